"""Learn the reliability of explanations: makes `gap/decision/reliability.npz` and
`gap/decision/reliability.toml`.

    pip install 'pamrig[learn]'
    python -m gap.check.learn out/practice/results.jsonl ... --judge out/held-out/results.jsonl

Learns from practice sets, and from reserved ones that have scored the diagnosis before and are
booked in the ledger: they are no longer blind. Sets under changed conditions never teach it, nor
do those of the campaign of held-out forms.

The errors it states are those on forms and on effects that a forest has not seen: one is grown for
each form, and for each effect, without any set that hides it. The two files are replaced only where
the new forest is better than the shipped one on the held-out forms of `--judge`: the mean log loss
is lower, and the 95 % interval of the difference (bootstrap over sets) does not reach zero.
"""

from __future__ import annotations

import argparse
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
from blind.sets import BESIDE, BLOCK, HELD_OUT
from gap.check.ledger import used_before
from gap.check.scoring.score import parameter_row
from gap.check.scoring.statistics import Z95, debiased_error
from gap.decision.reliability import (
    FEATURES,
    LEAST,
    OUTCOMES,
    Forest,
    features,
    shipped_reliability,
)
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
    """Explanations: features, shape (sets, features), outcomes and weights (sets,).

    `forms` are the effects that each set hides, each with the number of its form.
    """

    x: Array
    y: npt.NDArray[np.int64]
    weight: Array
    forms: tuple[tuple[tuple[str, int], ...], ...] = ()

    def without(self, left_out: npt.NDArray[np.bool_]) -> Samples:
        """The samples that are not left out."""
        kept = ~left_out
        forms = tuple(f for f, keep in zip(self.forms, kept, strict=True) if keep)
        return Samples(self.x[kept], self.y[kept], self.weight[kept], forms)


def learnable(lines: Sequence[dict[str, Any]], ledger: Path = LEDGER) -> list[dict[str, Any]]:
    """The sets that may teach: each once, its last line; none under changed conditions.

    Raises:
        CheckError: a reserved set that has not scored the diagnosis yet, or a set of the campaign
            of held-out forms.
    """
    kept = {}
    for line in lines:
        score = line["score"]
        if score["stream"] in (HELD_OUT, BESIDE):
            raise CheckError(
                "learn", f"set {score['number']} of {score['stream']!r}: held-out forms never teach"
            )
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
    x, y, weight, forms = [], [], [], []
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
        effects = line["envelope"]["answer"]["effects"]
        forms.append(tuple((str(e["id"]), int(e["form"])) for e in effects))
    return Samples(
        np.array(x), np.array(y, dtype=np.int64), np.array(weight) / np.mean(weight), tuple(forms)
    )


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
        made[~rest] = answers(fit(of.without(~rest)), of.x[~rest])
    return made


def answers(forest: Forest, x: Array) -> Array:
    """Probabilities that a forest states, shape (sets, outcomes)."""
    odds = np.array([np.maximum(forest.of(row), LEAST) for row in x]).reshape(-1, len(OUTCOMES))
    return np.asarray(odds / odds.sum(axis=1, keepdims=True))


def crossed_by(of: Samples, whole_effects: bool) -> Array:
    """Probabilities by forests that have not met a set's form, or none of its effect's forms.

    One forest for each form (or effect), grown without every set that hides it. A set that hides
    two gets the mean of the two answers. Shape (sets, outcomes).
    """
    hidden = [{(e, 0 if whole_effects else form) for e, form in forms} for forms in of.forms]
    total, count = np.zeros((len(of.x), len(OUTCOMES))), np.zeros(len(of.x))
    for group in sorted(set().union(*hidden)):
        out = np.array([group in one for one in hidden])
        if not out.all():
            total[out] += answers(fit(of.without(out)), of.x[out])
            count[out] += 1.0
    return np.asarray(total / np.maximum(count, 1.0)[:, None])


def losses(of: Samples, p: Array) -> Array:
    """Log loss of each set, shape (sets,)."""
    return -np.log(np.maximum(p[np.arange(len(of.y)), of.y], LEAST / len(OUTCOMES)))


@dataclass(frozen=True)
class Quality:
    """Mean log loss of stated probabilities, and the calibration error of names (debiased)."""

    log_loss: float
    calibration: float

    @classmethod
    def of(cls, of: Samples, p: Array) -> Quality:
        """Of the probabilities `p`, shape (sets, outcomes); a name is right in part or whole."""
        loss = float(np.average(losses(of, p), weights=of.weight))
        return cls(loss, debiased_error(p[:, 0] + p[:, 1], (of.y < 2).astype(float)))


_DRAWS = 2000


def better_by(of: Samples, old: Forest, new: Forest) -> tuple[float, float, float]:
    """Mean fall of the log loss from `old` to `new`, with its 95 % interval over sets."""
    fall = losses(of, answers(old, of.x)) - losses(of, answers(new, of.x))
    rng = np.random.default_rng(4)
    drawn = rng.integers(len(fall), size=(_DRAWS, len(fall)))
    means = [float(np.average(fall[i], weights=of.weight[i])) for i in drawn]
    low, high = np.quantile(means, [0.025, 0.975])
    return float(np.average(fall, weights=of.weight)), float(low), float(high)


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


def read(paths: Sequence[Path]) -> list[dict[str, Any]]:
    """Lines of results files."""
    found = []
    for path in paths:
        try:
            found += [json.loads(text) for text in path.read_text(encoding="utf-8").splitlines()]
        except OSError as error:
            raise CheckError(str(path), f"cannot be read: {error.strerror}") from None
    return found


def judges(lines: Sequence[dict[str, Any]]) -> Samples:
    """Explanations of sets with held-out forms.

    Raises:
        CheckError: no such set is among the lines.
    """
    kept = [line for line in lines if line["score"]["stream"] == HELD_OUT]
    if not kept:
        raise CheckError("--judge", f"no set of the stream {HELD_OUT!r}")
    return samples(kept)


def report(of: Samples, p: Array) -> None:
    """Print what the forests say of sets that they have not learnt from."""
    counts = dict(zip(OUTCOMES, np.bincount(of.y, minlength=len(OUTCOMES)).tolist(), strict=True))
    print(f"{counts}")
    for name, made in (
        ("sets", p),
        ("forms", crossed_by(of, whole_effects=False)),
        ("effects", crossed_by(of, whole_effects=True)),
    ):
        quality = Quality.of(of, made)
        print(
            f"  {name} not learnt from: log loss {quality.log_loss:.3f}, "
            f"calibration error {quality.calibration:.3f}"
        )
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


def main(arguments: Sequence[str]) -> int:
    """Learn from results files; write the shipped reliability where it became better."""
    parser = argparse.ArgumentParser(prog="python -m gap.check.learn", description=__doc__)
    parser.add_argument("results", nargs="+", type=Path, help="results.jsonl of campaigns")
    parser.add_argument("--judge", nargs="+", type=Path, help="results.jsonl of held-out forms")
    parser.add_argument("--ledger", type=Path, default=LEDGER, help="ledger of reserved sets")
    given = parser.parse_args(arguments)
    try:
        lines = learnable(read(given.results), given.ledger)
        judge = judges(read(given.judge)) if given.judge else None
    except CheckError as error:
        print(error, file=sys.stderr)
        return 2
    of = samples(lines)
    report(of, crossed(of))
    if judge is None:
        print("nothing written: no held-out forms to judge by (--judge)")
        return 0
    forest, old = fit(of), shipped_reliability().forest
    for name, one in (("shipped", old), ("new", forest)):
        quality = Quality.of(judge, answers(one, judge.x))
        print(
            f"held-out forms, {name}: {len(judge.y)} sets, log loss {quality.log_loss:.3f}, "
            f"calibration error {quality.calibration:.3f}"
        )
    gain, low, high = better_by(judge, old, forest)
    print(f"log loss falls by {gain:.3f} [{low:.3f}, {high:.3f}]")
    if low <= 0.0:
        print("nothing written: not better than the shipped one on held-out forms")
        return 0
    store(forest, form_errors(lines), len(of.x), Path(__file__).parents[1] / "decision")
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
