"""A data set for diagnosis: trials with their channels, whoever recorded them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from daq.calibration import StandardReading
from gap.data.simulator import ExternalSimulator
from gap.data.trial import Trial
from plant.constants import PlantConstants
from plant.effects.effects import NONE, Effects
from plant.effects.empirical import UNCORRECTED, Corrections

CALIBRATION = (
    "pressure_zero_kpa", "pressure_gain_percent", "force_zero_n", "force_gain_percent",
    "length_zero_mm", "length_gain_percent",
    "pressure_clock_ms", "force_clock_ms", "length_clock_ms",
)  # fmt: skip
"""Keys of `calibration.toml`."""


@dataclass(frozen=True)
class DataSet:
    """Trials of one bench, and the constants of that bench as far as they are stated.

    Attributes:
        origin: the folder or run it came from, for messages.
        trials: in order of measurement.
        constants: the nominal plant with what `bench.toml` states.
        effects: effects that `bench.toml` switches on, so that they are no gap.
        notes: what a reader of the verdict should know (columns ignored, trials left out).
        calibration: standard uncertainty of what all trials share of a sensor's zero, gain or
            clock, by `CALIBRATION`'s names; what is not stated is taken as exact.
        corrections: empirical terms that `bench.toml` states, so that they are no gap.
        standards: what the instruments read of reference standards.
        simulator: takes the place of the built-in stages that it stands for; None for none.
    """

    origin: str
    trials: tuple[Trial, ...]
    constants: PlantConstants
    effects: Effects = NONE
    notes: tuple[str, ...] = field(default=())
    calibration: Mapping[str, float] = field(default_factory=dict)
    simulator: ExternalSimulator | None = None
    corrections: Corrections = UNCORRECTED
    standards: tuple[StandardReading, ...] = ()

    @property
    def slots(self) -> dict[str, list[int]]:
        """Indices of the trials of each slot, in order of first appearance."""
        slots: dict[str, list[int]] = {}
        for index, trial in enumerate(self.trials):
            slots.setdefault(trial.slot, []).append(index)
        return slots

    @property
    def mountings(self) -> npt.NDArray[np.int64]:
        """Number of the mounting of each trial, in order of first appearance; -1 if not stated."""
        labels = [trial.mounting for trial in self.trials]
        known = {label: k for k, label in enumerate(dict.fromkeys(filter(None, labels)))}
        return np.array([known.get(label, -1) for label in labels], dtype=np.int64)

    @property
    def settled(self) -> bool:
        """Whether every trial is a table of settled points."""
        return all(trial.settled for trial in self.trials)
