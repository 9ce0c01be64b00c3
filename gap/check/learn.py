"""Learn how far an explanation is to be believed: makes `gap/belief.npz` and `gap/belief.toml`.

    pip install 'pamrig[learn]'
    python -m gap.check.learn out/practice/results.jsonl ...

Learns from practice sets, and from reserved ones that have scored the diagnosis before and are
booked in the ledger: they are no longer blind. Sets under changed conditions never teach it.
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

from blind.seal import opened
from blind.sets import BLOCK
from gap.belief import FEATURES, LEAST, OUTCOMES, Array, Forest, features
from gap.check.errors import CheckError
from gap.check.ledger import used_before
from gap.check.score import parameter_row
from gap.check.totals import CLEAR
from plant.catalogue import CATALOGUE

FOLDS = 10
TREES = 200
LEAF = 4
"""Least sets in a leaf of a tree."""
ASKED = 0.4
"""Share of the features that each split chooses from."""
LEAN = 1.0
"""Sets that the mean over all entries counts for."""
LEAST_ERROR = 0.04
MOST_ERROR = 0.8
LEDGER = Path("docs/gap-check-ledger.csv")


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


def store(forest: Forest, form: Mapping[str, float], sets: int, folder: Path) -> None:
    """Write the two files that ship."""
    np.savez_compressed(
        folder / "belief.npz",
        features=np.array(FEATURES),
        roots=forest.roots.astype(np.int32),
        feature=forest.feature.astype(np.int8),
        threshold=forest.threshold,
        left=forest.left.astype(np.int32),
        right=forest.right.astype(np.int32),
        odds=forest.odds.astype(np.float32),
    )
    text = (
        f"# Made by `python -m gap.check.learn` with {sets} explanations, as belief.npz;\n"
        "# do not edit. What other forms of an effect do to its headline, relative, one sd.\n"
        "[form]\n"
    )
    text += "".join(f"{name} = {value:.3g}\n" for name, value in form.items())
    (folder / "belief.toml").write_text(text, encoding="utf-8")


def main(paths: Sequence[str]) -> int:
    """Learn from results files and write the shipped belief."""
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
    store(fit(of), form_errors(lines), len(of.x), Path(__file__).parents[1])
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
