"""How well an experiment that was not yet made would tell two explanations apart.

d' is the norm of the difference of their predictions in units of noise, once the second has been
refitted (constants within their tolerances, amounts within the catalogue's range) to look like the
first on everything measured so far and on the experiment together. The right one is then preferred
with probability Phi(d'/2): 3.3 is right 95 times in 100. Noise is as the data's replicates show it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gap.design.library import LibraryExperiment, as_data
from gap.estimation.fit_problem import FitProblem, FitResult
from gap.estimation.information import damped_step, tolerance
from gap.estimation.noise import WHITE, Noise, usual
from gap.model.features import BLOCKS
from gap.model.grid import make_grid
from gap.model.residuals import Model
from gap.model.sensitivities import TRIAL_EFFECTS, trial_columns
from plant.arrays import Array

_BENDS = 12


@dataclass(frozen=True)
class Products:
    """Inner products, in units of noise, of a difference and the ways in which a rival may bend."""

    difference: float
    across: Array
    gram: Array

    def __add__(self, other: Products) -> Products:
        return Products(
            self.difference + other.difference, self.across + other.across, self.gram + other.gram
        )

    def times(self, count: int) -> Products:
        """The same experiment made `count` times."""
        return Products(count * self.difference, count * self.across, count * self.gram)


def products(problem: FitProblem, best: FitResult, rival: FitResult) -> Products:
    """Of all the data of `problem`, whatever they are."""
    return sum_of(by_trial(problem, best, rival))


def sum_of(parts: Sequence[Products]) -> Products:
    """All of several data together."""
    total = parts[0]
    for part in parts[1:]:
        total = total + part
    return total


def by_trial(problem: FitProblem, best: FitResult, rival: FitResult) -> list[Products]:
    """Of each trial of the data of `problem`."""
    gap = problem.predicted_difference(best, rival)
    columns = problem.columns_of(rival)
    both = np.hstack([columns, gap[:, None]])
    made = []
    for trial, rows in enumerate(problem.noise.trial_rows):
        total = np.zeros((both.shape[1], both.shape[1]))
        if len(rows):
            total = problem.noise.solve(trial, both[rows])[0]
        made.append(Products(float(total[-1, -1]), total[:-1, -1], total[:-1, :-1]))
    return made


def separation(found: Products, best: FitResult, rival: FitResult) -> float:
    """Separation d' once the rival has bent as far as its priors let it.

    What its constants cost by then, walls of their tolerances included, counts against it, and
    what those of `best` cost for it. Newton's method: the priors are parabolas, piece by piece.
    """
    n = len(rival.shift)
    low, high = np.array([s.bounds for s in rival.candidates]).reshape(-1, 2).T
    range_prior = 4.0 / np.maximum(high - low, 1e-30) ** 2
    bend = np.zeros(len(found.across))
    for _ in range(_BENDS):
        _, slope, stiffness = tolerance(rival.shift + bend[:n])
        matrix = found.gram + np.diag(np.r_[stiffness, range_prior])
        steep = found.gram @ bend - found.across + np.r_[slope, range_prior * bend[n:]]
        bend -= damped_step(matrix, steep, 0.0)
    left = found.difference - 2.0 * found.across @ bend + bend @ found.gram @ bend
    left += float(range_prior @ bend[n:] ** 2)
    left += tolerance(rival.shift + bend[:n])[0] - tolerance(best.shift)[0]
    return float(np.sqrt(max(float(left), 0.0)))


def on_experiment(problem: FitProblem, option: LibraryExperiment) -> FitProblem:
    """The plant and noise of a problem on the trials that an experiment would add."""
    data = as_data(problem, option.trials)
    model = Model(make_grid(data), None, problem.model)
    model.order = np.array([t.order for t in option.trials], dtype=np.float64)
    return problem.on_model(data, model, _noise(problem, model))


def _noise(problem: FitProblem, model: Model) -> Noise:
    """Noise of trials not made yet, with the scales that the data's replicates showed."""
    rows = model.grid.rows
    effects, shared = trial_columns(model, problem.data.constants)
    white = np.ones(len(rows))
    for number, block in enumerate(BLOCKS):
        here = rows.block == number
        known = problem.rows.block == number
        own = (
            problem.noise.white[known]
            - problem.rows.doubt[known] ** 2
            - problem.rows.floor[known] ** 2
        )
        each = np.maximum(own, 0.0) * problem.rows.samples[known]
        variance = float(np.median(each)) if known.any() else WHITE[block] ** 2
        white[here] = variance / rows.samples[here] + rows.doubt[here] ** 2 + rows.floor[here] ** 2
    scales = {effect.kind: effect.sd for effect in TRIAL_EFFECTS} | dict(problem.noise.scales)
    noise = Noise(np.maximum(white, 1e-9), [], [], [], scales, 0, 0)
    for group in noise.take_trials(model, effects, shared):
        scales.setdefault(group, usual(group))
    return noise
