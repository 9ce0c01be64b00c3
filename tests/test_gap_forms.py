"""Forms that an effect may have on a bench: what each does to a prediction."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from gap.model import force as laws
from gap.model import pressure as chamber
from gap.model.force import Active, Context
from plant.constants import nominal
from plant.effects import pressure_stage as stage
from plant.effects.catalogue import CATALOGUE
from plant.physics import layout, muscle
from test_gap_shapes import still

C = nominal()
HELD_M = 0.06
SUPPLY_PA = 5e5


def course(
    name: str,
    option: str,
    amount: float,
    shape: Mapping[str, float],
    edges: list[tuple[float, int]],
    time: np.ndarray | None = None,
    beside: Active = (),
) -> np.ndarray:
    """Predicted reading in Pa, the inlet switched at `edges`; by default every ms of 0.4 s."""
    q = chamber.parameters(C, [(name, option, amount, shape), *beside], C.supply_pa)
    q[stage.FOLLOW] = 0.0
    for k in range(4):
        q[layout.DELAY + k] = q[layout.DELAY_SLOPE + k] = 0.0
    time = np.arange(0.0, 0.4, 1e-3) if time is None else time
    n = len(time)
    out = np.empty(n)
    chamber.predict(
        q, np.array([0, n]), time, np.zeros(n), np.full(n, HELD_M), np.full(n, SUPPLY_PA),
        np.array([0, len(edges)]), np.array([at for at, _ in edges]),
        np.array([float(to) for _, to in edges]), np.zeros(len(edges), dtype=np.int64), out,
        np.zeros(1),
    )  # fmt: skip
    return out


PULSE = [(0.06, 1), (0.09, 0)]
TWICE = [(0.06, 1), (0.08, 0), (0.14, 1), (0.16, 0)]


def test_a_tube_before_the_sensor_is_late_once_more_and_as_late_in_all() -> None:
    """Two lags in a row: the delay of their sum is the sum, the start is flatter."""
    true = course("pressure_lag", "", 0.0, {}, PULSE)
    one = course("pressure_lag", "", 8.0, {}, PULSE)
    two = course("pressure_lag", "", 8.0, {"before": 0.5}, PULSE)
    final = true[-1]
    late = [float(np.sum(true - shown) * 1e-3 / final) for shown in (one, two)]
    assert late == pytest.approx([8e-3, 8e-3], rel=0.03)
    early = slice(62, 64)
    assert np.all(two[early] < one[early])


@pytest.mark.parametrize("damping", [0.2, 0.7, 0.999])
def test_a_gauge_that_swings_is_that_of_scipy_and_as_late_as_one_that_does_not(
    damping: float,
) -> None:
    """Second order (Bergh and Tijdeman 1965); a closed valve leaves it one true pressure."""
    true = course("pressure_lag", "", 0.0, {}, PULSE)
    shown = course("pressure_lag", "", 8.0, {"damping": damping}, PULSE)
    final = true[-1]
    late = float(np.sum(true - shown) * 1e-3 / final)
    assert late == pytest.approx(8e-3, rel=0.03)
    w = 2.0 * damping / 8e-3

    def swing(t: float, z: np.ndarray) -> list[float]:
        seen = float(np.interp(t, time, true))
        return [z[1], w * w * (seen - z[0]) - 2.0 * damping * w * z[1]]

    time = np.arange(0.0, 0.4, 1e-3)
    exact = solve_ivp(swing, (0.0, 0.399), [true[0], 0.0], t_eval=time, rtol=1e-8, max_step=5e-4)
    assert shown == pytest.approx(exact.y[0], abs=0.004 * final)
    if damping < 0.5:
        assert shown.max() > 1.05 * final


@pytest.mark.parametrize(
    ("name", "shape"), [("supply_droop", {"power": 2.0}), ("pressure_lag", {"damping": 0.4})]
)
def test_what_is_found_beside_a_stated_form_adds_to_it(
    name: str, shape: Mapping[str, float]
) -> None:
    """A plain one beside it took the form away: the last one counted alone."""

    def shown(active: Active) -> np.ndarray:
        return chamber.parameters(C, active, C.supply_pa)

    whole = shown([(name, "", 50.0, shape)])
    for parts in ([(20.0, shape), (30.0, {})], [(30.0, {}), (20.0, shape)]):
        assert shown([(name, "", a, s) for a, s in parts]) == pytest.approx(whole)


def test_a_vessel_behind_an_orifice_takes_as_much_gas_as_one_beside_the_line() -> None:
    """In the end; and it is full at a moment, where one behind a thin tube never quite is."""
    pulse = [(0.06, 1), (0.07, 0)]  # choked throughout: the same gas comes in
    plain = course("dead_volume", "", 3.0, {}, pulse)
    orifice, tube = (
        course("dead_volume", "", 3.0, {"line_s": 0.02, **more}, pulse)
        for more in ({"orifice": 1.0}, {})
    )
    assert orifice[-1] == pytest.approx(plain[-1], rel=2e-3)
    assert orifice[80] > 1.05 * plain[80]
    left = [np.abs(shown[150] - plain[-1]) for shown in (orifice, tube)]
    assert left[0] < 0.2 * left[1]


@pytest.mark.parametrize("line_s", [0.005, 0.06])
@pytest.mark.parametrize("orifice", [0.0, 1.0])
def test_a_vessel_that_is_full_follows_a_leak_in_steps_of_any_length(
    line_s: float, orifice: float
) -> None:
    """A long step is as good as many short ones once both pressures are one."""
    fine = np.arange(0.0, 10.0, 2e-4)
    coarse = np.r_[fine[fine < 0.6], np.arange(0.6, 10.0, 0.02)]
    shape = {"line_s": line_s, "orifice": orifice}
    leak: Active = [("leak", "", 2e-13, {})]
    slow, quick = (
        course("dead_volume", "", 3.0, shape, PULSE, time, leak) for time in (fine, coarse)
    )
    expected = np.interp(coarse, fine, slow)
    assert expected[-1] < 0.98 * expected[3000]
    assert quick == pytest.approx(expected, abs=3.0)  # Pa; the least floor is 20


def test_a_vessel_behind_a_one_way_flow_control_fills_at_once_and_keeps_its_gas() -> None:
    """Filled, the vessel takes its share; then a leak empties the chamber as if it stood alone."""
    pulse = [(0.06, 1), (0.08, 0)]
    leak: Active = [("leak", "", 2e-12, {})]
    both, held, alone = (
        course("dead_volume", "", volume_ml, shape, pulse, beside=leak)
        for volume_ml, shape in (
            (3.0, {"line_s": 1e-3}), (3.0, {"line_s": 1e-3, "empties": 1e6}), (0.0, {}),
        )
    )  # fmt: skip
    assert held[84] == pytest.approx(both[84], rel=0.01)

    def share_lost(p: np.ndarray) -> float:
        gas = p + C.atmosphere_pa  # choked: what is lost is a share of it
        return float(np.log(gas[90] / gas[390]))

    assert share_lost(held) == pytest.approx(share_lost(alone), rel=0.02)
    assert share_lost(both) < 0.8 * share_lost(alone)
    same = course("dead_volume", "", 3.0, {"line_s": 1e-3, "empties": 1.0}, pulse, beside=leak)
    assert same == pytest.approx(both, abs=1e-6)


def test_a_slow_regulator_gives_less_to_the_second_of_two_pulses() -> None:
    def second(shape: Mapping[str, float]) -> float:
        p = course("supply_droop", "", 80.0, shape, TWICE)
        return float(p[-1] - p[120])

    quick = second({"tau_s": 0.01})
    slow = second({"tau_s": 0.01, "back_s": 0.3})
    assert slow < 0.97 * quick


def test_an_area_that_changes_with_the_drop_is_the_stated_one_where_nothing_drops() -> None:
    plain = course("flow_area", "inlet", 0.0, {}, PULSE)
    wide = course("flow_area", "inlet", 0.2, {"drop": 1.0}, PULSE)
    begin = slice(62, 66)  # the whole supply drops over the seat
    assert np.mean(wide[begin] / plain[begin]) == pytest.approx(1.2, abs=0.02)
    full = [(0.02, 1)]
    assert course("flow_area", "inlet", 0.2, {"drop": 1.0}, full)[-1] == pytest.approx(
        course("flow_area", "inlet", 0.0, {}, full)[-1], rel=2e-3
    )


@pytest.mark.parametrize("soft_kpa", [30.0, 120.0, 1e4])
def test_a_hose_whose_wall_stiffens_holds_the_gas_that_came_in(soft_kpa: float) -> None:
    """A choked pulse brings as much gas with it as without; the rest is its isothermal law."""
    pulse = [(0.06, 1), (0.068, 0)]
    plain = course("dead_volume", "", 0.0, {}, pulse)[-1]
    wide = course("dead_volume", "", 2.0, {"soft_kpa": soft_kpa}, pulse)[-1]
    volume = muscle.braid_volume(HELD_M, C.braid_length_m, C.turns) + C.dead_volume_m3
    gained = 2e-6 * np.expm1(-wide / (soft_kpa * 1e3)) / np.expm1(-300.0 / soft_kpa)
    gas = (plain + C.atmosphere_pa) * volume
    assert wide < 0.9 * plain
    assert (wide + C.atmosphere_pa) * (volume + gained) == pytest.approx(gas, rel=2e-3)


@pytest.mark.parametrize(("late", "rigid"), [(0.4, 0.2), (3.0, 0.01), (0.01, 5.0)])
def test_a_wall_that_gives_way_ever_less_holds_the_gas_that_came_in(
    late: float, rigid: float
) -> None:
    """Two exponential laws and a part that does not widen; 2 ml at 300 kPa, whatever the parts."""
    pulse = [(0.06, 1), (0.068, 0)]
    shape = {"soft_kpa": 85.0, "late_kpa": 330.0, "late": late, "rigid": rigid}
    plain = course("dead_volume", "", 0.0, {}, pulse)[-1]
    wide = course("dead_volume", "", 2.0, shape, pulse)[-1]
    volume = muscle.braid_volume(HELD_M, C.braid_length_m, C.turns) + C.dead_volume_m3

    def law(pa: float, kpa: float) -> float:
        return float(np.expm1(-pa / (kpa * 1e3)) / np.expm1(-300.0 / kpa))

    gained = 2e-6 * (law(wide, 85.0) + late * law(wide, 330.0) + rigid) / (1.0 + late + rigid)
    gas = (plain + C.atmosphere_pa) * volume + C.atmosphere_pa * 2e-6 * rigid / (1 + late + rigid)
    assert (wide + C.atmosphere_pa) * (volume + gained) == pytest.approx(gas, rel=2e-3)


@pytest.mark.parametrize("yields_s", [0.02, 0.23, 3.0])
def test_a_hose_whose_wall_yields_by_and_by_is_that_of_scipy(yields_s: float) -> None:
    """A Voigt wall: after a choked pulse all gas stays, and the volume comes after the pressure."""
    plain = course("dead_volume", "", 0.0, {}, [(0.06, 1), (0.068, 0)])
    shown = course("dead_volume", "", 2.0, {"yields_s": yields_s}, [(0.06, 1), (0.068, 0)])
    volume = muscle.braid_volume(HELD_M, C.braid_length_m, C.turns) + C.dead_volume_m3
    per_pa = 2e-6 / 300e3
    time = np.arange(0.0, 0.4, 1e-3)
    gas = (plain + C.atmosphere_pa) * volume  # constant but in the pulse, where it is that of both

    def follows(t: float, y: np.ndarray) -> list[float]:
        inside = np.interp(t, time, gas) / (volume + per_pa * y[0]) - C.atmosphere_pa
        return [(inside - y[0]) / yields_s]

    after = solve_ivp(follows, (0.0, 0.399), [0.0], t_eval=time, rtol=1e-8, max_step=5e-4).y[0]
    expected = gas / (volume + per_pa * after) - C.atmosphere_pa
    # The gas of the pulse is taken as straight between milliseconds.
    assert shown == pytest.approx(expected, abs=0.003 * plain[-1])
    if yields_s == 0.23:
        assert shown[75] > 1.05 * shown[-1]


def test_an_exponent_that_fades_begins_as_it_is_stated_and_ends_half_as_far_above_one() -> None:
    def shown(amount: float, shape: Mapping[str, float]) -> np.ndarray:
        return course("polytropic", "", amount, shape, TWICE)

    whole, half = shown(0.3, {}), shown(0.15, {})
    assert shown(0.3, {"fades_s": 1e6}) == pytest.approx(whole, abs=1.0)
    assert shown(0.3, {"fades_s": 1e-6}) == pytest.approx(half, rel=2e-3)
    between = shown(0.3, {"fades_s": 0.01})
    assert np.all(between[165:] < whole[165:])
    assert np.all(between[165:] > half[165:])
    # At each opening it is as it was at first. Were it not, the second pulse would be that of half
    # the exponent: of the way from there to the whole one it would go nothing.
    steps = [(p[120] - p[55], p[-1] - p[120]) for p in (half, between, whole)]
    shares = [(b - a) / (c - a) for a, b, c in zip(*steps, strict=True)]
    assert shares[1] > 0.5 * shares[0] > 0.1


def pull(effects: Active, **fields: np.ndarray) -> np.ndarray:
    """Change of the muscle's force by `effects`, N."""
    points = still(**fields)
    context = Context(C, np.zeros(1))
    return laws.muscle_force(points, effects, context) - laws.muscle_force(points, [], context)


def test_a_limit_with_a_knee_takes_the_stated_force_near_the_end_and_none_beyond_the_knee() -> None:
    ends = C.length_min_m * 1e3 + np.array([1.0, 3.5, 6.0, 9.0])
    lost = pull([("contraction_limit", "", 4.0, {"knee_mm": 5.0})], length_mm=ends)
    assert lost == pytest.approx([-4.0, -1.0, 0.0, 0.0], abs=1e-9)


def test_a_load_held_before_the_record_began_has_crept_already() -> None:
    held = np.full(50, 60.0)
    fresh = pull([("creep", "", 6.0, {"tau_s": 5.0})], length_mm=held)
    settled = pull([("creep", "", 6.0, {"tau_s": 5.0, "settled": 1.0})], length_mm=held)
    force = laws.muscle_force(still(held), [], Context(C, np.zeros(1)))
    assert fresh == pytest.approx(np.zeros(50))
    assert settled / force == pytest.approx(np.full(50, -0.06), rel=1e-4)


def test_a_settled_point_has_crept_since_the_point_before_it_was_read() -> None:
    """The Kelvin element followed in small steps; the order of a table's rows says nothing."""
    height = 1e5 * np.array([2.0, 4.0, 5.0, 3.0])
    taken = np.array([2.0, 9.0, 40.0, 43.0])
    tau, loss = 8.0, 0.05 / -np.expm1(-60.0 / 8.0)

    def crept(rows: np.ndarray, when: np.ndarray) -> np.ndarray:
        points = still(
            np.full(4, 60.0), pressure=height[rows], taken=when[rows], settled=np.full(4, True)
        )
        effects = [("creep", "", 5.0, {"tau_s": tau})]
        context = Context(C, np.zeros(1))
        return laws.muscle_force(points, effects, context) - laws.muscle_force(points, [], context)

    every = np.arange(4)
    force = laws.muscle_force(still(np.full(4, 60.0), pressure=height), [], Context(C, np.zeros(1)))
    expected, element, now = [], 0.0, 0.0
    for pull, at in zip(force, taken, strict=True):
        while now < at - 1e-9:
            element += (pull - element) * 1e-3 / tau
            now += 1e-3
        expected.append(-loss * element)
    assert crept(every, taken) == pytest.approx(np.array(expected), rel=1e-3)
    mixed = np.array([2, 0, 3, 1])
    assert crept(mixed, taken) == pytest.approx(np.array(expected)[mixed], rel=1e-3)
    assert crept(every, np.full(4, np.nan)) == pytest.approx(np.zeros(4))


def test_a_load_that_still_creeps_where_it_is_called_settled_rubs_less_after_a_short_step() -> None:
    """Coming down: the friction is whole at the first point, and grows with the last step."""
    length = 60.0 + np.cumsum([0.0, 0.2, 1.5, 6.0])
    points = still(length, direction=np.full(4, -1.0))
    form = {"knee_mm_s": 1.0, "step_mm": 1.5}
    plain = laws.load_pull(points, [], Context(C, np.zeros(1)))
    rubbed = laws.load_pull(points, [("link_friction", "", 2.0, form)], Context(C, np.zeros(1)))
    whole = 1.0 - np.exp(-np.array([np.inf, 0.2, 1.5, 6.0]) / 1.5)
    assert rubbed - plain == pytest.approx(-2.0 * whole, abs=1e-9)


def test_a_load_that_sticks_after_it_has_turned_rubs_by_what_the_muscle_no_longer_pulls() -> None:
    """A slide of 20 N held 1.2 kg where they were from 580 to 180 kPa: named another muscle."""
    height = 1e5 * np.array([1.0, 2.0, 3.0, 3.0, 2.0, 1.0])
    length = np.array([70.0, 66.0, 60.0, 60.0, 60.03, 64.0])
    come = np.array([1.0, 1.0, 1.0, -1.0, -1.0, -1.0])
    shown = rubbed(length, height, come)
    assert shown[[1, 2, 3, 5]] == pytest.approx([2.0, 2.0, 2.0, -2.0], abs=1e-6)
    assert shown[0] == 0.0  # nobody knows how it came there
    assert -2.0 < shown[4] < 2.0
    mixed = np.array([4, 0, 5, 2, 3, 1])  # the order of a table's rows says nothing
    assert rubbed(length[mixed], height[mixed], come[mixed]) == pytest.approx(shown[mixed])
    assert rubbed(length, height, np.zeros(6)) == pytest.approx(np.zeros(6))


def rubbed(length_mm: np.ndarray, pressure: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """What 2 N of friction add to the pull that settled points ask for, N."""
    points = still(
        length_mm,
        pressure=pressure,
        direction=direction,
        settled=np.ones(len(pressure), dtype=bool),
    )
    context, stuck = Context(C, np.zeros(1)), ("link_friction", "", 2.0, {"travel_mm": 0.2})
    return laws.load_pull(points, [stuck], context) - laws.load_pull(points, [], context)


@given(st.floats(10.0, 1500.0), st.floats(0.0, 700e3))
def test_threads_that_lose_their_crimp_give_way_ever_less(crimp_kpa: float, p: float) -> None:
    """Withheld bench 1088: `end_cap` was taken for it, and then no nominal plant fitted."""
    stretch = CATALOGUE["fibre_stretch"].diagnosis.stretch
    assert stretch is not None
    at = np.array([0.0, p, p + 1e3, 500e3])
    share = stretch(at, np.full(4, 0.06), 2.0, {"crimp_kpa": crimp_kpa}, C)
    assert share[0] == 0.0
    assert share[3] == pytest.approx(0.02)
    assert share[2] >= share[1] >= min(p / 500e3, 1.0) * 0.02 * (1.0 - 1e-9)
