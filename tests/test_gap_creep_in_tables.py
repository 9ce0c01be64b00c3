"""Creep in settled points: to be seen where a table states when its points were read.

On a withheld bench (847) isometric tests showed creep and points of an isobaric test, taken to hold
no time, spoke against it: 13,000 of chi-square stayed. Now nothing stays.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from gap.data.dataset import DataSet
from gap.data.reader import read_dataset
from gap.decision.diagnose import diagnose
from tests.gap_sets import settled_set


def held_for_seconds_and_minutes(folder: Path, share: float) -> DataSet:
    """Each step of the force loses `share` of itself for each decade of time (Nutting 1921).

    The steps add up (Boltzmann); the diagnosis has elements with one time each instead.
    """
    path = settled_set(folder, {}, replicates=4) / "samples.csv"
    rng = np.random.default_rng(5)
    samples = pd.read_csv(path)
    for _, rows in samples.groupby("trial", sort=False):
        taken = np.cumsum(rng.choice([3.0, 20.0, 90.0], len(rows)))
        begun = np.r_[0.0, taken[:-1]]
        force = rows["force_n"].to_numpy()
        steps = np.diff(force, prepend=0.0)
        age = np.maximum(taken[:, None] - begun[None, :], 0.0)
        lost = (np.log10(1.0 + age / 0.3) * steps[None, :] * (age > 0.0)).sum(axis=1)
        samples.loc[rows.index, "force_n"] = force - share * lost
        samples.loc[rows.index, "taken_s"] = taken
    samples.to_csv(path, index=False)
    return read_dataset(folder)


def test_creep_is_named_in_a_table_that_states_when_it_was_read(tmp_path: Path) -> None:
    verdict = diagnose(held_for_seconds_and_minutes(tmp_path / "set", share=0.04))
    assert verdict.effects[0].ids == ("creep",)
    assert verdict.status.startswith("named")


def test_creep_is_never_offered_where_the_table_does_not(tmp_path: Path) -> None:
    held_for_seconds_and_minutes(tmp_path / "set", 0.04)
    path = tmp_path / "set" / "samples.csv"
    pd.read_csv(path).drop(columns="taken_s").to_csv(path, index=False)
    verdict = diagnose(read_dataset(tmp_path / "set"))
    assert all("creep" not in effect.ids for effect in verdict.effects)
