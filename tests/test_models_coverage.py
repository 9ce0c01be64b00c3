"""Do 95 % intervals hold the truth of a virtual bench as often as they say?

Every bench draws its own calibration errors; the truth is the nominal plant's braid.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from analysis.models.points import run_points
from bench_runs import run_bench
from plant.fitting.fit import fit
from plant.models import catalogue

TRUTH = {"braid_length": 88.4, "turns": 1.855}


def covered(root: Path, benches: int, first_seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Per bench and parameter: is the truth inside; error over its standard deviation."""
    inside, pulls = [], []
    model = catalogue.get("chou-hannaford")
    for seed in range(first_seed, first_seed + benches):
        result, run, _ = run_bench(root, "virtual", seed)
        assert result.outcome == "clean", result.error
        found = fit(model, run_points(run))
        assert found.identifiability.lines() == []
        estimates = [found.estimate(name) for name in TRUTH]
        truths = list(TRUTH.values())
        inside.append([e.low <= t <= e.high for e, t in zip(estimates, truths, strict=True)])
        pulls.append([(e.value - t) / e.sd for e, t in zip(estimates, truths, strict=True)])
    return np.array(inside), np.array(pulls)


def test_fits_of_a_few_benches_recover_the_braid(tmp_path: Path) -> None:
    inside, pulls = covered(tmp_path, 3, first_seed=3000)
    assert np.mean(inside) >= 0.7
    assert np.max(np.abs(pulls)) < 4.5


@pytest.mark.campaign
def test_intervals_cover_in_93_to_98_percent_of_500_benches(tmp_path: Path) -> None:
    benches = 500 if os.environ.get("PAMRIG_CAMPAIGN") else 60
    inside, pulls = covered(tmp_path, benches, first_seed=5000)
    print(
        f"\nintervals of {benches} runs: {np.mean(inside):.1%} pooled "
        f"({', '.join(f'{n} {x:.1%}' for n, x in zip(TRUTH, inside.mean(axis=0), strict=True))}); "
        f"pulls have sd {pulls.std():.3f}, mean {pulls.mean():.3f}"
    )
    assert 0.93 <= np.mean(inside) <= 0.98
