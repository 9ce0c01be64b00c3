"""Recordings cut into trials: by a column, by pauses, by edges of a command, by cycles."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from gap.errors import GapError
from gap.mapping.formats.source import Whole
from gap.mapping.mapping import Cut, Stream
from gap.mapping.recording import Recording, numbers, on_off, words
from gap.model.bins import turning_points
from plant.arrays import Array

FIRST_NS = int(np.iinfo(np.int64).min // 2)
LAST_NS = int(np.iinfo(np.int64).max // 2)


@dataclass(frozen=True)
class Piece:
    """A part of a recording that becomes a trial.

    Attributes:
        labels: what it is called, after the values, pauses, edges or cycles that bound it.
        begin_ns, end_ns: from the first to before the second.
        rows: rows of settled points; None for a piece in time.
        part: number from 1 among the parts of one setting; 0 where it is no part.
        setting: labels without the number of the part.
    """

    labels: tuple[str, ...] = ()
    begin_ns: int = FIRST_NS
    end_ns: int = LAST_NS
    rows: Whole | None = None
    part: int = 0
    setting: tuple[str, ...] = ()


def cut(recording: Recording, plan: Cut) -> list[Piece]:
    """The trials of a recording, in order of time (settled points: of first appearance).

    Raises:
        GapError: no piece is left, or a trial's value returns after another.
    """
    pieces = [Piece()]
    if recording.mapping.time.settled:
        count = len(next(iter(recording.channels.values())).values)
        pieces = [Piece(rows=np.arange(count, dtype=np.int64))]
    for way in plan.by:
        if way == "column":
            for column in plan.columns:
                pieces = [p for piece in pieces for p in _by_column(recording, piece, column, plan)]
        elif way == "gaps":
            pieces = [p for piece in pieces for p in _by_gaps(recording, piece, plan)]
        elif way == "edges":
            pieces = [p for piece in pieces for p in _by_edges(recording, piece, plan)]
        elif way == "cycles":
            pieces = [p for piece in pieces for p in _by_cycles(recording, piece, plan)]
    if not pieces:
        raise GapError(
            str(recording.found.path), f"no trial is found by {', '.join(plan.by)}",
            f"check [cut] of {recording.mapping.path}",
        )  # fmt: skip
    return pieces


def _by_column(recording: Recording, piece: Piece, name: str, plan: Cut) -> list[Piece]:
    series, found = recording.texts(name)
    texts = np.array(found, dtype=object)
    if piece.rows is not None:
        _same_rows(recording, name, len(texts))
        chosen = texts[piece.rows]
        made = []
        for word in dict.fromkeys(chosen.tolist()):
            rows = piece.rows[chosen == word]
            if word in plan.ignore:
                continue
            if not word:
                raise series.column.error(int(rows[0]), "is empty", "state cut.ignore")
            labels = (*piece.labels, str(word))
            made.append(Piece(labels, rows=rows, setting=labels))
        return made
    assert series.ns is not None
    inside = np.flatnonzero((series.ns >= piece.begin_ns) & (series.ns < piece.end_ns))
    if not len(inside):
        return []
    here, at = texts[inside], series.ns[inside]
    first = np.flatnonzero(np.r_[True, here[1:] != here[:-1]])
    ends = np.r_[at[first[1:]], piece.end_ns]
    made, seen = [], set()
    for k, end in zip(first.tolist(), ends.tolist(), strict=True):
        word = str(here[k])
        if word in plan.ignore:
            continue
        row = int(inside[k])
        if not word:
            raise series.column.error(row, "is empty", "values that are no trial: cut.ignore")
        if word in seen:
            raise series.column.error(
                row, f"trial {word!r} begins again after another", "cut by gaps or edges as well"
            )
        seen.add(word)
        labels = (*piece.labels, word)
        made.append(Piece(labels, int(at[k]), int(end), setting=labels))
    return made


def _same_rows(recording: Recording, name: str, count: int) -> None:
    first, series = next(iter(recording.channels.items()))
    if count != len(series.values):
        what = f"column {name} has {count} rows and {first} has {len(series.values)}"
        raise GapError(str(recording.found.path), what)


def _parts(piece: Piece, bounds: list[tuple[int, int]]) -> list[Piece]:
    """Numbered parts of a piece."""
    return [
        replace(
            piece, labels=(*piece.labels, str(k)), begin_ns=begin, end_ns=end, part=k,
            setting=piece.setting,
        )
        for k, (begin, end) in enumerate(bounds, start=1)
    ]  # fmt: skip


def _by_gaps(recording: Recording, piece: Piece, plan: Cut) -> list[Piece]:
    times = [s.ns for s in recording.channels.values() if s.ns is not None]
    all_ns = np.unique(np.concatenate(times))
    all_ns = all_ns[(all_ns >= piece.begin_ns) & (all_ns < piece.end_ns)]
    if not len(all_ns):
        return []
    after = np.flatnonzero(np.diff(all_ns) > plan.gap_s * 1e9) + 1
    starts = [piece.begin_ns, *all_ns[after].tolist()]
    ends = [*all_ns[after].tolist(), piece.end_ns]
    return _parts(piece, list(zip(starts, ends, strict=True)))


def _by_edges(recording: Recording, piece: Piece, plan: Cut) -> list[Piece]:
    assert plan.edges is not None
    before = round(plan.before_s * 1e9)
    if plan.edge == "change":
        series = recording.series(plan.edges.stream)
        values: npt.NDArray[np.generic] = np.array(words(series.column), dtype=object)
    else:
        series = on_off(recording, plan.edges)
        values = series.values
    assert series.ns is not None
    inside = (series.ns >= piece.begin_ns) & (series.ns < piece.end_ns)
    ns, here = series.ns[inside], values[inside]
    if not len(ns):
        return []
    changed = np.r_[False, here[1:] != here[:-1]]
    if plan.edge == "change":
        changed[0] = True
    else:
        on = np.asarray(here, dtype=np.float64) > 0.5
        if plan.edge != "both":
            changed &= on if plan.edge == "rise" else ~on
        if plan.edge != "fall":
            changed[0] = on[0]  # a command that is on from the first row has risen there
    starts = [max(int(t) - before, piece.begin_ns) for t in ns[changed]]
    return _parts(piece, list(zip(starts, [*starts[1:], piece.end_ns], strict=True)))


def _by_cycles(recording: Recording, piece: Piece, plan: Cut) -> list[Piece]:
    series = recording.channels[plan.cycles]
    assert series.ns is not None
    inside = (series.ns >= piece.begin_ns) & (series.ns < piece.end_ns)
    ns, value = series.ns[inside], np.asarray(series.values[inside], dtype=np.float64)
    if not len(ns):
        return []
    bounds = cycles_of(value, plan.hysteresis, plan.start, plan.ends)
    if not bounds:
        raise GapError(
            f"{recording.mapping.path}: cut.cycles",
            f"{plan.cycles} of {recording.found.path} makes no whole cycle beyond the hysteresis "
            f"of {plan.hysteresis:g}; it spans {float(np.ptp(value)):g}",
        )
    last = piece.end_ns
    return _parts(
        piece, [(int(ns[a]), int(ns[b]) if b < len(ns) else last) for a, b in bounds]
    )  # fmt: skip


def cycles_of(value: Array, hysteresis: float, start: str, ends: str) -> list[tuple[int, int]]:
    """First row and the row after the last of each cycle.

    A cycle goes from a low (or high) turning point to the next. With `ends` "keep", what comes
    before the first and after the last of these counts as a cycle if it also turns; with "drop" it
    is left out.

    Args:
        value: the channel, shape (n,).
        hysteresis: swings smaller than this are no turn.
        start: "low" or "high".
        ends: "drop" or "keep".
    """
    at = turning_points(np.arange(len(value), dtype=np.float64), value, hysteresis)
    turns = at.astype(np.int64)
    if not len(turns):
        return []
    follows = value[turns[1]] if len(turns) > 1 else value[-1]
    first_is_high = bool(value[turns[0]] > follows)
    first = 0 if first_is_high == (start == "high") else 1
    starts = turns[first::2].tolist()
    if ends == "keep":
        begun = starts[0] if starts else len(value)
        others = turns[1 - first :: 2]
        if (others < begun).any() and (not starts or starts[0] > 0):
            starts = [0, *starts]
        if starts and (others > starts[-1]).any():
            starts = [*starts, len(value)]
    return list(itertools.pairwise(starts))


def rows_outside(recording: Recording, pieces: list[Piece]) -> int:
    """Measured samples of a recording that are in no piece."""
    total = 0
    for series in recording.channels.values():
        if series.ns is None:
            kept = {int(row) for piece in pieces if piece.rows is not None for row in piece.rows}
            total += len(series.values) - len(kept)
            continue
        inside = np.zeros(len(series.ns), dtype=bool)
        for piece in pieces:
            inside |= (series.ns >= piece.begin_ns) & (series.ns < piece.end_ns)
        total += int((~inside).sum())
    return total


def constant_text(recording: Recording, piece: Piece, column: str, what: str) -> str:
    """The text that a column has throughout a piece. Raises `GapError` if it changes."""
    series, texts = recording.texts(column)
    rows = _rows_in(series.ns, piece, len(texts))
    if not len(rows):
        raise GapError(series.column.where, f"has no row in trial {'-'.join(piece.labels) or 1}")
    found: list[str] = [texts[row] for row in rows.tolist()]
    for row, word in zip(rows, found, strict=True):
        if word != found[0]:
            raise series.column.error(
                int(row), f"{word!r} after {found[0]!r} in one trial", f"{what} holds for a trial"
            )
    return found[0]


def constant_number(recording: Recording, piece: Piece, column: str, what: str) -> float:
    """The number that a column has throughout a piece; NaN if empty. Raises `GapError`."""
    series = recording.series(Stream(column))
    value = numbers(series.column)
    rows = _rows_in(series.ns, piece, len(value))
    here = value[rows]
    if not len(here):
        raise GapError(series.column.where, f"has no row in trial {'-'.join(piece.labels) or 1}")
    other = np.flatnonzero(~((here == here[0]) | (np.isnan(here) & np.isnan(here[0]))))
    if len(other):
        raise series.column.error(
            int(rows[other[0]]), f"{here[other[0]]:g} after {here[0]:g} in one trial",
            f"{what} holds for a trial; map it as a channel, or cut by this column",
        )  # fmt: skip
    return float(here[0])


def _rows_in(ns: Whole | None, piece: Piece, count: int) -> Whole:
    if piece.rows is not None:
        if piece.rows.max(initial=-1) >= count:
            return np.empty(0, dtype=np.int64)
        return piece.rows
    assert ns is not None
    return np.flatnonzero((ns >= piece.begin_ns) & (ns < piece.end_ns)).astype(np.int64)
