"""How far an explanation is to be believed, learnt from practice sets whose truth is known.

A goodness-of-fit test rejects every explanation when the signal is strong, because no form is ever
exact; a share of the gap alone lets mimics pass. So the traits of an explanation (`gap.traits`)
are weighed by a multinomial logistic regression into three outcomes: it is right; something else
of the catalogue is; nothing of the catalogue is. Its coefficients come from practice sets
(`python -m gap.check.learn`), never from those that score the diagnosis.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import resources

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

OUTCOMES = ("right", "other", "unknown")
FEATURES = (
    "left_share", "left_row", "stands_out", "pair", "more_effects", "last_share", "settled",
)  # fmt: skip
_FILE = "belief.toml"
_MOST_LEFT = -0.5
_MOST_AHEAD = 1.0
_NO_RIVAL = 1e8


def features(traits: Mapping[str, float]) -> Array:
    """Traits as bounded numbers of order one, in the order of `FEATURES`."""
    rows = max(traits["rows"], 1.0)
    chance = np.sqrt(2.0 * rows)
    left = traits["left"] + chance
    several = traits["effects"] > 1.0
    # How much more than the best explanation the best of another family leaves, if one was near
    # enough to be fitted at all.
    met = traits["margin_family"] < _NO_RIVAL and not several
    ahead = max(traits["margin_family"], 0.0) / left if met else 0.0
    return np.array(
        [
            np.log10(left / (traits["excess"] + chance)),
            # A strong signal shows every form to be inexact; that alone speaks against none.
            min(np.log10(left / rows), _MOST_LEFT),
            min(np.log10(1.0 + ahead), _MOST_AHEAD),
            float(traits["effects"] == 2.0),
            float(traits["effects"] >= 3.0),
            min(traits["share"], 1.0) if several else 1.0,
            traits["settled"],
        ]
    )


@dataclass(frozen=True)
class Belief:
    """Coefficients: mean and spread of the features, weights shape (outcomes, 1 + features).

    `form` is the relative error (1 sd) of an entry's headline that its true form brings.
    """

    mean: Array
    spread: Array
    weights: Array
    form: Mapping[str, float] = field(default_factory=dict)

    def of(self, traits: Mapping[str, float]) -> dict[str, float]:
        """Probability of each of `OUTCOMES`."""
        x = np.r_[1.0, np.clip((features(traits) - self.mean) / self.spread, -4.0, 4.0)]
        scores = self.weights @ x
        odds = np.exp(scores - scores.max())
        return dict(zip(OUTCOMES, (odds / odds.sum()).tolist(), strict=True))


@cache
def learnt() -> Belief:
    """The belief that ships with the program."""
    table = tomllib.loads(resources.files("gap").joinpath(_FILE).read_text(encoding="utf-8"))
    if tuple(table["features"]) != FEATURES:
        raise ValueError(f"gap/{_FILE} was learnt for other features; run gap.check.learn")
    mean, spread, weights = (np.array(table[name]) for name in ("mean", "spread", "weights"))
    return Belief(mean, spread, weights, dict(table.get("form", {})))
