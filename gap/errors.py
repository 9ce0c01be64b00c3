"""What a person did that the diagnosis cannot go on with."""

from __future__ import annotations

from daq.errors import PamrigError


class GapError(PamrigError):
    """A data set, plant file or argument that cannot be used: names file, row and column."""
