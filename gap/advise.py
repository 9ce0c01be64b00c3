"""What to measure next: the trials, or the reference standard, that separate the rivals left.

Two rivals are separated by d' = norm of the difference of their predictions in units of noise,
once the second has been refitted to look like the first; the right one is then preferred with
probability Phi(d'/2), so 3.3 is enough for 95 %. What each slot of the present data adds to d'
says what more trials like it would add. Where no number of trials on this bench would do, a
reference standard is named instead.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources

import numpy as np
import numpy.typing as npt

from gap.inquiry import Inquiry, State
from gap.verdict import Experiment
from plant.catalogue import CATALOGUE

Array = npt.NDArray[np.float64]

ENOUGH = 3.3
MOST_TRIALS = 24


@dataclass(frozen=True)
class Standard:
    """A reference standard and the families it tells apart from all others."""

    name: str
    what: str
    families: tuple[str, ...]


STANDARDS = (
    Standard("vent", "vent to the atmosphere and read the pressure",
             ("pressure_sensor", "dead_space")),
    Standard("dead weights", "hang known weights on the force sensor", ("force_sensor", "load")),
    Standard("gauge block", "hold a gauge block before the camera and between the holders",
             ("length_sensor", "geometry")),
    Standard("vented pull", "pull the vented muscle over its lengths", ("elasticity",)),
    Standard("slow and fast", "the same loop at speeds over two decades", ("friction", "rate")),
    Standard("locked decay", "shut both valves at pressure and watch", ("flow", "gas")),
    Standard("pulse widths", "pulses from below to well above the on-delay at two pressures",
             ("valve_timing",)),
)  # fmt: skip


def advise(q: Inquiry, best: State | None, rivals: Sequence[State]) -> Experiment | None:
    """Return the experiment that best separates `best` from its nearest rival."""
    if best is None or not best.suspects:
        return None
    if not rivals:
        return None
    by_unit = [_separation(q, best, rival) for rival in rivals]
    nearest = min(range(len(rivals)), key=lambda k: float(by_unit[k].sum()))
    gained = by_unit[nearest]
    now = float(np.sqrt(gained.sum()))
    counts = np.bincount(q.units, minlength=len(gained)).astype(np.float64)
    each = np.where(counts > 0, gained / np.maximum(counts, 1.0), 0.0)
    unit = int(np.argmax(each))
    between = ("+".join(best.ids), "+".join(rivals[nearest].ids))
    lacking = max(ENOUGH**2 - now**2, 0.0)
    needed = int(np.ceil(lacking / each[unit])) if each[unit] > 0.0 else MOST_TRIALS + 1
    if needed > MOST_TRIALS:
        return _standard(best, between, now)
    needed = max(needed, 2)
    trial = q.data.trials[int(np.flatnonzero(q.units == unit)[0])]
    settings = {
        name: value
        for name, value in (
            ("held_length_mm", trial.held_length_mm),
            ("load_kg", trial.load_kg),
            ("like_slot", trial.slot),
        )
        if isinstance(value, str) or np.isfinite(value)
    }
    return Experiment(
        trial.protocol, settings, now, float(np.sqrt(now**2 + needed * each[unit])), needed,
        between, f"trials like slot {trial.slot} tell {between[0]} from {between[1]} best",
    )  # fmt: skip


def _separation(q: Inquiry, first: State, second: State) -> Array:
    """Squared distance of two fitted explanations in units of noise, by slot."""
    gap = first.residual - second.residual
    made = np.zeros(int(q.units.max(initial=-1)) + 1)
    for trial, rows in enumerate(q.noise.trial_rows):
        if len(rows):
            made[q.units[trial]] += q.noise.solve(trial, gap[rows][:, None])[0][0, 0]
    return made


def _standard(best: State, between: tuple[str, str], now: float) -> Experiment:
    """The reference standard for what no trial on this bench separates."""
    families = [CATALOGUE[name].family for name in best.ids if name in CATALOGUE]
    fit = next((s for s in STANDARDS if set(families) & set(s.families)), STANDARDS[0])
    told = CATALOGUE[best.ids[0]].told_apart_by if best.ids[0] in CATALOGUE else fit.what
    return Experiment(
        "reference", {"standard": fit.name, "procedure": fit.what}, now, max(now, ENOUGH + 1.4), 1,
        between, told,
    )  # fmt: skip


def protocol_text(experiment: Experiment) -> str | None:
    """A protocol file for the experiment, after the shipped one of its name; None without one."""
    folder = resources.files("configs").joinpath("protocols")
    source = folder.joinpath(f"{experiment.protocol}.toml")
    if not source.is_file():
        return None
    lines = [f"# Advised: {experiment.why}", f"# {experiment.trials} trials"]
    for line in source.read_text(encoding="utf-8").splitlines():
        key = line.split("=")[0].strip()
        if key == "repeats":
            line = f"repeats = {experiment.trials}"
        elif key == "lengths_mm" and "held_length_mm" in experiment.settings:
            line = f"lengths_mm = [{experiment.settings['held_length_mm']}]"
        lines.append(line)
    return "\n".join(lines) + "\n"
