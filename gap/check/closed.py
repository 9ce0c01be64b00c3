"""How much of a gap a named effect really closes, on noise-free readings of the blind bench."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from blind.recalibrate import Recalibration
from blind.sets import BlindSet

CHANNELS = {"N": "force_n", "kPa": "pressure_kpa", "mm": "length_mm"}


def closed_fraction(one: BlindSet, best: Mapping[str, Any], unit: str | None) -> float | None:
    """Closed fraction of the named effects at the stated amounts, in the form they really have.

    Constants are fitted anew with and without; the channel is the one whose unit the verdict
    states. None if the verdict states no value or there is no gap in that channel.
    """
    recalibration = Recalibration(one.design, one.noise)
    explained = np.zeros(recalibration.layout.size)
    for hidden in one.hidden:
        if hidden.id not in best["ids"]:
            continue
        strength = 1.0
        if hidden.entry.parameter:
            stated = (best.get("parameters") or {}).get(hidden.entry.parameter) or {}
            value = stated.get("value")
            if not isinstance(value, (int, float)):
                return None
            strength = float(value) - hidden.entry.neutral
        # The hidden form at the stated value: what is judged is the effect and its amount.
        scale = strength / hidden.strength if hidden.id == "supply_droop" else 1.0
        shape = (hidden.shape[0] * scale, *hidden.shape[1:])
        stated_one = replace(hidden, strength=strength, shape=shape)
        explained += recalibration.signature(stated_one)
    before = recalibration.recalibrated(recalibration.signature_of(list(one.hidden)))
    after = recalibration.recalibrated(recalibration.signature_of(list(one.hidden)) - explained)
    for channel, protocol, index in recalibration.blocks():
        if channel == CHANNELS.get(str(unit)) and protocol == "all":
            total = float(np.sum(before[index] ** 2))
            return None if total <= 0.0 else 1.0 - float(np.sum(after[index] ** 2)) / total
    return None
