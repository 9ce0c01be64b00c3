"""The scale of a sensor that changes over its range: what data sheets call its linearity error."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from plant.constants import PlantConstants
from plant.effects.arguments import Array, Shape, Values
from plant.effects.effect import Parameter

POWERS = (0.3, 3.0)
"""What a bend may be: from one at the foot of the range to one at its upper end."""
_CURVE = ("at_0", "at_1", "at_2", "at_3", "at_4")
"""Control points of a calibration curve at each fifth of the full value, over that at it."""
_PLACES = ("zero", "1/5 of full", "2/5 of full", "3/5 of full", "4/5 of full")
BEYOND = 1.5
"""Times the full value up to which a scale goes on changing: what 30 % too little need."""
_LARGEST_LOG = math.log(10.0)
"""Of what a curve may be off by, over that at the full value."""
_FULL = "full"
"""Full value, SI, of a scale that a plant file states."""
FREE: Mapping[str, tuple[float, float]] = {"power": POWERS, **dict.fromkeys(_CURVE, (0.1, 10.0))}
"""Numbers of these shapes that a fit may move, with the range of each."""
SHAPES: tuple[Shape, ...] = ({}, {"power": 1.0})
"""A straight scale, and one that is off by a power of the value."""
CALIBRATION_CURVE: Shape = dict.fromkeys(_CURVE, 1.0)
"""A scale that is off by any smooth curve, from a straight one on."""


@dataclass(frozen=True)
class Scale:
    """The scale of one kind of sensor, as plant files state it.

    Attributes:
        unit: of the reading in files.
        si: that unit in SI units.
        usual: true value at which `percent` is stated where nothing else is, in the unit.
    """

    unit: str
    si: float
    usual: float

    @property
    def _full(self) -> str:
        return f"full_{self.unit.lower()}"

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters of a scale that is wrong: straight where no more than `percent` is stated."""
        return (
            Parameter("percent", "%", "read over true", -30, 30),
            Parameter("power", "", "of true / full that the error in percent goes with", 0, 3, 0.0),
            *(
                Parameter(name, "", f"error in percent at {share} over that at full", 0.1, 10, 1.0)
                for name, share in zip(_CURVE, _PLACES, strict=True)
            ),
            Parameter(
                self._full, self.unit, "true value at which percent is stated", 1, 1e5, self.usual
            ),
        )

    def shape_of(self, values: Values) -> Shape:
        """Shape of the scale that parameters state, empty for a straight one."""
        curve = {name: float(values[name]) for name in _CURVE}
        shape = {"power": float(values["power"])} if values["power"] else {}
        if any(number != 1.0 for number in curve.values()):
            shape |= curve
        return {**shape, _FULL: float(values[self._full]) * self.si} if shape else {}

    def stated(self, shape: Shape, values: Values, c: PlantConstants) -> Shape:
        """`InDiagnosis.stated`."""
        return self.shape_of(values)

    def changes(self, values: Values) -> bool:
        """`InSensors.scale_changes`."""
        return bool(self.shape_of(values))

    def bent(self, true: Array, values: Values) -> Array:
        """What a reading gains over that of a straight scale as far off at the full value."""
        shape = self.shape_of(values)
        if not shape:
            return np.zeros_like(true)
        return float(values["percent"]) / 100.0 * (linearity(true, shape[_FULL], shape) - true)

    def as_parameters(self, shape: Shape, full: float) -> dict[str, float]:
        """Parameters other than `percent` that give a shape; `full` in SI units."""
        made = {key: value for key, value in shape.items() if key != _FULL}
        return {**made, self._full: full / self.si} if made else {}


def linearity(value: Array, full: float, shape: Shape) -> Array:
    """Error of a scale of this shape that is off by all there is at the full value, in its unit.

    The scale is off by a share that grows with a power of the value, times one whose logarithm is a
    polynomial of the fifth degree (in Bernstein's form): a linearity error between zero and the
    full value (IEC 61298-2). Zero for a straight scale. A full value in the shape takes the place
    of `full`.

    The scale goes on changing up to `BEYOND` times the full value: a diagnosis knows the largest
    reading, and the true value behind it is larger where the sensor shows too little. From there on
    it is off by what it is there.
    """
    if not shape:
        return np.zeros_like(value)
    x = np.minimum(np.abs(value / shape.get(_FULL, full)), BEYOND)
    error = value
    if "power" in shape:
        error = error * x ** shape["power"]
    if _CURVE[0] in shape:
        count = len(_CURVE)
        y = 1.0 - x
        bent = np.zeros_like(x)
        for k, key in enumerate(_CURVE):
            bent = bent + math.comb(count, k) * x**k * y ** (count - k) * math.log(shape[key])
        error = error * np.exp(np.clip(bent, -_LARGEST_LOG, _LARGEST_LOG))
    return np.asarray(error)
