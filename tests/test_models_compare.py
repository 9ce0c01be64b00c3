"""Comparison on held-out groups: ranking of C-1, its floors, and when a difference is real."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from plant.errors import PlantError
from plant.fitting.compare import compare, floors
from plant.fitting.data import Points, joined
from plant.fitting.fit import fit
from plant.fitting.thesis_points import thesis_points
from plant.models import catalogue

CANDIDATES = ("chou-hannaford", "braid-bladder", "liner-braid", "quasi-static", "black-box")


@pytest.fixture(scope="module")
def ranking():
    models = [catalogue.get(n) for n in CANDIDATES]
    return compare(models, thesis_points("c01"), nested=True)


def test_the_best_model_with_at_most_8_parameters_is_below_1_9_N_on_held_out_lengths(ranking):
    best = next(s for s in ranking.scores if s.parameters <= 8)
    assert best.model == "quasi-static"
    assert best.parameters == 6
    assert best.rmse_n < 1.9
    assert best.rmse_n == pytest.approx(1.707, abs=0.002)


def test_choosing_by_the_training_lengths_alone_stays_below_1_9_N(ranking) -> None:
    assert ranking.nested_rmse_n < 1.9
    assert len(ranking.nested_choices) == 14


def test_the_ranking_says_which_differences_are_real(ranking) -> None:
    found = {s.model: s for s in ranking.scores}
    assert not found["black-box"].real
    assert not found["liner-braid"].real
    assert found["chou-hannaford"].real
    assert found["chou-hannaford"].excess_low_n > 1.0
    assert found["liner-braid"].excess_low_n < 0 < found["liner-braid"].excess_high_n


def test_held_out_residuals_are_those_of_a_fit_without_that_length(ranking) -> None:
    points = thesis_points("c01")
    out = np.isclose(points.length_m, 67e-3)
    model = fit(catalogue.get("quasi-static"), points.take(~out)).model
    expected = points.force_n[out] - model.force(
        points.pressure_pa[out], points.length_m[out], outside="ignore"
    )
    assert np.allclose(ranking.scores[0].residual_n[out], expected, atol=1e-9)


def test_held_out_is_worse_than_trained_for_every_model(ranking) -> None:
    for score in ranking.scores:
        assert score.rmse_n > score.train_rmse_n
        assert score.rmse_low_n < score.rmse_n < score.rmse_high_n
        assert abs(score.bias_n) <= score.rmse_n <= abs(score.worst_n)


def test_floor_of_smooth_models_on_c1() -> None:
    assert floors(thesis_points("c01")).between_lengths_n == pytest.approx(1.64, abs=0.005)


def test_repeated_cells_give_the_repeatability() -> None:
    both = joined([thesis_points("c01"), thesis_points("c02")])
    found = floors(both)
    assert found.repeats == 224
    # C-2 is C-1 plus noise of 0.586 N rms: the pooled deviation of a pair is that over root 2.
    assert found.repeat_n == pytest.approx(0.586 / np.sqrt(2), abs=0.002)


def test_models_that_are_truly_alike_are_not_told_apart() -> None:
    rng = np.random.default_rng(4)
    p, x = np.meshgrid(np.linspace(1e5, 6e5, 8), np.linspace(53e-3, 66e-3, 8))
    p, x = p.ravel(), x.ravel()
    truth = catalogue.get("chou-hannaford")
    force = truth.force(p, x) + rng.normal(size=p.size)
    points = Points(p, x, np.full(p.size, 21.0), force)
    found = compare([truth, catalogue.get("hasselroth")], points)
    assert not any(s.real for s in found.scores)
    assert found.scores[1].excess_n == pytest.approx(0, abs=1e-4)


def test_a_wrong_model_is_told_from_the_true_one() -> None:
    p, x = np.meshgrid(np.linspace(1e5, 6e5, 8), np.linspace(53e-3, 66e-3, 8))
    p, x = p.ravel(), x.ravel()
    truth = catalogue.get("braid-bladder").with_values({"stiffness": 3.0})
    force = truth.force(p, x) + 0.2 * np.random.default_rng(1).normal(size=p.size)
    points = Points(p, x, np.full(p.size, 21.0), force)
    found = compare([catalogue.get("chou-hannaford"), truth], points)
    assert found.scores[0].model == "braid-bladder"
    assert found.scores[1].real


def test_whole_temperatures_can_be_held_out() -> None:
    points = thesis_points("c01", warm=True)
    names = ("black-box-t", "quasi-static")
    found = compare([catalogue.get(n) for n in names], points, holdout="temperature")
    assert found.groups[0] == "21 °C"
    assert found.scores[0].model == "black-box-t"


def test_too_few_groups_and_unknown_groups_are_refused() -> None:
    points = thesis_points("c01")
    models = [catalogue.get("chou-hannaford")]
    with pytest.raises(PlantError, match="at least three"):
        compare(models, points, holdout="mounting")
    with pytest.raises(PlantError, match="choose length"):
        compare(models, points, holdout="row")
    with pytest.raises(PlantError, match="no model"):
        compare([], points)


def test_mountings_are_groups_too() -> None:
    points = thesis_points("c01")
    label = np.array(["a", "b", "c", "d"])[np.arange(224) % 4]
    found = compare(
        [catalogue.get("quasi-static")],
        dataclasses.replace(points, mounting_label=label),
        holdout="mounting",
    )
    assert found.groups == ("a", "b", "c", "d")
    assert found.scores[0].rmse_n < 1.6


def test_isotonic_points_are_held_out_by_load_not_by_row() -> None:
    models = [catalogue.get(n) for n in ("quasi-static", "chou-hannaford")]
    with pytest.raises(PlantError, match="single rows"):
        compare(models, thesis_points("c03"))
    found = compare(models, thesis_points("c03"), holdout="load")
    assert found.scores[0].model == "quasi-static"


def test_fitted_to_one_test_and_scored_on_another() -> None:
    c1, c3 = thesis_points("c01"), thesis_points("c03")
    model = catalogue.get("chou-hannaford")
    found = compare([model], c3, holdout="load", train=c1)
    fitted = fit(model, c1).model
    expected = c3.force_n - fitted.force(c3.pressure_pa, c3.length_m, outside="ignore")
    assert np.allclose(found.scores[0].residual_n, expected)
    assert "fitted to" in found.source
