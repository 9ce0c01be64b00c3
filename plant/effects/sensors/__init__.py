"""Effects of sensors and of what is written down, in the order of the specification."""

from __future__ import annotations

from plant.effects.effect import Effect
from plant.effects.sensors.camera_delay import CAMERA_DELAY
from plant.effects.sensors.camera_distortion import CAMERA_DISTORTION
from plant.effects.sensors.camera_scale import CAMERA_SCALE
from plant.effects.sensors.force_gain import FORCE_GAIN
from plant.effects.sensors.force_zero import FORCE_ZERO
from plant.effects.sensors.length_label import LENGTH_LABEL
from plant.effects.sensors.pressure_gain import PRESSURE_GAIN
from plant.effects.sensors.pressure_lag import PRESSURE_LAG
from plant.effects.sensors.pressure_zero import PRESSURE_ZERO

SENSORS: tuple[Effect, ...] = (
    PRESSURE_ZERO,
    PRESSURE_GAIN,
    PRESSURE_LAG,
    FORCE_ZERO,
    FORCE_GAIN,
    LENGTH_LABEL,
    CAMERA_SCALE,
    CAMERA_DISTORTION,
    CAMERA_DELAY,
)
