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
from typing import Any

from daq.errors import PamrigError
from daq.run import Run, open_run
from gap.dataset import DataSet
from gap.diagnose import diagnose
from gap.from_runs import export_runs
from gap.reader import read_dataset
from gap.reporttext import headline
from gap.verdict import Verdict
from plant.catalogue import CATALOGUE
from rigs.config import RigConfig
from rigs.interrupt import StopFlag
from rigs.protocols.registry import procedure
from rigs.session import run_protocol

SETTLED = ("named", "named_form_inadequate", "data_unfit")
BATTERY = ("isometric", "isotonic", "isobaric")
"""Tests in the order in which they are run when nothing is advised: what each shows first is muscle
and sensors at rest; load and camera; a length that moves."""
REPEATS = 3
Told = Callable[[str], None]


@dataclass(frozen=True)
class Round:
    """One test and what was known after it."""

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
    budget_min: float = 30.0,
    plant: Path | None = None,
    stop: StopFlag | None = None,
    tell: Told = lambda text: None,
) -> Investigation:
    """Run tests on a rig until the gap is named, or nothing more can be had for the budget.

    Args:
        config: the rig.
        out: folder of runs; protocol files and the joint data set go to `investigation` in it.
        budget_min: bench time; no test is begun once it is used up.
        plant: what is known of the bench's plant, as bench.toml states it.
        stop: set from outside to end in good order.
        tell: takes a line after each step.

    Raises:
        PamrigError: a test could not be run at all, or its data cannot be used.
    """
    folder = out / "investigation"
    folder.mkdir(parents=True, exist_ok=True)
    runs: list[Run] = []
    rounds: list[Round] = []
    done: list[str] = []
    verdict: Verdict | None = None
    used_min = 0.0
    while True:
        step = _next(verdict, done)
        if step is None or (runs and used_min >= budget_min):
            break
        name, settings, why = step
        done.append(name)
        tell(f"round {len(rounds) + 1}: {name} ({why})")
        path = folder / f"{len(rounds) + 1:02d}-{name}.toml"
        path.write_text(protocol_text(name, config, settings), encoding="utf-8")
        kind = procedure(name)
        result = run_protocol(kind, config, kind.read(str(path), config), out, stop=stop)
        run = open_run(result.folder)
        if result.outcome != "clean":
            raise PamrigError(
                str(result.folder), f"the test ended {result.outcome}: {result.error}",
                "find the cause and begin again; what was recorded is safe",
            )  # fmt: skip
        minutes = float((run.final or {}).get("duration_s") or 0.0) / 60.0
        used_min += minutes
        runs.append(run)
        data = joined(runs, folder / f"data-{len(runs):02d}", plant)
        verdict = diagnose(data)
        ids = tuple(" + ".join(effect.ids) for effect in verdict.effects)
        rounds.append(
            Round(name, why, run.run_id, result.outcome, minutes, verdict.status, ids,
                  headline(verdict))
        )  # fmt: skip
        tell(f"  {rounds[-1].headline}")
        if verdict.status in SETTLED:
            break
    assert verdict is not None
    found = Investigation(
        _conclusion(verdict), verdict, tuple(rounds), _references(verdict), folder
    )
    text = json.dumps(found.as_dict(), indent=2, allow_nan=False)
    (folder / "investigation.json").write_text(text + "\n", encoding="utf-8")
    return found


def joined(runs: list[Run], folder: Path, plant: Path | None) -> DataSet:
    """All runs so far as one data set, written to `folder`."""
    export_runs(runs, folder, plant=plant)
    return dataclasses.replace(read_dataset(folder), origin=str(folder))


def _next(verdict: Verdict | None, done: list[str]) -> tuple[str, dict[str, Any], str] | None:
    """Name and settings of the next test and why it is run; None when there is none left."""
    if verdict is not None and verdict.next_experiment is not None:
        advised = verdict.next_experiment
        if advised.protocol in BATTERY and advised.trials > 0 and done.count(advised.protocol) < 2:
            between = " and ".join(advised.between)
            why = "advised" + (f", to tell {between} apart" if between else "")
            return advised.protocol, dict(advised.settings), why
    for name in BATTERY:
        if name not in done:
            return name, {}, "nothing so far has shown what it shows" if done else "to begin with"
    return None


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
    return {name: CATALOGUE[name].told_apart_by for name in names}


def protocol_text(name: str, config: RigConfig, settings: Mapping[str, Any]) -> str:
    """A protocol file of that test for this rig, with `settings` over the usual ones."""
    values: dict[str, Any] = {**_usual(name, config)}
    values |= {key: value for key, value in settings.items() if key in values}
    lines = [f'protocol = "{name}"', f'name = "investigate-{name}"', 'order = "up-down"']
    lines += [f"{key} = {json.dumps(value)}" for key, value in values.items()]
    if name in ("isometric", "isobaric"):
        lines.append(f"slack_length_mm = {config.limits.length_min_mm + 3.0:.1f}")
    lines.append('mountings = ["m1"]')
    force = "drift_mm = 0.03" if name == "isotonic" else "drift_n = 0.05"
    top = 0.6 * config.limits.pressure_kpa
    lines += [
        "[precondition]", "cycles = 2", f"pressure_kpa = {top:.0f}", "dwell_s = 0.5",
        "[settle]", "window_s = 0.5", "pressure_kpa = 1.5", "drift_kpa = 0.5", force,
        "timeout_s = 6.0", "[measure]", "seconds = 0.5", "frames = 1", "zero_s = 0.4",
    ]  # fmt: skip
    return "\n".join(lines) + "\n"


def _usual(name: str, config: RigConfig) -> dict[str, Any]:
    """Settings that cover this rig's range, with replicates enough for a floor."""
    limits = config.limits
    span = limits.length_max_mm - limits.length_min_mm
    top = 0.9 * limits.pressure_kpa
    pressures = [round(share * top, -1) for share in (0.1, 0.3, 0.5, 0.75, 1.0)]
    lengths = [round(limits.length_min_mm + share * span, 1) for share in (0.12, 0.45, 0.75)]
    match name:
        case "isometric":
            return {"lengths_mm": lengths, "pressures_kpa": pressures, "repeats": REPEATS}
        case "isobaric":
            more = [round(limits.length_min_mm + s * span, 1) for s in (0.15, 0.35, 0.55, 0.75)]
            levels = [pressures[1], pressures[3]]
            return {"pressures_kpa": levels, "lengths_mm": more, "repeats": REPEATS}
    heaviest = 0.15 * limits.force_n / config.conditions.gravity_m_s2
    masses = [round(share * heaviest, 2) for share in (0.4, 1.0)]
    return {"masses_kg": masses, "pressures_kpa": pressures[1:], "repeats": REPEATS}
