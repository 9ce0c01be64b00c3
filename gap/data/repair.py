"""A data set put right before anything is compared: copies, spikes, and parts of a motion.

Each repair leaves a note for the reader of the verdict.

- Copies of trials, the same samples under another name, are no evidence and are left out.
- A reading of a length that leaves the course of its neighbours and is back with the next one is a
  fault of the sensor: nothing that has a mass moves so. Friction would turn at each of them.
- A recording that is cut into cycles begins and ends with part of one, and a test may have been
  broken off. Compared with whole cycles as if it were one of them, such a part takes one place in
  time for another, and what differs would be taken for noise.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.ndimage import median_filter

from gap.data.dataset import DataSet
from gap.data.trial import Channel, Trial
from plant.arrays import Array


def repaired(data: DataSet) -> DataSet:
    """The data set without copies of trials, spikes of a length and parts of a motion."""
    return without_parts(without_spikes(without_duplicates(data)))


_LEAST = 20
"""Samples from which equality to the last bit is no coincidence of rounded readings."""
_MEASURED = ("pressure_kpa", "force_n", "length_mm")


def without_duplicates(data: DataSet) -> DataSet:
    """The data set without trials whose measured samples all equal those of an earlier trial."""
    kept: list[Trial] = []
    seen: set[str] = set()
    for trial in data.trials:
        mark = _mark(trial)
        if mark is not None and mark in seen:
            continue
        if mark is not None:
            seen.add(mark)
        kept.append(trial)
    dropped = len(data.trials) - len(kept)
    if not dropped:
        return data
    note = f"{dropped} trials left out: copies of others, sample for sample"
    return replace(data, trials=tuple(kept), notes=(*data.notes, note))


def _mark(trial: Trial) -> str | None:
    channels = [(name, trial[name]) for name in _MEASURED if name in trial]
    if sum(len(channel) for _, channel in channels) < _LEAST:
        return None
    if not any(np.ptp(channel.value) > 0.0 for _, channel in channels if len(channel)):
        return None
    crc = hashlib.sha256()
    for name, channel in channels:
        crc.update(name.encode())
        crc.update(np.ascontiguousarray(channel.time_s).tobytes())
        crc.update(np.ascontiguousarray(channel.value).tobytes())
    return crc.hexdigest()


_SPIKE_SD = 8.0
"""Height of a spike in sd of the noise around it: chance makes one in two million readings."""
_COURSES = 0.5
"""Difference of the courses before and after a spike, over its height.

A moving length may overshoot or strike a stop, but it does not go on as if nothing had been.
"""
_SPIKES_SHARE = 0.03
"""Share of the readings up to which what leaves and comes back is a fault. Not tuned."""
_AROUND = 61
"""Readings from which the noise around one is taken."""
_NEAR = 11
"""The same where a length moves too quickly for its readings."""
_OF_BEND = float(np.sqrt(1.5))
"""Sd of a reading less the mean of its neighbours, over the sd of a reading."""


def without_spikes(data: DataSet) -> DataSet:
    """The data set with spikes of a length replaced by the mean of their neighbours.

    A spike is a single reading that departs from what the readings before it, those after it, and
    its two neighbours foretell, three times to the same side, while these agree with each other.
    """
    made, mended, readings = [], [], 0
    for trial in data.trials:
        channel = trial.get("length_mm")
        at = spikes_of(channel.value) if not trial.settled else np.empty(0, dtype=np.int64)
        if not len(at):
            made.append(trial)
            continue
        value = channel.value.copy()
        value[at] = 0.5 * (value[at - 1] + value[at + 1])
        channels = {**trial.channels, "length_mm": Channel(channel.time_s, value)}
        made.append(replace(trial, channels=channels))
        mended.append(trial.name)
        readings += len(at)
    if not readings:
        return data
    note = (
        f"spikes of length_mm, one reading each, replaced by the mean of their neighbours: "
        f"{readings}, in trials such as {mended[0]}"
    )
    return replace(data, trials=tuple(made), notes=(*data.notes, note))


def spikes_of(value: Array) -> npt.NDArray[np.int64]:
    """Indices of the spikes among equally spaced readings; none where they are many."""
    none = np.empty(0, dtype=np.int64)
    if len(value) < _AROUND:
        return none
    here = value[2:-2]
    bend = here - 0.5 * (value[1:-3] + value[3:-1])
    before, after = 2.0 * value[1:-3] - value[:-4], 2.0 * value[3:-1] - value[4:]
    off = np.stack([bend, here - before, here - after])
    one_sided = np.all(off > 0.0, axis=0) | np.all(off < 0.0, axis=0)
    height = np.where(one_sided, np.abs(off).min(axis=0), 0.0)
    height[np.abs(before - after) > _COURSES * height] = 0.0
    usual = [median_filter(np.abs(bend), around, mode="reflect") for around in (_AROUND, _NEAR)]
    sd = 1.4826 * np.maximum(*usual) / _OF_BEND
    resolution = float(np.diff(np.unique(value)).min(initial=np.inf))
    found = np.flatnonzero(height > _SPIKE_SD * np.where(sd > 0.0, sd, resolution)) + 2
    found = found[np.diff(found, prepend=-2) > 1]
    return found if 0 < len(found) <= _SPIKES_SHARE * len(value) else none


_FEWEST = 3
"""Trials of a slot from which one can differ from the others."""
_LONGER = 1.25
"""Ratio of the lengths in time of two trials from which one may be a part of the other."""
_ELSEWHERE = 0.2
"""Share of the range of a slot by which a trial begins or ends elsewhere. Neither was tuned."""
_DRIVEN = ("length_mm", "pressure_kpa")
_END = 5
"""Samples over which the start and the end of a trial are averaged."""


def without_parts(data: DataSet) -> DataSet:
    """The data set without trials that are a part of what their slot repeats.

    A trial is one if it is much shorter in time than its slot's trials usually are, and begins or
    ends elsewhere in what was driven. One that is much longer repeats more than they do: it gets a
    slot of its own.
    """
    slots = data.slots
    usual = {slot: _usual([data.trials[at] for at in members]) for slot, members in slots.items()}
    made: list[Trial] = []
    parts: list[str] = []
    longer: list[str] = []
    taken = set(slots)
    for trial in data.trials:
        ratio = _other_motion(trial, usual[trial.slot])
        if ratio < 1.0:
            parts.append(trial.name)
        elif ratio > 1.0:
            slot = _free_name(trial, taken)
            taken.add(slot)
            longer.append(trial.name)
            made.append(replace(trial, slot=slot))
        else:
            made.append(trial)
    if not parts and not longer:
        return data
    notes = list(data.notes)
    if parts:
        notes.append(
            f"left out, only a part of the motion that their slot repeats: {', '.join(parts)}"
        )
    if longer:
        notes.append(
            f"slots of their own, longer than what their slot repeats: {', '.join(longer)}"
        )
    return replace(data, trials=tuple(made), notes=tuple(notes))


@dataclass(frozen=True)
class _Usual:
    """What the trials of a slot usually are: seconds, range and both ends of a driven channel."""

    seconds: float
    range: float
    ends: Array


def _usual(trials: list[Trial]) -> dict[str, _Usual]:
    """The usual motion of a slot by driven channel; empty for settled points and few trials."""
    others = [one for one in trials if not one.settled]
    made: dict[str, _Usual] = {}
    for name in _DRIVEN if len(trials) >= _FEWEST and others else ():
        channels = [one.get(name) for one in others]
        if min(len(channel) for channel in channels) >= 2 * _END:
            made[name] = _Usual(
                float(np.median([np.ptp(channel.time_s) for channel in channels])),
                float(np.median([np.ptp(channel.value) for channel in channels])),
                np.median([_ends(channel.value) for channel in channels], axis=0),
            )
    return made


def _other_motion(trial: Trial, usual: dict[str, _Usual]) -> float:
    """Length in time over the usual one of a slot, if a trial is another motion; else 1."""
    for name, motion in usual.items() if not trial.settled else ():
        ratio = float(np.ptp(trial[name].time_s)) / max(motion.seconds, 1e-9)
        if 1.0 / _LONGER <= ratio <= _LONGER:
            return 1.0
        apart = float(np.abs(_ends(trial[name].value) - motion.ends).max())
        if apart > _ELSEWHERE * motion.range > 0.0:
            return ratio
    return 1.0


def _ends(value: Array) -> Array:
    return np.array([value[:_END].mean(), value[-_END:].mean()])


def _free_name(trial: Trial, taken: set[str]) -> str:
    name = f"{trial.slot} ({trial.replicate or trial.name})"
    return name if name not in taken else f"{trial.slot} ({trial.name})"
