"""Posterior probabilities of explanations, and the credible set.

Probabilities compare what each explanation leaves: like a likelihood where little is left, and less
steep where the best explanation leaves a pattern, because then its form is not exact and small
differences mean little. The constants of that map are in `gap.decision.config`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gap.decision.config import DECISION, DecisionConfig
from gap.selection.candidate_fits import Hypothesis
from gap.selection.search import SearchResult


@dataclass(frozen=True)
class Posterior:
    """Explanations with probabilities, best first, and what none and unknown get."""

    entries: list[tuple[Hypothesis, float]]
    none: float
    unknown: float


def posterior(
    search: SearchResult,
    reliability: Mapping[str, float],
    none: float,
    config: DecisionConfig = DECISION,
) -> Posterior:
    """The best explanation has its own reliability; the rivals share what others have."""
    known = [hypothesis for hypothesis in search.rivals if hypothesis.keys != search.best.keys]
    more = np.array([max(hypothesis.cost - search.best.cost, 0.0) for hypothesis in known])
    blunt = max(1.0, search.left / config.tail_left)
    weights = (1.0 + more / blunt / (2.0 * config.tail)) ** -config.tail
    # A rival that fits as well is as likely, whatever such an explanation is worth on its own.
    # Where none does, being wrong means something that was not thought of.
    alike = 1.0 + float(weights.sum())
    real = 1.0 - none
    known_at_all = 1.0 - reliability["unknown"]
    shares = known_at_all * real * weights / alike
    # What fits worse is not likelier.
    first = max(reliability["right"] * real / alike, float(shares.max(initial=0.0)))
    entries = [(search.best, first), *zip(known, shares.tolist(), strict=True)]
    unknown = real - sum(p for _, p in entries)
    entries.sort(key=lambda entry: -entry[1])
    return Posterior(entries, none, max(unknown, 0.0))


def credible_set(
    weighted: Posterior, config: DecisionConfig = DECISION
) -> list[tuple[Hypothesis, float]]:
    """Best explanations until together they hold most of what none and unknown leave."""
    whole = sum(p for _, p in weighted.entries)
    kept: list[tuple[Hypothesis, float]] = []
    held = 0.0
    for hypothesis, p in weighted.entries:
        if kept and (held >= config.credible * whole or p < config.least_probability):
            break
        kept.append((hypothesis, p))
        held += p
    return kept
