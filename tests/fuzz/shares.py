"""How many of the inputs each target gets, and whose branches are marked.

What reads bytes off a wire takes ten to fifty microseconds an input and gets most of them. A folder
has to be written and read anew for each input, which is a hundred times as dear, and gets what can
be afforded.
"""

from __future__ import annotations

SHARES = {
    "framer": 0.2210,
    "codec": 0.1500,
    "valve driver": 0.0800,
    "MT-SICS": 0.1650,
    "stage": 0.0400,
    "Marlin": 0.0200,
    "Zaber": 0.0200,
    "TMCL": 0.0200,
    "Modbus": 0.0900,
    "load cell": 0.0800,
    "thermometer": 0.0700,
    "supply": 0.0200,
    "TOML": 0.0040,
    "rig file": 0.0030,
    "model file": 0.0035,
    "protocol file": 0.0020,
    "plant files": 0.0020,
    "run folder": 0.0015,
    "killed run": 0.0010,
    "dataset folder": 0.0015,
    "picture": 0.0040,
    "picture file": 0.0015,
}
"""Of all inputs, by target; adds up to 1."""

MARKED = (
    "daq",
    "gap.data.reader",
    "gap.data.tables",
    "gap.data.dataset",
    "plant.tomlfile",
    "plant.constants",
    "plant.effects.effects",
    "plant.models",
    "rigs.devices.instruments.balance",
    "rigs.rigfile.config",
    "rigs.rigfile.device",
    "rigs.calibration.frames",
    "rigs.devices.instruments",
    "rigs.devices.lines",
    "rigs.steps.pictures",
    "analysis.reduction.points",
    "rigs.execution.resume",
    "rigs.devices.motion",
    "rigs.rigfile.toml_reader",
    "rigs.devices.valve_controller",
    "valvefw.wire",
    "vision",
)
"""Modules and packages whose branches are marked."""
