"""`python -m tests.advice_campaign`: does an advised experiment separate as it promised?

Practice sets of the blind bench with one effect are searched; where the truth is among the two best
explanations, the experiment that would tell them apart is asked for. The blind bench then runs it:
its trials are added to the set, with the same hidden effect and the same noise, and both
explanations are fitted anew. The drop in the whitened sum of squares from the wrong to the right
one is d' squared, achieved; beside it stands what was predicted. The journal takes one line a set.

    python -m tests.advice_campaign --sets 300-479
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from blind.exchange import write
from blind.physics.bench import Trial as BlindTrial
from blind.recording import record
from blind.sets import BlindSet, blind_set
from gap.check.scoring.statistics import share
from gap.data.reader import read_dataset
from gap.data.trial import Trial
from gap.design.advise import advise
from gap.design.config import DESIGN
from gap.design.foresight import products, separation
from gap.design.library import LibraryExperiment, library_experiments
from gap.estimation.fit_problem import FitProblem, FitResult
from gap.selection.search import search_effects

Row = dict[str, Any]


def on_the_blind_bench(trial: Trial, at: int, mounting: int) -> BlindTrial:
    """An advised trial as the blind bench runs it: its courses as prescribed, not its answers."""

    def course(name: str) -> Any:
        channel = trial.channels[name]
        return channel.time_s, channel.value

    seconds = float(max(c.time_s[-1] for c in trial.channels.values()))
    valves = "inlet_cmd" in trial.channels
    hung = bool(np.isfinite(trial.load_kg))
    moves = "length_mm" in trial.channels and not hung
    edges = [
        (t, side, value)
        for side, name in enumerate(("inlet_cmd", "outlet_cmd"))
        if valves
        for t, value in zip(*course(name), strict=True)
        if t > 0.0
    ]
    fields: dict[str, Any] = {
        "pressure_hz": 500.0 if valves else 20.0, "force_hz": 80.0 if valves else 10.0,
        "camera_hz": 10.0 if hung or moves else 0.0,
    }  # fmt: skip
    if valves:
        fields["edges"] = np.array(sorted(edges), dtype=float)
    else:
        t, p = course("pressure_kpa")
        fields |= {"regulator": (t, np.maximum(p, 0.0)), "regulator_s": 0.05}
    if hung:
        fields["load_kg"] = trial.load_kg
    elif moves:
        fields["length"] = course("length_mm")
    else:
        fields["held_mm"] = trial.held_length_mm
    if np.isfinite(trial.temperature_c):
        fields["temperature_c"] = trial.temperature_c
    return BlindTrial(
        f"advised{at}", f"advised-{trial.slot}", trial.protocol, at, mounting, 1000 + at, seconds,
        **fields,
    )  # fmt: skip


def with_advised(one: BlindSet, option: LibraryExperiment, repeats: int) -> BlindSet:
    """The set with an experiment's trials made after its own."""
    more = [
        on_the_blind_bench(trial, k * len(option.trials) + j, 0)
        for k in range(repeats)
        for j, trial in enumerate(option.trials)
    ]
    design = replace(one.design, trials=(*one.design.trials, *more))
    return replace(one, design=design)


def refitted(problem: FitProblem, fit: FitResult, names: Sequence[str]) -> FitResult:
    """The best fit of an explanation to other data, shape by shape.

    It starts where the fit of constants `names` to less data ended, too: from the stated constants
    a descent may end far off, and its cost would pass for a separation.
    """
    own = {s.key for s in fit.candidates}
    known = dict(zip(names, fit.shift.tolist(), strict=True))
    shift = np.array([known.get(name, 0.0) for name in problem.names])
    ends = [problem.fit_from(shift, fit.candidates, fit.amounts.tolist())]
    for candidate in (s for s in problem.candidates if s.key in own):
        ends += [problem.fit_afresh([candidate], [candidate.step])]
        ends += [problem.fit_from(shift, [candidate], [candidate.step])]
    return min((problem.polish(end) for end in ends), key=lambda f: f.cost)


def achieved(wrong: FitResult, right: FitResult) -> float:
    """d' as it came out; below 0 where the wrong one fits better."""
    drop = wrong.cost - right.cost
    return float(np.sign(drop) * np.sqrt(abs(drop)))


def one(number: int, folder: Path) -> Row | None:
    """Ask for advice on a set, have it followed, compare; None where there is nothing to ask."""
    begun = time.process_time()
    hidden = blind_set("practice", number, small=True)
    if hidden.kind != "single" or any(t.settled_s is not None for t in hidden.design.trials):
        return None
    write(record(hidden), folder / "set")
    problem = FitProblem.of(read_dataset(folder / "set"))
    search = search_effects(problem)
    pair = [search.best, *search.rivals[:1]]
    truth = hidden.hidden[0].id
    at = [k for k, hypothesis in enumerate(pair) if hypothesis.fit.ids == (truth,)]
    if len(pair) < 2 or not at or len(pair[1 - at[0]].fit.candidates) != 1:
        return None
    right, wrong = pair[at[0]].fit, pair[1 - at[0]].fit
    now = separation(products(problem, right, wrong), right, wrong)
    if now > 2.0 * DESIGN.enough_sd:
        return None
    row: Row = {
        "number": number,
        "truth": truth,
        "rival": wrong.ids[0],
        "now": now,
        "now_achieved": achieved(
            refitted(problem, wrong, problem.names), refitted(problem, right, problem.names)
        ),
    }
    advised = advise(problem, right, [wrong])
    row["protocol"] = advised.protocol if advised is not None else None
    if advised is None or advised.protocol == "reference" or "like_slot" in advised.settings:
        return row
    repeats = int(advised.settings["repeats"])
    wanted = {**advised.settings, "repeats": 0}
    best = next(
        c for c in library_experiments(problem, right)
        if {**c.settings, "repeats": 0} == wanted and c.protocol == advised.protocol
    )  # fmt: skip
    write(record(with_advised(hidden, best, repeats)), folder / "more")
    more = FitProblem.of(read_dataset(folder / "more"))
    return row | {
        "what": best.what,
        "repeats": repeats,
        "predicted": advised.separation_after,
        "achieved": achieved(
            refitted(more, wrong, problem.names), refitted(more, right, problem.names)
        ),
        "cpu_s": round(time.process_time() - begun, 1),
    }


def told(rows: Sequence[Row]) -> list[str]:
    """What came of it, in lines."""
    tried = [r for r in rows if r.get("achieved") is not None]
    if not tried:
        return [f"{len(rows)} pairs, no experiment was advised"]
    ratio = np.array([r["achieved"] / r["predicted"] for r in tried])
    low, middle, high = np.quantile(ratio, [0.1, 0.5, 0.9])
    lines = [
        f"{len(rows)} pairs, {len(tried)} with an experiment advised",
        f"achieved over predicted: median {middle:.2f}, 80 % between {low:.2f} and {high:.2f}",
    ]
    for name, flags in (
        ("within 25 %", np.abs(ratio - 1.0) <= 0.25),
        ("right one preferred before", [r["now_achieved"] > 0.0 for r in tried]),
        ("right one preferred after", [r["achieved"] > 0.0 for r in tried]),
        (
            f"achieved {DESIGN.enough_sd} or more",
            [r["achieved"] >= DESIGN.enough_sd for r in tried],
        ),
    ):
        found = share([bool(flag) for flag in flags])
        a, b = found.interval
        lines.append(f"{name}: {found.hits}/{found.of} [{100 * a:.0f}, {100 * b:.0f}] %")
    return lines


def main() -> int:
    """Ask for the sets that the journal does not hold yet."""
    parser = argparse.ArgumentParser(prog="python -m tests.advice_campaign", description=__doc__)
    parser.add_argument("--sets", default="300-479")
    parser.add_argument("--journal", type=Path, default=Path("out/advice.jsonl"))
    args = parser.parse_args()
    args.journal.parent.mkdir(parents=True, exist_ok=True)
    rows: dict[int, Row | None] = {}
    if args.journal.exists():
        for text in args.journal.read_text(encoding="utf-8").splitlines():
            line = json.loads(text)
            rows[line["number"]] = line if "truth" in line else None
    first, _, last = args.sets.partition("-")
    numbers = range(int(first), int(last or first) + 1)
    for number in numbers:
        if number in rows:
            continue
        with tempfile.TemporaryDirectory() as scratch:
            row = one(number, Path(scratch))
        rows[number] = row
        with args.journal.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row or {"number": number}) + "\n")
        if row is not None:
            print(json.dumps(row), flush=True)
    print("\n".join(told([r for n in numbers if (r := rows.get(n)) is not None])))
    return 0


if __name__ == "__main__":
    sys.exit(main())
