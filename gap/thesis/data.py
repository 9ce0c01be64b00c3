"""The measured tables of the thesis as data sets of settled points.

A trial is one held length (C-1, C-4) or one load (C-3, C-6), and each is a setting of its own: none
was repeated, so that there is no floor from replicates. The shortest length of C-1 is 51.45 mm
(A01 of ANOMALIES.md). C-2 is C-1 plus noise and is no data set.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from gap.data.dataset import DataSet
from gap.data.trial import Channel, Trial
from gap.errors import GapError
from plant.constants import nominal
from plant.thesis import load

SHORTEST_MM = 51.45
G_M_S2 = 9.80665
UNKNOWN = float("nan")
TABLES = {
    "c01": "isometric",
    "c03": "isotonic",
    "c04": "hysteresis",
    "c06": "hysteresis",
}
"""Tables with measured points of their own, and the protocol behind each."""

Row = dict[str, Any]


def thesis_set(name: str, warm: bool = False) -> DataSet:
    """A table as a data set, held against the nominal plant, whose geometry was fitted to C-1.

    `warm` also takes the columns of C-1 above 21 °C, which are a formula and no measurement.

    Raises:
        GapError: another table, or warm columns of a table that has none.
    """
    if name not in TABLES:
        raise GapError(f"thesis table {name!r}", f"is not one of {', '.join(TABLES)}")
    if warm and name != "c01":
        raise GapError(f"thesis table {name!r}", "has no columns above 21 °C")
    groups: dict[tuple[Any, ...], list[Row]] = {}
    for row in _rows(name, warm):
        groups.setdefault(_key(name, row), []).append(row)
    trials = tuple(_trial(name, key, rows) for key, rows in groups.items())
    more = " at 21 to 39 °C" if warm else ""
    return DataSet(f"thesis table C-{int(name[1:])}{more}", trials, nominal())


def _rows(name: str, warm: bool) -> list[Row]:
    rows = []
    for cells in load(name):
        row: Row = dict(cells)
        row["temperature_c"] = row.get("temperature_c", 21.0)
        if "mass_kg" in row:
            row["load_kg"] = row["mass_kg"]
        elif name == "c03":
            row["load_kg"] = row["force_n"] / G_M_S2
        if name == "c01" and row["length_mm"] == 51:
            row["length_mm"] = SHORTEST_MM
        measured = row["length_mm"] if "load_kg" in row else row["force_n"]
        if measured is not None and (warm or row["temperature_c"] == 21.0):
            rows.append(row)
    return rows


def _key(name: str, row: Row) -> tuple[Any, ...]:
    held = row["load_kg"] if "load_kg" in row else row["length_mm"]
    return held, row.get("cycle_max_kpa", 0), row["temperature_c"] if name == "c01" else 21.0


def _trial(name: str, key: tuple[Any, ...], rows: list[Row]) -> Trial:
    """One trial; of a cycle the way up first, each way in the order in which it was gone."""

    def place(row: Row) -> tuple[bool, float]:
        down = row.get("direction") == "down"
        return down, -row["pressure_kpa"] if down else row["pressure_kpa"]

    rows = sorted(rows, key=place)
    loaded = "load_kg" in rows[0]
    measured = "length_mm" if loaded else "force_n"
    count = np.arange(len(rows), dtype=np.float64)
    channels = {
        channel: Channel(count, np.array([row[channel] for row in rows], dtype=np.float64))
        for channel in ("pressure_kpa", measured)
    }
    ways = {"up": 1, "down": -1}
    held, cycle, temperature = key
    setting = f"{held * G_M_S2:.3g} N" if loaded else f"{held:g} mm"
    return Trial(
        name=f"{setting}, {temperature:g} °C" + (f", to {cycle:g} kPa" if cycle else ""),
        slot=setting,
        replicate="1",
        protocol=TABLES[name],
        mounting="",
        order=0.0,  # not printed: no effect that depends on it can be found
        held_length_mm=UNKNOWN if loaded else float(held),
        load_kg=float(held) if loaded else UNKNOWN,
        temperature_c=float(temperature),
        start_s=UNKNOWN,
        settled=True,
        channels=channels,
        direction=np.array([ways.get(str(row.get("direction")), 0) for row in rows]),
    )
