"""Whether an explanation found on earlier trials foretells trials it has never seen.

Its amounts stay as they were found; the plant's constants are recalibrated within their tolerances
as ever. A right explanation leaves of the new trials what noise leaves. One that only bent to the
earlier ones does not, and another one that fitted them as well mostly leaves more.
"""

from __future__ import annotations

import copy
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gap.inquiry import Inquiry, State

Array = npt.NDArray[np.float64]

SHOWN = 120.0
"""Least whitened squares that the new trials must have left without the explanation, beyond those
left with it: below that they say nothing for or against it."""
FORETOLD = 0.9
"""Least share of the new trials' gap that it must take away."""
REFUTED = 0.5
"""Share below which the new trials speak against it."""


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
        nearest = min(self.rivals.values(), default=np.inf)
        gained = min(self.without, nearest) - self.left
        return gained > SHOWN and self.share >= FORETOLD

    @property
    def refuted(self) -> bool:
        """Whether the new trials speak against the explanation."""
        return self.shown and self.share < REFUTED


def foretell(
    q: Inquiry, trials: Collection[int], state: State, rivals: Sequence[State]
) -> Foretelling:
    """How the explanation `state`, found without them, and its rivals fare on some trials of `q`.

    Args:
        q: all data, the new trials included.
        trials: which are new.
        state: found on data without them, perhaps by another inquiry.
        rivals: other explanations of the same data.
    """
    return Foretelling(
        sum(len(q.noise.trial_rows[trial]) for trial in trials),
        _left_by(q, q.base, trials),
        _left_by(q, _fixed(q, state), trials),
        {rival.ids: _left_by(q, _fixed(q, rival), trials) for rival in rivals},
    )


def gains(q: Inquiry, state: State) -> Array:
    """Whitened squares that an explanation of `q` takes from each trial, shape (trials,)."""
    before, after = q.base, state
    return np.array(
        [
            _left_by(q, before, [trial]) - _left_by(q, after, [trial])
            for trial in range(len(q.data.trials))
        ]
    )


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
