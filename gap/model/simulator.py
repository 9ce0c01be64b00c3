"""The interface of a simulator, and the built-in one behind it.

The diagnosis needs three things of a simulator: what it predicts for a trial, which numbers it may
be recalibrated by and how well each of them is known, and at which stages of the chain a measured
signal can be fed into it. Ours is `BuiltIn`. A Python function of a user, a table of predictions or
an FMU can stand behind the same interface.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from gap.data.dataset import Channel, DataSet, Trial
from gap.model.grid import make_grid
from gap.model.residuals import SCALE, Model, shifted
from gap.model.sensitivities import CONSTANTS
from plant.constants import KEYS


@dataclass(frozen=True)
class Parameter:
    """A number that a simulator may be recalibrated by.

    Attributes:
        name: with its unit, ``dead_volume_ml``.
        nominal: its value before any fit, in that unit.
        tolerance: standard deviation of its prior, in that unit; 0 for a number that is exact.
    """

    name: str
    nominal: float
    tolerance: float


@dataclass(frozen=True)
class Stage:
    """A part of the chain that can be simulated alone, on measured inputs.

    Attributes:
        name: of the stage.
        inputs: channels of a trial that are fed in as they were measured or commanded.
        output: the channel that is predicted, in the unit of its name.
    """

    name: str
    inputs: tuple[str, ...]
    output: str


class Simulator(Protocol):
    """Predicts the channels of a trial.

    The same trial and parameters must give the same channels: the diagnosis takes sensitivities
    by finite differences where a simulator gives none.
    """

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Everything that a fit may change."""
        ...

    @property
    def stages(self) -> tuple[Stage, ...]:
        """The stages that a measured signal can be fed into, in the order of the chain."""
        ...

    def simulate(self, trial: Trial, parameters: Mapping[str, float]) -> dict[str, Channel]:
        """Predicted channels of a trial, each stage fed with what was measured before it.

        Args:
            trial: commands, settings and measured channels. A prediction may use the inputs of
                its stage; the measured output says at which times it is wanted. The built-in
                chamber stage uses it also to begin anew after a long hold.
            parameters: by name, in the units of the names; what is missing is nominal.

        Returns:
            By the name of the stage; only stages whose inputs the trial has.

        Raises:
            KeyError: a parameter that this simulator does not have.
        """
        ...


STAGES = (
    Stage("pressure", ("supply_kpa", "inlet_cmd", "outlet_cmd", "length_mm"), "pressure_kpa"),
    Stage("force", ("pressure_kpa", "length_mm"), "force_n"),
    Stage("camera", ("length_mm",), "length_mm"),
)
"""Stages of the built-in simulator; their names are its blocks of features."""


class BuiltIn:
    """The simulator of this package, as a `Simulator`; thin over `gap.model.residuals`.

    Args:
        data: the data set that the trials belong to: its constants are the nominal plant.
    """

    def __init__(self, data: DataSet) -> None:
        self._data = data
        c = data.constants
        self._parameters = tuple(
            Parameter(
                name,
                getattr(c, KEYS[name].field) / KEYS[name].to_si,
                c.tolerance_si(name) / KEYS[name].to_si,
            )
            for name in CONSTANTS
        )

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The constants that the diagnosis recalibrates, with the tolerances of the plant file."""
        return self._parameters

    @property
    def stages(self) -> tuple[Stage, ...]:
        """Valve and chamber, muscle, camera."""
        return STAGES

    def simulate(self, trial: Trial, parameters: Mapping[str, float]) -> dict[str, Channel]:
        """Predictions at the instants where the diagnosis compares; see :class:`Simulator`."""
        nominal = {p.name: p.nominal for p in self._parameters}
        constants = self._data.constants
        for name, value in parameters.items():
            constants = shifted(constants, name, (value - nominal[name]) * KEYS[name].to_si)
        grid = make_grid(dataclasses.replace(self._data, trials=(trial,)))
        out: dict[str, Channel] = {}
        for stage in STAGES:
            points = grid.points.get(stage.name)
            if points is not None:
                # One row a point: the mean over a row is then the residual itself.
                own = dataclasses.replace(
                    points, row=np.arange(len(points.reading)), weight=np.ones(len(points.reading))
                )
                single = Model(dataclasses.replace(grid, points={stage.name: own}))
                gap = single.residual(constants, [], (stage.name,))[stage.name]
                predicted = points.reading * SCALE[stage.name] - gap
                out[stage.name] = Channel(points.time_s, predicted)
        return out
