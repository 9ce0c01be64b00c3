"""Learn what speaks for an effect by itself: makes `gap/decision/presence.toml`.

    pamrig gap check --stream practice --sets 10000-10239 --no-baselines --out out/practice
    python -m gap.check.several --sets 100-139 --out out/several.jsonl
    python -m gap.check.several --sets 100-109 --strike --out out/several.jsonl
    python -m gap.check.presence out/practice/results.jsonl out/several.jsonl --write

A logistic regression over all effects of all best explanations: is the effect hidden in the set?
Sets whose hidden effect was struck from the catalogue, sets with an effect from outside it and sets
without a gap say what a stand-in looks like; struck effects that others mimic to more than 0.9 are
left out, as in the score. Prints the loss on sets not learnt from, and on effects not learnt from.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize
from scipy.special import expit

from blind.sets import BESIDE, BLOCK, HELD_OUT
from gap.check.learn import read
from gap.check.scoring.score import MIMICKED
from gap.decision.presence import FEATURES, Evidence, Presence
from gap.errors import CheckError
from plant.arrays import Array

RIDGE = 0.3
"""Prior of the weights of standardised features, in the loss of one effect."""
FOLDS = 10
LEVELS = (0.5, 0.8, 0.9, 0.95)


@dataclass(frozen=True)
class Cases:
    """Effects of best explanations: features, whether they are hidden, their set and name.

    A set counts as often as its kind has a place in the mixture of the blind check, however many of
    that kind were made; one of several effects counts once.
    """

    x: Array
    y: npt.NDArray[np.bool_]
    of_set: npt.NDArray[np.int64]
    name: npt.NDArray[np.str_]
    weight: Array


def cases(lines: Sequence[Mapping[str, Any]]) -> Cases:
    """The effects that teach, from lines of a campaign or of `gap.check.several`.

    Raises:
        CheckError: a set with held-out forms, or no effect at all.
    """
    x, y, of_set, name, weight = [], [], [], [], []
    kinds = [line["score"]["kind"] for line in lines if "score" in line]
    own = [field.name for field in fields(Evidence)]
    for number, line in enumerate(lines):
        score = line.get("score", line)
        if score.get("stream") in (HELD_OUT, BESIDE):
            raise CheckError("presence", "sets with held-out forms never teach")
        if score.get("kind") == "left_out" and score["mimic"] > MIMICKED:
            continue
        hidden = set(score["hidden"]) if score.get("truth", "effects") == "effects" else set()
        evidence = line["verdict"].get("evidence") or {} if "verdict" in line else line
        place = 1.0
        if score.get("kind") in BLOCK:
            place = (
                BLOCK.count(score["kind"]) / len(BLOCK) * len(kinds) / kinds.count(score["kind"])
            )
        for one in evidence.get("presence") or []:
            weight.append(place)
            x.append(Evidence(**{key: one[key] for key in own}).features())
            y.append(one["id"] in hidden)
            of_set.append(number)
            name.append(one["id"])
    if not x:
        raise CheckError("presence", "no effect of any explanation in these results")
    return Cases(np.array(x), np.array(y), np.array(of_set), np.array(name),
                 np.array(weight))  # fmt: skip


def fit(x: Array, y: npt.NDArray[np.bool_], weight: Array) -> Presence:
    """Logistic regression with a small ridge on standardised features."""
    middle, size = x.mean(axis=0), x.std(axis=0) + 1e-9
    a = np.hstack([np.ones((len(x), 1)), (x - middle) / size])
    sign = np.where(y, 1.0, -1.0)

    def loss(beta: Array) -> float:
        fall = np.logaddexp(0.0, -sign * (a @ beta))
        return float(weight @ fall + RIDGE * np.sum(beta[1:] ** 2))

    beta = minimize(loss, np.zeros(a.shape[1])).x
    weights = beta[1:] / size
    return Presence(
        float(beta[0] - weights @ middle), dict(zip(FEATURES, weights.tolist(), strict=True))
    )


def crossed(of: Cases, group: npt.NDArray[np.int64]) -> Array:
    """Probability of each effect by a fit without its group, shape (effects,)."""
    made = np.zeros(len(of.y))
    for one in np.unique(group):
        out = group == one
        learnt = fit(of.x[~out], of.y[~out], of.weight[~out])
        weights = np.array([learnt.weights[name] for name in FEATURES])
        made[out] = expit(learnt.constant + of.x[out] @ weights)
    return made


def report(title: str, of: Cases, p: Array) -> str:
    """Loss, and how many would be named at some levels."""
    y = of.y
    loss = -np.average(np.log(np.maximum(np.where(y, p, 1.0 - p), 1e-9)), weights=of.weight)
    lines = [f"{title} not learnt from: log loss {loss:.3f}"]
    for level in LEVELS:
        sure = p >= level
        lines.append(
            f"  from {level:.2f}: {int((sure & y).sum())} of {int(y.sum())} right, "
            f"{int((sure & ~y).sum())} of {int((~y).sum())} wrong"
        )
    return "\n".join(lines)


def stored(learnt: Presence, of: Cases) -> str:
    """The file that ships."""
    text = (
        f"# Made by `python -m gap.check.presence` with {len(of.y)} effects of "
        f"{len(np.unique(of.of_set))} sets; do not edit.\n"
        f"constant = {learnt.constant:.4g}\n\n[weights]\n"
    )
    return text + "".join(f"{name} = {weight:.4g}\n" for name, weight in learnt.weights.items())


def main(arguments: Sequence[str] | None = None) -> None:
    """Learn from results files; print how well, and write the weights where asked to."""
    parser = argparse.ArgumentParser(prog="python -m gap.check.presence", description=__doc__)
    parser.add_argument("results", nargs="+", type=Path)
    parser.add_argument("--write", action="store_true", help="replace gap/decision/presence.toml")
    given = parser.parse_args(arguments)
    of = cases(read(given.results))
    folds = np.random.default_rng(0).integers(FOLDS, size=int(of.of_set.max()) + 1)[of.of_set]
    print(report("sets", of, crossed(of, folds)))
    names = np.unique(of.name, return_inverse=True)[1].astype(np.int64)
    print(report("effects", of, crossed(of, names)))
    learnt = fit(of.x, of.y, of.weight)
    print(json.dumps({"constant": learnt.constant, **learnt.weights}))
    if given.write:
        table = Path(__file__).parents[1] / "decision" / "presence.toml"
        table.write_text(stored(learnt, of), encoding="utf-8")


if __name__ == "__main__":
    main()
