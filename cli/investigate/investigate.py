"""Closed loop of test and diagnosis: run a test, diagnose, run the advised test, and so on.

Each round records an ordinary run; all runs so far are diagnosed together. The next test is the one
that the diagnosis advises, if this rig can run it. Otherwise it is the next test of the survey.

Each new test also checks the explanation of the tests before it. An effect that predicts the new
test, while its rivals do not, may be named even if the diagnosis alone (which ignores the order of
the data) would not name it.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from analysis.reporting.derived import try_derive
from cli.investigate.survey import BEFORE_NAMING, Test, battery, protocol_text
from daq.errors import PamrigError
from daq.interrupt import StopFlag
from daq.store.run import Run, open_run
from gap.data.dataset import DataSet
from gap.data.from_runs import export_runs, stated_plant
from gap.data.reader import read_dataset
from gap.decision.at_bound import leaning
from gap.decision.diagnose import searched
from gap.decision.standing import Standing, joint
from gap.errors import GapError
from gap.estimation.fit_problem import Inquiry
from gap.selection.forward import Naming
from gap.validation.prediction import SHOWN, families, foretell, margins, rivals_of
from gap.verdict import Verdict
from rigs.execution.session import run_protocol
from rigs.protocols.registry import procedure
from rigs.rigfile.config import RigConfig

if TYPE_CHECKING:
    from rigs.virtual.bench import VirtualBench

VALVE_TESTS = ("step",)
"""Tests whose valve commands are diagnosed. In other tests, a loop only holds a pressure."""
LIKELY = 0.7
"""Reliability of a family from which it is checked by a new test before anything else is done."""
FAILED = 2
"""Number of failed predictions after which no more tests check the same family."""
Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Round:
    """One test and the diagnosis after it; `status` is empty if there was no diagnosis yet."""

    protocol: str
    why: str
    run: str
    outcome: str
    minutes: float
    status: str
    effects: tuple[str, ...]
    headline: str
    foretold: Mapping[str, Any] | None = None
    """How well the explanation before this test predicted it, if the test shows the effect."""


@dataclass(frozen=True)
class Investigation:
    """The result: the last verdict, how it was reached, and what is still needed.

    `conclusion` is "named", "needs reference", "no gap" or "open"; `why` is a sentence about it.
    `family` is the named family of effects, or several families that act together.
    """

    conclusion: str
    why: str
    family: str | None
    verdict: Verdict
    rounds: tuple[Round, ...]
    references: Mapping[str, str]
    folder: Path
    ended: str | None = None
    """The fault that ended it, or None. The conclusion is then from the tests before the fault."""

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            "schema": 1,
            "conclusion": self.conclusion,
            "why": self.why,
            "family": self.family,
            "references": dict(self.references),
            "rounds": [{**vars(r), "effects": list(r.effects)} for r in self.rounds],
            "minutes": sum(r.minutes for r in self.rounds),
            "data": str(self.folder),
            "ended": self.ended,
            "verdict": self.verdict.as_dict(),
        }


def investigate(
    config: RigConfig,
    out: Path,
    *,
    budget_min: float = 60.0,
    plant: Path | None = None,
    stop: StopFlag | None = None,
    report: Callable[[str], None] = lambda text: None,
    bench: VirtualBench | None = None,
    derive: bool = True,
) -> Investigation:
    """Run tests on a rig until the gap is named, no test is left or the budget is used up.

    Args:
        config: the rig.
        out: folder of runs. Protocol files and the joint data set go into its subfolder
            `investigation` (`investigation-2` and so on if that exists).
        budget_min: bench time in minutes; no test starts after it is used up.
        plant: known constants of the bench's plant, in the format of bench.toml.
        stop: ends the investigation; the completed tests are diagnosed.
        report: called with a line of text after each step.
        bench: a virtual bench on a virtual clock, used for all tests. By default one is made
            if the rig is virtual.
        derive: also make table, figures and report of each run.

    Raises:
        PamrigError: the first test did not finish, or data cannot be used. A later fault ends
            the investigation; its conclusion is then from the tests before the fault.
    """
    if not budget_min > 0.0:
        raise GapError("--budget", f"expected minutes above 0, got {budget_min:g}")
    if plant is not None:
        stated_plant(plant)  # a bad file must fail now, not after the first hour of tests
    stop = stop or StopFlag()
    folder = _own_folder(out)
    if bench is None and config.is_virtual:
        from daq.clock import VirtualClock
        from rigs.virtual.bench import VirtualBench

        bench = VirtualBench(config, VirtualClock())
    state = _Investigating(config, folder, plant)
    left, again = battery(config), battery(config, again=True)
    used_min = 0.0
    while used_min < budget_min and not stop.reason:
        chosen = state.next(left, again)
        if chosen is None:
            break
        test, why = chosen
        name = test.protocol
        report(f"round {len(state.rounds) + 1}: {name}, {test.what} ({why})")
        path = folder / f"{len(state.rounds) + 1:02d}-{name}.toml"
        path.write_text(protocol_text(test, config), encoding="utf-8")
        kind = procedure(name)
        plan = kind.read(str(path), config)
        result = run_protocol(kind, config, plan, out, stop=stop, bench=bench)
        if derive:
            try_derive(result.folder, result.error)
        run = open_run(result.folder)
        if result.outcome == "stopped":
            report(f"  stopped; {run.run_id} is not used")
            break
        if result.outcome != "clean":
            error = PamrigError(
                str(result.folder), f"the test ended {result.outcome}: {result.error}",
                "find the cause and start again; the recorded data are safe",
            )  # fmt: skip
            if not state.runs:
                raise error
            # Do not continue without the operator after a fault. Diagnose the tests before it.
            state.ended = str(error)
            report(f"  {error}")
            break
        state.add(test, why, run, result.outcome)
        used_min += state.rounds[-1].minutes
        report(f"  {state.rounds[-1].headline}")
        if state.settled and not (state.doubtful and left):
            break
    return state.concluded()


@dataclass
class _Investigating(Standing):
    """An investigation in progress: the tests so far and their diagnosis."""

    config: RigConfig
    folder: Path
    plant: Path | None
    runs: list[Run] = field(default_factory=list)
    tests: list[Test] = field(default_factory=list)
    rounds: list[Round] = field(default_factory=list)
    inquiry: Inquiry | None = None
    naming: Naming | None = None
    ended: str | None = None
    _margins: Array | None = None

    def next(self, left: list[Test], again: list[Test]) -> tuple[Test, str] | None:
        """Take the next test from `left` or `again`; returns it and why, or None."""
        verdict = self.verdict
        check = None
        if self._only_pressure(left):
            check = self._most_selective([t for t in again if t.protocol in VALVE_TESTS], -np.inf)
        if check is None and self._likely:
            check = self._most_selective(again)
        if check is not None:
            again.remove(check)
            return check, self._reason_to_check
        if verdict is not None and verdict.next_experiment is not None:
            advised = verdict.next_experiment
            for tests in (left, again):
                for test in tests:
                    if test.matches(advised.protocol, advised.settings):
                        tests.remove(test)
                        between = " and ".join(advised.between)
                        return test, "advised" + (f", to distinguish {between}" if between else "")
        if left:
            why = "first tests" if verdict is None else "no test so far covers it"
            return left.pop(0), why
        check = self._most_selective(again)
        if check is None:
            return None
        again.remove(check)
        return check, self._reason_to_check

    @property
    def _likely(self) -> bool:
        """Whether one family is left, nearly named, and no test has checked it yet."""
        if self.family is None or self.family in self.foretold or self.verdict is None:
            return False
        belief = self.verdict.evidence.get("belief", {})
        return float(belief.get("right", 0.0) + belief.get("part", 0.0)) >= LIKELY

    def _only_pressure(self, left: list[Test]) -> bool:
        """Whether the effect acts on the pressure only, and no test of the valves is left."""
        if self.naming is None or any(test.protocol in VALVE_TESTS for test in left):
            return False
        blocks = {b for suspect in self.naming.chosen.state.suspects for b in suspect.blocks}
        return blocks == {"pressure"}

    def _most_selective(self, again: list[Test], least: float = SHOWN) -> Test | None:
        """The test to repeat: where explanation and nearest rival differ most.

        None if no difference exceeds `least`, or if `FAILED` predictions have failed already.
        """
        if self.naming is None or self.inquiry is None or self.family is None:
            return None
        if sum(not found.confirmed for _, found in self.foretold.get(self.family, [])) >= FAILED:
            return None
        if self._margins is None:
            others = [self.inquiry.base, *rivals_of(self.inquiry, self.naming, self._entry_ids)]
            self._margins = margins(self.inquiry, self.naming.chosen.state, others)
        best: tuple[float, Test | None] = (least, None)
        for run, made in zip(self.runs, self.tests, strict=True):
            difference = float(self._margins[:, _trials_of(self.inquiry, run)].sum(axis=1).min())
            for test in again:
                if test.what == made.what and difference > best[0]:
                    best = (difference, test)
        return best[1]

    @property
    def _reason_to_check(self) -> str:
        assert self.naming is not None
        names = " and ".join(self.naming.chosen.state.ids)
        return f"at other settings, to check whether {names} predicts it"

    def add(self, test: Test, why: str, run: Run, outcome: str) -> None:
        """Add a run to those before it and diagnose all of them."""
        self.runs.append(run)
        self.tests.append(test)
        minutes = float((run.final or {}).get("duration_s") or 0.0) / 60.0
        known: tuple[str, tuple[str, ...], str] = ("", (), "the first tests are not complete")
        prediction: dict[str, Any] | None = None
        if len(self.runs) >= BEFORE_NAMING:
            prediction = self._diagnose()
            assert self.verdict is not None
            ids = tuple(" + ".join(effect.ids) for effect in self.verdict.effects)
            known = (self.verdict.status, ids, self.why)
        self.rounds.append(
            Round(test.protocol, why, run.run_id, outcome, minutes, *known, foretold=prediction)
        )

    def _diagnose(self) -> dict[str, Any] | None:
        """Diagnose all runs; returns how well the previous explanation predicted the last run."""
        before, known, entries = self.naming, self.inquiry, self._entry_ids
        data = joined(self.runs, self.folder / f"data-{len(self.runs):02d}", self.plant)
        self.verdict, self.inquiry, self.naming = searched(data)
        self._margins = None
        self.leaning = {}
        if self.inquiry is not None and self.verdict.status == "no_gap_above_floor":
            self.leaning = leaning(self.inquiry)
        if before is None or known is None or not before.chosen.keys or self.inquiry is None:
            return None
        state = before.chosen.state
        new = _trials_of(self.inquiry, self.runs[-1])
        found = foretell(self.inquiry, new, state, rivals_of(known, before, entries))
        if not found.shown:
            return None
        self.foretold.setdefault(joint(families(state.ids)), []).append(
            (self.tests[-1].protocol, found)
        )
        return {
            "by": list(state.ids), "share": found.share, "confirmed": found.confirmed,
            "rows": found.rows, "without": found.without, "left": found.left,
            "rivals": {" + ".join(ids): left for ids, left in found.rivals.items()},
        }  # fmt: skip

    def concluded(self) -> Investigation:
        """The result, also written to the investigation's folder."""
        if not self.runs:
            raise PamrigError(self.config.source, "no test was run to its end", "start again")
        if self.verdict is None:
            self._diagnose()
        assert self.verdict is not None
        found = Investigation(
            self.conclusion, self.why, self.named, self.verdict, tuple(self.rounds),
            self.references, self.folder, self.ended,
        )  # fmt: skip
        text = json.dumps(found.as_dict(), indent=2, allow_nan=False)
        (self.folder / "investigation.json").write_text(text + "\n", encoding="utf-8")
        return found


def _trials_of(q: Inquiry, run: Run) -> list[int]:
    return [k for k, trial in enumerate(q.data.trials) if trial.name.startswith(f"{run.run_id}:")]


def _own_folder(out: Path) -> Path:
    """Create a new folder for this investigation."""
    number = 1
    while True:
        folder = out / ("investigation" if number == 1 else f"investigation-{number}")
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            number += 1
        except OSError as error:
            raise GapError(str(folder), f"cannot be created: {error.strerror}") from None
        else:
            return folder


def joined(runs: list[Run], folder: Path, plant: Path | None) -> DataSet:
    """Join all runs into one data set, written to `folder`."""
    export_runs(runs, folder, plant=plant, commands_of=VALVE_TESTS)
    return dataclasses.replace(read_dataset(folder), origin=str(folder))
