"""What one would use instead, on the same data: naive selection without a noise model or a null.

Each gets the same features, nominal constants and signatures as the diagnosis, and does with
them what is usually done: independent errors and BIC, random cross-validation, sequentially
thresholded least squares (Brunton, Proctor and Kutz, PNAS 113 (2016) 3932), or a fixed guess. One
gets the noise of the replicates as well: a posterior over effects with a model discrepancy
(`spike_and_slab`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gap.check.scoring.spike_and_slab import by_posterior
from gap.data.reader import read_dataset
from gap.decision.diagnose import candidates_without
from gap.estimation.fit_problem import FitProblem
from gap.model.sensitivities import candidate_columns
from plant.effects.catalogue import CATALOGUE

Floats = np.ndarray
BIC_GAIN = 10.0
FOLDS = 5
THRESHOLD = 0.15


@dataclass(frozen=True)
class Features:
    """Rows of one data set: residual of the plain plant, constants and candidates as columns.

    Every block of rows (pressure, force, ...) is divided by the scatter it has after the
    constants are fitted freely, so that units do not decide. `keys` is (id, family) a candidate.
    """

    residual: Floats
    constants: Floats
    candidates: Floats
    keys: tuple[tuple[str, str], ...]


def features(problem: FitProblem) -> Features:
    """The rows of a data set: what the diagnosis itself compares, before any weighting."""
    allowed = [s for s in problem.candidates if not s.defect]
    columns = candidate_columns(
        problem.model, problem.data.constants, problem.stated_effects, allowed
    )
    residual, constants = problem.stated_residual.copy(), problem.columns.copy()
    left = residual - constants @ np.linalg.lstsq(constants, residual, rcond=None)[0]
    scale = np.ones(len(residual))
    for block in np.unique(problem.rows.block):
        here = problem.rows.block == block
        scale[here] = max(float(np.sqrt(np.mean(left[here] ** 2))), 1e-9)
    shown = np.linalg.norm(columns, axis=0) > 1e-9
    keys = tuple((s.id, s.family) for s, ok in zip(allowed, shown, strict=True) if ok)
    return Features(
        residual / scale, constants / scale[:, None], columns[:, shown] / scale[:, None], keys
    )


def left_over(y: Floats, columns: Floats) -> float:
    """Sum of squares that ordinary least squares leaves."""
    fit = columns @ np.linalg.lstsq(columns, y, rcond=None)[0]
    return float(np.sum((y - fit) ** 2))


def by_bic(f: Features) -> int | None:
    """The candidate with the lowest BIC under independent errors, if it gains more than 10."""
    rows = len(f.residual)
    plain = left_over(f.residual, f.constants)
    gains = []
    for j in range(len(f.keys)):
        one = left_over(f.residual, np.column_stack([f.constants, f.candidates[:, j]]))
        gains.append(rows * np.log(plain / max(one, 1e-12)) - np.log(rows))
    best = int(np.argmax(gains))
    return best if gains[best] > BIC_GAIN else None


def by_random_folds(f: Features) -> int | None:
    """The candidate with the lowest error over random folds, if it gains more than its error."""
    rng = np.random.default_rng(0)
    fold = rng.permutation(len(f.residual)) % FOLDS

    def errors(columns: Floats) -> Floats:
        out = []
        for k in range(FOLDS):
            train, test = fold != k, fold == k
            fit = np.linalg.lstsq(columns[train], f.residual[train], rcond=None)[0]
            out.append(float(np.mean((f.residual[test] - columns[test] @ fit) ** 2)))
        return np.array(out)

    plain = errors(f.constants)
    best, gain = None, 0.0
    for j in range(len(f.keys)):
        drop = plain - errors(np.column_stack([f.constants, f.candidates[:, j]]))
        if drop.mean() > max(gain, float(drop.std(ddof=1) / np.sqrt(FOLDS))):
            best, gain = j, float(drop.mean())
    return best


def by_sparse_regression(f: Features) -> list[int]:
    """Suspects that survive thresholding of standardised coefficients, largest first."""
    basis, _ = np.linalg.qr(f.constants)
    clear = f.candidates - basis @ (basis.T @ f.candidates)
    norm = np.linalg.norm(clear, axis=0)
    usable = norm > 1e-6 * np.linalg.norm(f.candidates, axis=0)
    y = f.residual - basis @ (basis.T @ f.residual)
    size = float(np.linalg.norm(y))
    active = np.flatnonzero(usable)
    weight = np.zeros(len(f.keys))
    for _ in range(10):
        if not len(active):
            return []
        scaled = clear[:, active] / norm[active]
        ridge = scaled.T @ scaled + 1e-3 * np.eye(len(active))
        coefficient = np.linalg.solve(ridge, scaled.T @ y) / max(size, 1e-12)
        kept = np.abs(coefficient) >= THRESHOLD
        weight[:] = 0.0
        weight[active[kept]] = coefficient[kept]
        if kept.all():
            break
        active = active[kept]
    order = np.argsort(-np.abs(weight))
    return [int(j) for j in order if weight[j] != 0.0]


def verdict_of(keys: Sequence[tuple[str, str]]) -> dict[str, Any]:
    """A naive method's word in the exchange form: it is always sure."""
    if not keys:
        return {"status": "no_gap_above_floor", "stage": None, "effects": [],
                "probability_none": 1.0, "probability_unknown": 0.0}  # fmt: skip
    ids = list(dict.fromkeys(k for k, _ in keys))
    explanation = {"ids": ids, "family": keys[0][1], "probability": 1.0, "parameters": {}}
    return {"status": "named", "stage": stage_of(ids[0]), "effects": [explanation],
            "probability_none": 0.0, "probability_unknown": 0.0}  # fmt: skip


def stage_of(name: str) -> str:
    """Stage of a catalogue entry."""
    return str(CATALOGUE[name].stage)


def problem_of(folder: Path, without: Sequence[str]) -> FitProblem:
    """A data set as the diagnosis has it before its search."""
    return FitProblem.of(read_dataset(folder), candidates_without(without))


def methods(problem: FitProblem) -> dict[str, Callable[[], dict[str, Any]]]:
    """What gives each baseline's verdict, by name."""
    f = features(problem)

    def named(indices: Sequence[int | None]) -> dict[str, Any]:
        return verdict_of([f.keys[j] for j in indices if j is not None])

    return {
        "BIC, independent errors": lambda: named([by_bic(f)]),
        "random cross-validation": lambda: named([by_random_folds(f)]),
        "sparse regression": lambda: named(by_sparse_regression(f)),
        "posterior with discrepancy": lambda: by_posterior(problem),
        ALWAYS: always_friction,
    }


ALWAYS = "always friction"


def always_friction() -> dict[str, Any]:
    """The fixed guess."""
    friction = next(e for e in CATALOGUE.values() if e.family == "friction")
    return verdict_of([(friction.id, friction.family)])


def baseline_verdicts(folder: Path, without: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Verdicts of all baselines on one folder; the guess alone where the data cannot be read."""
    try:
        return {name: made() for name, made in methods(problem_of(folder, without)).items()}
    except Exception:  # a baseline that cannot read the data has nothing to say
        return {ALWAYS: always_friction()}
