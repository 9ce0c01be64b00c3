"""Inputs of an empirical correction, one value a feature row of a block."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import pairwise

import numpy as np

from gap.model.features import BLOCKS, Rows
from gap.model.grid import Grid, trial_order
from plant.arrays import Array
from plant.constants import REFERENCE_DENSITY_KG_M3, PlantConstants
from plant.effects.arguments import Points
from plant.effects.empirical import (
    FLOWS,
    FORGOTTEN_S,
    VALVE_FLOW,
    Correction,
    braid_scales,
    pressure_per_flow,
)

_SLIP_KPA = 15.0
_SLIP_MM = 1.0
_MOVING_MM = 2.0
_SHUTS_S = 0.05
_LONG_AGO_S = 2.0


def correction_at(grid: Grid, correction: Correction, c: PlantConstants) -> Array:
    """Correction at every row of its block, in the block's unit, shape (rows,)."""
    block = correction.block
    plain = [term for term in correction.terms if term.scale not in FLOWS]
    flows = [term for term in correction.terms if term.scale in FLOWS]
    at = inputs_of(grid, block, correction.inputs)
    if correction.scales:
        at |= scales_of(grid, block, c)
    count = int(grid.points[block].row.max(initial=-1)) + 1
    made = Correction(block, tuple(plain)).value(at, count)
    if flows:
        inside = point_inputs_of(grid, block, correction.inputs)
        inside[VALVE_FLOW] = valve_flow(grid, c)
        points = len(grid.points[block].time_s)
        flow = Correction(block, tuple(flows)).value(inside, points)
        made = made + risen(grid, flow[:, None], c)[:, 0]
    return made


def risen(grid: Grid, flow: Array, c: PlantConstants) -> Array:
    """Pressure in kPa by which flows in mg/s into the chamber raise it at every row.

    Args:
        flow: at the points of the pressure, shape (points, flows).

    As the prediction is drawn to the reading, so is what a flow adds to it.
    """
    points = grid.points["pressure"]
    per = pressure_per_flow(np.clip(points.length, 1e-4, 0.999 * c.braid_length_m), c)
    rate = flow * per[:, None]
    total = np.zeros_like(rate)
    for own in _spans(points):
        step = np.diff(points.time_s[own])
        gain = 0.5 * (rate[own][1:] + rate[own][:-1]) * step[:, None]
        kept = np.exp(-np.r_[0.0, step[:-1]] / FORGOTTEN_S)
        state = np.zeros(flow.shape[1])
        course = total[own]
        for k in range(len(step)):
            state = state * kept[k] + gain[k]
            course[k + 1] = state
    weighted = total * points.weight[:, None]
    count = int(points.row.max(initial=-1)) + 1
    sums = np.zeros((count, flow.shape[1]))
    np.add.at(sums, points.row, weighted)
    return np.asarray(sums / points.row_weight[:, None])


def valve_flow(grid: Grid, c: PlantConstants) -> Array:
    """Flow in mg/s into the chamber through the valve that is commanded open, at every point.

    ISO 6358 with the constants' conductances; out of the chamber it is negative. For a moment after
    a valve is commanded shut it is that of the valve as if still open: it may shut late.
    """
    points = grid.points["pressure"]
    since, valve = _edges(grid, points)
    closing = (valve == 0.0) & (since < _SHUTS_S)
    valve = np.where(closing, _last_open(valve), valve)
    outside = c.atmosphere_pa
    inside = np.maximum(points.pressure + outside, 1.0)
    supply = np.maximum(grid.supply + outside, 1.0)
    dense = 1e6 * REFERENCE_DENSITY_KG_M3
    inlet = c.inlet_conductance_m3_s_pa * supply * _factor(inside / supply, c.critical_ratio)
    outlet = c.outlet_conductance_m3_s_pa * inside * _factor(outside / inside, c.critical_ratio)
    return np.asarray(dense * np.where(valve > 0.0, inlet, np.where(valve < 0.0, -outlet, 0.0)))


def _last_open(valve: Array) -> Array:
    """The last valve that was open, at every point."""
    at = np.maximum.accumulate(np.where(valve != 0.0, np.arange(len(valve)), 0))
    return np.asarray(valve[at])


def _factor(ratio: Array, critical: float) -> Array:
    """The quarter ellipse of ISO 6358, 1 where the flow is choked."""
    share = np.clip((ratio - critical) / (1.0 - critical), 0.0, 1.0)
    return np.sqrt(1.0 - share**2)


def point_inputs_of(grid: Grid, block: str, names: tuple[str, ...]) -> dict[str, Array]:
    """Inputs by name at every point of a block, as `inputs_of` has them at every row."""
    points = grid.points[block]
    return {
        name: np.nan_to_num(
            _AT_POINTS[name](points) if name in _AT_POINTS else _OF_POINTS[name](grid, points)
        )
        for name in names
    }


def inputs_of(grid: Grid, block: str, names: tuple[str, ...]) -> dict[str, Array]:
    """Inputs by name at every row of a block; those that do not exist in a row are zero.

    `slip` is how far a loop of friction has turned since the motion last turned (-1 to 1), of the
    length where it moves and of the pressure where it is held; `change_<time>_kpa` is the pressure
    beyond its own mean over that time (a low-pass of first order); `valve` is +1 while the inlet is
    commanded open, -1 while the outlet is.
    """
    points = grid.points[block]
    here = grid.rows.block == BLOCKS.index(block)
    timed = np.bincount(points.row, weights=points.settled) == 0.0
    made: dict[str, Array] = {}
    for name in names:
        if name in _OF_ROWS:
            values = _OF_ROWS[name](grid.rows)[here]
        else:
            values = _means(points, _OF_POINTS[name](grid, points))
        # A table of settled points has no time; its direction is what it says of the past.
        made[name] = np.nan_to_num(np.where(timed | (name not in _TIMED), values, 0.0))
    return made


def scales_of(grid: Grid, block: str, c: PlantConstants) -> dict[str, Array]:
    """What the braid of constants `c` says at every row of a block: see `braid_scales`."""
    here = grid.rows.block == BLOCKS.index(block)
    return braid_scales(grid.rows.pressure[here], grid.rows.length[here], c)


def _means(points: Points, raw: Array) -> Array:
    """Means of values at the points over each row."""
    return np.asarray(np.bincount(points.row, weights=raw * points.weight) / points.row_weight)


def _spans(points: Points) -> list[slice]:
    """Points of each trial that has any."""
    ends = points.first
    return [slice(a, b) for a, b in pairwise(ends.tolist()) if b > a]


def _slope(points: Points) -> Array:
    """Slope of the pressure in kPa/s at every point."""
    made = np.zeros(len(points.time_s))
    for own in _spans(points):
        time = points.time_s[own]
        if len(time) > 2 and np.all(np.diff(time) > 0.0):
            made[own] = np.gradient(points.path[own], time) * 1e-3
    return made


def _slip(points: Points) -> Array:
    """How far a loop has turned since the last turning point: Dahl's element, -1 to 1."""
    made = np.zeros(len(points.time_s))
    for own in _spans(points):
        if points.settled[own].all():
            made[own] = points.direction[own]
            continue
        moves = not points.held[own].all() and np.ptp(points.length[own]) * 1e3 > _MOVING_MM
        x = points.length[own] * 1e3 / _SLIP_MM if moves else points.path[own] * 1e-3 / _SLIP_KPA
        step = np.diff(x)
        keep = np.exp(-np.abs(step))
        state, course = 0.0, [0.0]
        for sign, kept in zip(np.sign(step).tolist(), keep.tolist(), strict=True):
            state = sign + (state - sign) * kept
            course.append(state)
        made[own] = course
    return made


def _change(points: Points, tau_s: float) -> Array:
    """Pressure in kPa beyond its low-pass of first order, from rest at the first point."""
    made = np.zeros(len(points.time_s))
    for own in _spans(points):
        p = points.path[own] * 1e-3
        keep = np.exp(-np.maximum(np.diff(points.time_s[own]), 0.0) / tau_s)
        state, course = float(p[0]), [float(p[0])]
        for value, kept in zip(p[1:].tolist(), keep.tolist(), strict=True):
            state = value + (state - value) * kept
            course.append(state)
        made[own] = p - np.asarray(course)
    return made


def _edges(grid: Grid, points: Points) -> tuple[Array, Array]:
    """Seconds since the last command's edge, and which valve is commanded open."""
    since = np.full(len(points.time_s), _LONG_AGO_S)
    valve = np.zeros(len(points.time_s))
    for t in np.unique(points.trial):
        own = points.trial == t
        span = slice(int(grid.first_edge[t]), int(grid.first_edge[t + 1]))
        edges, to, of = grid.edge_s[span], grid.edge_to[span], grid.edge_of[span]
        if not len(edges):
            continue
        last = np.searchsorted(edges, points.time_s[own], side="right") - 1
        after = last >= 0
        ago = points.time_s[own] - edges[np.maximum(last, 0)]
        since[own] = np.where(after, np.minimum(ago, _LONG_AGO_S), _LONG_AGO_S)
        inlet = np.r_[0.0, _held(np.where(of == 0, to, np.nan))]
        outlet = np.r_[0.0, _held(np.where(of == 1, to, np.nan))]
        valve[own] = (inlet > 0.5)[last + 1].astype(float) - (outlet > 0.5)[last + 1]
    return since, valve


def _held(values: Array) -> Array:
    """Values with each NaN replaced by the last known one, zero before the first."""
    at = np.where(np.isnan(values), -1, np.arange(len(values)))
    last = np.maximum.accumulate(at)
    return np.where(last >= 0, values[np.maximum(last, 0)], 0.0)


_OF_ROWS: Mapping[str, Callable[[Rows], Array]] = {
    "pressure_kpa": lambda rows: rows.pressure * 1e-3,
    "length_mm": lambda rows: rows.length * 1e3,
    "velocity_mm_s": lambda rows: rows.rate * 1e3,
    "time_s": lambda rows: rows.time_s,
}
_OF_POINTS: Mapping[str, Callable[[Grid, Points], Array]] = {
    "pressure_rate_kpa_s": lambda grid, points: _slope(points),
    "temperature_c": lambda grid, points: points.temperature,
    "order": lambda grid, points: trial_order(grid.data)[points.trial],
    "slip": lambda grid, points: _slip(points),
    "change_1s_kpa": lambda grid, points: _change(points, 1.0),
    "change_10s_kpa": lambda grid, points: _change(points, 10.0),
    "since_edge_s": lambda grid, points: _edges(grid, points)[0],
    "valve": lambda grid, points: _edges(grid, points)[1],
}
_AT_POINTS: Mapping[str, Callable[[Points], Array]] = {
    "pressure_kpa": lambda points: points.pressure * 1e-3,
    "length_mm": lambda points: points.length * 1e3,
    "velocity_mm_s": lambda points: points.rate * 1e3,
    "time_s": lambda points: points.time_s,
}
_TIMED = (
    "velocity_mm_s", "time_s", "pressure_rate_kpa_s", "change_1s_kpa", "change_10s_kpa",
    "since_edge_s", "valve",
)  # fmt: skip
