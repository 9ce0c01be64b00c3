"""Headline parameters of fitted effects with intervals, and the smallest that would be seen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.stats import t as student

from gap.estimation.config import ESTIMATION
from gap.estimation.fit_problem import FitProblem, FitResult
from gap.estimation.information import covariance, damped_step, projected
from gap.verdict import Estimate
from plant.arrays import Array
from plant.effects.catalogue import CATALOGUE
from plant.effects.reference import MIDDLE_PRESSURE_PA

_Z95 = 1.96
_LEAST_SLOTS = 4
_MOST_CONDITION = 1e4
"""Condition of the two parts of a growth from which pressures differ too little to tell them."""


def undamped_step(problem: FitProblem, fit: FitResult) -> FitResult:
    """The fit after one last Gauss-Newton step without damping.

    Damping holds back the directions in which the data are weak, such as an effect against the
    constant that could do the same. There the prior decides. Without this step a constant may stay
    at the edge of its tolerance while the effect takes the rest.
    """
    if not fit.candidates:
        return fit
    n = len(problem.names)
    columns = problem.columns_of(fit)
    matrix, right = problem.normal(columns, fit.residual, fit.shift)
    beta = damped_step(matrix, right, 0.0)
    best = fit
    for share in (1.0, 0.5):
        shift = fit.shift + share * beta[:n]
        moved = problem.at(shift, fit.candidates, fit.amounts + share * beta[n:], fit)
        if moved.cost < best.cost:
            best = moved
            break
    cover = covariance(matrix)
    return FitResult(best.shift, best.candidates, best.amounts, best.residual, best.cost, cover)


def headline_estimates(
    problem: FitProblem,
    fit: FitResult,
    form_error: Mapping[str, float] | None = None,
    whole: bool = True,
) -> dict[str, Estimate]:
    """Headline parameters of all effects in force, keyed by parameter name.

    Shapes of one effect add up. With two effects of the same parameter name the later gets its
    id in front. With `whole`, what a constant of the same meaning took over beyond its tolerance
    counts to the effect, and the fit is settled first; without it the parameters go with the
    constants of the fit as it stands. `form_error` is the error (1 sd, of the logarithm) that
    the true form of an effect brings into its headline parameter, by catalogue id.
    """
    made: dict[str, Estimate] = {}
    n = len(problem.names)
    if whole:
        fit = undamped_step(problem, fit)
    spread = max(1.0, np.sqrt(fit.cost / max(len(problem.rows), 1)))
    for name in fit.ids:
        entry = CATALOGUE[name]
        at = [j for j, candidate in enumerate(fit.candidates) if candidate.id == name]
        if entry.headline is None:
            continue
        amount = float(fit.amounts[at].sum())
        index = [n + j for j in at]
        sd = float(np.sqrt(max(fit.cover[np.ix_(index, index)].sum(), 0.0))) * spread
        if entry.diagnosis.largest_fall:
            active = problem.active_effects(fit.shift, fit.candidates, fit.amounts)
            moved = problem.constants(fit.shift)
            fall = problem.model.largest_fall_pa(moved, active) * 1e-3
            sd = sd * fall / max(abs(amount), 1e-9)
            amount = fall
        if whole:
            taken = _share_of_constant(problem, fit, name, fit.candidates[at[0]].option)
            amount, sd = amount + taken, float(np.hypot(sd, 0.5 * taken))
        low, high = interval(
            amount, _Z95 * sd, _Z95 * (form_error or {}).get(name, ESTIMATION.form_error)
        )
        shift = entry.neutral_in(problem.data.constants)
        key = entry.headline if entry.headline not in made else f"{name}_{entry.headline}"
        made[key] = Estimate(amount + shift, low + shift, high + shift)
        option = fit.candidates[at[0]].option
        if option:
            word = entry.option_name or "where"
            made[word if word not in made else f"{name}_{word}"] = Estimate(option)
    return made


def growth_estimates(
    problem: FitProblem,
    fit: FitResult,
    form_error: Mapping[str, float] | None = None,
) -> dict[str, Estimate]:
    """How the size of each effect in force grows with pressure, where the data hold it.

    The residual without the effect is fitted by the part that is in proportion to the pressure and
    the part that is constant, all rows by their time alone: by the noise a misfit of the form in
    few rows, as after a turn, would decide. The error is that by the jackknife over slots. Not
    stated with fewer than four slots, nor where the interval holds all from constant to
    proportional.
    """
    made: dict[str, Estimate] = {}
    middle_kpa = MIDDLE_PRESSURE_PA * 1e-3
    for name in fit.ids:
        growth = CATALOGUE[name].search.growth if name in CATALOGUE else None
        own = [j for j, candidate in enumerate(fit.candidates) if candidate.id == name]
        if growth is None or growth.key not in fit.candidates[own[0]].shape:
            continue
        parts = _parts_by_slot(problem, fit, own, growth.key)
        slots = len(parts)
        whole = parts.sum(axis=0)
        if slots < _LEAST_SLOTS or np.linalg.cond(whole[:2, :2]) > _MOST_CONDITION:
            continue
        left_out_one = [np.linalg.solve(x[:2, :2], x[:2, 2])[0] for x in whole - parts]
        spread = float(np.sum((left_out_one - np.mean(left_out_one)) ** 2))
        sd = float(np.sqrt((slots - 1) / slots * spread)) / middle_kpa
        proportional, constant = np.linalg.solve(whole[:2, :2], whole[:2, 2])
        form = (form_error or {}).get(name, ESTIMATION.form_error)
        reach = float(student.ppf(0.975, slots - 2)) * sd
        value = float(proportional) / middle_kpa
        low, high = interval(value, reach, _Z95 * form)
        if low > 0.0 or high < float(proportional + constant) / middle_kpa:
            made[growth.name] = Estimate(value, low, high)
    return made


def _parts_by_slot(problem: FitProblem, fit: FitResult, own: list[int], key: str) -> Array:
    """Inner products of an effect's two parts and what it has to explain, by slot.

    In proportion to the pressure, constant, and the residual without the effect, weighted by time
    over the floor of the block; shape (slots, 3, 3). The shape is that of the largest amount.
    """
    largest = max(own, key=lambda j: abs(float(fit.amounts[j])))
    candidate = fit.candidates[largest]
    others, amounts = fit.kept(lambda one: one.id != candidate.id)
    pair = [replace(candidate, shape={**candidate.shape, key: on}) for on in (1.0, 0.0)]
    without = problem.at(fit.shift, others, np.array(amounts), fit)
    total = float(fit.amounts[own].sum())
    there = np.array([*amounts, 0.5 * total, 0.5 * total])
    columns = problem.slopes(fit.shift, [*others, *pair], there)[:, -2:]
    rows = problem.rows
    weight = np.zeros(len(rows))
    for number in np.unique(rows.block).tolist():
        here = rows.block == number
        weight[here] = rows.compared_s[here] / np.mean(problem.floor_variance[here])
    values = np.hstack([columns, without.residual[:, None]])
    units = problem.units[rows.trial]
    made = np.zeros((int(units.max()) + 1, 3, 3))
    for unit in range(len(made)):
        part = values[units == unit]
        made[unit] = part.T @ (part * weight[units == unit][:, None])
    return made[made[:, 1, 1] > 0.0]


def interval(amount: float, noise: float, form: float) -> tuple[float, float]:
    """Interval of a headline with two errors: `noise` adds to it, `form` to its logarithm.

    Each side's reaches are added in squares (Zou and Donner, Stat. Med. 27 (2008) 1693). The form
    of an effect is never exact; it makes the headline wrong by a factor, up or down alike.
    """
    ends = np.array([amount * np.exp(-form), amount * np.exp(form)])
    low, high = amount - ends.min(), ends.max() - amount
    return float(amount - np.hypot(noise, low)), float(amount + np.hypot(noise, high))


def _share_of_constant(problem: FitProblem, fit: FitResult, name: str, option: str) -> float:
    """What the constant of an effect's own meaning took of it, in the headline's unit."""
    entry = CATALOGUE[name]
    key = entry.own_constant.format(option=option)
    if key not in problem.names:
        return 0.0
    shift = float(fit.shift[problem.names.index(key)])
    if abs(shift) <= ESTIMATION.taken_over_sd:
        return 0.0
    stated, moved = problem.data.constants.value(key), problem.constants(fit.shift).value(key)
    if entry.ratio:
        at = next(j for j, s in enumerate(fit.candidates) if s.id == name)
        return (1.0 + float(fit.amounts[at])) * (moved / stated - 1.0)
    return moved - stated


def detection_limits(problem: FitProblem, alarm: float) -> dict[str, float]:
    """Smallest headline parameter of each effect that these data would have shown."""
    evidence = problem.evidence(problem.base)
    p = projected(evidence, evidence.total)
    made: dict[str, float] = {}
    for j, candidate in enumerate(problem.candidates):
        if candidate.defect or CATALOGUE[candidate.id].headline is None:
            continue
        strength = float(p[1 + j, 1 + j])
        if strength <= 1e-12:
            continue
        least = float(np.sqrt(alarm / strength))
        made[candidate.id] = min(made.get(candidate.id, np.inf), least)
    return made
