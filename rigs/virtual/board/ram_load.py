"""The large ram of section 5.9 on the virtual bench, in the muscle's place."""

from __future__ import annotations

from plant.constants import PlantConstants
from plant.effects.effects import Effects
from plant.scene.ram import Ram
from plant.simulator.bench import BenchSim


class RamLoad(BenchSim):
    """A bench whose valve block moves a ram; no muscle, nothing on the balance.

    Attributes:
        ram: the cylinder; its arrays are those that the board steps.
    """

    def __init__(self, constants: PlantConstants, effects: Effects) -> None:
        super().__init__(constants, effects)
        self.ram = Ram(constants, effects=effects)
        self.state, self.params = self.ram.state, self.ram.params

    @property
    def length_mm(self) -> float:
        """Height of the piston above its lower end: what a camera would be pointed at."""
        return self.ram.height_mm

    @property
    def force_n(self) -> float:
        """Nothing pulls on the balance."""
        return 0.0

    def set_length(self, length_mm: float) -> None:
        """Nothing holds a ram."""

    def set_length_rate(self, rate_mm_s: float) -> None:
        """Nothing moves a ram but its air."""
