"""The data of a diagnosis; a wrong path is reported before anything large is imported."""

from __future__ import annotations

import os
from pathlib import Path

from daq.errors import RecordError
from gap.errors import GapError


def data_folder(data: str, runs: Path, simulator: Path | None) -> Path:
    """The folder that a diagnosis reads: a path, or a run of ``runs`` by its name or as 'last'.

    Raises:
        GapError: there is no such folder or run, or the simulator's file is not there.
    """
    if simulator is not None and not os.path.exists(simulator):
        raise GapError(str(simulator), "no such file", "give the description of a simulator")
    if os.path.exists(data):
        return Path(data)
    from daq.store.store import find_run

    try:
        return Path(find_run(runs, data).folder)
    except RecordError as error:
        what = f"no such folder, and {error.what}" if data != "last" else error.what
        raise GapError(data, what, "check the path") from None
