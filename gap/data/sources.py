"""A data set from wherever it lies: a folder in the dataset format, or a recorded run."""

from __future__ import annotations

import dataclasses
import tempfile
from pathlib import Path

from daq.store.run import open_run
from gap.data.dataset import DataSet
from gap.data.from_runs import export_runs
from gap.data.reader import read_dataset


def open_data(path: str | Path) -> DataSet:
    """Read a folder in the dataset format, or a run folder as `pamrig gap export` would write it.

    Raises:
        GapError: it is neither, or cannot be read.
        RecordError: the run holds no trial, or is damaged.
    """
    folder = Path(path)
    if not (folder / "run.json").is_file():
        return read_dataset(folder)
    with tempfile.TemporaryDirectory(prefix="pamrig-gap-") as scratch:
        made = Path(scratch) / "data"
        export_runs([open_run(folder)], made)
        found = read_dataset(made)
    return dataclasses.replace(found, origin=str(folder))
