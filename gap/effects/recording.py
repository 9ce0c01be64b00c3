"""What a recording may have wrong by itself: its defects, and what varies from trial to trial.

They act like effects of the catalogue and are no part of it: no bench has them, only data sets.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plant.constants import PlantConstants
from plant.effects import pressure_stage as stage
from plant.effects.arguments import Array, Params, Points, Shape
from plant.effects.catalogue import CATALOGUE
from plant.effects.effect import EachTrial, Effect, InDiagnosis, Search
from plant.effects.trials import bend, moved


@dataclass(frozen=True)
class RecordingError:
    """One error of a recording; `search` None where the diagnosis does not look for it.

    Amounts are in ms where nothing else is said. `calibration` and `each_trial` are as those of an
    effect of the catalogue.
    """

    id: str
    meaning: str
    diagnosis: InDiagnosis
    search: Search | None = None
    calibration: str = ""
    each_trial: tuple[EachTrial, ...] = ()


def _force_late(force: Array, points: Points, amount: float) -> Array:
    return moved(points, force, -amount * 1e-3)


def _pressure_late(p: Array, points: Points, amount: float, shape: Shape) -> Array:
    return moved(points, p, amount * 1e-3)


def _pressure_clock(params: Params, amount: float, option: str, shape: Shape) -> None:
    params[stage.CLOCK] += amount * 1e-3


def _smoothed(values: Array, points: Points, amount: float) -> Array:
    """Smoothing both ways, to the second order; the amount is its variance over 1e-3 s2."""
    return values + 0.5 * amount * 1e-3 * bend(points, values)


def _mounting(points: Points, amount: float, shape: Shape, c: PlantConstants) -> Array:
    here = points.held & (points.mounting == int(shape["number"]))
    return np.where(here, amount * 1e-3, 0.0)


MOUNTING = InDiagnosis(length=_mounting)
"""What the offset of one mounting does; the force stage applies those of all at once."""


def _camera_zero(length: Array, amount: float, shape: Shape, c: PlantConstants) -> Array:
    return np.full(len(length), amount * 1e-3)


RECORDING: tuple[RecordingError, ...] = (
    RecordingError(
        "force_clock",
        "force_n is out of time with the other channels",
        InDiagnosis(force_shown=_force_late),
        Search(step=4.0, sign=0, blocks=("force", "load"), scan="clock"),
        calibration="force_clock_ms",
    ),
    RecordingError(
        "pressure_clock",
        "pressure_kpa is out of time with the other channels",
        InDiagnosis(pressure=_pressure_late, gas=_pressure_clock),
        Search(step=2.0, sign=0, blocks=("pressure", "force", "load"), scan="clock"),
        calibration="pressure_clock_ms",
    ),
    RecordingError(
        "force_smoothed",
        "force_n is smoothed both ways in time, the other channels are not",
        InDiagnosis(force_shown=_smoothed),
        Search(step=1.0, sign=1, blocks=("force",)),
    ),
    RecordingError(
        "pressure_smoothed",
        "pressure_kpa is smoothed both ways in time, the other channels are not",
        InDiagnosis(pressure_shown=_smoothed),
        Search(step=1.0, sign=1, blocks=("pressure",)),
    ),
    RecordingError(
        "mounting",
        "the lengths of one mounting are all off by this, mm",
        MOUNTING,
    ),
    RecordingError(
        "camera_zero",
        "the camera shows every length off by this, mm",
        InDiagnosis(camera=_camera_zero),
        calibration="length_zero_mm",
        each_trial=(EachTrial("length zero", 0.02, ("force", "load", "camera")),),
    ),
)

_ALL: tuple[Effect | RecordingError, ...] = (*CATALOGUE.values(), *RECORDING)

CALIBRATION: dict[str, str] = {one.calibration: one.id for one in _ALL if one.calibration}
"""The change of a reading that each key of `calibration.toml` stands for."""

EACH_TRIAL: dict[str, tuple[str, EachTrial]] = {
    each.kind: (one.id, each) for one in _ALL for each in one.each_trial
}
"""Errors that are drawn anew for each trial, by kind: what each is an amount of, and its size."""
