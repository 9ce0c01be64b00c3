"""Learn the reliability of explanations: makes `gap/decision/reliability.npz` and
`gap/decision/reliability.toml`.

    pip install 'pamrig[learn]'
    python -m gap.check.learn out/practice/results.jsonl ...

Learns from practice sets, and from reserved ones that have scored the diagnosis before and are
booked in the ledger: they are no longer blind. Sets under changed conditions never teach it.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize
from scipy.special import gammaln
from scipy.stats import t as student

from blind.seal import opened
from blind.sets import BLOCK
from gap.check.ledger import used_before
from gap.check.scoring.score import parameter_row
from gap.check.scoring.statistics import Z95
from gap.decision.reliability import FEATURES, LEAST, OUTCOMES, Forest, features
from gap.errors import CheckError
from plant.arrays import Array
from plant.effects.catalogue import CATALOGUE

FOLDS = 10
TREES = 200
LEAF = 2
"""Least sets in a leaf of a tree."""
ASKED = 0.4
"""Share of the features that each split chooses from."""
MOST_RATIO = 5.0
"""A headline further from the truth than this factor counts as just so far."""
LEDGER = Path("docs/evidence/gap-check-ledger.csv")


@dataclass(frozen=True)
class Samples:
    """Explanations: features, shape (sets, features), outcomes and weights (sets,)."""

    x: Array
    y: npt.NDArray[np.int64]
    weight: Array


def learnable(lines: Sequence[dict[str, Any]], ledger: Path = LEDGER) -> list[dict[str, Any]]:
    """The sets that may teach: each once, its last line; none under changed conditions.

    Raises:
        CheckError: a reserved set that has not scored the diagnosis yet.
    """
    kept = {}
    for line in lines:
        score = line["score"]
        if score["stream"] == "reserved" and not used_before(ledger, [score["number"]]):
            raise CheckError("learn", f"set {score['number']} is reserved and not in {ledger}")
        if not score["changed"]:
            kept[score["stream"], score["number"]] = line
    return list(kept.values())


def samples(lines: Sequence[dict[str, Any]]) -> Samples:
    """Features and outcomes of all sets in which something was explained.

    A set counts as often as its kind (single, pair, ...) has a place in the mixture of the blind
    check, however many of that kind were made for practice.
    """
    kinds = [line["score"]["kind"] for line in lines]
    x, y, weight = [], [], []
    for line in lines:
        score = line["score"]
        evidence = line["verdict"].get("evidence") or {}
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
        x.append(features(traits))
        y.append(OUTCOMES.index(outcome))
        share = kinds.count(score["kind"]) / len(kinds)
        weight.append(BLOCK.count(score["kind"]) / len(BLOCK) / share)
    return Samples(np.array(x), np.array(y, dtype=np.int64), np.array(weight) / np.mean(weight))


def fit(of: Samples) -> Forest:
    """A random forest (Breiman 2001), its trees as plain tables."""
    from sklearn.ensemble import RandomForestClassifier

    made = RandomForestClassifier(
        TREES, min_samples_leaf=LEAF, max_features=ASKED, random_state=0
    ).fit(of.x, of.y, of.weight)
    roots, parts, start = [], [], 0
    for one in made.estimators_:
        tree = one.tree_
        odds = np.zeros((tree.node_count, len(OUTCOMES)))
        odds[:, made.classes_] = tree.value[:, 0, :] / tree.value[:, 0, :].sum(1, keepdims=True)
        leaf = tree.children_left < 0
        parts.append(
            (
                np.where(leaf, -1, tree.feature), np.where(leaf, 0.0, tree.threshold),
                tree.children_left + start, tree.children_right + start, odds,
            )
        )  # fmt: skip
        roots.append(start)
        start += tree.node_count
    feature, threshold, left, right, odds = (np.concatenate(p) for p in zip(*parts, strict=True))
    return Forest(np.array(roots), feature, threshold, left, right, odds)


def crossed(of: Samples) -> Array:
    """Probabilities of each set by forests that have not seen it, shape (sets, outcomes)."""
    made = np.zeros((len(of.x), len(OUTCOMES)))
    fold = np.random.default_rng(0).permutation(len(of.x)) % FOLDS
    for k in range(FOLDS):
        rest = fold != k
        forest = fit(Samples(of.x[rest], of.y[rest], of.weight[rest]))
        for i in np.flatnonzero(~rest):
            odds = np.maximum(forest.of(of.x[i]), LEAST)
            made[i] = odds / odds.sum()
    return made


def form_errors(lines: Sequence[dict[str, Any]]) -> dict[str, float]:
    """How far each entry's headline is off: logarithms, one sd of a normal law as wide at 95 %.

    From all effects that were named. Each entry has a spread of its own, drawn from a law that all
    share and that is learnt from them (Smyth, Stat. Appl. Genet. Mol. Biol. 3 (2004) 3): the next
    error follows Student's t, wide where an entry was seen seldom. All are stretched alike, so
    that 95 % of the errors lie within what the others of their entry say.
    """
    errors: dict[str, list[float]] = {}
    for line in lines:
        best = (line["verdict"].get("effects") or [None])[0]
        if best is None or not set(line["score"]["named"]) & set(line["score"]["hidden"]):
            continue
        answer = opened(line["envelope"], line["seal"])
        ratio = parameter_row(answer, best).get("ratio")
        if ratio is not None:
            name = next(e["id"] for e in answer["effects"] if e["id"] in best["ids"])
            size = abs(math.log(min(max(ratio, 1.0 / MOST_RATIO), MOST_RATIO)))
            errors.setdefault(name, []).append(size)
    freedom, scale = shared_spread(list(errors.values()))

    def reach(known: Sequence[float]) -> float:
        weight = freedom + len(known)
        spread = math.sqrt((freedom * scale**2 + float(np.square(known).sum())) / weight)
        return spread * float(student.ppf(0.975, weight))

    left_out = [
        error / reach([*own[:k], *own[k + 1 :]])
        for own in errors.values() for k, error in enumerate(own)
    ]  # fmt: skip
    stretch = float(np.quantile(left_out, 0.95)) if left_out else 1.0
    return {name: stretch * reach(errors.get(name, [])) / Z95 for name in CATALOGUE}


def shared_spread(groups: Sequence[Sequence[float]]) -> tuple[float, float]:
    """Degrees of freedom and scale of the law from which the spreads of all groups come.

    The scaled inverse chi-squared law under which the errors in `groups` are likeliest.
    """
    count = np.array([float(len(group)) for group in groups])
    squares = np.array([float(np.square(group).sum()) for group in groups])

    def loss(at: Array) -> float:
        freedom, scale = np.exp(at)
        whole = 0.5 * (freedom + count)
        cost = whole * np.log1p(squares / freedom / scale**2) + count * np.log(scale)
        cost += 0.5 * count * np.log(freedom) + gammaln(0.5 * freedom) - gammaln(whole)
        return float(cost.sum())

    found = minimize(loss, np.log([2.0, 0.1]), method="L-BFGS-B", bounds=[(-1.5, 5.0), (-5.0, 0.0)])
    freedom, scale = np.exp(found.x)
    return float(freedom), float(scale)


def store(forest: Forest, form: Mapping[str, float], sets: int, folder: Path) -> None:
    """Write the two files that ship."""
    np.savez_compressed(
        folder / "reliability.npz",
        features=np.array(FEATURES),
        roots=forest.roots.astype(np.int32),
        feature=forest.feature.astype(np.int8),
        threshold=forest.threshold,
        left=forest.left.astype(np.int32),
        right=forest.right.astype(np.int32),
        odds=forest.odds.astype(np.float32),
    )
    text = (
        f"# Made by `python -m gap.check.learn` with {sets} explanations, as reliability.npz;\n"
        "# do not edit. How far headlines are off, as a logarithm, one sd.\n"
        "[form]\n"
    )
    text += "".join(f"{name} = {value:.3g}\n" for name, value in form.items())
    (folder / "reliability.toml").write_text(text, encoding="utf-8")


def main(paths: Sequence[str]) -> int:
    """Learn from results files and write the shipped reliability."""
    read = [json.loads(text) for path in paths for text in Path(path).read_text().splitlines()]
    lines = learnable(read)
    of = samples(lines)
    p = crossed(of)
    counts = dict(zip(OUTCOMES, np.bincount(of.y, minlength=len(OUTCOMES)).tolist(), strict=True))
    loss = -np.average(np.log(p[np.arange(len(of.y)), of.y]), weights=of.weight)
    print(f"{counts}, log loss of sets not learnt from {loss:.3f}")
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
    store(fit(of), form_errors(lines), len(of.x), Path(__file__).parents[1] / "decision")
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
