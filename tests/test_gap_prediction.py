"""Whether an explanation found on some protocols predicts another, and a wrong one does not."""

from __future__ import annotations

import dataclasses
from itertools import islice

import pytest

from gap.data.reader import read_dataset
from gap.effects.candidates import CANDIDATES
from gap.estimation.fit_problem import FitProblem, FitResult
from gap.selection.candidate_fits import Hypothesis
from gap.selection.search import SearchResult, search_effects
from gap.validation.config import VALIDATION
from gap.validation.prediction import margins, predict_trials, rivals_of
from gap_bench import write_set
from plant.effects.catalogue import CATALOGUE

NEW = "hysteresis"


@pytest.fixture(scope="module")
def earlier_and_all(tmp_path_factory: pytest.TempPathFactory) -> tuple[FitProblem, FitProblem]:
    folder = tmp_path_factory.mktemp("liner")
    liner = {"liner_threshold": {"threshold_kpa": 25.0}}
    write_set(folder, liner, seed=12, replicates=2, rate_hz=1000.0)
    data = read_dataset(folder)
    known = tuple(trial for trial in data.trials if trial.protocol != NEW)
    return FitProblem.of(dataclasses.replace(data, trials=known)), FitProblem.of(data)


@pytest.fixture(scope="module")
def named(earlier_and_all: tuple[FitProblem, FitProblem]) -> SearchResult:
    return search_effects(earlier_and_all[0])


def fitted(problem: FitProblem, name: str) -> FitResult:
    candidate = next(s for s in CANDIDATES if s.id == name)
    return problem.polish(problem.fit([candidate], [candidate.step]))


def test_what_is_there_is_foretold_and_what_merely_fitted_is_not(
    earlier_and_all: tuple[FitProblem, FitProblem], named: SearchResult
) -> None:
    earlier, everything = earlier_and_all
    new = [k for k, t in enumerate(everything.data.trials) if t.protocol == NEW]
    right, wrong = named.best.fit, fitted(earlier, "creep")
    assert right.ids == ("liner_threshold",)
    found = predict_trials(everything, new, right, [wrong])
    assert found.shown
    assert found.confirmed
    assert found.share > VALIDATION.predicted_share
    assert found.left < 1.3 * found.rows
    assert found.rivals[("creep",)] > found.left + VALIDATION.shown_chi2
    turned = predict_trials(everything, new, wrong, [right])
    assert not turned.confirmed
    # Beside one that predicts as much nothing is confirmed.
    assert not predict_trials(everything, new, right, [right]).confirmed


def test_an_explanation_that_nothing_came_near_is_held_against_other_families_all_the_same(
    earlier_and_all: tuple[FitProblem, FitProblem], named: SearchResult
) -> None:
    earlier, _ = earlier_and_all
    wrong = fitted(earlier, "creep")
    alone = dataclasses.replace(named, best=Hypothesis(("creep",), wrong), rivals=[])
    rivals = list(rivals_of(earlier, alone))
    assert (
        len({CATALOGUE[r.ids[0]].family for r in rivals}) == len(rivals) == VALIDATION.least_rivals
    )
    assert rivals[0].ids == ("liner_threshold",)  # what is there was not fitted, but stood first
    # An entry of the verdict is held against too, though none of the search's.
    entry = next(rivals_of(earlier, alone, [("viscosity",), ("end_cap", "wear")]))
    assert entry.ids == ("end_cap", "wear")


def test_two_families_are_held_against_each_alone(
    earlier_and_all: tuple[FitProblem, FitProblem], named: SearchResult
) -> None:
    earlier, _ = earlier_and_all
    both = [fitted(earlier, "liner_threshold"), fitted(earlier, "wear")]
    fit = earlier.fit([s for b in both for s in b.candidates], [a for b in both for a in b.amounts])
    pair = dataclasses.replace(named, best=Hypothesis(("liner_threshold", "wear"), fit), rivals=[])
    alone = [rival.ids for rival in islice(rivals_of(earlier, pair), 2)]
    assert sorted(alone) == [("liner_threshold",), ("wear",)]


def test_explanations_part_where_the_effect_is(
    earlier_and_all: tuple[FitProblem, FitProblem],
) -> None:
    earlier, _ = earlier_and_all
    fit = fitted(earlier, "liner_threshold")
    apart = margins(earlier, fit, [earlier.base, fit])
    assert apart.shape == (2, len(earlier.data.trials))
    assert not apart[1].any()
    by = {
        protocol: sum(g for g, t in zip(apart[0], earlier.data.trials, strict=True)
                      if t.protocol == protocol)
        for protocol in ("isometric", "step")
    }  # fmt: skip
    assert by["isometric"] > by["step"]
    assert by["isometric"] > VALIDATION.shown_chi2
