"""The catalogue of effects: what a real bench may do that the nominal plant does not.

Verdicts, rig files (`[effects.<id>]`), docs and blind checks all use these ids. Every entry says
what the effect adds and where that form comes from, what it leaves untouched, which others it can
be taken for, and which experiment or reference standard tells them apart.
"""

from __future__ import annotations

from plant.effects.entry import Entry as Entry
from plant.effects.entry import Parameter as Parameter
from plant.effects.gas import GAS_AND_LOAD
from plant.effects.muscle import MUSCLE
from plant.effects.sensors import SENSORS_AND_DRIFT

_ENTRIES = (*MUSCLE, *GAS_AND_LOAD, *SENSORS_AND_DRIFT)

CATALOGUE: dict[str, Entry] = {entry.id: entry for entry in _ENTRIES}
"""All thirty effects by id, in the order of the specification."""

FAMILIES: tuple[str, ...] = tuple(dict.fromkeys(entry.family for entry in _ENTRIES))
"""The families, in order of first appearance; "none" and "unknown" are verdicts beside them."""
