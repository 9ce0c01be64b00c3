"""Copies of trials: the same samples under another name are no evidence, and are left out."""

from __future__ import annotations

import hashlib
from dataclasses import replace

import numpy as np

from gap.data.dataset import DataSet, Trial

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
