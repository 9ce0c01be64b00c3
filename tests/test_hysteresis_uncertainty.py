"""The uncertainty of a loop's area: noise and calibrations, against loops that are known."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

from analysis.findings.hysteresis import Cycle, cycles_of
from analysis.reduction.points import Reduction
from analysis.reduction.setpoint import at_set_pressure
from daq.calibration import Calibration
from protocol_runs import run_short, with_virtual
from rigs.protocols.registry import procedure
from rigs.rigfile.config import load_rig

FULL = bool(os.environ.get("PAMRIG_CAMPAIGN"))
STEPS_KPA = np.arange(0.0, 601.0, 100.0)


def points(
    force_up: np.ndarray, force_down: np.ndarray, read_kpa: np.ndarray, u_n: float, number: int = 1
) -> Any:
    """A table of one cycle: what was read at each set pressure, up and down."""
    import pandas as pd

    half = {
        "trial": number, "repeat": number, "set_length_mm": 62.0, "length_mm": 62.0,
        "cycle_max_kpa": 600.0, "mass_kg": np.nan, "set_pressure_kpa": STEPS_KPA,
        "pressure_kpa": read_kpa, "u_force_n_noise": u_n, "u_pressure_kpa_noise": 0.0,
    }  # fmt: skip
    up = pd.DataFrame({**half, "direction": "up", "force_n": force_up})
    down = pd.DataFrame({**half, "direction": "down", "force_n": force_down})
    return pd.concat([up, down.iloc[::-1]], ignore_index=True)


def calibrations(force: float, pressure: float, zero_kpa: float) -> dict[str, Calibration]:
    return {
        "force_n": Calibration("force_n", "N", "g", 0.0, 1.0, u_offset=0.5, u_gain=force),
        "pressure_kpa": Calibration(
            "pressure_kpa", "kPa", "count", 0.0, 1.0, u_offset=zero_kpa, u_gain=pressure
        ),
    }


def loop(pressure_kpa: np.ndarray, share: float = 0.02) -> tuple[np.ndarray, np.ndarray]:
    """A muscle with friction that grows with pressure; at the turn it still holds the rise."""
    up = 0.08 * pressure_kpa
    gap = np.where(STEPS_KPA < 600.0, share * pressure_kpa, 0.0)
    return up, up + gap


def test_a_gain_error_scales_the_whole_loop() -> None:
    up, down = loop(STEPS_KPA)
    table = points(up, down, STEPS_KPA, 0.001)
    (noise_only,) = cycles_of(table)
    (force,) = cycles_of(table, calibrations(0.01, 0.0, 0.0))
    (pressure,) = cycles_of(table, calibrations(0.0, 0.01, 0.0))
    (zero,) = cycles_of(table, calibrations(0.0, 0.0, 0.3))
    area = noise_only.area
    assert area == pytest.approx(-3000.0)
    assert noise_only.u_area == pytest.approx(0.001 * np.sqrt(2) * 100 * np.sqrt(5.25), rel=0.01)
    for cycle in (force, pressure):
        assert cycle.u_area == pytest.approx(30.0, rel=0.01)
        assert cycle.mean()[1] == pytest.approx(0.01 * abs(cycle.mean()[0]), rel=0.05)
    assert zero.u_area == pytest.approx(0.3 * 0.02 * 500.0, rel=0.02)
    assert force.u_difference[3] == pytest.approx(0.06, rel=0.01)


def test_a_pressure_off_its_set_point_gives_no_difference_at_the_turn() -> None:
    """The reading at the turn is no neighbour of the falling branch: friction reverses there."""
    up, down = loop(STEPS_KPA)
    read = STEPS_KPA * 1.004  # the sensor reads too much; set pressures are as it reads them
    (cycle,) = cycles_of(at_set_pressure(points(up, down, read, 0.001), "force_n"))
    assert cycle.difference[-1] == pytest.approx(0.0, abs=1e-9)
    assert cycle.area == pytest.approx(-3000.0 / 1.004, rel=1e-3)


def test_errors_of_drawn_calibrations_are_within_two_u_in_95_percent() -> None:
    import pandas as pd

    draws = 2000 if FULL else 200
    rng = np.random.default_rng(20)
    tables = []
    for number in range(draws):
        force, gain = rng.normal(0, [0.004, 0.003])
        zero = rng.normal(0, 0.3)
        read = np.where(STEPS_KPA > 0, STEPS_KPA * (1 + gain) + zero, 0.0)
        up, down = (f * (1 + force) + 0.4 + rng.normal(0, 0.01, 7) for f in loop(STEPS_KPA))
        tables.append(points(up, down, read, 0.01, number))
    table = at_set_pressure(pd.concat(tables, ignore_index=True), "force_n")
    cycles = cycles_of(table, calibrations(0.004, 0.003, 0.3))
    pulls = np.array([(c.area + 3000.0) / c.u_area for c in cycles])
    by_noise = np.array([(c.area + 3000.0) / c.u_area for c in cycles_of(table)])
    print(f"\n{draws} draws: {np.mean(np.abs(pulls) <= 2):.1%} within k = 2, worst"
          f" {np.abs(pulls).max():.1f}; noise alone {np.mean(np.abs(by_noise) <= 2):.1%}, worst"
          f" {np.abs(by_noise).max():.1f}")  # fmt: skip
    assert len(pulls) == draws
    assert 0.92 <= np.mean(np.abs(pulls) <= 2.0) <= 0.985
    assert np.std(pulls) == pytest.approx(1.0, abs=0.12)
    assert np.mean(np.abs(by_noise) <= 2.0) < 0.6  # what the noise alone would cover


def measured(root: Path, seed: int) -> tuple[Cycle, float]:
    """A cycle on a virtual bench with drawn calibrations, and its area without their errors."""
    config = with_virtual(
        load_rig("virtual", seed), effects={"braid_friction": {"friction_n": 3.0}}
    )
    wide = {"pressure_kpa": 0.005, "force_n": 0.003}
    held = procedure("hysteresis").read("hysteresis", config).held  # type: ignore[attr-defined]
    config = dataclasses.replace(
        config,
        calibrations={
            n: dataclasses.replace(c, u_gain=wide.get(n, c.u_gain))
            for n, c in config.calibrations.items()
        },
    )
    true: list[tuple[float, float]] = []

    def listen(runner: Any) -> None:
        plant = runner.rig.bench.plant
        runner.watch.point = lambda *_: true.append((plant.pressure_kpa, plant.force_n))

    result, run, _ = run_short(
        "hysteresis", root, config=config, begin=listen, lengths_mm=(62.0,), cycles_kpa=(300.0,),
        method={"settle": held.settle, "measure_s": held.measure_s},
    )  # fmt: skip
    assert result.outcome == "clean", result.error
    reduction: Reduction = procedure("hysteresis").analysis.reduce(run)
    (cycle,) = cycles_of(at_set_pressure(reduction.table, "force_n"), reduction.calibrations)
    truth = reduction.table.copy()
    truth[["pressure_kpa", "force_n"]] = true
    (known,) = cycles_of(at_set_pressure(truth, "force_n"))
    return cycle, known.area


def test_the_area_on_virtual_benches_is_off_as_often_as_it_says(tmp_path: Path) -> None:
    benches = 200 if FULL else 3
    pulls = []
    for seed in range(benches):
        cycle, truth = measured(tmp_path, 4000 + seed)
        pulls.append((cycle.area - truth) / cycle.u_area)
    share, square = float(np.mean(np.abs(pulls) <= 2.0)), float(np.mean(np.square(pulls)))
    print(f"\nloop area: {share:.1%} of {benches} within k = 2, pulls of {square**0.5:.2f}")
    low, high = chi2.ppf([0.001, 0.999], benches) / benches
    assert low <= square <= high
    if FULL:
        assert 0.91 <= share <= 0.99
