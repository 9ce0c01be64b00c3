"""A test in several runs: each one goes on where the last whole trial of the one before ended."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from analysis.reduction.points import STRANGERS, Reduction
from daq.errors import ConfigError, RecordError
from daq.store.annotations import excluded_points
from rigs.execution.steps import EndTrial, Settle, Step, Steps, Trial
from rigs.protocols.registry import procedure_of

if TYPE_CHECKING:
    from daq.store.run import Run


def whole_trials(run: Run) -> list[int]:
    """Numbers of the trials that a run brought to their end, with those it took over before.

    Raises:
        RecordError: run.json is damaged.
    """
    taken = [int(t) for t in (run.manifest.get("continues") or {}).get("trials", [])]
    ended = [
        int(event["trial"])
        for event in run.events
        if event.get("kind") == "trial" and event.get("phase") == "end"
    ]
    return sorted({*taken, *ended})


def remaining(steps: Steps, done: Iterable[int]) -> Steps:
    """A method without the trials that are done; what comes before the first stays.

    What stands between two trials (a prompt, a new mounting) belongs to the one that follows and
    is left out with it, unless that one is still to be made. Left-out steps are answered as if
    all had gone well, so that the method runs through.
    """
    skip = set(done)
    waiting: list[Step] = []
    begun = inside = False
    answer: Any = None
    while True:
        try:
            step = steps.send(answer)
        except StopIteration:
            yield from _each(waiting)
            return
        answer = None
        if isinstance(step, Trial):
            begun, inside = True, True
            if step.trial in skip:
                waiting.clear()
                answer = _through(steps)
                inside = False
                continue
            yield from _each(waiting)
            waiting.clear()
            answer = yield step
        elif begun and not inside:
            waiting.append(step)
            answer = _as_if(step)
        else:
            answer = yield step
            if isinstance(step, EndTrial):
                inside = False


def _each(steps: list[Step]) -> Steps:
    """Steps that came before; a list alone would not take the answers that come back."""
    for step in steps:  # noqa: UP028
        yield step


def _through(steps: Steps) -> Any:
    """Let a trial pass without being made; None, the answer to its end."""
    answer: Any = None
    while True:
        step = steps.send(answer)
        if isinstance(step, EndTrial):
            return None
        answer = _as_if(step)


def _as_if(step: Step) -> Any:
    return (True, 0.0) if isinstance(step, Settle) else None


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
        return procedure_of(run.manifest.get("protocol")).reduce(run)
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


def continuation(run: Run) -> dict[str, Any]:
    """What the record of a run that goes on with ``run`` says of it.

    Raises:
        ConfigError: it cannot be continued.
    """
    where = run.run_id
    if run.manifest.get("imported"):
        raise ConfigError(where, "was imported", "only a test that was run can be continued")
    if run.outcome == "clean":
        raise ConfigError(where, "ran to its end", "start a new test")
    trials = whole_trials(run)
    return {
        "run_id": run.run_id,
        "outcome": run.outcome,
        "trials": trials,
        "trial": (max(trials) if trials else 0) + 1,
        "joined": True,
    }
