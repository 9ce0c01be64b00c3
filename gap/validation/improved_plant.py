"""The improved plant as a TOML file: what `pamrig gap shrink --out` writes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from gap.estimation.fit_problem import FitProblem, FitResult
from gap.estimation.intervals import headline_estimates, undamped_step
from gap.output import toml_value
from gap.verdict import EmpiricalTerm
from plant.constants import CHOICES, KEYS, nominal
from plant.effects.catalogue import CATALOGUE
from plant.effects.empirical import Correction


def improved_plant(
    problem: FitProblem, fit: FitResult, empirical: EmpiricalTerm | None = None
) -> str:
    """The improved plant as TOML: recalibrated and stated constants, and a table for each effect.

    The simulator (`pamrig simulate --plant`), the live prediction (`--predict`), the virtual bench
    and `bench.toml` read it; with an empirical term only `bench.toml` and the law without time.
    """
    fit = undamped_step(problem, fit) if empirical is None else _moved(fit, empirical)
    lines = ["# The plant as recalibrated on these data, with the effects that explain the gap."]
    constants = problem.constants(fit.shift)
    usual = nominal()
    lines += [
        f"{name} = {_within(name, constants.value(name)):.8g}"
        for name in constants.keys
        if name in problem.names or constants.value(name) != usual.value(name)
    ]
    lines += [
        f'{name} = "{getattr(constants, name)}"'
        for name in CHOICES
        if getattr(constants, name) != getattr(usual, name)
    ]
    for name in dict.fromkeys([*problem.data.effects.values, *fit.ids]):
        if name not in CATALOGUE:
            continue
        single = [s for s in fit.candidates if s.id == name and s.single]
        lines += [f"# {name}, {s.option}: correct it in trials.csv" for s in single]
        if single and name not in problem.data.effects.values:
            continue
        lines += ["", f"[effects.{name}]"]
        entry = CATALOGUE[name]
        if name not in fit.ids:
            lines += [
                f"{k} = {toml_value(v)}" for k, v in problem.data.effects.values[name].items()
            ]
            continue
        known = {parameter.name: parameter for parameter in entry.parameters}
        for key, estimate in headline_estimates(problem, only(fit, name), whole=False).items():
            value = estimate.value
            if isinstance(value, str):
                lines.append(f'{key} = "{value}"')
            elif key in known:
                if key == entry.headline:
                    value += _stated_amount(problem, fit, name)
                value = min(max(value, known[key].low), known[key].high)
                lines.append(f"{key} = {value:.6g}")
        for key, value in _shape(problem, fit, name).items():
            value = min(max(value, known[key].low), known[key].high)
            lines.append(f"{key} = {value:.4g}")
    corrections = dict(problem.data.corrections.of)
    if empirical is not None:
        correction = empirical.correction
        stated = corrections.get(correction.block, Correction(correction.block, ()))
        corrections[correction.block] = replace(correction, terms=stated.terms + correction.terms)
        lines += ["", *_described(empirical)]
    for correction in corrections.values():
        lines += ["", *_correction_lines(correction)]
    return "\n".join(lines) + "\n"


def _within(name: str, value: float) -> float:
    """A constant as far as a plant file takes it: a large gap without a name can lead it beyond."""
    return min(max(value, KEYS[name].low), KEYS[name].high)


def _moved(fit: FitResult, term: EmpiricalTerm) -> FitResult:
    """The fit with constants and amounts as they were fitted together with the term."""
    n = len(fit.shift)
    return replace(fit, shift=fit.shift + term.moved[:n], amounts=fit.amounts + term.moved[n:])


def _described(term: EmpiricalTerm) -> list[str]:
    """What a reader of the file should know of a term that is no physics."""
    shares = ", ".join(f"{name} {100 * share:.0f} %" for name, share in term.shares.items())
    shares = shares or "no input"
    told = [f"# Slot {term.told_by} alone tells of it, and is not counted."] if term.told_by else []
    return [
        "# Empirical: what is left of the gap has no name. Held at its edge beyond its knots.",
        f"# It depends on {shares}; on slots held out it closes {100 * term.closed:.0f} % of the",
        f"# gap ({100 * term.closed_low:.0f} to {100 * term.closed_high:.0f}).",
        *told,
    ]


def _correction_lines(correction: Correction) -> list[str]:
    table = correction.as_config()
    name = f"empirical.{correction.block}"
    lines = [f"[{name}]", f"unit = {toml_value(table['unit'])}"]
    for term in table["terms"]:
        lines += [f"[[{name}.terms]]", *(f"{k} = {toml_value(v)}" for k, v in term.items())]
    return lines


def _stated_amount(problem: FitProblem, fit: FitResult, name: str) -> float:
    """What `bench.toml` states of an effect already, where it is on the same side or edge."""
    table = problem.data.effects.values.get(name)
    if table is None:
        return 0.0
    word = next((str(v) for v in table.values() if isinstance(v, str)), "")
    option = next(s.option for s in fit.candidates if s.id == name)
    return CATALOGUE[name].amount(table, problem.data.constants) if word == option else 0.0


def _shape(problem: FitProblem, fit: FitResult, name: str) -> Mapping[str, float]:
    """Shape parameters of the plant's form of an effect, where the fitted shape gives them."""
    own = [(float(a), s) for s, a in zip(fit.candidates, fit.amounts, strict=True) if s.id == name]
    shape = max(own, key=lambda one: abs(one[0]))[1].shape
    search = CATALOGUE[name].search
    context = problem.model.context(problem.constants(fit.shift), fit.active)
    made = dict(search.as_plant(shape, context)) if search.as_plant is not None else {}
    growth = search.growth
    if growth is not None and growth.key in shape:
        total = sum(amount for amount, _ in own)
        grown = sum(amount * one.shape[growth.key] for amount, one in own)
        made[growth.share] = grown / total if total else shape[growth.key]
    return made


def only(fit: FitResult, name: str) -> FitResult:
    """The fit with the candidates of one effect, for its parameters."""
    at = [j for j, candidate in enumerate(fit.candidates) if candidate.id == name]
    n = len(fit.shift)
    index = [*range(n), *(n + j for j in at)]
    return FitResult(
        fit.shift, tuple(fit.candidates[j] for j in at), fit.amounts[at], fit.residual,
        fit.cost, fit.cover[np.ix_(index, index)],
    )  # fmt: skip
