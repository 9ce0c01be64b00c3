"""Annotations added to a run after its end: notes, and excluded points with a reason.

``annotations.jsonl`` in the run folder is append-only, one sealed line per annotation
(:mod:`daq.record.sealed`). Neither a point nor the reason for its exclusion is ever deleted.
``annotations.seal`` states run, number of lines, size and CRC of the file, so that a removed,
exchanged or shortened file is detected; derived files state the same for what they were made with.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Sequence
from dataclasses import dataclass
from dataclasses import fields as dataclass_fields
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from daq.errors import RecordError
from daq.record.disk import disk_error
from daq.record.safe_read import path_inside, read_inside
from daq.record.sealed import open_file, read_lines, seal_line, sums, write_all, write_sealed

ANNOTATIONS = "annotations.jsonl"
SEAL = "annotations.seal"
ACTIONS = {"note": "a remark", "exclude": "an exclusion", "include": "an inclusion"}


@dataclass(frozen=True)
class Annotation:
    """One annotation.

    Attributes:
        n: its number, from 0.
        utc: time, ISO.
        who: author.
        action: "note", "exclude", or "include" to revoke an exclusion.
        points: numbers (``order``) of the points concerned; empty for the whole run.
        reason: never empty.
    """

    n: int
    utc: str
    who: str
    action: str
    points: tuple[int, ...]
    reason: str


def annotate(
    folder: Path,
    action: str,
    points: Sequence[int],
    reason: str,
    who: str = "",
    now: datetime | None = None,
) -> Annotation:
    """Append an annotation durably.

    Args:
        folder: of the run.
        action: one of :data:`ACTIONS`.
        points: numbers of the points concerned.
        reason: not empty.
        who: author.
        now: time of the annotation; default is the present time.

    Raises:
        RecordError: no reason or points are given, a point is not excluded, or the file is damaged
            or cannot be written.
    """
    if not reason.strip():
        raise RecordError(str(folder), f"{ACTIONS[action]} needs a reason", 'give --reason "..."')
    if action != "note" and not points:
        raise RecordError(
            str(folder), f"{ACTIONS[action]} needs points", "give their numbers (order)"
        )
    before = read_annotations(folder)
    if action == "include" and (never := set(points) - set(excluded_points(folder))):
        raise RecordError(
            str(folder),
            f"point {min(never)} is not excluded",
            "give the numbers of excluded points",
        )
    utc = (now or datetime.now(UTC)).strftime("%Y-%m-%dT%H:%M:%SZ")
    made = Annotation(
        len(before), utc, who, action, tuple(sorted({int(p) for p in points})), reason.strip()
    )
    line = seal_line({**vars(made), "points": list(made.points)})
    old = _bytes(folder)
    after = {"run_id": _run_id(folder), "count": len(before) + 1, **sums(old + line)}
    try:
        # Not through a link: the folder may come from an untrusted source.
        path_inside(Path(folder), ANNOTATIONS)
        path_inside(Path(folder), SEAL)
        # Until the line is written, the file may be as it was: a crash here loses nothing.
        write_sealed(folder / SEAL, {**after, "before": {"count": len(before), **sums(old)}})
        flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0)
        fd = os.open(folder / ANNOTATIONS, flags, 0o644)
        try:
            write_all(fd, line)
            os.fsync(fd)
        finally:
            os.close(fd)
        write_sealed(folder / SEAL, after)
    except OSError as error:
        raise disk_error(folder / ANNOTATIONS, "cannot be written", error) from error
    return made


def read_annotations(folder: Path) -> list[Annotation]:
    """All annotations in order; an empty list if there are none.

    Raises:
        RecordError: a line is damaged or missing, or the file was removed, exchanged or shortened;
            an exclusion could otherwise be lost unnoticed.
    """
    path = Path(folder) / ANNOTATIONS
    data = _bytes(folder)
    found = []
    for number, line in enumerate(read_lines(data)):
        if line.fields is None or line.fields.get("n") != number:
            raise RecordError(
                f"{path} line {number + 1}",
                "does not match its CRC" if line.fields is None else "a line is missing",
                "restore the file from a copy; points may have been excluded there",
            )
        found.append(_annotation(line.fields, f"{path} line {number + 1}"))
    if wrong := _unlike_seal(Path(folder), data):
        raise RecordError(
            str(path), wrong, "restore it from a copy; points may have been excluded there"
        )
    return found


def annotation_sums(folder: Path) -> dict[str, Any]:
    """Number of annotations, and size and CRC of their file, for what is derived with them.

    Raises:
        RecordError: as :func:`read_annotations`.
    """
    return {"count": len(read_annotations(folder)), **sums(_bytes(folder))}


def annotations_differ(folder: Path, manifest: dict[str, Any], later: bool = False) -> str:
    """Why derived files were not made with the present annotations; "" if they were.

    Args:
        folder: of the run.
        manifest: members of the manifest of the derived files.
        later: annotations that were added since do not matter.
    """
    made_with = manifest.get("annotations")
    if not isinstance(made_with, dict):
        return ""  # a manifest of format 1
    size = made_with.get("size")
    data = _bytes(folder)
    if type(size) is not int or sums(data[: max(size, 0)])["crc32"] != made_with.get("crc32"):
        return "was made with annotations that are not there any more"
    return "was made before the last annotation" if len(data) > size and not later else ""


def _bytes(folder: Path) -> bytes:
    there = os.path.lexists(Path(folder) / ANNOTATIONS)
    return read_inside(Path(folder), ANNOTATIONS) if there else b""


def _run_id(folder: Path) -> str:
    """The run's name as run.json states it, else that of its folder."""
    with contextlib.suppress(ValueError, RecordError):
        stated = open_file(read_inside(Path(folder), "run.json")).get("run_id")
        return str(stated or Path(folder).resolve().name)
    return Path(folder).resolve().name


def _unlike_seal(folder: Path, data: bytes) -> str:
    """Why the annotations are not those of their seal; "" if they are."""
    if not os.path.lexists(folder / SEAL):
        old = os.path.lexists(folder / ANNOTATIONS) and _version(folder) > 1
        return f"{SEAL} is missing" if old else ""
    try:
        seal = open_file(read_inside(folder, SEAL))
    except ValueError:
        return f"{SEAL} does not match its CRC"
    if seal.get("run_id") != _run_id(folder):
        return f"{SEAL} belongs to run {seal.get('run_id')}"
    there = sums(data)
    states = [seal, seal.get("before", {})]
    if any(isinstance(s, dict) and there.items() <= s.items() for s in states):
        return ""
    return f"not the {seal.get('count')} annotations that {SEAL} states"


def _version(folder: Path) -> int:
    with contextlib.suppress(ValueError, RecordError):
        schema = open_file(read_inside(Path(folder), "run.json")).get("schema")
        return 1 if schema == "pamrig-run/1" else 2
    return 2


def _annotation(fields: dict[str, Any], where: str) -> Annotation:
    points = fields.get("points")
    texts = all(isinstance(fields.get(key), str) for key in ("utc", "who", "action", "reason"))
    whole = isinstance(points, list) and all(type(point) is int for point in points)
    if not texts or not whole or set(fields) != {f.name for f in dataclass_fields(Annotation)}:
        raise RecordError(where, "is not an annotation", "pamrig did not write this line")
    return Annotation(**{**fields, "points": tuple(points or ())})


def excluded_points(folder: Path) -> dict[int, str]:
    """The currently excluded points, each with its latest reason."""
    out: dict[int, str] = {}
    for annotation in read_annotations(folder):
        for point in annotation.points:
            if annotation.action == "exclude":
                out[point] = annotation.reason
            elif annotation.action == "include":
                out.pop(point, None)
    return out
