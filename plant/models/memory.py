"""Laws with memory: Prandtl-Ishlinskii in pressure, Maxwell slip in length, creep in time."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar, TypeVar, cast

import numpy as np
from numba import njit

from plant.arrays import Array
from plant.errors import PlantError
from plant.models.law import Bools, History, Law, Past, Slopes, static_force

F = TypeVar("F", bound=Callable[..., Any])

PLAY_KPA = (25.0, 50.0, 100.0, 200.0)
"""Half-widths of the play operators: the pressure steps of a typical test, doubled."""
SLIP_UM = (100.0, 300.0, 1000.0)
"""Travel after which each Maxwell element slips."""
CREEP_S = (2.0, 20.0, 200.0)
"""Time constants of creep."""


def _compiled(function: F) -> F:
    return cast(F, njit(cache=True)(function))


@_compiled
def _play(x: Any, start: Any, half_width: float) -> tuple[Any, Any]:  # pragma: no cover
    """Play operator, 0 at the start of a trial, and its slope dy/dx (0 or 1)."""
    y, slope = np.empty_like(x), np.zeros_like(x)
    last = 0.0
    for i in range(x.size):
        if start[i]:
            last = 0.0
        if last < x[i] - half_width:
            last, slope[i] = x[i] - half_width, 1.0
        elif last > x[i] + half_width:
            last, slope[i] = x[i] + half_width, 1.0
        y[i] = last
    return y, slope


@_compiled
def _stop(x: Any, start: Any, travel: float) -> tuple[Any, Any]:  # pragma: no cover
    """Stop operator (elastic up to `travel`), 0 at the start of a trial, and its slope."""
    y, slope = np.empty_like(x), np.ones_like(x)
    last = 0.0
    for i in range(x.size):
        if start[i]:
            last = 0.0
        else:
            last += x[i] - x[i - 1]
        if last > travel:
            last, slope[i] = travel, 0.0
        elif last < -travel:
            last, slope[i] = -travel, 0.0
        y[i] = last
    return y, slope


@_compiled
def _add_plays(
    out: Any, x: Any, start: Any, half_width: Any, weight: Any
) -> None:  # pragma: no cover
    """Add sum of weight (play(x) - x) to `out`, all operators in one pass."""
    last = np.zeros(half_width.size)
    for i in range(x.size):
        if start[i]:
            last[:] = 0.0
        total = 0.0
        for k in range(half_width.size):
            last[k] = max(x[i] - half_width[k], min(x[i] + half_width[k], last[k]))
            total += weight[k] * (last[k] - x[i])
        out[i] += total


@_compiled
def _add_stops(out: Any, x: Any, start: Any, travel: Any, weight: Any) -> None:  # pragma: no cover
    """Add sum of weight stop(x) to `out`, all elements in one pass."""
    last = np.zeros(travel.size)
    for i in range(x.size):
        if start[i]:
            last[:] = 0.0
            continue
        total = 0.0
        for k in range(travel.size):
            last[k] = max(-travel[k], min(travel[k], last[k] + x[i] - x[i - 1]))
            total += weight[k] * last[k]
        out[i] += total


@_compiled
def _late(x: Any, time_s: Any, start: Any, tau_s: Any, share: Any) -> Any:  # pragma: no cover
    """Return x + sum of share (lag(x) - x), for first-order lags of a piecewise linear signal."""
    out = np.empty_like(x)
    count = tau_s.size
    lag, decay, ramp = np.empty(count), np.empty(count), np.empty(count)
    last_step = -1.0
    for i in range(x.size):
        if start[i]:
            lag[:] = x[i]
            out[i] = x[i]
            continue
        step = time_s[i] - time_s[i - 1]
        # With constant sampling (up to rounding of the times) the exponentials are computed once.
        if abs(step - last_step) > 1e-9 * step:
            for k in range(count):
                a = step / tau_s[k]
                decay[k] = np.exp(-a)
                ramp[k] = 1.0 - (1.0 - decay[k]) / a if a > 0.0 else 0.0
            last_step = step
        total = x[i]
        for k in range(count):
            lag[k] = lag[k] * decay[k] + x[i - 1] * (1.0 - decay[k] - ramp[k]) + x[i] * ramp[k]
            total += share[k] * (lag[k] - x[i])
        out[i] = total
    return out


def _starts(n: int, path: History | None) -> Bools:
    starts = np.zeros(n, dtype=np.bool_)
    if path is not None and path.start is not None:
        starts |= path.start
    if n:
        starts[0] = True
    return starts


class _Hysteresis(Law):
    """Static law plus sum of w_i h_i(x): rate-independent operators on pressure or length."""

    memory = True
    _axis: ClassVar[int]
    """Index of the operators' input among the slopes: 0 pressure, 1 length."""

    def __init__(self, base: Law, names: tuple[str, ...]) -> None:
        self.base = base
        self.parameters = (*base.parameters, *names)  # type: ignore[misc]
        self.linear = base.linear  # type: ignore[misc]
        self.uses_temperature = base.uses_temperature  # type: ignore[misc]

    @abstractmethod
    def _operators(
        self, p: Array, length: Array, path: History | None
    ) -> list[tuple[Array, Array]]:
        """Value and slope of each operator."""

    @abstractmethod
    def _add(self, out: Array, weights: Array, p: Array, length: Array, starts: Bools) -> None:
        """Add the weighted operators to `out`, in one pass."""

    def force(self, q: Array, p: Array, length: Array, t: Array, path: Past = None) -> Array:
        """Static force and all operators."""
        k = len(self.base.parameters)
        out = static_force(self.base, q[:k], p, length, t)
        self._add(out, q[k:], p, length, _starts(p.size, path))
        return out

    def slopes(self, q: Array, p: Array, length: Array, t: Array, path: Past = None) -> Slopes:
        """Slopes when moving on in the direction in which the point was reached."""
        k = len(self.base.parameters)
        slopes = list(self.base.slopes(q[:k], p, length, t))
        for weight, (_, slope) in zip(q[k:], self._operators(p, length, path), strict=True):
            slopes[self._axis] = slopes[self._axis] + weight * slope
        return slopes[0], slopes[1], slopes[2]

    def jacobian(self, q: Array, p: Array, length: Array, t: Array, path: Past = None) -> Array:
        """Of the static law, then of the operators."""
        k = len(self.base.parameters)
        values = [value for value, _ in self._operators(p, length, path)]
        return np.concatenate([self.base.jacobian(q[:k], p, length, t), np.stack(values)])


class PrandtlIshlinskii(_Hysteresis):
    """Static law plus sum of w_i (play_i(p) - p): the force lags behind the pressure.

    play_i has the half-width PLAY_KPA[i]. For w_i > 0 the force is lower by w_i times the
    half-width while the pressure rises (after that much travel), and higher while it falls.
    Rate-independent. Valid for rising and falling pressure at constant length.
    """

    _axis = 0

    def __init__(self, base: Law) -> None:
        super().__init__(base, tuple(f"play_{width:g}_kpa" for width in PLAY_KPA))

    def _operators(
        self, p: Array, length: Array, path: History | None
    ) -> list[tuple[Array, Array]]:
        starts = _starts(p.size, path)
        plays = [_play(p, starts, width * 1e3) for width in PLAY_KPA]
        return [(y - p, slope - 1.0) for y, slope in plays]

    def _add(self, out: Array, weights: Array, p: Array, length: Array, starts: Bools) -> None:
        _add_plays(out, p, starts, np.array(PLAY_KPA) * 1e3, weights)


class MaxwellSlip(_Hysteresis):
    """Static law plus sum of k_i stop_i(L): springs that slip after SLIP_UM[i] of travel.

    The friction of the braid as a function of length: while it shortens, a muscle pulls less than
    while it lengthens, by at most the sum of k_i SLIP_UM[i]. Rate-independent, with minor loops.
    An isometric test does not determine the k_i, because the length does not change.
    """

    _axis = 1

    def __init__(self, base: Law) -> None:
        super().__init__(base, tuple(f"slip_{travel:g}_um" for travel in SLIP_UM))

    def _operators(
        self, p: Array, length: Array, path: History | None
    ) -> list[tuple[Array, Array]]:
        starts = _starts(length.size, path)
        return [_stop(length, starts, travel * 1e-6) for travel in SLIP_UM]

    def _add(self, out: Array, weights: Array, p: Array, length: Array, starts: Bools) -> None:
        _add_stops(out, length, starts, np.array(SLIP_UM) * 1e-6, weights)


class Creep(Law):
    """Part of every change is delayed: F = F_0 + sum of c_i (lag_i(F_0) - F_0).

    F_0 is the static law, lag_i a first-order lag with the time constant CREEP_S[i]. The fraction
    1 - sum of c_i follows a step immediately. Needs the times of the points. The muscle is assumed
    to be at rest at the first point of a trial. Settled points far apart in time do not determine
    the c_i.
    """

    memory = True

    def __init__(self, base: Law) -> None:
        self.base = base
        names = [f"late_{tau:g}_s" for tau in CREEP_S]
        self.parameters = (*base.parameters, *names)  # type: ignore[misc]
        self.uses_temperature = base.uses_temperature  # type: ignore[misc]

    def _time(self, path: History | None) -> Array:
        if path is None or path.time_s is None:
            raise PlantError("creep needs the time of every point; give History(time_s=...)")
        return path.time_s

    def _late(self, share: Array, signal: Array, path: History | None) -> Array:
        starts = _starts(signal.size, path)
        return np.asarray(_late(signal, self._time(path), starts, np.array(CREEP_S), share))

    def force(self, q: Array, p: Array, length: Array, t: Array, path: Past = None) -> Array:
        """Static force with its delayed part."""
        k = len(self.base.parameters)
        return self._late(q[k:], static_force(self.base, q[:k], p, length, t), path)

    def slopes(self, q: Array, p: Array, length: Array, t: Array, path: Past = None) -> Slopes:
        """Slopes for an immediate change, without the delayed part."""
        k = len(self.base.parameters)
        share = 1.0 - float(np.sum(q[k:]))
        by_p, by_l, by_t = self.base.slopes(q[:k], p, length, t)
        return share * by_p, share * by_l, share * by_t

    def jacobian(self, q: Array, p: Array, length: Array, t: Array, path: Past = None) -> Array:
        """The lag is linear, so it is applied to the static sensitivities."""
        k = len(self.base.parameters)
        rows = [self._late(q[k:], row, path) for row in self.base.jacobian(q[:k], p, length, t)]
        static = self.base.force(q[:k], p, length, t)
        for unit in np.eye(len(CREEP_S)):
            rows.append(self._late(unit, static, path) - static)
        return np.stack(rows)
