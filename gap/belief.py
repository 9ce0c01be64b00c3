"""How far an explanation is to be believed, learnt from practice sets whose truth is known.

A goodness-of-fit test rejects every explanation when the signal is strong, because no form is ever
exact; a share of the gap alone lets mimics pass. So the traits of an explanation (`gap.traits`)
are weighed by a multinomial logistic regression into four outcomes: it is right; part of it is;
something else of the catalogue is; nothing of the catalogue is. Explanations by one effect and by
several go wrong in other ways and have coefficients of their own. These come from practice sets
(`python -m gap.check.learn`), never from those that score the diagnosis.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib import resources

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

OUTCOMES = ("right", "part", "other", "unknown")
FEATURES: dict[str, tuple[str, ...]] = {
    "one": (
        "left_share", "repeated_row", "repeated_share", "bent", "bent_base", "margin", "no_rival",
        "more_left", "closed",
    ),
    "several": ("left_share", "bent", "unbent", "three", "same_family"),
}  # fmt: skip
_FILE = "belief.toml"
_MOST = 1e8
"""Margins from here on say that no rival was near enough to be fitted."""


def features(traits: Mapping[str, float]) -> dict[str, float]:
    """Traits as bounded numbers of order one."""
    rows = max(traits["rows"], 1.0)
    chance = float(np.sqrt(2.0 * rows))
    left = traits["left"] + chance
    excess = traits["excess"] + chance
    margin = max(traits["margin"], 0.0)
    shared, shared_left = (max(traits[k], 0.0) + chance for k in ("repeated", "repeated_left"))
    near = traits["margin"] < _MOST
    return {
        "left_share": _log(left / excess),
        # What replicates share of the rest is form, the remainder noise of whatever size.
        "repeated_row": _log(shared_left / rows),
        "repeated_share": _log(shared_left / shared),
        # How much more the best explanation by other effects leaves, if one was near at all.
        "margin": min(_log(1.0 + margin / left), 1.0) if near else 0.0,
        "no_rival": float(not near),
        "more_left": _log((max(traits["more"], 0.0) + 20.0) / left),
        "bent": min(traits["bent"], 6.0),
        "bent_base": min(traits["bent_base"], 6.0),
        "unbent": min(max(traits["bent_base"] - traits["bent"], 0.0), 5.0),
        "closed": float(np.clip(traits["closed"], -1.0, 1.0)),
        "three": float(traits["effects"] >= 3.0),
        "same_family": traits["same_family"],
    }


def _log(x: float) -> float:
    return float(np.log10(x))


def kind_of(traits: Mapping[str, float]) -> str:
    """Which coefficients an explanation is weighed with."""
    return "several" if traits["effects"] > 1.0 else "one"


@dataclass(frozen=True)
class Weights:
    """Mean and spread of the features, weights of shape (outcomes, 1 + features)."""

    mean: Array
    spread: Array
    weights: Array

    def of(self, values: Sequence[float] | Array) -> Array:
        """Probability of each of `OUTCOMES` for the features in order."""
        x = np.r_[1.0, np.clip((np.asarray(values) - self.mean) / self.spread, -4.0, 4.0)]
        scores = self.weights @ x
        odds = np.exp(scores - scores.max())
        return np.asarray(odds / odds.sum())


@dataclass(frozen=True)
class Belief:
    """Coefficients by kind of explanation.

    `form` is the relative error (1 sd) of an entry's headline that its true form brings.
    """

    kinds: Mapping[str, Weights]
    form: Mapping[str, float] = field(default_factory=dict)

    def of(self, traits: Mapping[str, float]) -> dict[str, float]:
        """Probability of each of `OUTCOMES`."""
        kind = kind_of(traits)
        known = features(traits)
        odds = self.kinds[kind].of([known[name] for name in FEATURES[kind]])
        return dict(zip(OUTCOMES, odds.tolist(), strict=True))


@cache
def learnt() -> Belief:
    """The belief that ships with the program."""
    table = tomllib.loads(resources.files("gap").joinpath(_FILE).read_text(encoding="utf-8"))
    kinds = {}
    for kind, names in FEATURES.items():
        part = table[kind]
        if tuple(part["features"]) != names:
            raise ValueError(f"gap/{_FILE} was learnt for other features; run gap.check.learn")
        kinds[kind] = Weights(*(np.array(part[name]) for name in ("mean", "spread", "weights")))
    return Belief(kinds, dict(table.get("form", {})))
