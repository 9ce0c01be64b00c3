"""A test in several runs: each one goes on where the last whole trial of the one before ended."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from daq.errors import ConfigError
from rigs.steps.custom_step import Step, Steps
from rigs.steps.steps import EndTrial, Settle, Trial

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
