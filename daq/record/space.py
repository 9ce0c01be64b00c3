"""Check of the free disk space before a run."""

from __future__ import annotations

import shutil
from pathlib import Path

from daq.errors import RecordError

BYTES_PER_POINT = 400_000
"""Upper estimate of the record size per settled point: some seconds at 1 kHz and one frame."""


def check_disk(root: Path, points: int) -> None:
    """Refuse to start a run that needs more space than the disk has.

    Raises:
        RecordError: names the required and the free space.
    """
    try:
        root.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RecordError(
            str(root), f"cannot hold runs: {error.strerror}", "choose another folder with --out"
        ) from None
    free = shutil.disk_usage(root).free
    need = 20_000_000 + points * BYTES_PER_POINT
    if free < need:
        raise RecordError(
            str(root),
            f"{free / 1e6:.0f} MB free, this run may need {need / 1e6:.0f} MB",
            "make room or choose another folder with --out",
        )
