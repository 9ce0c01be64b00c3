"""Signatures: what each constant, trial effect and candidate effect does to the features."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gap.effects.candidates import Candidate
from gap.effects.recording import CALIBRATION, EACH_TRIAL
from gap.effects.terms import NOMINAL, Active
from gap.model.features import BLOCKS
from gap.model.residuals import Model, shifted
from plant.arrays import Array
from plant.constants import PlantConstants

CONSTANTS: dict[str, tuple[str, ...]] = {
    "supply_kpa": ("pressure",),
    "atmosphere_kpa": ("pressure",),
    "gas_temperature_k": ("pressure",),
    "braid_length_mm": ("pressure", "force", "load"),
    "turns": ("pressure", "force", "load"),
    "piston_area_mm2": ("pressure", "force", "load"),
    "inlet_conductance_m3_s_pa": ("pressure",),
    "outlet_conductance_m3_s_pa": ("pressure",),
    "critical_ratio": ("pressure",),
    "dead_volume_ml": ("pressure",),
    "load_damping_n_s_mm": ("load",),
    "inlet_on_ms": ("pressure",),
    "inlet_on_ms_per_kpa": ("pressure",),
    "inlet_off_ms": ("pressure",),
    "inlet_off_ms_per_kpa": ("pressure",),
    "outlet_on_ms": ("pressure",),
    "outlet_on_ms_per_kpa": ("pressure",),
    "outlet_off_ms": ("pressure",),
    "outlet_off_ms_per_kpa": ("pressure",),
    "inlet_closing_kpa": ("pressure",),
    "outlet_closing_kpa": ("pressure",),
    "inlet_dead_band": ("pressure",),
    "outlet_dead_band": ("pressure",),
    "valve_lag_ms": ("pressure",),
}
"""Constants that are recalibrated within their tolerances, and the blocks they move."""


@dataclass(frozen=True)
class TrialEffect:
    """A small change drawn anew for each trial: its kind, and what it is made of."""

    kind: str
    sd: float
    active: Active
    blocks: tuple[str, ...]


def _trial_effect(kind: str) -> TrialEffect:
    name, each = EACH_TRIAL[kind]
    return TrialEffect(kind, each.sd, [(name, each.option, 1.0, {})], each.blocks)


TRIAL_EFFECTS: tuple[TrialEffect, ...] = tuple(
    _trial_effect(kind)
    for kind in (
        "pressure zero", "pressure gain", "force zero", "force gain", "length zero", "length gain",
        "held length", "inlet timing", "outlet timing",
    )
)  # fmt: skip
"""Zeros and gains of the sensors (docs/reference/plant.md), and random errors of hand and clock, in
the order of the noise model's columns."""

SLOW_WAVES = 14
"""Cosines over a trial that carry slow noise of each block."""


def constant_columns(
    model: Model, c: PlantConstants, active: Active, stated: PlantConstants
) -> tuple[list[str], Array]:
    """What a rise of each constant by one sd adds to the reading, shape (rows, constants).

    Taken at `c`; sd are those of the `stated` constants. Constants without any trace are left out.
    """
    tried: list[tuple[str, float, list[str]]] = []
    for key, blocks in CONSTANTS.items():
        sd = stated.tolerance_si(key)
        if sd <= 0.0:
            continue
        # A simulator that predicts a block has numbers of its own for it.
        there = [b for b in blocks if b in model.grid.points and not _instead(model, key, b)]
        if not there:
            continue
        tried.append((key, 0.5 * sd, there))

    def column(one: tuple[str, float, list[str]]) -> Array:
        key, step, there = one
        low = model.stacked(model.residual(shifted(c, key, -step), active, there))
        high = model.stacked(model.residual(shifted(c, key, step), active, there))
        return low - high

    made = zip(tried, model.each(column, tried), strict=True)
    seen = [(key, x) for (key, _, _), x in made if np.abs(x).max(initial=0.0) > 1e-9]
    names, columns = [key for key, _ in seen], [x for _, x in seen]
    return names, np.stack(columns, axis=1) if columns else np.zeros((len(model.grid.rows), 0))


def _instead(model: Model, key: str, block: str) -> bool:
    """Whether a simulator takes the place of what a constant does in a block."""
    return model.covers(block) and not (block == "load" and key.startswith("load_"))


def nominal_shift(shift: Array) -> Active:
    """Numbers of the simulator that is the nominal plant, moved by `shift` sd."""
    return [(NOMINAL, "", float(sd), {"number": float(k)}) for k, sd in enumerate(shift) if sd]


def nominal_columns(model: Model, c: PlantConstants, active: Active) -> Array:
    """What one sd of each number of the simulator adds to the reading, shape (rows, numbers)."""
    if model.nominal is None:
        return np.zeros((len(model.grid.rows), 0))
    there = [block for block in model.grid.points if model.covers(block)]
    at = model.nominal.shift(active)
    others = [one for one in active if one[0] != NOMINAL]
    columns = np.zeros((len(model.grid.rows), len(at)))
    errors = model.error_columns(c, active)
    if errors is not None:
        columns[:, len(at) - errors.shape[1] :] = errors
    for number in range(len(at) - (errors.shape[1] if errors is not None else 0)):
        step = np.zeros(len(at))
        step[number] = 0.5
        low = model.residual(c, [*others, *nominal_shift(at - step)], there)
        high = model.residual(c, [*others, *nominal_shift(at + step)], there)
        columns[:, number] = model.stacked(low) - model.stacked(high)
    return columns


MOUNTING_MM = 0.03
"""One sd of the length that a muscle comes to sit off by when it is put back into the rig."""


def mounted(shift: Array) -> Active:
    """What lengths set by hand are off by, `shift` sd in each mounting."""
    return [
        ("mounting", "", MOUNTING_MM * float(sd), {"number": float(number)})
        for number, sd in enumerate(shift)
    ]


def mounting_columns(model: Model, c: PlantConstants, active: Active, count: int) -> Array:
    """What a rise of each mounting's own offset by one sd adds to the reading, (rows, mountings).

    Replicates of one mounting share this error, so their differences do not show it.
    """
    there = [b for b in ("pressure", "force", "camera") if b in model.grid.points]

    def column(number: int) -> Array:
        one = np.zeros(count)
        one[number] = 0.5
        low = model.stacked(model.residual(c, [*active, *mounted(-one)], there))
        high = model.stacked(model.residual(c, [*active, *mounted(one)], there))
        return low - high

    columns = np.zeros((len(model.grid.rows), count))
    for number, made in enumerate(model.each(column, range(count))):
        columns[:, number] = made
    return columns


def miscalibrated(shift: Array, calibration: Mapping[str, float]) -> Active:
    """What the sensors' calibrations are off by, `shift` sd of each that is stated."""
    return [
        (CALIBRATION[key], "", u * float(sd), {})
        for (key, u), sd in zip(calibration.items(), shift, strict=True)
    ]


def calibration_columns(
    model: Model, c: PlantConstants, active: Active, calibration: Mapping[str, float]
) -> Array:
    """What one sd of each calibration adds to the reading, shape (rows, calibrations).

    All trials share it, so no replicates show it.
    """
    columns = np.zeros((len(model.grid.rows), len(calibration)))
    there = [block for block in BLOCKS if block in model.grid.points]
    for number in range(len(calibration)):
        one = np.zeros(len(calibration))
        one[number] = 0.5
        low = model.residual(c, [*active, *miscalibrated(-one, calibration)], there)
        high = model.residual(c, [*active, *miscalibrated(one, calibration)], there)
        columns[:, number] = model.stacked(low) - model.stacked(high)
    return columns


def trial_columns(model: Model, c: PlantConstants) -> tuple[list[TrialEffect], Array]:
    """Change of all rows for one unit of each trial effect, shape (rows, effects)."""
    kinds: list[TrialEffect] = []
    columns: list[Array] = []
    base: dict[str, Array] = model.residual(c, [])
    for effect in TRIAL_EFFECTS:
        there = [block for block in effect.blocks if block in model.grid.points]
        small = [(i, o, a * 0.3, s) for i, o, a, s in effect.active]
        moved = model.residual(c, small, there)
        column = model.stacked({b: (moved[b] - base[b]) / 0.3 for b in there})
        if np.abs(column).max(initial=0.0) > 1e-9:
            kinds.append(effect)
            columns.append(column)
    return kinds, np.stack(columns, axis=1) if columns else np.zeros((len(model.grid.rows), 0))


UNSEEN_GAS = "gas between frames"
_LEAST_ADRIFT_KPA = 0.02


def slow_columns(model: Model, trial_rows: npt.NDArray[np.int64]) -> tuple[Array, list[str]]:
    """Cosines over one trial for each of its blocks, shape (rows of the trial, waves).

    Where gas may have passed unseen, the pressure has one more.
    """
    rows = model.grid.rows
    columns: list[Array] = []
    groups: list[str] = []
    if rows.adrift[trial_rows].max(initial=0.0) > _LEAST_ADRIFT_KPA:
        columns.append(rows.adrift[trial_rows])
        groups.append(UNSEEN_GAS)
    for number, block in enumerate(BLOCKS):
        here = rows.block[trial_rows] == number
        if (
            block == "camera"
            or here.sum() < 20
            or model.grid.data.trials[int(rows.trial[trial_rows[0]])].settled
        ):
            continue
        t = rows.time_s[trial_rows][here]
        span = max(float(np.ptp(t)), 1e-9)
        share = (t - t[0]) / span
        for wave in range(1, SLOW_WAVES + 1):
            column = np.zeros(len(trial_rows))
            column[here] = np.cos(np.pi * wave * share)
            columns.append(column)
            hertz = wave / (2.0 * span)
            groups.append(f"slow {block} {'<' if hertz < 0.1 else '<<' if hertz < 0.4 else '<<<'}")
    if not columns:
        return np.zeros((len(trial_rows), 0)), []
    return np.stack(columns, axis=1), groups


def candidate_columns(
    model: Model,
    c: PlantConstants,
    active: Active,
    candidates: Sequence[Candidate],
) -> Array:
    """Change of measured-minus-predicted explained by one unit of each, (rows, candidates).

    The column is minus the change of the residual, so that a true amount a leaves a residual of
    a times the column.
    """
    base = model.residual(c, active)

    def column(candidate: Candidate) -> Array:
        there = [block for block in candidate.blocks if block in model.grid.points]
        amount = candidate.step
        moved = model.residual(
            c, [*active, (candidate.id, candidate.option, amount, candidate.shape)], there
        )
        return model.stacked({b: (base[b] - moved[b]) / amount for b in there})

    columns = np.zeros((len(model.grid.rows), len(candidates)))
    for j, made in enumerate(model.each(column, candidates)):
        columns[:, j] = made
    return columns
