"""The built-in plant behind the interface of a simulator (`gap.data.simulator`)."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np

from gap.data.dataset import DataSet
from gap.data.simulator import FORCE_STAGE, PRESSURE_STAGE, Parameter, Stage
from gap.data.trial import Channel, Trial
from gap.model.grid import make_grid
from gap.model.residuals import SCALE, Model, shifted
from gap.model.sensitivities import CONSTANTS
from plant.constants import KEYS

STAGES = (PRESSURE_STAGE, FORCE_STAGE, Stage("camera", ("length_mm",), "length_mm"))
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
