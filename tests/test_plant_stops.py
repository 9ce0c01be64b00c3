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


def test_a_muscle_that_is_led_to_a_length_keeps_its_pressure() -> None:
    """At once, the same way compresses what is in it."""
    led, moved = BenchSim(nominal(), length_m=0.06), BenchSim(nominal(), length_m=0.06)
    led.lead_to(74.0)
    moved.set_length(74.0)
    assert led.length_mm == moved.length_mm == 74.0
    assert led.pressure_kpa == 0.0
    assert moved.pressure_kpa > 10.0
