"""Inputs of an empirical correction, one value a feature row of a block."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np

from gap.model.features import BLOCKS, Rows
from gap.model.grid import Grid, trial_order
from gap.model.pressure import Push
from plant.arrays import Array
from plant.compiled import entry_point, fingerprint
from plant.constants import REFERENCE_DENSITY_KG_M3, PlantConstants
from plant.effects.arguments import Points
from plant.effects.empirical import (
    ALL_LATE,
    CELL,
    CELL_GAIN,
    FLOW,
    FORGOTTEN_S,
    IN_GAS,
    INLET_FLOW,
    LATE,
    OUTLET_FLOW,
    READING,
    SEEN,
    SHIFTS_S,
    SHORT_PULSES,
    SUPPLY,
    VALVE_FLOW,
    Correction,
    braid_scales,
    pressure_per_flow,
    wave_columns,
)
from plant.effects.trials import without_noise_turns
from plant.physics.layout import DEAD_BAND, DELAY, DELAY_MODE, DELAY_SLOPE, nominal_slots
from plant.physics.muscle import braid_force
from plant.physics.valve import opening

_SLIP_KPA = 15.0
_SLIP_MM = 1.0
_LONG_AGO_S = 2.0


def correction_at(grid: Grid, correction: Correction, c: PlantConstants) -> Array:
    """Correction at every row of its block, in the block's unit, shape (rows,).

    Without its flows into the chamber: see `flow_at`.
    """
    block = correction.block
    plain = Correction(block, tuple(t for t in correction.terms if t.scale not in IN_GAS))
    at = inputs_of(grid, block, plain.inputs)
    if plain.scales:
        at |= scales_of(grid, block, c)
    waves = {(name, period): waves_at(grid, block, name, period) for name, period in plain.periods}
    return plain.value(at, int(grid.points[block].row.max(initial=-1)) + 1, waves)


def in_load(grid: Grid, force: Correction, c: PlantConstants) -> Array:
    """What an error of the force cell adds to every row of the load that it weighs, N.

    The pull that a load asks for is compared with what the cell read: what this shows too much is
    missing there.

    Args:
        force: correction of the force, of which the terms whose scale is one of `weighed` count.
    """
    made = np.zeros(int((grid.rows.block == BLOCKS.index("load")).sum()))
    for scale, read in weighed(grid).items():
        own = tuple(replace(t, scale="") for t in force.terms if t.scale == scale)
        made -= correction_at(grid, Correction("load", own), c) * read
    return made


def weighed(grid: Grid) -> dict[str, Array]:
    """What of an error of the force cell every row of the load shows, by scale.

    The share of its points at which a cell read it, and what it read there, N.
    """
    points = grid.points["load"]
    read = np.isfinite(points.reading).astype(np.float64)
    return {
        CELL: _means(points, read),
        CELL_GAIN: _means(points, np.nan_to_num(points.reading)),
    }


def flow_at(grid: Grid, correction: Correction, c: PlantConstants) -> Flow | None:
    """What a correction does to the simulation of the gas; None where it has no such term."""
    count = len(grid.points[correction.block].time_s)
    terms = [term for term in correction.terms if term.scale in IN_GAS]
    at = point_inputs_of(grid, correction.block, Correction(correction.block, tuple(terms)).inputs)
    made = {term.scale: np.zeros(count) for term in terms}
    for term in terms:
        made[term.scale] += term.splines(at, count)
    return Flow(made) if terms else None


@dataclass(frozen=True)
class Flow:
    """A flow into the chamber, and an error of its gauge, at every point of the pressure.

    Attributes:
        of: by scale of a term, mg/s, a share of a flow, ms or kPa, shape (points,) each.
    """

    of: Mapping[str, Array]

    def mg_s(self, grid: Grid, c: PlantConstants) -> Array:
        """All of it in mg/s, with the valve as the constants have it, shape (points,)."""
        through = valve_flows(grid, c)
        flows = {scale: x for scale, x in self.of.items() if scale != READING}
        parts = [x * through[scale] if scale in through else x for scale, x in flows.items()]
        return np.sum(parts, axis=0) if parts else np.zeros(len(grid.points["pressure"].time_s))

    def raised(self, grid: Grid, c: PlantConstants) -> Array:
        """Pressure in kPa by which it raises every row of a reading not simulated here."""
        made = risen(grid, self.mg_s(grid, c)[:, None], c)
        if READING in self.of:
            made = made + shown_too_much(grid, self.of[READING][:, None], c, followed=False)
        return np.asarray(made[:, 0])

    def push(self, grid: Grid, c: PlantConstants) -> Push:
        """What it does to the simulated gas and its valves."""
        points = grid.points["pressure"]
        zero = np.zeros(len(points.time_s))
        own = {scale: self.of.get(scale, zero) for scale in IN_GAS}
        whole = own[VALVE_FLOW]
        late = [
            1e-3 * np.sum([own[s] for s, parts in ALL_LATE.items() if one in parts], axis=0)
            for one in LATE
        ]
        valves = np.stack([own[INLET_FLOW] + whole, own[OUTLET_FLOW] + whole, *late])
        per = pressure_per_flow(np.clip(points.length, 1e-4, 0.999 * c.braid_length_m), c)
        flow = own[FLOW]
        if SHORT_PULSES in self.of:  # the simulated valve stays shut
            flow = flow + own[SHORT_PULSES] * short_pulses(grid, c)
        rate = 1e3 * flow * per
        # Where a trial begins nothing is known of the time before.
        step = np.r_[0.0, np.diff(points.time_s)]
        step[points.first[:-1][points.first[:-1] < len(step)]] = 0.0
        before = np.r_[0, np.arange(len(zero) - 1)]
        supply = 1e3 * own[SUPPLY]
        return Push(
            0.5 * step * (rate + rate[before]),
            np.ascontiguousarray(0.5 * (valves + valves[:, before])),
            1e3 * own[READING],
            0.5 * (supply + supply[before]),
        )


def risen(grid: Grid, flow: Array, c: PlantConstants, begun: Array | None = None) -> Array:
    """Pressure in kPa by which flows in mg/s into the chamber raise it at every row.

    Args:
        flow: at the points of the pressure, shape (points, flows).
        begun: what the pressure is raised by where each trial begins, kPa, of the same shape; only
            its values there count. By default nothing.

    As the prediction is drawn to the reading, so is what a flow adds to it; and through an open
    valve it passes away: a chamber at the pressure of its supply, or vented, keeps no surplus.
    """
    points = grid.points["pressure"]
    lost = _passing_away(grid, c)
    per = pressure_per_flow(np.clip(points.length, 1e-4, 0.999 * c.braid_length_m), c)
    step = np.r_[0.0, np.diff(points.time_s)]
    kept = np.exp(-step / FORGOTTEN_S - step * 0.5 * (lost + np.r_[0.0, lost[:-1]]))
    # What is gained in a step passes away from its middle on.
    gain = 0.5 * step * np.sqrt(kept)
    sums = np.zeros((int(points.row.max(initial=-1)) + 1, flow.shape[1]))
    start = np.zeros((len(points.first) - 1, flow.shape[1]))
    if begun is not None:
        full = np.diff(points.first) > 0
        start[full] = begun[points.first[:-1][full]]
    _rise(
        points.first, np.ascontiguousarray(flow), np.stack([per, gain, kept]), start, points.row,
        points.weight, sums,
    )  # fmt: skip
    return np.asarray(sums / points.row_weight[:, None])


def shown_too_much(grid: Grid, error: Array, c: PlantConstants, followed: bool) -> Array:
    """What errors of the gauge, in kPa, add to its predicted reading at every row, kPa.

    Args:
        error: at the points of the pressure, shape (points, errors).
        followed: whether the prediction is drawn to the reading, and so to the error: what it has
            followed of it, and not lost through an open valve, is no difference any more.
    """
    points = grid.points["pressure"]
    shown = np.stack([_means(points, own) for own in error.T], axis=1)
    if not followed:
        return shown
    per = pressure_per_flow(np.clip(points.length, 1e-4, 0.999 * c.braid_length_m), c)
    return np.asarray(shown - risen(grid, error / (FORGOTTEN_S * per)[:, None], c, error))


def _build_rise(sources: int) -> Callable[..., None]:
    vector = "float64[::1]"

    @entry_point(
        "void(int64[::1], float64[:, ::1], float64[:, ::1], float64[:, ::1], int64[::1], "
        f"{vector}, float64[:, ::1])"
    )
    def rise(
        first: Any, flow: Any, pace: Any, start: Any, row: Any, weight: Any, sums: Any
    ) -> None:
        if sources < 0:
            return
        per, gain, kept = pace
        state = np.empty(flow.shape[1])
        for t in range(len(first) - 1):
            state[:] = start[t]
            for k in range(first[t], first[t + 1]):
                for j in range(len(state)):
                    if k > first[t]:
                        rate = flow[k, j] * per[k] + flow[k - 1, j] * per[k - 1]
                        state[j] = state[j] * kept[k] + gain[k] * rate
                    sums[row[k], j] += weight[k] * state[j]

    return rise


_rise = _build_rise(fingerprint())


def _passing_away(grid: Grid, c: PlantConstants) -> Array:
    """Rate in 1/s at which a surplus of pressure leaves through the open valve, at every point."""
    points = grid.points["pressure"]
    per = pressure_per_flow(np.clip(points.length, 1e-4, 0.999 * c.braid_length_m), c)
    less = _open_shares(grid, c, risen_pa=_fitted(grid, c)) * _less_through(grid, c)
    return np.asarray(np.maximum(less.sum(axis=0) * per, 0.0))


def _less_through(grid: Grid, c: PlantConstants) -> Array:
    """Flow in mg/s that each valve, if open, passes less for each kPa of surplus in the gas.

    From what it passes on either side: at the pressure of the supply nothing flows back, but what
    is missing flows in.
    """
    fitted = _fitted(grid, c)
    less = _through(grid, c, -_SURPLUS_PA, fitted) - _through(grid, c, _SURPLUS_PA, fitted)
    return np.asarray(less / (2e-3 * _SURPLUS_PA))


def _fitted(grid: Grid, c: PlantConstants) -> float:
    """What the constants' supply is above the one that was read or stated, Pa."""
    return c.supply_pa - grid.data.constants.supply_pa


_SURPLUS_PA = 1e3


def valve_flows(grid: Grid, c: PlantConstants) -> dict[str, Array]:
    """Flows in mg/s into the chamber that a term is multiplied by, at every point, by scale.

    ISO 6358 with the constants' conductances; out of the chamber a flow is negative. The flow of a
    valve is what passes while it is open by the constants' delays; that of `LATE` is what passes
    more if it moves 1 ms later, those of `ALL_LATE` if all of theirs do, that of
    `SUPPLY` what the inlet passes more if the supply is 1 kPa higher; for `SHORT_PULSES` see
    `short_pulses`.
    """
    fitted = _fitted(grid, c)
    through = _through(grid, c, 0.0, fitted)
    share = _open_shares(grid, c, risen_pa=fitted)
    inlet, outlet = share * through
    made = {
        VALVE_FLOW: np.asarray(inlet + outlet),
        INLET_FLOW: np.asarray(inlet),
        OUTLET_FLOW: np.asarray(outlet),
    }
    for which, scale in enumerate(LATE):
        valve = which // 2
        later = _open_shares(grid, c, which, _LATER_S, risen_pa=fitted)[valve] - share[valve]
        made[scale] = np.asarray(later * through[valve] * 1e-3 / _LATER_S)
    for scale, parts in ALL_LATE.items():
        made[scale] = np.sum([made[one] for one in parts], axis=0)
    made[SHORT_PULSES] = short_pulses(grid, c)
    # A valve's delay depends on the pressure before it, too.
    sooner = _open_shares(grid, c, risen_pa=fitted + 1e3)[0] - share[0]
    made[SUPPLY] = share[0] * _more_from(grid, c, through[0]) + sooner * through[0]
    return made


def _more_from(grid: Grid, c: PlantConstants, inlet: Array) -> Array:
    """Flow in mg/s that an open inlet passes more for each kPa of its supply.

    Where both pressures rise by the same share, so does the flow (ISO 6358). What more supply does
    therefore follows from what less pressure of the gas does: the same slope as in
    `_passing_away`, so that a surplus ends where the gas has the pressure of its supply.
    """
    supply_kpa = 1e-3 * np.maximum(grid.supply + c.atmosphere_pa + _fitted(grid, c), 1.0)
    inside_kpa = 1e-3 * (grid.points["pressure"].pressure + c.atmosphere_pa)
    return np.asarray((inlet + inside_kpa * _less_through(grid, c)[0]) / supply_kpa)


def short_pulses(grid: Grid, c: PlantConstants) -> Array:
    """Flow in mg/s of the commands too short for their valve to move, at every point.

    What would pass if all edges acted, each after its delay, beyond what passes; 0 where they do.
    The supply is the one that was read or stated, as a muscle that such commands fill leads the
    fitted constants far astray.
    """
    more = _open_shares(grid, c, all_act=True) - _open_shares(grid, c)
    return np.asarray(np.sum(more * _through(grid, c, 0.0), axis=0))


_LATER_S = 1e-3
"""Time by which a valve is moved where a slope is taken."""


def _open_shares(
    grid: Grid, c: PlantConstants, late: int = -1, late_s: float = 0.0, all_act: bool = False,
    risen_pa: float = 0.0,
) -> Array:  # fmt: skip
    """Opening of inlet and outlet in the mean over the time around each point, shape (2, points).

    A valve acts after its delay; a command that has not acted yet when the next one comes is
    forgotten, unless the constants or `all_act` say that all edges act. `late` is the number of the
    delay that is longer by `late_s`; `risen_pa` is what the supply is above what was read or
    stated.
    """
    points = grid.points["pressure"]
    slots = nominal_slots(c)
    if late >= 0:
        slots[DELAY + late] += late_s
    made = np.zeros((2, len(points.time_s)))
    for own in _spans(points):
        trial = int(points.trial[own.start])
        time = points.time_s[own]
        middle = 0.5 * (time[1:] + time[:-1])
        ends = np.r_[time[0], middle, time[-1]]
        span = slice(int(grid.first_edge[trial]), int(grid.first_edge[trial + 1]))
        for valve in range(2):
            mine = grid.edge_of[span] == valve
            upstream = grid.supply[own] + risen_pa if valve == 0 else points.pressure[own]
            turns: list[tuple[float, float]] = []
            band = slots[DEAD_BAND + valve]
            command = 0.0
            for at, to in zip(grid.edge_s[span][mine], grid.edge_to[span][mine], strict=True):
                if to == command:
                    continue
                which = 2 * valve + (0 if to > command else 1)
                command = to
                pressure = float(np.interp(at, time, upstream))
                delay = slots[DELAY + which] + slots[DELAY_SLOPE + which] * pressure
                acts = float(at) + max(delay, 0.0)
                if slots[DELAY_MODE] == 0.0 and not all_act and turns and turns[-1][0] > at:
                    turns.pop()
                else:
                    turns.append((max(acts, turns[-1][0] if turns else acts), opening(to, band)))
            made[valve, own] = _share_open(turns, ends)
    return made


def _share_open(turns: list[tuple[float, float]], ends: Array) -> Array:
    """Mean opening of a valve over each span between `ends`; `turns` are instants and openings."""
    instants = np.array([at for at, _ in turns])
    state = np.r_[0.0, [to for _, to in turns]]
    if not len(instants):
        return np.zeros(len(ends) - 1)
    # Seconds for which it has been open at each turn, then at each end.
    sums = np.r_[0.0, np.cumsum(np.diff(instants) * state[1:-1])]
    last = np.searchsorted(instants, ends, side="right") - 1
    known = np.maximum(last, 0)
    open_s = np.where(last >= 0, sums[known] + state[1:][known] * (ends - instants[known]), 0.0)
    width = np.diff(ends)
    return np.asarray(np.diff(open_s) / np.where(width > 0.0, width, 1.0))


def _through(grid: Grid, c: PlantConstants, surplus_pa: float, risen_pa: float = 0.0) -> Array:
    """Flows in mg/s through inlet and outlet if open, shape (2, points).

    Args:
        surplus_pa: what the gas is above its reading.
        risen_pa: what the supply is above what was read or stated.
    """
    outside = c.atmosphere_pa
    inside = np.maximum(grid.points["pressure"].pressure + outside + surplus_pa, 1.0)
    supply = np.maximum(grid.supply + outside + risen_pa, 1.0)
    dense = 1e6 * REFERENCE_DENSITY_KG_M3
    inlet = c.inlet_conductance_m3_s_pa * supply * _factor(inside / supply, c.critical_ratio)
    outlet = c.outlet_conductance_m3_s_pa * inside * _factor(outside / inside, c.critical_ratio)
    # What holds a valve open is the pressure across it.
    inlet = np.where(supply - inside > c.inlet_closing_pa, inlet, 0.0)
    outlet = np.where(inside - outside > c.outlet_closing_pa, outlet, 0.0)
    return dense * np.stack([inlet, -outlet])


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
    is, and between for a proportional valve; `moves_<time>_mm` is how far the length moves within
    that time from now on, `moved_<time>_mm` how far it has within the time before: a camera that is
    late, or early, shows the length of another instant.
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


def waves_at(grid: Grid, block: str, name: str, period: float) -> Array:
    """Waves of an input in the mean over every row of a block, shape (rows, `WAVES`).

    A row that stands for some periods shows nothing of them; nor does one without time.
    """
    points = grid.points[block]
    own = wave_columns(point_inputs_of(grid, block, (name,))[name], period)
    made = np.stack([_means(points, column) for column in own.T], axis=1)
    if name in _TIMED:
        made[np.bincount(points.row, weights=points.settled) > 0.0] = 0.0
    return made


def scales_of(grid: Grid, block: str, c: PlantConstants) -> dict[str, Array]:
    """What the braid of constants `c` says at every row of a block: see `braid_scales`.

    "seen" is what the force errs by where the camera shows 1 mm too much: nothing where the length
    was held at a stated one. "cell_gain" is the pull, as far as a cell tells it.
    """
    here = grid.rows.block == BLOCKS.index(block)
    made = braid_scales(grid.rows.pressure[here], grid.rows.length[here], c)
    points = grid.points[block]
    read = _means(points, np.where(points.held, 0.0, 1.0))
    return made | {SEEN: np.asarray(-made["pull_per_mm"] * read), CELL_GAIN: made["pull"]}


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


def _moves(_grid: Grid, points: Points, after_s: float) -> Array:
    """How far in mm the length moves within a time from now on, or has within the time before.

    Args:
        after_s: the time; negative for that before.

    Beyond the ends of its trial it stands still.
    """
    made = np.zeros(len(points.time_s))
    for own in _spans(points):
        time, length = points.time_s[own], points.length[own] * 1e3
        made[own] = np.sign(after_s) * (np.interp(time + after_s, time, length) - length)
    return made


def _edges(grid: Grid, points: Points) -> tuple[Array, Array]:
    """Seconds since the last command's edge, and the inlet's command less the outlet's."""
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
        valve[own] = inlet[last + 1] - outlet[last + 1]
    return since, valve


def _openings(grid: Grid, points: Points) -> Array:
    """Commands to open a valve in the trial so far: a valve warms up, and sticks after a rest."""
    made = np.zeros(len(points.time_s))
    for t in np.unique(points.trial):
        own = points.trial == t
        span = slice(int(grid.first_edge[t]), int(grid.first_edge[t + 1]))
        opens = np.zeros(0)
        for side in (0, 1):
            mine = grid.edge_of[span] == side
            to = grid.edge_to[span][mine]
            opens = np.r_[opens, grid.edge_s[span][mine][(to > 0.0) & (np.r_[0.0, to[:-1]] == 0.0)]]
        opens.sort()
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
    **{name: partial(_moves, after_s=after_s) for name, after_s in SHIFTS_S.items()},
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
    "openings", *SHIFTS_S,
)  # fmt: skip
