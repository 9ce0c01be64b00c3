"""Whether an explanation found on earlier trials foretells trials it has never seen.

Its amounts stay as they were found; the plant's constants are recalibrated within their tolerances
as ever. A right explanation leaves of the new trials what noise leaves. One that only bent to the
earlier ones does not, and another one that fitted them as well mostly leaves more.
"""

from __future__ import annotations

import copy
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gap.estimation.fit_problem import Inquiry, State
from gap.selection.forward import Naming
from gap.selection.refine import in_best_form, linear_gains, refine
from plant.effects.catalogue import CATALOGUE

Array = npt.NDArray[np.float64]

SHOWN = 120.0
"""Least whitened squares that the new trials must have left without the explanation, beyond those
left with it: below that they say nothing for or against it."""
FORETOLD = 0.9
"""Least share of the new trials' gap that it must take away."""
REFUTED = 0.5
"""Share below which the new trials speak against it."""
MOST_RIVALS = 4
"""Other explanations that new trials are held against,"""
LEAST_RIVALS = 2
"""and how many of other families there are in any case: the nearest are fitted for it."""


@dataclass(frozen=True)
class Foretelling:
    """What new trials have left beyond noise, as whitened sums of squares.

    Attributes:
        rows: features of the new trials.
        without: left by the recalibrated plant.
        left: left with the explanation as it was found before.
        rivals: the same of each rival, by its ids.
    """

    rows: int
    without: float
    left: float
    rivals: dict[tuple[str, ...], float]

    @property
    def share(self) -> float:
        """Share of the gap that is taken away; what chance may leave does not count as left."""
        chance = self.rows + float(np.sqrt(2.0 * self.rows))
        return 1.0 - max(self.left - chance, 0.0) / max(self.without - self.rows, 1.0)

    @property
    def shown(self) -> bool:
        """Whether the new trials have anything to say about the explanation."""
        return abs(self.without - self.left) > SHOWN

    @property
    def confirmed(self) -> bool:
        """Whether the new trials came out as foretold, and as no rival foretold them."""
        return self.gained > SHOWN and self.share >= FORETOLD

    @property
    def gained(self) -> float:
        """Whitened squares that it takes away beyond what the nearest rival does."""
        return min([self.without, *self.rivals.values()]) - self.left

    @property
    def refuted(self) -> bool:
        """Whether the new trials speak against the explanation."""
        return self.shown and self.share < REFUTED


def foretell(
    q: Inquiry, trials: Collection[int], state: State, rivals: Iterable[State]
) -> Foretelling:
    """How the explanation `state`, found without them, and its rivals fare on some trials of `q`.

    Args:
        q: all data, the new trials included.
        trials: which are new.
        state: found on data without them, perhaps by another inquiry.
        rivals: other explanations of the same data; asked for only where the trials say anything.
    """
    found = Foretelling(
        sum(len(q.noise.trial_rows[trial]) for trial in trials),
        _left_by(q, q.base, trials),
        _left_by(q, _fixed(q, state), trials),
        {},
    )
    if found.shown:
        found.rivals.update({rival.ids: _left_by(q, _fixed(q, rival), trials) for rival in rivals})
    return found


def rivals_of(
    q: Inquiry, naming: Naming, entries: Iterable[tuple[str, ...]] = ()
) -> Iterator[State]:
    """What an explanation of `q` must foretell new trials better than.

    Without any one of its families, where it has several; then the nearest explanations by other
    families and the other entries of the verdict, fitted now where the search had no need to.
    """
    chosen = naming.chosen.state
    own = families(chosen.ids)
    for family in sorted(own) if len(own) > 1 else ():
        rest = [
            (s, float(a))
            for s, a in zip(chosen.suspects, chosen.amounts, strict=True)
            if CATALOGUE[s.id].family != family
        ]
        yield q.polish(q.fit([s for s, _ in rest], [a for _, a in rest]))
    seen: set[str] = set()
    others = [choice.state for choice in naming.rivals if not own & families(choice.state.ids)]
    for state in others[:MOST_RIVALS]:
        seen |= families(state.ids)
        yield state
    held = [families(state.ids) for state in others[:MOST_RIVALS]]
    for ids in entries:
        other = families(ids)
        if other & own or other in held:
            continue
        seen |= other
        suspects = [next(s for s in q.suspects if s.id == name) for name in ids]
        yield q.polish(q.fit(suspects, [s.step for s in suspects]))
    gains, amounts = linear_gains(q, q.base)
    for key in sorted(naming.first_gain, key=lambda key: -naming.first_gain[key]):
        if len(seen) >= LEAST_RIVALS:
            return
        other = families((key.partition(":")[0],))
        if not other or other & (own | seen):
            continue
        seen |= other
        first = refine(q, q.base, (), key, gains, amounts)
        yield q.polish(in_best_form(q, q.base, first, gains, amounts).state)


def families(ids: Collection[str]) -> frozenset[str]:
    """Families of the catalogue's entries among `ids`; defects of a recording have none."""
    return frozenset(CATALOGUE[name].family for name in ids if name in CATALOGUE)


def margins(q: Inquiry, state: State, others: Sequence[State]) -> Array:
    """What others leave of each trial more than `state`, shape (others, trials).

    All are fitted to `q`; in whitened squares.
    """
    trials = range(len(q.data.trials))
    own = np.array([_left_by(q, state, [trial]) for trial in trials])
    left = [[_left_by(q, other, [trial]) for trial in trials] for other in others]
    return np.asarray(np.array(left).reshape(len(others), len(own)) - own)


def _fixed(q: Inquiry, state: State) -> State:
    """Constants recalibrated on all of `q` with the effects of `state` as they were found."""
    other = copy.copy(q)
    other.given = [*q.given, *state.active]
    return other.polish(other.fit(()))


def _left_by(q: Inquiry, state: State, trials: Collection[int]) -> float:
    total = 0.0
    for trial in trials:
        rows = q.noise.trial_rows[trial]
        if len(rows):
            total += float(q.noise.solve(trial, state.residual[rows][:, None])[0][0, 0])
    return total
