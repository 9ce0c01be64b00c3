"""Closes the loop: run a test, diagnose, run what the diagnosis requests, until it is named.

Where no test decides, the instruments read reference standards, if somebody is there to set them.
Top floor: here a rig and a diagnosis meet. Each round records an ordinary run; all runs so far are
diagnosed together. What to run next is what the diagnosis advises, where this rig can run it, and
otherwise the next test that shows something no test so far has shown. Each test is a trial of what
the tests before it were explained by: an explanation that predicts it, as no other does, may be
named though the diagnosis alone, which sees no order in its data, would not go so far.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.reporting.derived import try_derive
from cli.investigate.config import INVESTIGATION
from cli.investigate.survey import Test, battery, protocol_text
from daq.calibration import StandardReading
from daq.errors import PamrigError
from daq.interrupt import StopFlag, Stopped
from daq.store.run import Run, open_run
from gap.data.dataset import DataSet
from gap.data.from_runs import export_runs, stated_plant
from gap.data.reader import read_dataset
from gap.decision.at_bound import relieving
from gap.decision.diagnose import diagnose_without_term, with_empirical_term
from gap.decision.sequential import Conclusion, SequentialVerdict, joint
from gap.errors import GapError
from gap.estimation.fit_problem import FitProblem
from gap.estimation.standards import ERRORS_OF
from gap.reporting.text import conclusion_text
from gap.selection.search import SearchResult
from gap.validation.config import VALIDATION
from gap.validation.prediction import families, margins, predict_trials, rivals_of
from gap.verdict import Status, Verdict
from plant.arrays import Array
from rigs.calibration.standards import read_standards, readable_standards
from rigs.execution.session import run_protocol
from rigs.protocols.registry import procedure
from rigs.rigfile.config import RigConfig

if TYPE_CHECKING:
    from rigs.virtual.bench import VirtualBench

VALVE_TESTS = ("step",)
"""Tests whose valve commands are diagnosed: elsewhere a loop only holds a pressure."""
VALVES_MOVING = ("step", False)
"""The kind of those that move valves all the time."""
Report = Callable[[str], None]


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
    predicted: Mapping[str, Any] | None = None
    """How what was found before fared on this test, where the test shows it."""

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        values = {**vars(self), "effects": list(self.effects)}
        return values | {"foretold": values.pop("predicted")}


@dataclass(frozen=True)
class Investigation:
    """What came of it: the last verdict, how it was reached, and what is still needed.

    `conclusion` is "named", "needs reference", "no gap" or "open", and `why` is
    its sentence.
    `family` is what was named: a family of the catalogue, or several that act together.
    """

    conclusion: str
    why: str
    family: str | None
    verdict: Verdict
    rounds: tuple[Round, ...]
    references: Mapping[str, str]
    folder: Path
    ended: str | None = None
    """The fault that ended it, if one did: the conclusion is that of the tests before."""

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            "schema": 1,
            "conclusion": self.conclusion,
            "why": self.why,
            "family": self.family,
            "references": dict(self.references),
            "rounds": [r.as_dict() for r in self.rounds],
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
    report: Report = lambda text: None,
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
        report: takes a line after each step.
        bench: a virtual bench on a virtual clock; all tests are run on it, one after another. By
            default one is made of a rig that states a virtual bench.
        derive: also make table, figures and report of each run.

    Raises:
        PamrigError: the first test did not come to its end, or data cannot be used. A later fault
            ends the investigation, with what the tests before it allow to say.
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
    running = _Running(config, folder, plant)
    left, again = battery(config), battery(config, again=True)
    used_min = 0.0
    while used_min < budget_min and not stop.reason:
        chosen = running.next(left, again)
        if chosen is None:
            break
        test, why = chosen
        name = test.protocol
        report(f"round {len(running.rounds) + 1}: {name}, {test.what} ({why})")
        path = folder / f"{len(running.rounds) + 1:02d}-{name}.toml"
        path.write_text(protocol_text(test, config), encoding="utf-8")
        kind = procedure(name)
        plan = kind.read(str(path), config)
        result = run_protocol(kind, config, plan, out, stop=stop, bench=bench)
        if derive:
            try_derive(result.folder, result.error)
        run = open_run(result.folder)
        if result.outcome == "stopped":
            report(f"  stopped; {run.run_id} is left out")
            break
        if result.outcome != "clean":
            error = PamrigError(
                str(result.folder), f"the test ended {result.outcome}: {result.error}",
                "find the cause and begin again; `pamrig runs verify` checks what was recorded",
            )  # fmt: skip
            if not running.runs:
                raise error
            # No machine goes on by itself after a fault; what was measured before it is diagnosed.
            running.ended = str(error)
            report(f"  {error}")
            break
        running.take(test, why, run, result.outcome)
        used_min += running.rounds[-1].minutes
        report(f"  {running.rounds[-1].headline}")
        if running.settled and not (running.uncertain and left):
            break
    if not stop.reason and used_min < budget_min:
        _have_standards_read(running, config, out, stop, bench, report)
    return running.concluded(stopped=bool(stop.reason))


def _have_standards_read(
    running: _Running, config: RigConfig, out: Path, stop: StopFlag, bench: VirtualBench | None,
    report: Report,
) -> None:  # fmt: skip
    """Have reference standards read as long as one would decide what no test did."""
    while running.ended is None and (channels := running.wanted_standards):
        report(f"reference standards: {', '.join(channels)}")
        try:
            read, record = read_standards(config, channels, out, stop=stop, bench=bench)
        except Stopped:
            report("  stopped; the standards are left out")
            return
        except PamrigError as error:
            running.ended = str(error)
            report(f"  {error}")
            return
        running.take_standards(channels, read, record)
        report(f"  {running.rounds[-1].headline}")


@dataclass
class _Running(SequentialVerdict):
    """An investigation under way: the tests so far, and what is known after them."""

    config: RigConfig
    folder: Path
    plant: Path | None
    runs: list[Run] = field(default_factory=list)
    tests: list[Test] = field(default_factory=list)
    rounds: list[Round] = field(default_factory=list)
    standards: list[StandardReading] = field(default_factory=list)
    problem: FitProblem | None = None
    search: SearchResult | None = None
    _margins: Array | None = None

    def next(self, left: list[Test], again: list[Test]) -> tuple[Test, str] | None:
        """The next test, taken from those left or to be made again, and why; None at the end."""
        verdict = self.verdict
        repeated = None
        if self._shows_valves_alone(left):
            repeated = self._repeated_test([t for t in again if t.kind == VALVES_MOVING], -np.inf)
        if repeated is None and self._nearly_certain:
            repeated = self._repeated_test(again)
        if repeated is not None:
            again.remove(repeated)
            return repeated, self._reason_to_repeat
        if verdict is not None and verdict.next_experiment is not None:
            advised = verdict.next_experiment
            for tests in (left, again):
                for test in tests:
                    if test.answers(advised.protocol, advised.settings):
                        tests.remove(test)
                        between = " and ".join(advised.between)
                        return test, "advised" + (f", to tell {between} apart" if between else "")
        if left:
            why = "to begin with" if verdict is None else "nothing so far has shown what it shows"
            return left.pop(0), why
        repeated = self._repeated_test(again)
        if repeated is None:
            return None
        again.remove(repeated)
        return repeated, self._reason_to_repeat

    @property
    def _nearly_certain(self) -> bool:
        """Whether one family is left, all but named, and no test has put it to the proof yet."""
        if self.family is None or self.family in self.predicted or self.verdict is None:
            return False
        reliability = self.verdict.evidence.get("belief", {})
        right = float(reliability.get("right", 0.0) + reliability.get("part", 0.0))
        return right >= INVESTIGATION.nearly_certain

    def _shows_valves_alone(self, left: list[Test]) -> bool:
        """Whether what was found shows where valves act, and no test left looks there."""
        if self.search is None or any(test.kind == VALVES_MOVING for test in left):
            return False
        blocks = {b for candidate in self.search.best.fit.candidates for b in candidate.blocks}
        return blocks == {"pressure"}

    def _repeated_test(
        self, again: list[Test], least: float = VALIDATION.shown_chi2
    ) -> Test | None:
        """The test to be made again: where the explanation and its nearest rival part most.

        It is made for one family: the one that leads, or the one that all entries left agree on.
        None where no test parts them by more than `least`, or two have failed already.
        """
        if self.search is None or self.problem is None or not (self.family or self.agreed):
            return None
        predicted = self.predicted.get(joint(families(self.search.best.fit.ids)), [])
        if sum(not found.confirmed for _, found in predicted) >= INVESTIGATION.most_failed:
            return None
        if self._margins is None:
            others = [self.problem.base, *rivals_of(self.problem, self.search, self._entry_ids)]
            self._margins = margins(self.problem, self.search.best.fit, others)
        best: tuple[float, Test | None] = (least, None)
        for run, made in zip(self.runs, self.tests, strict=True):
            apart = float(self._margins[:, _trials_of(self.problem, run)].sum(axis=1).min())
            for test in again:
                if test.kind == made.kind and apart > best[0]:
                    best = (apart, test)
        return best[1]

    @property
    def _reason_to_repeat(self) -> str:
        assert self.search is not None
        names = " and ".join(self.search.best.fit.ids)
        return f"at other settings, to see whether {names} predicts it"

    def take(self, test: Test, why: str, run: Run, outcome: str) -> None:
        """Join a run to those before it and diagnose all of them."""
        self.runs.append(run)
        self.tests.append(test)
        known: tuple[str, tuple[str, ...], str] = ("", (), "the survey is not whole yet")
        predicted: dict[str, Any] | None = None
        if len(self.runs) >= INVESTIGATION.first_diagnosis_after:
            predicted = self._diagnose()
            known = self._known()
        self.rounds.append(
            Round(
                test.protocol,
                why,
                run.run_id,
                outcome,
                _minutes(run),
                *known,
                predicted=predicted,
            )
        )

    @property
    def wanted_standards(self) -> tuple[str, ...]:
        """Channels that should read a standard, as nothing else decides, and have not yet.

        So it is too where what fits best rests on an error of an instrument that nobody believes,
        or nothing fits for sure: one that reads right leaves the rest.
        """
        undecided = (Conclusion.NEEDS_REFERENCE, Conclusion.OPEN)
        if self.verdict is None or self.conclusion not in undecided:
            return ()
        had = {one.channel for one in self.standards}
        return tuple(
            channel
            for channel in readable_standards(self.config)
            if channel not in had and set(ERRORS_OF[channel]) & set(self.doubted)
        )

    def take_standards(
        self, channels: Sequence[str], read: Sequence[StandardReading], record: Path
    ) -> None:
        """Take in what the instruments read of standards, and diagnose the tests with it."""
        between = " or ".join(n for n in self.doubted if any(n in ERRORS_OF[c] for c in channels))
        self.standards += read
        self.search = None  # no test is new: none is to be predicted
        self._diagnose()
        run = open_run(record)
        why = f"to see whether there is {between}"
        self.rounds.append(
            Round(
                "reference standards", why, run.run_id, "clean", _minutes(run), *self._known()
            )
        )  # fmt: skip

    def _known(self) -> tuple[str, tuple[str, ...], str]:
        """Status, entries and conclusion of the last diagnosis, for a round."""
        assert self.verdict is not None
        ids = tuple(" + ".join(effect.ids) for effect in self.verdict.effects)
        return self.verdict.status, ids, conclusion_text(self)

    def _diagnose(self) -> dict[str, Any] | None:
        """Diagnose all runs; how what was found before fared on the last of them."""
        before, known, entries = self.search, self.problem, self._entry_ids
        name = f"data-{len(self.runs):02d}"
        if self.standards:
            name += "-" + "-".join(dict.fromkeys(one.channel for one in self.standards))
        data = joined(self.runs, self.folder / name, self.plant, self.standards)
        self.verdict, self.problem, self.search = diagnose_without_term(data)
        self._margins = None
        self.relieving = {}
        if self.problem is not None and self.verdict.status == Status.NO_GAP_ABOVE_FLOOR:
            self.relieving = relieving(self.problem)
        if before is None or known is None or not before.best.keys or self.problem is None:
            return None
        fit = before.best.fit
        new = _trials_of(self.problem, self.runs[-1])
        found = predict_trials(self.problem, new, fit, rivals_of(known, before, entries))
        if not found.shown:
            return None
        self.predicted.setdefault(joint(families(fit.ids)), []).append(
            (self.tests[-1].protocol, found)
        )
        return {
            "by": list(fit.ids), "share": found.share, "confirmed": found.confirmed,
            "rows": found.rows, "without": found.without, "left": found.left,
            "rivals": {" + ".join(ids): left for ids, left in found.rivals.items()},
        }  # fmt: skip

    def concluded(self, stopped: bool) -> Investigation:
        """The outcome, also written to the investigation's folder.

        A stop does not wait for what the gap looks like; `pamrig diagnose` of the data tells it.
        """
        if not self.runs:
            raise PamrigError(self.config.source, "no test was run to its end", "begin again")
        if self.verdict is None:
            self._diagnose()
        found = self._written()
        if stopped or self.problem is None or self.search is None:
            return found
        # Not after each test: nothing asks for it there, and it takes as long as all else.
        self.verdict = with_empirical_term(found.verdict, self.problem, self.search)
        return self._written()

    def _written(self) -> Investigation:
        """The outcome as it is known now, written to the investigation's folder."""
        assert self.verdict is not None
        found = Investigation(
            self.conclusion, conclusion_text(self), self.named, self.verdict, tuple(self.rounds),
            self.references, self.folder, self.ended,
        )  # fmt: skip
        text = json.dumps(found.as_dict(), indent=2, allow_nan=False)
        (self.folder / "investigation.json").write_text(text + "\n", encoding="utf-8")
        return found


def _minutes(run: Run) -> float:
    return float((run.final or {}).get("duration_s") or 0.0) / 60.0


def _trials_of(problem: FitProblem, run: Run) -> list[int]:
    return [
        k for k, trial in enumerate(problem.data.trials) if trial.name.startswith(f"{run.run_id}:")
    ]


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


def joined(
    runs: list[Run], folder: Path, plant: Path | None, standards: Sequence[StandardReading] = ()
) -> DataSet:
    """All runs so far as one data set, with what standards showed, written to `folder`."""
    export_runs(runs, folder, plant=plant, commands_of=VALVE_TESTS, standards=standards)
    return dataclasses.replace(read_dataset(folder), origin=str(folder))
