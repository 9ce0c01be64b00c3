"""The lag of a gauge that falls with the pressure: a tube passes more of a denser gas.

Found on held-out forms (53118, 53337): such a lag was unknown, or was given to valves.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from gap.data.dataset import DataSet
from gap.data.reader import read_dataset
from gap.decision.diagnose import diagnose
from gap.model.pressure import behind_lag
from plant.physics.lag import STATED_PA, at_pressure
from tests.gap_bench import write_set

OUTSIDE_PA = 101325.0


@given(st.floats(1e-3, 1.0), st.floats(0.05, 2.0))
def test_a_lag_is_what_is_stated_at_the_stated_pressure_and_less_above(
    tau: float, power: float
) -> None:
    assert at_pressure(tau, power, STATED_PA) == pytest.approx(tau)
    assert at_pressure(tau, power, 2.0 * STATED_PA) == pytest.approx(tau * 2.0**-power)
    assert at_pressure(tau, 0.0, 3.0 * STATED_PA) == tau


def test_a_path_behind_such_a_lag_is_that_of_scipy() -> None:
    time = np.linspace(0.0, 2.0, 2001)
    corners = [0.0, 0.2, 0.5, 1.2, 1.3, 2.0]
    path = np.interp(time, corners, [0.0, 0.0, 4.5e5, 4.5e5, 0.5e5, 0.5e5])
    first = np.array([0, len(time)], dtype=np.int64)
    shown = behind_lag(first, time, path, 0.05, 0.8, OUTSIDE_PA)

    def slope(t: float, seen: np.ndarray) -> np.ndarray:
        true = np.interp(t, time, path)
        tau = 0.05 * ((true + OUTSIDE_PA) / 4e5) ** -0.8
        return np.asarray((true - seen) / tau)

    exact = solve_ivp(slope, (0.0, 2.0), [0.0], t_eval=time, rtol=1e-8, atol=1e-3, max_step=1e-3)
    assert np.abs(shown - exact.y[0]).max() < 20.0


def behind_a_tube(folder: Path, seconds: float) -> DataSet:
    """A nominal bench whose gauge sits behind a long thin tube.

    The flow through it is laminar and goes with the difference of the squares of the pressures; the
    diagnosis has a power of one pressure.
    """
    write_set(folder, replicates=2)
    samples = pd.read_parquet(folder / "samples.parquet")
    shown = []
    for _, trial in samples[samples["pressure_kpa"].notna()].groupby("trial", sort=False):
        time = trial["time_s"].to_numpy()
        true = trial["pressure_kpa"].to_numpy() + 101.3
        seen = np.empty(len(time))
        seen[0] = true[0]
        for i in range(1, len(time)):
            now, steps = seen[i - 1], 8
            for _ in range(steps):
                flow = (true[i] ** 2 - now**2) / (2.0 * 400.0 * seconds)
                now += flow * (time[i] - time[i - 1]) / steps
            seen[i] = now
        shown.append(pd.Series(seen - 101.3, index=trial.index))
    samples["pressure_kpa"] = pd.concat(shown)
    samples.to_parquet(folder / "samples.parquet")
    return read_dataset(folder)


def test_a_gauge_behind_a_long_thin_tube_is_late_and_no_valve(tmp_path: Path) -> None:
    verdict = diagnose(behind_a_tube(tmp_path / "set", seconds=0.03))
    # Its form is not that of the catalogue: it may be offered with a probability.
    assert [effect.ids for effect in verdict.effects] == [("pressure_lag",)]
