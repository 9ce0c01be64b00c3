"""Studies: the fast loop is the firmware's, and each study answers at its small size."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from bench_process import call_pamrig
from plant.constants import nominal
from plant.simulator.bench import FINE_STEP_SHARE, BenchSim
from rigs.virtual.board.as_printed import install_as_printed
from rigs.virtual.board.board import SimBoard
from rigs.virtual.board.pressure_sensor import PressureSensor
from rigs.virtual.board.timing import IDEAL
from rigs.virtual.board.tuning import burst_parameters, safety_parameters
from studies.schemes import delay, orifice, ram, schemes
from studies.schemes.command import Progress
from studies.schemes.ram import lift
from studies.schemes.trial import SCHEMES, Bench, Trace, run_trial, summary
from valvefw.wire import encode_frame

C = nominal()


@pytest.mark.parametrize("scheme", sorted(SCHEMES))
def test_the_fast_loop_is_the_whole_firmware_tick_by_tick(scheme: str) -> None:
    """Without noise: wire, guards and telemetry change nothing of what the valves do."""
    plant = BenchSim(C, length_m=0.060)
    board = SimBoard(
        plant,
        np.random.default_rng(1),
        sensor=PressureSensor(noise_kpa=0.0),
        truth_every=1,
        outlet_normally_open=False,
        timing=IDEAL,
    )
    install_as_printed(board)
    values = board.controller.values
    values.update({**burst_parameters(C), **safety_parameters(C)})
    values.update(inlet_max_ms=2000, stuck_ms=0, leak_counts=0, slew=4095, hb_ms=1000)
    values.update(trip=4095, sat_high=4096, rise_ms=0)
    board.run_until_us(60_000)
    board.controller.safety.arm(values)
    for text in (f"scheme {scheme}", f"sp {round(0.4 * 550 * 4.095 * 16)}"):
        board.feed(encode_frame(f"Q1 {text}".encode()))
    twin = BenchSim(C, length_m=0.060)
    twin.state[:] = plant.state
    at = len(board.truth_kpa)
    board.run_until_us(board.bench_us + 900_000)
    assert not board.controller.safety.faults
    here = np.array(board.truth_kpa)[at + 2 :]
    fast = run_trial(Bench(C, noise_kpa=0.0), scheme, (0.4,), step_s=0.9, plant=twin)
    there = fast[0].pressure_kpa
    assert np.ptp(here) > 50.0
    # The board advances first, then reads; a scheme that is chosen runs from the next reading on.
    assert np.abs(here - there[: len(here)]).max() < 1e-9


def test_figures_of_a_known_trace() -> None:
    t = np.arange(3000) * 1e-3
    pressure = np.where(t < 0.1, 0.0, 200.0 + 11.0 * np.sin(2 * np.pi * 10 * t))
    valve = (np.arange(3000) % 100) < 10
    trace = Trace(200.0, 550.0, pressure, np.full(3000, 60.0), valve, np.zeros(3000, bool))
    found = trace.figures()
    assert found["ripple"] == pytest.approx(4.0, abs=0.01)
    assert found["overshoot"] == pytest.approx(2.0, abs=0.01)
    assert found["error"] == pytest.approx(0.0, abs=0.01)
    assert found["rms"] == pytest.approx(11.0 / math.sqrt(2.0) / 5.5, rel=1e-3)
    assert found["rise_s"] == pytest.approx(0.1)
    assert found["settle_s"] == pytest.approx(0.1)
    assert found["switchings"] == 10.0 or found["switchings"] == 9.0


def test_statements_follow_from_figures_and_can_fail() -> None:
    def result(ripple: float, rise: float, overshoot: float) -> schemes.Summary:
        return {
            "ripple": (ripple, 1.0, 20),
            "rise_s": (rise, 0.01, 20),
            "overshoot": (overshoot, 1.0, 20),
            "error": (1.0, 1.0, 20),
        }

    wild = {
        "two": result(20.0, 0.1, 20.0),
        "duty_in": result(40.0, 0.5, 30.0),
        "duty": result(15.0, 0.2, 15.0),
        "slide": result(8.0, 0.3, 9.0),
    }
    assert all(schemes.holds(wild).values())
    calm = {name: result(0.1, 0.3, 0.1) for name in wild}
    calm["two"] = result(0.05, 0.3, 0.1)
    assert not any(schemes.holds(calm).values())


def test_the_muscle_swings_on_the_valve_of_1996_and_not_on_the_small_fast_one() -> None:
    valves = schemes.valves()
    swings = {
        name: schemes.measure(Bench(c), "two", (0.4, 0.7), 1)["ripple"][0]
        for name, c in valves.items()
    }
    assert swings["1996"] > 20.0
    assert swings["small and fast"] < 2.0


def test_halving_the_step_changes_no_figure_of_a_lift() -> None:
    """The ram's rest and the peak on the way; every tick is made of substeps half as long."""
    from plant.scene.ram import Ram, RamConstants, ram_scene

    rests = []
    for share in (1.0, 0.5):
        scene = ram_scene(C, RamConstants(), height_m=0.1, step_share=share)
        twin = Ram(C, height_mm=100.0)
        twin.scene = scene
        twin.state = scene.world.units[0]
        path = []
        for tick in range(1500):
            twin.advance(1e-3, 1e-3 if tick < 120 else 0.0, 0.0)
            path.append(twin.height_mm)
        rests.append((max(path), path[-1]))
    assert rests[0] == pytest.approx(rests[1], rel=1e-3)


@pytest.mark.parametrize(
    ("load", "scheme"),
    [("held", "duty_in"), ("hung", "slide"), ("hung", "burst"), ("hung", "slide_as_printed")],
)
def test_a_quarter_of_the_step_changes_no_figure_of_a_scheme(load: str, scheme: str) -> None:
    """In a closed loop, converter and noise included."""
    found = []
    for share in (FINE_STEP_SHARE, FINE_STEP_SHARE / 4):
        bench = Bench(C, load, step_share=share)
        found.append(summary(run_trial(bench, scheme, (0.25, 0.55, 0.4))))
    for key, (mean, _, count) in found[0].items():
        assert count == found[1][key][2]
        if count:
            assert mean == pytest.approx(found[1][key][0], rel=1e-3, abs=1e-3)


def test_a_lift_is_held_by_friction_and_gas() -> None:
    found = lift(C, ram.RamConstants(), 100.0)
    assert found.moved_mm < 0.1
    assert found.rest_mm > 140.0


def test_a_burst_is_worth_what_the_map_says() -> None:
    """A fifth of supply at 1 mm and the delays of 1996; a quarter of it at half the diameter."""
    whole = orifice.burst_share(orifice.valve(1.0, 1.0))
    assert whole == pytest.approx(19.8, abs=0.3)
    assert orifice.burst_share(orifice.valve(0.5, 1.0)) == pytest.approx(whole / 4)
    assert orifice.burst_share(orifice.valve(1.0, 0.5)) == pytest.approx(whole / 2)


def test_short_pulses_tell_the_delays_apart() -> None:
    assert delay.answer_kpa("inertial", 8.0) == 0.0
    assert delay.answer_kpa("transport", 8.0) > 50.0
    assert delay.answer_kpa("inertial", 14.0) == pytest.approx(delay.answer_kpa("transport", 14.0))


@pytest.mark.parametrize("module", [schemes, ram, orifice, delay])
def test_each_study_answers_in_small(module, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    study = module.run(False, Progress())
    text = study.markdown()
    assert study.grids
    assert "|" in text
    assert json.loads(json.dumps(study.as_json(), allow_nan=False))["study"] == study.name
    for statement in study.statements:
        assert statement.verdict in ("confirmed", "contradicted", "partly")
        assert any(c.isdigit() for c in statement.because)
    for draw in study.figures.values():
        for ax in draw().axes:
            assert ax.get_ylabel() or ax.get_xlabel() or ax.get_title(loc="left")


def test_the_command_writes_figures_and_one_json_value(tmp_path: Path) -> None:
    done = call_pamrig("study", "delay", "--json", "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["study"] == "delay"
    assert (tmp_path / "study-delay.png").stat().st_size > 10_000
