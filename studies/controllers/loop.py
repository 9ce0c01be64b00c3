"""The control loop: a law on the host, the firmware on every muscle, and the finger."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from plant.arrays import Array
from plant.constants import PlantConstants
from plant.effects.effects import NONE, Effects
from plant.finger import Finger, FingerSim
from studies.controllers.bench import FingerBench, Sensing
from studies.controllers.muscles import Pairs
from studies.controllers.reference import GRID_S, Reference, tips

HOST_MS = 10
"""Period of the host in ms."""
FINE_STEP_S = 5e-5
"""Integration step of the finger in a closed loop; see `plant.simulator.bench.FINE_STEP_SHARE`."""
SETTLE_S = 1.5
"""Time from vented to the first posture of the reference, before time 0."""


class Law(Protocol):
    """A controller on the host: input angles, output deltas."""

    def start(self, reference: Reference, q: Array) -> None:
        """Start at rest at the read angles `q`."""

    def delta(self, time_s: float, q: Array) -> Array:
        """Delta of each pair (n,) in kPa for the next `HOST_MS`; `q` are the read angles."""


@dataclass(frozen=True)
class Trial:
    """True angles (samples, n), tip (samples, 3), pressures (samples, 2 n), every ms.

    `set_kpa` (samples, 2 n) are the set-points. `switchings` counts how often a valve was
    energised during the reference. `faults` are those latched by the firmware. `estimates` are
    the parameters that the law estimates, one row every `HOST_MS`.
    """

    time_s: Array
    q: Array
    tip: Array
    pressure_kpa: Array
    set_kpa: Array
    reference: Reference
    switchings: int
    faults: list[str]
    estimates: Array


def run_law(  # noqa: PLR0913 - options of a trial, by name
    finger: Finger,
    constants: PlantConstants,
    law: Law,
    reference: Reference,
    *,
    scheme: str = "burst",
    built: Finger | None = None,
    plant: PlantConstants | None = None,
    payload_kg: float = 0.0,
    effects: Effects = NONE,
    seed: int = 1,
    sensing: Sensing | None = None,
    parameters: dict[str, int] | None = None,
    step_max_s: float = FINE_STEP_S,
) -> Trial:
    """Move the finger from vented to the start of the reference, then follow the reference.

    Law and firmware use `finger` and `constants`. The plant may differ from these by `built`,
    `plant`, `payload_kg` and `effects`.
    """
    known = Pairs(finger, constants)
    sim = FingerSim(built or finger, plant or constants, effects, payload_kg, step_max_s=step_max_s)
    rng = np.random.default_rng([seed, 81])
    bench = FingerBench(sim, scheme, rng, sensing, parameters, constants)
    bench.begin()
    law.start(reference, reference.q[0])
    begin_ms = round(SETTLE_S * 1000)
    for k in range(0, begin_ms, HOST_MS):
        # The law moves the finger to the start, with a constant reference.
        time = (k - begin_ms) * 1e-3
        bench.set_pressures(known.pressures(law.delta(time, bench.angles())))
        bench.run(HOST_MS)
    before = bench.switchings
    samples = len(reference.q)
    n = len(finger.joints)
    angles = np.empty((samples, n))
    pressure = np.empty((samples, 2 * n))
    set_kpa = np.empty((samples, 2 * n))
    estimates: list[Array] = []
    now = np.zeros(2 * n)
    for k in range(samples):
        angles[k], pressure[k] = sim.q_rad, sim.pressure_kpa
        if k % HOST_MS == 0:
            now = known.pressures(law.delta(k * GRID_S, bench.angles()))
            bench.set_pressures(now)
            estimates.append(np.array(getattr(law, "estimates", np.zeros(0)), dtype=float))
        set_kpa[k] = now
        bench.run(1)
    return Trial(
        np.asarray(np.arange(samples) * GRID_S),
        angles,
        tips(finger.arm, angles),
        pressure,
        set_kpa,
        reference,
        bench.switchings - before,
        bench.faults,
        np.array(estimates),
    )
