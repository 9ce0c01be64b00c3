"""Replicates that are not identical: equal commands of a controller, but unequal valve actions.

What a wrong plant misses then differs between the replicates and would pass for noise, many times
as large as the noise itself. So the noise of such data is learnt from the part of the residual that
no constant and no candidate effect can make.
"""

from __future__ import annotations

import numpy as np

from gap.data.dataset import DataSet
from gap.data.trial import COMMANDS, Channel
from gap.estimation.config import ESTIMATION
from gap.estimation.noise import Noise
from plant.arrays import Array

_RIDGE = 1e-6


def non_identical(data: DataSet) -> bool:
    """Whether valves acted otherwise in some replicate than in the first of its slot."""
    for members in data.slots.values():
        first, *others = (data.trials[member] for member in members)
        for trial in others:
            if any(_differ(first.get(name), trial.get(name)) for name in COMMANDS):
                return True
    return False


def _differ(a: Channel, b: Channel) -> bool:
    if len(a) != len(b):
        return True
    later = np.abs(a.time_s - b.time_s).max(initial=0.0)
    return bool(later > ESTIMATION.same_edges_s or np.any(a.value != b.value))


def unexplainable(columns: Array, residual: Array, noise: Noise) -> Array:
    """What of a residual no mix of signatures makes, shape (rows,).

    Args:
        columns: signatures, shape (rows, columns).
        residual: shape (rows,).
        noise: as it usually is.
    """
    both = np.hstack([columns, residual[:, None]])
    gram = np.zeros((both.shape[1], both.shape[1]))
    for trial, rows in enumerate(noise.trial_rows):
        if len(rows):
            gram += noise.solve(trial, both[rows])[0]
    size = np.sqrt(np.maximum(np.diag(gram)[:-1], 1e-30))
    # The ridge is there because many signatures are nearly the same.
    alike = gram[:-1, :-1] / np.outer(size, size) + _RIDGE * np.eye(len(size))
    made = columns @ (np.linalg.solve(alike, gram[:-1, -1] / size) / size)
    return np.asarray(residual - made)
