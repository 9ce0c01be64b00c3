"""Leaks that differ between replicates: a fitting that was tight in one trial and not in another.

Such a leak was taken for noise: `no_gap_above_floor` with a floor of 2.2 kPa in place of 0.5.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gap.data.dataset import DataSet
from gap.data.reader import read_dataset
from gap.decision.diagnose import diagnose
from gap.estimation.fit_problem import FitProblem
from gap.reporting.text import headline
from gap.verdict import Verdict
from plant.constants import nominal
from plant.effects.effects import NONE, Effects
from plant.simulator.simulate import commands, run_commands

SMALL = {"inlet_conductance_m3_s_pa": 1.25e-10, "outlet_conductance_m3_s_pa": 1.25e-10}
SETTINGS = ((58.0, 0.3), (60.0, 0.5), (62.0, 0.4), (64.0, 0.7), (66.0, 0.35))
"""Length in mm, and time in s for which the inlet is open."""
LEAK = 4e-13


def held(folder: Path, leak: Callable[[int, int], float]) -> DataSet:
    """Five settings, three replicates each: filled, shut for some seconds, vented.

    Args:
        leak: conductance by setting and replicate, m3/(s Pa).
    """
    rng = np.random.default_rng(11)
    c = nominal().with_overrides(SMALL)
    trials, samples = [], []
    for slot, (length_mm, width) in enumerate(SETTINGS):
        told = commands([(0.3, "inlet", 1.0), (0.3 + width, "inlet", 0.0), (7.0, "outlet", 1.0)])
        for replicate in range(3):
            own = leak(slot, replicate)
            effects = Effects({"leak": {"conductance_m3_s_pa": own}}) if own else NONE
            run = run_commands(c, told, 8.0, 100.0, effects, length_m=length_mm * 1e-3)
            t, name = run.time_s, f"{slot}-{replicate}"
            trials.append({"trial": name, "slot": str(slot), "replicate": replicate,
                           "protocol": "hold", "held_length_mm": length_mm,
                           "order": len(trials) + 1})  # fmt: skip
            zero, gain = 0.3 * rng.standard_normal(), 1.0 + 0.002 * rng.standard_normal()
            samples.append(pd.DataFrame({
                "trial": name, "time_s": t,
                "inlet_cmd": ((t >= 0.3) & (t < 0.3 + width)).astype(int),
                "outlet_cmd": (t >= 7.0).astype(int),
                "pressure_kpa": run.pressure_kpa * gain + zero
                + 0.3 * rng.standard_normal(len(t)),
            }))  # fmt: skip
    folder.mkdir(parents=True)
    pd.DataFrame(trials).to_csv(folder / "trials.csv", index=False)
    pd.concat(samples).to_csv(folder / "samples.csv", index=False)
    (folder / "bench.toml").write_text("".join(f"{k} = {v}\n" for k, v in SMALL.items()))
    return read_dataset(folder)


def one_loose(slot: int, replicate: int) -> float:
    return LEAK if (slot, replicate) == (1, 1) else 0.0


def by_mounting(slot: int, replicate: int) -> float:
    return (0.0, LEAK, 0.5 * LEAK)[replicate]


def all_alike(slot: int, replicate: int) -> float:
    return 0.5 * LEAK


@pytest.fixture(scope="module")
def one(tmp_path_factory: pytest.TempPathFactory) -> DataSet:
    return held(tmp_path_factory.mktemp("one") / "set", one_loose)


@pytest.fixture(scope="module")
def verdict_of_one(one: DataSet) -> Verdict:
    return diagnose(one)


def amounts(problem: FitProblem) -> dict[str, float]:
    """What was found, by name of the trial."""
    return {problem.data.trials[int(s["trial"])].name: a for _, _, a, s in problem.by_trial}


def test_one_loose_fitting_is_found_in_its_trial_and_is_no_noise(one: DataSet) -> None:
    problem = FitProblem.of(one)
    assert amounts(problem) == {"1-1": pytest.approx(LEAK, rel=0.05)}
    floor_kpa = float(np.sqrt(np.mean(problem.floor_variance)))
    left_kpa = float(np.sqrt(np.mean(problem.base.residual**2)))
    assert floor_kpa < 0.8
    assert left_kpa < 1.1 * floor_kpa


def test_the_verdict_names_it_and_the_trial(verdict_of_one: Verdict) -> None:
    assert verdict_of_one.status == "named"
    assert verdict_of_one.sure == ("leak",)
    assert str(verdict_of_one.reason) == (
        "leak differs between replicates: more in 1 of 15 trials than in others"
    )
    assert any("1-1 4" in note and "m3/(s Pa)" in note for note in verdict_of_one.notes)
    assert verdict_of_one.probability_none == 0.0
    assert headline(verdict_of_one).startswith("leak differs between replicates")


def test_leaks_of_mountings_are_found_each(tmp_path: Path) -> None:
    problem = FitProblem.of(held(tmp_path / "set", by_mounting))
    found = amounts(problem)
    assert set(found) == {f"{slot}-{replicate}" for slot in range(5) for replicate in (1, 2)}
    for name, amount in found.items():
        assert amount == pytest.approx(by_mounting(0, int(name[-1])), rel=0.1)


def test_a_leak_that_all_have_is_that_of_the_bench(tmp_path: Path) -> None:
    data = held(tmp_path / "set", all_alike)
    assert not FitProblem.of(data).by_trial
    verdict = diagnose(data)
    assert verdict.status == "named"
    assert "explains the gap" in str(verdict.reason)


def test_without_the_effect_it_is_not_looked_for(one: DataSet) -> None:
    problem = FitProblem.of(one)
    assert not FitProblem.of(one, [c for c in problem.candidates if c.id != "leak"]).by_trial


def test_a_kept_diagnosis_has_it_as_well(one: DataSet, tmp_path: Path) -> None:
    problem = FitProblem.of(one)
    again = FitProblem.restored(one, problem.state())
    assert again.by_trial == problem.by_trial
    other = problem.on_model(one, problem.model, problem.noise)
    assert not other.by_trial  # numbers of trials are those of other data
