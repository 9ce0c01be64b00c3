"""Checks every byte of a run against its checksums and lists all damage."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from daq.errors import RecordError
from daq.record.chunks import ChunkIndex, Problem
from daq.record.disk import RESERVE_BYTES, RESERVE_NAME
from daq.record.safe_read import names_inside, read_inside, sum_inside
from daq.record.sealed import open_file
from daq.record.written import WRITTEN, Written
from daq.store.annotations import ANNOTATIONS, SEAL, annotations_differ, read_annotations
from daq.store.belongs import EVENTS
from daq.store.run import DERIVED, INTERRUPTED, PARTIAL, Run, stream_of
from daq.store.validate import structure_error
from daq.store.versions import missing_versions, version_folders

MOST_FINDINGS = 50
"""So many are stated in reports and exports; `pamrig runs verify` states all."""


def verify(run: Run) -> list[Problem]:
    """All damaged, missing, exchanged, unfinished and unknown data in the run folder.

    The list is empty for a finished run without damage. Bytes that an interrupted run left
    unfinished have ``tail`` set; they are never read as data.
    """
    return sorted(set(_problems(Run(run.folder))), key=lambda p: (p.file, p.offset, p.what))


def unproven(run: Run) -> str:
    """What a record of an old format cannot prove; "" for the present format."""
    if run.version > 1:
        return ""
    if run.outcome == INTERRUPTED:
        return (
            "format 1, not finished: a file that was removed, exchanged for that of another run, "
            "or cut off at the end of a line cannot be detected"
        )
    return "format 1: an exchanged run.json, or removed annotations, cannot be detected"


def _problems(run: Run) -> Iterator[Problem]:
    folder = run.folder
    seen = {"run.json", "final.json", EVENTS, WRITTEN, ANNOTATIONS, SEAL}
    found = list(_record_problems(run, seen))
    yield from found
    belonging = run.belonging
    yield from belonging.problems
    for name, why in belonging.strangers.items():
        yield Problem(name, 0, why)
    if belonging.lister not in belonging.strangers:
        yield from _sums(folder, belonging.stated, {p.file for p in found if not p.tail})
        seen.update(belonging.stated)
    final = run.final or {}
    if "write_failure" in final:
        yield Problem("final.json", 0, f"writing failed: {final['write_failure'].get('what')}")
    yield from _derived_problems(run, seen)
    try:
        read_annotations(folder)
    except RecordError as error:
        yield Problem(ANNOTATIONS, 0, error.what)
    if run.outcome == INTERRUPTED and os.path.lexists(folder / RESERVE_NAME):
        seen.add(RESERVE_NAME)
        yield from _reserve_problems(folder)
    try:
        for name, size in names_inside(folder):
            if name.startswith(f"{PARTIAL}/"):
                what = "left by derived files that were not completed; the next ones replace it"
                yield Problem(name, 0, what, size, True)
            elif name not in seen:
                what = "the record does not list this file, not read"
                yield Problem(name, 0, what, size, run.outcome == INTERRUPTED)
    except RecordError as error:
        yield Problem("", 0, error.what)


def _reserve_problems(folder: Path) -> Iterator[Problem]:
    try:
        if read_inside(folder, RESERVE_NAME, RESERVE_BYTES).strip(b"\x00"):
            yield Problem(RESERVE_NAME, 0, "expected zeros only")
    except RecordError as error:
        yield Problem(RESERVE_NAME, 0, error.what)


def _record_problems(run: Run, seen: set[str]) -> Iterator[Problem]:
    """Damage found with the CRCs of lines and chunks, for finished and interrupted runs."""
    folder = run.folder
    if run.run_json is None and not any(p.file == "run.json" for p in run.problems):
        yield Problem("run.json", 0, "missing")
    try:
        _ = run.events
    except RecordError as error:
        yield Problem(EVENTS, 0, error.what)
    names = [f"samples/{stream}.index.jsonl" for stream in run.streams]
    names += [p for p in ("frames.jsonl",) if os.path.lexists(folder / p)]
    names += [
        p.relative_to(folder).as_posix() for p in sorted((folder / "wire").glob("*.index.jsonl"))
    ]
    for name in names:
        seen.add(name)
        try:
            run.refuse_stranger(name)
            if name.startswith("samples/"):
                index = run.index(name.removeprefix("samples/").removesuffix(".index.jsonl"))
            else:
                index = ChunkIndex(folder, name)
        except RecordError as error:
            yield Problem(name, 0, error.what)
            continue
        seen.update(entry.file for entry in index.entries)
        if name.startswith("samples/"):
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


def _derived_problems(run: Run, seen: set[str]) -> Iterator[Problem]:
    names = version_folders(run.folder)
    for folder in (DERIVED, *names):
        if os.path.lexists(run.folder / folder / "manifest.json"):
            yield from _folder_problems(run, folder, seen)
    for missing in missing_versions(names):
        yield Problem(missing, 0, "missing: a later derived version is there")


def _folder_problems(run: Run, folder: str, seen: set[str]) -> Iterator[Problem]:
    """Damage in the derived files, or in a derived version."""
    name = f"{folder}/manifest.json"
    seen.add(name)
    own = folder == DERIVED
    replace = "pamrig runs rebuild replaces it" if own else "make the version again"
    try:
        fields = open_file(read_inside(run.folder, name))
        listed = fields.get("files")
    except (ValueError, RecordError):
        yield Problem(name, 0, f"does not match its CRC; {replace}")
        return
    if not isinstance(listed, dict) or structure_error("derived/manifest.json", fields):
        yield Problem(name, 0, f"is not a list of files; {replace}")
        return
    files = {
        f"{folder}/{file}": Written(sums["size"], sums["crc32"], True)
        for file, sums in listed.items()
    }
    seen.update(files)
    if fields.get("run_id") != run.belonging.run_id:
        yield Problem(name, 0, f"belongs to run {fields.get('run_id')}; {replace}")
    elif not own and fields.get("version") != folder:
        yield Problem(name, 0, f"is that of {fields.get('version')}; {replace}")
    elif wrong := annotations_differ(run.folder, fields, later=not own):
        yield Problem(name, 0, f"{wrong}; {replace}")
    yield from _sums(run.folder, files, set())


def _sums(folder: Path, files: dict[str, Written], reported: set[str]) -> Iterator[Problem]:
    """Damage found only with the sums of whole files: removed, cut off or exchanged files."""
    for name, known in files.items():
        try:
            size, crc32 = sum_inside(folder, name, None if known.exact else known.size)
        except RecordError as error:
            if error.what != "missing" or name not in reported:
                yield Problem(name, 0, error.what)
            continue
        if size < known.size or (known.exact and size != known.size):
            what = f"{size} bytes, expected {known.size}"
            yield Problem(name, min(size, known.size), what)
        elif known.crc32 not in ("", crc32) and name not in reported:
            yield Problem(name, 0, "does not match the CRC of the whole file", size)


def findings(run: Run) -> tuple[str, ...]:
    """What :func:`verify` finds in a record, for whatever is made from it; derived files excepted.

    The result is kept with the run, so that a record is checked once for all its readers.
    """
    known: tuple[str, ...] | None = run.__dict__.get("_findings")
    if known is None:
        found = [str(p) for p in verify(run) if not p.file.startswith("derived")]
        if len(found) > MOST_FINDINGS:
            found[MOST_FINDINGS:] = [f"and {len(found) - MOST_FINDINGS} more"]
        known = run.__dict__["_findings"] = tuple(found)
    return known


def summary_of(problems: list[Problem]) -> list[dict[str, Any]]:
    """Problems as plain values for JSON."""
    return [{"file": p.file, "offset": p.offset, "what": p.what} for p in problems]
