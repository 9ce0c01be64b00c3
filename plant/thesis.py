"""The tables of the 1996 thesis, as printed, shipped with the package.

    rows = load("c01")            # [{"pressure_kpa": 0, "length_mm": 51, ...}, ...]
    columns = array("c01")        # {"pressure_kpa": array([...]), ...}

The tables are not corrected: `data/ANOMALIES.md` lists doubtful entries. The first length of C-1 is
printed as 51 but was 51.45 mm (A01 there).
"""

from __future__ import annotations

import csv
from functools import cache
from importlib import resources
from typing import Any

import numpy as np
import numpy.typing as npt

from plant.errors import PlantError

Cell = int | float | str | None


def tables() -> tuple[str, ...]:
    """Names of all shipped tables, e.g. "c01_isometric", sorted."""
    folder = resources.files("plant.data")
    names = (entry.name for entry in folder.iterdir() if entry.name.endswith(".csv"))
    return tuple(sorted(name.removesuffix(".csv") for name in names))


def load(name: str) -> list[dict[str, Cell]]:
    """Rows of a table: numbers parsed, text unchanged, blank cells None.

    `name` is a name from `tables()` or its beginning ("c01"). If a table has a companion
    ("..._mean"), the beginning selects the table. Raises `PlantError` if no table or several match.
    """
    return [dict(row) for row in _rows(_resolve(name))]


def array(name: str) -> dict[str, npt.NDArray[Any]]:
    """Columns of a table: float64 if every cell is a number or blank (nan), else str."""
    rows = _rows(_resolve(name))
    columns: dict[str, npt.NDArray[Any]] = {}
    for column in rows[0]:
        cells = [row[column] for row in rows]
        if any(isinstance(cell, str) for cell in cells):
            columns[column] = np.array(["" if cell is None else str(cell) for cell in cells])
        else:
            columns[column] = np.array([np.nan if cell is None else cell for cell in cells], float)
    return columns


def anomalies() -> str:
    """List of doubtful entries in the tables, as Markdown."""
    return resources.files("plant.data").joinpath("ANOMALIES.md").read_text(encoding="utf-8")


def _resolve(name: str) -> str:
    known = tables()
    if name in known:
        return name
    fitting = [table for table in known if table.startswith(name)] if name else []
    # A table and its companions ("..._mean") have the same beginning: take the table.
    if fitting and all(table.startswith(fitting[0]) for table in fitting):
        return fitting[0]
    if fitting:
        raise PlantError(f"thesis table {name!r} is ambiguous: {' or '.join(fitting)}")
    raise PlantError(f"thesis table {name!r} is not shipped; known: {', '.join(known)}")


@cache
def _rows(name: str) -> tuple[dict[str, Cell], ...]:
    text = resources.files("plant.data").joinpath(f"{name}.csv").read_text(encoding="utf-8")
    reader = csv.DictReader(text.splitlines())
    return tuple({key: _cell(value) for key, value in row.items()} for row in reader)


def _cell(text: str | None) -> Cell:
    text = (text or "").strip()
    if not text:
        return None
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text
