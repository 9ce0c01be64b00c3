"""The camera's clock is late against the others."""

from __future__ import annotations

import numpy as np

from plant.constants import PlantConstants
from plant.effects.arguments import Array, Points, Shape
from plant.effects.effect import Effect, InDiagnosis, InSensors, Parameter, Search
from plant.effects.standards import LAMP
from plant.effects.trials import moved, travelled


def _delay(amount: float) -> float:
    return amount * 1e-3


def _length(points: Points, amount: float, shape: Shape, c: PlantConstants) -> Array:
    # The mean of two readings has less noise than one: what was read, shifted by half a sample,
    # would fit better whatever the clock.
    path = travelled(points)
    return np.where(points.held, 0.0, moved(points, path, _delay(amount)) - path)


CAMERA_DELAY = Effect(
    "camera_delay",
    "length_sensor",
    "sensor",
    "frame times are late against the other clocks",
    (Parameter("delay_ms", "ms", "frame time minus true", -200, 200),),
    "everything at rest",
    ("viscosity", "pressure_lag"),
    "the blinking light in the picture against the device clock",
    equation="read(t) = true(t - delay)",
    source="none needed",
    standard="the sync light in the picture",
    calibration="length_clock_ms",
    reference=(LAMP, 0.5),
    sensors=InSensors(camera_delay=_delay),
    diagnosis=InDiagnosis(length=_length),
    search=Search(
        step=4.0,
        sign=0,
        blocks=("pressure", "force", "load"),
        scan="clock",
    ),
)
