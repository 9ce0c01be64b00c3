"""One table of a data set as it lies on disk, checked column by column."""

from __future__ import annotations

import difflib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from daq.errors import PamrigError
from daq.store.tablefile import LARGEST_HEAD, check_csv, read_parquet
from gap.errors import GapError
from plant.arrays import Array
from plant.constants import PlantConstants
from plant.effects.reference import size_of

# A column that begins like one of ours but ends otherwise is most likely another unit.
_QUANTITIES: tuple[str, ...] = (
    "time", "supply", "pressure", "length", "held_length", "force", "temperature",
)  # fmt: skip
_QUANTITIES += ("load", "start", "mass")
# Ten times outside the range of the sensor (docs/reference/plant.md, sensors).
_LIMITS = {
    "pressure_kpa": (-1000.0, 10000.0),
    "supply_kpa": (-1000.0, 12000.0),
    "force_n": (-10000.0, 10000.0),
    "temperature_c": (-100.0, 600.0),
    "load_kg": (0.0, 1000.0),
    "time_s": (-1e9, 1e9),
    "taken_s": (0.0, 1e7),
    "start_s": (-1e11, 1e11),
    "order": (-1e9, 1e9),
}


@dataclass
class Table:
    """A table as read: labels as text, every other column as it came."""

    path: Path
    frame: pd.DataFrame
    notes: list[str] = field(default_factory=list)

    def error(self, row: int, column: str, what: str, remedy: str = "") -> GapError:
        """Return the error that names this file, the row as a person counts it, and the column."""
        counted = row + (2 if self.path.suffix == ".csv" else 1)
        return GapError(f"{self.path}, row {counted}, column {column}", what, remedy)


def read_table(path: Path, required: tuple[str, ...], labels: tuple[str, ...]) -> Table:
    """Read a CSV or Parquet file; `labels` are columns of text. Raises `GapError`."""
    if not path.exists():
        raise GapError(str(path), "no such file", "see docs/reference/dataset-format.md")
    if path.stat().st_size == 0:
        raise GapError(str(path), "is empty")
    try:
        csv = path.suffix == ".csv"
        frame, notes = _read_csv(path, labels) if csv else (read_parquet(path), [])
    except GapError:
        raise
    except PamrigError as exc:
        raise GapError(exc.where, exc.what, exc.remedy) from exc
    except Exception as exc:
        raise GapError(str(path), f"cannot be read ({_first_line(exc)})") from exc
    frame.columns = [str(name).strip() for name in frame.columns]
    table = Table(path, frame.reset_index(drop=True), notes)
    doubled = frame.columns[frame.columns.duplicated()]
    if len(doubled):
        raise GapError(f"{path}, column {doubled[0]}", "appears twice")
    for name in required:
        if name not in table.frame:
            near = difflib.get_close_matches(name, list(table.frame.columns), n=1)
            hint = f"did you mean to name {near[0]!r} so?" if near else ""
            raise GapError(f"{path}, column {name}", "is missing", hint)
    if not len(table.frame):
        raise GapError(str(path), "has no rows")
    for name in labels:
        if name in table.frame:
            table.frame[name] = _labels(table.frame[name])
    return table


def _read_csv(path: Path, labels: tuple[str, ...]) -> tuple[pd.DataFrame, list[str]]:
    check_csv(path)
    with path.open("rb") as file:
        head = file.readline().decode("utf-8-sig", errors="replace")
    names = [name.strip().strip('"') for name in head.rstrip("\r\n").split(",")]
    for name in names:
        if names.count(name) > 1:
            raise GapError(f"{path}, column {name}", "appears twice")
    text: dict[Any, Any] = {name: str for name in names if name in (*labels, "note")}
    frame = pd.read_csv(
        path, dtype=text, skipinitialspace=True, encoding="utf-8-sig", low_memory=False,
        index_col=False,
    )  # fmt: skip
    return frame, _check_end(path, len(names), len(frame))


def _check_end(path: Path, columns: int, rows: int) -> list[str]:
    """Refuse a file that ends in the middle of a row: its last number may be cut short as well.

    Where the row is whole and only its end of line is missing, that is worth a note: many a program
    writes none.
    """
    with path.open("rb") as file:
        file.seek(max(path.stat().st_size - LARGEST_HEAD, 0))
        tail = file.read()
    last = tail.rpartition(b"\n")[2]
    if last.strip() and b'"' not in last and last.count(b",") < columns - 1:
        raise GapError(
            f"{path}, row {rows + 1}",
            f"is cut short: {last.count(b',') + 1} of {columns} values, and no end of line",
            "copy the file again, or drop the row",
        )
    if not last.strip():
        return []
    return [f"{path.name}: row {rows + 1} has no end of line; was its last value cut short?"]


def _labels(column: pd.Series[Any]) -> pd.Series[Any]:
    """Text of a label column; whole numbers lose the ".0" that an empty cell gives them."""

    def text(value: Any) -> Any:
        if value is None or (isinstance(value, float) and np.isnan(value)):
            return None
        if isinstance(value, (float, np.floating)) and float(value).is_integer():
            return str(int(value))
        return str(value).strip()

    if len(column) > 1000:
        codes, uniques = pd.factorize(column, use_na_sentinel=True)
        words = np.array([text(value) for value in uniques] + [None], dtype=object)
        return pd.Series(words[codes], index=column.index)
    return pd.Series([text(value) for value in column], index=column.index, dtype=object)


def unit_check(table: Table, known: tuple[str, ...]) -> None:
    """Refuse unknown columns that look like another unit; note the others. Raises `GapError`."""
    for name in table.frame.columns:
        if name in known:
            continue
        stem = next((q for q in _QUANTITIES if name == q or name.startswith(q + "_")), None)
        ours = [k for k in known if stem and k.startswith(stem + "_")]
        lowered = [k for k in known if name.lower().replace(" ", "_") == k]
        if ours or lowered or _closest(name, known):
            meant = (ours or lowered or [_closest(name, known)])[0]
            raise GapError(
                f"{table.path}, row 1, column {name}",
                "is not a column of the dataset format and looks like another unit or a slip",
                f"convert it to {meant}",
            )
        table.notes.append(f"{table.path.name}: column {name} is not used")


def _closest(name: str, known: tuple[str, ...]) -> str:
    near = difflib.get_close_matches(name.lower(), known, n=1, cutoff=0.85)
    return near[0] if near else ""


def numbers(table: Table, name: str, constants: PlantConstants) -> Array:
    """Column `name` as floats, NaN where empty or absent; raises `GapError`."""
    if name not in table.frame:
        return np.full(len(table.frame), np.nan)
    column = table.frame[name]
    if pd.api.types.is_bool_dtype(column):
        column = column.astype(float)
    if not pd.api.types.is_numeric_dtype(column):
        try:
            read = pd.to_numeric(column, errors="coerce")
        except OverflowError:  # of hundreds of digits: no cell is one that can be read
            read = column.map(_finite)
        blank = column.isna() | column.astype(str).str.strip().isin(["", "nan", "NaN", "None"])
        wrong = np.flatnonzero((read.isna() & ~blank).to_numpy())
        if len(wrong) or pd.api.types.is_datetime64_any_dtype(column):
            row = int(wrong[0]) if len(wrong) else 0
            raise table.error(row, name, f"{str(column.iloc[row])[:40]!r} is not a number")
        column = read
    value = np.asarray(column.to_numpy(dtype=np.float64, na_value=np.nan), dtype=np.float64)
    _range(table, name, value, constants)
    return value


def _finite(cell: object) -> float:
    try:
        value = float(str(cell))
    except ValueError:
        return float("nan")
    return value if np.isfinite(value) else float("nan")


def _range(table: Table, name: str, value: Array, constants: PlantConstants) -> None:
    infinite = np.flatnonzero(np.isinf(value))
    if len(infinite):
        raise table.error(int(infinite[0]), name, "is infinite", "leave the cell empty instead")
    expected = ""
    if name in ("inlet_cmd", "outlet_cmd"):
        bad = np.isfinite(value) & (value != 0.0) & (value != 1.0)
        expected = (
            'expected 0 or 1; of a proportional valve (valve = "proportional" in bench.toml) 0 to 1'
        )
        if constants.valve == "proportional":
            bad = (value < 0.0) | (value > 1.0)
            expected = "expected 0 to 1, the share of the whole opening"
    else:
        size = size_of(constants) * 1e3
        # The piston of a cylinder may stand at its cover.
        least = 0.0 if constants.actuator == "cylinder" else size / 30.0
        limits = {"length_mm": (least, 10.0 * size)}
        limits["held_length_mm"] = limits["length_mm"]
        low, high = limits.get(name, _LIMITS.get(name, (-np.inf, np.inf)))
        bad = (value < low) | (value > high)
    rows = np.flatnonzero(bad)
    if len(rows):
        row = int(rows[0])
        if expected:
            raise table.error(row, name, f"{value[row]:g} is no command", expected)
        raise table.error(
            row, name, f"{value[row]:g} is far outside the sensor's range",
            f"allowed {low:g} to {high:g}; unit?",
        )  # fmt: skip


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]
