"""Compiled force, volume and stiffness of one unit of a scene.

A braid uses the functions of the single bench (`plant.simulator.rates`), a model of `plant.models`
uses its table, and a cylinder the area of its piston.
"""

from __future__ import annotations

import math

from plant.arrays import Array
from plant.compiled import inlined
from plant.physics import layout as at
from plant.physics import muscle
from plant.scene import layout as sc
from plant.simulator import hooks
from plant.simulator.rates import (
    added_damping,
    added_stiffness,
    chamber,
    tension,
)

_braid_slope = inlined(muscle.braid_force_slope)
_braid_volume_slope = inlined(muscle.braid_volume_slope)


@inlined
def _cell(value: float, low: float, width: float, count: int) -> tuple[int, float]:
    """Index of a cell of an axis, and position in it (0 to 1; beyond that outside the axis)."""
    place = (value - low) / width
    cell = min(max(int(place), 0), count - 1)
    return cell, place - cell


@inlined
def _table_force(tables: Array, axes: Array, row: int, p: float, length: float) -> float:
    i, u = _cell(p, axes[row, 0], axes[row, 1], tables.shape[1])
    j, v = _cell(length, axes[row, 2], axes[row, 3], tables.shape[2])
    total = 0.0
    for a in range(3, -1, -1):
        c = 4 * a
        inner = tables[row, i, j, c + 3]
        inner = inner * v + tables[row, i, j, c + 2]
        inner = inner * v + tables[row, i, j, c + 1]
        inner = inner * v + tables[row, i, j, c]
        total = total * u + inner
    return total


@inlined
def _table_volume(volumes: Array, axes: Array, row: int, length: float) -> tuple[float, float]:
    """Volume in m3 and its slope in m2."""
    j, v = _cell(length, axes[row, 2], axes[row, 3], volumes.shape[1])
    c0, c1 = volumes[row, j, 0], volumes[row, j, 1]
    c2, c3 = volumes[row, j, 2], volumes[row, j, 3]
    volume = ((c3 * v + c2) * v + c1) * v + c0
    return volume, ((3.0 * c3 * v + 2.0 * c2) * v + c1) / axes[row, 3]


@inlined
def gas_volume(w: sc.World, k: int, length: float) -> float:
    """Gas volume of unit `k` with its line and fittings, m3."""
    if w.kinds[k] == sc.BRAID:
        return chamber(w.params[k], length)
    if w.kinds[k] == sc.TABLE:
        volume, _ = _table_volume(w.volumes, w.axes, int(w.shape[k, sc.TABLE_ROW]), length)
        return float(volume + w.params[k, at.DEAD_VOLUME])
    return float(w.shape[k, sc.AREA] * length + w.params[k, at.DEAD_VOLUME])


@inlined
def volume_slope(w: sc.World, k: int, length: float) -> float:
    """dV/dL of unit `k` in m2."""
    if w.kinds[k] == sc.BRAID:
        return _braid_volume_slope(length, w.params[k, at.BRAID_LENGTH], w.params[k, at.TURNS])
    if w.kinds[k] == sc.TABLE:
        _, slope = _table_volume(w.volumes, w.axes, int(w.shape[k, sc.TABLE_ROW]), length)
        return slope
    return float(w.shape[k, sc.AREA])


@inlined
def _memory(w: sc.World, k: int, p: float, length: float, base: float) -> float:
    """Force of the memory operators after a change from their present states, N."""
    kind = w.shape[k, sc.MEMORY_KIND]
    total = 0.0
    for i in range(sc.MEMORY_SIZE):
        weight = w.shape[k, sc.MEMORY_WEIGHT + i]
        if weight != 0.0:
            width = w.shape[k, sc.MEMORY_WIDTH + i]
            past = w.shape[k, sc.MEMORY_STATE + i]
            if kind == sc.PLAY:
                total += weight * (max(p - width, min(p + width, past)) - p)
            elif kind == sc.STOP:
                moved = past + length - w.units[k, at.LENGTH]
                total += weight * max(-width, min(width, moved))
            else:
                total += weight * (past - base)
    return total


@inlined
def unit_force(w: sc.World, k: int, p: float, length: float, rate: float) -> float:
    """Tensile force of unit `k` in N at gauge pressure `p`, starting from its accepted state.

    A cylinder pushes: its force is negative. A tendon cannot push: its force is at least 0.
    """
    state, params = w.units[k], w.params[k]
    if w.kinds[k] == sc.BRAID:
        pull = tension(state, params, p, length, rate)
    elif w.kinds[k] == sc.TABLE:
        pull = _table_force(w.tables, w.axes, int(w.shape[k, sc.TABLE_ROW]), p, length)
        if w.shape[k, sc.MEMORY_KIND] != sc.NO_MEMORY:
            pull += _memory(w, k, p, length, pull)
    else:
        return float(-p * w.shape[k, sc.AREA])
    if w.shape[k, sc.PULLS_ONLY] != 0.0:
        return max(pull, 0.0)
    return pull


@inlined
def link_drag(w: sc.World, k: int, length: float) -> float:
    """Friction in the joint or slide that unit `k` pulls on, as a force along the unit, N."""
    return float(hooks.drag(0.0, w.units[k], w.params[k], length))


@inlined
def unit_damping(w: sc.World, k: int) -> float:
    """Largest change of the force of unit `k` with its speed, N s/m."""
    params = w.params[k]
    if w.kinds[k] != sc.BRAID or params[at.FORCE_EFFECTS] == 0.0:
        return 0.0
    return added_damping(params, w.units[k, at.PRESSURE], w.units[k, at.LENGTH_RATE])


@inlined
def unit_stiffness(w: sc.World, k: int, absolute: float, volume: float) -> float:
    """Stiffness of unit `k` along its length with closed valves, N/m, at least 0."""
    state, params = w.units[k], w.params[k]
    length = state[at.LENGTH]
    area = volume_slope(w, k, length)
    stiffness = params[at.EXPONENT] * absolute * area * area / volume
    if w.kinds[k] == sc.BRAID:
        stiffness += abs(_braid_slope(state[at.PRESSURE], length, params[at.TURNS]))
        if params[at.FORCE_EFFECTS] != 0.0:
            stiffness += added_stiffness(params, state[at.PRESSURE], length)
    elif w.kinds[k] == sc.TABLE:
        p, row = state[at.PRESSURE], int(w.shape[k, sc.TABLE_ROW])
        span = 1e-4
        further = _table_force(w.tables, w.axes, row, p, length + span)
        stiffness += abs(further - _table_force(w.tables, w.axes, row, p, length)) / span
        if w.shape[k, sc.MEMORY_KIND] == sc.STOP:
            for i in range(sc.MEMORY_SIZE):
                stiffness += abs(w.shape[k, sc.MEMORY_WEIGHT + i])
    return float(stiffness)


@inlined
def remember(w: sc.World, k: int, p: float, length: float, lasted: float) -> None:
    """Update the memory operators for an accepted step; call before the state is updated."""
    kind = w.shape[k, sc.MEMORY_KIND]
    base = 0.0
    if kind == sc.LATE:
        row = int(w.shape[k, sc.TABLE_ROW])
        base = _table_force(w.tables, w.axes, row, p, length)
    for i in range(sc.MEMORY_SIZE):
        slot = sc.MEMORY_STATE + i
        width = w.shape[k, sc.MEMORY_WIDTH + i]
        past = w.shape[k, slot]
        if kind == sc.PLAY:
            w.shape[k, slot] = max(p - width, min(p + width, past))
        elif kind == sc.STOP:
            moved = past + length - w.units[k, at.LENGTH]
            w.shape[k, slot] = max(-width, min(width, moved))
        elif width > 0.0:
            w.shape[k, slot] = base + (past - base) * math.exp(-lasted / width)
