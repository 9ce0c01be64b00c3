"""Advance one trial from instant to instant, and run it whole, with readings where asked for."""

from __future__ import annotations

from typing import Any

import numpy as np

from blind.physics import numbers as n
from blind.physics.compiled import compiled
from blind.physics.kernel import (
    GRAVITY,
    VALVE_CELLS,
    command,
    next_edge,
    slopes,
    valve_edges,
)
from blind.physics.laws import static_force

Array = Any
# What a run returns for each instant asked for.
OUT_P, OUT_TAP, OUT_L, OUT_V, OUT_A, OUT_F, OUT_FALL = 0, 1, 2, 3, 4, 5, 6
OUTPUTS = 7


@compiled
def tolerance_of(i: int) -> float:
    """Absolute tolerance of state i, in its unit."""
    if i in (n.Y_P, n.Y_TAP, n.Y_TAP + 1, n.Y_ISO, n.Y_SIDE, n.Y_FALL):
        return 0.004
    if i == n.Y_L:
        return 2e-4
    if i == n.Y_V:
        return 0.02
    return 0.005


@compiled
def reading(
    t: float, y: Array, out: Array, f: float, length: float, v: float, a: float, c: Array, e: Array
) -> None:
    """Write one row of outputs."""
    gauge = y[n.Y_P] - c[n.ATMOSPHERE]
    out[OUT_P] = gauge
    out[OUT_TAP] = gauge
    if e[n.P_LAG, 0] == 2.0:
        out[OUT_TAP] = y[n.Y_TAP + 1]
    elif e[n.P_LAG, 0] >= 0.0:
        out[OUT_TAP] = y[n.Y_TAP]
    out[OUT_L] = length
    out[OUT_V] = v
    out[OUT_A] = a
    out[OUT_F] = f
    out[OUT_FALL] = y[n.Y_FALL]


@compiled
def advance(
    t: float,
    end: float,
    step: float,
    y: Array,
    vs: Array,
    c: Array,
    e: Array,
    w: Array,
    regulated: bool,
    set_t: Array,
    set_v: Array,
    len_t: Array,
    len_v: Array,
    t_out: Array,
    out: Array,
    at: int,
    scale: float,
) -> Any:
    """Integrate from t to end, writing the outputs on the way; returns (step, next output)."""
    size = n.STATES
    k1, k2, k3, k4 = np.zeros(size), np.zeros(size), np.zeros(size), np.zeros(size)
    trial, fresh, row = np.zeros(size), np.zeros(size), np.zeros(size)
    valve_edges(t, vs)
    course = (set_t, set_v, len_t, len_v)
    slopes(t, y, k1, vs, c, e, w, regulated, set_t, set_v, len_t, len_v)
    while t < end - 1e-12:
        stop = next_edge(t, end, vs, course[0], course[2])
        if stop <= t + 1e-12:
            valve_edges(t + 1e-12, vs)
            slopes(t, y, k1, vs, c, e, w, regulated, set_t, set_v, len_t, len_v)
            continue
        left = stop - t
        h = min(step, left)
        if left < 1.5 * h:
            h = left
        while True:
            for i in range(size):
                trial[i] = y[i] + 0.5 * h * k1[i]
            slopes(t + 0.5 * h, trial, k2, vs, c, e, w, regulated, set_t, set_v, len_t, len_v)
            for i in range(size):
                trial[i] = y[i] + 0.75 * h * k2[i]
            slopes(t + 0.75 * h, trial, k3, vs, c, e, w, regulated, set_t, set_v, len_t, len_v)
            for i in range(size):
                fresh[i] = y[i] + h * (2.0 * k1[i] + 3.0 * k2[i] + 4.0 * k3[i]) / 9.0
            inside = t + h if t + h < stop - 1e-12 else stop - 1e-10
            f, length, v, a = slopes(
                inside, fresh, k4, vs, c, e, w, regulated, set_t, set_v, len_t, len_v
            )
            worst = 0.0
            for i in range(size):
                miss = h * abs(-5.0 * k1[i] + 6.0 * k2[i] + 8.0 * k3[i] - 9.0 * k4[i]) / 72.0
                worst = max(worst, miss / (scale * (tolerance_of(i) + 1e-5 * abs(fresh[i]))))
            if worst <= 1.0 or h < 2e-7:
                break
            h *= max(0.25, 0.9 * worst ** (-1.0 / 3.0))
        while at < len(t_out) and t_out[at] <= t + h + 1e-12:
            u = (t_out[at] - t) / h
            for i in range(size):  # cubic Hermite
                d = fresh[i] - y[i]
                row[i] = (
                    y[i] + u * d + u * (u - 1.0) * ((1.0 - 2.0 * u) * d + (u - 1.0) * h * k1[i])
                )
                row[i] += u * (u - 1.0) * u * h * k4[i]
            f, length, v, a = slopes(
                t_out[at], row, trial, vs, c, e, w, regulated, set_t, set_v, len_t, len_v
            )
            reading(t_out[at], row, out[at], f, length, v, a, c, e)
            at += 1
        t += h
        for i in range(size):
            y[i] = fresh[i]
            k1[i] = k4[i]
        if h < left or worst > 0.0:
            step = min(h * min(4.0, 0.9 * (worst + 1e-9) ** (-1.0 / 3.0)), 0.25)
        if t >= stop - 1e-12:
            t = stop
            valve_edges(t, vs)
            slopes(t, y, k1, vs, c, e, w, regulated, set_t, set_v, len_t, len_v)
            step = min(step, 2e-3)
    return step, at


@compiled
def at_rest(gauge: float, length: float, c: Array, e: Array) -> Any:
    """State and valve memory of a muscle that has settled at a pressure and a length."""
    y = np.zeros(n.STATES)
    vs = np.zeros(VALVE_CELLS)
    p = gauge + c[n.ATMOSPHERE]
    y[n.Y_P], y[n.Y_ISO], y[n.Y_SIDE] = p, p, p
    y[n.Y_TAP], y[n.Y_TAP + 1] = gauge, gauge
    if e[n.P_LAG, 0] >= 3.0 and e[n.P_LAG, 0] != 5.0:  # a speed there, not a pressure
        y[n.Y_TAP + 1] = 0.0
    y[n.Y_L] = length
    if c[n.MASS] > 0.0:  # hangs on its lower stop
        real = c[n.MASS]
        if e[n.PAYLOAD, 0] >= 0.0:
            real += e[n.PAYLOAD, 1]
        rest = c[n.L_MAX]
        for _ in range(30):
            force = static_force(gauge, rest, c, e)
            rest = c[n.L_MAX] + (real * GRAVITY - force) / c[n.STOP_K]
        y[n.Y_L] = rest
    settled = static_force(gauge, y[n.Y_L], c, e)
    for i in range(n.MEMORIES):
        y[n.Y_CREEP + i] = settled
    return y, vs


@compiled
def run(
    c: Array,
    e: Array,
    w: Array,
    regulated: bool,
    edges: Array,
    set_t: Array,
    set_v: Array,
    len_t: Array,
    len_v: Array,
    t_out: Array,
    scale: float,
) -> Any:
    """A whole trial from rest: readings of shape (len(t_out), OUTPUTS), times in s ascending.

    `edges` rows: time, side (0 inlet, 1 outlet), state. `scale` multiplies the tolerances.
    """
    start = set_v[0] if regulated else 0.0
    y, vs = at_rest(start, len_v[0], c, e)
    out = np.zeros((len(t_out), OUTPUTS))
    t, step, at = 0.0, 1e-3, 0
    while at < len(t_out) and t_out[at] <= 0.0:
        row = np.zeros(n.STATES)
        f, length, v, a = slopes(0.0, y, row, vs, c, e, w, regulated, set_t, set_v, len_t, len_v)
        reading(0.0, y, out[at], f, length, v, a, c, e)
        at += 1
    for i in range(len(edges)):
        if edges[i, 0] > t:
            step, at = advance(
                t, edges[i, 0], step, y, vs, c, e, w, regulated,
                set_t, set_v, len_t, len_v, t_out, out, at, scale,
            )  # fmt: skip
            t = edges[i, 0]
        command(t, int(edges[i, 1]), edges[i, 2] > 0.0, y, vs, c, e)
    if len(t_out) and t < t_out[-1]:
        advance(
            t, t_out[-1] + 1e-9, step, y, vs, c, e, w, regulated,
            set_t, set_v, len_t, len_v, t_out, out, at, scale,
        )  # fmt: skip
    return out
