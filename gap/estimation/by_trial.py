"""Effects that differ between the replicates of a slot: one trial has more of it than another.

Replicates are measured alike, so nothing that the plant or its constants get wrong tells them
apart. A fitting that leaked in one of them would be taken for noise: it would raise the floor of
all trials, and hide every gap below it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gap.effects.candidates import Candidate
from gap.effects.terms import OF_TRIAL, Active
from gap.estimation.config import ESTIMATION
from gap.estimation.noise import Noise, usual_noise
from gap.model.features import BLOCKS
from gap.model.residuals import Model
from plant.arrays import Array
from plant.constants import PlantConstants
from plant.effects.catalogue import CATALOGUE

_ROUNDS = 3


@dataclass(frozen=True)
class _Found:
    """What one trial shows of an effect: amount, its sd, and how an amount of one moves the reading
    (root mean square, kPa).
    """

    trial: int
    amount: float
    sd: float
    signature: float


def effects_by_trial(
    model: Model, c: PlantConstants, active: Active, candidates: Sequence[Candidate],
    slots: Sequence[Sequence[int]],
) -> Active:  # fmt: skip
    """What trials have more of an effect than the replicate that has least of it.

    Only what is far beyond the usual noise of a bench, is seen in the readings, and explains most
    of how the replicates differ.

    Args:
        active: effects in force, without these.
        candidates: that may be looked for; those that may differ between trials are.
        slots: trials of each slot.
    """
    made: Active = []
    seen = set[str]()
    for candidate in candidates:
        effect = CATALOGUE.get(candidate.id)
        if effect is None or effect.diagnosis.gas_in_trial is None or candidate.id in seen:
            continue
        seen.add(candidate.id)
        made += _of_candidate(model, c, active, candidate, slots)
    return made


def _of_candidate(
    model: Model, c: PlantConstants, active: Active, candidate: Candidate,
    slots: Sequence[Sequence[int]],
) -> Active:  # fmt: skip
    amounts: dict[int, float] = {}
    tightest = set[int]()
    for _ in range(_ROUNDS):
        own = _in_trials(candidate, amounts)
        residual = _rows(model, c, [*active, *own])
        # A step that all trials take alike: each shows its own signature.
        step = 0.1 * candidate.step
        moved = _rows(model, c, [*active, *own, (candidate.id, candidate.option, step, {})])
        signature = (residual - moved) / step
        noise = usual_noise(model, c, residual)
        changed = False
        for slot in slots:
            found = [one for t in slot if (one := _shown(noise, model, signature, residual, t))]
            if len(found) < 2:
                continue
            known = [one for one in found if one.trial in tightest]
            lowest = known[0] if known else min(found, key=lambda one: one.amount)
            for one in found:
                refined = one.trial in amounts
                if one is not lowest and (
                    refined or (not known and _differs(model, signature, residual, one, lowest))
                ):
                    amounts[one.trial] = amounts.get(one.trial, 0.0) + one.amount - lowest.amount
                    tightest.add(lowest.trial)
                    changed = True
        if not changed:
            break
    return _in_trials(candidate, {t: a for t, a in amounts.items() if a > 0.0})


def _in_trials(candidate: Candidate, amounts: dict[int, float]) -> Active:
    return [
        (candidate.id, candidate.option, amount, {OF_TRIAL: float(trial)})
        for trial, amount in sorted(amounts.items())
    ]


def _rows(model: Model, c: PlantConstants, active: Active) -> Array:
    """Measured minus predicted pressure; zero in the rows of other blocks."""
    return np.nan_to_num(model.stacked(model.residual(c, active, ("pressure",))))


def _shown(
    noise: Noise, model: Model, signature: Array, residual: Array, trial: int
) -> _Found | None:
    rows = noise.trial_rows[trial]
    if not np.any(signature[rows]):
        return None
    gram = noise.solve(trial, np.stack([signature[rows], residual[rows]], axis=1))[0]
    here = rows[model.grid.rows.block[rows] == BLOCKS.index("pressure")]
    size = float(np.sqrt(np.mean(signature[here] ** 2)))
    return _Found(trial, float(gram[0, 1] / gram[0, 0]), float(gram[0, 0] ** -0.5), size)


def _differs(model: Model, signature: Array, residual: Array, one: _Found, other: _Found) -> bool:
    """Whether the effect is most of what tells a trial from its replicate, and well seen."""
    more = one.amount - other.amount
    if more < ESTIMATION.by_trial_sd * np.hypot(one.sd, other.sd):
        return False
    if more * one.signature < ESTIMATION.by_trial_kpa:
        return False
    rows = model.grid.rows
    both = []
    for found in (one, other):
        at = np.flatnonzero((rows.trial == found.trial) & (rows.block == BLOCKS.index("pressure")))
        both.append(dict(zip(rows.bin[at].tolist(), at.tolist(), strict=True)))
    common = sorted(both[0].keys() & both[1].keys())
    if len(common) < _LEAST_ROWS:
        return False
    a, b = (np.array([place[k] for k in common]) for place in both)
    weight = rows.compared_s[a]
    # Zeros differ from trial to trial.
    apart, shape = (
        x - np.average(x, weights=weight)
        for x in (residual[a] - residual[b], 0.5 * (signature[a] + signature[b]))
    )
    whole = float(weight @ apart**2)
    part = float((weight * shape) @ apart) ** 2 / max(float(weight @ shape**2), 1e-300)
    return part > ESTIMATION.by_trial_share * whole


_LEAST_ROWS = 4
"""Rows that two replicates must share to be compared."""
