"""The table of a run, joined with the trials of the earlier runs that it continues."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from analysis.reduction.points import Reduction, exclude
from analysis.registry import analysis_of
from daq.errors import RecordError
from daq.store.annotations import excluded_points
from daq.store.verify import findings

if TYPE_CHECKING:
    from daq.store.run import Run

INVALID_RECORD = (KeyError, IndexError, TypeError, ValueError, AttributeError, ArithmeticError)
"""Errors of a reduction if another program wrote the record."""


@contextmanager
def contents_of(run: Run) -> Iterator[None]:
    """Turn the errors of contents that no test of the protocol has into one about the record.

    Raises:
        RecordError: names the run.
    """
    try:
        yield
    except INVALID_RECORD as error:
        raise RecordError(
            str(run.folder),
            "does not have the contents of a test of its protocol"
            f" ({type(error).__name__}: {error})",
            "the record is complete, but this version of pamrig did not write it",
        ) from error


def chain_of(run: Run) -> list[Run]:
    """A run and the earlier runs that it continues, the latest first.

    Raises:
        RecordError: an earlier run is missing, or the chain is a circle.
    """
    chain = [run]
    while chain[-1].manifest.get("continues"):
        earlier = earlier_run(chain[-1])
        if earlier.run_id in [r.run_id for r in chain]:
            raise RecordError(str(run.folder), f"continues itself, through {earlier.run_id}")
        chain.append(earlier)
    return chain


def record_findings(run: Run) -> tuple[str, ...]:
    """What is wrong with the record of a run, and with those of the runs that it continues.

    Whatever is made from a run states this; files of another run are never read at all.
    """
    own = findings(run)
    others = [f"{r.run_id}: {text}" for r in chain_of(run)[1:] for text in findings(r)]
    return (*own, *others)


def reduce_run(run: Run) -> Reduction:
    """The table of a run by its protocol, joined with the trials of the runs that it continues.

    Raises:
        RecordError: an earlier run is missing or damaged, or the record does not have the
            contents of a test of its protocol.
    """
    chain = chain_of(run)
    reduction = _reduced(chain.pop())
    while chain:
        reduction = _continued(chain.pop(), reduction)
    return reduction


def _reduced(run: Run) -> Reduction:
    """The table of a run alone."""
    with contents_of(run):
        return analysis_of(run.manifest.get("protocol")).reduce(run)


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
    return open_run(folder, run.pictures)


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
