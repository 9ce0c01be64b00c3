"""PID control of each joint angle, Equations 1-1 to 1-4, with Ziegler-Nichols gains.

    u = kp (e + 1/Ti integral of e + Td de/dt)

The thesis prints the integral in 1-3 and 1-4 without 1/Ti; the units would then be inconsistent.
The derivative is that of the reading, with a lag of Td / 8, so that a step of the reference has no
effect on it. The integral stops when the pressures are at their limits.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plant.arrays import Array
from studies.controllers.loop import HOST_MS
from studies.controllers.reference import Reference

FILTER = 8.0


@dataclass(frozen=True)
class Gains:
    """One loop: kPa/rad, s, s; `ti_s` infinite means no integral."""

    kp: float
    ti_s: float
    td_s: float


def ziegler_nichols(critical_gain: float, critical_period_s: float, form: str = "pid") -> Gains:
    """Gains from critical gain and period (Ziegler and Nichols 1942): "p", "pi" or "pid"."""
    share, ti, td = {
        "p": (0.5, float("inf"), 0.0),
        "pi": (0.45, 1.0 / 1.2, 0.0),
        "pid": (0.6, 0.5, 0.125),
    }[form]
    return Gains(share * critical_gain, ti * critical_period_s, td * critical_period_s)


class Pid:
    """Independent loops, one per joint, about `bias` (kPa), with output limits ± `limit_kpa`."""

    def __init__(self, gains: list[Gains], bias: Array, limit_kpa: float = 250.0) -> None:
        self._kp = np.array([g.kp for g in gains])
        self._ki = np.array([g.kp / g.ti_s for g in gains])
        self._td = np.array([g.td_s for g in gains])
        self._bias = bias
        self._limit = limit_kpa
        self._integral = np.zeros(len(gains))
        self._slope = np.zeros(len(gains))
        self._last: Array | None = None
        self._reference: Reference | None = None

    def start(self, reference: Reference, q: Array) -> None:
        """Reset all states."""
        self._reference = reference.smooth
        self._integral = np.zeros(len(self._kp))
        self._slope = np.zeros(len(self._kp))
        self._last = None

    def delta(self, time_s: float, q: Array) -> Array:
        """Outputs of the loops."""
        assert self._reference is not None
        step = HOST_MS * 1e-3
        wanted, _, _ = self._reference.at(time_s)
        error = wanted - q
        if self._last is not None:
            lag = self._td / FILTER
            share = step / (lag + step)
            self._slope += share * ((q - self._last) / step - self._slope)
        self._last = q.copy()
        free = self._bias + self._kp * (error - self._td * self._slope) + self._integral
        out = np.clip(free, -self._limit, self._limit)
        # Anti-windup: integrate only within the limits, or towards them.
        held = (free != out) & (np.sign(error) == np.sign(free))
        self._integral += np.where(held, 0.0, self._ki * step * error)
        return out
