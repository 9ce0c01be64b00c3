"""A chamber that somebody else simulates, with another valve than the built-in one.

Effects of gauge and gas act on what that simulator predicts, in its own course: the built-in
chamber of the same bench fills twice as fast. Its amounts had come out a tenth off, with further
effects to make up for it, and a zero of the gauge had no name: such a simulator starts at the first
reading, which holds the zero too.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
from scipy.signal import lfilter

from gap.data.dataset import DataSet
from gap.data.reader import read_dataset
from gap.data.simulator import PRESSURE_STAGE, Parameter, Stage
from gap.data.trial import Channel, Trial
from gap.decision.diagnose import diagnose
from gap.effects.candidates import CANDIDATES
from gap.estimation.fit_problem import FitProblem, FitResult

Array = npt.NDArray[np.float64]

SUPPLY_KPA, STEP_S, NOISE_KPA = 500.0, 0.002, 0.2
LAG_S, ZERO_KPA = 0.02, 6.0


def filled(time_s: Array, inlet: Array, outlet: Array, start_kpa: float, pace: float) -> Array:
    """Pressure in kPa of a chamber that follows the supply, or the room, at `pace` per second."""
    made, p = np.empty(len(time_s)), start_kpa
    for i in range(len(time_s)):
        made[i] = p
        p += STEP_S * pace * (inlet[i] * (SUPPLY_KPA - p) - outlet[i] * p)
    return made


def commands(time_s: Array, open_s: float) -> tuple[Array, Array]:
    """Two fillings and ventings, of the inlet and the outlet."""
    turn = time_s % 1.5
    inlet = (turn > 0.2) & (turn < 0.2 + open_s)
    return inlet.astype(np.float64), ((turn > 0.9) & (turn < 1.4)).astype(np.float64)


@dataclass(frozen=True)
class Chamber:
    """That chamber as its user would bind it: it starts at the first pressure that was read."""

    parameters: tuple[Parameter, ...] = (Parameter("pace", 4.0, 0.05),)
    covariance: Array | None = None
    model_error_n: float = 0.0
    noise_n: float = 0.0
    origin: str = "chamber.toml"
    stages: tuple[Stage, ...] = (PRESSURE_STAGE,)

    def simulate(self, trial: Trial, parameters: Mapping[str, float]) -> dict[str, Channel]:
        t = trial["pressure_kpa"].time_s
        inlet, outlet = (
            np.interp(t, trial[name].time_s, trial[name].value)
            for name in ("inlet_cmd", "outlet_cmd")
        )
        pace = {"pace": 4.0, **parameters}["pace"]
        start = float(trial["pressure_kpa"].value[0])
        return {"pressure": Channel(t, filled(t, inlet, outlet, start, pace))}


def recorded(folder: Path, lag_s: float = 0.0, zero_kpa: float = 0.0) -> DataSet:
    """Four settings, three times each, of that chamber behind a gauge."""
    rng = np.random.default_rng(11)
    t = np.arange(0.0, 3.0, STEP_S)
    trials, samples = [], []
    for open_s in (0.1, 0.2, 0.3, 0.4):
        inlet, outlet = commands(t, open_s)
        for replicate in (1, 2, 3):
            true = filled(t, inlet, outlet, 0.0, 4.0)
            if lag_s > 0.0:
                share = 1.0 - np.exp(-STEP_S / lag_s)
                true = lfilter([0.5 * share, 0.5 * share], [1.0, share - 1.0], true)
            name = f"open {open_s}, {replicate}"
            trials.append({"trial": name, "slot": f"open {open_s}", "replicate": replicate,
                           "protocol": "step", "held_length_mm": 80.0})  # fmt: skip
            samples.append(pd.DataFrame({
                "trial": name, "time_s": t, "inlet_cmd": inlet, "outlet_cmd": outlet,
                "pressure_kpa": true + zero_kpa + NOISE_KPA * rng.standard_normal(len(t)),
            }))  # fmt: skip
    folder.mkdir()
    pd.DataFrame(trials).to_csv(folder / "trials.csv", index=False)
    pd.concat(samples).to_csv(folder / "samples.csv", index=False)
    return replace(read_dataset(folder), simulator=Chamber())


def with_effect(data: DataSet, name: str) -> tuple[float, FitResult]:
    """Share of the gap that one effect leaves, and its fit."""
    problem = FitProblem.of(data, list(CANDIDATES)).run_as_stated()
    one = next(c for c in problem.candidates if c.id == name)
    found = problem.polish(problem.fit_afresh([one], [5.0]))
    rows = len(problem.rows)
    return (found.cost - rows) / (problem.base.cost - rows), found


def test_the_lag_of_a_gauge_acts_on_what_the_simulator_predicts(tmp_path: Path) -> None:
    left, found = with_effect(recorded(tmp_path / "set", lag_s=LAG_S), "pressure_lag")
    assert found.amounts[0] == pytest.approx(1e3 * LAG_S, rel=0.05)
    assert left < 0.01


def test_a_zero_of_the_gauge_is_also_in_the_pressure_it_was_started_from(tmp_path: Path) -> None:
    left, found = with_effect(recorded(tmp_path / "set", zero_kpa=ZERO_KPA), "pressure_zero")
    assert found.amounts[0] == pytest.approx(ZERO_KPA, rel=0.05)
    assert left < 0.03


def test_what_the_calibration_denies_is_offered_and_not_named(tmp_path: Path) -> None:
    data = recorded(tmp_path / "set", lag_s=LAG_S, zero_kpa=ZERO_KPA)
    named = diagnose(data)
    assert set(named.sure) == {"pressure_lag", "pressure_zero"}
    denied = diagnose(replace(data, calibration={"pressure_zero_kpa": 0.5}))
    assert denied.sure == ("pressure_lag",)
    assert "times what calibration.toml states of pressure_zero_kpa" in str(denied.reason)
