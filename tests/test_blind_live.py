"""The blind bench, step by step: the same physics as a whole trial, and a secret well kept."""

from __future__ import annotations

import json

import numpy as np
import pytest

from blind.live import LiveBench, draw_secret
from blind.physics import numbers as n
from blind.physics.bench import Trial, nominal, run_trial
from blind.physics.entries import Hidden
from blind.physics.stepping import OUT_F, OUT_L, OUT_P
from blind.seal import opened


def test_steps_of_a_millisecond_give_the_trial_run_whole() -> None:
    bench = LiveBench()
    bench.start_trial(length_mm=60.0)
    shown = [bench.step(1e-3, inlet=int(20 <= i < 60), outlet=int(200 <= i < 230))
             for i in range(400)]  # fmt: skip
    edges = np.array([[0.02, 0, 1], [0.06, 0, 0], [0.2, 1, 1], [0.23, 1, 0]])
    trial = Trial("t", "s", "step", 1, 1, 1, 0.4, held_mm=60.0, edges=edges)
    whole = run_trial(trial, nominal(), bench.effects, np.array([s.time_s for s in shown]))
    assert np.abs(whole[:, OUT_P] - [s.pressure_kpa for s in shown]).max() < 0.1
    assert np.abs(whole[:, OUT_F] - [s.force_n for s in shown]).max() < 0.02


def test_a_hanging_mass_is_lifted_as_in_a_trial_run_whole() -> None:
    bench = LiveBench()
    bench.start_trial(load_kg=2.0)
    shown = [bench.step(1e-3, inlet=int(i >= 100)) for i in range(600)]
    trial = Trial("t", "s", "step", 1, 1, 1, 0.6, load_kg=2.0, edges=np.array([[0.1, 0, 1]]))
    whole = run_trial(trial, nominal(), bench.effects, np.array([s.time_s for s in shown]))
    assert np.abs(whole[:, OUT_L] - [s.length_mm for s in shown]).max() < 0.05


def test_a_moving_stage_and_a_regulator() -> None:
    bench = LiveBench()
    bench.start_trial(length_mm=55.0, pressure_kpa=300.0)
    for i in range(100):
        shown = bench.step(0.01, regulator_kpa=300.0, length_mm=55.0 + 0.1 * (i + 1))
    assert shown.length_mm == pytest.approx(65.0)
    assert shown.force_n == pytest.approx(33.72, abs=0.05)


def test_a_muscle_shortened_with_its_outlet_open_draws_air_in() -> None:
    """It stayed below the atmosphere, and the next filling looked like a dead sensor (seed 130)."""
    bench = LiveBench()
    bench.start_trial(length_mm=72.0)
    for i in range(100):
        drawn = bench.step(0.01, outlet=1, length_mm=72.0 - 0.1 * i)
    assert drawn.pressure_kpa == pytest.approx(0.0, abs=0.2)
    for i in range(100):
        shut = bench.step(0.01, length_mm=62.0 - 0.1 * i)
    assert shut.pressure_kpa < -3.0  # nothing comes in where the outlet is shut


def test_a_force_that_depends_on_speed_shows_while_the_stage_moves() -> None:
    hidden = Hidden("viscosity", 1, 0.5, (12.0, 0.0, 0.0))
    bench = LiveBench(hidden=[hidden])
    bench.start_trial(length_mm=55.0, pressure_kpa=300.0)
    shown = [
        bench.step(0.01, regulator_kpa=300.0, length_mm=55.0 + 0.1 * (i + 1)) for i in range(100)
    ]
    course = np.array([0.0, 1.0]), np.array([55.0, 65.0])
    level = np.array([0.0, 1.0]), np.array([300.0, 300.0])
    trial = Trial("t", "s", "free", 1, 1, 1, 1.0, length=course, regulator=level)
    whole = run_trial(trial, nominal(), bench.effects, np.array([s.time_s for s in shown[:-1]]))
    assert np.abs(whole[:, OUT_F] - [s.force_n for s in shown[:-1]]).max() < 0.05
    still = bench.step(0.01, regulator_kpa=300.0)
    assert shown[-1].force_n - still.force_n > 3.0


def test_a_new_trial_does_not_touch_valves_that_are_open_or_about_to_move() -> None:
    shown = {}
    for keep in (False, True):
        hidden = Hidden("flow_area", 1, -0.4, variant="outlet")
        bench = LiveBench(hidden=[hidden])
        bench.start_trial(length_mm=60.0, pressure_kpa=300.0)
        for i in range(60):
            bench.step(1e-3, outlet=int(i < 59))
        if keep:
            bench.start_trial(length_mm=60.0, keep=True)
        shown[keep] = [bench.step(1e-3, outlet=0).true_pressure_kpa for _ in range(20)]
    assert shown[True] == pytest.approx(shown[False], rel=1e-6)


def test_the_camera_is_late_by_the_hidden_delay() -> None:
    bench = LiveBench(hidden=[Hidden("camera_delay", 0, 50.0)])
    bench.start_trial(length_mm=55.0, pressure_kpa=300.0)
    for i in range(400):
        shown = bench.step(1e-3, regulator_kpa=300.0, length_mm=55.0 + 0.01 * (i + 1))
    assert shown.true_length_mm - shown.length_mm == pytest.approx(0.5, abs=0.02)


def test_a_secret_is_sealed_and_its_own_entropy_repeats_it() -> None:
    one, same = draw_secret(77), draw_secret(77)
    assert one.answer() == same.answer()
    assert one.hidden
    assert one.hidden[0].form in (1, 2)
    digest, envelope = LiveBench(secret=one).sealed()
    assert opened(json.loads(json.dumps(envelope)), digest) == json.loads(json.dumps(one.answer()))


def test_two_secrets_of_the_operating_system_differ() -> None:
    a = draw_secret(effects=["payload"])
    b = draw_secret(effects=["payload"])
    assert not np.array_equal(a.constants, b.constants)
    assert a.constants[n.MASS] == 0.0
