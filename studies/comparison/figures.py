"""Figures of merit of a trial: rise, settling, overshoot, steady error, path error."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from studies.controllers.loop import Trial
from studies.controllers.reference import GRID_S, STEP_DEG

STEADY_S = 1.0
BAND_DEG = 1.0


@dataclass(frozen=True)
class StepFigures:
    """Figures of merit of one step, from true angles; None if not reached.

    `rise_s` is from 10 to 90 %, `settling_s` the time until the angle stays within 1 degree,
    `overshoot_percent` relative to the step. Over the last second: `steady_error_deg` is the
    largest error of the joint, `mean_error_deg` its mean, `ripple_deg` its range,
    `others_error_deg` the largest error of any other joint.
    """

    rise_s: float | None
    settling_s: float | None
    overshoot_percent: float
    steady_error_deg: float
    mean_error_deg: float
    ripple_deg: float
    others_error_deg: float
    switchings_per_s: float
    faults: tuple[str, ...]


@dataclass(frozen=True)
class PathFigures:
    """Figures of merit of one path: distance of the fingertip from its reference position.

    The first turn is not included, except in `first_turn_rms_mm`.
    """

    rms_mm: float
    worst_mm: float
    first_turn_rms_mm: float
    switchings_per_s: float
    faults: tuple[str, ...]


def step_figures(trial: Trial, joint: int, degrees: float = STEP_DEG) -> StepFigures:
    """Figures of merit of a step of one joint."""
    begin = round(trial.reference.scored_from_s / GRID_S)
    goal = trial.reference.q[-1]
    q = np.degrees(trial.q[begin:] - goal)
    # Relative to the reference before the step: a steady error before it is not part of the rise.
    share = 1.0 + q[:, joint] / degrees
    time = np.arange(len(share)) * GRID_S
    up = [np.flatnonzero(share >= level) for level in (0.1, 0.9)]
    rise = float(time[up[1][0]] - time[up[0][0]]) if len(up[0]) and len(up[1]) else None
    outside = np.flatnonzero(np.abs(q[:, joint]) > BAND_DEG)
    settled = len(outside) == 0 or outside[-1] < len(q) - 1
    settling = float(time[outside[-1] + 1] if len(outside) else 0.0) if settled else None
    last = q[-round(STEADY_S / GRID_S) :]
    others = np.delete(last, joint, axis=1)
    duration = trial.reference.duration_s
    return StepFigures(
        rise,
        settling,
        max(0.0, float(share.max() - 1.0) * 100.0),
        float(np.abs(last[:, joint]).max()),
        float(last[:, joint].mean()),
        float(np.ptp(last[:, joint])),
        float(np.abs(others).max()),
        trial.switchings / duration,
        tuple(trial.faults),
    )


def path_figures(trial: Trial, lead_s: float = 1.5) -> PathFigures:
    """Figures of merit of a path of the fingertip."""
    assert trial.reference.tip is not None
    distance = np.linalg.norm(trial.tip - trial.reference.tip, axis=1) * 1e3
    begin = round(trial.reference.scored_from_s / GRID_S)
    first = distance[round(lead_s / GRID_S) : begin]
    return PathFigures(
        float(np.sqrt(np.mean(distance[begin:] ** 2))),
        float(distance[begin:].max()),
        float(np.sqrt(np.mean(first**2))),
        trial.switchings / trial.reference.duration_s,
        tuple(trial.faults),
    )
