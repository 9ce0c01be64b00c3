"""How much of a gap the diagnosis's own model really closes: judged on noise-free readings.

The same trials are recorded once more without noise, zeros, gains and mishaps, and the fitted
plant predicts them: what it leaves, against what the recalibrated plant leaves, is the true
closed fraction that the verdict's interval should hold.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from blind.exchange import write
from blind.noise import Noise
from blind.recording import record
from blind.sets import BlindSet
from gap.data.reader import read_dataset
from gap.decision.diagnose import diagnose_with_fit
from gap.estimation.cross_validation import held_out
from gap.estimation.fit_problem import FitResult
from gap.model.features import BLOCKS, UNITS
from gap.model.grid import make_grid
from gap.model.residuals import Model

Floats = np.ndarray


def silent(noise: Noise) -> Noise:
    """The same bench, its muscles mounted as they were, with nothing that shakes."""
    levels = {f.name: 0.0 for f in fields(noise) if isinstance(getattr(noise, f.name), float)}
    steps = {"pressure_step_kpa": 1e-6, "force_step_n": 1e-6}
    times = {"pressure_slow_s": 1.0, "force_slow_s": 1.0}
    kept = {"mounting_mm": noise.mounting_mm}
    return replace(noise, **{**levels, **steps, **times, **kept})  # type: ignore[arg-type]


def closed_fraction(
    one: BlindSet, folder: Path, without: Sequence[str], gap: Mapping[str, Any]
) -> float | None:
    """True closed fraction of the diagnosis's fit to `folder`, in the channel of its verdict.

    The channel is the block in the verdict's unit whose recalibrated gap, held out, is the one it
    states. Mountings stay as they were: their offsets are part of either fit. None where the fit
    names nothing or the noise-free gap vanishes.
    """
    _, problem, fit = diagnose_with_fit(read_dataset(folder), without)
    if problem is None or fit is None or not fit.candidates:
        return None
    clean = folder.with_name("clean")
    write(record(replace(one, noise=silent(one.noise))), clean)
    held = held_out(problem, fit)
    grid = make_grid(read_dataset(clean))
    model = Model(grid)

    def left(fit: FitResult) -> Floats:
        active = problem.active_effects(fit.shift, fit.candidates, fit.amounts)
        return np.nan_to_num(model.stacked(model.residual(problem.constants(fit.shift), active)))

    before, after = left(problem.base) ** 2, left(fit) ** 2
    rows, best, miss = grid.rows, None, np.inf
    for number, block in enumerate(BLOCKS):
        here = rows.block == number
        if UNITS[block] != gap.get("unit") or block not in held or not here.any():
            continue
        weight = rows.compared_s[here]
        total = float(np.sum(weight * before[here]))
        off = abs(held[block].rms("recalibrated") - float(gap["recalibrated"] or 0.0))
        if total > 0.0 and off < miss:
            best, miss = 1.0 - float(np.sum(weight * after[here])) / total, off
    return best
