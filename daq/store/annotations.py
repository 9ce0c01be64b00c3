"""What is said about a run afterwards: remarks, and points excluded with a reason.

``annotations.jsonl`` in the run folder is only ever appended to, one sealed line a remark
(:mod:`daq.record.sealed`), so that neither a point nor the reason why it is left out is ever lost.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from dataclasses import fields as dataclass_fields
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from daq.errors import RecordError
from daq.record.disk import disk_error
from daq.record.sealed import read_lines, seal_line, sync_folder, write_all
from daq.record.within import path_inside, read_inside

ANNOTATIONS = "annotations.jsonl"
ACTIONS = {"note": "a remark", "exclude": "an exclusion", "include": "an inclusion"}


@dataclass(frozen=True)
class Annotation:
    """One remark.

    Attributes:
        n: its number, from 0.
        utc: when, ISO.
        who: by whom.
        action: "note", "exclude", or "include" to take an exclusion back.
        points: numbers (``order``) of the points concerned; none: the run as a whole.
        reason: why; never empty.
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
    """Append a remark, durably.

    Args:
        folder: of the run.
        action: one of :data:`ACTIONS`.
        points: numbers of the points concerned.
        reason: why.
        who: by whom.
        now: instead of the present time.

    Raises:
        RecordError: no reason, nothing to exclude, a damaged file, or it cannot be written.
    """
    if not reason.strip():
        raise RecordError(str(folder), f"{ACTIONS[action]} needs a reason", 'give --reason "..."')
    if action != "note" and not points:
        raise RecordError(
            str(folder), f"{ACTIONS[action]} needs points", "give their numbers (order)"
        )
    before = read_annotations(folder)
    if action == "include" and (never := set(points) - set(excluded_points(folder))):
        raise RecordError(str(folder), f"point {min(never)} is not excluded", "nothing to undo")
    utc = (now or datetime.now(UTC)).strftime("%Y-%m-%dT%H:%M:%SZ")
    made = Annotation(
        len(before), utc, who, action, tuple(sorted({int(p) for p in points})), reason.strip()
    )
    line = seal_line({**vars(made), "points": list(made.points)})
    try:
        # Not through a link: a stranger's folder may hold one that leads anywhere.
        path_inside(Path(folder), ANNOTATIONS)
        flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0)
        fd = os.open(folder / ANNOTATIONS, flags, 0o644)
        try:
            write_all(fd, line)
            os.fsync(fd)
        finally:
            os.close(fd)
        sync_folder(folder)
    except OSError as error:
        raise disk_error(folder / ANNOTATIONS, "cannot be written", error) from error
    return made


def read_annotations(folder: Path) -> list[Annotation]:
    """Every remark in order; none where nothing was said.

    Raises:
        RecordError: a line is damaged or missing: an exclusion must not come undone in silence.
    """
    path = Path(folder) / ANNOTATIONS
    if not path.is_file():
        return []
    found = []
    for number, line in enumerate(read_lines(read_inside(Path(folder), ANNOTATIONS))):
        if line.fields is None or line.fields.get("n") != number:
            raise RecordError(
                f"{path} line {number + 1}",
                "does not carry its checksum" if line.fields is None else "a line is missing",
                "restore the file from a copy; points may have been excluded there",
            )
        found.append(_remark(line.fields, f"{path} line {number + 1}"))
    return found


def _remark(fields: dict[str, Any], where: str) -> Annotation:
    points = fields.get("points")
    texts = all(isinstance(fields.get(key), str) for key in ("utc", "who", "action", "reason"))
    whole = isinstance(points, list) and all(type(point) is int for point in points)
    if not texts or not whole or set(fields) != {f.name for f in dataclass_fields(Annotation)}:
        raise RecordError(where, "is sealed, but is no remark", "pamrig did not write it")
    return Annotation(**{**fields, "points": tuple(points or ())})


def excluded_points(folder: Path) -> dict[int, str]:
    """Points that are excluded now, each with the latest reason."""
    out: dict[int, str] = {}
    for remark in read_annotations(folder):
        for point in remark.points:
            if remark.action == "exclude":
                out[point] = remark.reason
            elif remark.action == "include":
                out.pop(point, None)
    return out
