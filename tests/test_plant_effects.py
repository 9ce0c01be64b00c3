"""Effects: headline parameters mean what the catalogue says, and the catalogue is whole."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plant.constants import nominal
from plant.effects.catalogue import CATALOGUE, FAMILIES
from plant.effects.effects import Effects
from plant.errors import PlantError
from plant.physics import layout, muscle
from plant.physics.friction import slip_history
from plant.simulator.bench import BenchSim

C = nominal()
RISE = np.arange(0.0, 601.0, 20.0)


def effects(**tables: dict[str, float]) -> Effects:
    return Effects.from_config(tables)


def pressure_cycle(bench: BenchSim, top_kpa: float = 600.0) -> dict[str, np.ndarray]:
    """Forces on the way up and down at every 20 kPa, length held, through the valve-less gas."""
    rise = np.arange(0.0, top_kpa + 1, 20.0)
    force: dict[str, list[float]] = {"up": [], "down": []}
    for direction, path in (("up", rise), ("down", rise[::-1])):
        for kpa in path:
            bench.set_pressure(float(kpa))
            force[direction].append(bench.force_n)
    return {"up": np.array(force["up"]), "down": np.array(force["down"])[::-1]}


def regulated_cycle(bench: BenchSim, top_kpa: float) -> dict[str, float]:
    """Forces at 300 kPa on the way up and down, with the regulator and in real time."""
    force: dict[str, float] = {}
    last = 0.0
    for direction, target in (("up", top_kpa), ("down", 0.0)):
        bench.set_regulator(target)
        for _ in range(8000):
            bench.advance(1e-3, 1e-3)
            now = bench.pressure_kpa
            if (last - 300.0) * (now - 300.0) <= 0.0 and direction not in force:
                # Force is proportional to pressure nearby: refer it to 300 kPa exactly.
                force[direction] = bench.force_n * 300.0 / now
            last = now
    return force


@pytest.mark.parametrize("friction", [0.5, 2.0, 8.0])
@pytest.mark.parametrize("length_m", [0.053, 0.060, 0.067])
def test_friction_n_is_half_the_loop_height_at_300_kpa(friction: float, length_m: float) -> None:
    bench = BenchSim(C, effects(braid_friction={"friction_n": friction}), length_m=length_m)
    for _ in range(2):
        loop = pressure_cycle(bench)
    height = (loop["down"] - loop["up"])[RISE == 300.0]
    assert height / 2 == pytest.approx(friction, rel=1e-9)


@pytest.mark.parametrize("top_kpa", [400.0, 600.0])
def test_friction_n_is_the_same_half_height_when_cycled_with_the_regulator(top_kpa: float) -> None:
    bench = BenchSim(C, effects(braid_friction={"friction_n": 3.0}), source="regulator")
    bench.advance(0.02, 0.02)
    force = regulated_cycle(bench, top_kpa)
    assert (force["down"] - force["up"]) / 2 == pytest.approx(3.0, rel=1e-6)


def test_friction_shows_the_same_half_height_in_a_length_cycle_at_300_kpa() -> None:
    bench = BenchSim(C, effects(braid_friction={"friction_n": 3.0}), source="regulator")
    bench.set_regulator(300.0)
    for _ in range(30):
        bench.advance(1.0, 1.0)
    force = {}
    for direction, rate in (("long", 5.0), ("short", -5.0), ("long", 5.0)):
        bench.set_length_rate(rate)
        for _ in range(2000):
            bench.advance(1e-3, 1e-3)
            if abs(bench.length_mm - 65.0) < 0.0026:
                force[direction] = bench.force_n
    assert (force["long"] - force["short"]) / 2 == pytest.approx(3.0, rel=0.02)


def test_friction_leaves_the_mean_of_up_and_down_where_it_was() -> None:
    bench = BenchSim(C, effects(braid_friction={"friction_n": 4.0}))
    for _ in range(2):
        loop = pressure_cycle(bench)
    middle = (RISE >= 80) & (RISE <= 520)
    nominal_force = muscle.force(RISE * 1e3, 0.060, C)
    assert ((loop["up"] + loop["down"]) / 2)[middle] == pytest.approx(nominal_force[middle])
    assert loop["up"][0] == loop["down"][0] == 0.0


def test_friction_is_independent_of_rate() -> None:
    fast, slow = (
        BenchSim(C, effects(braid_friction={"friction_n": 4.0}), source="valve") for _ in "ab"
    )
    for bench, steps in ((fast, 1), (slow, 50)):
        bench.set_pressure(300.0)
        for _ in range(steps):
            bench.set_length_rate(1.0)
            bench.advance(1.0 / steps)
        bench.set_length_rate(-1.0)
        bench.advance(0.1)
    assert fast.force_n == pytest.approx(slow.force_n, rel=1e-12)


@given(turns=st.lists(st.floats(0, 600e3), min_size=2, max_size=12))
def test_friction_remembers_turning_points_only(turns: list[float]) -> None:
    dense = np.concatenate([np.linspace(a, b, 17) for a, b in pairwise(turns)])
    coarse = slip_history(turns, [0.06] * len(turns), 40e3, 0.4e-3)
    fine = slip_history(dense, [0.06] * len(dense), 40e3, 0.4e-3)
    assert fine[-1] == pytest.approx(coarse[-1], abs=1e-9)
    assert np.abs(fine).max() <= 1.0


def test_a_minor_loop_closes_and_leaves_the_major_loop_alone() -> None:
    path = [0.0, 600e3, 300e3, 330e3, 300e3, 200e3]
    without = [0.0, 600e3, 300e3, 200e3]
    slips = slip_history(path, [0.06] * 6, 40e3, 0.4e-3)
    assert slips[4] == pytest.approx(slips[2])
    assert slips[3] > slips[2]
    assert slips[-1] == pytest.approx(slip_history(without, [0.06] * 4, 40e3, 0.4e-3)[-1])


@pytest.mark.parametrize("threshold", [20.0, 100.0, 180.0])
def test_threshold_kpa_is_the_pressure_lost_at_high_pressure(threshold: float) -> None:
    bench = BenchSim(C, effects(liner_threshold={"threshold_kpa": threshold}), length_m=0.062)
    bench.set_pressure(700.0)
    per_kpa = float(muscle.dforce_dp(0.0, 0.062, C)) * 1e3
    lost = 700.0 - bench.force_n / per_kpa
    assert lost == pytest.approx(threshold, abs=0.01)


def test_a_liner_lets_little_force_through_below_its_threshold() -> None:
    bench = BenchSim(C, effects(liner_threshold={"threshold_kpa": 100.0}), length_m=0.062)
    bench.set_pressure(50.0)
    assert 0.0 <= bench.force_n < 0.07 * float(muscle.force(50e3, 0.062, C))


@given(p=st.floats(0, 700e3), lost=st.floats(0, 500e3), width=st.floats(1e3, 200e3))
def test_liner_pressure_is_between_nothing_and_all_and_grows(
    p: float, lost: float, width: float
) -> None:
    here = float(muscle.effective_pressure(p, lost, width))
    assert -1e-6 <= here <= p + 1e-6
    assert p - here <= lost + 1e-6
    assert float(muscle.effective_pressure(p + 100.0, lost, width)) >= here - 1e-6


def test_a_liner_of_nothing_is_the_nominal_muscle() -> None:
    p = np.linspace(0, 700e3, 50)
    assert muscle.effective_pressure(p, 0.0, 25e3) == pytest.approx(p)
    bench = BenchSim(C, effects(liner_threshold={"threshold_kpa": 0.0}))
    bench.set_pressure(432.1)
    assert bench.force_n == pytest.approx(float(muscle.force(432.1e3, 0.060, C)), rel=1e-12)


def test_compiled_and_plain_formulas_are_the_same_with_both_effects_on() -> None:
    both = effects(
        liner_threshold={"threshold_kpa": 90.0, "width_kpa": 20.0},
        braid_friction={"friction_n": 2.5},
    )
    bench = BenchSim(C, both, length_m=0.064)
    path = [0.0, 500.0, 220.0, 260.0]
    for kpa in path:
        bench.set_pressure(kpa)
    slip = slip_history(np.array(path) * 1e3, [0.064] * 4, 40e3, 0.4e-3)[-1]
    push = muscle.effective_pressure(260e3, 90e3, 20e3)
    expected = float(muscle.force(push, 0.064, C)) - 2.5 * 260 / 300 * slip
    assert bench.force_n == pytest.approx(expected, rel=1e-12)


def test_a_hung_mass_sticks_within_the_friction_and_slips_beyond_it() -> None:
    bench = BenchSim(
        C, effects(braid_friction={"friction_n": 5.0}), "regulator", "isotonic", 0.060, 2.0
    )
    lengths = []
    for target in (400.0, 600.0, 400.0, 300.0, 400.0, 600.0, 400.0):
        bench.set_regulator(target)
        for _ in range(15):
            bench.advance(1.0, 1.0)
        lengths.append(bench.length_mm)
    # After falling from 600 the muscle is shorter at 400 kPa than after rising from 300.
    assert lengths[2] == pytest.approx(lengths[6], abs=1e-3)
    assert lengths[4] - lengths[2] > 1.0


def test_the_catalogue_has_thirty_effects_in_fourteen_families() -> None:
    # With the verdicts none and unknown, sixteen answers to "which family".
    assert len(CATALOGUE) == 30
    assert len(FAMILIES) == 14
    assert [entry.id for entry in CATALOGUE.values()] == list(CATALOGUE)
    assert CATALOGUE["transport_delay"].headline is None
    assert CATALOGUE["liner_threshold"].headline == "threshold_kpa"


def test_being_mistaken_for_each_other_is_mutual_and_every_entry_is_explained() -> None:
    for name, entry in CATALOGUE.items():
        assert entry.untouched
        assert entry.told_apart_by
        assert entry.summary
        assert entry.equation
        assert entry.source
        for other in entry.mistaken_for:
            assert name in CATALOGUE[other].mistaken_for, (name, other)
            assert other != name


@pytest.mark.parametrize(
    ("config", "told"),
    [
        ({"liner_treshold": {"threshold_kpa": 1}}, "did you mean liner_threshold"),
        ({"creep": {"relaxation": 5}}, "known: relaxation_percent, fast_s, slow_s"),
        ({"flow_area": {"ratio": 2.0, "side": "left"}}, "allowed inlet, outlet"),
        ({"liner_threshold": {"threshold": 1}}, "known: threshold_kpa, width_kpa"),
        ({"liner_threshold": {}}, "threshold_kpa is missing"),
        ({"liner_threshold": {"threshold_kpa": "100"}}, "is a str"),
        ({"liner_threshold": {"threshold_kpa": 900}}, "allowed 0 to 500"),
        ({"liner_threshold": {"threshold_kpa": float("nan")}}, "allowed 0 to 500"),
        ({"braid_friction": 3.0}, "expected a table"),
        ({"braid_friction": {"friction_n": True}}, "is a bool"),
    ],
)
def test_bad_effects_are_refused_with_key_and_remedy(config: dict[str, object], told: str) -> None:
    with pytest.raises(PlantError, match=told) as caught:
        Effects.from_config(config, origin="rig virtual.toml [effects]")
    assert "rig virtual.toml [effects]" in str(caught.value)


def test_effects_go_round_through_their_config() -> None:
    some = effects(braid_friction={"friction_n": 2.0})
    assert Effects.from_config(some.values) == some
    assert some.values["braid_friction"]["travel_kpa"] == 40.0
    assert not Effects.from_config(None)
    assert "braid_friction" in some


def test_state_slots_do_not_overlap() -> None:
    assert layout.SLIP + layout.SLIP_ELEMENTS <= layout.QUEUE_HEAD
    assert layout.MEMORY + layout.MEMORY_SLOTS <= layout.QUEUE
