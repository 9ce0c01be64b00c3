"""What a person asked of the blind check that it cannot do."""

from __future__ import annotations

from daq.errors import PamrigError


class CheckError(PamrigError):
    """A stream, a range of sets or a file of results that cannot be used."""
