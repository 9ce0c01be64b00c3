"""A change over the trials is no noise, however large it is."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest

from gap.data.reader import read_dataset
from gap.estimation.fit_problem import FitProblem
from gap.model.features import BLOCKS
from gap_bench import write_set

Array = npt.NDArray[np.float64]


def with_drift(folder: Path, share: Callable[[Array], Array]) -> FitProblem:
    """The bench's tests, three times in turn, with forces that change by a share of themselves.

    Args:
        share: of the force, at 0 for the first trial to 1 for the last.
    """
    write_set(folder, {})
    trials = pd.read_csv(folder / "trials.csv").set_index("trial")
    samples = pd.read_parquet(folder / "samples.parquet")
    at = samples["trial"].map(trials["order"] / trials["order"].max()).to_numpy(np.float64)
    samples["force_n"] *= 1.0 + share(at)
    samples.to_parquet(folder / "samples.parquet", index=False)
    return FitProblem.of(read_dataset(folder))


def floor_n(problem: FitProblem) -> float:
    here = problem.rows.block == BLOCKS.index("force")
    return float(np.sqrt(np.mean(problem.floor_variance[here])))


@pytest.mark.parametrize(
    "share",
    [
        lambda x: 0.2 * x,
        lambda x: -0.3 * x**2,
        lambda x: 0.4 * x**3,
        lambda x: 0.3 * np.log1p(10.0 * x),
    ],
    ids=["even", "falling", "ever faster", "ever slower"],
)
def test_a_large_change_over_the_trials_is_not_taken_for_noise(
    tmp_path: Path, share: Callable[[Array], Array]
) -> None:
    """Force gains of 6 to 20 % had been learnt from it, and the floor was 2 to 6 N."""
    problem = with_drift(tmp_path / "data", share)
    assert problem.noise.trend is not None
    assert problem.noise.scales["force gain"] < 1.0
    assert floor_n(problem) < 0.8


def test_without_a_change_there_is_none_in_the_noise(tmp_path: Path) -> None:
    problem = with_drift(tmp_path / "data", np.zeros_like)
    assert problem.noise.trend is None
    assert problem.noise.scales["force gain"] < 0.5
    assert floor_n(problem) < 0.5
