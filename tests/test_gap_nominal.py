"""The nominal plant: a simulator from elsewhere in the place of a built-in stage."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gap.data.dataset import DataSet
from gap.data.reader import read_dataset
from gap.data.simulator import ExternalSimulator, Parameter
from gap.decision.diagnose import diagnose
from gap.errors import GapError
from gap.estimation.fit_problem import FitProblem
from gap.model.nominal import ModelError, Prior
from gap_sets import settled_set
from gap_simulators import BraidWithMemory, StaticBraid, braid


@pytest.fixture(scope="module")
def shortened(tmp_path_factory: pytest.TempPathFactory) -> DataSet:
    """End caps that shorten the muscle by 1.5 mm, held at five lengths."""
    folder = tmp_path_factory.mktemp("sets") / "caps"
    return read_dataset(settled_set(folder, {"end_cap": {"shortening_mm": 1.5}}))


def with_simulator(data: DataSet, simulator: ExternalSimulator) -> DataSet:
    return replace(data, simulator=simulator)


@pytest.mark.parametrize("simulator", [braid(), BraidWithMemory(braid())], ids=["law", "memory"])
def test_the_same_equations_from_elsewhere_give_the_same_verdict(
    shortened: DataSet, simulator: ExternalSimulator
) -> None:
    own = diagnose(shortened)
    theirs = diagnose(with_simulator(shortened, simulator))
    assert (theirs.status, theirs.effects[0].ids) == (own.status, own.effects[0].ids)
    for name, estimate in theirs.effects[0].parameters.items():
        assert estimate.value == pytest.approx(own.effects[0].parameters[name].value, rel=0.02)
    assert theirs.gap is not None
    assert own.gap is not None
    assert theirs.gap.recalibrated == pytest.approx(own.gap.recalibrated, rel=0.03)
    assert theirs.gap.after == pytest.approx(own.gap.after, rel=0.03)


@pytest.mark.parametrize("memory", [False, True], ids=["law", "memory"])
def test_a_parameter_off_by_two_sd_is_recalibrated_and_no_gap(tmp_path: Path, memory: bool) -> None:
    data = read_dataset(settled_set(tmp_path / "none", {}))
    off = tuple(
        replace(p, nominal=p.nominal + (2.0 * p.tolerance if p.name == "braid_mm" else 0.0))
        for p in braid(tolerance_mm=0.6).parameters
    )
    law = StaticBraid(off)
    data = with_simulator(data, BraidWithMemory(law) if memory else law)
    assert diagnose(data).status == "no_gap_above_floor"
    problem = FitProblem.of(data)
    found = problem.simulator_values(problem.base.shift)
    # turns and braid length trade against each other; the pull at a held length does not.
    at = (np.array([300.0]), np.array([61.0]))
    assert law.force_n(*at, found) == pytest.approx(braid().force_n(*at, {}), rel=0.003)


def test_constants_that_a_simulator_stands_for_are_not_recalibrated(shortened: DataSet) -> None:
    names = FitProblem.of(with_simulator(shortened, braid())).names
    assert "simulator braid_mm" in names
    assert "braid_length_mm" not in names
    assert "turns" not in names


def test_an_exact_parameter_stays(shortened: DataSet) -> None:
    exact = StaticBraid((Parameter("braid_mm", 88.4, 0.0), Parameter("turns", 1.855, 0.02)))
    problem = FitProblem.of(with_simulator(shortened, exact))
    assert [n for n in problem.names if n.startswith("simulator")] == ["simulator turns"]


def test_a_smooth_error_of_the_stated_size_is_no_gap(tmp_path: Path) -> None:
    """What is known to be wrong with a law's form is no effect, and does not move its constants."""
    data = read_dataset(settled_set(tmp_path / "none", {}))

    class Bent(StaticBraid):
        def force_n(self, pressure_kpa, length_mm, parameters):  # type: ignore[no-untyped-def]
            true = super().force_n(pressure_kpa, length_mm, parameters)
            return true + 2.0 * np.sin(pressure_kpa / 150.0) * np.cos((length_mm - 50.0) / 12.0)

    parameters = braid().parameters
    rigid = diagnose(with_simulator(data, Bent(parameters)))
    assert rigid.status != "no_gap_above_floor"
    allowed = diagnose(with_simulator(data, Bent(parameters, model_error_n=2.0)))
    assert allowed.status == "no_gap_above_floor"


def test_an_effect_beyond_the_model_error_is_still_seen(shortened: DataSet) -> None:
    verdict = diagnose(with_simulator(shortened, braid(model_error_n=0.2)))
    assert verdict.effects
    assert "end_cap" in verdict.effects[0].ids


def test_the_model_error_has_its_stated_size_everywhere() -> None:
    pressure, length = np.linspace(0.0, 5e5, 40), np.linspace(0.05, 0.07, 40)
    error = ModelError.over(pressure, length, 3.0)
    p, x = (a.ravel() for a in np.meshgrid(pressure, length))
    sd = np.sqrt((error.terms(p, x) ** 2).sum(axis=1))
    assert error.count < 64  # the variance ends the terms, not their largest number
    assert sd == pytest.approx(3.0, rel=0.12)


def test_a_covariance_is_taken_whole() -> None:
    cover = np.array([[0.04, -0.018], [-0.018, 0.01]])
    prior = Prior.of(braid(tolerance_mm=0.2, covariance=cover))  # type: ignore[arg-type]
    assert prior.root @ prior.root.T == pytest.approx(cover)
    z = np.array([1.0, -0.5])
    assert list(prior.values(z).values()) == pytest.approx(prior.nominal + prior.root @ z)


def test_a_covariance_that_is_none_is_refused() -> None:
    wrong = np.array([[0.04, -0.05], [-0.05, 0.01]])
    with pytest.raises(GapError, match=r"braid\.toml.*not positive definite"):
        Prior.of(braid(tolerance_mm=0.2, covariance=wrong))  # type: ignore[arg-type]


def test_a_prediction_that_is_missing_names_simulator_trial_and_time(shortened: DataSet) -> None:
    class Silent(BraidWithMemory):
        def simulate(self, trial, parameters):  # type: ignore[no-untyped-def]
            made = super().simulate(trial, parameters)["force"]
            return {"force": replace(made, value=np.where(made.time_s == 3, np.nan, made.value))}

    with pytest.raises(GapError, match=r"memory\.toml, trial t01: .* no prediction at"):
        diagnose(with_simulator(shortened, Silent(braid())))
