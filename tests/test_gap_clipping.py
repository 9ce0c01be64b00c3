"""Readings at the end of what an instrument can show."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gap.data.reader import read_dataset
from gap.estimation.fit_problem import FitProblem
from gap.model import force as laws
from gap.model.clipping import at_lower_end
from gap_bench import write_set
from plant.constants import nominal
from plant.effects.arguments import Context
from test_gap_shapes import still

CONTEXT = Context(nominal(), np.zeros(1))

STEP_KPA = 0.244


def reading(zero_kpa: float, noise_kpa: float, ends: bool, seed: int = 1) -> np.ndarray:
    """A gauge at rest and then at 300 kPa, in steps of a 12-bit converter."""
    rng = np.random.default_rng(seed)
    true = np.repeat([0.0, 300.0], 2000) + zero_kpa
    read = STEP_KPA * np.round((true + rng.normal(0.0, noise_kpa, len(true))) / STEP_KPA)
    return np.maximum(read, 0.0) if ends else read


@pytest.mark.parametrize("zero_kpa", [-1.5, -0.45, -0.1])
def test_noise_that_stops_at_the_lowest_reading_shows_its_end(zero_kpa: float) -> None:
    read = reading(zero_kpa, 0.2, ends=True)
    found = at_lower_end(read)
    assert np.array_equal(found, read == 0.0)


@pytest.mark.parametrize("zero_kpa", [-0.45, 0.0, 2.0])
def test_a_gauge_that_reads_below_its_zero_ends_nowhere(zero_kpa: float) -> None:
    assert not at_lower_end(reading(zero_kpa, 0.2, ends=False)).any()


def test_a_pressure_that_was_held_is_no_end_of_a_gauge() -> None:
    """A cylinder held at 1 bar: its lowest readings were taken for those of a vented muscle."""
    assert not at_lower_end(reading(-0.45, 0.2, ends=True) + 70.0).any()


def test_a_reading_without_noise_ends_nowhere() -> None:
    assert not at_lower_end(reading(0.0, 0.0, ends=True)).any()
    assert not at_lower_end(np.repeat([0.0, 100.0, 200.0, 300.0], 100)).any()
    assert not at_lower_end(np.zeros(0)).any()


def test_what_a_gauge_cannot_show_is_the_pressure_of_the_atmosphere() -> None:
    """With a zero of -8 kPa, 0 at the lower end is not 8 kPa; 2 kPa above it is 10."""
    clipped = np.array([True, False, False])
    points = still(np.full(3, 60.0), pressure=np.array([0.0, 2e3, 3e5]), clipped=clipped)
    low = [("pressure_zero", "", -8.0, {})]
    assert laws.true_pressure(points, low, CONTEXT).tolist() == [0.0, 10e3, 308e3]
    assert laws.true_pressure(points, [], CONTEXT).tolist() == [0.0, 2e3, 3e5]
    high = [("pressure_zero", "", 2.0, {})]
    assert laws.true_pressure(points, high, CONTEXT)[0] == -2e3  # it shows more than is there
    assert np.array_equal(np.isnan(points.known_reading), clipped)


def below_zero(folder: Path, offset_kpa: float, ends: bool) -> FitProblem:
    """A bench whose gauge reads low, with a converter that ends at zero or goes on below."""
    write_set(folder, replicates=2)
    samples = pd.read_parquet(folder / "samples.parquet")
    read = STEP_KPA * ((samples.pressure_kpa + offset_kpa) / STEP_KPA).round()
    samples["pressure_kpa"] = read.clip(lower=0.0) if ends else read
    samples.to_parquet(folder / "samples.parquet", index=False)
    return FitProblem.of(read_dataset(folder))


@pytest.mark.parametrize("offset_kpa", [-1.0, -8.0])
def test_a_zero_below_the_end_of_a_gauge_is_found_as_if_the_gauge_went_on(
    offset_kpa: float, tmp_path: Path
) -> None:
    """A vented muscle stands at the atmosphere, whatever the zero is and the gauge shows."""
    found = {}
    for name, ends in (("ends", True), ("goes on", False)):
        problem = below_zero(tmp_path / name, offset_kpa, ends)
        fit = problem.polish(problem.fit_effects(["pressure_zero"]))
        found[name] = (float(fit.amounts[0]), (fit.cost - len(problem.rows)) / len(problem.rows))
    assert found["ends"][0] == pytest.approx(offset_kpa, abs=0.3)
    assert found["ends"][1] < found["goes on"][1] + 0.1
