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
    EDGE_S,
    FLOWS,
    FORGOTTEN_S,
    INLET_EDGE,
    INLET_FLOW,
    OUTLET_EDGE,
    OUTLET_FLOW,
    VALVE_FLOW,
    Correction,
    braid_scales,
    pressure_per_flow,
)
from plant.effects.trials import without_noise_turns
from plant.physics.muscle import braid_force

_SLIP_KPA = 15.0
_SLIP_MM = 1.0
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
        inside |= valve_flows(grid, c)
        points = len(grid.points[block].time_s)
        flow = Correction(block, tuple(flows)).value(inside, points)
        made = made + risen(grid, flow[:, None], c)[:, 0]
    return made


def risen(grid: Grid, flow: Array, c: PlantConstants) -> Array:
    """Pressure in kPa by which flows in mg/s into the chamber raise it at every row.

    Args:
        flow: at the points of the pressure, shape (points, flows).

    As the prediction is drawn to the reading, so is what a flow adds to it; and through an open
    valve it passes away: a chamber at the pressure of its supply, or vented, keeps no surplus.
    """
    points = grid.points["pressure"]
    lost = _passing_away(grid, c)
    per = pressure_per_flow(np.clip(points.length, 1e-4, 0.999 * c.braid_length_m), c)
    rate = flow * per[:, None]
    total = np.zeros_like(rate)
    for own in _spans(points):
        step = np.diff(points.time_s[own])
        gain = 0.5 * (rate[own][1:] + rate[own][:-1]) * step[:, None]
        # What is gained in a step passes away from its middle on.
        kept = np.exp(-step / FORGOTTEN_S - step * 0.5 * (lost[own][1:] + lost[own][:-1]))
        gain *= np.sqrt(kept)[:, None]
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


def _passing_away(grid: Grid, c: PlantConstants) -> Array:
    """Rate in 1/s at which a surplus of pressure leaves through the open valve, at every point."""
    points = grid.points["pressure"]
    per = pressure_per_flow(np.clip(points.length, 1e-4, 0.999 * c.braid_length_m), c)
    valve = _edges(grid, points)[1]
    less = _through(grid, c, valve, 0.0) - _through(grid, c, valve, _SURPLUS_PA)
    return np.asarray(np.maximum(less.sum(axis=0) * per / (1e-3 * _SURPLUS_PA), 0.0))


_SURPLUS_PA = 1e3


def valve_flows(grid: Grid, c: PlantConstants) -> dict[str, Array]:
    """Flows in mg/s into the chamber that a term can be a share of, at every point, by scale.

    ISO 6358 with the constants' conductances; out of the chamber a flow is negative. For a moment
    after a valve is commanded shut its flow is that of the valve as if still open: it may shut
    late.
    """
    points = grid.points["pressure"]
    since, valve = _edges(grid, points)
    closing = (valve == 0.0) & (since < _SHUTS_S)
    valve = np.where(closing, _last_open(valve), valve)
    through_inlet, through_outlet = _through(grid, c, valve, 0.0)
    soon = since < EDGE_S
    return {
        VALVE_FLOW: np.asarray(through_inlet + through_outlet),
        INLET_FLOW: np.asarray(through_inlet),
        OUTLET_FLOW: np.asarray(through_outlet),
        INLET_EDGE: np.asarray(np.where(soon, through_inlet, 0.0)),
        OUTLET_EDGE: np.asarray(np.where(soon, through_outlet, 0.0)),
    }


def _through(grid: Grid, c: PlantConstants, valve: Array, surplus_pa: float) -> Array:
    """Flows in mg/s through inlet and outlet with a surplus of pressure, shape (2, points)."""
    outside = c.atmosphere_pa
    inside = np.maximum(grid.points["pressure"].pressure + outside + surplus_pa, 1.0)
    supply = np.maximum(grid.supply + outside, 1.0)
    dense = 1e6 * REFERENCE_DENSITY_KG_M3
    inlet = c.inlet_conductance_m3_s_pa * supply * _factor(inside / supply, c.critical_ratio)
    outlet = c.outlet_conductance_m3_s_pa * inside * _factor(outside / inside, c.critical_ratio)
    return dense * np.stack(
        [np.where(valve > 0.0, inlet, 0.0), np.where(valve < 0.0, -outlet, 0.0)]
    )


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

    `slip` is how far a loop of friction has turned since the motion last turned: -1 as the muscle
    shortens or its pressure rises, 1 as it lengthens or its pressure falls; `change_<time>_kpa` is
    the pressure beyond its own mean over that time (a low-pass of first order),
    `pull_change_<time>_n` the same of the braid's pull; `openings` counts the commands to open a
    valve in the trial so far; `valve` is +1 while the inlet is commanded open, -1 while the outlet
    is.
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
    """How far a loop has turned since the last turning point: Dahl's element, -1 to 1.

    The fibres slip alike as the muscle shortens and as its pressure rises: both are -1. Turns that
    only noise makes are none: a loop would run down to its middle while nothing moves.
    """
    travel = points.length * 1e3 / _SLIP_MM - points.path * 1e-3 / _SLIP_KPA
    travel = np.asarray(without_noise_turns(points, travel))
    made = np.zeros(len(points.time_s))
    for own in _spans(points):
        if points.settled[own].all():
            made[own] = -points.direction[own]
            continue
        step = np.diff(travel[own])
        keep = np.exp(-np.abs(step))
        state, course = 0.0, [0.0]
        for sign, kept in zip(np.sign(step).tolist(), keep.tolist(), strict=True):
            state = sign + (state - sign) * kept
            course.append(state)
        made[own] = course
    return made


def _change(points: Points, tau_s: float) -> Array:
    """Pressure in kPa beyond its low-pass of first order, from rest at the first point."""
    return _beyond_mean(points, points.path * 1e-3, tau_s)


def _pull_change(grid: Grid, points: Points, tau_s: float) -> Array:
    """Pull in N of the stated braid beyond its low-pass of first order.

    A muscle that creeps, creeps under its load, whether pressure or length has changed it.
    """
    c = grid.data.constants
    pull = braid_force(points.path, points.length, c.braid_length_m, c.turns)
    return _beyond_mean(points, np.asarray(pull), tau_s)


def _beyond_mean(points: Points, values: Array, tau_s: float) -> Array:
    """Values beyond their low-pass of first order, from rest at the first point of each trial."""
    made = np.zeros(len(points.time_s))
    for own in _spans(points):
        x = values[own]
        keep = np.exp(-np.maximum(np.diff(points.time_s[own]), 0.0) / tau_s)
        state, course = float(x[0]), [float(x[0])]
        for value, kept in zip(x[1:].tolist(), keep.tolist(), strict=True):
            state = value + (state - value) * kept
            course.append(state)
        made[own] = x - np.asarray(course)
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


def _openings(grid: Grid, points: Points) -> Array:
    """Commands to open a valve in the trial so far: a valve warms up, and sticks after a rest."""
    made = np.zeros(len(points.time_s))
    for t in np.unique(points.trial):
        own = points.trial == t
        span = slice(int(grid.first_edge[t]), int(grid.first_edge[t + 1]))
        opens = grid.edge_s[span][grid.edge_to[span] > 0.5]
        made[own] = np.searchsorted(opens, points.time_s[own], side="right")
    return made


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
    "pull_change_1s_n": lambda grid, points: _pull_change(grid, points, 1.0),
    "pull_change_10s_n": lambda grid, points: _pull_change(grid, points, 10.0),
    "pull_change_100s_n": lambda grid, points: _pull_change(grid, points, 100.0),
    "since_edge_s": lambda grid, points: _edges(grid, points)[0],
    "valve": lambda grid, points: _edges(grid, points)[1],
    "openings": lambda grid, points: _openings(grid, points),
}
_AT_POINTS: Mapping[str, Callable[[Points], Array]] = {
    "pressure_kpa": lambda points: points.pressure * 1e-3,
    "length_mm": lambda points: points.length * 1e3,
    "velocity_mm_s": lambda points: points.rate * 1e3,
    "time_s": lambda points: points.time_s,
}
_TIMED = (
    "velocity_mm_s", "time_s", "pressure_rate_kpa_s", "change_1s_kpa", "change_10s_kpa",
    "pull_change_1s_n", "pull_change_10s_n", "pull_change_100s_n", "since_edge_s", "valve",
    "openings",
)  # fmt: skip
