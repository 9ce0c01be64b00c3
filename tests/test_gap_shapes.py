"""An effect's shape is fitted with it, and its own error is undone where it arises."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gap.data.reader import read_dataset
from gap.decision.diagnose import diagnose, diagnose_with_search
from gap.effects.candidates import CANDIDATES
from gap.estimation.fit_problem import FitProblem
from gap.estimation.shape_fit import fit_shapes
from gap.model import force as laws
from gap.model.force import Context
from gap_bench import write_set
from gap_sets import settled_set
from plant.constants import nominal
from plant.effects.arguments import Points
from plant.effects.catalogue import CATALOGUE

C = nominal()


def still(length_mm: np.ndarray, **fields: np.ndarray) -> Points:
    """Points of one trial under a camera, at rest but for what `fields` say."""
    n = len(length_mm)
    zero = np.zeros(n)
    given = {
        "first": np.array([0, n]), "trial": np.zeros(n, dtype=np.int64),
        "mounting": np.zeros(n, dtype=np.int64), "time_s": np.arange(n) * 0.01,
        "row": np.arange(n), "weight": np.ones(n), "pressure": np.full(n, 3e5),
        "pressure_slope": zero, "path": zero, "length": length_mm * 1e-3, "rate": zero,
        "rate_sd": zero, "acceleration": zero, "held": np.zeros(n, dtype=bool),
        "settled": np.zeros(n, dtype=bool),
        "temperature": np.full(n, 21.0),
        "mass": np.ones(n), "reading": zero, "direction": zero,
        "taken": np.full(n, np.nan),
        "clipped": np.zeros(n, dtype=bool),
    }  # fmt: skip
    return Points(**{**given, **fields})


@given(st.floats(-1.5, 1.5), st.floats(1.5, 5.0), st.floats(-3.0, 3.0))
def test_the_length_behind_a_bent_reading_is_the_one_the_lens_showed_so(
    bend_mm: float, power: float, scale_percent: float
) -> None:
    true = np.linspace(C.length_min_m + 1e-3, C.length_max_m - 1e-3, 21)
    effects = [
        ("camera_distortion", "", bend_mm, {"power": power}),
        ("camera_scale", "", scale_percent, {}),
    ]
    shown = true + laws.read_minus_true(effects, true, C)
    behind = laws.true_length(still(shown * 1e3), effects, C)
    assert behind == pytest.approx(true, abs=2e-5)


def test_a_length_that_was_written_down_is_not_touched_by_the_camera() -> None:
    points = still(np.linspace(55.0, 65.0, 5), held=np.ones(5, dtype=bool))
    bent = [("camera_distortion", "", 1.0, {"power": 3.0})]
    assert laws.true_length(points, bent, C) == pytest.approx(points.length)


@pytest.mark.parametrize("delay_ms", [75.0, -95.0])
def test_a_late_or_early_camera_shows_settled_points_where_they_are(delay_ms: float) -> None:
    """A table beside trials with time in them: its rows are no seconds."""
    late = [("camera_delay", "", delay_ms, {})]
    away = np.linspace(55.0, 65.0, 5)
    moving = laws.true_length(still(away, rate=np.full(5, 0.25)), late, C)
    assert np.abs(moving * 1e3 - away).max() > 2.0
    settled = still(away, time_s=np.arange(5.0), settled=np.ones(5, dtype=bool))
    assert laws.true_length(settled, late, C) == pytest.approx(away * 1e-3)


def test_a_load_with_a_hose_weighs_more_the_higher_it_hangs() -> None:
    points = still(np.array([50.0, 60.0, 70.0]))
    context = Context(C, np.zeros(1))
    plain = laws.load_pull(points, [], context)
    pull = laws.load_pull(points, [("payload", "", 0.1, {"lifted_mm": 20.0})], context) - plain
    assert pull == pytest.approx(0.1 * 9.80665 * np.array([1.5, 1.0, 0.5]))


def test_stribeck_s_part_of_friction_is_gone_at_speed() -> None:
    points = still(np.full(3, 60.0), rate=np.array([0.0005, 0.004, 0.02]))
    shape = {"knee_mm_s": 0.1, "fall_mm_s": 4.0}
    context = Context(C, np.zeros(1))
    lost = laws.load_pull(points, [], context)
    lost = lost - laws.load_pull(points, [("link_friction", "", 2.0, shape)], context)
    assert lost == pytest.approx([2.0 * np.exp(-(0.5**2) / 16.0), 2.0 / np.e, 0.0], abs=1e-3)


def test_ends_that_fill_are_whole_at_the_pressure_at_which_they_are_stated() -> None:
    shortened = CATALOGUE["end_cap"].diagnosis.shortened
    assert shortened is not None
    p = np.array([-5e3, 0.0, 150e3, 500e3])
    shape = {"grow": 0.0, "fill_kpa": 150.0}
    found = shortened(p, np.full(4, 0.065), 1.2, shape, C)
    part = (1.0 - np.exp(-1.0)) / (1.0 - np.exp(-10.0 / 3.0))
    assert found == pytest.approx([0.0, 0.0, 1.2e-3 * part, 1.2e-3])


def test_ends_that_fill_are_not_taken_for_threads_that_stretch(tmp_path: Path) -> None:
    """Forces by the braid's equation (Chou and Hannaford 1996): only the threads' stretch depended
    on the pressure, and was named."""
    folder = settled_set(tmp_path / "ends", {})
    samples, trials = (pd.read_csv(folder / f"{name}.csv") for name in ("samples", "trials"))
    length = samples["trial"].map(trials.set_index("trial")["held_length_mm"])
    p = samples["pressure_kpa"].clip(lower=0.0)
    shorter = length - 1.5 * (1.0 - np.exp(-p / 140.0))
    turns = 4.0 * np.pi * C.turns**2
    samples["force_n"] += 1e-3 * p * 3.0 * (shorter**2 - length**2) / turns
    samples.to_csv(folder / "samples.csv", index=False)
    verdict = diagnose(read_dataset(folder))
    assert verdict.effects[0].ids == ("end_cap",)
    assert "fibre_stretch" not in verdict.sure


@pytest.fixture(scope="module")
def tube(tmp_path_factory: pytest.TempPathFactory) -> FitProblem:
    """A bench whose rubber tube rests at a length that no candidate has."""
    folder = tmp_path_factory.mktemp("tube")
    effect = {"bladder_elasticity": {"stiffness_n_mm": 0.6, "rest_mm": 66.0}}
    return FitProblem.of(read_dataset(write_set(folder, effect, seed=4)))


def test_a_shape_between_two_candidates_is_found_from_either_side(tube: FitProblem) -> None:
    rests = []
    for share in (0.57, 0.82):
        candidate = next(s for s in CANDIDATES if dict(s.shape) == {"rest": share})
        picked = tube.fit([candidate], [0.3])
        fitted = tube.polish(fit_shapes(tube, picked))
        assert fitted.cost < picked.cost
        rests.append(
            fitted.candidates[0].shape["rest"] * tube.constants(fitted.shift).braid_length_m
        )
    assert rests == pytest.approx([0.066, 0.066], abs=0.0015)


def test_a_hardening_tube_is_one_effect_not_two_of_its_family(tmp_path: Path) -> None:
    """The straight tube fits a hardening one badly; a relative would take what it leaves."""
    hard = {"stiffness_n_mm": 0.1, "rest_mm": 68.0, "hardening_per_mm2": 0.01}
    data = read_dataset(write_set(tmp_path, {"bladder_elasticity": hard}, seed=6))
    verdict, _, search = diagnose_with_search(data)
    assert search is not None
    assert search.best.fit.ids == ("bladder_elasticity",)
    assert verdict.stage == "muscle"


def test_the_improved_plant_has_the_fitted_shape(tube: FitProblem) -> None:
    from gap.validation.improved_plant import improved_plant

    candidate = next(s for s in CANDIDATES if dict(s.shape) == {"rest": 0.68})
    written = improved_plant(tube, tube.polish(fit_shapes(tube, tube.fit([candidate], [0.3]))))
    rest = float(next(x for x in written.splitlines() if x.startswith("rest_mm")).split("=")[1])
    assert rest == pytest.approx(66.0, abs=1.5)
