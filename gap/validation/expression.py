"""A short formula for an empirical term: sparse regression on a small library of terms.

Greedy forward selection by the error on slots held out (orthogonal matching pursuit; sparse
libraries for laws from data: Brunton, Proctor and Kutz 2016). Stated only where it predicts those
slots as well as the splines do, to within one standard error.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from gap.estimation.cross_validation import floor_squares
from gap.estimation.fit_problem import FitProblem, FitResult
from gap.model.empirical import inputs_of, scales_of, waves_at
from gap.model.features import BLOCKS, UNITS
from gap.validation.config import ValidationConfig
from gap.validation.terms.held_out_terms import HeldOutTerms, Whole, gain_and_errors
from gap.verdict import Expression
from plant.arrays import Array
from plant.effects.empirical import IN_GAS, OF_CELL, SHIFTS_S, Correction

_DECAYS_S = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0)
_DECAYS_KPA = (30.0, 100.0, 300.0)
_SHORT = {
    "pressure_kpa": ("p", "kPa"), "length_mm": ("L", "mm"), "velocity_mm_s": ("v", "mm/s"),
    "pressure_rate_kpa_s": ("dp/dt", "kPa/s"), "temperature_c": ("T", "°C"),
    "order": ("order", ""), "time_s": ("t", "s"), "since_edge_s": ("t_edge", "s"),
    "valve": ("valve", ""), "openings": ("openings", ""), "slip": ("slip", ""),
    "change_1s_kpa": ("p - mean of 1 s", "kPa"), "change_10s_kpa": ("p - mean of 10 s", "kPa"),
    "pull_change_1s_n": ("F - mean of 1 s", "N"), "pull_change_10s_n": ("F - mean of 10 s", "N"),
    "pull_change_100s_n": ("F - mean of 100 s", "N"),
    **{
        name: (f"(L in {1e3 * s:.0f} ms - L)" if s > 0 else f"(L - L {-1e3 * s:.0f} ms ago)", "mm")
        for name, s in SHIFTS_S.items()
    },
}  # fmt: skip
_BOTH_SIDES = 0.1
"""Share of its range that an input must have on either side of zero for zero to be its middle."""
_SCALE_UNITS = {"pull": "", "pull_per_kpa": "kPa", "pull_per_mm": "mm", "seen": "mm"}


@dataclass(frozen=True)
class _Word:
    """One term of the library: its text and its values."""

    text: str
    values: Array


def compact_expression(
    problem: FitProblem, fit: FitResult, splines: Array, nothing: Array, correction: Correction,
    config: ValidationConfig,
) -> Expression | None:  # fmt: skip
    """A formula in the inputs of a correction; None where none does nearly as well.

    None for a flow, too: what is read is its sum over time; and for an error of the force cell,
    which shows in a load as well.

    Args:
        splines: squared errors of the correction on held-out slots, shape (slots,).
        nothing: those of the plant without it, shape (slots,).
    """
    block = correction.block
    at = inputs_of(problem.grid, block, correction.inputs)
    if not at or any(term.scale in (*IN_GAS, *OF_CELL) for term in correction.terms):
        return None
    scales = scales_of(problem.grid, block, problem.constants(fit.shift))
    scales[""] = np.ones(len(next(iter(at.values()))))
    used = dict.fromkeys(term.scale for term in correction.terms)
    words, text = _library(at)
    words += _waves(problem, correction)
    library = [(scale, word, word.values * scales[scale]) for scale in used for word in words]
    columns = np.stack([values for _, _, values in library], axis=1)
    size = np.sqrt(np.maximum(np.mean(columns**2, axis=0), 1e-300))
    columns = columns / size
    rms = float(np.sqrt(np.mean(fit.residual[problem.rows.block == BLOCKS.index(block)] ** 2)))
    prior = np.eye(columns.shape[1]) / (4.0 * config.term_sd * max(rms, 1e-9)) ** 2
    terms = HeldOutTerms.of(problem, fit, block, columns, prior)
    chosen, errors = _greedy(terms, config)
    if not len(chosen):
        return None
    lost, sure = gain_and_errors(errors, splines)
    floor = floor_squares(problem, problem.units)[block][list(terms.slots)]
    if sure > 1.0 and lost > 0.0:
        return None
    weights = terms.coefficients(chosen) / size[chosen]
    parts: dict[str, list[str]] = {}
    for k, weight in zip(chosen.tolist(), weights.tolist(), strict=True):
        scale, word, _ = library[k]
        parts.setdefault(scale, []).append(f"{weight:+.3g} {word.text}".removesuffix(" 1"))
    written = " + ".join(_summed(scale, own, UNITS[block]) for scale, own in parts.items())
    where = "; ".join(line for name, line in text.items() if name in written)
    closed = float((nothing - errors).sum() / max(float((nothing - floor).sum()), 1e-300))
    return Expression(f"{written}, {where}" if where else written, closed)


def _waves(problem: FitProblem, correction: Correction) -> list[_Word]:
    """Cosine and sine of the periods with which a correction repeats, in the mean over each row."""
    made = []
    for name, period in correction.periods:
        short, unit = _SHORT[name]
        columns = waves_at(problem.grid, correction.block, name, period)
        for k, values in enumerate(columns.T):
            turn, wave = period / (k // 2 + 1), ("cos", "sin")[k % 2]
            made.append(_Word(f"{wave}(2 pi {short}/{turn:.4g} {unit})", values))
    return made


def _summed(scale: str, parts: list[str], unit: str) -> str:
    """Terms of one scale with their unit: pull_per_kpa (-3.2 x_p +1.1 x_p^2 kPa)."""
    if not scale:
        return f"{' '.join(parts)} {unit}"
    inner = f"{' '.join(parts)} {_SCALE_UNITS[scale]}".strip()
    return f"{scale} ({inner})"


def _greedy(terms: HeldOutTerms, config: ValidationConfig) -> tuple[Whole, Array]:
    """Columns that lower the error on held-out slots for sure, one at a time, and that error."""
    chosen: Whole = np.empty(0, dtype=np.int64)
    errors = terms.errors(chosen)
    for _ in range(config.most_words):
        tried = [
            (np.r_[chosen, k], terms.errors(np.r_[chosen, k]))
            for k in range(terms.penalty.shape[0])
            if k not in chosen
        ]
        best = min(tried, key=lambda one: float(one[1].sum()), default=None)
        if best is None or gain_and_errors(errors, best[1])[1] <= 1.0:
            break
        chosen, errors = best
    return chosen, errors


def _library(at: dict[str, Array]) -> tuple[list[_Word], dict[str, str]]:
    """Terms in inputs brought to -1 to 1, and what each stands for: x_p = (p - 250 kPa)/250 kPa."""
    words: list[_Word] = []
    scaled: dict[str, Array] = {}
    text: dict[str, str] = {}
    for name, x in at.items():
        short, unit = _SHORT[name]
        low, high = float(x.min()), float(x.max())
        if min(-low, high) > _BOTH_SIDES * (high - low):
            middle, half = 0.0, max(-low, high)
        else:
            middle, half = 0.5 * (low + high), 0.5 * (high - low)
        middle, half = float(f"{middle:.3g}"), float(f"{half:.3g}")
        label = f"x_{name.split('_')[0] if len(short) > 2 else short}"
        scaled[label] = (x - middle) / half
        gap = f"({short} - {middle:g})" if middle else short
        text[label] = f"{label} = {gap}/{half:g} {unit}".rstrip()
        words += [_Word(label, scaled[label]), _Word(f"{label}^2", scaled[label] ** 2)]
        words.append(_Word(f"{label}^3", scaled[label] ** 3))
        if not middle:
            words += [
                _Word(f"|{label}|", np.abs(scaled[label])),
                _Word(f"sign({label})", np.sign(scaled[label])),
                _Word(f"{label} |{label}|", scaled[label] * np.abs(scaled[label])),
            ]
        if name in ("time_s", "since_edge_s"):
            words += [_Word(f"exp(-{short}/{d:g} s)", np.exp(-x / d)) for d in _DECAYS_S]
        if name == "pressure_kpa":
            words += [_Word(f"exp(-p/{d:g} kPa)", np.exp(-x / d)) for d in _DECAYS_KPA]
    for one, two in combinations(scaled, 2):
        words += [
            _Word(f"{one} {two}", scaled[one] * scaled[two]),
            _Word(f"{one}^2 {two}", scaled[one] ** 2 * scaled[two]),
            _Word(f"{one} {two}^2", scaled[one] * scaled[two] ** 2),
        ]
    if words:
        words.append(_Word("1", np.ones_like(words[0].values)))
    return words, text
