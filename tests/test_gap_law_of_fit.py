"""A law that `pamrig fit` wrote as the nominal plant: where it holds, and how far it may be off.

Another generator, with muscles of other laws and a law fitted to each, met all of this: fills from
empty crossed the corner where the muscle goes slack, which the fit had left out, and the law was
negative there; a bent error of the law was more than its terms could follow. Four of four such
plants with nothing hidden were called unknown.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from gap.data.reader import read_dataset
from gap.data.simulator import StaticForce, domain_of
from gap.decision.diagnose import diagnose
from gap.effects.candidates import CANDIDATES
from gap.effects.terms import Active
from gap.estimation.fit_problem import FitProblem
from gap.model.grid import make_grid
from gap.model.nominal import ModelError, Prior
from gap.model.sensitivities import nominal_columns, nominal_shift
from gap.simulators.open import open_simulator, with_simulator
from gap_sets import settled_set
from gap_simulators import Array, StaticBraid, braid
from plant.models import catalogue
from plant.models.model import Domain, Model


def law(folder: Path, **changed: object) -> Path:
    """The model file of a fit: the braid's law, with something changed."""
    path = folder / "model.toml"
    model: Model = dataclasses.replace(catalogue.get("chou-hannaford"), **changed)  # type: ignore[arg-type]
    path.write_text(catalogue.to_toml(model), encoding="utf-8")
    return path


def test_a_law_that_only_pulls_is_zero_where_the_muscle_is_slack(tmp_path: Path) -> None:
    short = np.array([40.0, 60.0])
    pressure = np.full(2, 200.0)
    plain = open_simulator(law(tmp_path))
    assert isinstance(plain, StaticForce)
    free = plain.force_n(pressure, short, {})
    assert free[0] < 0.0 < free[1]
    slack = open_simulator(law(tmp_path, pulls_only=True))
    assert isinstance(slack, StaticForce)
    assert slack.force_n(pressure, short, {}).tolist() == [0.0, free[1]]


def test_nothing_is_compared_beyond_the_points_that_a_law_was_fitted_to(tmp_path: Path) -> None:
    data = read_dataset(settled_set(tmp_path / "set", {}))
    whole = make_grid(data).rows
    fitted = Domain((100.0, 500.0), (56.0, 70.0), (21.0, 21.0))
    within = with_simulator(data, law(tmp_path, domain=fitted))
    rows = make_grid(within).rows
    assert rows.pressure.min() > 90e3
    assert rows.length.min() > 55e-3
    left_out = 1.0 - len(rows) / len(whole)
    assert within.notes[-1].startswith(f"{100.0 * left_out:.0f} % of the forces are not compared")
    assert "100 to 500 kPa and 56 to 70 mm" in within.notes[-1]


def test_a_shipped_law_has_no_domain_of_its_own(tmp_path: Path) -> None:
    path = tmp_path / "simulator.toml"
    path.write_text('kind = "law"\nmodel = "chou-hannaford"\n', encoding="utf-8")
    assert domain_of(open_simulator(path)) is None
    assert domain_of(open_simulator(law(tmp_path))) is not None


class Cornered(StaticBraid):
    """The braid with an error that has a corner, as a law without slack has where it begins."""

    def force_n(
        self, pressure_kpa: Array, length_mm: Array, parameters: Mapping[str, float]
    ) -> Array:
        true = super().force_n(pressure_kpa, length_mm, parameters)
        return true + 4.0 * np.abs(pressure_kpa / 500.0 - (70.0 - length_mm) / 20.0) - 1.5


def test_an_error_with_a_corner_is_no_gap_where_its_size_is_stated(tmp_path: Path) -> None:
    data = read_dataset(settled_set(tmp_path / "none", {}))
    stated = Cornered(braid().parameters, model_error_n=1.5)
    verdict = diagnose(dataclasses.replace(data, simulator=stated))
    assert verdict.status == "no_gap_above_floor"


def test_what_the_terms_of_an_error_leave_out_is_a_hundredth_of_it() -> None:
    pressure, length = np.linspace(0.0, 5e5, 40), np.linspace(0.05, 0.07, 40)
    error = ModelError.over(pressure, length, 3.0)
    p, x = (a.ravel() for a in np.meshgrid(pressure, length))
    variance = (error.terms(p, x) ** 2).sum(axis=1)
    assert np.median(variance) == pytest.approx(9.0, rel=0.02)


@pytest.mark.parametrize(("error_n", "times"), [(0.0, 1.0), (0.2, 1.527), (20.0, np.sqrt(10.0))])
def test_parameters_of_a_form_that_errs_are_known_less_well(error_n: float, times: float) -> None:
    """Points of a map that lie close share an error; a fit takes them for independent."""
    one = StaticBraid(
        braid().parameters, covariance=np.diag([0.04, 1e-4]), model_error_n=error_n, noise_n=0.48
    )
    root = Prior.of(one).root
    assert np.diag(root) == pytest.approx(times * np.array([0.2, 0.01]), rel=0.01)


def test_slopes_of_an_error_are_those_of_its_predictions(tmp_path: Path) -> None:
    """Two predictions tell of all terms, with sensors in error between the pull and the reading."""
    data = read_dataset(settled_set(tmp_path / "set", {}))
    bent = dataclasses.replace(data, simulator=braid(model_error_n=1.5))
    model = FitProblem.of(bent, list(CANDIDATES)).model
    active: Active = [
        ("force_gain", "", 8.0, {}), ("pressure_gain", "", 5.0, {}),
        ("fibre_stretch", "", 1.0, {"power": 1.0}),
    ]  # fmt: skip
    c = data.constants
    columns = nominal_columns(model, c, active)
    first = columns.shape[1] - model.error_columns(c, active).shape[1]  # type: ignore[union-attr]
    assert first == 2
    for number in (first, first + 5):
        step = np.zeros(columns.shape[1])
        step[number] = 0.5
        low, high = (
            model.stacked(model.residual(c, [*active, *nominal_shift(sign * step)], ["force"]))
            for sign in (-1.0, 1.0)
        )
        assert columns[:, number] == pytest.approx(low - high, abs=1e-9)
