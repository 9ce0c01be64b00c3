"""The large pneumatic ram of section 5.9: a single-acting cylinder that lifts a mass.

    ram = Ram(nominal())
    ram.advance(1e-3, 1e-3, 0.0)
    ram.height_mm, ram.pressure_kpa, ram.prox_bits

Air lifts the mass, its weight lowers it. Coulomb friction of the seals can hold the piston. Two
proximity switches are mounted along the stroke. The thesis gives no numbers: bore, stroke, mass,
friction, switch range and end stiffness are those of a common cylinder.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from plant.arrays import Array
from plant.constants import STANDARD_GRAVITY_M_S2, PlantConstants
from plant.effects.effects import NONE, Effects
from plant.errors import PlantError
from plant.scene.layout import SWITCH_ON
from plant.scene.scene import Coordinate, Event, Piston, Scene, Switch, Unit


@dataclass(frozen=True)
class RamConstants:
    """The cylinder, in SI. Raises `PlantError` for impossible values.

    Attributes:
        bore_m: diameter of the piston.
        stroke_m: full stroke.
        mass_kg: moving mass.
        friction_n: Coulomb friction of seals and guide.
        dead_volume_m3: gas volume with the piston at its lower end.
        switches_m: heights of proximity switches A and B.
        switch_reach_m: a switch is on within this distance of its height.
        switch_gap_m: hysteresis; it goes off at this additional distance.
        end_stiffness_n_m, end_damping_n_s_m: of the buffers at both ends.
    """

    bore_m: float = 0.050
    stroke_m: float = 0.200
    mass_kg: float = 5.0
    friction_n: float = 20.0
    dead_volume_m3: float = 20e-6
    switches_m: tuple[float, ...] = (0.050, 0.150)
    switch_reach_m: float = 5e-3
    switch_gap_m: float = 0.5e-3
    end_stiffness_n_m: float = 2e5
    end_damping_n_s_m: float = 500.0

    def __post_init__(self) -> None:
        for name in ("bore_m", "stroke_m", "mass_kg", "dead_volume_m3", "switch_reach_m"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise PlantError(f"ram: {name} = {value!r}; expected more than 0")
        for name in ("friction_n", "switch_gap_m", "end_stiffness_n_m", "end_damping_n_s_m"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0.0):
                raise PlantError(f"ram: {name} = {value!r}; expected 0 or more")
        for at in self.switches_m:
            if not 0.0 <= at <= self.stroke_m:
                raise PlantError(
                    f"ram: switch at {at * 1e3:g} mm is outside the stroke, 0 to "
                    f"{self.stroke_m * 1e3:g} mm"
                )

    @property
    def area_m2(self) -> float:
        """Area of the piston."""
        return math.pi / 4.0 * self.bore_m**2

    def balance_kpa(self) -> float:
        """Gauge pressure that balances the weight without friction."""
        return self.mass_kg * STANDARD_GRAVITY_M_S2 / self.area_m2 * 1e-3


def ram_scene(
    constants: PlantConstants,
    ram: RamConstants | None = None,
    effects: Effects = NONE,
    height_m: float = 0.0,
    step_share: float = 1.0,
) -> Scene:
    """The ram as a scene: unit "ram" and coordinate "height", m above the lower end."""
    ram = ram or RamConstants()
    valve = dataclasses.replace(constants, dead_volume_m3=ram.dead_volume_m3)
    weight = ram.mass_kg * STANDARD_GRAVITY_M_S2
    return Scene(
        [Unit("ram", valve, effects, model=Piston(ram.area_m2), reach={"height": 1.0})],
        [
            Coordinate(
                "height",
                mass=ram.mass_kg,
                pull=-weight,
                low=0.0,
                high=ram.stroke_m,
                stop_stiffness=ram.end_stiffness_n_m,
                stop_damping=ram.end_damping_n_s_m,
                coulomb=ram.friction_n,
                start=height_m,
            )
        ],
        switches=[
            Switch("height", at, ram.switch_reach_m, ram.switch_gap_m) for at in ram.switches_m
        ],
        step_share=step_share,
    )


class Ram:
    """A ram simulated tick by tick; can replace a `plant.simulator.bench.BenchSim`.

    Attributes:
        state, params: rows of its one unit (`plant.physics.layout`), read by a simulated board.
        scene: the whole scene.
    """

    def __init__(
        self,
        constants: PlantConstants,
        ram: RamConstants | None = None,
        effects: Effects = NONE,
        height_mm: float = 0.0,
        step_share: float = 1.0,
    ) -> None:
        self.constants = constants
        self.ram = ram or RamConstants()
        self.scene = ram_scene(constants, self.ram, effects, height_mm * 1e-3, step_share)
        self.state: Array = self.scene.world.units[0]
        self.params: Array = self.scene.world.params[0]
        self._fill, self._vent = np.zeros(1), np.zeros(1)

    def advance(self, dt_s: float, inlet_on_s: float = 0.0, vent_on_s: float = 0.0) -> None:
        """Advance by one control tick; see `plant.simulator.bench.advance`."""
        self._fill[0], self._vent[0] = inlet_on_s, vent_on_s
        self.scene.advance(dt_s, self._fill, self._vent)

    def step(
        self, state: Array, params: Array, dt_s: float, inlet_on_s: float, vent_on_s: float
    ) -> None:
        """`advance` with the signature that a simulated board calls; the arrays are not used."""
        del state, params
        self.advance(dt_s, inlet_on_s, vent_on_s)

    @property
    def time_s(self) -> float:
        """Simulated time."""
        return self.scene.time_s

    @property
    def pressure_kpa(self) -> float:
        """True gauge pressure under the piston."""
        return float(self.scene.pressures_kpa[0])

    @property
    def height_mm(self) -> float:
        """Height of the piston above its lower end."""
        return float(self.scene.places[0]) * 1e3

    @property
    def rate_mm_s(self) -> float:
        """Velocity of the piston, positive upwards."""
        return float(self.scene.rates[0]) * 1e3

    @property
    def prox_bits(self) -> int:
        """Proximity switches in the firmware's format: bit 0 is A, bit 1 is B."""
        switches = self.scene.world.switches
        bits = 0
        for i in range(len(switches)):  # called at every tick
            if switches.item(i, SWITCH_ON):
                bits |= 1 << i
        return bits

    def take_events(self) -> list[Event]:
        """Events since the last call, with their times."""
        return self.scene.take_events()
