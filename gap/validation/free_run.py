"""Errors of the free-running model on held-out units: before, recalibrated, after, floor.

Stage by stage, each block is fed with what was measured. Free-running, only commands, settings and
the first pressure are fed in. A small error at each step may add up, and a large one may average
out, so both kinds are reported.
"""

from __future__ import annotations

import numpy as np

from gap.estimation.cross_validation import HeldOut, left_out
from gap.estimation.fit_problem import FitProblem, FitResult
from gap.validation.chain import Chain
from gap.validation.shapley import replicate_tables
from plant.arrays import Array


def free_running(problem: FitProblem, fit: FitResult) -> dict[str, HeldOut]:
    """Squared errors by kind of end on held-out slots; see `gap.estimation.cross_validation.Held`.

    Constants and amounts are those fitted to all other slots. The floor is what replicates of a
    slot differ by at the same end.
    """
    chain = Chain(problem, fit)
    named = bool(fit.candidates)
    n = len(problem.names)
    base = left_out(problem, problem.base, problem.units).change
    fits = left_out(problem, fit, problem.units).change if named else base
    count = int(problem.units.max(initial=-1)) + 1
    untouched = chain.free(np.zeros(n), None)
    made = {
        end: {name: np.zeros(count) for name in ("before", "recalibrated", "after", "weight")}
        for end in untouched
    }
    for unit in range(count):
        recalibrated = chain.free(problem.base.shift + base[unit], None)
        after = recalibrated
        if named:
            amounts = fit.amounts + fits[unit, n:]
            bounds = np.array([s.bounds for s in fit.candidates])
            amounts = np.clip(amounts, bounds[:, 0], bounds[:, 1])
            after = chain.free(fit.shift + fits[unit, :n], amounts)
        for end, table in made.items():
            at = chain.rows_of(end)
            own = problem.units[problem.rows.trial[at]] == unit
            span = problem.rows.compared_s[at][own]
            table["weight"][unit] = span.sum()
            for name, ran in (
                ("before", untouched), ("recalibrated", recalibrated), ("after", after),
            ):  # fmt: skip
                table[name][unit] = span @ chain.of_rows(end, ran[end])[own] ** 2
    return {
        end: HeldOut(
            table["before"], table["recalibrated"], table["after"],
            _floor(chain, end, untouched[end], table["weight"]), table["weight"],
        )
        for end, table in made.items()
    }  # fmt: skip


def _floor(chain: Chain, end: str, values: Array, weight: Array) -> Array:
    """What replicates differ by at an end, as squared errors of each slot.

    Slots without replicates get the mean of the others; without any, the noise model's variance.
    """
    made = np.full(len(weight), np.nan)
    for slot, table, span in replicate_tables(chain, end, values):
        if len(table) > 1:
            variance = float(span @ table.var(axis=0, ddof=1)) / max(float(span.sum()), 1e-12)
            made[slot] = variance * weight[slot]
    known = np.isfinite(made)
    if known.any():
        usual = float(made[known].sum() / max(float(weight[known].sum()), 1e-12))
    else:
        usual = float(np.mean(chain.problem.floor_variance[chain.rows_of(end)]))
    return np.where(known, made, usual * weight)
