"""A load that sinks slowly onto a stop arrives there."""

from __future__ import annotations

from plant.constants import nominal
from plant.physics import layout as at
from plant.simulator.bench import BenchSim


def test_a_load_that_speeds_up_towards_a_stop_arrives() -> None:
    """4.5 nm above the stop, slow and speeding up: each secant falls short of it by a little.

    Before the stop took what came within 0.01 nm of it, this tick never ended.
    """
    sim = BenchSim(nominal(), source="regulator", load="isotonic", length_m=0.06, mass_kg=1.734)
    sim.set_regulator(62.4)
    sim.state[at.PRESSURE] = 89004.66511640996
    sim.state[at.LENGTH] = 0.07249999552341176
    sim.state[at.LENGTH_RATE] = 4.652703684760844e-05
    for _ in range(50):
        sim.advance(1e-3, 1e-3, 0.0)
    assert sim.length_mm > 72.5
    assert sim.length_mm < 73.5
