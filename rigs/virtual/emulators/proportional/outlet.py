"""The pressure at the outlet of an emulated proportional regulator.

What a set-point goes through, in this order: a dead time; the play between rising and falling
(hysteresis); offset and gain; a dead band, in which a regulator at rest does not react; a first
order lag whose speed is limited. The equations are stepped in time. What identifies them
(`analysis.regression.regulator`) has closed forms instead.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

import numpy as np

from plant.physics.layout import REGULATOR_LAG, REGULATOR_SET
from plant.simulator.bench import BenchSim

STEP_NS = 1_000_000
LINE_LAG_S = 0.002
"""From the outlet through the open inlet valve into the muscle."""
SENSOR_NOISE_KPA = 0.1
REST_SHARE = 0.02
REST_KPA = 0.01


@dataclass(frozen=True)
class OutletDynamics:
    """What a set-point goes through; pressures in kPa, times in s.

    Attributes:
        dead_time_s: until the outlet begins to follow.
        time_constant_s: of the approach.
        slew_kpa_s: the outlet's fastest change.
        dead_band_kpa: at rest, a smaller difference moves nothing.
        hysteresis_kpa: difference of the resting pressures after rising and after falling.
        offset_kpa, gain_error: the outlet rests at ``offset + (1 + gain_error) * set-point``.
    """

    dead_time_s: float = 0.03
    time_constant_s: float = 0.15
    slew_kpa_s: float = 600.0
    dead_band_kpa: float = 1.0
    hysteresis_kpa: float = 2.0
    offset_kpa: float = 0.0
    gain_error: float = 0.0


RANGES: dict[str, tuple[float, float]] = {
    "dead_time_s": (0.01, 0.08),
    "time_constant_s": (0.06, 0.4),
    "slew_kpa_s": (300.0, 1500.0),
    "dead_band_kpa": (0.5, 2.5),
    "hysteresis_kpa": (0.5, 5.0),
    "offset_kpa": (-2.0, 2.0),
    "gain_error": (-0.005, 0.005),
}
"""What is drawn where a rig file states nothing in ``[virtual.regulator]``."""


def draw(rng: np.random.Generator, stated: Mapping[str, float]) -> OutletDynamics:
    """A regulator: uniformly within `RANGES`, but for what is stated."""
    drawn = {name: float(rng.uniform(low, high)) for name, (low, high) in RANGES.items()}
    known = {f.name for f in fields(OutletDynamics)}
    return replace(
        OutletDynamics(**drawn), **{k: float(v) for k, v in stated.items() if k in known}
    )


class RegulatorOutlet:
    """Sets the pressure upstream of the inlet of a simulated bench.

    Args:
        plant: the bench; its regulator's set-point becomes the outlet's pressure.

    Attributes:
        dynamics: see `OutletDynamics`.
        pressure_kpa: at the outlet now.
        wanted_kpa: the newest set-point.
        holding: the valves are held: nothing moves.
    """

    def __init__(self, plant: BenchSim, dynamics: OutletDynamics | None = None) -> None:
        self.dynamics = dynamics or OutletDynamics()
        self.pressure_kpa = 0.0
        self.wanted_kpa = 0.0
        self.holding = False
        self._plant = plant
        plant.params[REGULATOR_LAG] = LINE_LAG_S
        self._rng = np.random.default_rng(0)
        self._now_ns = 0
        self._due: deque[tuple[int, float]] = deque()
        self._play = 0.0
        self._target = 0.0
        self._moving = False

    def seed(self, rng: np.random.Generator) -> None:
        """Where the noise of its sensor comes from."""
        self._rng = rng

    def set_point(self, kpa: float, at_ns: int | None = None) -> None:
        """A set-point arrives: at a bench time, or now."""
        self.wanted_kpa = kpa
        begin_ns = self._now_ns if at_ns is None else at_ns
        self._due.append((begin_ns + round(self.dynamics.dead_time_s * 1e9), kpa))

    def sensor_kpa(self) -> float:
        """What the regulator's own sensor reads."""
        return self.pressure_kpa + float(self._rng.normal(0.0, SENSOR_NOISE_KPA))

    def feed(self, data: bytes) -> None:
        """A regulator on an analogue line gets no bytes."""

    @property
    def next_ns(self) -> int | None:
        """When it next has something to do."""
        times = [self._due[0][0]] if self._due else []
        if self._moving:
            times.append(self._now_ns + STEP_NS)
        return min(times) if times else None

    def advance(self, to_ns: int) -> None:
        """Let time pass to ``to_ns`` (bench time)."""
        while self._due and self._due[0][0] <= to_ns:
            at_ns, kpa = self._due.popleft()
            self._move(at_ns)
            self._take(kpa)
        self._move(to_ns)
        self._plant.state[REGULATOR_SET] = max(self.pressure_kpa, 0.0) * 1e3

    def _take(self, kpa: float) -> None:
        """A set-point has come through the dead time."""
        d = self.dynamics
        half = d.hysteresis_kpa / 2
        if kpa > self._play + half:
            self._play = kpa - half
        elif kpa < self._play - half:
            self._play = kpa + half
        shut = kpa <= 0.0  # set to nothing it is open to the air
        self._target = 0.0 if shut else d.offset_kpa + (1.0 + d.gain_error) * self._play
        if abs(self._target - self.pressure_kpa) > d.dead_band_kpa or shut:
            self._moving = True

    def _move(self, to_ns: int) -> None:
        d = self.dynamics
        while self._moving and not self.holding and self._now_ns < to_ns:
            step_ns = min(STEP_NS, to_ns - self._now_ns)
            step_s = step_ns * 1e-9
            error = self._target - self.pressure_kpa
            change = error * -np.expm1(-step_s / d.time_constant_s)
            most = d.slew_kpa_s * step_s
            self.pressure_kpa += float(min(max(change, -most), most))
            self._now_ns += step_ns
            rest = max(REST_SHARE * d.dead_band_kpa, REST_KPA)
            self._moving = abs(self._target - self.pressure_kpa) > rest
        self._now_ns = max(self._now_ns, to_ns)
