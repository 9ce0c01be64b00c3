"""Strict reading of settled points from a CSV file or a folder in the dataset format.

A wrong number that is not noticed is worse than a rejected file. Therefore the import stops at
everything that could be another unit, another quantity or a typing error; the message states
file, row and column.
"""

from __future__ import annotations

import csv
import hashlib
import math
import re
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from analysis.formats.point_checks import (
    DIRECTIONS,
    LABELS,
    NUMBERS,
    REQUIRED,
    SENSOR_RANGE,
    SLACK,
    TRIAL_COLUMNS,
    check_columns,
    check_required,
    number,
    truth,
)
from daq.errors import PamrigError
from daq.store.tablefile import check_csv, read_parquet
from plant import tomlfile

MOST_POINTS = 1_000_000
"""Settled points of one file; a test of a month has a hundredth of it."""


@dataclass(frozen=True)
class PointsFile:
    """Settled points as read: one dict per row, numbers as float, labels as text.

    Attributes:
        rows: every row has the three required numbers; other numbers may be NaN.
        notes: for the report (ignored columns, skipped rows).
        sources: name, size and SHA-256 of every file read.
        bench: contents of ``bench.toml``, empty without one.
    """

    rows: list[dict[str, Any]]
    notes: list[str]
    sources: list[dict[str, Any]]
    bench: dict[str, Any] = field(default_factory=dict)


def read_points(path: Path) -> PointsFile:
    """Read a CSV of settled points, or a folder with trials.csv and samples.csv or .parquet.

    Raises:
        PamrigError: states file, row and column, the value and a remedy.
    """
    if not path.exists():
        raise PamrigError(str(path), "no such file or folder", "check the path")
    if path.is_dir():
        return _read_folder(path)
    return _points(_read_table(path), {}, path.name, [_source(path)])


def _read_folder(folder: Path) -> PointsFile:
    names = ("samples.csv", "samples.parquet")
    found = [folder / name for name in names if (folder / name).exists()]
    if len(found) != 1:
        what = "has both samples.csv and samples.parquet" if found else "no samples.csv"
        raise PamrigError(str(folder), what, "the dataset format has trials.csv and one of the two")
    samples_path, trials_path = found[0], folder / "trials.csv"
    if not trials_path.exists():
        raise PamrigError(str(folder), "no trials.csv", "one row per trial, with at least: trial")
    trials: dict[str, dict[str, Any]] = {}
    for line, row in _read_table(trials_path):
        check_columns(list(row), trials_path.name, TRIAL_COLUMNS)
        name = str(row.get("trial") or "")
        if not name:
            raise PamrigError(f"{trials_path.name} row {line} column trial", "empty", "name it")
        if name in trials:
            raise PamrigError(
                f"{trials_path.name} row {line} column trial",
                f"trial {name!r} occurs twice",
                "one row per trial",
            )
        trials[name] = row
    sources = [_source(trials_path), _source(samples_path)]
    bench: dict[str, Any] = {}
    if (folder / "bench.toml").exists():
        sources.append(_source(folder / "bench.toml"))
        try:
            bench = tomlfile.loads(tomlfile.read_text(folder / "bench.toml"))
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise PamrigError(
                "bench.toml", f"is not TOML: {error}", "correct or remove it"
            ) from error
    points = _points(_read_table(samples_path), trials, samples_path.name, sources)
    return PointsFile(points.rows, points.notes, points.sources, bench)


def _points(
    raw: Iterator[tuple[int, dict[str, Any]]],
    trials: dict[str, dict[str, Any]],
    name: str,
    sources: list[dict[str, Any]],
) -> PointsFile:
    rows: list[dict[str, Any]] = []
    notes: list[str] = []
    seen: dict[tuple[Any, ...], int] = {}
    skipped: list[int] = []
    outside: dict[str, list[int]] = {}
    columns: list[str] = []
    for line, cells in raw:
        if not columns:
            columns = list(cells)
            notes += check_columns(columns, name, (*NUMBERS, *LABELS, SLACK))
            check_required(columns, name, trials)
        full = _joined(cells, trials, name, line)
        row = _typed(full, name, line, outside)
        key = tuple(sorted((k, str(v)) for k, v in row.items() if k != "line"))
        if key in seen:
            raise PamrigError(
                f"{name} row {line}",
                f"is the same as row {seen[key]} in every column",
                "remove one, or number true repeats in a column named repeat",
            )
        seen[key] = line
        if any(math.isnan(row[column]) for column in REQUIRED):
            skipped.append(line)
            continue
        rows.append(row)
    if not columns:
        raise PamrigError(name, "has no rows", "expected a header and at least one settled point")
    if not rows:
        raise PamrigError(
            name,
            f"none of its {len(skipped)} rows has all of {', '.join(REQUIRED)}",
            "a settled point needs all three",
        )
    if skipped:
        notes.append(f"{len(skipped)} rows lack a value and were left out, first: row {skipped[0]}")
    for column, lines in outside.items():
        low, high = SENSOR_RANGE[column]
        notes.append(
            f"{column}: {len(lines)} values outside {low:g} to {high:g}, first in row {lines[0]}"
        )
    return PointsFile(rows, notes, sources)


def _joined(
    cells: dict[str, Any], trials: dict[str, dict[str, Any]], name: str, line: int
) -> dict[str, Any]:
    """The row, with missing values taken from its trial."""
    if not trials:
        return cells
    trial = str(cells.get("trial") if cells.get("trial") is not None else "")
    if trial not in trials:
        raise PamrigError(
            f"{name} row {line} column trial",
            f"trial {trial!r} is not in trials.csv",
            f"known: {', '.join(list(trials)[:8])}",
        )
    full = {k: v for k, v in trials[trial].items() if k in (*LABELS, "temperature_c")}
    held = trials[trial].get("held_length_mm")
    full.update({k: v for k, v in cells.items() if v not in (None, "")})
    if held not in (None, ""):
        full.setdefault("set_length_mm", held)
        full.setdefault("length_mm", held)
    return full


def _typed(
    cells: dict[str, Any], name: str, line: int, outside: dict[str, list[int]]
) -> dict[str, Any]:
    row: dict[str, Any] = {"line": line}
    for column in NUMBERS:
        row[column] = number(cells.get(column), name, line, column, outside)
    for column in LABELS:
        value = cells.get(column)
        if value is not None and str(value) != "":
            row["repeat" if column == "replicate" else column] = str(value)
    if truth(cells.get(SLACK), name, line, SLACK):
        row[SLACK] = True
    direction = row.get("direction", "")
    if direction not in DIRECTIONS:
        raise PamrigError(
            f"{name} row {line} column direction",
            f"expected up, down or single, got {direction!r}",
            "leave it empty if unknown",
        )
    if "order" in row:
        try:
            row["order"] = int(row["order"])
        except ValueError:
            raise PamrigError(
                f"{name} row {line} column order",
                f"expected a whole number, got {row['order']!r}",
                "number the points in the order they were taken",
            ) from None
    return row


def _read_table(path: Path) -> Iterator[tuple[int, dict[str, Any]]]:
    """Rows with their line number in the file (the header is row 1)."""
    if path.stat().st_size == 0:
        raise PamrigError(path.name, "the file is empty", "expected a header and rows")
    if path.suffix == ".parquet":
        yield from _read_parquet(path)
        return
    check_csv(path)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise PamrigError(
            path.name, f"is not UTF-8 text (byte {error.start})", "save it as CSV in UTF-8"
        ) from error
    try:
        yield from _read_rows(path, csv.reader(text.splitlines()))
    except csv.Error as error:
        raise PamrigError(path.name, f"is not CSV: {error}", "save it as CSV again") from None


def _read_rows(path: Path, lines: Any) -> Iterator[tuple[int, dict[str, Any]]]:
    header = [cell.strip() for cell in next(lines, [])]
    if len(header) == 1 and re.search(r"[;\t]", header[0]):
        raise PamrigError(
            f"{path.name} row 1", "columns are not separated by commas", "save it with commas"
        )
    for column in header:
        if header.count(column) > 1:
            raise PamrigError(f"{path.name} column {column}", "occurs twice", "remove one")
    for cells in lines:
        if not any(cell.strip() for cell in cells):
            continue
        if len(cells) != len(header):
            raise PamrigError(
                f"{path.name} row {lines.line_num}",
                f"has {len(cells)} cells, the header has {len(header)}",
                "check for a missing or extra comma, or a decimal comma",
            )
        yield lines.line_num, dict(zip(header, (cell.strip() for cell in cells), strict=True))


def _read_parquet(path: Path) -> Iterator[tuple[int, dict[str, Any]]]:
    table = read_parquet(path)
    if len(table) > MOST_POINTS:
        what = f"has {len(table)} rows, allowed are {MOST_POINTS} settled points"
        raise PamrigError(path.name, what, "give settled points, not samples")
    for index, row in enumerate(table.astype(object).where(table.notna(), None).to_dict("records")):
        yield index + 1, {str(name): value for name, value in row.items()}


def _source(path: Path) -> dict[str, Any]:
    data = path.read_bytes()
    return {"file": path.name, "bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()}
