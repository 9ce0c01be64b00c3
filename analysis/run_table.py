"""The table of a run, joined with the trials of the earlier runs that it continues."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from analysis.reduction.points import STRANGERS, Reduction
from analysis.registry import analysis_of
from daq.errors import RecordError
from daq.store.annotations import excluded_points

if TYPE_CHECKING:
    from daq.store.run import Run

NONSENSE = (KeyError, IndexError, TypeError, ValueError, AttributeError, ArithmeticError)
"""What a record that another program wrote makes a reduction run into."""


def reduce_run(run: Run) -> Reduction:
    """The table of a run by its protocol, joined with the trials of the runs that it continues.

    Raises:
        RecordError: an earlier run is missing or damaged, or the record, though whole, does not
            hold what a test of its protocol writes.
    """
    chain = [run]
    while chain[-1].manifest.get("continues"):
        earlier = earlier_run(chain[-1])
        if earlier.run_id in [r.run_id for r in chain]:
            raise RecordError(str(run.folder), f"continues itself, through {earlier.run_id}")
        chain.append(earlier)
    reduction = _reduced(chain.pop())
    while chain:
        later = chain.pop()
        reduction = _continued(later, reduction)
    return reduction


def _reduced(run: Run) -> Reduction:
    """The table of a run alone."""
    try:
        return analysis_of(run.manifest.get("protocol")).reduce(run)
    except NONSENSE as error:
        raise RecordError(
            str(run.folder),
            f"holds nothing that a test of its protocol writes ({type(error).__name__}: {error})",
            "it is whole, but this version of pamrig did not write it",
        ) from error


def _continued(run: Run, first: Reduction) -> Reduction:
    """A run's table behind that of the run it goes on with."""
    before = run.manifest["continues"]
    own = _reduced(run)
    try:
        trials = [int(t) for t in before["trials"]]
        return _joined(_also_excluded(run, first), own, trials, str(before["run_id"]))
    except NONSENSE as error:
        raise RecordError(
            str(run.folder), f"does not say what it continues ({type(error).__name__}: {error})"
        ) from error


def _also_excluded(run: Run, first: Reduction) -> Reduction:
    """The earlier table without what was excluded in the run that goes on with it."""
    reasons = excluded_points(run.folder)
    out = first.table["order"].isin(list(reasons))
    rows = first.table[out].to_dict("records")
    listed = [
        {"reason": reasons[int(r["order"])], **{str(k): v for k, v in r.items()}} for r in rows
    ]
    table = first.table[~out].reset_index(drop=True)
    return replace(first, table=table, excluded=(*first.excluded, *listed))


def earlier_run(run: Run) -> Run:
    """The run that a run continues, beside it.

    Raises:
        RecordError: it is not there.
    """
    from daq.store.run import open_run

    name = str(run.manifest["continues"].get("run_id"))
    folder = Path(run.folder).resolve().parent / Path(name).name
    if name in ("", ".", "..") or Path(name).name != name or not (folder / "run.json").is_file():
        raise RecordError(
            str(run.folder),
            f"continues run {name}, which is not beside it",
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
        f"{len(trials)} whole trials ({len(kept)} points) are those of run {name}, which this one"
        " continues"
    )
    return replace(
        second,
        table=table,
        notes=(note, *(n for n in second.notes if not n.startswith(STRANGERS))),
        zeros=(*(z for z in first.zeros if z.get("trial") in trials), *second.zeros),
        excluded=(*first.excluded, *second.excluded),
    )
