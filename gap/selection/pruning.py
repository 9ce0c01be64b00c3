"""What a search found, cleared of defects of the recording and of effects it could do without.

A defect of the recording bends to much that has nothing to do with it. It may stand as the answer
only where it explains the gap alone and every trial asks for the same amount of it; otherwise the
search is made again among effects alone.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.stats import t as student

from gap.estimation.cross_validation import Held, held_out
from gap.estimation.fit_problem import Inquiry, State
from gap.selection.forward import PLAIN, Naming, name_effects
from gap.selection.inclusion import PLAINLY_SEEN, apart, excess, plain, relieves, seen, settles
from gap.selection.refine import Choice

Array = npt.NDArray[np.float64]

ALONE = 0.75
"""Least share of the gap's excess that a defect must take away alone."""
SAME = 0.15
"""Most that trials may differ in the amount they ask for, beyond chance, over that amount."""
FAR_WORSE = 0.1
"""Share of the gap's excess by which effects may do worse than a defect and still be named."""
LEAST_LATE_MS = 5.0
"""Delay below which a late channel may as well be a slow sensor, which no clock is to blame for."""
SURE = 0.95
FORM = 0.12
"""Share of what is explained below which a further effect in the same channels only mends the
form of the one before."""
SECOND = 1.25
"""Gain, in units of a first effect's alarm, from which one needs no other proof in channels that
no other touches, beside one that leaves nothing: there it is a first effect."""
LARGE = 0.2
"""Share of the gap from which a further effect needs no held-out proof."""


@dataclass(frozen=True)
class Cleared:
    """The search's outcome among effects alone.

    Attributes:
        naming: outcome without any defect, unless `defect`.
        defect: whether a defect of the recording is the answer.
        blurred: whether a defect, though not certain, explains far more than any effect.
    """

    naming: Naming
    defect: bool = False
    blurred: bool = False


def cleared(q: Inquiry, naming: Naming) -> Cleared:
    """Take defects and needless effects out of what a search found."""
    suspects = naming.chosen.state.suspects
    if not any(suspect.defect for suspect in suspects):
        return Cleared(_needed(q, _rivals_cleared(naming)))
    first = suspects[0].defect
    if first and _is_defect(q, naming):
        return Cleared(naming, defect=True)
    clean = name_effects(without_defects(q))
    worse = clean.chosen.cost - naming.chosen.cost
    blurred = first and worse > PLAIN + FAR_WORSE * naming.excess
    return Cleared(_needed(q, _rivals_cleared(clean)), blurred=blurred)


def without_defects(q: Inquiry) -> Inquiry:
    """The same data and fits, asked about effects alone."""
    other = copy.copy(q)
    other.suspects = tuple(suspect for suspect in q.suspects if not suspect.defect)
    return other


def _rivals_cleared(naming: Naming) -> Naming:
    rivals = [c for c in naming.rivals if not any(s.defect for s in c.state.suspects)]
    return replace(naming, rivals=rivals)


def _is_defect(q: Inquiry, naming: Naming) -> bool:
    if naming.steps[0][1] < max(ALONE * naming.excess, PLAIN):
        return False
    state = naming.chosen.state
    late = float(state.amounts[0])
    if state.suspects[0].id.endswith("clock") and 0.0 < late < LEAST_LATE_MS:
        return False
    return _disagreement(q, state) < SAME * abs(float(state.amounts[0]))


def _disagreement(q: Inquiry, state: State) -> float:
    """Spread over trials, beyond chance, of the amount of the first suspect each asks for."""
    slope = q.slopes(state.shift, state.suspects, state.amounts)[:, 0]
    asked, weight = [], []
    for trial, rows in enumerate(q.noise.trial_rows):
        if len(rows):
            gram, _ = q.noise.solve(trial, np.stack([slope[rows], state.residual[rows]], axis=1))
            if gram[0, 0] > 0.0:
                asked.append(gram[0, 1] / gram[0, 0])
                weight.append(gram[0, 0])
    if not weight:
        return float("inf")
    d, w = np.array(asked), np.array(weight)
    return float(np.sqrt(max(float(w @ d**2) - len(d), 0.0) / w.sum()))


def _needed(q: Inquiry, naming: Naming) -> Naming:
    """Strike further effects, last first, whose own gain on held-out slots is not certain."""
    while len(keys := naming.chosen.keys) > 1:
        state = naming.chosen.state
        gain = naming.steps[-1][1]
        elsewhere = apart(q, state, keys[-1])
        if elsewhere and gain > PLAIN:
            break
        pairs = [
            (suspect, float(amount))
            for suspect, amount in zip(state.suspects, state.amounts, strict=True)
            if suspect.key != keys[-1]
        ]
        less = q.polish(q.fit([s for s, _ in pairs], [a for _, a in pairs], state))
        if plain(q, naming.excess, less, gain) or settles(q, naming.excess, less, state):
            break  # it may show in few slots only, where no mean over slots is certain
        exact = excess(q, less) < 2.0 * np.sqrt(2.0 * len(q.rows))
        if relieves(less, state) or (elsewhere and exact and gain > SECOND * naming.alarm):
            break
        part = gain < FORM * max(q.base.cost - state.cost, 1.0)
        mends = part and not (elsewhere or exact) and seen(q, less, state) < PLAINLY_SEEN
        if not mends and (
            gain > LARGE * naming.excess or _gains_surely(held_out(q, less), held_out(q, state))
        ):
            break
        naming = replace(
            naming, chosen=Choice(keys[:-1], less), rivals=[], steps=naming.steps[:-1],
            left=excess(q, less),
        )  # fmt: skip
    return naming


def _gains_surely(less: dict[str, Held], more: dict[str, Held]) -> bool:
    """Whether some block's held-out error falls for certain, over units, with the fuller state."""
    for block, held in more.items():
        use = held.weight > 0.0
        gain = (less[block].after - held.after)[use]
        if len(gain) < 3:
            return True
        error = float(gain.std(ddof=1) / np.sqrt(len(gain)))
        if float(gain.mean()) > float(student.ppf(SURE, len(gain) - 1)) * error:
            return True
    return False
