"""Errors of requests that the blind check cannot carry out."""

from __future__ import annotations

from daq.errors import PamrigError


class CheckError(PamrigError):
    """A stream, a range of sets or a file of results that cannot be used."""
