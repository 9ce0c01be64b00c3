"""Which files of a run folder belong to its run.

A file that was exchanged for that of another run is sound by its own checksums. What shows it:

* ``final.json`` (of a finished run) and ``written.map`` (of an interrupted one) state size and
  CRC-32 of every file;
* in records of format 2 each index, and the events, name their run in the first line.

A record of format 1 that was interrupted has neither.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from daq.errors import RecordError
from daq.record.chunks import Problem
from daq.record.safe_read import LARGEST_INDEX, read_inside, sum_inside
from daq.record.sealed import open_line, read_lines
from daq.record.written import WRITTEN, Written, WrittenFiles
from daq.store.validate import SCHEMAS

EVENTS = "events.jsonl"


@dataclass(frozen=True)
class Belonging:
    """What the files of a folder say of themselves.

    Attributes:
        folder: of the run.
        run_id: the run that most of it belongs to.
        version: of the format.
        stated: what is known of each file, by name; empty if nothing is.
        lister: the file that states it, ``final.json`` or ``written.map``.
        strangers: sealed files that belong to another run, with the reason.
        problems: further findings, about the folder as a whole.
    """

    folder: Path
    run_id: str
    version: int
    stated: dict[str, Written]
    lister: str
    strangers: dict[str, str]
    problems: tuple[Problem, ...]

    def stranger(self, name: str) -> str:
        """Why an index, or the events, is not this run's; "" if it is, or cannot be read."""
        try:
            data = read_inside(self.folder, name, LARGEST_INDEX)
        except RecordError:
            return ""
        own = self._first_line(name, data)
        if own is not None and own != "":
            return own
        known = self.stated.get(name)
        if known is None:
            listed = self.stated and self.lister == "final.json"
            unknown = listed or (own is None and self.version > 1)
            return f"{self.lister} does not list it" if unknown else ""
        if self._as_stated(name, known) or (len(data) < known.size and not known.exact):
            return ""
        first = data if known.exact else data[: known.size]
        if all(line.fields is not None for line in read_lines(first)):
            return f"each line is sound, but not the whole as {self.lister} states it"
        return ""

    def _as_stated(self, name: str, known: Written) -> bool:
        size, crc32 = sum_inside(self.folder, name, None if known.exact else known.size)
        return crc32 == known.crc32 and (size == known.size or not known.exact)

    def _first_line(self, name: str, data: bytes) -> str | None:
        """Why the first line is not this run's; "" if it is, None if it cannot be known."""
        if self.version < 2:
            return None
        try:
            head = open_line(data[: data.find(b"\n") + 1])
        except ValueError:
            return None
        if head.get("run_id") != self.run_id:
            return f"its first line names run {head.get('run_id')}"
        stem = name.rpartition("/")[2].removesuffix(".index.jsonl")
        for key in ("stream", "wire"):
            if key in head and (head[key] != stem or name == EVENTS):
                return f"its first line names {key} {head[key]}"
        kinds = {EVENTS: "events", "frames.jsonl": "frames"}
        kind = kinds.get(name, "wire" if name.startswith("wire/") else "stream")
        return "" if kind in head else f"its first line is not that of {kind}"


def belonging(
    folder: Path, run_json: dict[str, Any] | None, final: dict[str, Any] | None
) -> Belonging:
    """What the files of a folder say of themselves.

    Args:
        folder: of the run.
        run_json: members of ``run.json``; None if it is missing or damaged.
        final: members of ``final.json``; None if it is missing or damaged.
    """
    name = folder.resolve().name
    written = WrittenFiles(folder)
    ended = os.path.lexists(folder / "final.json")
    problems = [] if ended else list(written.problems)
    said = final if ended else written.head
    lister = "final.json" if ended else WRITTEN
    ours, theirs = (run_json or {}).get("run_id"), (said or {}).get("run_id")
    schemas = [t.get("schema") for t in (run_json, said) if t]
    strangers: dict[str, str] = {}
    if run_json is not None and not isinstance(ours, str):
        strangers["run.json"] = "names no run"
    if ours and theirs and ours != theirs:
        stranger, other = (lister, theirs) if ours == name else ("run.json", ours)
        strangers[stranger] = (
            f"belongs to run {other}, the rest to {ours if other == theirs else theirs}"
        )
    run_id = name if name in (ours, theirs) else str(ours or theirs or name)
    if run_id != name:
        what = f"belongs to run {run_id}, but the folder is named {name}"
        problems.append(Problem("run.json", 0, what))
    version = max((SCHEMAS.get(str(schema), 1) for schema in schemas), default=1)
    version = 2 if written.there else version
    if version >= 2 and not ended and not written.there:
        what = "missing: a run that has ended has it, any other has written.map"
        problems.append(Problem("final.json", 0, what))
    stated: dict[str, Written] = {}
    if not ended:
        stated = written.files
    elif final is not None and lister not in strangers:
        stated = {
            name: Written(sums["size"], sums["crc32"], True)
            for name, sums in final["files"].items()
        }
    of_run = stated.get("run.json")
    if not ended and isinstance(written.head.get("run_json"), dict) and not strangers:
        sums = written.head["run_json"]
        of_run = Written(int(sums.get("size", 0)), str(sums.get("crc32")), True)
    if of_run is not None and run_json is not None and "run.json" not in strangers:
        size, crc32 = sum_inside(folder, "run.json")
        if (size, crc32) != (of_run.size, of_run.crc32):
            strangers["run.json"] = f"is not the one that {lister} states"
    return Belonging(folder, run_id, version, stated, lister, strangers, tuple(problems))
