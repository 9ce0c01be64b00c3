"""Checks of imported columns and values: other units and typing errors."""

from __future__ import annotations

import difflib
import math
import re
from typing import Any

from daq.errors import PamrigError

REQUIRED = ("pressure_kpa", "length_mm", "force_n")
"""Required quantities of an isometric point."""

NUMBERS = (
    *REQUIRED,
    "temperature_c",
    "u_pressure_kpa",
    "u_length_mm",
    "u_force_n",
    "u_temperature_c",
    "set_pressure_kpa",
    "set_length_mm",
)
LABELS = ("trial", "slot", "replicate", "repeat", "mounting", "direction", "order")
"""`repeat` and `replicate` are one label; `repeat` comes later, so it is kept where both occur:
it can number the points of one trial, and `replicate` cannot."""
SLACK = "slack"
"""Column that is true where the muscle hangs loose: its force of 0 is no measurement."""
TRUTHS = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False, "": False}
TRIAL_COLUMNS = (
    "trial", "slot", "replicate", "protocol", "mounting", "order", "held_length_mm", "load_kg",
    "temperature_c", "start_s", "note",
)  # fmt: skip
DIRECTIONS = ("up", "down", "single", "")

SENSOR_RANGE = {
    "pressure_kpa": (0.0, 1000.0),
    "set_pressure_kpa": (0.0, 1000.0),
    "force_n": (-50.0, 200.0),
    "length_mm": (10.0, 200.0),
    "set_length_mm": (10.0, 200.0),
    "held_length_mm": (10.0, 200.0),
    "temperature_c": (10.0, 60.0),
}
"""Ranges of the sensors of the bench. Ten times beyond them another unit is assumed, except in
``HARD_CEILING`` and ``HARD_FLOOR``."""

HARD_CEILING = {"force_n": 10e3}
"""Industrial muscles of 40 mm pull 6000 N."""

HARD_FLOOR = {"pressure_kpa": -101.325, "set_pressure_kpa": -101.325, "temperature_c": -273.15}

_QUANTITY = re.compile(
    r"^(u_|set_|held_)?(pressure|length|force|temperature|load|mass|weight|p|f|l)"
    r"([_ \[(].*)?$",
    re.IGNORECASE,
)
_CONVERT = {
    "bar": "1 bar = 100 kPa",
    "mbar": "1 mbar = 0.1 kPa",
    "psi": "1 psi = 6.89476 kPa",
    "mpa": "1 MPa = 1000 kPa",
    "pa": "1 Pa = 0.001 kPa",
    "kgf": "1 kgf = 9.80665 N",
    "kg": "1 kg pulls with 9.80665 N",
    "g": "1 g pulls with 0.00980665 N",
    "cm": "1 cm = 10 mm",
    "m": "1 m = 1000 mm",
    "in": "1 inch = 25.4 mm",
    "inch": "1 inch = 25.4 mm",
    "k": "degC = K - 273.15",
    "f": "degC = (degF - 32) / 1.8",
}
_TARGET = {
    "pressure": "pressure_kpa",
    "p": "pressure_kpa",
    "length": "length_mm",
    "l": "length_mm",
    "force": "force_n",
    "f": "force_n",
    "load": "force_n",
    "mass": "force_n",
    "weight": "force_n",
    "temperature": "temperature_c",
}


def number(cell: Any, name: str, line: int, column: str, outside: dict[str, list[int]]) -> float:
    """The cell as a number, NaN if empty. Values outside the sensor range are added to ``outside``.

    Raises:
        PamrigError: it is not a number, or far outside the range of the sensor.
    """
    where = f"{name} row {line} column {column}"
    if cell is None or cell == "":
        return math.nan
    try:
        if isinstance(cell, bool) or "_" in str(cell):
            raise ValueError
        value = float(cell)
    except (TypeError, ValueError):
        remedy = "write numbers with a decimal point and without a unit"
        raise PamrigError(where, f"expected a number, got {str(cell)[:40]!r}", remedy) from None
    if math.isnan(value):
        return math.nan
    if math.isinf(value):
        raise PamrigError(where, f"expected a finite number, got {cell!r}", "leave it empty")
    if column.startswith("u_"):
        if value < 0:
            raise PamrigError(where, f"an uncertainty cannot be negative: {value:g}", "correct it")
        return value
    low, high = SENSOR_RANGE[column]
    floor = HARD_FLOOR.get(column, 10.0 * low if low < 0 else low / 10.0)
    if value > HARD_CEILING.get(column, 10.0 * high) or value < floor:
        unit = column.rsplit("_", 1)[1]
        raise PamrigError(
            where,
            f"{value:g} is far outside the sensor range of {low:g} to {high:g} {unit}",
            f"if it has another unit, convert it to {unit}; otherwise clear the cell",
        )
    if not low <= value <= high:
        outside.setdefault(column, []).append(line)
    return value


def truth(cell: Any, name: str, line: int, column: str) -> bool:
    """The cell as true or false; empty is false.

    Raises:
        PamrigError: it is neither.
    """
    text = "" if cell is None else str(cell).strip().lower()
    if text not in TRUTHS:
        raise PamrigError(
            f"{name} row {line} column {column}",
            f"expected true or false, got {str(cell)[:40]!r}",
            "leave it empty for false",
        )
    return TRUTHS[text]


def check_columns(columns: list[str], name: str, known: tuple[str, ...]) -> list[str]:
    """Raise PamrigError for other units and time series; returns a note on ignored columns."""
    ignored = []
    for column in columns:
        if column in known:
            continue
        if re.match(r"^(time|t)([_ \[(].*)?$", column, re.IGNORECASE):
            raise PamrigError(
                f"{name} column {column}",
                "this is a time series, expected a table of settled points",
                "reduce it to settled points first: one row per point, without time",
            )
        match = _QUANTITY.match(column)
        if match and column not in TRIAL_COLUMNS:
            target = (match[1] or "").lower().replace("held_", "") + _TARGET[match[2].lower()]
            unit = re.sub(r"[^a-z]", "", (match[3] or "").lower())
            given = "has no unit in its name" if not unit else "looks like another unit"
            rule = f" ({_CONVERT[unit]})" if unit in _CONVERT else ""
            raise PamrigError(
                f"{name} column {column}",
                f"{given}, expected {target}",
                f"convert the values{rule} and name the column {target}",
            )
        ignored.append(column)
    return [f"columns not used: {', '.join(ignored)}"] if ignored else []


def check_required(columns: list[str], name: str, trials: dict[str, dict[str, Any]]) -> None:
    """Raise PamrigError if a required column is missing; suggests a similar name."""
    held = any(row.get("held_length_mm") not in (None, "") for row in trials.values())
    for column in REQUIRED:
        if column in columns or (column == "length_mm" and held):
            continue
        close = difflib.get_close_matches(column, columns, n=1, cutoff=0.6)
        remedy = f"rename {close[0]!r}?" if close else f"found: {', '.join(columns)}"
        raise PamrigError(f"{name} column {column}", "is missing", remedy)
