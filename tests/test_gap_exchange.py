"""Exchanges of effects of an explanation for others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gap.estimation.fit_problem import FitProblem
from gap.estimation.information import tolerance
from gap.selection.candidate_fits import Hypothesis
from gap.selection.config import SELECTION
from gap.selection.exchange import proposals, with_exchanges
from gap.selection.inclusion import excess_chi2
from gap.selection.search import SearchResult
from gap_sets import fitted, table_with_two_effects
from plant.arrays import Array

ALARM = 30.0


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> FitProblem:
    return table_with_two_effects(tmp_path_factory.mktemp("table") / "set")


def outcome(problem: FitProblem, best: Hypothesis) -> SearchResult:
    """A search that ended at an explanation."""
    gap = excess_chi2(problem, problem.base)
    steps = tuple((key, gap / len(best.keys)) for key in best.keys)
    left = excess_chi2(problem, best.fit)
    return SearchResult(best, [], {}, gap, left, alarm=ALARM, steps=steps)


def whitened(problem: FitProblem, columns: Array) -> Array:
    """Columns with rows of unit noise."""
    made = np.zeros_like(columns)
    for trial, rows in enumerate(problem.noise.trial_rows):
        if len(rows):
            made[rows] = problem.noise.whiten(trial, columns[rows])
    return made


def cost_of(problem: FitProblem, best: Hypothesis, columns: Array, y: Array) -> float:
    """What least squares leave of `y` by `columns`, the prior of the constants included."""
    cost, slope, stiffness = tolerance(best.fit.shift)
    n = len(slope)
    # The prior of the constants as rows: half its slope and curvature where they stand.
    pull = np.zeros((n, columns.shape[1]))
    pull[:, :n] = np.diag(np.sqrt(stiffness))
    a = np.vstack([whitened(problem, columns), pull])
    right = np.r_[whitened(problem, y[:, None])[:, 0], -slope / np.sqrt(stiffness)]
    beta = np.linalg.lstsq(a, right, rcond=1e-13)[0]
    offset = cost - float(np.sum(slope**2 / stiffness))
    return float(np.sum((right - a @ beta) ** 2)) + offset


def test_two_effects_take_the_place_of_two_that_stood_for_them(table: FitProblem) -> None:
    wrong = fitted(table, "fibre_stretch", "pressure_gain")
    found = with_exchanges(table, outcome(table, wrong))
    assert set(found.best.keys) == {"liner_threshold", "force_gain"}
    assert found.best.cost < wrong.cost - ALARM
    assert found.left == excess_chi2(table, found.best.fit)
    assert wrong in found.rivals


def test_a_rival_that_came_out_better_than_the_explanation_takes_its_place(
    table: FitProblem,
) -> None:
    """In set 1026 a rival with fewer effects left 5,700 less once it was fitted to its end."""
    wrong = fitted(table, "fibre_stretch", "pressure_gain")
    right = fitted(table, "liner_threshold", "force_gain")
    passed_by = replace(outcome(table, wrong), rivals=[right])
    found = with_exchanges(table, passed_by, replace(SELECTION, exchange_rounds=0))
    assert found.best is right
    assert found.rivals == [wrong]


def test_what_nothing_makes_better_stays_as_it_is(table: FitProblem) -> None:
    right = outcome(table, fitted(table, "liner_threshold", "force_gain"))
    assert with_exchanges(table, right) is right


def test_the_cost_of_an_exchange_is_that_of_least_squares(table: FitProblem) -> None:
    wrong = fitted(table, "fibre_stretch", "pressure_gain")
    exchange = proposals(table, wrong, ALARM)[0]
    fit = wrong.fit
    columns = table.all_columns(fit)
    n, k = len(table.names), len(fit.candidates)
    own = [j for j, c in enumerate(fit.candidates) if c.key in exchange.out]
    place = {id(c): n + k + j for j, c in enumerate(table.candidates)}
    used = [*range(n), *(n + j for j in range(k) if j not in own)]
    used += [place[id(c)] for c in exchange.entering]
    y = fit.residual + columns[:, [n + j for j in own]] @ fit.amounts[own]
    made = cost_of(table, wrong, columns[:, used], y)
    kept = len(wrong.keys) - len(exchange.out) + len(exchange.entering)
    assert exchange.cost == pytest.approx(made + ALARM * kept, rel=1e-4, abs=0.1)
