"""The four checks of the plant's specification, and the laws every version of it must obey."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plant.constants import GAS_CONSTANT_J_KG_K, nominal
from plant.errors import PlantError
from plant.physics import flow, layout, muscle
from plant.simulator.bench import BenchSim, advance
from plant.simulator.simulate import pulse_train, run_commands

C = nominal()
LENGTHS = st.floats(0.045, 0.080)
PRESSURES = st.floats(0.0, 700e3)


def burst_ladder(step_max_s: float | None = None) -> list[np.ndarray]:
    bench = BenchSim(C, length_m=0.060)
    if step_max_s is not None:
        bench.params[layout.STEP_MAX] = step_max_s
        bench.params[layout.STEP_SAFETY] *= 0.5
    ladder, trace = [bench.pressure_kpa], []
    for _ in range(7):
        for k in range(100):
            bench.advance(1e-3, min(1e-3, max(0.0, 0.0112 - k * 1e-3)))
            trace.append(bench.pressure_kpa)
        ladder.append(bench.pressure_kpa)
    return [np.array(ladder), np.array(trace)]


def test_check_1_bursts_of_11_2_ms_fill_the_muscle_in_the_stated_steps() -> None:
    share = burst_ladder()[0] / 550 * 100
    assert np.abs(share - [0, 21, 41, 61, 79, 92, 99, 100]).max() <= 1.0


def test_check_1_valve_is_open_for_8_83_ms_of_each_burst() -> None:
    traces = run_commands(C, pulse_train("inlet", 0.0, 0.0112), 0.1, rate_hz=100_000)
    assert traces.inlet_open.sum() / 1e5 == pytest.approx(8.83e-3, abs=0.02e-3)


def test_check_2_forces_and_volumes_of_the_reference_muscle() -> None:
    length = np.array([52, 55, 60, 65, 67]) * 1e-3
    assert np.abs(muscle.force(600e3, length, C) - [4.13, 17.49, 41.42, 67.44, 78.43]).max() < 0.005
    volume_ml = muscle.volume(length, C) * 1e6
    assert np.abs(volume_ml - [6.146, 6.092, 5.848, 5.396, 5.153]).max() < 0.0005


def test_check_3_closed_valves_keep_pressure_times_volume_over_1e5_steps() -> None:
    bench = BenchSim(C, length_m=0.060)
    bench.set_pressure(400.0)

    def product() -> float:
        absolute = bench.state[layout.PRESSURE] + C.atmosphere_pa
        return float(absolute * muscle.chamber_volume(bench.state[layout.LENGTH], C))

    first = product()
    for k in range(100_000):
        if k % 500 == 0:
            bench.set_length_rate(10.0 if k % 1000 == 0 else -10.0)
        advance(bench.state, bench.params, 1e-3, 0.0, 0.0)
    assert product() == pytest.approx(first, rel=1e-9)


@pytest.mark.parametrize("exponent", [1.0, 1.2])
def test_sealed_gas_under_a_bouncing_load_keeps_p_v_to_the_exponent(exponent: float) -> None:
    c = C.with_overrides({"polytropic_exponent": exponent})
    bench = BenchSim(c, load="isotonic", length_m=0.060, mass_kg=1.5)
    bench.set_pressure(500.0)
    first = (500e3 + c.atmosphere_pa) * muscle.chamber_volume(0.060, c) ** exponent
    for _ in range(2000):
        bench.advance(1e-3)
    state = bench.state
    last = (state[layout.PRESSURE] + c.atmosphere_pa) * float(
        muscle.chamber_volume(state[layout.LENGTH], c) ** exponent
    )
    assert last == pytest.approx(float(first), rel=1e-11)
    assert abs(bench.length_mm - 60.0) > 1.0


def test_check_4_halving_the_step_leaves_the_burst_trace_alone() -> None:
    coarse, fine = burst_ladder()[1], burst_ladder(0.5e-3)[1]
    assert np.abs(coarse - fine).max() < 0.1
    # What this integrator reaches; a regression here is a lost order of accuracy.
    assert np.abs(coarse - fine).max() < 0.002


@given(p=PRESSURES, length=LENGTHS)
def test_force_is_pressure_times_shrinking_volume(p: float, length: float) -> None:
    force, slope = muscle.force(p, length, C), muscle.dvolume_dl(length, C)
    assert float(force) == pytest.approx(float(-p * slope), rel=1e-12, abs=1e-9)


@given(p=PRESSURES, length=LENGTHS)
def test_derivatives_agree_with_finite_differences(p: float, length: float) -> None:
    h = 1e-6
    by_length = (muscle.force(p, length + h, C) - muscle.force(p, length - h, C)) / (2 * h)
    assert float(muscle.dforce_dl(p, length, C)) == pytest.approx(
        float(by_length), rel=1e-6, abs=1e-3
    )
    by_pressure = (muscle.force(p + 10, length, C) - muscle.force(p - 10, length, C)) / 20
    assert float(muscle.dforce_dp(p, length, C)) == pytest.approx(
        float(by_pressure), rel=1e-6, abs=1e-12
    )
    by_volume = (muscle.volume(length + h, C) - muscle.volume(length - h, C)) / (2 * h)
    assert float(muscle.dvolume_dl(length, C)) == pytest.approx(
        float(by_volume), rel=1e-5, abs=1e-10
    )


def test_force_is_zero_at_the_braid_s_neutral_length() -> None:
    assert float(muscle.force(600e3, muscle.zero_force_length(C), C)) == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize("length", [0.0, -0.01, 0.0884, 1.0, float("nan")])
def test_a_length_outside_the_braid_is_refused_by_name(length: float) -> None:
    with pytest.raises(PlantError, match="braid_length_mm"):
        muscle.force(1e5, length, C)
    with pytest.raises(PlantError, match="length"):
        BenchSim(C, length_m=length)


def test_a_pressure_below_vacuum_is_refused() -> None:
    with pytest.raises(PlantError, match="vacuum"):
        muscle.force(-2e5, 0.06, C)


@given(ratio=st.floats(0.0, 1.5), critical=st.floats(0.0, 0.9))
def test_flow_factor_lies_between_shut_and_choked_and_falls_with_ratio(
    ratio: float, critical: float
) -> None:
    here = flow.subsonic_factor(ratio, critical)
    assert 0.0 <= here <= 1.0
    assert flow.subsonic_factor(ratio + 0.01, critical) <= here
    if ratio <= critical:
        assert here == 1.0
    if ratio >= 1.0:
        assert here == 0.0


@given(ratio=st.floats(0.01, 0.9999), critical=st.floats(0.0, 0.9))
def test_flow_slope_is_the_derivative_of_the_factor(ratio: float, critical: float) -> None:
    h = 1e-9
    if abs(ratio - critical) < 1e-6:
        return
    difference = (
        flow.subsonic_factor(ratio - h, critical) - flow.subsonic_factor(ratio + h, critical)
    ) / (2 * h)
    assert flow.subsonic_slope(ratio, critical) == pytest.approx(difference, rel=1e-3, abs=1e-5)


def test_choked_flow_follows_the_definition_of_conductance() -> None:
    # 1.25e-9 m3/(s Pa) at 651.325 kPa: 0.814 litres of reference air a second.
    assert flow.mass_flow_kg_s(651_325, 101_325, 1.25e-9, 0.5) == pytest.approx(
        1.25e-9 * 651_325 * 1.185, rel=1e-12
    )


COMMANDS = st.lists(st.tuples(st.floats(0.0, 1.0), st.floats(0.0, 1.0)), min_size=5, max_size=60)


@settings(max_examples=60, deadline=None)
@given(ticks=COMMANDS, start_kpa=st.floats(0.0, 550.0), rate=st.floats(-20.0, 20.0))
def test_gas_in_the_muscle_is_what_came_in_less_what_went_out(
    ticks: list[tuple[float, float]], start_kpa: float, rate: float
) -> None:
    c = C.with_overrides({"delay_mode": "transport"})
    bench = BenchSim(c, length_m=0.060)
    bench.set_pressure(start_kpa)
    bench.set_length_rate(rate)

    def mass() -> float:
        absolute = bench.state[layout.PRESSURE] + c.atmosphere_pa
        volume = float(muscle.chamber_volume(bench.state[layout.LENGTH], c))
        return float(absolute * volume / (GAS_CONSTANT_J_KG_K * c.gas_temperature_k))

    first = mass()
    for inlet, outlet in ticks:
        bench.advance(0.010, inlet * 0.010, outlet * 0.010)
    gained = bench.state[layout.MASS_IN] - bench.state[layout.MASS_OUT]
    assert mass() - first == pytest.approx(gained, rel=1e-9, abs=1e-15)


@settings(max_examples=40, deadline=None)
@given(start_kpa=st.floats(0.0, 700.0), length_m=LENGTHS)
def test_venting_never_raises_the_pressure_and_ends_at_the_atmosphere(
    start_kpa: float, length_m: float
) -> None:
    bench = BenchSim(C, length_m=length_m)
    bench.set_pressure(start_kpa)
    last = start_kpa
    for _ in range(400):
        bench.advance(1e-3, 0.0, 1e-3)
        assert bench.pressure_kpa <= last + 1e-9
        last = bench.pressure_kpa
    assert last == pytest.approx(0.0, abs=1e-3)
