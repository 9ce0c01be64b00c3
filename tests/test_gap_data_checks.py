"""What a verdict must not be built on: copies, tables out of time, amounts beyond reliability."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from gap.data.dataset import DataSet
from gap.data.quality import unfit_channels
from gap.data.reader import read_dataset
from gap.data.repair import without_duplicates
from gap.data.trial import Channel
from gap.effects.candidates import CANDIDATES
from gap.estimation.fit_problem import FitProblem
from gap_bench import write_set
from gap_sets import settled_set


@pytest.fixture(scope="module")
def nominal(tmp_path_factory: pytest.TempPathFactory) -> DataSet:
    return read_dataset(write_set(tmp_path_factory.mktemp("nominal"), seed=21))


def test_copies_are_left_out_and_said_to_be(nominal: DataSet) -> None:
    copies = tuple(dataclasses.replace(t, name=f"{t.name}-x") for t in nominal.trials)
    once = without_duplicates(dataclasses.replace(nominal, trials=(*nominal.trials, *copies)))
    assert [t.name for t in once.trials] == [t.name for t in nominal.trials]
    assert f"{len(copies)} trials left out" in once.notes[-1]
    assert without_duplicates(nominal) is nominal


def test_a_table_without_time_is_never_out_of_time(tmp_path: Path) -> None:
    asked = FitProblem.of(read_dataset(settled_set(tmp_path / "table", {}))).candidates
    assert asked
    assert not [s.id for s in asked if s.defect or s.id == "camera_delay"]


def test_amounts_stay_within_the_range_of_the_catalogue(tmp_path: Path) -> None:
    problem = FitProblem.of(
        read_dataset(settled_set(tmp_path / "table", {"force_gain": {"percent": 29.0}}))
    )
    gain = next(s for s in CANDIDATES if s.id == "pressure_gain")
    assert abs(float(problem.fit([gain], [385.0]).amounts[0])) <= 30.0


def test_force_in_random_order_is_unfit_and_in_order_is_not(nominal: DataSet) -> None:
    rng = np.random.default_rng(0)
    trials = []
    for trial in nominal.trials:
        channels = dict(trial.channels)
        if "force_n" in channels:
            force = channels["force_n"]
            channels["force_n"] = Channel(force.time_s, rng.permutation(force.value))
        trials.append(dataclasses.replace(trial, channels=channels))
    shuffled = dataclasses.replace(nominal, trials=tuple(trials))
    assert not unfit_channels(nominal)
    assert "force_n has no order in time" in str(unfit_channels(shuffled)[0])
