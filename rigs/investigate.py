"""Closes the loop: run a test, diagnose, run what the diagnosis asks for, until it is named.

Top floor: here a rig and a diagnosis meet. Each round records an ordinary run; all runs so far are
diagnosed together. What to run next is what the diagnosis advises, where this rig can run it, and
otherwise the next test that shows something no test so far has shown. Each test is a trial of what
the tests before it were explained by: an explanation that foretells it, as no other does, may be
named though the diagnosis alone, which sees no order in its data, would not go so far.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from daq.errors import PamrigError
from daq.run import Run, open_run
from gap.advise import reference_for
from gap.dataset import DataSet
from gap.diagnose import searched
from gap.errors import GapError
from gap.from_runs import export_runs, stated_plant
from gap.inquiry import Inquiry
from gap.naming import Naming
from gap.prediction import Foretelling, foretell, gains
from gap.reader import read_dataset
from gap.reporttext import headline, sentence
from gap.verdict import Verdict
from plant.catalogue import CATALOGUE
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
LIKELY = 0.7
"""Belief in one family from which it is put to the proof before anything else is looked at."""
FAILED = 2
"""Tests that did not come out as foretold after which no more are made for that."""
MOST_RIVALS = 4
"""Other explanations that a new test is held against."""
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
    foretold: Mapping[str, Any] | None = None
    """How what was found before fared on this test, where the test shows it."""


@dataclass(frozen=True)
class Investigation:
    """What came of it: the last verdict, how it was reached, and what is still needed.

    `conclusion` is "named", "needs reference", "no gap" or "open", and `why` says it in a sentence.
    `family` is what was named: a family of the catalogue, or several that act together.
    """

    conclusion: str
    why: str
    family: str | None
    verdict: Verdict
    rounds: tuple[Round, ...]
    references: Mapping[str, str]
    folder: Path

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
    begun = _Begun(config, folder, plant)
    left, again = battery(config), battery(config, again=True)
    used_min = 0.0
    while used_min < budget_min and not stop.reason:
        chosen = begun.next(left, again)
        if chosen is None:
            break
        test, why = chosen
        name = test.protocol
        tell(f"round {len(begun.rounds) + 1}: {name}, {test.what} ({why})")
        path = folder / f"{len(begun.rounds) + 1:02d}-{name}.toml"
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
        begun.take(test, why, run, result.outcome)
        used_min += begun.rounds[-1].minutes
        tell(f"  {begun.rounds[-1].headline}")
        if begun.settled:
            break
    return begun.concluded()


@dataclass
class _Begun:
    """An investigation under way: the tests so far, and what is known after them."""

    config: RigConfig
    folder: Path
    plant: Path | None
    runs: list[Run] = field(default_factory=list)
    tests: list[Test] = field(default_factory=list)
    rounds: list[Round] = field(default_factory=list)
    verdict: Verdict | None = None
    inquiry: Inquiry | None = None
    naming: Naming | None = None
    foretold: dict[str, list[tuple[str, Foretelling]]] = field(default_factory=dict)
    """By family, tests that show what was found before them, and how it fared on each."""

    def next(self, left: list[Test], again: list[Test]) -> tuple[Test, str] | None:
        """The next test, taken from those left or to be made again, and why; None at the end."""
        verdict = self.verdict
        if self._likely or self._of_valves_alone(left):
            telling = self._telling(again)
            if telling is not None:
                return telling
        if verdict is not None and verdict.next_experiment is not None:
            advised = verdict.next_experiment
            for tests in (left, again):
                for test in tests:
                    if test.answers(advised.protocol, advised.why):
                        tests.remove(test)
                        between = " and ".join(advised.between)
                        return test, "advised" + (f", to tell {between} apart" if between else "")
        if left:
            why = "to begin with" if verdict is None else "nothing so far has shown what it shows"
            return left.pop(0), why
        return self._telling(again)

    @property
    def _likely(self) -> bool:
        """Whether one family is left, all but named, and no test has put it to the proof yet."""
        if self.family is None or self.family in self.foretold or self.verdict is None:
            return False
        belief = self.verdict.evidence.get("belief", {})
        return float(belief.get("right", 0.0) + belief.get("part", 0.0)) >= LIKELY

    def _of_valves_alone(self, left: list[Test]) -> bool:
        """Whether what was found shows where valves act, and no test left looks there."""
        if self.naming is None or any(test.protocol in VALVE_TESTS for test in left):
            return False
        blocks = {b for suspect in self.naming.chosen.state.suspects for b in suspect.blocks}
        return blocks == {"pressure"}

    def _telling(self, again: list[Test]) -> tuple[Test, str] | None:
        """The test that shows most of what is all but named, to be made again, and why."""
        if self.naming is None or self.inquiry is None or self.family is None:
            return None
        if sum(not found.confirmed for _, found in self.foretold.get(self.family, [])) >= FAILED:
            return None
        taken = gains(self.inquiry, self.naming.chosen.state)
        best: tuple[float, Test | None] = (0.0, None)
        for run, made in zip(self.runs, self.tests, strict=True):
            here = sum(float(taken[trial]) for trial in _trials_of(self.inquiry, run))
            for test in again:
                if test.what == made.what and here > best[0]:
                    best = (here, test)
        telling = best[1]
        if telling is None:
            return None
        again.remove(telling)
        names = " and ".join(self.naming.chosen.state.ids)
        return telling, f"at other settings, to see whether {names} foretells it"

    def take(self, test: Test, why: str, run: Run, outcome: str) -> None:
        """Join a run to those before it and diagnose all of them."""
        self.runs.append(run)
        self.tests.append(test)
        minutes = float((run.final or {}).get("duration_s") or 0.0) / 60.0
        known: tuple[str, tuple[str, ...], str] = ("", (), "the survey is not whole yet")
        told: dict[str, Any] | None = None
        if len(self.runs) >= BEFORE_NAMING:
            told = self._diagnose()
            assert self.verdict is not None
            ids = tuple(" + ".join(effect.ids) for effect in self.verdict.effects)
            known = (self.verdict.status, ids, self.why)
        self.rounds.append(
            Round(test.protocol, why, run.run_id, outcome, minutes, *known, foretold=told)
        )

    def _diagnose(self) -> dict[str, Any] | None:
        """Diagnose all runs; how what was found before fared on the last of them."""
        before = self.naming
        data = joined(self.runs, self.folder / f"data-{len(self.runs):02d}", self.plant)
        self.verdict, self.inquiry, self.naming = searched(data)
        if before is None or not before.chosen.keys or self.inquiry is None:
            return None
        state = before.chosen.state
        families = _families(state.ids)
        rivals = [c.state for c in before.rivals if not families & _families(c.state.ids)]
        found = foretell(
            self.inquiry, _trials_of(self.inquiry, self.runs[-1]), state, rivals[:MOST_RIVALS]
        )
        if not found.shown:
            return None
        protocol = self.tests[-1].protocol
        self.foretold.setdefault("+".join(families), []).append((protocol, found))
        return {
            "by": list(state.ids), "share": found.share, "confirmed": found.confirmed,
            "rows": found.rows, "without": found.without, "left": found.left,
            "rivals": {" + ".join(ids): left for ids, left in found.rivals.items()},
        }  # fmt: skip

    @property
    def family(self) -> str | None:
        """The one family that is in all entries left, where the diagnosis stops short of a name.

        None where there are several.
        """
        if self.verdict is None or self.verdict.status not in ("indistinguishable", "mimicable"):
            return None
        left = [_families(effect.ids) for effect in self.verdict.effects]
        common = frozenset.intersection(*left) if left else frozenset()
        return next(iter(common)) if len(common) == 1 else None

    @property
    def confirmed(self) -> tuple[str, Foretelling] | None:
        """The test that came out as the explanation foretold, if no later one spoke against it."""
        for protocol, found in reversed(self.foretold.get(self.family or "", [])):
            if found.confirmed:
                return protocol, found
            if found.refuted:
                break
        return None

    @property
    def settled(self) -> bool:
        """Whether there is nothing more to find out."""
        if self.verdict is None:
            return False
        return self.verdict.status in SETTLED or self.confirmed is not None

    @property
    def conclusion(self) -> str:
        """What a lab is told, in a word or two."""
        assert self.verdict is not None
        status = self.verdict.status
        if status in ("named", "named_form_inadequate") or self.confirmed is not None:
            return "named"
        if status in ("indistinguishable", "mimicable") and len(self._entries) > 1:
            return "needs reference"
        return "no gap" if status == "no_gap_above_floor" else "open"

    @property
    def _entries(self) -> set[str]:
        """Families, or pairs of them, of the entries left."""
        return {effect.family for effect in self.verdict.effects} if self.verdict else set()

    @property
    def why(self) -> str:
        """The same in a sentence."""
        assert self.verdict is not None
        if self.confirmed is None:
            return headline(self.verdict)
        protocol, found = self.confirmed
        ids = [" + ".join(effect.ids) for effect in self.verdict.effects]
        return sentence(
            f"It is {' or '.join(ids)}, found on the tests before and confirmed by the {protocol} "
            f"test, of whose gap it foretold {100 * found.share:.0f} % and no other explanation "
            "as much"
        )

    def concluded(self) -> Investigation:
        """The outcome, also written to the investigation's folder."""
        if not self.runs:
            raise PamrigError(self.config.source, "no test was run to its end", "begin again")
        if self.verdict is None:
            self._diagnose()
        assert self.verdict is not None
        named = None
        if self.conclusion == "named":
            named = self.family if self.confirmed else self.verdict.effects[0].family
        found = Investigation(
            self.conclusion, self.why, named, self.verdict, tuple(self.rounds), self.references,
            self.folder,
        )  # fmt: skip
        text = json.dumps(found.as_dict(), indent=2, allow_nan=False)
        (self.folder / "investigation.json").write_text(text + "\n", encoding="utf-8")
        return found

    @property
    def references(self) -> dict[str, str]:
        """What would tell the entries left apart, or prove the only one, where no test did."""
        assert self.verdict is not None
        names = dict.fromkeys(name for effect in self.verdict.effects for name in effect.ids)
        proven = self.confirmed is not None and len(names) == 1
        if self.verdict.status not in ("indistinguishable", "mimicable") or proven:
            return {}
        return {name: reference_for(name) for name in names}


def _trials_of(q: Inquiry, run: Run) -> list[int]:
    return [k for k, trial in enumerate(q.data.trials) if trial.name.startswith(f"{run.run_id}:")]


def _families(ids: tuple[str, ...]) -> frozenset[str]:
    return frozenset(CATALOGUE[name].family for name in ids)


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
