"""Which protocols there are; light enough for the command line to import."""

from __future__ import annotations

PROTOCOLS: dict[str, str] = {
    "isometric": "Run an isometric test: length held, pressure stepped, force read.",
    "switching-time": "Measure a valve's switching times at a range of pressures.",
    "switching-voltage": "Measure the voltages at which a valve turns on and off.",
    "flow": "Measure air velocity against pressure behind a valve.",
}
"""Name of each protocol's command and what it does; its module is ``rigs.protocols.NAME`` with _
for -, and holds PROCEDURE."""

DEFAULT_RIG: dict[str, str] = {
    "switching-time": "virtual-valve-stand",
    "switching-voltage": "virtual-valve-stand",
    "flow": "virtual-valve-stand",
}
"""The shipped rig that has all a protocol needs, where that is not "virtual"."""


def default_rig(name: str) -> str:
    """The rig that a protocol runs on when none is named."""
    return DEFAULT_RIG.get(name, "virtual")
