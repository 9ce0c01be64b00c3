"""Belief shared out among explanations, and the set of those that stay.

Probabilities compare what each explanation leaves: like a likelihood where little is left, and
blunter where the best explanation itself leaves a pattern, because then its form is not exact and
small differences mean little. Its constants were set on practice sets (docs/use/gap.md).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gap.selection.forward import Naming
from gap.selection.refine import Choice

BLUNT = 4.0
"""How fast an explanation loses credit as it leaves more than the best one."""


FORM = 100.0
"""Whitened excess that the best explanation may leave before differences count for less."""


COVER = 0.9


_LEAST = 0.03


@dataclass(frozen=True)
class Weighed:
    """Explanations with probabilities, best first, and what none and unknown get."""

    entries: list[tuple[Choice, float]]
    none: float
    unknown: float


def weigh(naming: Naming, belief: Mapping[str, float], none: float) -> Weighed:
    """Belief shared out: the best explanation has its own, the rivals share what others have."""
    known = [choice for choice in naming.rivals if choice.keys != naming.chosen.keys]
    more = np.array([max(choice.cost - naming.chosen.cost, 0.0) for choice in known])
    blunt = max(1.0, naming.left / FORM)
    weights = (1.0 + more / blunt / (2.0 * BLUNT)) ** -BLUNT
    # A rival that fits as well is as likely, whatever such an explanation is worth on its own.
    # Where none does, being wrong means something that was not thought of.
    alike = 1.0 + float(weights.sum())
    real = 1.0 - none
    known_at_all = 1.0 - belief["unknown"]
    entries = [(naming.chosen, belief["right"] * real / alike)]
    entries += [(c, known_at_all * real * w / alike) for c, w in zip(known, weights, strict=True)]
    unknown = real - sum(p for _, p in entries)
    entries.sort(key=lambda entry: -entry[1])
    return Weighed(entries, none, max(unknown, 0.0))


def ambiguity_set(weighed: Weighed) -> list[tuple[Choice, float]]:
    """Best explanations until together they hold most of what none and unknown leave."""
    whole = sum(p for _, p in weighed.entries)
    kept: list[tuple[Choice, float]] = []
    held = 0.0
    for choice, p in weighed.entries:
        if kept and (held >= COVER * whole or p < _LEAST):
            break
        kept.append((choice, p))
        held += p
    return kept
