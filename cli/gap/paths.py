"""The data of a diagnosis; a wrong path is reported before anything large is imported."""

from __future__ import annotations

import os
from pathlib import Path

from daq.errors import RecordError
from gap.errors import GapError


def data_folder(data: str, runs: Path, simulator: Path | None) -> Path:
    """The folder that a diagnosis reads: a path, or a run by a part of its name or as 'last'.

    Raises:
        GapError: there is no such folder or run, or the simulator's file is not there.
    """
    if simulator is not None and not os.path.exists(simulator):
        raise GapError(str(simulator), "no such file", "give the description of a simulator")
    if os.path.exists(data):
        return Path(data)
    named = [path.parent for path in runs.glob("*/run.json") if data in path.parent.name]
    if data != "last" and len(named) != 1:
        what = f"no such folder, and {len(named) or 'no'} runs match in {runs}"
        raise GapError(data, what, "pamrig runs list shows all runs")
    from daq.store.store import find_run

    try:
        return Path(find_run(runs, data).folder)
    except RecordError as error:
        raise GapError(data, error.what, "check the path") from None
