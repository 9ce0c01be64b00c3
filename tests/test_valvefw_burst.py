"""The burst scheme on both simulated benches: issue figures, robustness, quiet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from plant.constants import PlantConstants, nominal
from rigs.rigfile.config import load_rig
from rigs.virtual.board.tuning import burst_parameters, safety_parameters
from test_valvefw_pwm import Held
from test_valvefw_safety import thesis, virtual
from valvefw.config import defaults

BENCHES = {"virtual": virtual, "thesis": thesis}
LIMIT = {"virtual": 0.5, "thesis": 3.0}  # % of supply
LARGE = 0.25  # of supply


@dataclass(frozen=True)
class Step:
    """One step, in % of supply."""

    size: float
    error: float
    ripple: float
    overshoot: float
    settled_s: float


def run(
    constants: PlantConstants,
    shares: list[float],
    seed: int = 1,
    parameters: dict[str, int] | None = None,
    scheme: str = "burst",
    length_mm: float = 60.0,
) -> list[Step]:
    """Steps between set-points given as shares of supply, 2 s each, beginning vented."""
    bench = Held(constants, length_mm, seed)
    for key, value in (parameters or burst_parameters(constants)).items():
        assert bench.ask(f"set {key} {value}").startswith("ok"), key
    bench.arm(scheme)
    supply = constants.supply_pa * 1e-3
    out = []
    for share in shares:
        before = bench.board.pressure_kpa
        goal = share * supply
        t, p = bench.step(goal)
        tail = p[t > 1.5]
        past = (p - goal).max() if goal > before else (goal - p).max()
        away = t[np.abs(p - goal) > 0.03 * supply]
        out.append(
            Step(
                size=(goal - before) / supply * 100,
                error=abs(float(tail.mean()) - goal) / supply * 100,
                ripple=float(np.ptp(tail)) / supply * 100,
                overshoot=float(past) / supply * 100,
                settled_s=float(away[-1]) if len(away) else 0.0,
            )
        )
    assert bench.cause() == ""
    return out


def large_steps(rng: np.random.Generator, n: int) -> list[float]:
    """Set-points between 25 and 85 %, each at least 25 % from the one before."""
    shares = [float(rng.uniform(0.25, 0.85))]
    while len(shares) < n:
        share = float(rng.uniform(0.25, 0.85))
        if abs(share - shares[-1]) >= LARGE:
            shares.append(share)
    return shares


def check_figures(name: str, seeds: range, n: int) -> None:
    constants = BENCHES[name]()
    for seed in seeds:
        rng = np.random.default_rng([4, seed])
        for step in run(constants, large_steps(rng, n), seed):
            assert step.error < LIMIT[name], step
            assert step.overshoot < 5.0, step
            assert step.ripple < 0.05, step  # no limit cycle: nothing moves any more


@pytest.mark.parametrize("name", BENCHES)
def test_large_steps_meet_the_figures(name: str) -> None:
    check_figures(name, range(3), 8)


@pytest.mark.parametrize("name", BENCHES)
@pytest.mark.parametrize("share", [0.25, 0.4, 0.55, 0.7, 0.85])
def test_from_vented_to_every_level(name: str, share: float) -> None:
    (step,) = run(BENCHES[name](), [share], seed=7)
    assert step.error < LIMIT[name]
    assert step.overshoot < 5.0
    assert step.ripple < 0.05


@pytest.mark.campaign
@pytest.mark.parametrize("name", BENCHES)
def test_large_steps_meet_the_figures_over_many_draws(name: str) -> None:
    check_figures(name, range(100, 140), 25)


@pytest.mark.parametrize("name", BENCHES)
def test_small_steps_end_near_too_by_overlapped_fill_and_vent(name: str) -> None:
    """Not asked for, reported: far below one shortest fill (a fifth of supply on the thesis's)."""
    rng = np.random.default_rng(3)
    shares = [0.5]
    for _ in range(15):
        shares.append(float(np.clip(shares[-1] + rng.uniform(-0.12, 0.12), 0.25, 0.85)))
    steps = run(BENCHES[name](), shares)[1:]
    assert max(s.error for s in steps) < LIMIT[name]
    assert max(s.ripple for s in steps) < 0.05


@pytest.mark.parametrize(
    "wrong",
    [
        {"inlet_conductance_m3_s_pa": 1.25e-9 * 1.1},
        {"outlet_conductance_m3_s_pa": 1.25e-9 * 0.9},
        {"supply_kpa": 535.0},
        {"inlet_off_ms": 9.2},
        {"inlet_on_ms": 8.5, "outlet_on_ms": 9.0},
        {"dead_volume_ml": 0.8},
    ],
    ids=lambda w: next(iter(w)),
)
def test_a_bench_that_is_not_quite_the_model_is_still_met(wrong: dict[str, float]) -> None:
    """Parameters of the nominal bench, on another one: no limit cycle and below 3 %."""
    parameters = burst_parameters(thesis())
    other = thesis().with_overrides(wrong)
    for step in run(other, [0.3, 0.6, 0.85, 0.5, 0.8, 0.25], parameters=parameters):
        assert step.error < 3.0, step
        assert step.ripple < 0.05, step


@pytest.mark.parametrize("length_mm", [52.0, 67.0])
def test_another_length_is_another_volume(length_mm: float) -> None:
    for step in run(thesis(), [0.3, 0.6, 0.85, 0.5], length_mm=length_mm):
        assert step.error < 3.0, step
        assert step.ripple < 0.05, step


@pytest.mark.parametrize("rig", ["virtual", "virtual-thesis"])
def test_the_shipped_rigs_carry_the_parameters_of_their_valves(rig: str) -> None:
    config = load_rig(rig)
    assert config.virtual is not None
    c = nominal().with_overrides(config.virtual.plant)
    told = {**defaults(), **config.valve.parameters}
    for key, value in {**burst_parameters(c), **safety_parameters(c)}.items():
        assert told[key] == pytest.approx(value, rel=0.005), key


def test_the_valve_stand_knows_how_slowly_its_vessel_changes() -> None:
    """With a muscle's slew a wire that broke below 100 kPa was told after 457 ms, by another."""
    config = load_rig("virtual-valve-stand")
    assert config.virtual is not None
    c = nominal().with_overrides(config.virtual.plant)
    assert config.valve.parameters["slew"] == safety_parameters(c)["slew"]


def test_set_point_0_vents_and_the_next_starts_from_there() -> None:
    steps = run(virtual(), [0.5, 0.0, 0.3])
    assert steps[1].error < 0.2
    assert steps[2].error < 0.5
