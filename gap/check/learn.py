"""Learn from practice sets how far an explanation is to be believed: makes `gap/belief.toml`.

    python -m gap.check.learn out/practice/results.jsonl

Practice sets only: those of the reserved stream score the diagnosis and never teach it.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize

from blind.seal import opened
from gap.belief import FEATURES, OUTCOMES, Array, Belief, features
from gap.check.errors import CheckError
from gap.check.score import parameter_row
from gap.check.totals import CLEAR
from plant.catalogue import CATALOGUE

FOLDS = 10
RIDGE = 10.0
"""Weight of the prior that no feature matters, in sets."""
LEAN = 1.0
"""Sets that the mean over all entries counts for."""
LEAST_ERROR = 0.04
MOST_ERROR = 0.8


def samples(lines: Sequence[dict[str, Any]]) -> tuple[Array, Array]:
    """Features and outcomes of all sets in which something was explained.

    Returns:
        Features, shape (sets, features), and the number of each outcome, shape (sets,).
    """
    x, y = [], []
    for line in lines:
        score, verdict = line["score"], line["verdict"]
        if score["stream"] != "practice":
            raise CheckError("learn", f"set {score['number']} is of the {score['stream']} stream")
        traits = (verdict.get("evidence") or {}).get("traits")
        found = (verdict.get("evidence") or {}).get("found")
        if score["kind"] in ("unfit", "nominal") or not traits or not found:
            continue
        hidden = set(score["hidden"]) if score["truth"] == "effects" else set()
        if score["truth"] == "effects":
            outcome = "right" if set(found) == hidden else "other"
        else:
            outcome = "unknown"
        x.append(features(traits))
        y.append(OUTCOMES.index(outcome))
    return np.array(x), np.array(y)


def fit(x: Array, y: Array) -> Belief:
    """Multinomial logistic regression with a ridge, on standardised features."""
    mean, spread = x.mean(axis=0), np.maximum(x.std(axis=0), 1e-6)
    z = np.hstack([np.ones((len(x), 1)), np.clip((x - mean) / spread, -4.0, 4.0)])
    shape = (len(OUTCOMES), z.shape[1])
    target = np.eye(len(OUTCOMES))[y]

    def loss(flat: Array) -> tuple[float, Array]:
        weights = flat.reshape(shape)
        scores = z @ weights.T
        scores -= scores.max(axis=1, keepdims=True)
        odds = np.exp(scores)
        p = odds / odds.sum(axis=1, keepdims=True)
        cost = -float(np.sum(target * np.log(np.maximum(p, 1e-12))))
        cost += 0.5 * RIDGE * float(np.sum(weights[:, 1:] ** 2))
        slope = (p - target).T @ z
        slope[:, 1:] += RIDGE * weights[:, 1:]
        return cost, slope.ravel()

    found = minimize(loss, np.zeros(shape[0] * shape[1]), jac=True, method="L-BFGS-B")
    return Belief(mean, spread, found.x.reshape(shape))


def crossed(x: Array, y: Array) -> Array:
    """Probabilities of each set by a fit to the other folds, shape (sets, outcomes)."""
    made = np.zeros((len(x), len(OUTCOMES)))
    fold = np.random.default_rng(0).permutation(len(x)) % FOLDS
    for k in range(FOLDS):
        belief = fit(x[fold != k], y[fold != k])
        for i in np.flatnonzero(fold == k):
            made[i] = _weigh(belief, x[i])
    return made


def _weigh(belief: Belief, x: Array) -> Array:
    z = np.r_[1.0, np.clip((x - belief.mean) / belief.spread, -4.0, 4.0)]
    scores = belief.weights @ z
    odds = np.exp(scores - scores.max())
    return np.asarray(odds / odds.sum())


def form_errors(lines: Sequence[dict[str, Any]]) -> dict[str, float]:
    """Relative error of each entry's headline that other forms of the effect bring, one sd.

    From clear single effects whose best explanation was right; entries with few sets lean towards
    the rest.
    """
    errors: dict[str, list[float]] = {}
    for line in lines:
        score, verdict = line["score"], line["verdict"]
        best = (verdict.get("effects") or [None])[0]
        if score["kind"] not in ("single", "degenerate") or score["size"] < CLEAR or best is None:
            continue
        if best["ids"] != score["hidden"]:
            continue
        row = parameter_row(opened(line["envelope"], line["seal"]), best)
        if "error" in row:
            errors.setdefault(best["ids"][0], []).append(min(abs(row["error"]), MOST_ERROR))
    every = [e for found in errors.values() for e in found]
    usual = float(np.mean(np.square(every))) if every else 0.01
    made = {}
    for name in CATALOGUE:
        own = np.square(errors.get(name, []))
        mean = (LEAN * usual + float(own.sum())) / (LEAN + len(own))
        made[name] = max(float(np.sqrt(mean)), LEAST_ERROR)
    return made


def as_toml(belief: Belief, form: Mapping[str, float], sets: int) -> str:
    """The coefficients as the file that ships."""

    def row(values: Array) -> str:
        return "[" + ", ".join(f"{v:.5g}" for v in values) + "]"

    weights = ",\n  ".join(row(w) for w in belief.weights)
    names = ", ".join(f'"{name}"' for name in FEATURES)
    return (
        f"# Made by `python -m gap.check.learn` from {sets} practice sets; do not edit.\n"
        f"features = [{names}]\nmean = {row(belief.mean)}\nspread = {row(belief.spread)}\n"
        f"# Rows: {', '.join(OUTCOMES)}. First column: constant.\nweights = [\n  {weights},\n]\n"
        "\n# What other forms of an effect do to its headline, relative, one sd.\n[form]\n"
        + "".join(f"{name} = {value:.3g}\n" for name, value in form.items())
    )


def main(paths: Sequence[str]) -> int:
    """Learn from results files and write the shipped coefficients."""
    lines = [json.loads(text) for path in paths for text in Path(path).read_text().splitlines()]
    x, y = samples(lines)
    p = crossed(x, y)
    print(f"{len(x)} explanations: {np.bincount(y, minlength=len(OUTCOMES)).tolist()} {OUTCOMES}")
    print(f"log loss, crossed: {-np.mean(np.log(p[np.arange(len(y)), y])):.3f}")
    for least in (0.5, 0.6, 0.7, 0.8, 0.9):
        sure = p[:, 0] >= least
        print(
            f"right with {least:.1f} or more: {sure.sum()} sets, {np.mean(y[sure] == 0):.3f} right"
        )
    target = Path(__file__).parents[1] / "belief.toml"
    target.write_text(as_toml(fit(x, y), form_errors(lines), len(x)), encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
