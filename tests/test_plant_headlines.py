"""Every effect's headline parameter, measured back from simulated data by its own definition.

The formulas here are those of a person with the data and the nominal constants: none of the
plant's own effect code is used to read a value back.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from plant.constants import nominal
from plant.effects.catalogue import CATALOGUE
from plant.effects.effects import Effects
from plant.errors import PlantError
from plant.physics import layout
from plant.simulator.bench import BenchSim, build_params
from plant.simulator.readings import readings
from plant.simulator.simulate import Commands, Traces, commands, pulse_train, run_commands

C = nominal()
B, N, ATM = 0.0884, 1.855, 101_325.0
HELD = {"source": "regulator", "load": "isometric"}


def on(**tables: dict[str, Any]) -> Effects:
    return Effects.from_config(tables)


def braid_n(p_kpa: Any, length_mm: Any) -> Any:
    """Equation 4-8 of the thesis with the nominal geometry."""
    length = np.asarray(length_mm) * 1e-3
    return np.asarray(p_kpa) * 1e3 * (3 * length**2 - B**2) / (4 * math.pi * N**2)


def volume_m3(length_mm: float) -> float:
    length = length_mm * 1e-3
    return (B**2 * length - length**3) / (4 * math.pi * N**2) + 0.5e-6


def at_rest(effects: Effects, p_kpa: float, length_mm: float, **more: float) -> float:
    """Force of a muscle put at a pressure and length, right then."""
    bench = BenchSim(C, effects, length_m=length_mm * 1e-3)
    if "temperature_c" in more:
        bench.set_temperature(more["temperature_c"])
    bench.set_trials(more.get("trials", 0.0))
    bench.set_pressure(p_kpa)
    return bench.force_n


def filled(effects: Effects, seconds: float = 0.2, **more: Any) -> Traces:
    """The inlet opened at time 0 and left open, 20 kHz."""
    return run_commands(
        C, commands([(0.0, "inlet", 1.0)]), seconds, 20_000, effects=effects, **more
    )


def vented(effects: Effects, seconds: float = 0.2, **more: Any) -> Traces:
    rows = commands([(0.0, "outlet", 1.0)])
    return run_commands(C, rows, seconds, 20_000, effects, pressure_kpa=500.0, **more)


def moved_at(trace: Traces) -> float:
    """When the pressure began to change, s."""
    change = np.abs(trace.pressure_kpa - trace.pressure_kpa[0]) > 1e-9
    return float(trace.time_s[np.flatnonzero(change)[0] - 1])


# ---- muscle -------------------------------------------------------------------------------------


@pytest.mark.parametrize("hardening", [0.0, 0.004])
def test_bladder_stiffness_is_the_slope_of_the_vented_muscle_at_60_mm(hardening: float) -> None:
    effects = on(bladder_elasticity={"stiffness_n_mm": 0.8, "hardening_per_mm2": hardening})
    for p in (0.0, 400.0):
        high, low = at_rest(effects, p, 60.01), at_rest(effects, p, 59.99)
        slope = (high - braid_n(p, 60.01) - low + braid_n(p, 59.99)) / 0.02
        assert slope == pytest.approx(0.8, rel=1e-4)


def test_contraction_limit_is_lost_1_mm_above_the_shortest_and_nothing_far_away() -> None:
    effects = on(contraction_limit={"force_n": 6.0})
    assert braid_n(300.0, 52.0) - at_rest(effects, 300.0, 52.0) == pytest.approx(6.0, rel=1e-9)
    assert braid_n(300.0, 65.0) - at_rest(effects, 300.0, 65.0) < 1e-4


def test_end_cap_shortening_is_the_length_by_which_the_force_is_that_of_a_shorter_muscle() -> None:
    force = at_rest(on(end_cap={"shortening_mm": 2.5}), 450.0, 60.0)
    # Solve equation 4-8 for the length that gives this force.
    length = math.sqrt((force * 4 * math.pi * N**2 / 450e3 + B**2) / 3) * 1e3
    assert 60.0 - length == pytest.approx(2.5, rel=1e-9)


def test_fibre_stretch_is_the_braid_length_that_the_force_at_500_kpa_tells() -> None:
    force = at_rest(on(fibre_stretch={"stretch_percent": 1.2}), 500.0, 60.0)
    braid = math.sqrt(3 * 0.060**2 - force * 4 * math.pi * N**2 / 500e3)
    assert (braid / B - 1) * 100 == pytest.approx(1.2, rel=1e-9)


@pytest.mark.parametrize(("exponent", "share"), [(1.0, 0.0), (0.5, 0.0), (0.7, 1.0)])
def test_damping_is_force_per_speed_at_10_mm_s(exponent: float, share: float) -> None:
    effects = on(viscosity={"damping_n_s_mm": 0.3, "exponent": exponent, "pressure_share": share})
    bench = BenchSim(C, effects, "regulator", length_m=0.060)
    bench.set_pressure(300.0)
    forces = {}
    for rate in (10.0, -10.0):
        bench.set_length(60.0)
        bench.set_pressure(300.0)
        bench.set_length_rate(rate)
        bench.advance(0.0)
        forces[rate] = bench.force_n
    assert (forces[10.0] - forces[-10.0]) / 20.0 == pytest.approx(0.3, rel=1e-9)


@pytest.mark.parametrize("relaxation", [4.0, 12.0, -3.0])
def test_relaxation_is_the_share_of_a_step_gone_after_60_s(relaxation: float) -> None:
    effects = on(creep={"relaxation_percent": relaxation})
    trace = run_commands(C, commands([]), 60.0, 10.0, effects, pressure_kpa=400.0)
    assert trace.force_n[0] == pytest.approx(braid_n(400.0, 60.0), rel=1e-9)
    gone = (trace.force_n[0] - trace.force_n[-1]) / trace.force_n[0] * 100
    assert gone == pytest.approx(relaxation, rel=1e-6)
    first_second = (trace.force_n[0] - trace.force_n[10]) / trace.force_n[0] * 100
    assert abs(first_second) < 0.15 * abs(relaxation)


def test_creep_follows_a_ramp_as_the_convolution_of_its_step_answer() -> None:
    effects = on(creep={"relaxation_percent": 10.0})
    rows = commands([(0.0, "inlet", 1.0), (0.5, "regulator_kpa", 400.0)])
    trace = run_commands(C, rows, 20.0, 50.0, effects, source="regulator")
    step = run_commands(C, commands([]), 20.0, 50.0, effects, pressure_kpa=400.0).force_n
    answer = step / step[0]
    elastic = braid_n(trace.pressure_kpa, 60.0)
    middle = (answer[:-1] + answer[1:]) / 2
    rises = np.diff(elastic)
    folded = np.array([float(rises[:k] @ middle[:k][::-1]) for k in range(len(elastic))])
    assert np.abs(trace.force_n - folded).max() < 2e-4


@pytest.mark.parametrize("flat", [0.0, 0.6])
def test_percent_per_k_is_the_change_at_500_kpa(flat: float) -> None:
    effects = on(temperature_stiffening={"percent_per_k": 0.9, "flat_share": flat})
    cold, hot = (at_rest(effects, 500.0, 62.0, temperature_c=t) for t in (21.0, 31.0))
    assert (hot / cold - 1) * 10 == pytest.approx(0.9, rel=1e-9)
    low = at_rest(effects, 100.0, 62.0, temperature_c=31.0) - braid_n(100.0, 62.0)
    grown = 0.09 * (braid_n(100.0, 62.0) * (1 - flat) + braid_n(500.0, 62.0) * flat)
    assert low == pytest.approx(float(grown), rel=1e-9)


def test_wear_is_percent_per_100_trials() -> None:
    effects = on(wear={"percent_per_100_trials": -7.0})
    new, old = (at_rest(effects, 350.0, 60.0, trials=k) for k in (0.0, 50.0))
    assert (old / new - 1) * 100 / 50 * 100 == pytest.approx(-7.0, rel=1e-9)


# ---- chamber and valve --------------------------------------------------------------------------


@pytest.mark.parametrize("length_mm", [53.0, 60.0, 70.0])
def test_dead_volume_is_what_the_squeezed_gas_tells(length_mm: float) -> None:
    bench = BenchSim(C, on(dead_volume={"volume_ml": 2.0}), length_m=length_mm * 1e-3)
    bench.set_pressure(300.0)
    bench.set_length(length_mm + 2.0)
    ratio = (300e3 + ATM) / (bench.pressure_kpa * 1e3 + ATM)
    # ratio = (V1 + x) / (V0 + x)
    extra = (volume_m3(length_mm + 2.0) - ratio * volume_m3(length_mm)) / (ratio - 1.0)
    assert extra * 1e6 == pytest.approx(2.0, rel=1e-6)


def test_polytropic_exponent_is_the_slope_of_log_p_over_log_v() -> None:
    bench = BenchSim(C, on(polytropic={"exponent": 1.25}), length_m=0.060)
    bench.set_pressure(400.0)
    bench.set_length_rate(50.0)
    bench.advance(0.1)
    slope = math.log((bench.pressure_kpa * 1e3 + ATM) / (400e3 + ATM))
    slope /= math.log(volume_m3(60.0) / volume_m3(65.0))
    assert slope == pytest.approx(1.25, rel=1e-9)


def test_leak_conductance_is_the_loss_of_mass_over_choked_flow() -> None:
    trace = run_commands(
        C, commands([]), 1.0, 100.0, on(leak={"conductance_m3_s_pa": 3e-12}), pressure_kpa=500.0
    )
    absolute = trace.pressure_kpa * 1e3 + ATM
    passed = 1.185 * np.trapezoid(absolute, trace.time_s)
    assert trace.mass_out_kg[-1] / passed == pytest.approx(3e-12, rel=1e-6)
    shrunk = (absolute[0] - absolute[-1]) * volume_m3(60.0) / (287.05 * 293.15)
    assert trace.mass_out_kg[-1] == pytest.approx(shrunk, rel=1e-6)


@pytest.mark.parametrize(("side", "run"), [("inlet", filled), ("outlet", vented)])
def test_flow_area_is_the_ratio_of_the_choked_rates(side: str, run: Any) -> None:
    rates = {}
    for ratio in (1.0, 1.6):
        effects = on(flow_area={"ratio": ratio, "side": side})
        trace = run(effects)
        begin = np.searchsorted(trace.time_s, moved_at(trace) + 1e-9)
        absolute = trace.pressure_kpa[begin : begin + 40] * 1e3 + ATM
        # Choked filling is a straight line of p; choked venting of log p.
        line = absolute if side == "inlet" else np.log(absolute)
        rates[ratio] = (line[-1] - line[0]) / 39
    assert rates[1.6] / rates[1.0] == pytest.approx(1.6, rel=1e-6)
    other = filled if side == "outlet" else vented
    same = other(on(flow_area={"ratio": 1.6, "side": side})).pressure_kpa
    assert np.array_equal(same, other(Effects()).pressure_kpa)


@pytest.mark.parametrize("critical", [0.25, 0.6])
def test_critical_ratio_is_where_filling_ceases_to_be_a_straight_line(critical: float) -> None:
    trace = filled(on(critical_ratio={"critical_ratio": critical}), 0.3)
    rate = np.gradient(trace.pressure_kpa)
    flowing = np.flatnonzero(rate > 0.999 * rate.max())
    ratio = (trace.pressure_kpa[flowing[-1]] * 1e3 + ATM) / (550e3 + ATM)
    assert ratio == pytest.approx(critical, abs=0.04)
    # And exactly: psi well beyond, from the rate there.
    share = (trace.pressure_kpa * 1e3 + ATM) / (550e3 + ATM)
    k = int(np.searchsorted(share, 0.85))
    psi = math.sqrt(1 - ((share[k] - critical) / (1 - critical)) ** 2)
    assert rate[k] / rate.max() == pytest.approx(psi, rel=1e-3)


def test_a_conductance_may_change_less_the_nearer_the_pressures_are() -> None:
    """Choked venting: d ln P / dt goes with the conductance, here 1 + 0.6 (1 - 0.5 P_a / P)."""
    more = {"ratio": 1.6, "side": "outlet"}
    plain = vented(Effects(), 0.05)
    for falls in (0.0, 0.5):
        trace = vented(on(flow_area={**more, "with_ratio": falls}), 0.05)
        for start in (400e3, 300e3):
            slopes = []
            for one in (trace, plain):
                absolute = one.pressure_kpa * 1e3 + ATM
                k = int(np.searchsorted(-absolute, -start))
                slopes.append(float(np.log(absolute[k + 3] / absolute[k - 3])))
            expected = 1.0 + 0.6 * (1.0 - falls * ATM / start)
            assert slopes[0] / slopes[1] == pytest.approx(expected, rel=2e-3)


def test_the_subsonic_index_is_what_the_flow_beyond_the_ratio_falls_with() -> None:
    """ISO 6358-1:2013: psi = (1 - s^2)^m; here m = 0.5 + 0.4 (0.5 - 0.3)."""
    trace = filled(on(critical_ratio={"critical_ratio": 0.3, "index": 0.4}), 0.3)
    source = 550e3 + ATM
    ratio = (trace.pressure_kpa * 1e3 + ATM) / source
    rate = np.gradient(trace.pressure_kpa)
    for share in (0.5, 0.7, 0.85):
        k = int(np.searchsorted(ratio, share))
        psi = (1.0 - ((ratio[k] - 0.3) / 0.7) ** 2) ** 0.58
        assert rate[k] / rate.max() == pytest.approx(psi, rel=2e-3)


@pytest.mark.parametrize("droop", [15.0, 80.0])
def test_droop_is_the_largest_fall_of_the_supply_while_filling(droop: float) -> None:
    effects = on(supply_droop={"droop_kpa": droop, "shown": 1.0})
    trace = filled(effects, 0.3)
    shown = readings(trace, C, effects).supply_kpa
    assert (550.0 - shown).max() == pytest.approx(droop, rel=1e-9)
    # The choked rate tells the same pressure, and the muscle ends at the whole supply.
    plain = filled(Effects(), 0.3)
    rate = np.gradient(trace.pressure_kpa).max() / np.gradient(plain.pressure_kpa).max()
    assert rate == pytest.approx((550e3 + ATM - droop * 1e3) / (550e3 + ATM), rel=1e-3)
    assert trace.pressure_kpa[-1] == pytest.approx(550.0, abs=0.5)


def test_a_drooping_supply_keeps_to_its_line_at_every_flow() -> None:
    effects = on(supply_droop={"droop_kpa": 60.0, "shown": 1.0})
    trace = filled(effects, 0.3)
    inside = trace.pressure_kpa * 1e3 + ATM
    source = readings(trace, C, effects).supply_kpa * 1e3 + ATM
    ratio = np.clip(inside / source, 0.5, 1.0)
    psi = np.sqrt(1.0 - ((ratio - 0.5) / 0.5) ** 2)
    flow = source * psi / (550e3 + ATM - 60e3)
    while_open = trace.inlet_open & (np.arange(len(inside)) > 400)
    error = (550e3 + ATM - source) - 60e3 * flow
    assert np.abs(error[while_open]).max() < 1.0


@pytest.mark.parametrize("edge", ["inlet_on", "inlet_off", "outlet_on", "outlet_off"])
def test_delay_ms_is_how_much_later_the_valve_acts(edge: str) -> None:
    solenoid, direction = edge.split("_")  # type: ignore[assignment]
    rows = pulse_train(solenoid, 0.0, 0.030)  # type: ignore[arg-type]
    acts = []
    for effects in (Effects(), on(valve_delay={"delay_ms": 4.0, "edge": edge})):
        trace = run_commands(C, rows, 0.06, 100_000, effects, pressure_kpa=300.0)
        is_open = trace.inlet_open if solenoid == "inlet" else trace.outlet_open
        k = np.flatnonzero(is_open)[0 if direction == "on" else -1]
        acts.append(trace.time_s[k])
    assert (acts[1] - acts[0]) * 1e3 == pytest.approx(4.0, abs=0.011)


def test_slope_ms_per_kpa_is_the_delay_at_two_pressures() -> None:
    effects = on(valve_delay_pressure={"slope_ms_per_kpa": 0.01, "edge": "outlet_on"})
    delay = {}
    for p in (100.0, 500.0):
        rows = commands([(0.0, "outlet", 1.0)])
        for name, which in (("with", effects), ("without", Effects())):
            trace = run_commands(C, rows, 0.03, 100_000, which, pressure_kpa=p)
            delay[name, p] = trace.time_s[np.flatnonzero(trace.outlet_open)[0]] * 1e3
    extra = [delay["with", p] - delay["without", p] for p in (100.0, 500.0)]
    assert (extra[1] - extra[0]) / 400.0 == pytest.approx(0.01, abs=1e-4)


def test_transport_lets_a_pulse_shorter_than_the_on_delay_through() -> None:
    rows = pulse_train("inlet", 0.0, 0.005)
    ignored = run_commands(C, rows, 0.05, 10_000)
    passed = run_commands(C, rows, 0.05, 10_000, on(transport_delay={}))
    assert not ignored.inlet_open.any()
    # Open from 8.70 + 0.00395 x 550 ms for 5 ms plus the off-delay minus the on-delay.
    first = passed.time_s[np.flatnonzero(passed.inlet_open)[0]] * 1e3
    assert first == pytest.approx(8.70 + 0.00395 * 550, abs=0.11)
    expected = 5.0 + (8.94 - 0.0008 * 550) - (8.70 + 0.00395 * 550)
    assert passed.inlet_open.sum() / 10 == pytest.approx(expected, abs=0.11)


# ---- load ---------------------------------------------------------------------------------------


def hung(effects: Effects, path_kpa: list[float], mass_kg: float = 2.0) -> list[float]:
    """Lengths in mm at which a hung mass comes to rest at each pressure of a path."""
    c = C.with_overrides({"load_damping_n_s_mm": 0.2})
    bench = BenchSim(c, effects, "regulator", "isotonic", 0.060, mass_kg)
    out = []
    for p in path_kpa:
        bench.set_regulator(p)
        for _ in range(15):
            bench.advance(1.0, 1.0)
        out.append(bench.length_mm)
    return out


def test_payload_is_the_mass_that_the_braid_balances() -> None:
    (length,) = hung(on(payload={"mass_kg": 0.3}), [400.0])
    carried = float(braid_n(400.0, length)) / 9.80665
    assert carried - 2.0 == pytest.approx(0.3, abs=1e-3)


def test_link_friction_is_half_the_gap_between_rising_and_falling_loads() -> None:
    effects = on(link_friction={"friction_n": 1.5})
    lengths = hung(effects, [400.0, 500.0, 600.0, 500.0])
    # Shortening the muscle lifts load and friction; lengthening it, friction helps.
    pull = braid_n(500.0, np.array([lengths[1], lengths[3]]))
    assert (pull[0] - pull[1]) / 2 == pytest.approx(1.5, rel=0.02)
    assert pull.mean() == pytest.approx(2.0 * 9.80665, rel=0.01)


def test_a_payload_that_leaves_nothing_to_carry_is_refused() -> None:
    with pytest.raises(PlantError, match=r"payload.*-2 kg beside a load of 1 kg"):
        BenchSim(C, on(payload={"mass_kg": -2.0}), load="isotonic", mass_kg=1.0)
    BenchSim(C, on(payload={"mass_kg": -2.0}), load="isometric", mass_kg=1.0)


# ---- sensors ------------------------------------------------------------------------------------


def moving(effects: Effects) -> tuple[Traces, Any]:
    """Pressure rising behind the regulator, the length swept over its range."""
    rows = commands([(0.0, "inlet", 1.0), (0.02, "regulator_kpa", 500.0)]) + Commands(
        np.array([0.1, 1.9]), ("length_rate_mm_s",) * 2, np.array([10.0, -10.0])
    )
    trace = run_commands(C, rows, 3.0, 1000.0, effects, source="regulator", length_m=0.053)
    return trace, readings(trace, C, effects)


def test_without_effects_every_sensor_shows_the_truth() -> None:
    trace, seen = moving(Effects())
    for name in ("pressure_kpa", "force_n", "length_mm", "supply_kpa"):
        assert np.array_equal(getattr(seen, name), getattr(trace, name))


@pytest.mark.parametrize(
    ("effect", "channel"),
    [
        ({"pressure_zero": {"offset_kpa": 3.0}}, "pressure_kpa"),
        ({"force_zero": {"offset_n": 3.0}}, "force_n"),
    ],
)
def test_zeros_are_read_minus_true(effect: dict[str, Any], channel: str) -> None:
    trace, seen = moving(on(**effect))
    assert getattr(seen, channel) - getattr(trace, channel) == pytest.approx(3.0, rel=1e-12)


@pytest.mark.parametrize(
    ("effect", "channel"),
    [
        ({"pressure_gain": {"percent": 2.0}}, "pressure_kpa"),
        ({"force_gain": {"percent": 2.0}}, "force_n"),
        ({"camera_scale": {"percent": 2.0}}, "length_mm"),
    ],
)
def test_gains_are_read_over_true(effect: dict[str, Any], channel: str) -> None:
    trace, seen = moving(on(**effect))
    true = getattr(trace, channel)
    far = np.abs(true) > 1.0
    assert getattr(seen, channel)[far] / true[far] == pytest.approx(1.02, rel=1e-12)


@pytest.mark.parametrize("centre", [0.0, -4.0])
def test_distortion_mm_is_the_error_at_the_end_of_the_range(centre: float) -> None:
    effects = on(camera_distortion={"distortion_mm": 0.6, "centre_mm": centre})
    trace, seen = moving(effects)
    error = seen.length_mm - trace.length_mm
    assert np.interp(72.5 - 2.0, trace.length_mm[:1800], error[:1800]) < 0.6
    held = run_commands(C, commands([]), 0.01, 100, effects, length_m=0.0725)
    assert readings(held, C, effects).length_mm[0] - 72.5 == pytest.approx(0.6, rel=1e-9)
    still = np.interp(61.75 + centre, trace.length_mm[:1800], error[:1800])
    assert still == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("delay", [25.0, -10.0])
def test_camera_delay_is_frame_time_minus_true(delay: float) -> None:
    trace, seen = moving(on(camera_delay={"delay_ms": delay}))
    later = np.interp(trace.time_s + delay * 1e-3, trace.time_s, seen.length_mm)
    inside = (trace.time_s > 0.3) & (trace.time_s < 2.5)
    assert later[inside] == pytest.approx(trace.length_mm[inside], abs=1e-9)
    assert np.array_equal(seen.pressure_kpa, trace.pressure_kpa)


def test_pressure_lag_is_the_time_constant_of_an_independent_filter() -> None:
    trace, seen = moving(on(pressure_lag={"time_ms": 40.0}))

    def rate(t: float, y: Any) -> Any:
        return (np.interp(t, trace.time_s, trace.pressure_kpa) - y) / 0.040

    oracle = solve_ivp(rate, (0, 3), [0.0], t_eval=trace.time_s, max_step=2e-3, rtol=1e-9).y[0]
    assert np.abs(seen.pressure_kpa - oracle).max() < 2e-3


def test_length_label_is_true_minus_written() -> None:
    trace = run_commands(
        C, commands([]), 0.1, 100, on(length_label={"offset_mm": 0.7}), length_m=0.058
    )
    assert trace.length_mm - 58.0 == pytest.approx(0.7, rel=1e-9)


# ---- all of them --------------------------------------------------------------------------------

NOTHING = {"ratio": 1.0, "exponent": 1.0, "critical_ratio": 0.5}


def table(name: str, value: float | None = None) -> dict[str, Any]:
    """An effect's table at `value`, or at the value that changes nothing."""
    out: dict[str, Any] = {}
    for parameter in CATALOGUE[name].parameters:
        if parameter.choices:
            out[parameter.name] = parameter.choices[0]
        elif parameter.default is None:
            out[parameter.name] = NOTHING.get(parameter.name, 0.0) if value is None else value
    return out


@pytest.mark.parametrize("name", [n for n in CATALOGUE if n != "transport_delay"])
def test_an_effect_of_size_zero_changes_not_a_bit(name: str) -> None:
    rows = pulse_train("inlet", 0.0, 0.013, 0.04, 10) + pulse_train("outlet", 0.02, 0.013, 0.04, 10)
    zero = on(**{name: table(name)})
    for load in ("isometric", "isotonic"):
        plain, same = (
            run_commands(C, rows, 0.5, 500, e, load=load, temperature_c=30, trials=9)  # type: ignore[arg-type]
            for e in (Effects(), zero)
        )
        seen, told = readings(plain, C, Effects()), readings(same, C, zero)
        for channel in ("pressure_kpa", "force_n", "length_mm", "supply_kpa"):
            assert np.array_equal(getattr(seen, channel), getattr(told, channel)), channel


def test_without_effects_the_kernel_takes_the_nominal_numbers_and_skips_every_addition() -> None:
    params = build_params(C)
    assert np.all(params[layout.EFFECTS :] == 0.0)
    assert params[layout.DEAD_VOLUME] == C.dead_volume_m3
    assert params[layout.DELAY_MODE] == 0.0


def around(effects: Effects, source: str = "regulator") -> tuple[float, float]:
    """Work in J that goes into the muscle over one slow closed cycle of length, and its scale."""
    bench = BenchSim(C, effects, source, length_m=0.060)  # type: ignore[arg-type]
    bench.set_regulator(300.0)
    for _ in range(30):
        bench.advance(1.0, 1.0)
    work = total = 0.0
    for cycle in range(2):
        work = total = 0.0
        for rate in (5.0, -5.0, -5.0, 5.0):
            bench.set_length_rate(rate)
            for _ in range(1000):
                before, at = bench.force_n, bench.length_mm
                bench.advance(1e-3, 1e-3)
                step = (before + bench.force_n) / 2 * (bench.length_mm - at) * 1e-3
                work += step
                total += abs(step)
        del cycle
    return work, total


@pytest.mark.parametrize(
    "effect",
    [
        {"bladder_elasticity": {"stiffness_n_mm": 1.0, "hardening_per_mm2": 0.003}},
        {"contraction_limit": {"force_n": 5.0}},
        {"end_cap": {"shortening_mm": 2.0}},
        {"fibre_stretch": {"stretch_percent": 1.0}},
        {"temperature_stiffening": {"percent_per_k": 1.0}},
        {"liner_threshold": {"threshold_kpa": 60.0}},
    ],
)
def test_effects_without_memory_give_back_the_work_they_take(effect: dict[str, Any]) -> None:
    work, total = around(on(**effect))
    assert abs(work) < 1e-6 * total


@pytest.mark.parametrize(
    "effect",
    [
        {"viscosity": {"damping_n_s_mm": 0.2}},
        {"viscosity": {"damping_n_s_mm": 0.2, "exponent": 0.4, "pressure_share": 0.5}},
        {"creep": {"relaxation_percent": 10.0}},
        {"braid_friction": {"friction_n": 2.0}},
    ],
)
def test_effects_that_lose_work_never_give_any(effect: dict[str, Any]) -> None:
    work, total = around(on(**effect))
    assert work > 1e-4 * total
