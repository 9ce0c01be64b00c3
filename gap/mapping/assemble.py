"""Pieces of recordings as trials of data sets, one set for each muscle."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from gap.data.trial import CHANNELS, COMMANDS
from gap.errors import GapError
from gap.mapping.cutting import (
    FIRST_NS,
    Piece,
    constant_number,
    constant_text,
    cut,
    rows_outside,
)
from gap.mapping.mapping import FACTS, Label, Mapping
from gap.mapping.recording import Recording, fact_value, find_files, read_recording
from gap.mapping.units import DIMENSION, conversion
from plant.arrays import Array

TRIAL_COLUMNS = (
    "trial", "slot", "replicate", "protocol", "mounting", "order", "held_length_mm", "load_kg",
    "temperature_c", "start_s", "tare_length_mm", "note",
)  # fmt: skip
SAMPLE_COLUMNS = ("trial", "time_s", *COMMANDS, *CHANNELS, "direction")


@dataclass
class MuscleSet:
    """The trials of one muscle.

    Attributes:
        name: of the muscle; "" where the mapping names none.
        trials: rows of trials.csv.
        samples: one table a trial, in the columns of the dataset format.
        recordings: what it was read from.
        notes: what a reader should know.
    """

    name: str
    trials: list[dict[str, Any]] = field(default_factory=list)
    samples: list[pd.DataFrame] = field(default_factory=list)
    recordings: list[Recording] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    @property
    def clock_errors_ms(self) -> dict[str, float]:
        """What the joined clocks of its recordings leave open, by key of `calibration.toml`.

        Of several recordings the largest.
        """
        found: dict[str, float] = {}
        for recording in self.recordings:
            for key in recording.clocks if recording.offset is not None else ():
                assert recording.offset is not None
                found[key] = max(found.get(key, 0.0), 1e3 * recording.offset.u_s)
        return found


def assemble(mapping: Mapping, folder: Path) -> list[MuscleSet]:
    """Read all files of a mapping and cut them into trials.

    Args:
        mapping: the mapping.
        folder: that of the data files.

    Raises:
        GapError: names file and row, or the key of the mapping.
    """
    found = find_files(mapping, folder)
    sets: dict[str, MuscleSet] = {}
    for file in found:
        recording = read_recording(mapping, file, folder)
        pieces = cut(recording, mapping.cut)
        outside = rows_outside(recording, pieces)
        absent = {name: s.dropped for name, s in recording.channels.items() if s.dropped}
        for piece in pieces:
            muscle = _label(mapping, recording, piece, "muscle", "")
            own = sets.setdefault(muscle, MuscleSet(muscle))
            if recording not in own.recordings:
                own.recordings.append(recording)
                if file.doubt:
                    own.notes.append(file.doubt)
                if outside:
                    own.notes.append(f"{file.path.name}: {outside} samples belong to no trial")
                if recording.offset is not None and mapping.join is not None:
                    name = f"{file.path.name}: {mapping.join.channel}"
                    own.notes.append(recording.offset.words(name))
                own.notes += [
                    f"{file.path.name}: {name}: {count} values stand for no measurement"
                    for name, count in absent.items()
                ]
            _add(own, mapping, recording, piece, several=len(found) > 1)
    for muscle in mapping.muscles:
        if muscle not in sets:
            raise GapError(
                f"{mapping.path}: muscles.{muscle}", "no such muscle in the data",
                f"there are: {', '.join(sets)}",
            )  # fmt: skip
    for one in sets.values():
        _finish(one, mapping)
    return list(sets.values())


def _label(mapping: Mapping, recording: Recording, piece: Piece, name: str, default: str) -> str:
    label: Label | None = mapping.labels.get(name)
    if label is None:
        return default
    if label.column:
        return constant_text(recording, piece, label.column, name)
    return recording.found.filled(label.text)


def _add(
    own: MuscleSet, mapping: Mapping, recording: Recording, piece: Piece, several: bool
) -> None:
    parts = ([recording.found.path.stem] if several or not piece.labels else []) + [*piece.labels]
    whole = ([recording.found.path.stem] if several or not piece.setting else []) + [*piece.setting]
    name = "-".join(parts)
    samples, begin_ns = _samples(recording, piece, name)
    replicates = mapping.cut.replicates and piece.part
    row: dict[str, Any] = {
        "trial": name,
        "slot": _label(mapping, recording, piece, "slot", "-".join(whole if replicates else parts)),
        "replicate": _label(mapping, recording, piece, "replicate", ""),
        "protocol": _label(mapping, recording, piece, "protocol", ""),
        "mounting": _label(mapping, recording, piece, "mounting", ""),
        "note": _label(mapping, recording, piece, "note", ""),
        "begin_ns": begin_ns,
        "dated": recording.dated,
        "file": len(own.recordings) - 1,
    }
    for fact in FACTS:
        row[fact] = _fact(mapping, recording, piece, fact)
    own.trials.append(row)
    own.samples.append(samples)


def _fact(mapping: Mapping, recording: Recording, piece: Piece, name: str) -> float:
    fact = mapping.facts.get(name)
    if fact is None:
        return float("nan")
    if fact.value is not None:
        return fact.value
    where = f"{mapping.path}: trials.{name}"
    if fact.name:
        return fact_value(name, fact, recording.found.names[fact.name], where)
    value = constant_number(recording, piece, fact.column, name)
    return float(conversion(fact.unit, DIMENSION[name], where, None)(np.array([value]))[0])


def _samples(recording: Recording, piece: Piece, name: str) -> tuple[pd.DataFrame, int | None]:
    """Rows of one trial and its beginning, ns: a row for each time at which a channel has a sample.

    Nothing is interpolated: channels of other rates leave cells empty.
    """
    if piece.rows is not None:
        rows = piece.rows
        made: dict[str, Any] = {"trial": name}
        for channel, series in recording.channels.items():
            made[channel] = np.asarray(series.values, dtype=np.float64)[rows]
        frame = pd.DataFrame(made, index=range(len(rows)))
        if recording.direction is not None:
            ways = np.array(["", "up", "down"], dtype=object)
            frame["direction"] = ways[recording.direction[rows]]
        frame = frame.dropna(how="all", subset=list(recording.channels))
        if frame.empty:
            raise GapError(str(recording.found.path), f"trial {name} has no measured point")
        return frame, None
    cuts: dict[str, tuple[Any, Array]] = {}
    for channel, series in recording.channels.items():
        assert series.ns is not None
        inside = (series.ns >= piece.begin_ns) & (series.ns < piece.end_ns)
        if inside.any():
            cuts[channel] = (series.ns[inside], np.asarray(series.values[inside], dtype=np.float64))
    if not cuts:
        raise GapError(str(recording.found.path), f"trial {name} has no measured sample")
    begin = min(int(ns[0]) for ns, _ in cuts.values())
    edges = {channel: _edges(recording, channel, piece) for channel in recording.commands}
    begin = min([begin, *(int(ns[0]) for ns, _, _ in edges.values() if len(ns))])
    if piece.begin_ns > FIRST_NS:
        begin = max(begin, piece.begin_ns)
    columns: dict[str, pd.Series[Any]] = {}
    for channel, (ns, held, value) in edges.items():
        if held is not None and (not len(ns) or ns[0] > begin):
            ns, value = np.r_[begin, ns], np.r_[held, value]
        columns[channel] = pd.Series(value, index=ns)
    for channel, (ns, value) in cuts.items():
        columns[channel] = pd.Series(value, index=ns)
    frame = pd.DataFrame(columns).sort_index()
    time_s = (frame.index.to_numpy(dtype=np.int64) - begin) * 1e-9
    frame = frame.reset_index(drop=True)
    frame.insert(0, "time_s", time_s)
    frame.insert(0, "trial", name)
    return frame, begin


def _edges(recording: Recording, channel: str, piece: Piece) -> tuple[Any, float | None, Array]:
    """Changes of a command within a piece (times, values after) and what it was before."""
    series = recording.commands[channel]
    assert series.ns is not None
    value = np.asarray(series.values, dtype=np.float64)
    changed = np.r_[True, value[1:] != value[:-1]]
    inside = (series.ns >= piece.begin_ns) & (series.ns < piece.end_ns)
    earlier = np.flatnonzero(series.ns < piece.begin_ns)
    held = float(value[earlier[-1]]) if len(earlier) else None
    return series.ns[inside & changed], held, value[inside & changed]


def _finish(own: MuscleSet, mapping: Mapping) -> None:
    """Number replicates, and give the trials the order that is known."""
    names = Counter(row["trial"] for row in own.trials)
    twice = next((name for name, count in names.items() if count > 1), None)
    if twice is not None:
        what = f"two trials are called {twice!r}"
        raise GapError(f"{mapping.path}: cut.by", what, 'cut by "file" as well, or rename a file')
    for key, u_ms in own.clock_errors_ms.items():
        own.notes.append(f"calibration.toml: {key} contains {u_ms:.3g} ms of the joined clocks")
    order = _order(own, mapping)
    if order is None:
        for row in own.trials:
            row["order"] = None
    else:
        together = sorted(zip(order, own.trials, own.samples, strict=True), key=lambda t: t[0])
        own.trials = [row for _, row, _ in together]
        own.samples = [samples for _, _, samples in together]
        for number, row in enumerate(own.trials, start=1):
            row["order"] = number
    clock = own.trials[0]["dated"] or len(own.recordings) == 1
    zero = min((row["begin_ns"] for row in own.trials if row["begin_ns"] is not None), default=0)
    counted: Counter[str] = Counter()
    for row in own.trials:
        begin, dated = row.pop("begin_ns"), row.pop("dated")
        row.pop("file")
        known = begin is not None and clock
        row["start_s"] = ((begin if dated else begin - zero) * 1e-9) if known else None
        counted[row["slot"]] += 1
        row["replicate"] = row["replicate"] or str(counted[row["slot"]])


def _order(own: MuscleSet, mapping: Mapping) -> list[Any] | None:
    """Something to sort the trials by; None where the order is not known."""
    wanted, key = mapping.order, f"{mapping.path}: trials.order"
    timed = not mapping.time.settled
    dated = all(row["dated"] for row in own.trials)
    if wanted == "auto":
        wanted = "time" if timed and (dated or len(own.recordings) == 1) else "unknown"
    if len(own.trials) == 1 and wanted == "unknown":
        return [0]
    if wanted == "unknown":
        return None
    if wanted == "time":
        if not timed or not (dated or len(own.recordings) == 1):
            raise GapError(key, "the files have no common clock", 'state "files" or "unknown"')
        return [row["begin_ns"] for row in own.trials]
    if wanted == "rows" and timed:
        raise GapError(key, '"rows" is for settled points; these have times')
    return [(row["file"], k) for k, row in enumerate(own.trials)]
