"""A bench whose physics are not the plant's, behind the plant's arrays and methods.

What it is made of is known to `rigs.virtual.withheld.bench` alone; here it is a thing that takes
commands and shows readings.
"""

from __future__ import annotations

from typing import Any, Protocol

from plant.arrays import Array
from plant.constants import PlantConstants
from plant.effects.effects import NONE
from plant.physics.layout import (
    FORCE,
    INLET_COMMAND,
    LENGTH,
    LENGTH_RATE,
    LOAD,
    MASS,
    OUTLET_COMMAND,
    PRESSURE,
    PRESSURE_LAG,
    PRESSURE_READ,
    REGULATOR_SET,
    SOURCE,
    TIME,
)
from plant.simulator.bench import BenchSim, build_params, build_state
from rigs.virtual.emulators.sensor_error import FRESH_KPA, USED_KPA, SensorError

SHORTEST_S = 1e-7
HAND_MM = 0.5
HAND_MM_S = 10.0
"""Lengths that are set further than the one are gone to at the other."""


class Live(Protocol):
    """One muscle with valve block, stage or load, advanced step by step."""

    def start_trial(
        self, length_mm: float = ..., load_kg: float = ..., *, temperature_c: float = ...,
        keep: bool = ...,
    ) -> None:  # fmt: skip
        """Begin a trial; with `keep`, air and memories stay."""
        ...

    def step(
        self, dt: float, inlet: int = ..., outlet: int = ..., *, length_mm: float | None = ...,
        load_kg: float | None = ..., regulator_kpa: float | None = ...,
        temperature_c: float | None = ...,
    ) -> Any:  # fmt: skip
        """Advance and show: pressure_kpa, force_n, length_mm, and what is so (true_*)."""
        ...

    def read_block(self, true_mm: float) -> float:
        """What the camera shows of a gauge block in the place of the muscle, mm."""
        ...


class WithheldPlant(BenchSim):
    """What instruments and board touch of a plant, moved by physics that are not the plant's.

    Args:
        live: the bench behind.
        constants: what is stated of it.
        source: "valve" or "regulator".
        length_m: written length at power-on.
        zero_n: what the force sensor shows when nothing pulls, after any tare.
        frames_late_s: how much older than its stamp a picture is; below 0 it is younger.
    """

    def __init__(
        self,
        live: Live,
        constants: PlantConstants,
        source: str,
        length_m: float,
        zero_n: float = 0.0,
        frames_late_s: float = 0.0,
    ) -> None:
        self.live = live
        self.constants = constants
        self.effects = NONE
        self.load = "isometric"
        self.params = build_params(constants, source="valve" if source == "valve" else "regulator")
        # The transducer's slot carries what the blind bench's own sensor shows.
        self.params[PRESSURE_LAG] = 1.0
        self.state = build_state(constants, length_m)
        self._written_mm = length_m * 1e3
        self._temperature_c = 21.0
        self._used = False
        self.zero_n = zero_n
        self.frames_late_s = frames_late_s
        live.start_trial(length_mm=self._written_mm)
        self.shown = live.step(1e-6, 0, int(self.state[OUTLET_COMMAND]))
        self._show()

    def step(
        self, state: Array, params: Array, dt_s: float, inlet_on_s: float, vent_on_s: float
    ) -> None:
        """One control tick, as `plant.simulator.bench.advance`; `state` and `params` are this
        plant's own.
        """
        del state, params
        begin = 0.0
        marks = (min(inlet_on_s, dt_s), min(vent_on_s, dt_s), dt_s)
        for end in sorted({m for m in marks if m > SHORTEST_S}):
            if end - begin > SHORTEST_S:
                self._piece(end - begin, begin < inlet_on_s, begin < vent_on_s)
            begin = end
        self.state[TIME] += dt_s
        self.state[INLET_COMMAND] = float(inlet_on_s >= dt_s)
        self.state[OUTLET_COMMAND] = float(vent_on_s >= dt_s)
        self._show()

    def _piece(self, dt_s: float, inlet: bool, vent: bool) -> None:
        hung = self.params[LOAD] == 1.0
        self._written_mm += float(self.state[LENGTH_RATE]) * dt_s * 1e3 if not hung else 0.0
        regulated = self.params[SOURCE] == 1.0 and inlet and not vent
        self.shown = self.live.step(
            dt_s,
            inlet=int(inlet),
            outlet=int(vent),
            length_mm=None if hung else self._written_mm,
            load_kg=float(self.params[MASS]) if hung else 0.0,
            regulator_kpa=float(self.state[REGULATOR_SET]) * 1e-3 if regulated else None,
            temperature_c=self._temperature_c,
        )

    def _show(self) -> None:
        """Bring the arrays up to date with what the blind bench is and shows."""
        shown = self.shown
        self.state[PRESSURE] = shown.true_pressure_kpa * 1e3
        self.state[PRESSURE_READ] = shown.pressure_kpa * 1e3
        self.state[LENGTH] = shown.true_length_mm * 1e-3
        self.state[FORCE] = shown.force_n - self.zero_n

    def set_length(self, length_mm: float) -> None:
        """Hold the muscle at another written length; it is led there by hand, with its valves as
        they are, in time that passes for the muscle alone.
        """
        far_mm = abs(length_mm - self._written_mm)
        self._written_mm = length_mm
        self.state[LENGTH_RATE] = 0.0
        if far_mm > HAND_MM and self.params[LOAD] == 0.0:
            vent = int(self.state[OUTLET_COMMAND])
            seconds = far_mm / HAND_MM_S
            self.shown = self.live.step(seconds, 0, vent, length_mm=length_mm, load_kg=0.0)
            self._show()

    def lead_to(self, length_mm: float) -> None:
        """The same: it takes its time in any case."""
        self.set_length(length_mm)

    def set_length_rate(self, rate_mm_s: float) -> None:
        """Move the stage at a steady rate."""
        self.state[LENGTH_RATE] = rate_mm_s * 1e-3

    def set_temperature(self, temperature_c: float) -> None:
        """Temperature of the muscle's wall."""
        self._temperature_c = temperature_c

    @property
    def length_mm(self) -> float:
        """Length as it is written down: what stands on the stage's scale."""
        return self._written_mm if self.params[LOAD] == 0.0 else self.shown.true_length_mm

    def count_use(self) -> None:
        """A trial is over when a muscle that was filled is empty again."""
        pressure_kpa = self.shown.true_pressure_kpa
        if pressure_kpa > USED_KPA:
            self._used = True
        elif self._used and pressure_kpa < FRESH_KPA:
            self._used = False
            hung = self.params[LOAD] == 1.0
            self.live.start_trial(
                length_mm=self._written_mm,
                load_kg=float(self.params[MASS]) if hung else 0.0,
                temperature_c=self._temperature_c,
                keep=True,
            )


class WithheldReading(SensorError):
    """What the blind bench's own sensors show goes straight to the virtual instruments."""

    def __init__(self, plant: WithheldPlant) -> None:
        super().__init__(plant)
        self._withheld = plant
        self._block_mm: float | None = None

    @property
    def force_zero_n(self) -> float:
        """What no tare takes out."""
        return self._withheld.zero_n

    def force_n(self, true_n: float) -> float:
        """What a load cell shows, zero included."""
        return true_n + self._withheld.zero_n

    @property
    def camera_delay_s(self) -> float:
        """Only where pictures are younger than their stamps: an older one is shown so already."""
        return min(0.0, self._withheld.frames_late_s)

    def length_mm(self, true_mm: float) -> float:
        """Where the camera sees the marker now, whatever is true."""
        del true_mm
        if self._block_mm is not None:
            return self._withheld.live.read_block(self._block_mm)
        return float(self._withheld.shown.length_mm)

    def place_block(self, length_mm: float) -> None:
        """A block stands before the camera; the muscle is where it was."""
        self._block_mm = length_mm

    def take_block(self) -> None:
        """The camera sees the muscle again."""
        self._block_mm = None

    def age(self, temperature_c: float) -> None:
        """Let the muscle be as warm as the bench, and count what it has been through."""
        self._withheld.set_temperature(temperature_c)
        self._withheld.count_use()
