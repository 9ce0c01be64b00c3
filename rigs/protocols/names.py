"""Which protocols there are; light enough for the command line to import."""

from __future__ import annotations

PROTOCOLS: dict[str, str] = {
    "isometric": "Run an isometric test: length held, pressure stepped, force read.",
    "isobaric": "Run an isobaric test: pressure held, length stepped, force read.",
    "isotonic": "Run an isotonic test: load hung, pressure stepped, length read by the camera.",
    "isothermal": "Repeat isometric and isobaric trials over temperatures.",
    "hysteresis": "Run cycles up and down, at held lengths or under hung loads.",
    "blocked-force": "Hold the slack length, step the pressure, read the blocked force.",
    "free-contraction": "Hang almost nothing, step the pressure, read the contraction.",
    "creep": "Hold pressure and load, and read how the length creeps.",
    "relaxation": "Hold length and pressure, and read how the force relaxes.",
    "dynamic": "Move the pressure in sines and sweeps, measure the frequency response.",
    "fatigue": "Cycle the pressure many times, and record how the muscle wears.",
    "switching-time": "Measure a valve's switching times at a range of pressures.",
    "switching-voltage": "Measure the voltages at which a valve turns on and off.",
    "flow": "Measure air velocity against pressure behind a valve.",
    "step": "Compare closed-loop schemes on the same steps of pressure.",
    "ram": "Move a ram from one proximity switch to the next and hold it there.",
    "joint-static": "Measure angle, torque and stiffness of a joint between two muscles.",
    "joint-step": "Step the pressures of two muscles and record how their joint answers.",
}
"""Name of each protocol's command and what it does; its module is ``rigs.protocols.NAME`` with _
for -, unless `MODULES` names another, and holds PROCEDURE."""

MODULES: dict[str, str] = {
    "blocked-force": "muscle.blocked_force",
    "free-contraction": "muscle.free_contraction",
    "creep": "muscle.creep",
    "relaxation": "muscle.relaxation",
    "dynamic": "muscle.dynamic",
    "fatigue": "muscle.fatigue",
    "joint-static": "joint.static",
    "joint-step": "joint.step",
}
"""Protocols whose module is in a room of its own."""

DEFAULT_RIG: dict[str, str] = {
    "isothermal": "virtual-instruments",
    "switching-time": "virtual-valve-stand",
    "switching-voltage": "virtual-valve-stand",
    "flow": "virtual-valve-stand",
    "step": "virtual-thesis-loop",
    "ram": "virtual-ram",
    "joint-static": "virtual-joint",
    "joint-step": "virtual-joint",
}
"""The shipped rig that has all a protocol needs, where that is not "virtual"."""

SPECIMEN: dict[str, str] = {
    "switching-time": "valve",
    "switching-voltage": "valve",
    "flow": "valve",
    "ram": "ram",
    "joint-static": "joint",
    "joint-step": "joint",
}
"""What a protocol tests, where that is no muscle."""


def default_rig(name: str) -> str:
    """The rig that a protocol runs on when none is named."""
    return DEFAULT_RIG.get(name, "virtual")


def default_specimen(name: str) -> str:
    """What a protocol tests, where nobody says which one: its kind."""
    return SPECIMEN.get(name, "muscle")
