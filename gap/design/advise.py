"""What to measure next: the experiment, or the reference standard, that separates the rivals left.

Every experiment of the library (`gap.design.library`), of a kind that the data hold or not, is
foreseen (`gap.design.foresight`): how far it would move the best explanation and its nearest rival
apart. The one that gets there in the least bench time is advised; where no number of trials on
this bench would do, a reference standard is named instead.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Any

import numpy as np

from gap.design.config import DESIGN
from gap.design.foresight import Products, by_trial, on_experiment, products, separation, sum_of
from gap.design.library import LibraryExperiment, library_experiments
from gap.errors import GapError
from gap.estimation.fit_problem import FitProblem, FitResult
from gap.output import toml_value
from gap.verdict import Experiment
from plant.effects.catalogue import CATALOGUE
from plant.effects.standards import Standard
from plant.errors import PlantError

REFERENCES: dict[str, tuple[Standard, float]] = {
    effect.id: effect.reference for effect in CATALOGUE.values() if effect.reference is not None
}
"""For an effect its standard, and how well that gives the headline parameter (one sd, its unit)."""


@dataclass(frozen=True)
class _Plan:
    """An experiment with as many repeats as it needs, and where that leads."""

    option: LibraryExperiment
    repeats: int
    after: float

    @property
    def minutes(self) -> float:
        """Bench time with what it takes to begin a run."""
        return DESIGN.begin_min + self.repeats * self.option.minutes


def advise(
    problem: FitProblem, best: FitResult | None, rivals: Sequence[FitResult]
) -> Experiment | None:
    """Return the experiment that best separates `best` from its nearest rival."""
    if best is None or not best.candidates or not rivals:
        return None
    found = [by_trial(problem, best, rival) for rival in rivals]
    apart = [separation(sum_of(f), best, r) for f, r in zip(found, rivals, strict=True)]
    nearest = int(np.argmin(apart))
    rival, now = rivals[nearest], apart[nearest]
    present = sum_of(found[nearest])
    between = ("+".join(best.ids), "+".join(rival.ids))
    # Where forms that are never exact have kept two apart in name only, it takes an experiment
    # that would be enough by itself.
    enough = DESIGN.enough_sd
    if now >= enough:
        enough = float(np.hypot(now, enough))
    plans = [
        plan
        for plan in (
            _plan(problem, best, rival, c, present, enough) for c in _library(problem, best)
        )
        if plan is not None
    ]
    reference = _reference(best, rival, present, enough, now, between)
    if reference is not None and reference[0] < min((p.minutes for p in plans), default=np.inf):
        return reference[1]
    if plans:
        plan = min(plans, key=lambda p: p.minutes)
        return Experiment(
            plan.option.protocol,
            {**plan.option.settings, "repeats": plan.repeats},
            now, plan.after, plan.repeats * len(plan.option.trials), between,
            f"{plan.option.what}: tells {between[0]} from {between[1]} in about "
            f"{max(plan.minutes, 1.0):.0f} min",
        )  # fmt: skip
    again = _same_again(problem, best, rival, found[nearest], present, enough, now, between)
    return again if again is not None else _standard(best, between, now)


def more_replicates(problem: FitProblem, needed: int) -> Experiment:
    """The settings that were measured once more, as often as the noise needs to be known.

    Args:
        needed: replicates beyond the first, over all slots.
    """
    slots = problem.data.slots
    first = problem.data.trials[0]
    missing = max(needed - problem.noise.freedom, 1)
    repeats = 1 + -(-missing // len(slots))
    return Experiment(
        first.protocol, {"repeats": repeats}, float("nan"), float("nan"),
        (repeats - 1) * len(slots), (),
        "replicates are missing: without them nobody knows what runs of one setting differ by; "
        "measure each setting again, best in another order and mounting",
    )  # fmt: skip


def _library(problem: FitProblem, best: FitResult) -> list[LibraryExperiment]:
    """The library, or nothing where the plant as known cannot be simulated."""
    try:
        return library_experiments(problem, best)
    except PlantError:
        return []


def _plan(
    problem: FitProblem,
    best: FitResult,
    rival: FitResult,
    option: LibraryExperiment,
    present: Products,
    enough: float,
) -> _Plan | None:
    """Repeats that an experiment needs; None where it would take too many.

    None as well where the simulator in the place of the plant says nothing of such trials: a table
    of predictions holds the trials that were made, and a surface has an edge.
    """
    try:
        one = products(on_experiment(problem, option), best, rival)
    except GapError:
        return None
    for repeats in range(DESIGN.least_repeats, DESIGN.most_trials // len(option.trials) + 1):
        after = separation(present + one.times(repeats), best, rival)
        if after >= enough:
            return _Plan(option, repeats, after)
    return None


def _same_again(
    problem: FitProblem,
    best: FitResult,
    rival: FitResult,
    parts: Sequence[Products],
    present: Products,
    enough: float,
    now: float,
    between: tuple[str, str],
) -> Experiment | None:
    """More trials of the slot that separates best, where that does; else None."""
    found: tuple[int, float, int] | None = None
    for slot, members in enumerate(problem.data.slots.values()):
        one = sum_of([parts[t] for t in members]).times(1)
        for rounds in range(1, DESIGN.most_trials // len(members) + 1):
            after = separation(present + one.times(rounds), best, rival)
            if after >= enough:
                count = rounds * len(members)
                if found is None or count < found[0]:
                    found = (count, after, slot)
                break
    if found is None:
        return None
    count, after, slot = found
    name = list(problem.data.slots)[slot]
    trial = problem.data.trials[problem.data.slots[name][0]]
    settings: dict[str, Any] = {"like_slot": name, "repeats": count}
    for key, value in (("held_length_mm", trial.held_length_mm), ("load_kg", trial.load_kg)):
        if np.isfinite(value):
            settings[key] = value
    return Experiment(
        trial.protocol, settings, now, after, count, between,
        f"trials like slot {name} tell {between[0]} from {between[1]} best",
    )  # fmt: skip


def _reference(
    best: FitResult, rival: FitResult, present: Products, enough: float, now: float,
    between: tuple[str, str],
) -> tuple[float, Experiment] | None:  # fmt: skip
    """Quickest standard that tells the two apart, with its minutes; None where none does."""
    found: list[tuple[float, float, Standard, str]] = []
    for name in dict.fromkeys([*best.ids, *rival.ids]):
        if name not in REFERENCES:
            continue
        standard, error = REFERENCES[name]
        after = separation(present + _measured(best, rival, name, error), best, rival)
        if after >= enough:
            found.append((standard.minutes, after, standard, name))
    if not found:
        return None
    minutes, after, standard, name = min(found, key=lambda f: f[0])
    why = f"{standard.what}: gives {name} by itself, whatever the muscle does"
    settings = {"standard": standard.name, "procedure": standard.what}
    return minutes, Experiment("reference", settings, now, after, 1, between, why)


def _measured(best: FitResult, rival: FitResult, name: str, error: float) -> Products:
    """What a direct measurement of one effect's amount adds."""
    n = len(rival.shift)
    column = np.r_[np.zeros(n), [float(s.id == name) for s in rival.candidates]] / error
    apart = (_amount(rival, name) - _amount(best, name)) / error
    return Products(apart**2, apart * column, np.outer(column, column))


def _amount(fit: FitResult, name: str) -> float:
    return float(sum(a for s, a in zip(fit.candidates, fit.amounts, strict=True) if s.id == name))


def _standard(best: FitResult, between: tuple[str, str], now: float) -> Experiment:
    """The catalogue's own advice for the best entry, where no separation can be computed."""
    name = next((n for n in best.ids if n in REFERENCES), best.ids[0])
    advice = CATALOGUE[name].told_apart_by if name in CATALOGUE else ""
    standard = REFERENCES[name][0] if name in REFERENCES else None
    settings = {
        "standard": standard.name if standard else "see why",
        "procedure": standard.what if standard else advice,
    }
    return Experiment("reference", settings, now, now, 1, between, advice)


def reference_for(name: str) -> str:
    """What gives an effect by itself: a standard, or the advice of the catalogue."""
    if name in REFERENCES:
        standard = REFERENCES[name][0]
        return f"{standard.name}: {standard.what}"
    return CATALOGUE[name].told_apart_by


def protocol_text(experiment: Experiment) -> str | None:
    """A protocol file for the experiment, after the shipped one of its name; None without one."""
    folder = resources.files("configs").joinpath("protocols")
    source = folder.joinpath(f"{experiment.protocol}.toml")
    if not source.is_file():
        return None
    table = tomllib.loads(source.read_text(encoding="utf-8"))
    table["name"] = f"advised-{experiment.protocol}"
    for key, value in experiment.settings.items():
        if key == "held_length_mm" and "lengths_mm" in table:
            table["lengths_mm"] = [value]
        elif key == "load_kg" and "masses_kg" in table:
            table["masses_kg"] = [value]
        elif value is None:
            table.pop(key, None)
        elif isinstance(value, Mapping):
            table[key] = {**table.get(key, {}), **value}
        elif key in table:
            table[key] = value
    lines = [
        f"# Advised: {experiment.why}.",
        f"# {experiment.trials} trials; separation {experiment.separation_now:.1f} now, "
        f"{experiment.separation_after:.1f} afterwards.",
        f"# {DESIGN.enough_sd:g} is right 95 times in 100, if the forms of the catalogue are.",
    ]
    lines += [f"{k} = {toml_value(v)}" for k, v in table.items() if not isinstance(v, dict)]
    for key, value in table.items():
        if isinstance(value, dict):
            lines += ["", f"[{key}]", *(f"{k} = {toml_value(v)}" for k, v in value.items())]
    return "\n".join(lines) + "\n"
