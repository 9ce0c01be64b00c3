"""Reference standards: what gives one effect by itself, whatever the muscle does."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Standard:
    """A reference standard: what is done with it, and how long that takes."""

    name: str
    what: str
    minutes: float


VENT = Standard("vent", "vent to the atmosphere and read the pressure", 2.0)
GAUGE = Standard("gauge", "read a reference gauge beside the sensor at three pressures", 6.0)
WEIGHTS = Standard("dead weights", "hang known weights on the force sensor, and none", 6.0)
BLOCK = Standard("gauge block", "hold a gauge block before the camera at three places", 6.0)
HOLDERS = Standard("gauge block", "set a gauge block between the holders", 6.0)
LAMP = Standard("sync lamp", "show the camera a lamp that the controller switches", 4.0)
SCALES = Standard("scales", "weigh the load", 2.0)
LOCKED = Standard("locked decay", "shut both valves at pressure and watch for a minute", 4.0)
SYRINGE = Standard("bypass volume", "connect a known volume and fill once more", 10.0)
