"""Checks every byte of a run against its checksums and lists all damage."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from daq.errors import RecordError
from daq.record.chunks import ChunkIndex, Problem
from daq.record.disk import RESERVE_BYTES, RESERVE_NAME
from daq.record.safe_read import path_inside, read_inside
from daq.record.sealed import open_file
from daq.store.annotations import ANNOTATIONS, read_annotations
from daq.store.run import INTERRUPTED, Run, stream_of
from daq.store.validate import structure_error


def verify(run: Run) -> list[Problem]:
    """All damaged, missing, unfinished and unknown data in the run folder.

    The list is empty for a finished run without damage. Bytes that an interrupted run left
    unfinished have ``tail`` set; they are never read as data.
    """
    return sorted(_problems(Run(run.folder)), key=lambda p: (p.file, p.offset))


def _problems(run: Run) -> Iterator[Problem]:
    folder = run.folder
    seen = {"run.json", "final.json", "events.jsonl"}
    found = list(_record_problems(run, seen))
    yield from found
    final = run.final
    if final is not None:
        yield from _against_final(run, final, {p.file for p in found})
        seen.update(final["files"])
    yield from _derived_problems(folder, seen)
    yield from _annotation_problems(folder, seen)
    reserve = folder / RESERVE_NAME
    if run.outcome == INTERRUPTED and reserve.exists():
        seen.add(RESERVE_NAME)
        if reserve.stat().st_size > RESERVE_BYTES or reserve.read_bytes().strip(b"\x00"):
            yield Problem(RESERVE_NAME, 0, "expected zeros only")
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if not path.is_dir() and name not in seen:
            tail = run.outcome == INTERRUPTED
            what = "the record does not list this file, not read"
            yield Problem(name, 0, what, path.stat().st_size, tail)


def _annotation_problems(folder: Path, seen: set[str]) -> Iterator[Problem]:
    """Damage in the annotations."""
    seen.add(ANNOTATIONS)
    try:
        read_annotations(folder)
    except RecordError as error:
        yield Problem(ANNOTATIONS, 0, error.what)


def _record_problems(run: Run, seen: set[str]) -> Iterator[Problem]:
    """Damage found with the CRCs of lines and chunks, for finished and interrupted runs."""
    folder = run.folder
    run.sealed("run.json")
    _ = run.final
    _ = run.events
    indexes = [run.index(stream) for stream in run.streams]
    others = [p for p in [folder / "frames.jsonl"] if p.exists()]
    others += sorted((folder / "wire").glob("*.index.jsonl"))
    indexes += [ChunkIndex(folder, p.relative_to(folder).as_posix()) for p in others]
    for index in indexes:
        seen.add(index.index)
        seen.update(entry.file for entry in index.entries)
        if index.index.startswith("samples/"):
            run.read_rows(index)
            seen.add(_ahead_problems(run, index))
        else:
            for _ in index.valid_chunks():
                pass
        run.problems.extend(index.problems)
    yield from run.problems


def _ahead_problems(run: Run, index: ChunkIndex) -> str:
    """Damage in the write-ahead file; returns its name, "" if there can be none."""
    if run.outcome != INTERRUPTED:
        return ""
    try:
        ahead = run.rows_ahead(index, run.schema(stream_of(index)))
    except RecordError:  # the damaged index is already listed
        return ""
    index.problems.extend(ahead.problems)
    for low, high in ahead.missing:
        what = f"rows {low} to {high - 1} are lost"
        index.problems.append(Problem(ahead.name, 0, what))
    return ahead.name


def _against_final(run: Run, final: dict[str, Any], reported: set[str]) -> Iterator[Problem]:
    """Damage found only with the sums in final.json: truncated, exchanged or missing files."""
    started = run.sealed("run.json")
    if started is not None and (named := started.get("run_id")) != final["run_id"]:
        what = f"belongs to run {final['run_id']}, run.json to {named}"
        yield Problem("final.json", 0, what)
    yield from _sums(run.folder, final["files"], reported)
    if "write_failure" in final:
        yield Problem("final.json", 0, f"writing failed: {final['write_failure']['what']}")


def _derived_problems(folder: Path, seen: set[str]) -> list[Problem]:
    path = folder / "derived" / "manifest.json"
    if not path.exists():
        return []
    name = "derived/manifest.json"
    seen.add(name)
    try:
        fields = open_file(read_inside(folder, name))
        listed = fields.get("files")
    except (ValueError, RecordError):
        return [Problem(name, 0, "does not match its CRC; pamrig runs rebuild replaces it")]
    if not isinstance(listed, dict) or structure_error(name, fields):
        return [Problem(name, 0, "is not a list of files; pamrig runs rebuild replaces it")]
    files = {f"derived/{file}": sums for file, sums in listed.items()}
    seen.update(files)
    return list(_sums(folder, files, set()))


def _sums(folder: Path, files: dict[str, dict[str, Any]], reported: set[str]) -> Iterator[Problem]:
    for name, expected in files.items():
        try:
            path = path_inside(folder, name)
        except RecordError as error:
            yield Problem(name, 0, error.what)
            continue
        if not path.is_file():
            if name not in reported:
                yield Problem(name, 0, "missing")
            continue
        size, crc = _sum(path)
        if size != expected["size"]:
            what = f"{size} bytes, expected {expected['size']}"
            yield Problem(name, min(size, int(expected["size"])), what)
        elif f"{crc:08x}" != expected["crc32"] and name not in reported:
            yield Problem(name, 0, "does not match the CRC of the whole file", size)


def _sum(path: Path) -> tuple[int, int]:
    size = crc = 0
    with open(path, "rb") as file:
        while block := file.read(1 << 20):
            size += len(block)
            crc = zlib.crc32(block, crc)
    return size, crc
