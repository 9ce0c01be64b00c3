"""What the measured tables of the thesis can say about the plant, and what they cannot.

The isometric table C-1 at 21 °C gives a ladder of effects, whole lengths left out, from the
deterministic model. Its warm columns are a formula and C-2 is C-1 plus noise: no evidence of either
is claimed. C-3, C-4 and C-6 are held against the plant fitted to C-1.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from gap.data.dataset import DataSet
from gap.thesis.data import G_M_S2, thesis_set
from gap.thesis.static_ladder import Fit, Ladder, Step, Table
from plant.arrays import Array
from plant.constants import nominal

THESIS_BRAID_MM = 78.3
THESIS_TURNS = 2.34
"""Geometry of the thesis's own deterministic model, recovered from its published statistics."""
LEAST_SETTINGS = 8
"""With fewer settings no signed-rank test can be as sure as the ladder requires."""
AT_REST = (
    "liner_threshold", "bladder_elasticity", "contraction_limit", "end_cap", "fibre_stretch",
    "pressure_zero", "force_zero", "length_label",
)  # fmt: skip
CYCLES = (*AT_REST, "braid_friction")


@dataclass(frozen=True)
class TableVerdict:
    """One table: its ladder, its floor, and what it can show.

    Attributes:
        transfer: error of plants fitted to C-1 alone, as its ladder built them, in N.
        up_down: mean of up minus down at equal pressure, its unit, and in how many of how many
            pairs up is above down; None where the table has no direction.
        published: standard deviation and root mean square of the thesis's own model on it.
    """

    name: str
    settings: int
    points: int
    status: str
    reason: str
    floor_n: float | None
    floor: str
    steps: tuple[Step, ...]
    transfer: dict[str, float]
    up_down: tuple[float, str, int, int] | None = None
    published: tuple[float, float] | None = None

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            **{k: v for k, v in vars(self).items() if k not in ("steps", "up_down", "published")},
            "steps": [_step(step) for step in self.steps],
            "up_minus_down": None if self.up_down is None else dict(
                zip(("mean", "unit", "above", "pairs"), self.up_down, strict=True)
            ),
            "thesis_model": None if self.published is None else dict(
                zip(("standard_deviation_n", "rms_n"), self.published, strict=True)
            ),
        }  # fmt: skip


def diagnose_thesis() -> list[TableVerdict]:
    """Verdicts on C-1 at 21 °C, on its warm columns, and on C-3, C-4 and C-6."""
    isometric = thesis_set("c01")
    table = points_of(isometric)
    floor = smoothness(table)
    ladder = Ladder(table, nominal(), True, AT_REST, floor)
    steps = ladder.climb()
    plants = _plants(ladder, steps)
    first = _isometric(table, floor, steps)
    return [first, _warm(), *(_other(name, plants) for name in ("c03", "c04", "c06"))]


def points_of(data: DataSet) -> Table:
    """Settled points of a data set; a path is known where its table states up or down."""
    columns: list[list[float]] = [[], [], [], []]
    path: list[int] = []
    slots = {slot: k for k, slot in enumerate(data.slots)}
    setting: list[int] = []
    for number, trial in enumerate(data.trials):
        pressure = trial["pressure_kpa"].value
        count = len(pressure)
        loaded = np.isfinite(trial.load_kg)
        columns[0] += list(pressure)
        columns[1] += list(trial["length_mm"].value) if loaded else [trial.held_length_mm] * count
        columns[2] += [trial.load_kg * G_M_S2] * count if loaded else list(trial["force_n"].value)
        columns[3] += [trial.temperature_c] * count
        path += [number if trial.direction.any() else -1] * count
        setting += [slots[trial.slot]] * count
    pressure, length, force, temperature = (np.array(column) for column in columns)
    return Table(pressure, length, force, temperature, np.array(path), np.array(setting))


def smoothness(table: Table) -> float:
    """What each inner length differs by from a straight line between its neighbours, rms in N.

    No model that is smooth in length can do better at a length that was left out.
    """
    lengths = np.unique(table.length_mm)
    errors: list[Array] = []
    for low, here, high in zip(lengths, lengths[1:], lengths[2:], strict=False):
        share = (here - low) / (high - low)
        rows = [table.only(table.length_mm == at) for at in (low, here, high)]
        common = sorted(set.intersection(*(set(row.pressure_kpa.tolist()) for row in rows)))
        forces = [np.array([row.force_n[row.pressure_kpa == p][0] for p in common]) for row in rows]
        errors.append(forces[1] - (1.0 - share) * forces[0] - share * forces[2])
    return float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))


def _plants(ladder: Ladder, steps: list[Step]) -> dict[str, Fit]:
    """The plants of the kept steps, each fitted to the whole of C-1."""
    plants: dict[str, Fit] = {}
    for step in steps:
        if step.kept:
            ids = tuple(step.values)
            plants[" + ".join(("deterministic", *ids))] = ladder.fit(ladder.table, ids)
    return plants


def _isometric(table: Table, floor: float, steps: list[Step]) -> TableVerdict:
    kept = [step for step in steps if step.kept]
    names = " and ".join(kept[-1].values)
    closed = (kept[0].rms ** 2 - kept[-1].rms ** 2) / (kept[0].rms ** 2 - floor**2)
    own = Fit(THESIS_BRAID_MM, THESIS_TURNS, {}, 0.0)
    residual = Ladder(table, nominal(), True, (), floor).residual(table, own)
    return TableVerdict(
        "C-1 at 21 °C", len(np.unique(table.setting)), len(table.force_n),
        "named_form_inadequate" if kept[-1].rms > 1.1 * floor else "named",
        f"{names} close {100 * closed:.0f} % of the gap above the floor, whole lengths left out; "
        f"{_next_best(steps)}",
        floor, "each length against a straight line between its neighbours", tuple(steps), {},
        published=(float(residual.std()), float(np.sqrt(np.mean(residual**2)))),
    )  # fmt: skip


def _next_best(steps: list[Step]) -> str:
    if steps[-1].kept:
        return "the ladder was not climbed further"
    name = max(steps[-1].added, key=lambda key: steps[-1].added[key])
    return f"a further effect ({name} at best) is not worth having, so the ladder stops here"


def _warm() -> TableVerdict:
    """What of the warm columns a linear change with temperature reproduces: of a formula."""
    table = points_of(thesis_set("c01", warm=True))
    candidates = ("temperature_stiffening", "liner_threshold", "bladder_elasticity")
    steps = Ladder(table, nominal(), True, candidates, 0.0003).climb()
    kept = [step for step in steps if step.kept]
    names = ", ".join(kept[-1].values) or "nothing"
    return TableVerdict(
        "C-1 at 21 to 39 °C", len(np.unique(table.setting)), len(table.force_n),
        "below_resolution",
        "the columns above 21 °C follow from the 21 °C column by a formula, so they hold no "
        f"evidence; the catalogue's forms ({names}) reproduce that formula to "
        f"{kept[-1].rms:.2f} N, which shows nothing about a muscle",
        None, "a formula has none", tuple(steps), {},
    )  # fmt: skip


def _other(name: str, plants: dict[str, Fit]) -> TableVerdict:
    data = thesis_set(name)
    table = points_of(data)
    count = len(np.unique(table.setting))
    cycles = name in ("c04", "c06")
    ladder = Ladder(table, nominal(), False, CYCLES if cycles else AT_REST, 0.0)
    steps = ladder.climb(most=1)
    transfer = {
        label: float(np.sqrt(np.mean(ladder.residual(table, plant) ** 2)))
        for label, plant in plants.items()
    }
    best, left = next(iter(ladder.alone().items()))
    pairs = _up_down(data) if cycles else None
    more = ""
    if pairs is not None:
        more = f"; up less down is {pairs[0]:+.2f} {pairs[1]} in the mean, {_sense(name, pairs[0])}"
    return TableVerdict(
        f"C-{int(name[1:])}", count, len(table.force_n),
        "below_resolution" if count < LEAST_SETTINGS else "unknown",
        f"{count} settings, none repeated, on another day than C-1: the plant fitted to C-1 is off "
        f"by {steps[0].rms:.1f} N; the one effect that helps most where it is left out ({best}) "
        f"leaves {left:.1f} N, and {LEAST_SETTINGS} settings at least are needed to be sure of "
        f"any{more}",
        None, "no replicates", tuple(steps), transfer, pairs,
    )  # fmt: skip


def _sense(name: str, up_less_down: float) -> str:
    """Whether a difference of directions is that of friction.

    Friction takes from the force as the pressure rises (C-4), and keeps a loaded muscle long (C-6).
    """
    friction = up_less_down < 0.0 if name == "c04" else up_less_down > 0.0
    return "the sense of friction" if friction else "the opposite of friction"


def _up_down(data: DataSet) -> tuple[float, str, int, int]:
    """Mean of up minus down at equal pressure, below the turn, over all cycles."""
    differences: list[float] = []
    unit = "N"
    for trial in data.trials:
        channel = "length_mm" if "length_mm" in trial else "force_n"
        unit = "mm" if channel == "length_mm" else "N"
        pressure, value = trial["pressure_kpa"].value, trial[channel].value
        up = {p: v for p, v, d in zip(pressure, value, trial.direction, strict=True) if d > 0}
        down = {p: v for p, v, d in zip(pressure, value, trial.direction, strict=True) if d < 0}
        turn = max(up)
        differences += [up[p] - down[p] for p in up if p in down and p < turn]
    array = np.array(differences)
    return float(array.mean()), unit, int((array > 0).sum()), len(array)


def _step(step: Step) -> dict[str, Any]:
    return {
        "added": dict(step.added),
        "held_out_rms_n": step.rms,
        "parameters": step.values,
        "spread": {name: list(pair) for name, pair in step.spread.items()},
        "p": step.p,
        "kept": step.kept,
        "instead": dict(step.rivals or {}),
    }
