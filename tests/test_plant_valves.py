"""How the valve block answers commands: delays, short pulses, both modes, regulator, loads."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plant.constants import nominal
from plant.errors import PlantError
from plant.physics import layout, muscle, valve
from plant.simulator.bench import BenchSim
from plant.simulator.simulate import Commands, commands, pulse_train, run_commands

C = nominal()
INERTIAL, TRANSPORT = C, C.with_overrides({"delay_mode": "transport"})


def test_delays_are_taken_at_each_solenoid_s_own_upstream_side() -> None:
    assert valve.on_delay_s("inlet", 550e3, C) == pytest.approx(10.8725e-3)
    assert valve.off_delay_s("inlet", 550e3, C) == pytest.approx(8.50e-3)
    assert valve.on_delay_s("outlet", 300e3, C) == pytest.approx(9.802e-3)
    assert valve.off_delay_s("outlet", 300e3, C) == pytest.approx(8.646e-3)


def test_the_inlet_opens_after_its_delay_and_not_before() -> None:
    delay = valve.on_delay_s("inlet", C.supply_pa, C)
    bench = BenchSim(C)
    bench.advance(delay - 1e-6, 1.0)
    assert not bench.inlet_open
    bench.advance(2e-6, 1.0)
    assert bench.inlet_open


def test_the_outlet_delay_uses_the_pressure_when_the_command_changed() -> None:
    # Filling goes on while the vent command waits: the delay must not follow the pressure.
    bench = BenchSim(C)
    bench.advance(0.015, 1.0)
    at_command = bench.state[layout.PRESSURE]
    delay = valve.on_delay_s("outlet", at_command, C)
    bench.advance(delay - 1e-6, 1.0, 1.0)
    assert bench.state[layout.PRESSURE] > at_command + 10e3
    assert not bench.outlet_open
    bench.advance(2e-6, 1.0, 1.0)
    assert bench.outlet_open


def test_an_inertial_valve_ignores_a_command_exactly_as_long_as_its_delay() -> None:
    delay = valve.on_delay_s("inlet", C.supply_pa, C)
    for pulse, moved in [(delay - 1e-6, False), (delay, False), (delay + 1e-6, True)]:
        bench = BenchSim(INERTIAL)
        bench.advance(0.1, pulse)
        assert (bench.pressure_kpa > 0.0) is moved, pulse


def test_an_inertial_valve_ignores_an_exactly_equal_command_late_in_a_run_too() -> None:
    bench = BenchSim(INERTIAL)
    bench.set_supply(100.0)
    delay = valve.on_delay_s("inlet", 100e3, C)
    bench.state[layout.TIME] = 3600.0 + 1 / 3
    whole = math.floor(delay / 1e-3)
    for _ in range(whole):
        bench.advance(1e-3, 1e-3)
    bench.advance(1e-3, delay - whole * 1e-3)
    bench.advance(0.05)
    assert bench.pressure_kpa == 0.0


def test_an_inertial_valve_stays_open_through_a_short_release() -> None:
    release = valve.off_delay_s("inlet", C.supply_pa, C)
    for gap, stays in [(release - 1e-4, True), (release, True), (release + 1e-4, False)]:
        bench = BenchSim(INERTIAL)
        bench.advance(0.012, 1.0)
        assert bench.inlet_open
        bench.advance(gap, 0.0)
        shut_seen = False
        for _ in range(50):
            bench.advance(1e-4, 1.0)
            shut_seen |= not bench.inlet_open
        assert shut_seen is not stays, gap


def test_a_transported_short_pulse_opens_the_valve_later() -> None:
    traces = run_commands(TRANSPORT, pulse_train("inlet", 0.0, 0.004), 0.05, rate_hz=1e5)
    on_at = traces.time_s[np.argmax(traces.inlet_open)]
    assert on_at == pytest.approx(valve.on_delay_s("inlet", C.supply_pa, C), abs=2e-5)
    assert traces.inlet_open.sum() / 1e5 == pytest.approx(
        valve.open_time_s("inlet", 0.004, C.supply_pa, TRANSPORT), abs=2e-5
    )
    assert run_commands(INERTIAL, pulse_train("inlet", 0.0, 0.004), 0.05).pressure_kpa[-1] == 0.0


@settings(max_examples=60, deadline=None)
@given(
    pulse=st.floats(0.2e-3, 30e-3),
    solenoid=st.sampled_from(["inlet", "outlet"]),
    mode=st.sampled_from(["inertial", "transport"]),
)
def test_open_time_in_the_bench_is_the_one_in_closed_form(
    pulse: float, solenoid: valve.Solenoid, mode: str
) -> None:
    c = C.with_overrides({"delay_mode": mode, "supply_kpa": 300})
    # The outlet's delays follow the muscle: without slopes both solenoids see one pressure.
    c = c.with_overrides({"outlet_on_ms_per_kpa": 0.0, "outlet_off_ms_per_kpa": 0.0})
    traces = run_commands(
        c,
        pulse_train(solenoid, 0.0, pulse),
        0.06,
        rate_hz=2e5,
        pressure_kpa=100.0,
    )
    seen = (traces.inlet_open if solenoid == "inlet" else traces.outlet_open).sum() / 2e5
    told = valve.open_time_s(solenoid, pulse, 300e3, c)
    assert seen == pytest.approx(told, abs=1.1e-5)


def test_a_command_that_goes_on_over_ticks_has_no_edges_between_them() -> None:
    ticks, once = BenchSim(C), BenchSim(C)
    for _ in range(30):
        ticks.advance(1e-3, 1e-3)
    once.advance(0.030, 0.030)
    assert ticks.pressure_kpa == pytest.approx(once.pressure_kpa, abs=1e-4)
    assert ticks.pressure_kpa > 50


def test_many_pending_edges_in_transport_mode_are_all_kept() -> None:
    c = TRANSPORT.with_overrides(
        {"inlet_on_ms": 50, "inlet_off_ms": 50, "inlet_on_ms_per_kpa": 0, "inlet_off_ms_per_kpa": 0}
    )
    traces = run_commands(c, pulse_train("inlet", 0.0, 0.4e-3, 1e-3, 40), 0.2, rate_hz=1e5)
    rises = np.count_nonzero(np.diff(traces.inlet_open.astype(int)) == 1)
    assert rises == 40
    assert traces.inlet_open.sum() / 1e5 == pytest.approx(0.016, rel=0.03)


def test_a_normally_open_outlet_starts_vented_and_shuts_when_told_not_to_vent() -> None:
    bench = BenchSim(C.with_overrides({"outlet_normally": "open"}))
    seen = [bench.outlet_open]
    for _ in range(2):
        bench.advance(0.005, 0.0, 0.0)
        seen.append(bench.outlet_open)
    assert seen == [True, True, False]
    assert not BenchSim(C).outlet_open


def test_the_regulator_is_followed_with_a_lag_of_one_second() -> None:
    bench = BenchSim(C, source="regulator")
    bench.set_regulator(400.0)
    bench.advance(0.05, 0.0)
    assert bench.pressure_kpa == 0.0
    opens = valve.on_delay_s("inlet", C.supply_pa, C)
    bench.advance(opens + 1.0, 9.0)
    assert bench.pressure_kpa == pytest.approx(400 * (1 - math.exp(-1)), abs=1e-6)
    bench.advance(20.0, 20.0)
    assert bench.pressure_kpa == pytest.approx(400.0, abs=1e-3)
    bench.set_regulator(100.0)
    bench.advance(1.0, 1.0)
    assert bench.pressure_kpa == pytest.approx(100 + 300 * math.exp(-1), abs=1e-3)


def test_the_regulator_s_bench_vents_through_its_outlet() -> None:
    bench = BenchSim(C, source="regulator")
    bench.set_pressure(400.0)
    bench.advance(0.5, 0.0, 0.5)
    assert bench.pressure_kpa == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("kpa", [-1.0, 701.0, float("nan")])
def test_a_set_point_beyond_the_regulator_is_refused(kpa: float) -> None:
    with pytest.raises(PlantError, match="0 to 700"):
        BenchSim(C, source="regulator").set_regulator(kpa)


@pytest.mark.parametrize(("mass", "kpa"), [(1.0, 400.0), (2.0, 450.0), (4.0, 600.0)])
def test_a_hung_mass_settles_where_force_balances_weight(mass: float, kpa: float) -> None:
    bench = BenchSim(C, source="regulator", load="isotonic", length_m=0.060, mass_kg=mass)
    bench.set_regulator(kpa)
    for _ in range(60):
        bench.advance(1.0, 1.0)
    assert C.length_min_m * 1e3 < bench.length_mm < C.length_max_m * 1e3
    assert bench.force_n == pytest.approx(mass * 9.80665, rel=1e-6)
    # In closed form: L = sqrt((b^2 + 4 pi n^2 m g / p) / 3).
    k = 4 * math.pi * C.turns**2 * mass * 9.80665 / (kpa * 1e3)
    assert bench.length_mm == pytest.approx(
        1e3 * math.sqrt((C.braid_length_m**2 + k) / 3), abs=1e-4
    )


def test_a_slack_muscle_lets_the_load_down_onto_the_stop() -> None:
    bench = BenchSim(C, load="isotonic", length_m=0.060, mass_kg=1.0)
    for _ in range(3000):
        bench.advance(1e-3, 0.0, 1e-3)
    # What a bounce has driven out comes back through the open outlet.
    assert bench.pressure_kpa == pytest.approx(0.0, abs=1e-3)
    assert 20.0 * (bench.length_mm - 72.5) == pytest.approx(9.80665 - bench.force_n, abs=0.01)


def test_moving_the_holder_squeezes_the_gas_that_is_shut_in() -> None:
    bench = BenchSim(C, length_m=0.060)
    bench.set_pressure(300.0)
    bench.set_length(66.0)
    squeezed = muscle.chamber_volume(0.060, C) / muscle.chamber_volume(0.066, C)
    assert bench.pressure_kpa == pytest.approx(float(401.325 * squeezed - 101.325), rel=1e-12)
    assert bench.force_n == pytest.approx(
        float(muscle.force(bench.state[layout.PRESSURE], 0.066, C)), rel=1e-12
    )
    assert bench.time_s == 0.0


def test_prescribing_a_length_to_a_hung_mass_is_refused() -> None:
    bench = BenchSim(C, load="isotonic")
    with pytest.raises(PlantError, match="hung mass"):
        bench.set_length(60.0)
    with pytest.raises(PlantError, match="hung mass"):
        bench.set_length_rate(1.0)


def test_a_stage_that_runs_on_stops_before_the_end_of_the_braid() -> None:
    bench = BenchSim(C, length_m=0.060)
    bench.set_length_rate(100.0)
    for _ in range(2000):
        bench.advance(1e-3)
    assert 80 < bench.length_mm < C.braid_length_m * 1e3
    assert math.isfinite(bench.pressure_kpa)


@pytest.mark.parametrize(
    ("rows", "told"),
    [
        (Commands(np.array([0.1, 0.0]), ("inlet", "inlet"), np.array([1.0, 0.0])), "sort"),
        (commands([(0.0, "inlte", 1.0)]), "inlte"),  # type: ignore[list-item]
        (commands([(0.0, "inlet", 0.5)]), "allowed 0 or 1"),
        (commands([(float("nan"), "inlet", 1.0)]), "finite"),
        (Commands(np.zeros(2), ("inlet",), np.zeros(1)), "one of each"),
        (commands([(-1.0, "inlet", 1.0)]), "before 0"),
    ],
)
def test_bad_recordings_are_refused_with_the_row(rows: Commands, told: str) -> None:
    with pytest.raises(PlantError, match=told):
        run_commands(C, rows, 0.1)
