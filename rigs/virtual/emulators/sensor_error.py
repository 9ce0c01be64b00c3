"""Effects of the catalogue that act on instruments, as the virtual instruments take them.

What acts on muscle, gas and valves is the plant's; here is what a sensor shows of it, where the
stage stands against its own scale, and what wears with use.
"""

from __future__ import annotations

from dataclasses import dataclass

from plant.effects.effects import Effects
from plant.errors import PlantError
from plant.simulator.bench import BenchSim
from plant.simulator.readings import (
    camera_delay_s,
    force_error,
    pressure_error,
    read_force,
    read_length,
)
from plant.simulator.simulate import held_offset_mm

FRESH_KPA = 20.0
USED_KPA = 60.0
"""A trial begins when the pressure rises past the upper of these, having been below the lower."""


def refuse_changing_scales(effects: Effects) -> None:
    """Raise `PlantError` for a scale that changes over its range: the instruments' are straight."""
    for effect, values in effects.active():
        if effect.sensors.scale_changes is not None and effect.sensors.scale_changes(values):
            raise PlantError(
                f"effects.{effect.id}: the virtual instruments have straight scales; "
                f"state {effect.headline} alone"
            )


@dataclass
class SensorError:
    """Effects on the instruments of one virtual bench; without any, all is as it was."""

    plant: BenchSim

    def __post_init__(self) -> None:
        self._effects = self.plant.effects
        self._pressure = pressure_error(self._effects)
        self._force = force_error(self._effects)
        # One at every length: a scale that changes is refused.
        label_mm = held_offset_mm(self.plant.length_mm, self.plant.constants, self._effects)
        self._label_mm = float(label_mm)
        self._delay_s = camera_delay_s(self._effects)
        active = self._effects.active()
        self._ages = any(effect.plant.scale is not None for effect, _ in active)
        self._fresh = True
        self._temperature_c = float("nan")

    @property
    def pressure_zero_kpa(self) -> float:
        """Beside the zero error that the transducer's calibration allows."""
        return self._pressure[1]

    @property
    def pressure_gain(self) -> float:
        """Relative, beside the one that the transducer's calibration allows."""
        return self._pressure[0]

    @property
    def force_zero_n(self) -> float:
        """Force that reads although nothing pulls, after a tare too."""
        return self._force[1]

    @property
    def force_gain(self) -> float:
        """Relative, beside the one that the sensor's calibration allows."""
        return self._force[0]

    def force_n(self, true_n: float) -> float:
        """What the load cell shows of a pull."""
        return float(read_force(true_n, self._effects))

    @property
    def label_mm(self) -> float:
        """Where the muscle is held, less what the stage's scale says."""
        return self._label_mm

    def length_mm(self, true_mm: float) -> float:
        """Where the camera sees a marker that stands at a true length."""
        return float(read_length(true_mm, self.plant.constants, self._effects))

    def place_block(self, length_mm: float) -> None:
        """Put a gauge block in the place of the muscle: what measures a length sees the block."""
        self.plant.set_length(length_mm)

    def take_block(self) -> None:
        """Take the last block out; the muscle is mounted at that length again."""

    @property
    def camera_delay_s(self) -> float:
        """How much the picture is older than its stamp and its sync LED say."""
        return self._delay_s

    def age(self, temperature_c: float) -> None:
        """Let the muscle be as warm as the bench, and count what it has been through."""
        if not self._ages:
            return
        if temperature_c != self._temperature_c:
            self._temperature_c = temperature_c
            self.plant.set_temperature(temperature_c)
        pressure_kpa = self.plant.pressure_kpa
        if pressure_kpa < FRESH_KPA:
            self._fresh = True
        elif self._fresh and pressure_kpa > USED_KPA:
            self._fresh = False
            self.plant.count_trial()
