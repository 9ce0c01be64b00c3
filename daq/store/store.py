"""Finds, lists and shows the runs in a folder."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from daq.errors import RecordError
from daq.record.runname import by_start
from daq.record.safe_read import names_inside
from daq.store.index import index_path, update_index
from daq.store.info import TESTS, RunInfo, run_info
from daq.store.run import Run, open_run
from daq.store.versions import version_folders, version_settings


def list_runs(root: Path | str) -> list[RunInfo]:
    """All runs below ``root``, oldest first; an empty list if the folder is missing.

    With an index (:mod:`daq.store.index`), only changed runs are read.
    """
    folder = Path(root)
    if not folder.is_dir():
        return []
    if index_path(folder).is_file():
        with contextlib.suppress(RecordError):  # with a damaged index, read all folders
            return update_index(folder)
    folders = sorted((p.parent for p in folder.glob("*/run.json")), key=by_start)
    return [run_info(Run(p)) for p in folders]


def find_run(root: Path | str, text: str) -> Run:
    """The run with the given path, full name, or unique part of the name.

    ``last`` is the newest test on a bench; where there is none, the newest run of any origin.

    Raises:
        RecordError: no run or several runs match.
    """
    if (Path(text) / "run.json").is_file() or Path(text).is_file():
        return open_run(text)
    listed = list_runs(root)
    if not listed:
        raise RecordError(text, f"there are no runs in {root}", "choose the folder of your runs")
    runs = [info.run_id for info in listed]
    if text == "last":
        found = ([info.run_id for info in listed if info.origin in TESTS] or runs)[-1:]
    else:
        found = [r for r in runs if r == text]
    found = found or [r for r in runs if text in r]
    if len(found) != 1:
        some = ", ".join(found[:5]) + (", ..." if len(found) > 5 else "")
        what = f"{len(found)} runs match: {some}" if found else f"no run named {text}"
        raise RecordError(text, f"{what} (in {root})", "pamrig runs list shows all runs")
    return open_run(Path(root) / found[0])


def show(run: Run) -> dict[str, Any]:
    """The content of a run as plain data; damage, and what is not read, is under ``problems``."""
    refused: list[str] = []

    def read(what: Callable[[], Any], otherwise: Any) -> Any:
        try:
            return what()
        except RecordError as error:
            refused.append(str(error))
            return otherwise

    kinds: dict[str, int] = {}
    for event in read(lambda: run.events, []):
        kinds[event["kind"]] = kinds.get(event["kind"], 0) + 1
    derived = run.folder / "derived"
    there = read(lambda: list(names_inside(run.folder)), [])
    return {
        **run_info(run).as_dict(),
        "streams": {name: read(partial(_stream, run, name), {}) for name in run.streams},
        "events": kinds,
        "frames": len(read(lambda: run.frames, [])),
        "calibrations": read(lambda: [c.to_dict() for c in run.calibrations.values()], []),
        "final": {k: v for k, v in (run.final or {}).items() if k != "files"},
        "derived": sorted(p.name for p in derived.iterdir()) if derived.is_dir() else [],
        "versions": {n: version_settings(run, n) for n in version_folders(run.folder)},
        "bytes": sum(size for _, size in there),
        "problems": sorted({*(str(p) for p in run.problems), *refused}),
    }


def _stream(run: Run, name: str) -> dict[str, Any]:
    columns = run.samples(name)
    rows = len(next(iter(columns.values()), ()))
    return {"rows": rows, "lost_rows": run.lost_rows(name), "columns": list(columns)}
