"""The table of a run, joined with the trials of the earlier runs that it continues."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from analysis.reduction.points import Reduction, exclude
from analysis.registry import analysis_of
from daq.errors import RecordError
from daq.store.annotations import excluded_points

if TYPE_CHECKING:
    from daq.store.run import Run

INVALID_RECORD = (KeyError, IndexError, TypeError, ValueError, AttributeError, ArithmeticError)
"""Errors of a reduction if another program wrote the record."""


def reduce_run(run: Run) -> Reduction:
    """The table of a run by its protocol, joined with the trials of the runs that it continues.

    Raises:
        RecordError: an earlier run is missing or damaged, or the record does not have the
            contents of a test of its protocol.
    """
    chain = [run]
    while chain[-1].manifest.get("continues"):
        earlier = earlier_run(chain[-1])
        if earlier.run_id in [r.run_id for r in chain]:
            raise RecordError(str(run.folder), f"continues itself, through {earlier.run_id}")
        chain.append(earlier)
    reduction = _reduced(chain.pop())
    while chain:
        reduction = _continued(chain.pop(), reduction)
    return reduction


def _reduced(run: Run) -> Reduction:
    """The table of a run alone."""
    try:
        return analysis_of(run.manifest.get("protocol")).reduce(run)
    except INVALID_RECORD as error:
        raise RecordError(
            str(run.folder),
            "does not have the contents of a test of its protocol"
            f" ({type(error).__name__}: {error})",
            "the record is complete, but this version of pamrig did not write it",
        ) from error


def _continued(run: Run, first: Reduction) -> Reduction:
    """The table of the earlier runs, followed by that of the run that continues them."""
    before = run.manifest["continues"]
    own = _reduced(run)
    try:
        trials = [int(t) for t in before["trials"]]
        earlier = exclude(first, excluded_points(run.folder))
        return _joined(earlier, own, trials, str(before["run_id"]))
    except INVALID_RECORD as error:
        raise RecordError(
            str(run.folder),
            f"does not state correctly what it continues ({type(error).__name__}: {error})",
        ) from error


def earlier_run(run: Run) -> Run:
    """The run that a run continues, in the same folder of runs.

    Raises:
        RecordError: it is not there.
    """
    from daq.store.run import open_run

    name = str(run.manifest["continues"].get("run_id"))
    folder = Path(run.folder).resolve().parent / Path(name).name
    if name in ("", ".", "..") or Path(name).name != name or not (folder / "run.json").is_file():
        raise RecordError(
            str(run.folder),
            f"continues run {name}, which is not in the same folder",
            "put both runs into one folder",
        )
    return open_run(folder)


def _joined(first: Reduction, second: Reduction, trials: list[int], name: str) -> Reduction:
    import pandas as pd

    kept = first.table[first.table["trial"].isin(trials)]
    own = second.table[~second.table["trial"].isin(trials)]
    parts = [part for part in (kept, own) if len(part)] or [own]
    table = pd.concat(parts, ignore_index=True).sort_values(
        "order", kind="stable", ignore_index=True
    )
    note = (
        f"{len(trials)} complete trials ({len(kept)} points) are those of run {name}, which this"
        " run continues"
    )
    return replace(
        second,
        table=table,
        own_notes=(note, *second.own_notes),
        zeros=(*(z for z in first.zeros if z.get("trial") in trials), *second.zeros),
        excluded=(*first.excluded, *second.excluded),
        unknown_exclusions=(),
    )
