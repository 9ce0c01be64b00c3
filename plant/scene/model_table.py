"""A model of `plant.models` as a table for compiled code.

Pressure and length are divided into cells. In each cell the force is a bicubic polynomial that
equals the model in sixteen points. Laws of degree 3 or less in both variables (Chou and Hannaford,
Tondu and Lopez, the polynomials of the thesis) are exact up to rounding. Cell boundaries lie at 125
and 150 kPa, where the two-region models of the thesis have a kink.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plant.arrays import Array
from plant.constants import PlantConstants
from plant.errors import PlantError
from plant.models.memory import CREEP_S, PLAY_KPA, SLIP_UM, Creep, MaxwellSlip, PrandtlIshlinskii
from plant.models.model import Model
from plant.physics.muscle import braid_volume
from plant.scene import layout as sc

CELL_PA = 12.5e3
CELL_M = 1e-3
LOWEST_PA = -25e3
HIGHEST_PA = 800e3
MARGIN_M = 3e-3
"""Range of the table beyond the stops."""
_INSIDE = np.array([0.0, 1.0, 2.0, 3.0]) / 3.0
# Matrix from the values in four points of a cell to the coefficients of the cubic.
_TO_COEFFICIENTS = np.linalg.inv(np.vander(_INSIDE, 4, increasing=True))


@dataclass(frozen=True)
class ModelTable:
    """`force` (cells in pressure, cells in length, 16), `volume` (cells in length, 4), `axes` (6).

    `error_n` is the largest difference to the model in points off the grid; `memory` holds the
    columns of a unit's shape for a model with memory.
    """

    name: str
    force: Array
    volume: Array
    axes: Array
    error_n: float
    memory: Array


def model_table(model: Model, c: PlantConstants, temperature_c: float = 21.0) -> ModelTable:
    """Tabulate a model over the pressures and lengths of a bench.

    A model of the form p f(L) + g(L) has its own gas volume, that of its measured geometry at the
    rest length; without a geometry it is set equal to the braid's volume in the middle of the
    range. Otherwise the gas volume is that of the bench's braid.

    Raises:
        PlantError: the model has no value somewhere in the range.
    """
    low, high = c.length_min_m - MARGIN_M, min(c.length_max_m + MARGIN_M, c.braid_length_m)
    rows = round((HIGHEST_PA - LOWEST_PA) / CELL_PA)
    columns = max(4, round((high - low) / CELL_M))
    width = (high - low) / columns
    base, memory = _without_memory(model)

    def force(p: Array, length: Array) -> Array:
        with np.errstate(invalid="ignore", divide="ignore"):
            t = np.full(p.size, temperature_c)
            out = base(p.ravel(), length.ravel(), t).reshape(p.shape)
        if not np.isfinite(out).all():
            at = int(np.flatnonzero(~np.isfinite(out.ravel()))[0])
            raise PlantError(
                f"model {model.name} has no value at {p.ravel()[at] / 1e3:g} kPa and "
                f"{length.ravel()[at] * 1e3:g} mm, within the range of this bench; reduce "
                "the range length_min_mm to length_max_mm, or use another model"
            )
        return np.asarray(out)

    p_nodes = (LOWEST_PA + CELL_PA * (np.arange(rows)[:, None] + _INSIDE)).ravel()
    l_nodes = (low + width * (np.arange(columns)[:, None] + _INSIDE)).ravel()
    values = force(*np.meshgrid(p_nodes, l_nodes, indexing="ij")).reshape(rows, 4, columns, 4)
    to = _TO_COEFFICIENTS
    cells = np.einsum("ap,ipjl,bl->ijab", to, values, to).reshape(rows, columns, 16)
    volume = _volume(model, c, l_nodes).reshape(columns, 4) @ to.T
    axes = np.array([LOWEST_PA, CELL_PA, low, width, 0.0, 0.0])
    table = np.ascontiguousarray(cells)
    off_p = LOWEST_PA + CELL_PA * (np.arange(0, rows, 3)[:, None] + np.array([0.21, 0.83])).ravel()
    off_l = low + width * (np.arange(columns)[:, None] + np.array([0.13, 0.55])).ravel()
    grid = np.meshgrid(off_p, off_l, indexing="ij")
    error = float(np.abs(table_force(table, axes, *grid) - force(*grid)).max())
    return ModelTable(model.name, table, np.ascontiguousarray(volume), axes, error, memory)


def table_force(table: Array, axes: Array, p: Array, length: Array) -> Array:
    """Force from the table in plain numpy, the same calculation as in the kernel."""
    i = np.clip(((p - axes[0]) / axes[1]).astype(int), 0, table.shape[0] - 1)
    j = np.clip(((length - axes[2]) / axes[3]).astype(int), 0, table.shape[1] - 1)
    u, v = (p - axes[0]) / axes[1] - i, (length - axes[2]) / axes[3] - j
    cells = table[i, j].reshape(*i.shape, 4, 4)
    powers_u, powers_v = (np.stack([x**k for k in range(4)], -1) for x in (u, v))
    return np.asarray(np.einsum("...a,...ab,...b", powers_u, cells, powers_v))


def _without_memory(model: Model):  # type: ignore[no-untyped-def]
    """The static force law of a model, and its memory operators as columns of a unit's shape."""
    law, q = model.law, model.q
    shape = np.zeros(sc.SHAPE_SIZE)
    if not isinstance(law, (PrandtlIshlinskii, MaxwellSlip, Creep)):
        if law.memory:
            raise PlantError(f"model {model.name}: its type of memory cannot be simulated")
        return (lambda p, length, t: law.force(q, p, length, t)), shape
    count = len(law.base.parameters)
    if isinstance(law, PrandtlIshlinskii):
        kind, widths = sc.PLAY, np.array(PLAY_KPA) * 1e3
    elif isinstance(law, MaxwellSlip):
        kind, widths = sc.STOP, np.array(SLIP_UM) * 1e-6
    else:
        kind, widths = sc.LATE, np.array(CREEP_S)
    weights = q[count:]
    shape[sc.MEMORY_KIND] = kind
    shape[sc.MEMORY_WEIGHT : sc.MEMORY_WEIGHT + len(weights)] = weights
    shape[sc.MEMORY_WIDTH : sc.MEMORY_WIDTH + len(widths)] = widths
    base = law.base
    return (lambda p, length, t: base.force(q[:count], p, length, t)), shape


def _volume(model: Model, c: PlantConstants, length: Array) -> Array:
    middle = 0.5 * (c.length_min_m + c.length_max_m)
    if model.law.separable and model.geometry is not None:
        return model.volume(length)
    if model.law.separable:
        anchor = float(braid_volume(middle, c.braid_length_m, c.turns))
        return model.volume(length, middle, anchor)
    return np.asarray(braid_volume(length, c.braid_length_m, c.turns))
