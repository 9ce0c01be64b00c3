"""Errors with a cause and a remedy for the operator."""

from __future__ import annotations


def printable(text: str) -> str:
    """Escape non-printable characters, so that a text cannot control the terminal."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


class PamrigError(Exception):
    """An error with a known cause. The command line prints it without traceback, exit status 2.

    Args:
        where: the device, file (with row) or configuration key.
        what: the expected and the actual state (bytes, row, value).
        remedy: what the operator can do.
    """

    def __init__(self, where: str, what: str, remedy: str = "") -> None:
        self.where = where
        self.what = what
        self.remedy = remedy
        super().__init__(str(self))

    def __str__(self) -> str:
        text = f"{self.where}: {self.what}"
        return f"{text} ({self.remedy})" if self.remedy else text


class ConfigError(PamrigError):
    """A TOML file has an unknown key, a missing key or a value out of range."""


class PortError(PamrigError):
    """A port is missing, in use, or access is denied."""


class LinkLost(PamrigError):
    """A port was lost while in use."""


class DeviceError(PamrigError):
    """A device sent an unexpected answer."""


class DeviceTimeout(DeviceError):
    """A device did not answer within its deadline."""


class RecordError(PamrigError):
    """A run folder cannot be written or read."""
