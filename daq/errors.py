"""Errors that a person can act on: who, what was expected, what came, what to do."""

from __future__ import annotations


def printable(text: str) -> str:
    """The text on one line, with what would steer a terminal written as an escape."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


class PamrigError(Exception):
    """Something an operator did, or met, that the program can name.

    The command line prints it without a traceback and exits with status 2.

    Args:
        where: the device, file (with row) or configuration key concerned.
        what: what was expected and what came instead (bytes, row, value).
        remedy: what the operator can do about it.
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
    """A TOML file has an unknown key, a missing key or a value out of bounds."""


class PortError(PamrigError):
    """A port is missing, in use, or may not be opened."""


class LinkLost(PamrigError):
    """A port vanished while in use, in whichever of its many ways."""


class DeviceError(PamrigError):
    """A device answered, but not what it should have."""


class DeviceTimeout(DeviceError):
    """A device did not answer within its deadline."""


class RecordError(PamrigError):
    """A run folder cannot be written, or cannot be read as one."""
