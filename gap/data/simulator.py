"""The interface of a simulator: what the diagnosis needs of one, whoever wrote it.

The diagnosis needs three things of a simulator: what it predicts for a trial, which numbers it may
be recalibrated by and how well each of them is known, and at which stages of the chain a measured
signal can be fed into it. A Python function, an FMU, a table of predictions and a fitted law of the
muscle stand behind this interface, and so does the built-in plant.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from gap.data.trial import Channel, Trial
from plant.arrays import Array
from plant.models.model import Domain

Mask = npt.NDArray[np.bool_]


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
        name: of the stage: ``pressure`` or ``force``.
        inputs: channels of a trial that are fed in as they were measured or commanded.
        output: the channel that is predicted, in the unit of its name.
    """

    name: str
    inputs: tuple[str, ...]
    output: str


PRESSURE_STAGE = Stage(
    "pressure", ("supply_kpa", "inlet_cmd", "outlet_cmd", "length_mm"), "pressure_kpa"
)
FORCE_STAGE = Stage("force", ("pressure_kpa", "length_mm"), "force_n")
STAGES = {stage.name: stage for stage in (PRESSURE_STAGE, FORCE_STAGE)}
"""Stages that a simulator from elsewhere may stand for, by name."""


class Simulator(Protocol):
    """Predicts the channels of a trial.

    The same trial and parameters must give the same channels: the diagnosis takes sensitivities
    by finite differences.
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
                its stage; the measured output says at which times it is wanted.
            parameters: by name, in the units of the names; what is missing is nominal.

        Returns:
            By the name of the stage; only stages whose inputs the trial has.

        Raises:
            KeyError: a parameter that this simulator does not have.
        """
        ...


class ExternalSimulator(Simulator, Protocol):
    """A simulator that takes the place of a part of the built-in plant."""

    @property
    def covariance(self) -> Array | None:
        """Prior covariance of the parameters, shape (parameters, parameters), in their units.

        None where they are independent, each with its tolerance.
        """
        ...

    @property
    def model_error_n(self) -> float:
        """One sd of the error in N that the form of its force stage is known to have; 0 if none.

        The error is a smooth function of pressure and length, the same in all trials.
        """
        ...

    @property
    def noise_n(self) -> float:
        """One sd of a single reading of the force in N; 0 where it is not known.

        It holds where the data have no replicates that would show it.
        """
        ...

    @property
    def origin(self) -> str:
        """The file that describes it, for messages."""
        ...


@runtime_checkable
class StaticForce(Protocol):
    """A force stage without memory: force is a function of pressure and length alone.

    The diagnosis evaluates it at the true pressure and length behind the readings, so that errors
    of sensors act through it exactly.
    """

    def force_n(
        self, pressure_kpa: Array, length_mm: Array, parameters: Mapping[str, float]
    ) -> Array:
        """Pull in N, same shape as the arguments.

        Args:
            pressure_kpa: gauge pressures.
            length_mm: lengths, same shape.
            parameters: by name, in the units of the names.
        """
        ...


@runtime_checkable
class LimitedForce(Protocol):
    """A force stage that holds at some pressures and lengths only."""

    @property
    def domain(self) -> Domain | None:
        """Where it holds; None where nothing is said."""
        ...


def domain_of(simulator: Simulator | None) -> Domain | None:
    """Where the force of a simulator holds; None where nothing is said."""
    return simulator.domain if isinstance(simulator, LimitedForce) else None


def holds(domain: Domain, pressure_kpa: Array, length_mm: Array) -> Mask:
    """Whether points lie in a domain, or beyond it by no more than a sensor's zero may move them.

    Farther out a law may be off by any amount, so nothing is compared there.
    """
    inside = np.ones(np.broadcast(pressure_kpa, length_mm).shape, dtype=bool)
    for value, (low, high), least in (
        (pressure_kpa, domain.pressure_kpa, _LEAST_KPA), (length_mm, domain.length_mm, _LEAST_MM),
    ):  # fmt: skip
        margin = max(_MARGIN * (high - low), least)
        inside &= (value >= low - margin) & (value <= high + margin)
    return inside


_MARGIN = 0.02
"""Share of the extent by which a point may lie beyond it."""
_LEAST_KPA, _LEAST_MM = 3.0, 0.3


def compared(simulator: Simulator | None, pressure_kpa: Array, length_mm: Array) -> Mask:
    """Which points of a force may be compared with a simulator; all where none limits them."""
    domain = domain_of(simulator)
    if domain is None:
        return np.ones(np.broadcast(pressure_kpa, length_mm).shape, dtype=bool)
    return holds(domain, pressure_kpa, length_mm)


@runtime_checkable
class RoughForce(Protocol):
    """A force stage whose error changes from point to point, as between the points of a table."""

    @property
    def rough_error_n(self) -> float:
        """One sd of it in N: where it shows, nothing smaller can be seen."""
        ...


def rough_error_n(simulator: Simulator | None) -> float:
    """One sd in N of a simulator's error that changes from point to point; 0 without one."""
    return simulator.rough_error_n if isinstance(simulator, RoughForce) else 0.0
