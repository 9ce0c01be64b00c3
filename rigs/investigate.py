"""Closes the loop: run a test, diagnose, run what the diagnosis asks for, until it is named.

Top floor: here a rig and a diagnosis meet. Each round records an ordinary run; all runs so far are
diagnosed together. What to run next is what the diagnosis advises, where this rig can run it, and
otherwise the next test that shows something no test so far has shown.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from daq.errors import PamrigError
from daq.run import Run, open_run
from gap.advise import reference_for
from gap.dataset import DataSet
from gap.diagnose import diagnose
from gap.errors import GapError
from gap.from_runs import export_runs, stated_plant
from gap.reader import read_dataset
from gap.reporttext import headline
from gap.verdict import Verdict
from rigs.config import RigConfig
from rigs.interrupt import StopFlag
from rigs.protocols.registry import procedure
from rigs.session import run_protocol
from rigs.survey import BEFORE_NAMING, Test, battery, protocol_text

if TYPE_CHECKING:
    from rigs.virtual.bench import VirtualBench

SETTLED = ("named", "named_form_inadequate", "data_unfit")
VALVE_TESTS = ("step",)
"""Tests whose valve commands are diagnosed: elsewhere a loop only holds a pressure."""
Told = Callable[[str], None]


@dataclass(frozen=True)
class Round:
    """One test and what was known after it; `status` is empty where nothing was diagnosed yet."""

    protocol: str
    why: str
    run: str
    outcome: str
    minutes: float
    status: str
    effects: tuple[str, ...]
    headline: str


@dataclass(frozen=True)
class Investigation:
    """What came of it: the last verdict, how it was reached, and what is still needed.

    `conclusion` is "named", "needs reference", "no gap" or "open".
    """

    conclusion: str
    verdict: Verdict
    rounds: tuple[Round, ...]
    references: Mapping[str, str]
    folder: Path

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            "schema": 1,
            "conclusion": self.conclusion,
            "references": dict(self.references),
            "rounds": [{**vars(r), "effects": list(r.effects)} for r in self.rounds],
            "minutes": sum(r.minutes for r in self.rounds),
            "data": str(self.folder),
            "verdict": self.verdict.as_dict(),
        }


def investigate(
    config: RigConfig,
    out: Path,
    *,
    budget_min: float = 60.0,
    plant: Path | None = None,
    stop: StopFlag | None = None,
    tell: Told = lambda text: None,
    bench: VirtualBench | None = None,
    derive: bool = True,
) -> Investigation:
    """Run tests on a rig until the gap is named, or nothing more can be had for the budget.

    Args:
        config: the rig.
        out: folder of runs; protocol files and the joint data set go to `investigation` in it (or
            `investigation-2` and so on, where there is one).
        budget_min: bench time; no test is begun once it is used up.
        plant: what is known of the bench's plant, as bench.toml states it.
        stop: set from outside to end in good order: what was measured is diagnosed.
        tell: takes a line after each step.
        bench: a virtual bench on a virtual clock; all tests are run on it, one after another. By
            default one is made of a rig that states a virtual bench.
        derive: also make table, figures and report of each run.

    Raises:
        PamrigError: a test could not be run at all, or its data cannot be used.
    """
    if not budget_min > 0.0:
        raise GapError("--budget", f"expected minutes above 0, got {budget_min:g}")
    if plant is not None:
        stated_plant(plant)  # refused now, not after the first hour of tests
    stop = stop or StopFlag()
    folder = _own_folder(out)
    if bench is None and config.is_virtual:
        from daq.clock import VirtualClock
        from rigs.virtual.bench import VirtualBench

        bench = VirtualBench(config, VirtualClock())
    left = battery(config)
    runs: list[Run] = []
    rounds: list[Round] = []
    verdict: Verdict | None = None
    used_min = 0.0
    while left and used_min < budget_min and not stop.reason:
        test, why = _next(verdict, left)
        left.remove(test)
        name = test.protocol
        tell(f"round {len(rounds) + 1}: {name}, {test.what} ({why})")
        path = folder / f"{len(rounds) + 1:02d}-{name}.toml"
        path.write_text(protocol_text(test, config), encoding="utf-8")
        kind = procedure(name)
        plan = kind.read(str(path), config)
        result = run_protocol(kind, config, plan, out, stop=stop, derive=derive, bench=bench)
        run = open_run(result.folder)
        if result.outcome == "stopped":
            tell(f"  stopped; {run.run_id} is left out")
            break
        if result.outcome != "clean":
            raise PamrigError(
                str(result.folder), f"the test ended {result.outcome}: {result.error}",
                "find the cause and begin again; what was recorded is safe",
            )  # fmt: skip
        minutes = float((run.final or {}).get("duration_s") or 0.0) / 60.0
        used_min += minutes
        runs.append(run)
        known: tuple[str, tuple[str, ...], str] = ("", (), "the survey is not whole yet")
        if len(runs) >= BEFORE_NAMING:
            verdict = diagnose(joined(runs, folder / f"data-{len(runs):02d}", plant))
            ids = tuple(" + ".join(effect.ids) for effect in verdict.effects)
            known = (verdict.status, ids, headline(verdict))
        rounds.append(Round(name, why, run.run_id, result.outcome, minutes, *known))
        tell(f"  {rounds[-1].headline}")
        if verdict is not None and verdict.status in SETTLED:
            break
    return _concluded(config, runs, rounds, verdict, folder, plant)


def _concluded(
    config: RigConfig, runs: list[Run], rounds: list[Round], verdict: Verdict | None,
    folder: Path, plant: Path | None,
) -> Investigation:  # fmt: skip
    if not runs:
        raise PamrigError(config.source, "no test was run to its end", "begin again")
    if verdict is None:
        verdict = diagnose(joined(runs, folder / f"data-{len(runs):02d}", plant))
    found = Investigation(
        _conclusion(verdict), verdict, tuple(rounds), _references(verdict), folder
    )
    text = json.dumps(found.as_dict(), indent=2, allow_nan=False)
    (folder / "investigation.json").write_text(text + "\n", encoding="utf-8")
    return found


def _own_folder(out: Path) -> Path:
    """A folder that no investigation has used yet."""
    number = 1
    while True:
        folder = out / ("investigation" if number == 1 else f"investigation-{number}")
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            number += 1
        except OSError as error:
            raise GapError(str(folder), f"cannot be made: {error.strerror}") from None
        else:
            return folder


def joined(runs: list[Run], folder: Path, plant: Path | None) -> DataSet:
    """All runs so far as one data set, written to `folder`."""
    export_runs(runs, folder, plant=plant, commands_of=VALVE_TESTS)
    return dataclasses.replace(read_dataset(folder), origin=str(folder))


def _next(verdict: Verdict | None, left: list[Test]) -> tuple[Test, str]:
    """The next test and why it is run."""
    if verdict is not None and verdict.next_experiment is not None:
        advised = verdict.next_experiment
        for test in left:
            if test.answers(advised.protocol, advised.why):
                between = " and ".join(advised.between)
                return test, "advised" + (f", to tell {between} apart" if between else "")
    first = left[0]
    return first, "to begin with" if verdict is None else "nothing so far has shown what it shows"


def _conclusion(verdict: Verdict) -> str:
    if verdict.status in ("named", "named_form_inadequate"):
        return "named"
    if verdict.status in ("indistinguishable", "mimicable"):
        return "needs reference"
    return "no gap" if verdict.status == "no_gap_above_floor" else "open"


def _references(verdict: Verdict) -> dict[str, str]:
    """What would tell the entries of the ambiguity set apart, where a test did not."""
    if _conclusion(verdict) != "needs reference":
        return {}
    names = dict.fromkeys(name for effect in verdict.effects for name in effect.ids)
    return {name: reference_for(name) for name in names}
