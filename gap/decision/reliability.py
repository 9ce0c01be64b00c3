"""Reliability of an explanation, learnt from blind sets whose truth is known.

A goodness-of-fit test rejects every explanation where the signal is strong, because no form is
exact; a share of the gap alone accepts confounders. So a random forest maps the traits of an
explanation (`gap.decision.traits`) to the probabilities of four outcomes: it is right; a part of it
is right; another effect of the catalogue is; an effect outside the catalogue is. The forest comes
from sets that were set apart for learning (`python -m gap.check.learn`), never from those that
score the diagnosis.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib import resources

import numpy as np
import numpy.typing as npt
from scipy.stats import norm
from scipy.stats import t as student

from plant.arrays import Array

Indices = npt.NDArray[np.int64]

OUTCOMES = ("right", "part", "other", "unknown")
FEATURES = (
    "left_share", "repeated_row", "repeated_share", "bent", "bent_base", "unbent", "margin",
    "no_rival", "more_left", "closed", "excess", "several", "three", "same_family", "next_seen",
    "next_gain", "first_gain", "last_gain", "settled", "at_an_end",
)  # fmt: skip
LEAST = 0.01
"""Least probability of an outcome: no forest has seen everything."""
FORMS_SEEN = 3
"""Forms of each effect that the shipped errors were learnt on."""
FORMS_SHARED = 3
"""Forms that the mean over all effects counts for: as much as an effect's own."""
_FORM, _FOREST = "reliability.toml", "reliability.npz"
_MOST = 1e8
"""Margins from here on say that no rival was near enough to be fitted."""


def features(traits: Mapping[str, float]) -> Array:
    """Traits as bounded numbers of order one, in the order of `FEATURES`."""
    rows = max(traits["rows"], 1.0)
    chance = float(np.sqrt(2.0 * rows))
    left = traits["left"] + chance
    excess = traits["excess"] + chance
    margin = max(traits["margin"], 0.0)
    shared, shared_left = (max(traits[k], 0.0) + chance for k in ("repeated", "repeated_left"))
    near = traits["margin"] < _MOST
    made = {
        "left_share": _log(left / excess),
        # What replicates share of the rest is form, the remainder noise of whatever size; of few
        # rows chance makes them share more.
        "repeated_row": _log(0.02 + max(traits["repeated_left"] - 2.0 * chance, 0.0) / rows),
        "repeated_share": _log(shared_left / shared),
        "excess": _log(excess / chance),
        # How much more the best explanation by other effects leaves, if one was near at all.
        "margin": min(_log(1.0 + margin / left), 1.5) if near else 1.5,
        "no_rival": float(not near),
        "more_left": _log((max(traits["more"], 0.0) + 20.0) / (traits["left"] + 80.0)),
        "bent": min(traits["bent"], 6.0),
        "bent_base": min(traits["bent_base"], 6.0),
        "unbent": min(max(traits["bent_base"] - traits["bent"], 0.0), 5.0),
        "closed": float(np.clip(traits["closed"], -1.0, 1.0)),
        "several": float(traits["effects"] > 1.0),
        "three": float(traits["effects"] >= 3.0),
        "same_family": traits["same_family"],
        "next_seen": min(traits["next_seen"], 4.0),
        "next_gain": _log(1.0 + max(traits["next_gain"], 0.0)),
        "first_gain": _log(max(traits["first_gain"], 1.0)),
        "last_gain": _log(max(traits["last_gain"], 1.0)),
        "settled": traits["settled"],
        # A stand-in is often led to an end of what it can be.
        "at_an_end": min(traits["at_an_end"], 2.0),
    }
    return np.array([made[name] for name in FEATURES])


def _log(x: float) -> float:
    return float(np.log10(x))


@dataclass(frozen=True)
class Forest:
    """Decision trees, each a table of nodes, all of them one after another.

    Attributes:
        roots: index of each tree's first node, shape (trees,).
        feature: the feature that a node compares, -1 at a leaf, shape (nodes,).
        threshold: up to and with this value the way goes left, shape (nodes,).
        left: index of the node on the left, shape (nodes,); right: the same on the right.
        odds: probability of each outcome at a node, shape (nodes, outcomes).
    """

    roots: Indices
    feature: Indices
    threshold: Array
    left: Indices
    right: Indices
    odds: Array

    def of(self, values: Sequence[float] | Array) -> Array:
        """Mean probability of each outcome over the trees, shape (outcomes,)."""
        x = np.asarray(values, dtype=np.float32)  # as the trees were grown
        at = self.roots.copy()
        while (inner := self.feature[at] >= 0).any():
            node = at[inner]
            low = x[self.feature[node]] <= self.threshold[node]
            at[inner] = np.where(low, self.left[node], self.right[node])
        return np.asarray(self.odds[at].mean(axis=0))


@dataclass(frozen=True)
class Reliability:
    """The forest, and what an entry's true form may do to its headline.

    `form` is the error (1 sd) of the logarithm of an entry's headline that its true form brings,
    a form that nobody has seen included.
    """

    forest: Forest
    form: Mapping[str, float] = field(default_factory=dict)

    def of(self, traits: Mapping[str, float]) -> dict[str, float]:
        """Probability of each of `OUTCOMES`."""
        odds = np.maximum(self.forest.of(features(traits)), LEAST)
        return dict(zip(OUTCOMES, (odds / odds.sum()).tolist(), strict=True))


@cache
def shipped_reliability() -> Reliability:
    """The reliability model that ships with the program."""
    shipped = resources.files("gap.decision")
    table = tomllib.loads(shipped.joinpath(_FORM).read_text(encoding="utf-8"))
    with shipped.joinpath(_FOREST).open("rb") as file, np.load(file) as stored:
        if tuple(stored["features"].tolist()) != FEATURES:
            raise ValueError(
                f"gap/decision/{_FOREST} was learnt for other features; run gap.check.learn"
            )
        forest = Forest(
            stored["roots"].astype(np.int64),
            stored["feature"].astype(np.int64),
            stored["threshold"],
            stored["left"].astype(np.int64),
            stored["right"].astype(np.int64),
            stored["odds"].astype(np.float64),
        )
    return Reliability(forest, for_unseen_forms(table["form"]))


def for_unseen_forms(seen: Mapping[str, float]) -> dict[str, float]:
    """Errors (1 sd, of the logarithm) that an unseen form of each effect may bring.

    What was learnt on many sets with few forms states how far those few forms are off. The next
    form is another draw: its error has as many degrees of freedom as there were forms, and is drawn
    towards the mean over all effects by as many more (Smyth, Stat. Appl. Genet. Mol. Biol. 3 (2004)
    3, with a form as the unit instead of a set). Given as the normal law that is as wide at 95 %.

    Args:
        seen: error that the seen forms of each effect brought.
    """
    shared = float(np.mean(np.square(list(seen.values()))))
    freedom = FORMS_SEEN + FORMS_SHARED
    wider = float(student.ppf(0.975, freedom) / norm.ppf(0.975))
    return {
        name: wider * float(np.sqrt((FORMS_SEEN * own**2 + FORMS_SHARED * shared) / freedom))
        for name, own in seen.items()
    }
