"""Measured data that this software did not record becomes a run like any other.

An imported run holds a stream ``points`` and one event ``point`` a row; reduction, figures and
report then treat it as they treat a recorded one.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from daq.clock import Clock
from daq.errors import PamrigError
from rigs.pointcheck import NUMBERS
from rigs.pointsfile import PointsFile, read_points

SHORTEST_MM = 51.45
"""What every table but C-1 calls the shortest length; C-1's own heading says 51."""

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

STATED = {
    "u_pressure_kpa": 5.0 / math.sqrt(3.0),
    "u_length_mm": 0.1 / math.sqrt(3.0),
    "u_temperature_c": 0.01 / math.sqrt(3.0),
}
"""Section 4.6.4: gauge +/- 5 kPa, calipers +/- 0.1 mm, +/- 0.01 degC; each taken as the
half-width of an even spread (divided by the square root of 3)."""

STATED_NOTE = (
    "uncertainties are those stated in section 4.6.4 (± 5 kPa, ± 0.1 mm, ± 0.01 °C)"
    " read as limits of an even spread; of the force only the scale's step (0.001 g) is stated,"
    " so u_force_n holds no more than the rounding of the printed numbers"
)


@dataclass(frozen=True)
class _Source:
    """One thesis table that can be imported."""

    table: str
    title: str
    force_step_n: float
    labels: tuple[str, ...] = ()
    notes: tuple[str, ...] = field(default=())


_THESIS = {
    "c01": _Source("C-1", "isometric test, force at 14 lengths and 16 pressures", 0.001),
    "c02": _Source("C-2", "isobaric test", 0.01, labels=("C-1 plus noise",), notes=(NOISE,)),
    "c04": _Source("C-4", "isometric hysteresis, pressure up and down to 400 and 600 kPa", 0.01),
}


def import_thesis(
    name: str,
    root: Path | str,
    clock: Clock,
    *,
    include_formula: bool = False,
    shortest_mm: float = SHORTEST_MM,
) -> Path:
    """Make a run of a measured table of the thesis.

    Args:
        name: ``c01`` (isometric, 21 degC), ``c02`` (labelled: C-1 plus noise) or ``c04``
            (isometric hysteresis, both directions).
        root: folder of all runs.
        clock: names the run.
        include_formula: also take the columns above 21 degC, labelled as a formula.
        shortest_mm: what the length headed 51 in Table C-1 is taken as.

    Returns:
        The run folder.

    Raises:
        PamrigError: unknown table, or the record cannot be written.
    """
    from plant.thesis import load

    key = name.lower().replace("-", "").replace("_", "")
    key = key if key in _THESIS else f"c{key.lstrip('c').zfill(2)}"
    if key not in _THESIS:
        raise PamrigError(
            f"thesis table {name}",
            "cannot be reduced as an isometric test",
            f"those that can: {', '.join(_THESIS)}",
        )
    source = _THESIS[key]
    labels, notes = list(source.labels), list(source.notes)
    measured, formula = 0, 0
    rows: list[dict[str, Any]] = []
    for line, cells in enumerate(load(key), start=2):
        row = {k: cells[k] for k in ("pressure_kpa", "length_mm", "force_n")}
        row["temperature_c"] = cells.get("temperature_c", 21.0)
        if row["temperature_c"] != 21.0:
            formula += 1
            if not include_formula:
                continue
        measured += 1
        if key == "c01" and row["length_mm"] == 51:
            row["length_mm"] = shortest_mm
        cycle = f" cycle {cells['cycle_max_kpa']:g}" if "cycle_max_kpa" in cells else ""
        row.update(
            line=line,
            set_pressure_kpa=row["pressure_kpa"],
            set_length_mm=row["length_mm"],
            direction=cells.get("direction", "single"),
            slot=f"L{row['length_mm']:g}{cycle}",
            repeat=2 if cycle.endswith("400") else 1,
        )
        rows.append(row)
    if key == "c01":
        notes.append(READING_51.format(length=shortest_mm))
    if key in ("c01", "c02"):
        if include_formula:
            labels.append("warm columns: formula, not measured")
            notes.append(FORMULA)
        else:
            notes.append(f"{formula} cells above 21 °C left out ({FORMULA})")
    notes.append(STATED_NOTE)
    manifest = {
        "specimen": "thesis-muscle",
        "source": {
            "kind": "thesis",
            "table": source.table,
            "title": source.title,
            "origin": "1996 thesis on pneumatic muscles, Appendix C",
            "temperatures": "21 degC and formula" if include_formula else "21 degC",
            "shortest_mm": shortest_mm,
            "rows": measured,
        },
        "labels": labels,
        "notes": notes,
        "stated_uncertainty": {**STATED, "u_force_n": source.force_step_n / math.sqrt(12.0)},
    }
    return _write(rows, manifest, root, clock)


def import_points(path: Path | str, root: Path | str, clock: Clock, *, specimen: str = "") -> Path:
    """Make a run of a CSV of settled points, or of an exchange folder of them.

    Args:
        path: the file or folder, read by :func:`rigs.pointsfile.read_points`.
        root: folder of all runs.
        clock: names the run.
        specimen: name of the muscle; the file's name if empty.

    Raises:
        PamrigError: names the file, row and column, what came and what to do.
    """
    path = Path(path)
    points: PointsFile = read_points(path)
    manifest: dict[str, Any] = {
        "specimen": specimen or path.stem,
        "source": {
            "kind": "points",
            "title": f"settled points from {path.name}",
            "files": points.sources,
            "rows": len(points.rows),
        },
        "labels": [],
        "notes": points.notes,
        "stated_uncertainty": {},
    }
    if points.bench:
        manifest["bench"] = points.bench
    return _write(points.rows, manifest, root, clock)


def _write(
    rows: Sequence[dict[str, Any]], manifest: dict[str, Any], root: Path | str, clock: Clock
) -> Path:
    """Write rows as a run: raw values into the stream, labels into events."""
    from daq.record import RecordWriter

    full = {"protocol": "isometric", "imported": True, "calibrations": {}, **manifest}
    writer = RecordWriter(root, full, clock, durable=False, threaded=False)
    try:
        columns = [name for name in NUMBERS if not name.startswith("set_")]
        schema = {"row": "int64", "file_row": "int64", **dict.fromkeys(columns, "float64")}
        units = {name: _unit(name) for name in columns}
        writer.stream("points", schema, units)
        batch: dict[str, Any] = {
            "row": np.arange(len(rows), dtype=np.int64),
            "file_row": np.array([row["line"] for row in rows], dtype=np.int64),
        }
        for name in columns:
            values = [row.get(name, math.nan) for row in rows]
            batch[name] = np.array(values, dtype=np.float64)
        writer.append("points", batch)
        for index, (row, trial) in enumerate(zip(rows, _trials(rows), strict=True)):
            writer.event(
                "point",
                row=index,
                trial=trial,
                slot=str(row.get("slot", "")),
                replicate=_whole(row.get("repeat", 1)),
                order=int(row.get("order", index + 1)),
                mounting=str(row.get("mounting", "")),
                direction=row.get("direction") or "single",
                set_pressure_kpa=_known(row, "set_pressure_kpa"),
                set_length_mm=_known(row, "set_length_mm"),
                settled=True,
            )
        writer.finalize("clean")
    except BaseException:
        writer.abandon()
        raise
    return Path(writer.folder)


def _trials(rows: Iterable[dict[str, Any]]) -> list[int | str]:
    """The trial of each row: as given, else one trial a slot or length, numbered from 1."""
    numbers: dict[Any, int] = {}
    trials: list[int | str] = []
    for row in rows:
        if "trial" in row:
            trials.append(_whole(row["trial"]))
        else:
            key = (row.get("slot"), row["length_mm"] if "slot" not in row else None)
            trials.append(numbers.setdefault(key, len(numbers) + 1))
    return trials


def _known(row: dict[str, Any], name: str) -> float | None:
    value = row.get(name, math.nan)
    return None if math.isnan(value) else float(value)


def _whole(value: Any) -> int | str:
    """A label as a whole number if it is one."""
    text = str(value)
    return int(text) if text.isdecimal() else text


def _unit(name: str) -> str:
    return {"kpa": "kPa", "mm": "mm", "n": "N", "c": "degC"}[name.rsplit("_", 1)[1]]
