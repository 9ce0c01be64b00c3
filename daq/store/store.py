"""The runs in a folder: which there are, what one holds, is it sound, make it anew."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from daq.errors import RecordError
from daq.record.chunks import Problem
from daq.record.runname import by_start
from daq.store.derive import Maker, derive
from daq.store.index import index_path, update_index
from daq.store.info import RunInfo, run_info
from daq.store.run import Run, open_run
from daq.store.verify import verify

__all__ = ["Problem", "find_run", "list_runs", "rebuild", "show", "verify"]


def list_runs(root: Path | str) -> list[RunInfo]:
    """All runs below ``root``, oldest first; none if the folder is missing.

    Where there is an index (:mod:`daq.store.index`) only what has changed since is read.
    """
    folder = Path(root)
    if not folder.is_dir():
        return []
    if index_path(folder).is_file():
        with contextlib.suppress(RecordError):  # a damaged index is no reason for no list
            return update_index(folder)
    folders = sorted((p.parent for p in folder.glob("*/run.json")), key=by_start)
    return [run_info(Run(p)) for p in folders]


def find_run(root: Path | str, text: str) -> Run:
    """The run meant by a path, a whole name, or a part of a name that only one has.

    ``last`` is the newest.

    Raises:
        RecordError: none or several fit.
    """
    if (Path(text) / "run.json").is_file() or Path(text).is_file():
        return open_run(text)
    runs = [info.run_id for info in list_runs(root)]
    found = runs[-1:] if text == "last" else [r for r in runs if r == text]
    found = found or [r for r in runs if text in r]
    if len(found) != 1:
        some = ", ".join(found[:5]) + (", ..." if len(found) > 5 else "")
        what = f"{len(found)} runs are called so: {some}" if found else "no run is called so"
        raise RecordError(text, f"{what} (in {root})", "pamrig runs list shows the runs there are")
    return open_run(Path(root) / found[0])


def show(run: Run) -> dict[str, Any]:
    """What a run holds, as plain data; damage met on the way is under ``problems``."""
    info = run_info(run).as_dict()
    final = run.final or {}
    streams = {}
    for name in run.streams:
        columns = run.samples(name)
        rows = len(next(iter(columns.values()), ()))
        streams[name] = {"rows": rows, "lost_rows": run.lost_rows(name), "columns": list(columns)}
    kinds: dict[str, int] = {}
    for event in run.events:
        kinds[event["kind"]] = kinds.get(event["kind"], 0) + 1
    derived = run.folder / "derived"
    return {
        **info,
        "streams": streams,
        "events": kinds,
        "frames": len(run.frames),
        "calibrations": [c.to_dict() for c in run.calibrations.values()]
        if run.sealed("run.json")
        else [],
        "final": {k: v for k, v in final.items() if k != "files"},
        "derived": sorted(p.name for p in derived.iterdir()) if derived.is_dir() else [],
        "bytes": sum(p.stat().st_size for p in run.folder.rglob("*") if p.is_file()),
        "problems": sorted({str(p) for p in run.problems}),
    }


def rebuild(run: Run, makers: Iterable[Maker] = ()) -> Path:
    """Make everything derived anew; see :func:`daq.store.derive.derive`.

    Args:
        run: the run.
        makers: from above, such as the view, the reduced table and the report.
    """
    return derive(run, makers)
