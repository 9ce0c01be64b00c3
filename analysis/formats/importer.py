"""Import of data that other software measured.

An imported run has a stream ``points`` and one event ``point`` per row. Reduction, figures and
report treat it like a recorded run.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from analysis.formats.point_checks import NUMBERS, REQUIRED
from analysis.formats.points_file import PointsFile, read_points
from daq.clock import Clock

SHORTEST_MM = 51.45
"""The shortest length in all tables except C-1, whose heading says 51."""
ORIGIN = {"c": "1996 thesis on pneumatic muscles, Appendix C", "d": "the same thesis, Appendix D"}


def import_thesis(
    name: str,
    root: Path | str,
    clock: Clock,
    *,
    include_formula: bool = False,
) -> Path:
    """Import a measured table of the thesis as a run.

    Args:
        name: ``c01`` (isometric, 21 degC), ``c02`` (labelled: C-1 plus noise), ``c03``
            (isotonic), ``c04`` and ``c06`` (hysteresis, both directions), ``d01`` to ``d03``
            (switching times, one run), ``d04`` (switching voltages), ``d05`` (air velocity).
            ``c05`` and ``c07`` are differences of ``c04`` and ``c06``, which are imported.
        root: folder of all runs.
        clock: names the run.
        include_formula: include the columns above 21 degC, labelled as a formula.

    Returns:
        The run folder.

    Raises:
        PamrigError: the table is unknown, or the record cannot be written.
    """
    from analysis.formats.thesis_sources import FORMULA, READING_51, source

    key, found = source(name)
    labels, notes = list(found.labels), list(found.notes)
    every = found.rows()
    rows = [r for r in every if include_formula or r.get("temperature_c", 21.0) == 21.0]
    if key == "c01":
        notes.insert(0, READING_51.format(length=SHORTEST_MM))
        for row in rows:
            if row["length_mm"] == 51:
                row.update(
                    length_mm=SHORTEST_MM, set_length_mm=SHORTEST_MM, slot=f"L{SHORTEST_MM:g}"
                )
    if key in ("c01", "c02"):
        if include_formula:
            labels.append("warm columns: formula, not measured")
            notes.insert(len(notes) - 1, FORMULA)
        else:
            left_out = f"{len(every) - len(rows)} cells above 21 °C left out ({FORMULA})"
            notes.insert(len(notes) - 1, left_out)
    manifest: dict[str, Any] = {
        "protocol": found.protocol,
        "specimen": "thesis-muscle" if key[0] == "c" else "thesis-valve",
        "source": {
            "kind": "thesis",
            "table": found.table,
            "title": found.title,
            "origin": ORIGIN[key[0]],
            "rows": len(rows),
            "rounding_only": list(found.rounding_only),
        },
        "labels": labels,
        "notes": notes,
        "stated_uncertainty": found.stated,
    }
    if key[0] == "c":
        manifest["source"] |= {
            "temperatures": "21 degC and formula" if include_formula else "21 degC",
            "shortest_mm": SHORTEST_MM,
        }
    return _write(rows, manifest, root, clock, found.columns)


def import_points(path: Path | str, root: Path | str, clock: Clock) -> Path:
    """Import settled points from a CSV file or a folder in the dataset format as a run.

    Args:
        path: the file or folder, read by :func:`analysis.formats.points_file.read_points`.
        root: folder of all runs.
        clock: names the run.

    Raises:
        PamrigError: states file, row and column, the value and a remedy.
    """
    path = Path(path)
    points: PointsFile = read_points(path)
    manifest: dict[str, Any] = {
        "specimen": path.stem,
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


EVENT_EXTRAS = ("valve", "mass_kg", "cycle_max_kpa", "slack")
"""Labels that only some tables have."""


def _write(
    rows: Sequence[dict[str, Any]],
    manifest: dict[str, Any],
    root: Path | str,
    clock: Clock,
    numbers: Sequence[str] = REQUIRED,
) -> Path:
    """Write rows as a run: values into the stream, labels into events."""
    from daq.record.writer import RecordWriter

    full = {"protocol": "isometric", "imported": True, "calibrations": {}, **manifest}
    writer = RecordWriter(root, full, clock, durable=False, threaded=False)
    try:
        columns = list(dict.fromkeys(n for n in (*numbers, *NUMBERS) if not n.startswith("set_")))
        if "length_mm" not in numbers:
            columns = [*numbers, *(f"u_{name}" for name in numbers)]
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
                **{k: row[k] for k in EVENT_EXTRAS if row.get(k) is not None},
            )
        writer.finalize("clean")
    except BaseException:
        writer.abandon()
        raise
    return Path(writer.folder)


def _trials(rows: Iterable[dict[str, Any]]) -> list[int | str]:
    """The trial of each row: as given, otherwise one trial per slot or length, from 1."""
    numbers: dict[Any, int] = {}
    trials: list[int | str] = []
    for row in rows:
        if "trial" in row:
            trials.append(_whole(row["trial"]))
        else:
            key = (
                row.get("slot"),
                row.get("repeat"),
                row["length_mm"] if "slot" not in row else None,
            )
            trials.append(numbers.setdefault(key, len(numbers) + 1))
    return trials


def _known(row: dict[str, Any], name: str) -> float | None:
    value = row.get(name, math.nan)
    return None if math.isnan(value) else float(value)


def _whole(value: Any) -> int | str:
    """A label as an int if it is a whole number."""
    text = str(value)
    return int(text) if text.isdecimal() else text


def _unit(name: str) -> str:
    if name.endswith("_m_s"):
        return "m/s"
    units = {"kpa": "kPa", "mm": "mm", "n": "N", "c": "degC", "ms": "ms", "v": "V"}
    return units[name.rsplit("_", 1)[1]]
