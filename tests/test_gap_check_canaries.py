"""Canaries: data that would fool a diagnosis which counts samples, or loves its own names."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from blind.exchange import write
from blind.recording import Recorded, record
from blind.sets import BlindSet, blind_set, choose, kind_and_count
from gap.data.reader import read_dataset
from gap.decision.diagnose import diagnose
from gap.verdict import Verdict

NAMING = ("named", "named_form_inadequate")


def numbers(kind: str, count: int, first: int = 0) -> list[int]:
    return [i for i in range(first, 600) if kind_and_count(i)[0] == kind][:count]


def verdict_on(recorded: Recorded, folder: Path) -> Verdict:
    write(recorded, folder)
    return diagnose(read_dataset(folder))


def best(verdict: Verdict) -> float:
    return max((e.probability for e in verdict.effects), default=0.0)


def with_strengths(one: BlindSet, factor: float) -> BlindSet:
    hidden = tuple(replace(h, strength=h.strength * factor) for h in one.hidden)
    return replace(one, hidden=hidden)


@pytest.mark.parametrize("number", [12, 13, 14])
def test_duplicated_trials_do_not_raise_confidence(number: int, tmp_path: Path) -> None:
    """A copy is no evidence: same files, twice the rows."""
    plain = record(blind_set("smoke", number))
    copies = plain.trials.assign(
        trial=plain.trials["trial"] + "x",
        replicate="copy" + plain.trials["replicate"].astype(str),
        order=plain.trials["order"] + plain.trials["order"].max(),
    )
    rows = plain.samples.assign(trial=plain.samples["trial"] + "x")
    doubled = Recorded(
        pd.concat([plain.trials, copies], ignore_index=True),
        pd.concat([plain.samples, rows], ignore_index=True),
        plain.bench,
    )
    once, twice = verdict_on(plain, tmp_path / "a"), verdict_on(doubled, tmp_path / "b")
    assert best(twice) <= best(once) + 0.05
    if once.status not in NAMING:
        assert twice.status not in NAMING


@pytest.mark.parametrize("number", numbers("single", 3))
def test_an_effect_of_no_size_is_not_named(number: int, tmp_path: Path) -> None:
    one = with_strengths(blind_set("smoke", number), 1e-9)
    assert verdict_on(record(one), tmp_path / "zero").status not in NAMING


def hides(number: int) -> str:
    """What the draw of a set's number hides, without making the set."""
    kind, count = kind_and_count(number)
    return choose(kind, count, np.random.default_rng(0))[0][0]


@pytest.mark.parametrize("name", ["braid_friction", "viscosity", "leak"])
def test_an_effect_with_its_sign_turned_is_not_named(name: str, tmp_path: Path) -> None:
    """Friction that pushes, air that leaks in: nothing of the catalogue."""
    number = next(i for i in numbers("single", 60) if hides(i) == name)
    one = blind_set("smoke", number)
    flipped = with_strengths(one, -4.0)
    verdict = verdict_on(record(flipped), tmp_path / "flipped")
    if verdict.status in NAMING:
        assert name not in verdict.effects[0].ids


@pytest.mark.parametrize("number", [13, 14])
def test_force_shuffled_among_trials_names_nobody(number: int, tmp_path: Path) -> None:
    recorded = record(blind_set("smoke", number))
    samples = recorded.samples.copy()
    with_force = samples.dropna(subset=["force_n"])
    values = with_force["force_n"].to_numpy(copy=True)
    np.random.default_rng(0).shuffle(values)
    samples.loc[with_force.index, "force_n"] = values
    verdict = verdict_on(replace(recorded, samples=samples), tmp_path / "shuffled")
    assert verdict.status not in NAMING


def test_a_drift_over_trials_that_nothing_may_explain_is_not_passed_over(tmp_path: Path) -> None:
    """Replicates far apart in time take wear for noise; their order still tells it."""
    one = blind_set("practice", 8096)
    assert [h.id for h in one.hidden] == ["wear"]
    write(record(one), tmp_path / "worn")
    verdict = diagnose(read_dataset(tmp_path / "worn"), without=["wear"])
    assert verdict.status == "unknown"
    assert any(c.alarm and "early-late trials" in c.name for c in verdict.contrasts)
