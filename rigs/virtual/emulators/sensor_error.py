"""Effects of the catalogue that act on instruments, as the virtual instruments take them.

What acts on muscle, gas and valves is the plant's; here is what a sensor shows of it, where the
stage stands against its own scale, and what wears with use.
"""

from __future__ import annotations

from dataclasses import dataclass

from plant.simulator.bench import BenchSim
from plant.simulator.readings import read_force, read_length

FRESH_KPA = 20.0
USED_KPA = 60.0
"""A trial begins when the pressure rises past the upper of these, having been below the lower."""


@dataclass
class Misreading:
    """Effects on the instruments of one virtual bench; without any, all is as it was."""

    plant: BenchSim

    def __post_init__(self) -> None:
        self._effects = self.plant.effects
        self._worn = "wear" in self._effects
        self._warms = "temperature_stiffening" in self._effects
        self._fresh = True
        self._temperature_c = float("nan")

    def _get(self, effect: str, parameter: str) -> float:
        return self._effects.get(effect, parameter)

    @property
    def pressure_zero_kpa(self) -> float:
        """Beside the zero error that the transducer's calibration allows."""
        return self._get("pressure_zero", "offset_kpa")

    @property
    def pressure_gain(self) -> float:
        """Relative, beside the one that the transducer's calibration allows."""
        return self._get("pressure_gain", "percent") / 100.0

    @property
    def force_zero_n(self) -> float:
        """Force that reads although nothing pulls, after a tare too."""
        return self._get("force_zero", "offset_n")

    @property
    def force_gain(self) -> float:
        """Relative, beside the one that the sensor's calibration allows."""
        return self._get("force_gain", "percent") / 100.0

    def force_n(self, true_n: float) -> float:
        """What the load cell shows of a pull."""
        return float(read_force(true_n, self._effects))

    @property
    def label_mm(self) -> float:
        """Where the muscle is held, less what the stage's scale says."""
        return self._get("length_label", "offset_mm")

    def length_mm(self, true_mm: float) -> float:
        """Where the camera sees a marker that stands at a true length."""
        return float(read_length(true_mm, self.plant.constants, self._effects))

    @property
    def camera_delay_s(self) -> float:
        """How much the picture is older than its stamp and its sync LED say."""
        return self._get("camera_delay", "delay_ms") * 1e-3

    def age(self, temperature_c: float) -> None:
        """Let the muscle be as warm as the bench, and count what it has been through."""
        if self._warms and temperature_c != self._temperature_c:
            self._temperature_c = temperature_c
            self.plant.set_temperature(temperature_c)
        if not self._worn:
            return
        pressure_kpa = self.plant.pressure_kpa
        if pressure_kpa < FRESH_KPA:
            self._fresh = True
        elif self._fresh and pressure_kpa > USED_KPA:
            self._fresh = False
            self.plant.count_trial()
