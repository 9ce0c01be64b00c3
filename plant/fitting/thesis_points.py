"""Tables of the thesis as settled points."""

from __future__ import annotations

from typing import Any

import numpy as np

from plant.arrays import Array
from plant.errors import PlantError
from plant.fitting.data import Points
from plant.models.law import History
from plant.thesis import array

SHORTEST_MM = 51.45
"""The length with heading 51 in C-1 (A01); this value reproduces the thesis's coefficients."""
G_M_S2 = 9.80665
TABLES = ("c01", "c02", "c03", "c04", "c06")
"""Tables with pressure, length and force."""


def thesis_points(name: str, warm: bool = False) -> Points:
    """Settled points of C-1, C-2, C-3, C-4 or C-6.

    `warm` includes the columns above 21 °C of C-1 and C-2, which are a formula (A02) or that
    formula plus noise (A06). Raises `PlantError` for another table.
    """
    if name not in TABLES:
        raise PlantError(
            f"thesis table {name!r} has no settled points; these have: {', '.join(TABLES)}"
        )
    columns = array(name)
    pressure, start = columns["pressure_kpa"], None
    if "mass_kg" in columns:
        columns["force_n"] = columns["mass_kg"] * G_M_S2
    length, force = columns["length_mm"], columns["force_n"]
    temperature = columns.get("temperature_c", np.full(pressure.size, 21.0))
    use = np.isfinite(force) & np.isfinite(length) & (warm | (temperature == 21.0))
    if name == "c01":
        length = np.where(length == 51.0, SHORTEST_MM, length)
    order = np.flatnonzero(use)
    if "direction" in columns:
        order, start = _cycles(columns, use)
    given = (pressure, length, temperature, force)
    picked = [np.asarray(a[order], dtype=np.float64) for a in given]
    cells = [f"{p:g} kPa {x:g} mm {t:g} °C" for p, x, t, _ in zip(*picked, strict=True)]
    source = f"thesis table {name[0].upper()}-{int(name[1:])}"
    if name in ("c01", "c02"):
        source += " at 21 to 39 °C" if warm else " at 21 °C"
    return Points(
        pressure_pa=picked[0] * 1e3,
        length_m=picked[1] * 1e-3,
        temperature_c=picked[2],
        force_n=picked[3],
        # With a given load the force is not measured, so there are no repeated readings.
        cell=np.array(cells) if name in ("c01", "c02", "c04") else None,
        path=None if start is None else History(None, start),
        source=source,
    )


def _cycles(columns: dict[str, Any], use: Any) -> tuple[Any, Any]:
    """Rows in the order of measurement: each cycle up, then down."""
    held = "length_mm" if "mass_kg" not in columns else "mass_kg"
    pressure: Array = columns["pressure_kpa"]
    down = columns["direction"] == "down"
    climb = np.where(down, -pressure, pressure)
    order = np.lexsort((climb, down, columns["cycle_max_kpa"], columns[held]))
    order = order[use[order]]
    trial = [(columns[held][k], columns["cycle_max_kpa"][k]) for k in order]
    start = np.array([k == 0 or trial[k] != trial[k - 1] for k in range(len(order))])
    return order, start
