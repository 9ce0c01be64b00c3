"""The measured tables of the thesis as rows of points, with notes about each."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from daq.errors import PamrigError
from plant.thesis import load

GRAVITY = 9.80665
"""m/s2. The thesis gives masses in C-6 and forces in C-3."""
EVEN = math.sqrt(3.0)
"""Half-width of a rectangular distribution divided by its standard deviation."""
STEP = math.sqrt(12.0)
"""Step of a printed number divided by its standard deviation."""

READING_51 = (
    "The heading of Table C-1 gives its shortest length as 51 mm; Tables C-2, C-8 to C-15 and C-19"
    " to C-32 give 51.45 mm, and only 51.45 mm reproduces the published coefficients. Here it is"
    " {length:g} mm."
)
FORMULA = (
    "formula, not measured: each of the 1344 cells above 21 °C follows from the 21 °C column by"
    " one factor"
)
NOISE = (
    "C-1 plus noise: the cells of Table C-2 differ from Table C-1 by at most 1.005 N, with a"
    " uniform distribution, so it is no independent test and does not confirm C-1"
)
STATED_NOTE = (
    "uncertainties are those stated in section 4.6.4 (± 5 kPa, ± 0.1 mm, ± 0.01 °C)"
    " taken as limits of a rectangular distribution; for the force only the step of the balance"
    " (0.001 g) is stated, so u_force_n includes only the rounding of the printed numbers"
)
CAMERA_NOTE = (
    "uncertainties are those stated in section 4.6.4 (± 5 kPa by the gauge, ± 0.05 mm by the"
    " camera) taken as limits of a rectangular distribution; the error of the load is not stated"
)
VALVE_NOTE = (
    "the thesis states no errors of these readings: pressures are taken as ± 5 kPa (the gauge of"
    " section 4.6.4), limits of a rectangular distribution; other uncertainties are those of"
    " rounding"
)


@dataclass(frozen=True)
class Source:
    """One thesis table that can be imported.

    Attributes:
        table: its name as printed.
        title: its contents.
        protocol: the test whose reduction and report are used.
        stated: standard uncertainties by column (``u_<column>``).
        rounding_only: columns whose stated uncertainty is only the rounding of the printed numbers:
            no result of a single point has an expanded uncertainty from it.
        rows: returns its points, one dict each, with ``columns`` and labels.
        columns: numbers of a point, in order.
        labels, notes: for the report.
    """

    table: str
    title: str
    protocol: str
    stated: dict[str, float]
    rows: Callable[[], list[dict[str, Any]]]
    columns: tuple[str, ...]
    labels: tuple[str, ...] = ()
    notes: tuple[str, ...] = field(default=())
    rounding_only: tuple[str, ...] = ()


def source(name: str) -> tuple[str, Source]:
    """The table with this name (``c01``, ``C-1``, ``d05``): (key, source).

    Raises:
        PamrigError: there is no such table, or it has no measured points.
    """
    key = name.lower().replace("-", "").replace("_", "")
    if key[:1] in ("c", "d") and key[1:].isdecimal():
        key = f"{key[0]}{int(key[1:]):02d}"
    key = ALIASES.get(key, key)
    if key not in SOURCES:
        raise PamrigError(
            f"thesis table {name}",
            "is not a table of measured points",
            f"tables that can be imported: {', '.join([*SOURCES, *ALIASES])}",
        )
    return key, SOURCES[key]


def _points(name: str, **common: Any) -> list[dict[str, Any]]:
    """The cells of a table, one point per printed row, with line, set pressure and repeat."""
    return [
        {"line": line, "repeat": 1, **cells, "set_pressure_kpa": cells["pressure_kpa"], **common}
        for line, cells in enumerate(load(name), start=2)
    ]


def _muscle(name: str) -> list[dict[str, Any]]:
    """C-1, C-2, C-4: force at held lengths."""
    rows = _points(name)
    for row in rows:
        cycle = f" cycle {row['cycle_max_kpa']:g}" if "cycle_max_kpa" in row else ""
        row.setdefault("temperature_c", 21.0)
        row.setdefault("direction", "single")
        row |= {"set_length_mm": row["length_mm"], "slot": f"L{row['length_mm']:g}{cycle}"}
    return rows


def _isobaric() -> list[dict[str, Any]]:
    return [{**row, "slot": f"P{row['pressure_kpa']:g}"} for row in _muscle("c02")]


def _isotonic() -> list[dict[str, Any]]:
    """C-3: lengths under loads, with headings in newton."""
    rows = _points("c03", temperature_c=21.0, direction="single")
    for row in rows:
        row |= {"mass_kg": float(row["force_n"]) / GRAVITY, "slot": f"{row['force_n']:g} N"}
    return rows


def _isotonic_hysteresis() -> list[dict[str, Any]]:
    """C-6: lengths under hung masses at rising and falling pressure."""
    rows = _points("c06", temperature_c=21.0)
    for row in rows:
        mass = float(str(row["mass_kg"]))
        slot = f"{mass:g} kg cycle {row['cycle_max_kpa']:g}"
        row |= {"mass_kg": mass, "force_n": mass * GRAVITY, "slot": slot}
    return rows


def _by_valve(name: str, unit: str) -> list[dict[str, Any]]:
    """D-1 to D-4: two points per printed row, one for each valve."""
    rows = []
    for cells in _points(name):
        for valve in ("inlet", "outlet"):
            row = {k: v for k, v in cells.items() if not k.startswith(("inlet_", "outlet_"))}
            row |= {
                "valve": valve,
                f"on_{unit}": cells[f"{valve}_on_{unit}"],
                f"off_{unit}": cells[f"{valve}_off_{unit}"],
                "slot": f"{valve} {cells['pressure_kpa']:g}",
            }
            rows.append(row)
    return rows


def _flow() -> list[dict[str, Any]]:
    rows = _points("d05", valve="outlet")
    for row in rows:
        row |= {"velocity_m_s": row["air_velocity_m_s"], "slot": f"{row['pressure_kpa']:g}"}
    return rows


_MUSCLE = ("pressure_kpa", "length_mm", "force_n", "temperature_c")
_GAUGE = {"u_pressure_kpa": 5.0 / EVEN}
_HELD = {**_GAUGE, "u_length_mm": 0.1 / EVEN, "u_temperature_c": 0.01 / EVEN}
_SEEN = {**_GAUGE, "u_length_mm": 0.05 / EVEN, "u_temperature_c": 0.01 / EVEN, "u_force_n": 0.0}

SOURCES = {
    "c01": Source(
        "C-1", "isometric test, force at 14 lengths and 16 pressures", "isometric",
        {**_HELD, "u_force_n": 0.001 / STEP}, lambda: _muscle("c01"), _MUSCLE,
        notes=(STATED_NOTE,), rounding_only=("force_n",),
    ),
    "c02": Source(
        "C-2", "isobaric test, force at 16 pressures and 14 lengths", "isobaric",
        {**_HELD, "u_force_n": 0.01 / STEP}, _isobaric, _MUSCLE,
        labels=("C-1 plus noise",), notes=(NOISE, STATED_NOTE), rounding_only=("force_n",),
    ),
    "c03": Source(
        "C-3", "isotonic test, length at 7 loads and 23 pressures", "isotonic",
        _SEEN, _isotonic, _MUSCLE,
        notes=(
            CAMERA_NOTE,
            "the headings of Table C-3 give loads in newton, section 4.6.2 mentions hung masses;"
            " newton is used",
        ),
    ),
    "c04": Source(
        "C-4", "isometric hysteresis, pressure up and down to 400 and 600 kPa", "hysteresis",
        {**_HELD, "u_force_n": 0.01 / STEP}, lambda: _muscle("c04"), _MUSCLE,
        notes=(STATED_NOTE,), rounding_only=("force_n",),
    ),
    "c06": Source(
        "C-6", "isotonic hysteresis, length with pressure up and down to 400 and 600 kPa",
        "hysteresis", _SEEN, _isotonic_hysteresis, _MUSCLE,
        notes=(
            CAMERA_NOTE,
            "the headings of Table C-6 are forces in newton; the columns are lengths in mm",
        ),
    ),
    "d01": Source(
        "D-1 to D-3", "switching times of both valves, three repeats", "switching-time",
        {**_GAUGE, "u_on_ms": 0.1 / STEP, "u_off_ms": 0.1 / STEP},
        lambda: _by_valve("d01", "ms"),
        ("pressure_kpa", "on_ms", "off_ms", "air_delay_ms"),
        notes=(
            VALVE_NOTE,
            "the tables have no unit; section 5.12 uses milliseconds",
            "the inlet's off times of Tables D-2 and D-3 are the same numbers, and so are the"
            " outlet's: off times have two repeats, not three",
            "the thesis does not state whether the printed times include the propagation delay to"
            " the sensor; they are used as printed. The tables give the delay as 1.016 ms, the text"
            " as 1.02 ms, and 62 mm at 65 m/s are 0.954 ms",
            "times are also printed at 0 kPa, where no air flows: a strain gauge on the line cannot"
            " have measured them",
        ),
        rounding_only=("on_ms", "off_ms"),
    ),
    "d04": Source(
        "D-4", "lowest voltages at which the valves switch", "switching-voltage",
        {**_GAUGE, "u_on_v": 0.05 / STEP, "u_off_v": 0.05 / STEP},
        lambda: _by_valve("d04", "v"), ("pressure_kpa", "on_v", "off_v"),
        notes=(VALVE_NOTE, "outlet off at 0 kPa: 0.7 V here, 0.75 V in section 5.11.1"),
        rounding_only=("on_v", "off_v"),
    ),
    "d05": Source(
        "D-5", "air velocity behind the valve against pressure", "flow",
        {**_GAUGE, "u_velocity_m_s": 1.0 / STEP}, _flow, ("pressure_kpa", "velocity_m_s"),
        notes=(
            VALVE_NOTE,
            "the table has no units: kPa and, from the text, m/s; the bore of the meter and the"
            " valve are not stated",
        ),
        rounding_only=("velocity_m_s",),
    ),
}  # fmt: skip

ALIASES = {"c05": "c04", "c07": "c06", "d02": "d01", "d03": "d01"}
"""C-5 and C-7 are differences of C-4 and C-6, which their reports recompute. D-1 to D-3 are one
test with three repeats."""
