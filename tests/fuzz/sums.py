"""Sums of whole files stated anew after a change: what a maker of false records would do."""

from __future__ import annotations

import json
from pathlib import Path

from daq.record.safe_read import sum_inside
from daq.record.sealed import seal_file, sums
from daq.record.writer import SCHEMA
from daq.record.written import WRITTEN, WrittenFiles, WrittenMap


def seal_anew(folder: Path) -> None:
    """Make ``final.json`` state the files as they are now: what a maker of false records would do.

    So a changed file is read as far as its content allows, past all checks of sums.
    """
    path = folder / "final.json"
    fields = json.loads(path.read_bytes())
    del fields["crc"]
    for name in fields["files"]:
        if (folder / name).is_file():
            size, crc32 = sum_inside(folder, name)
            fields["files"][name] = {"size": size, "crc32": crc32}
    path.write_bytes(seal_file(fields))


def map_anew(folder: Path) -> None:
    """As :func:`seal_anew` for ``written.map`` of an interrupted record."""
    known = WrittenFiles(folder).files
    (folder / WRITTEN).unlink()
    about = sums((folder / "run.json").read_bytes())
    head = {"schema": SCHEMA, "run_id": folder.name, "run_json": about}
    made = WrittenMap(folder, head)
    for name, stated in known.items():
        if stated.crc32 and (folder / name).is_file():
            size, crc32 = sum_inside(folder, name)
            made.put(name, size, int(crc32, 16))
        elif not stated.crc32:
            made.constant(name, stated.size)
    made.close(False)
