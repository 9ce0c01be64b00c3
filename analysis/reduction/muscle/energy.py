"""Work and efficiency of a cycle: mechanical work, work of the gas, exergy of the air used.

Definitions. All pressures of the gas are absolute, the gas is ideal and isothermal.

- Work of a stroke: the integral of F dL from the longest to the shortest length; of a hung mass
  m g times the stroke. Over a closed cycle under a hung mass it is zero.
- Work of a loop: the closed integral of F dL where both force and length move, by the trapezoidal
  rule over the readings in order; positive where the muscle gives work.
- Air used: that which the muscle holds at the high pressure beyond what it holds at the low one,
  expressed as p V: p_high V_high - p_low V_low.
- Exergy of that air at the supply: (p_high V_high - p_low V_low) ln(p_supply / p_atmosphere): the
  most work that it could give at the temperature of the surroundings (Cai, Kawashima and Kagawa
  2002, "air power").
- Efficiency: work over that exergy.

The volume is that which is stated; without it none of the last three is known.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from plant.arrays import Array

J_PER_KPA_ML = 1e-3


@dataclass(frozen=True)
class Air:
    """What is stated of the air: supply (gauge), atmosphere (absolute), volume over length.

    Attributes:
        lengths_mm, volumes_ml: volume of the muscle at lengths, increasing; between them it is
            interpolated.
        dead_ml: of line and fittings behind the valves.
        u_volume_ml: standard uncertainty of each volume, common to all.
    """

    supply_kpa: float
    u_supply_kpa: float
    atmosphere_kpa: float
    u_atmosphere_kpa: float
    lengths_mm: tuple[float, ...]
    volumes_ml: tuple[float, ...]
    dead_ml: float
    u_volume_ml: float

    def as_dict(self) -> dict[str, Any]:
        """Plain values for run.json."""
        return {k: list(v) if isinstance(v, tuple) else v for k, v in vars(self).items()}

    def volume_ml(self, length_mm: float) -> float:
        """Muscle and line at a length; NaN beyond the stated lengths."""
        if not self.lengths_mm[0] <= length_mm <= self.lengths_mm[-1]:
            return math.nan
        return float(np.interp(length_mm, self.lengths_mm, self.volumes_ml)) + self.dead_ml


def stated_air(parameters: Mapping[str, Any]) -> Air | None:
    """The table ``[air]`` of a recorded test; None where it states none."""
    given = parameters.get("air")
    if not isinstance(given, Mapping):
        return None
    values: dict[str, Any] = {
        k: tuple(float(x) for x in v) if isinstance(v, list) else float(v) for k, v in given.items()
    }
    return Air(**values)


@dataclass(frozen=True)
class State:
    """One end of a cycle: gauge pressure and length, with standard uncertainties."""

    pressure_kpa: float
    u_pressure_kpa: float
    length_mm: float
    u_length_mm: float


@dataclass(frozen=True)
class Energy:
    """Work, exergy of the air and efficiency of a cycle, with standard uncertainties.

    ``exergy_j`` and ``efficiency`` are NaN where the volume is not known.
    """

    work_j: float
    u_work_j: float
    exergy_j: float = math.nan
    u_exergy_j: float = math.nan
    efficiency: float = math.nan
    u_efficiency: float = math.nan


def cycle_energy(
    work_j: float, u_work_j: float, high: State, low: State, air: Air | None
) -> Energy:
    """Energy of a cycle between two ends; uncertainties by each input in turn."""
    if air is None:
        return Energy(work_j, u_work_j)

    def exergy(values: Array) -> float:
        p1, l1, p2, l2, supply, atmosphere, volume = values
        used = (p1 + atmosphere) * (air.volume_ml(l1) + volume)
        used -= (p2 + atmosphere) * (air.volume_ml(l2) + volume)
        return float(used * math.log((supply + atmosphere) / atmosphere) * J_PER_KPA_ML)

    at = np.array([
        high.pressure_kpa, high.length_mm, low.pressure_kpa, low.length_mm, air.supply_kpa,
        air.atmosphere_kpa, 0.0,
    ])  # fmt: skip
    u = np.array([
        high.u_pressure_kpa, high.u_length_mm, low.u_pressure_kpa, low.u_length_mm,
        air.u_supply_kpa, air.u_atmosphere_kpa, air.u_volume_ml,
    ])  # fmt: skip
    value = exergy(at)
    if not math.isfinite(value):  # a length beyond those whose volume is stated
        return Energy(work_j, u_work_j)
    u_value = _by_each(exergy, at, u)
    ratio = work_j / value if value > 0.0 else math.nan
    u_ratio = math.hypot(u_work_j / value, ratio * u_value / value) if value > 0.0 else math.nan
    return Energy(work_j, u_work_j, value, u_value, ratio, u_ratio)


def loop_work(force_n: Array, length_mm: Array, u_force_n: Array, u_length_mm: Array) -> (
    tuple[float, float]
):  # fmt: skip
    """Work that a muscle gives over a closed loop in J, and its standard uncertainty by noise.

    Args:
        force_n, length_mm: readings in order, the first is joined to the last, shapes (n,).
        u_force_n, u_length_mm: their uncertainties, independent from reading to reading. Zeros
            cancel over a closed loop; add the gains of the calibrations as shares of the work.
    """
    next_f, next_l = np.roll(force_n, -1), np.roll(length_mm, -1)
    work = -float(np.sum((force_n + next_f) / 2.0 * (next_l - length_mm))) * 1e-3
    by_force = (np.roll(length_mm, 1) - next_l) / 2.0
    by_length = (next_f - np.roll(force_n, 1)) / 2.0
    u = math.sqrt(float(np.sum((by_force * u_force_n) ** 2 + (by_length * u_length_mm) ** 2)))
    return work, u * 1e-3


def gas_work(pressure_kpa: Array, volume_ml: Array) -> float:
    """Work of the gas on the muscle over a closed loop, the integral of p dV, in J.

    Args:
        pressure_kpa: gauge or absolute (over a closed loop it is the same), shape (n,).
        volume_ml: shape (n,).
    """
    next_p, next_v = np.roll(pressure_kpa, -1), np.roll(volume_ml, -1)
    return float(np.sum((pressure_kpa + next_p) / 2.0 * (next_v - volume_ml))) * J_PER_KPA_ML


def _by_each(function: Callable[[Array], float], at: Array, u: Array) -> float:
    """Standard uncertainty of a function by central differences in each input."""
    total = 0.0
    for k in np.flatnonzero(u > 0.0):
        step = np.zeros(len(at))
        step[k] = u[k] / 2.0
        change = function(at + step) - function(at - step)
        if not math.isfinite(change):  # beyond the stated lengths on one side
            change = max(
                2.0 * abs(function(at + way * step) - function(at))
                for way in (1.0, -1.0)
                if math.isfinite(function(at + way * step))
            )
        total = math.hypot(total, change)
    return total
