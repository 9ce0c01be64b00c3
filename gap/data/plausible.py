"""Remarks on units and signs: readings that contradict each other as a slip of a mapping would.

A wrong unit or sign is no gap of a muscle, yet a diagnosis would explain it by one. Nothing here
refuses data: each remark says what was seen, and what to check.
"""

from __future__ import annotations

import numpy as np

from gap.data.dataset import DataSet
from gap.data.trial import Trial, sampled
from plant.arrays import Array
from plant.constants import nominal
from plant.physics.muscle import braid_force

_SLIPS: tuple[tuple[float, str], ...] = (
    (6.895, "pressures in psi read as kPa"),
    (1.0 / 6.895, "pressures in kPa read as psi"),
    (100.0, "pressures in bar read as kPa"),
    (1e-2, "pressures in kPa read as bar"),
    (1e3, "pressures in MPa read as kPa, or forces in mN read as N"),
    (1e-3, "pressures in Pa read as kPa, or forces in kN read as N"),
    (10.0, "pressures in kPa read as mbar, or forces in N read as kgf"),
    (0.1, "pressures in mbar read as kPa, or forces in kgf read as N"),
    (1.0 / 4.448, "forces in lbf read as N"),
    (4.448, "forces in N read as lbf"),
)
"""Measured over predicted force of a muscle by the slip that makes it."""
_LIKE_SLIP = 0.12
"""Relative deviation up to which a ratio is that of a slip. Braids as stated are known better."""
_MOST = 0.5
"""Share of the points that must lie near that ratio, each within twice the deviation."""
_LEAST_POINTS = 12
_SURE = 0.8
"""Correlation, or share of the trials, from which on a sign is wrong."""
_AIR_KPA = (80.0, 108.0)
"""Pressure of the air, from 2000 m up to a high at the sea."""
_LEAST_RANGE_KPA = 20.0
_MUSCLE_KPA = (15.0, 2500.0)
"""Largest pressures between which a test of a muscle reaches."""


def remarks(data: DataSet) -> list[str]:
    """What the readings of a data set say against their units and signs."""
    made = [*_pressures(data), *_supply(data), *_commands(data)]
    points = [found for trial in data.trials if (found := _points(trial)) is not None]
    if points:
        pressure, length, force = (np.concatenate(one) for one in zip(*points, strict=True))
        made += _force_sign(data, pressure, length, force)
        made += _force_size(data, pressure, length, force)
    return made + _length_sign(data)


def _pressures(data: DataSet) -> list[str]:
    """Pressures that are absolute, or of another unit altogether."""
    lows, highs, count = [], [], 0
    for trial in data.trials:
        value = trial.get("pressure_kpa").value
        count += len(value)
        if len(value):
            lows.append(float(value.min()))
            highs.append(float(value.max()))
    if count < _LEAST_POINTS:
        return []
    made = []
    low, high = _MUSCLE_KPA
    if 0.0 < max(highs) < low:
        made.append(
            f"no pressure is above {max(highs):.3g} kPa: check the unit of pressure_kpa (bar, psi?)"
        )
    elif max(highs) > high:
        made.append(f"pressures reach {max(highs):.3g} kPa: check the unit of pressure_kpa (mbar?)")
    timed = [t for t in data.trials if not t.settled and "pressure_kpa" in t]
    if len(timed) > 1 and max(highs) > _AIR_KPA[1] + _LEAST_RANGE_KPA:
        at_air = [_AIR_KPA[0] < low < _AIR_KPA[1] for low in lows]
        spread = float(np.ptp(lows))
        if all(at_air) and spread < 0.25 * _LEAST_RANGE_KPA:
            made.append(
                f"the lowest pressure of every trial is {min(lows):.4g} to {max(lows):.4g} kPa: if "
                "the muscle was vented then, the pressure is absolute"
            )
    return made


def _supply(data: DataSet) -> list[str]:
    """Muscles at more than their supply."""
    for trial in data.trials:
        supply, pressure = trial.get("supply_kpa").value, trial.get("pressure_kpa").value
        if len(supply) and len(pressure):
            most, fed = float(np.quantile(pressure, 0.99)), float(supply.max())
            # A sealed muscle that is squeezed passes its supply, but not by so much.
            if most > 2.0 * fed + _LEAST_RANGE_KPA:
                return [
                    f"trial {trial.name}: the muscle reaches {most:.4g} kPa from a supply of "
                    f"{fed:.4g} kPa: check the units of pressure_kpa and supply_kpa"
                ]
    return []


def _commands(data: DataSet) -> list[str]:
    """Commands that do the opposite of what they say."""
    rise: dict[str, list[float]] = {"inlet_cmd": [], "outlet_cmd": []}
    for trial in data.trials:
        pressure = trial.get("pressure_kpa")
        if trial.settled or len(pressure) < 3:
            continue
        own = {name: sampled(name, trial.channels.get(name, 0.0), pressure.time_s) for name in rise}
        step = np.diff(pressure.value)
        for name, other in (("inlet_cmd", "outlet_cmd"), ("outlet_cmd", "inlet_cmd")):
            alone = (own[name][:-1] > 0.0) & (own[other][:-1] == 0.0)
            if alone.any():
                rise[name].append(float(step[alone].sum()))
    fills, vents = (np.array(rise[name]) for name in ("inlet_cmd", "outlet_cmd"))
    wrong = [
        len(moved) > 0 and float(np.mean(sign * moved < -_LEAST_RANGE_KPA)) >= _SURE
        for sign, moved in ((1.0, fills), (-1.0, vents))
    ]
    if all(wrong) or (any(wrong) and not (len(fills) and len(vents))):
        return [
            "the pressure falls while inlet_cmd is 1 or rises while outlet_cmd is 1: are the two "
            "commands exchanged, or is their on and off?"
        ]
    return []


def _points(trial: Trial) -> tuple[Array, Array, Array] | None:
    """Pressures in kPa, lengths in mm and forces in N that belong together."""
    pressure, force, length = (trial.get(n) for n in ("pressure_kpa", "force_n", "length_mm"))
    if not len(pressure) or not len(force):
        return None
    if trial.settled:
        if len(pressure) != len(force):
            return None
        p, f = pressure.value, force.value
        here = len(length) == len(force)
        x = length.value if here else np.full(len(f), trial.held_length_mm)
    else:
        every = max(len(force) // 400, 1)
        time_s, f = force.time_s[::every], force.value[::every]
        p = np.interp(time_s, pressure.time_s, pressure.value)
        x = np.full(len(f), trial.held_length_mm)
        if len(length):
            x = np.interp(time_s, length.time_s, length.value)
    good = np.isfinite(p) & np.isfinite(x) & np.isfinite(f)
    return (p[good], x[good], f[good]) if good.any() else None


def _force_sign(data: DataSet, pressure: Array, length: Array, force: Array) -> list[str]:
    """A pull that falls where pressure rises, at equal lengths; a cylinder's push does."""
    slope, alike = _partial(pressure, length, force)
    if data.constants.actuator == "cylinder":
        if slope > 0.0 and alike > _SURE and float(np.median(force)) > 0.0:
            return [
                f"forces are positive and grow by {slope:.3g} N per kPa of pressure: force_n is "
                "the pull, and a cylinder pushes: its force is negative"
            ]
        return []
    if slope < 0.0 and alike < -_SURE and float(np.median(force)) < 0.0:
        return [
            f"forces are negative and fall by {-slope:.3g} N per kPa of pressure: force_n is the "
            "pull, check its sign"
        ]
    return []


def _length_sign(data: DataSet) -> list[str]:
    """Lengths that grow with pressure under a steady load: a contraction, or the wrong sign."""
    if data.constants.actuator == "cylinder":
        return []
    moved: list[tuple[float, float]] = []
    for trial in data.trials:
        pressure, length = trial.get("pressure_kpa"), trial.get("length_mm")
        if len(pressure) < _LEAST_POINTS or len(length) < _LEAST_POINTS:
            continue
        if trial.load_kg != trial.load_kg or trial.load_kg <= 0.0:
            continue
        p = pressure.value
        if trial.settled:
            if len(p) != len(length):
                continue
        else:
            p = np.interp(length.time_s, pressure.time_s, p)
        if np.ptp(p) < _LEAST_RANGE_KPA or np.ptp(length.value) <= 0.0:
            continue
        moved.append((float(np.corrcoef(p, length.value)[0, 1]), float(np.ptp(length.value))))
    if len(moved) > 0 and all(alike > _SURE and by > 1.0 for alike, by in moved):
        return [
            f"under a steady load the length grows with the pressure in {len(moved)} of "
            f"{len(moved)} trials: is length_mm a contraction, or its sign wrong?"
        ]
    return []


def _force_size(data: DataSet, pressure: Array, length: Array, force: Array) -> list[str]:
    """Forces that are a unit's factor from those of the braid as stated."""
    c, usual = data.constants, nominal()
    if (c.braid_length_m, c.turns) == (usual.braid_length_m, usual.turns):
        return []  # whose muscle it is nobody said
    if not np.all(length < 1e3 * c.braid_length_m):
        return []
    told = np.asarray(braid_force(pressure * 1e3, length * 1e-3, c.braid_length_m, c.turns))
    if c.actuator == "cylinder":
        told, force = -told, -force
    large = told > 0.3 * max(float(told.max(initial=0.0)), 1e-12)
    if large.sum() < _LEAST_POINTS:
        return []
    ratios = force[large] / told[large]
    ratio = float(np.median(ratios))
    if ratio <= 0.0:
        return []
    for factor, slip in _SLIPS:
        near = np.abs(ratios / factor - 1.0) < 2.0 * _LIKE_SLIP
        if abs(ratio / factor - 1.0) < _LIKE_SLIP and float(near.mean()) > _MOST:
            return [
                f"forces are {ratio:.3g} times those of the {c.actuator} as stated, as of {slip}: "
                "check the units, and its constants"
            ]
    return []


def _partial(x: Array, other: Array, y: Array) -> tuple[float, float]:
    """Slope of y on x with another input held, and the partial correlation; 0 where none is."""
    if len(x) < _LEAST_POINTS:
        return 0.0, 0.0
    basis = np.stack([np.ones(len(x)), other], axis=1)
    left = [v - basis @ np.linalg.lstsq(basis, v, rcond=None)[0] for v in (x, y)]
    square, across = float(left[0] @ left[0]), float(left[0] @ left[1])
    scale = np.sqrt(square * float(left[1] @ left[1]))
    return (across / square, across / float(scale)) if scale > 0.0 else (0.0, 0.0)
