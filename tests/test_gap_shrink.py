"""How far the gap shrinks: held out, run free, beside a learner without names, and put to use."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from blind.noise import draw_noise
from cli.main import app
from daq.store.run import open_run
from gap.check.scoring.closed import silent
from gap.data.from_runs import open_data
from gap.estimation.cross_validation import HeldOut, held_out, left_out
from gap.estimation.fit_problem import FitProblem, FitResult
from gap.estimation.intervals import undamped_step
from gap.validation.free_run import free_running
from gap.validation.improved_plant import improved_plant
from gap.validation.learner import generic, splines
from gap.validation.shrinkage import as_lines, shrinkage
from gap_bench import write_set
from gap_sets import settled_set
from plant.constants import nominal
from rigs.rigfile.plant_file import load_plant

RATIO = 0.6
STIFFNESS = 0.8


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> tuple[FitProblem, FitResult]:
    """A bench with a throttled inlet and a stiff bladder, fitted with both."""
    hidden = {
        "flow_area": {"ratio": RATIO, "side": "inlet"},
        "bladder_elasticity": {"stiffness_n_mm": STIFFNESS},
    }
    problem = FitProblem.of(
        open_data(write_set(tmp_path_factory.mktemp("shrink") / "two", hidden, 5, 2))
    )
    inlet = next(s for s in problem.candidates if s.key == "flow_area:inlet")
    bladders = [s for s in problem.candidates if s.key == "bladder_elasticity"]
    fits = [problem.fit_afresh([inlet, b], [-0.4, 0.8]) for b in bladders]
    return problem, min(fits, key=lambda f: f.cost)


def test_a_leak_leaves_the_constants_their_own_uncertainty(tmp_path: Path) -> None:
    """Its conductance is thirty decades smaller than a length: in one matrix with it, in units
    as they stand, nothing else would count."""
    leak = {"leak": {"conductance_m3_s_pa": 2e-12}}
    problem = FitProblem.of(open_data(write_set(tmp_path, leak, seed=5, replicates=2)))
    candidate = next(s for s in problem.candidates if s.key == "leak")
    fit = undamped_step(problem, problem.fit_afresh([candidate], [2e-12]))
    constants = range(len(problem.names) - problem.unnamed)
    spread = np.sqrt(np.diag(fit.cover))[constants]
    assert np.all(spread > 0.01)
    assert np.all(spread < 1.2)
    left = left_out(problem, fit, problem.units)
    assert np.any(left.change[:, constants] != 0.0)


def test_where_less_than_the_floor_is_left_all_or_a_little_less_may_be_closed() -> None:
    """The floor was stated too high then: an interval above one would hold no plant at all."""
    even = np.ones(8)
    left = 0.8 + 0.02 * np.cos(np.arange(8.0))
    closed = HeldOut(5.0 * even, 5.0 * even, left, even, even).closed()
    assert closed is not None
    ratio, low, high = closed
    assert ratio > 1.04
    assert low < 1.0 < high


def test_the_bench_without_noise_has_its_muscles_mounted_as_before() -> None:
    """Either fit knows the mountings' offsets, so they are none of what is left."""
    noise = draw_noise(np.random.default_rng(1), changed=False)
    assert silent(noise).mounting_mm == noise.mounting_mm
    assert silent(noise).force_zero_n == 0.0


def test_run_free_the_gap_is_larger_and_closes_too(two: tuple[FitProblem, FitResult]) -> None:
    problem, fit = two
    free, fed = free_running(problem, fit), held_out(problem, fit)
    # A throttled inlet adds up over a staircase; measured pressure hides that from the muscle.
    assert free["pressure"].rms("before") > 1.2 * fed["pressure"].rms("before")
    for end in ("pressure", "force"):
        closed = free[end].closed()
        assert closed is not None
        assert closed[0] > 0.9, (end, closed)
        assert free[end].rms("after") < 2.0 * free[end].rms("floor")


def test_a_learner_no_freer_than_the_effects_closes_less_than_they_do(
    two: tuple[FitProblem, FitResult],
) -> None:
    problem, fit = two
    found = shrinkage(problem, fit, named=True)
    force = next(one for one in found["generic"] if one["block"] == "force")
    assert force["closed_named"] > 0.9
    assert force["closed_alike"] < 0.8 * force["closed_named"]
    assert force["closed_large"] > force["closed_alike"]
    assert force["splines"] > 15


def test_what_is_found_carries_over_to_protocols_that_were_left_out(
    two: tuple[FitProblem, FitResult],
) -> None:
    found = shrinkage(*two, named=True)
    told = {(t["name"], t["block"]): t for t in found["transfer"] if t["held_out"] == "protocol"}
    assert {name for name, _ in told} == {"isometric", "step", "hold", "hysteresis", "isotonic"}
    assert told["hysteresis", "force"]["carries"]
    assert told["hysteresis", "force"]["after"] < 0.3 * told["hysteresis", "force"]["recalibrated"]
    amounts = {one["name"]: one for one in found["stability"] if one["kind"] == "amount"}
    assert set(amounts) == {"flow_area:inlet", "bladder_elasticity"}
    assert all(one["variation"] < 0.2 for one in amounts.values())
    assert any("improvement holds" in line or "worse for" in line for line in as_lines(found))


def test_nothing_to_learn_and_nothing_is_learnt(tmp_path: Path) -> None:
    problem = FitProblem.of(open_data(settled_set(tmp_path / "plain", {})))
    learnt = generic(problem, 2)
    part = held_out(problem, problem.base)["force"]
    weight = part.weight.sum()
    for errors in (learnt.alike["force"], learnt.large["force"]):
        assert np.sqrt(errors.sum() / weight) < 1.5 * part.rms("recalibrated")


def test_splines_are_a_partition_of_one() -> None:
    x = np.random.default_rng(1).uniform(0.0, 600.0, 300)
    assert np.allclose(splines(x, 6).sum(axis=1), 1.0)


# ---------------------------------------------------------------------------- put to use


def test_the_improved_plant_holds_constants_and_effects(
    two: tuple[FitProblem, FitResult], tmp_path: Path
) -> None:
    problem, fit = two
    path = tmp_path / "plant.toml"
    path.write_text(improved_plant(problem, fit))
    constants, effects = load_plant(path)
    assert effects.get("flow_area", "ratio") == pytest.approx(RATIO, abs=0.08)
    assert effects.get("bladder_elasticity", "stiffness_n_mm") == pytest.approx(STIFFNESS, rel=0.15)
    moved = problem.constants(undamped_step(problem, fit).shift)
    assert constants.braid_length_m == pytest.approx(moved.braid_length_m, rel=1e-6)


def test_constants_that_the_bench_states_stay_in_the_improved_plant(tmp_path: Path) -> None:
    folder = settled_set(tmp_path / "other", {})
    (folder / "bench.toml").write_text('outlet_normally = "open"\nlength_max_mm = 74.0\n')
    problem = FitProblem.of(open_data(folder))
    path = tmp_path / "plant.toml"
    path.write_text(improved_plant(problem, problem.base))
    constants, _ = load_plant(path)
    assert constants.outlet_normally == "open"
    assert constants.length_max_m == pytest.approx(0.074)
    assert nominal().length_max_m != constants.length_max_m


def test_simulate_takes_the_improved_plant(
    two: tuple[FitProblem, FitResult], tmp_path: Path
) -> None:
    problem, fit = two
    path = tmp_path / "plant.toml"
    path.write_text(improved_plant(problem, fit))
    forces = []
    for more in ([], ["--plant", str(path)]):
        ran = CliRunner().invoke(
            app, ["simulate", "held-steps", "--out", str(tmp_path / "runs"), "--json", *more]
        )
        assert ran.exit_code == 0, ran.output
        folder = sorted((tmp_path / "runs").iterdir())[-1]
        table = open_run(folder).table
        forces.append(table["force_n"].to_numpy())
        json.loads(ran.stdout)
    # The bladder pulls the force down by its stiffness times some 10 mm at 60 mm.
    assert np.all(forces[1] < forces[0] - 2.0)


def test_a_plant_file_that_cannot_be_used_is_refused_in_one_line(tmp_path: Path) -> None:
    bad = tmp_path / "plant.toml"
    bad.write_text("suply_kpa = 640\n")
    ran = CliRunner().invoke(app, ["simulate", "held-steps", "--plant", str(bad)])
    assert ran.exit_code != 0
