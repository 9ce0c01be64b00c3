"""Close a loop: a law on the host, the firmware on every muscle, the finger beneath."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import numpy.typing as npt

from plant.constants import PlantConstants
from plant.effects.effects import NONE, Effects
from plant.finger import Finger, FingerSim
from studies.controllers.bench import FingerBench, Sensing
from studies.controllers.muscles import Pairs
from studies.controllers.reference import GRID_S, Reference, tips

Array = npt.NDArray[np.float64]

HOST_MS = 10
"""The host asks for new pressures so often."""
FINE_STEP_S = 5e-5
"""The finger's step in a closed loop, for the reason given at
`plant.simulator.bench.FINE_STEP_SHARE`."""
SETTLE_S = 1.5
"""From vented to the reference's first posture, before the clock starts."""


class Law(Protocol):
    """A controller on the host: angles in, deltas out."""

    def start(self, reference: Reference, q: Array) -> None:
        """Begin at angles `q` (as read), at rest."""

    def delta(self, time_s: float, q: Array) -> Array:
        """Delta of each pair (n,), kPa, for `HOST_MS` from now; `q` is the reading."""


@dataclass(frozen=True)
class Trial:
    """What happened: true angles (samples, n), tip (samples, 3), pressures (samples, 2 n) each ms.

    `asked_kpa` (samples, 2 n) are the set-points, `switchings` how often a valve was energised
    while the reference ran, `faults` what the firmware latched, `notes` what the law tells.
    """

    time_s: Array
    q: Array
    tip: Array
    pressure_kpa: Array
    asked_kpa: Array
    reference: Reference
    switchings: int
    faults: list[str]
    notes: dict[str, Array] = field(default_factory=dict)


def run_law(  # noqa: PLR0913 - what a trial may change, each by name
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
    """Bring the finger from vented to the reference's start, then let the law follow it.

    `finger` and `constants` are what law and firmware know; the finger as it is built and the
    plant's own constants (`built`, `plant`, where they differ), its `payload_kg` and `effects` are
    theirs to cope with.
    """
    known = Pairs(finger, constants)
    sim = FingerSim(built or finger, plant or constants, effects, payload_kg, step_max_s=step_max_s)
    rng = np.random.default_rng([seed, 81])
    bench = FingerBench(sim, scheme, rng, sensing, parameters, constants)
    bench.begin()
    law.start(reference, reference.q[0])
    begin_ms = round(SETTLE_S * 1000)
    for k in range(0, begin_ms, HOST_MS):
        # The law itself brings the finger to the start, with the reference standing still.
        time = (k - begin_ms) * 1e-3
        bench.ask(known.pressures(law.delta(time, bench.angles())))
        bench.run(HOST_MS)
    before = bench.switchings
    samples = len(reference.q)
    n = len(finger.joints)
    angles = np.empty((samples, n))
    pressure = np.empty((samples, 2 * n))
    asked = np.empty((samples, 2 * n))
    notes: list[Array] = []
    now = np.zeros(2 * n)
    for k in range(samples):
        angles[k], pressure[k] = sim.q_rad, sim.pressure_kpa
        if k % HOST_MS == 0:
            now = known.pressures(law.delta(k * GRID_S, bench.angles()))
            bench.ask(now)
            notes.append(np.array(getattr(law, "note", np.zeros(0)), dtype=float))
        asked[k] = now
        bench.run(1)
    return Trial(
        np.asarray(np.arange(samples) * GRID_S),
        angles,
        tips(finger.arm, angles),
        pressure,
        asked,
        reference,
        bench.switchings - before,
        bench.faults,
        {"note": np.array(notes)},
    )
