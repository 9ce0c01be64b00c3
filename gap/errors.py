"""What a person did that the diagnosis, or its blind check, cannot go on with."""

from __future__ import annotations

from daq.errors import PamrigError


class GapError(PamrigError):
    """A data set, plant file or argument that cannot be used: names file, row and column."""


class CheckError(PamrigError):
    """A stream, a range of sets or a file of results that cannot be used."""
