"""How many of the inputs each target gets, and whose branches are marked.

What reads bytes off a wire takes ten to fifty microseconds an input and gets most of them. A folder
has to be written and read anew for each input, which is a hundred times as dear, and gets what can
be afforded.
"""

from __future__ import annotations

SHARES = {
    "framer": 0.220,
    "codec": 0.140,
    "valve driver": 0.080,
    "MT-SICS": 0.152,
    "stage": 0.100,
    "Modbus": 0.090,
    "load cell": 0.080,
    "thermometer": 0.060,
    "supply": 0.020,
    "TOML": 0.020,
    "rig file": 0.006,
    "model file": 0.007,
    "run folder": 0.007,
    "killed run": 0.005,
    "EXCHANGE folder": 0.006,
    "picture": 0.005,
    "picture file": 0.002,
}
"""Of all inputs, by target; adds up to 1."""

MARKED = (
    "daq",
    "gap.reader",
    "gap.tables",
    "gap.dataset",
    "plant.tomlfile",
    "plant.constants",
    "plant.effects",
    "plant.models",
    "rigs.balance",
    "rigs.config",
    "rigs.device",
    "rigs.frames",
    "rigs.instruments",
    "rigs.lines",
    "rigs.pictures",
    "rigs.reduction",
    "rigs.segments",
    "rigs.stage",
    "rigs.toml_reader",
    "rigs.valve",
    "valvefw.wire",
    "vision",
)
"""Modules and packages whose branches are marked."""
