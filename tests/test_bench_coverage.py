"""Do settled points agree with the plant as often as their uncertainty says?

The oracle is the nominal plant's muscle equation, written out here, not taken from the package.
"""

from __future__ import annotations

import math
import os
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from analysis.reduction.points import reduce_isometric
from bench_runs import run_bench

BRAID_MM = 88.4
TURNS = 1.855


def force_n(pressure_kpa: float, length_mm: float) -> float:
    """Equation 4-7 in kPa, mm and N: F = p (3 L^2 - b^2) / (4 pi n^2)."""
    area_mm2 = (3 * length_mm**2 - BRAID_MM**2) / (4 * math.pi * TURNS**2)
    return pressure_kpa * 1e-3 * area_mm2


def slopes(pressure_kpa: float, length_mm: float) -> tuple[float, float]:
    """(dF/dp in N/kPa, dF/dL in N/mm) of Equation 4-7."""
    scale = 1e-3 / (4 * math.pi * TURNS**2)
    return scale * (3 * length_mm**2 - BRAID_MM**2), scale * pressure_kpa * 6 * length_mm


def agreement(root: Path, rig: str, benches: int) -> tuple[np.ndarray, float]:
    """Errors over their u, (benches, points); worst |mean true pressure - set-point| in kPa."""
    pulls, worst = [], 0.0
    for seed in range(1000, 1000 + benches):
        result, run, bench = run_bench(root, rig, seed)
        assert result.outcome == "clean", result.error
        table = reduce_isometric(run).table
        here = []
        for row in table.itertuples():
            by_p, by_l = slopes(row.pressure_kpa, row.length_mm)
            u = math.hypot(row.u_force_n, by_p * row.u_pressure_kpa, by_l * row.u_length_mm)
            here.append((row.force_n - force_n(row.pressure_kpa, row.length_mm)) / u)
        pulls.append(here)
        for event in run.events:
            if event["kind"] == "point":
                a, b = event["valve_seq"]
                samples = run.between("valve", "seq", a, b)
                true_kpa = bench.board.mean_kpa(
                    int(samples["device_us"][0]), int(samples["device_us"][-1])
                )
                worst = max(worst, abs(true_kpa - event["set_pressure_kpa"]))
    return np.array(pulls), worst


def check(root: Path, rig: str) -> None:
    """At full size the share within k = 2; at a small one, what few benches can tell.

    Points of one bench share its calibration errors. Were they all one error, the mean square of
    pulls over n benches would be chi squared with n degrees over n: its range of 99.8 % holds
    however much they share. An uncertainty stated at half of what it should be is seen at the
    small size, one at twice that only at the full one.
    """
    full = bool(os.environ.get("PAMRIG_CAMPAIGN"))
    benches = 400 if full else 12
    pulls, worst_kpa = agreement(root, rig, benches)
    share, square = float(np.mean(np.abs(pulls) <= 2.0)), float(np.mean(pulls**2))
    print(
        f"\n{rig}: {share:.1%} of {pulls.size} points within k = 2, pulls of {square**0.5:.2f}; "
        f"worst set-point error {worst_kpa:.2f} kPa"
    )
    assert worst_kpa < 2.0
    if full:
        assert 0.93 <= share <= 0.98
        return
    low, high = chi2.ppf([0.001, 0.999], benches) / benches
    assert low <= square <= high
    assert share >= 0.85


def test_stated_uncertainty_covers_the_plant_on_the_modern_bench(tmp_path: Path) -> None:
    check(tmp_path, "virtual")


@pytest.mark.campaign
def test_stated_uncertainty_covers_the_plant_on_the_thesis_bench(tmp_path: Path) -> None:
    check(tmp_path, "virtual-thesis")


def test_the_equation_here_is_that_of_the_specification() -> None:
    """docs/reference/plant.md, check 2: F(600 kPa) at 52, 55, 60, 65 and 67 mm."""
    got = [force_n(600.0, length) for length in (52.0, 55.0, 60.0, 65.0, 67.0)]
    assert np.round(got, 2).tolist() == [4.13, 17.49, 41.42, 67.44, 78.43]
