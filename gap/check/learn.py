"""Learn from practice sets how far an explanation is to be believed: makes `gap/belief.toml`.

    python -m gap.check.learn out/practice/results.jsonl

Practice sets only: those of the reserved stream score the diagnosis and never teach it.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize

from blind.seal import opened
from blind.sets import BLOCK
from gap.belief import FEATURES, OUTCOMES, Array, Weights, features, kind_of
from gap.check.errors import CheckError
from gap.check.score import parameter_row
from gap.check.totals import CLEAR
from plant.catalogue import CATALOGUE

FOLDS = 10
RIDGE = 4.0
"""Weight of the prior that no feature matters, in sets."""
LEAN = 1.0
"""Sets that the mean over all entries counts for."""
LEAST_ERROR = 0.04
MOST_ERROR = 0.8


@dataclass(frozen=True)
class Samples:
    """Explanations of one kind: features, shape (sets, features), outcomes and weights (sets,)."""

    x: Array
    y: npt.NDArray[np.int64]
    weight: Array


def samples(lines: Sequence[dict[str, Any]]) -> dict[str, Samples]:
    """Features and outcomes of all sets in which something was explained, by kind of explanation.

    A set counts as often as its kind (single, pair, ...) has a place in the mixture of the blind
    check, however many of that kind were made for practice.
    """
    kinds = [line["score"]["kind"] for line in lines]
    made: dict[str, tuple[list[list[float]], list[int], list[float]]] = {
        kind: ([], [], []) for kind in FEATURES
    }
    for line in lines:
        score, verdict = line["score"], line["verdict"]
        if score["stream"] != "practice":
            raise CheckError("learn", f"set {score['number']} is of the {score['stream']} stream")
        evidence = verdict.get("evidence") or {}
        traits, found = evidence.get("traits"), evidence.get("found")
        if score["kind"] in ("unfit", "nominal") or not traits or not found:
            continue
        hidden = set(score["hidden"]) if score["truth"] == "effects" else set()
        if not hidden:
            outcome = "unknown"
        elif set(found) == hidden:
            outcome = "right"
        else:
            outcome = "part" if hidden & set(found) else "other"
        kind = kind_of(traits)
        x, y, weight = made[kind]
        known = features(traits)
        x.append([known[name] for name in FEATURES[kind]])
        y.append(OUTCOMES.index(outcome))
        share = kinds.count(score["kind"]) / len(kinds)
        weight.append(BLOCK.count(score["kind"]) / len(BLOCK) / share)
    return {
        kind: Samples(np.array(x), np.array(y, dtype=np.int64), np.array(w) / np.mean(w))
        for kind, (x, y, w) in made.items()
    }


def fit(of: Samples) -> Weights:
    """Multinomial logistic regression with a ridge, on standardised features."""
    mean = np.average(of.x, axis=0, weights=of.weight)
    spread = np.sqrt(np.average((of.x - mean) ** 2, axis=0, weights=of.weight))
    spread = np.maximum(spread, 1e-6)
    z = np.hstack([np.ones((len(of.x), 1)), np.clip((of.x - mean) / spread, -4.0, 4.0)])
    shape = (len(OUTCOMES), z.shape[1])
    target = np.eye(len(OUTCOMES))[of.y]

    def loss(flat: Array) -> tuple[float, Array]:
        weights = flat.reshape(shape)
        scores = z @ weights.T
        scores -= scores.max(axis=1, keepdims=True)
        odds = np.exp(scores)
        p = odds / odds.sum(axis=1, keepdims=True)
        cost = -float(np.sum(of.weight[:, None] * target * np.log(np.maximum(p, 1e-12))))
        cost += 0.5 * RIDGE * float(np.sum(weights[:, 1:] ** 2))
        slope = ((p - target) * of.weight[:, None]).T @ z
        slope[:, 1:] += RIDGE * weights[:, 1:]
        return cost, slope.ravel()

    found = minimize(loss, np.zeros(shape[0] * shape[1]), jac=True, method="L-BFGS-B")
    return Weights(mean, spread, found.x.reshape(shape))


def crossed(of: Samples) -> Array:
    """Probabilities of each set by a fit to the other folds, shape (sets, outcomes)."""
    made = np.zeros((len(of.x), len(OUTCOMES)))
    fold = np.random.default_rng(0).permutation(len(of.x)) % FOLDS
    for k in range(FOLDS):
        rest = fold != k
        weights = fit(Samples(of.x[rest], of.y[rest], of.weight[rest]))
        for i in np.flatnonzero(~rest):
            made[i] = weights.of(of.x[i])
    return made


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


def as_toml(kinds: Mapping[str, Weights], form: Mapping[str, float], sets: int) -> str:
    """The coefficients as the file that ships."""

    def row(values: Array) -> str:
        return "[" + ", ".join(f"{v:.5g}" for v in values) + "]"

    made = (
        f"# Made by `python -m gap.check.learn` from {sets} explanations of practice sets; do not "
        f"edit.\n# Rows of weights: {', '.join(OUTCOMES)}. First column: constant.\n"
    )
    for kind, of in kinds.items():
        names = ", ".join(f'"{name}"' for name in FEATURES[kind])
        weights = ",\n  ".join(row(w) for w in of.weights)
        made += (
            f"\n[{kind}]\nfeatures = [{names}]\nmean = {row(of.mean)}\n"
            f"spread = {row(of.spread)}\nweights = [\n  {weights},\n]\n"
        )
    made += "\n# What other forms of an effect do to its headline, relative, one sd.\n[form]\n"
    return made + "".join(f"{name} = {value:.3g}\n" for name, value in form.items())


def main(paths: Sequence[str]) -> int:
    """Learn from results files and write the shipped coefficients."""
    lines = [json.loads(text) for path in paths for text in Path(path).read_text().splitlines()]
    kinds = samples(lines)
    for kind, of in kinds.items():
        p = crossed(of)
        counts = dict(
            zip(OUTCOMES, np.bincount(of.y, minlength=len(OUTCOMES)).tolist(), strict=True)
        )
        loss = -np.average(np.log(p[np.arange(len(of.y)), of.y]), weights=of.weight)
        print(f"{kind}: {counts}, log loss of sets not learnt from {loss:.3f}")
        for least in (0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9):
            # A name is wrong where nothing of it is hidden.
            sure = p[:, 0] + p[:, 1] >= least
            w = of.weight[sure]
            wrong = float(w[of.y[sure] >= 2].sum() / max(w.sum(), 1e-9))
            unknown = of.y == OUTCOMES.index("unknown")
            flagged = p[:, 3] >= least
            print(
                f"  named from {least:.1f}: {sure.sum()} sets, {100 * wrong:.1f} % wrong; "
                f"unknown from {least:.1f}: {int((flagged & unknown).sum())} of {unknown.sum()}, "
                f"{int((flagged & ~unknown).sum())} of {(~unknown).sum()} in error"
            )
    target = Path(__file__).parents[1] / "belief.toml"
    count = sum(len(of.x) for of in kinds.values())
    made = as_toml({kind: fit(of) for kind, of in kinds.items()}, form_errors(lines), count)
    target.write_text(made, encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
