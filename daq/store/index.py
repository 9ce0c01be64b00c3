"""SQLite index of the runs in a folder, for fast lists.

The folders are authoritative. For each run the index keeps its line of the list, with size and
time of the files it came from. A run with changed files is read again; a deleted run is dropped.
The index can be rebuilt at any time.
"""

from __future__ import annotations

import contextlib
import sqlite3
from collections.abc import Iterator
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

from daq.errors import RecordError
from daq.record.runname import by_start
from daq.store.annotations import ANNOTATIONS
from daq.store.info import RunInfo, run_info
from daq.store.run import Run

INDEX = "index.sqlite"
LAYOUT = 4
"""Version of the columns below; an index of another version is rebuilt."""
FILES = ("run.json", "final.json", ANNOTATIONS)
COLUMNS = (
    "run_id TEXT PRIMARY KEY", "started_utc TEXT", "protocol TEXT", "specimen TEXT", "outcome TEXT",
    "duration_s REAL", "operator TEXT", "rig TEXT", "excluded INTEGER", "continues TEXT",
    "origin TEXT",
    "stamp TEXT",
)  # fmt: skip
CREATE = f"CREATE TABLE runs ({', '.join(COLUMNS)})"
NAMES = tuple(column.split()[0] for column in COLUMNS)


def index_path(root: Path | str) -> Path:
    """Path of the index of a folder of runs."""
    return Path(root) / INDEX


def rebuild_index(root: Path | str) -> list[RunInfo]:
    """Create the index again from the folders; returns its runs, oldest first.

    Raises:
        RecordError: the folder does not exist or cannot be written.
    """
    folder = Path(root)
    if not folder.is_dir():
        raise RecordError(str(root), "no such folder", "give the folder of runs with --runs")
    path = index_path(root)
    try:
        for old in folder.glob(f"{INDEX}*"):
            old.unlink()
        with _open(path) as db:
            db.execute(CREATE)
            db.execute(f"PRAGMA user_version = {LAYOUT}")
    except (sqlite3.Error, OSError) as error:
        raise RecordError(
            str(path), f"cannot be written: {error}", "check disk and permissions"
        ) from error
    return update_index(root)


def update_index(root: Path | str) -> list[RunInfo]:
    """All runs of a folder, oldest first; updates the index for changed runs.

    Raises:
        RecordError: the index is damaged; `pamrig runs index` rebuilds it.
    """
    folder = Path(root)
    path = index_path(root)
    try:
        with _open(path) as db:
            (layout,) = db.execute("PRAGMA user_version").fetchone()
            if layout != LAYOUT:
                raise sqlite3.DatabaseError(f"layout {layout}, not {LAYOUT}")
            holds = db.execute("SELECT type, name, sql FROM sqlite_schema").fetchall()
            if [row for row in holds if row[2] is not None] != [("table", "runs", CREATE)]:
                # A view may be endless, a trigger may change the result.
                raise sqlite3.DatabaseError("it contains other objects than the runs")
            known = {row[0]: row for row in db.execute(f"SELECT {', '.join(NAMES)} FROM runs")}
            found: list[RunInfo] = []
            fresh = []
            folders = (manifest.parent for manifest in folder.glob("*/run.json"))
            for run_folder in sorted(folders, key=by_start):
                name, stamp = run_folder.name, _stamp(run_folder)
                row = known.pop(name, None)
                if row is None or row[-1] != stamp:
                    info = run_info(Run(run_folder))
                    values = asdict(info)
                    fresh.append(tuple(stamp if n == "stamp" else values[n] for n in NAMES))
                else:
                    info = _info(dict(zip(NAMES, row, strict=True)), run_folder)
                found.append(info)
            places = ", ".join("?" * len(NAMES))
            with contextlib.suppress(
                sqlite3.OperationalError
            ):  # read-only or busy: the list is still complete
                db.executemany(f"INSERT OR REPLACE INTO runs VALUES ({places})", fresh)
                db.executemany("DELETE FROM runs WHERE run_id = ?", [(gone,) for gone in known])
            return found
    except sqlite3.Error as error:
        raise RecordError(
            str(path), f"is damaged: {error}", "`pamrig runs index` rebuilds it"
        ) from error


@contextlib.contextmanager
def _open(path: Path) -> Iterator[sqlite3.Connection]:
    if path.is_symlink():
        raise RecordError(str(path), "is a link", "remove it; then the index is rebuilt")
    db = sqlite3.connect(path, timeout=5.0)
    try:
        with db:
            yield db
    finally:
        db.close()


def _stamp(folder: Path) -> str:
    """Size and time of the files that the list is read from."""
    parts = []
    for name in FILES:
        with contextlib.suppress(OSError):
            status = (folder / name).stat()
            parts.append(f"{name}:{status.st_size}:{status.st_mtime_ns}")
    return " ".join(parts)


def _info(row: dict[str, Any], folder: Path) -> RunInfo:
    names = {field.name for field in fields(RunInfo)}
    return RunInfo(**{k: v for k, v in row.items() if k in names}, folder=str(folder))
