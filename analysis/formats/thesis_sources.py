"""The measured tables of the thesis as rows of points, with what is to be known about each."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from daq.errors import PamrigError
from plant.thesis import load

GRAVITY = 9.80665
"""m/s2; the thesis gives masses in C-6 and forces in C-3."""
EVEN = math.sqrt(3.0)
"""Half-width of an even spread over its standard deviation."""
STEP = math.sqrt(12.0)
"""Step of a printed number over its standard deviation."""

READING_51 = (
    "Table C-1 heads its shortest length 51 mm; Tables C-2, C-8 to C-15 and C-19 to C-32 say"
    " 51.45 mm, and only 51.45 mm reproduces the published coefficients. It is taken as"
    " {length:g} mm here."
)
FORMULA = (
    "formula, not measured: the columns above 21 °C follow from the 21 °C column by one"
    " factor a cell in every one of their 1344 cells"
)
NOISE = (
    "C-1 plus noise: no cell of Table C-2 differs from Table C-1 by more than 1.005 N, evenly"
    " spread, so it is no independent test and confirms nothing about C-1"
)
STATED_NOTE = (
    "uncertainties are those stated in section 4.6.4 (± 5 kPa, ± 0.1 mm, ± 0.01 °C)"
    " read as limits of an even spread; of the force only the scale's step (0.001 g) is stated,"
    " so u_force_n holds no more than the rounding of the printed numbers"
)
CAMERA_NOTE = (
    "uncertainties are those stated in section 4.6.4 (± 5 kPa by the gauge, ± 0.05 mm by the"
    " camera) read as limits of an even spread; the load is as hung, its error is not stated"
)
VALVE_NOTE = (
    "of these readings the thesis states no error: pressures are taken as ± 5 kPa (the gauge of"
    " section 4.6.4) read as limits of an even spread, the rest as the rounding of the printed"
    " numbers"
)


@dataclass(frozen=True)
class Source:
    """One thesis table that can be imported.

    Attributes:
        table: its name as printed.
        title: what it holds.
        protocol: the test it came from: its reduction and its report.
        stated: standard uncertainties by column (``u_<column>``).
        rows: makes its points: columns of ``columns`` and labels, one dict a point.
        columns: numbers of a point, in order.
        labels, notes: as the report shows them.
    """

    table: str
    title: str
    protocol: str
    stated: dict[str, float]
    rows: Callable[[], list[dict[str, Any]]]
    columns: tuple[str, ...]
    labels: tuple[str, ...] = ()
    notes: tuple[str, ...] = field(default=())


def source(name: str) -> tuple[str, Source]:
    """The table of that name (``c01``, ``C-1``, ``d05``): (key, source).

    Raises:
        PamrigError: no such table, or it holds nothing measured.
    """
    key = name.lower().replace("-", "").replace("_", "")
    if key[:1] in ("c", "d") and key[1:].isdecimal():
        key = f"{key[0]}{int(key[1:]):02d}"
    key = ALIASES.get(key, key)
    if key not in SOURCES:
        raise PamrigError(
            f"thesis table {name}",
            "is not one of measured points",
            f"those that can be imported: {', '.join([*SOURCES, *ALIASES])}",
        )
    return key, SOURCES[key]


def _muscle(name: str) -> list[dict[str, Any]]:
    """C-1, C-2, C-4: force at held lengths."""
    rows = []
    for line, cells in enumerate(load(name), start=2):
        row = {k: cells[k] for k in ("pressure_kpa", "length_mm", "force_n")}
        cycle = f" cycle {cells['cycle_max_kpa']:g}" if "cycle_max_kpa" in cells else ""
        row.update(
            line=line,
            temperature_c=cells.get("temperature_c", 21.0),
            direction=cells.get("direction", "single"),
            cycle_max_kpa=cells.get("cycle_max_kpa"),
            set_pressure_kpa=row["pressure_kpa"],
            set_length_mm=row["length_mm"],
            slot=f"L{row['length_mm']:g}{cycle}",
            repeat=2 if cycle.endswith("400") else 1,
        )
        rows.append(row)
    return rows


def _isobaric() -> list[dict[str, Any]]:
    rows = _muscle("c02")
    for row in rows:
        row["slot"] = f"P{row['pressure_kpa']:g}"
    return rows


def _hysteresis() -> list[dict[str, Any]]:
    rows = _muscle("c04")
    for row in rows:
        row["repeat"] = 1
    return rows


def _isotonic() -> list[dict[str, Any]]:
    """C-3: lengths under loads that are headed in newton."""
    rows = []
    for line, cells in enumerate(load("c03"), start=2):
        row: dict[str, Any] = {k: cells[k] for k in ("pressure_kpa", "length_mm", "force_n")}
        row.update(
            line=line,
            temperature_c=21.0,
            direction="single",
            mass_kg=float(row["force_n"]) / GRAVITY,
            set_pressure_kpa=row["pressure_kpa"],
            slot=f"{row['force_n']:g} N",
            repeat=1,
        )
        rows.append(row)
    return rows


def _isotonic_hysteresis() -> list[dict[str, Any]]:
    """C-6: lengths under hung masses, up and down."""
    rows = []
    for line, cells in enumerate(load("c06"), start=2):
        mass = float(str(cells["mass_kg"]))
        row = {
            "line": line,
            "pressure_kpa": cells["pressure_kpa"],
            "length_mm": cells["length_mm"],
            "force_n": mass * GRAVITY,
            "temperature_c": 21.0,
            "direction": cells["direction"],
            "cycle_max_kpa": cells["cycle_max_kpa"],
            "mass_kg": mass,
            "set_pressure_kpa": cells["pressure_kpa"],
            "slot": f"{mass:g} kg cycle {cells['cycle_max_kpa']:g}",
            "repeat": 1,
        }
        rows.append(row)
    return rows


def _by_valve(name: str, unit: str, *common: str) -> list[dict[str, Any]]:
    """D-1 to D-4: two points a printed row, one a valve."""
    rows = []
    for line, cells in enumerate(load(name), start=2):
        for valve in ("inlet", "outlet"):
            row: dict[str, Any] = {
                "line": line,
                "valve": valve,
                "pressure_kpa": cells["pressure_kpa"],
                "set_pressure_kpa": cells["pressure_kpa"],
                f"on_{unit}": cells[f"{valve}_on_{unit}"],
                f"off_{unit}": cells[f"{valve}_off_{unit}"],
                "slot": f"{valve} {cells['pressure_kpa']:g}",
                "repeat": int(str(cells.get("repeat", 1))),
            }
            row.update({k: cells[k] for k in common})
            rows.append(row)
    return rows


def _flow() -> list[dict[str, Any]]:
    return [
        {
            "line": line,
            "valve": "outlet",
            "pressure_kpa": cells["pressure_kpa"],
            "set_pressure_kpa": cells["pressure_kpa"],
            "velocity_m_s": cells["air_velocity_m_s"],
            "slot": f"{cells['pressure_kpa']:g}",
            "repeat": 1,
        }
        for line, cells in enumerate(load("d05"), start=2)
    ]


_MUSCLE = ("pressure_kpa", "length_mm", "force_n", "temperature_c")
_GAUGE = {"u_pressure_kpa": 5.0 / EVEN}
_HELD = {**_GAUGE, "u_length_mm": 0.1 / EVEN, "u_temperature_c": 0.01 / EVEN}
_SEEN = {**_GAUGE, "u_length_mm": 0.05 / EVEN, "u_temperature_c": 0.01 / EVEN, "u_force_n": 0.0}

SOURCES = {
    "c01": Source(
        "C-1", "isometric test, force at 14 lengths and 16 pressures", "isometric",
        {**_HELD, "u_force_n": 0.001 / STEP}, lambda: _muscle("c01"), _MUSCLE,
        notes=(STATED_NOTE,),
    ),
    "c02": Source(
        "C-2", "isobaric test, force at 16 pressures and 14 lengths", "isobaric",
        {**_HELD, "u_force_n": 0.01 / STEP}, _isobaric, _MUSCLE,
        labels=("C-1 plus noise",), notes=(NOISE, STATED_NOTE),
    ),
    "c03": Source(
        "C-3", "isotonic test, length at 7 loads and 23 pressures", "isotonic",
        _SEEN, _isotonic, _MUSCLE,
        notes=(
            CAMERA_NOTE,
            "Table C-3 heads its loads in newton where section 4.6.2 speaks of hung masses; they"
            " are taken as newton",
        ),
    ),
    "c04": Source(
        "C-4", "isometric hysteresis, pressure up and down to 400 and 600 kPa", "hysteresis",
        {**_HELD, "u_force_n": 0.01 / STEP}, _hysteresis, _MUSCLE, notes=(STATED_NOTE,),
    ),
    "c06": Source(
        "C-6", "isotonic hysteresis, length with pressure up and down to 400 and 600 kPa",
        "hysteresis", _SEEN, _isotonic_hysteresis, _MUSCLE,
        notes=(
            CAMERA_NOTE,
            "Table C-6 heads its columns force, in newton; they hold lengths in mm",
        ),
    ),
    "d01": Source(
        "D-1 to D-3", "switching times of both valves, three repeats", "switching-time",
        {**_GAUGE, "u_on_ms": 0.1 / STEP, "u_off_ms": 0.1 / STEP},
        lambda: _by_valve("d01", "ms", "air_delay_ms"),
        ("pressure_kpa", "on_ms", "off_ms", "air_delay_ms"),
        notes=(
            VALVE_NOTE,
            "the tables name no unit; section 5.12 speaks of milliseconds",
            "the inlet's off times of Tables D-2 and D-3 are the same numbers, and so are the"
            " outlet's: off times have two repeats, not three",
            "whether the printed times still hold the air's way to the sensor is not said; they"
            " are taken as printed. The tables give it as 1.016 ms, the text as 1.02, and"
            " 62 mm at 65 m/s are 0.954 ms",
            "time is printed at 0 kPa, too, where no air flows: a strain gauge on the line cannot"
            " have seen it",
        ),
    ),
    "d04": Source(
        "D-4", "lowest voltages at which the valves switch", "switching-voltage",
        {**_GAUGE, "u_on_v": 0.05 / STEP, "u_off_v": 0.05 / STEP},
        lambda: _by_valve("d04", "v"), ("pressure_kpa", "on_v", "off_v"),
        notes=(VALVE_NOTE, "outlet off at 0 kPa: 0.7 V here, 0.75 V in section 5.11.1"),
    ),
    "d05": Source(
        "D-5", "air velocity behind the valve against pressure", "flow",
        {**_GAUGE, "u_velocity_m_s": 1.0 / STEP}, _flow, ("pressure_kpa", "velocity_m_s"),
        notes=(
            VALVE_NOTE,
            "the table names no units: kPa and, by the text, m/s; neither the bore in which the"
            " velocity was read nor the valve is told",
        ),
    ),
}  # fmt: skip

ALIASES = {"c05": "c04", "c07": "c06", "d02": "d01", "d03": "d01"}
"""C-5 and C-7 are differences of C-4 and C-6, recomputed in their reports; D-1 to D-3 are one
test of three repeats."""
