"""Export of a run: table and samples as CSV, Parquet or MAT, with units in the column names."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np

from daq.errors import ConfigError, RecordError
from daq.record.disk import disk_error
from daq.store.run import Run
from daq.wholefile import whole_files

if TYPE_CHECKING:
    import pandas as pd

FORMATS = ("csv", "parquet", "mat")
SUFFIX = {
    "share of 1 ms": "",
    "s": "s",
    "ns": "ns",
    "us": "us",
    "kPa": "kpa",
    "N": "n",
    "mm": "mm",
    "degC": "c",
    "V": "v",
    "A": "a",
    "m/s": "m_s",
    "g": "g",
    "%": "percent",
    "count": "counts",
    "counts": "counts",
    "ms": "ms",
}
"""Suffix of column names for each unit."""
MAX_NAME_LENGTH = 63
"""MATLAB truncates longer names."""


def with_unit(name: str, unit: str) -> str:
    """A column's name with its unit as suffix, unless it already has it."""
    suffix = SUFFIX.get(unit, re.sub(r"[^a-z0-9]+", "_", unit.lower()).strip("_"))
    if not suffix or name == suffix or name.endswith(f"_{suffix}"):
        return name
    return f"{name}_{suffix}"


def tables_of(run: Run) -> dict[str, pd.DataFrame]:
    """The tables that a run exports: ``table`` (its points) and each stream in physical units.

    Raises:
        RecordError: run.json is damaged.
    """
    import pandas as pd

    from analysis.run_table import contents_of, reduce_run
    from daq.store.derive import engineering

    out = {"table": reduce_run(run).table}
    for stream in run.streams:
        with contents_of(run):
            columns, units = engineering(run, stream)
        if columns:
            named = {with_unit(k, units.get(k, "")): v for k, v in columns.items()}
            out["samples" if stream == "valve" else stream] = pd.DataFrame(named)
    return out


def export_run(run: Run, kind: str, out: Path | None = None, what: str = "all") -> list[Path]:
    """Write a run in the format of another program.

    Args:
        run: an opened run.
        kind: "csv", "parquet" or "mat".
        out: folder; the default is ``<run>-<kind>`` in the current folder.
        what: "table", "samples" or "all".

    Returns:
        The files written, with a ``README.json`` about the run, calibrations and units.

    Raises:
        ConfigError: unknown format.
        RecordError: the run is damaged, or the folder cannot be written.
    """
    if kind not in FORMATS:
        raise ConfigError("--to", f"{kind!r} is not one of {', '.join(FORMATS)}")
    tables = tables_of(run)
    if what != "all":
        keep = {"table"} if what == "table" else set(tables) - {"table"}
        tables = {name: table for name, table in tables.items() if name in keep}
    folder = out or Path(f"{run.run_id}-{kind}")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with whole_files() as part:
            written = _write(run, tables, kind, folder, part)
            about = folder / "README.json"
            text = json.dumps(_about(run, tables), indent=2) + "\n"
            part(about).write_text(text, encoding="utf-8")
    except OSError as error:
        raise disk_error(folder, "export cannot be written", error) from error
    return [*written, about]


def _write(
    run: Run,
    tables: dict[str, pd.DataFrame],
    kind: str,
    folder: Path,
    part: Callable[[Path], Path],
) -> list[Path]:
    if kind == "mat":
        path = folder / f"{run.run_id}.mat"
        with part(path).open("wb") as file:
            _write_mat(run, tables, file)
        return [path]
    written = []
    for name, table in tables.items():
        path = folder / f"{name}.{kind}"
        if kind == "csv":
            with part(path).open("wb") as file:
                write_csv(table, file)
        else:
            table.to_parquet(part(path), index=False)
        written.append(path)
    return written


def write_csv(table: pd.DataFrame, file: BinaryIO) -> None:
    """Write a table as CSV in UTF-8; a column of numbers without a value is empty there.

    Arrow writes the same shortest digits as pandas, ten times as fast, but quotes the header.
    """
    import pyarrow as pa
    from pandas.api.types import is_bool_dtype, is_numeric_dtype
    from pyarrow import csv

    if not all(is_numeric_dtype(kind) and not is_bool_dtype(kind) for kind in table.dtypes):
        file.write(table.to_csv(index=False, lineterminator="\n").encode())
        return
    rows = pa.Table.from_pandas(table, preserve_index=False)  # nan becomes null: an empty field
    file.write((",".join(map(str, table)) + "\n").encode())
    csv.write_csv(rows, file, csv.WriteOptions(include_header=False))


def _write_mat(run: Run, tables: dict[str, pd.DataFrame], file: BinaryIO) -> None:
    """One struct per table, one field per column; text columns are cell arrays of char."""
    from scipy.io import savemat

    content: dict[str, Any] = {"run_id": run.run_id, "protocol": str(run.manifest["protocol"])}
    for name, table in tables.items():
        struct: dict[str, Any] = {}
        for column in table:
            field = re.sub(r"\W", "_", str(column))
            if len(field) > MAX_NAME_LENGTH:
                raise RecordError(
                    str(column), f"is longer than the {MAX_NAME_LENGTH} characters of MATLAB"
                )
            values = table[column].to_numpy()
            if values.dtype == object or values.dtype.kind in "USO":
                cells = np.empty((len(values), 1), dtype=object)
                cells[:, 0] = [str(v) for v in values]
                struct[field] = cells
            else:
                struct[field] = values.reshape(-1, 1)
        content[name] = struct
    savemat(file, content, long_field_names=True, do_compression=True, oned_as="column")


def _about(run: Run, tables: dict[str, pd.DataFrame]) -> dict[str, Any]:
    from analysis.reporting.report import record_hash
    from analysis.run_table import record_findings
    from daq.record.sealed import plain

    manifest = run.manifest
    about: dict[str, Any] = plain(
        {
            "run_id": run.run_id,
            "outcome": run.outcome,
            "protocol": manifest.get("protocol"),
            "specimen": manifest.get("specimen"),
            "started_utc": (manifest.get("started") or {}).get("utc"),
            "labels": manifest.get("labels") or [],
            "problems": list(record_findings(run)),
            "record_sha256": record_hash(run.folder),
            "tables": {
                name: {"rows": len(table), "columns": [str(c) for c in table]}
                for name, table in tables.items()
            },
            "units": "each column's name ends with its unit; u_X is the standard uncertainty of X",
            "calibrations": [c.to_dict() for c in run.calibrations.values()],
        }
    )
    return about
