"""A wrong path is reported before anything large is imported: seconds sooner."""

from __future__ import annotations

import os
from pathlib import Path

from gap.errors import GapError


def check_paths(data: Path, simulator: Path | None) -> None:
    """Raise `GapError` where the folder of the data or the simulator's file is not there."""
    if not os.path.exists(data):
        raise GapError(str(data), "no such folder", "check the path")
    if simulator is not None and not os.path.exists(simulator):
        raise GapError(str(simulator), "no such file", "give the description of a simulator")
