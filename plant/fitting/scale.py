"""Start values and bounds for a muscle of another size than that of the shipped values.

The shipped values belong to a muscle of 67 mm that pulls 80 N. A muscle that is s_L times as long
and s_F times as strong at the same pressure obeys F(p, L) = s_F f(p, L / s_L), so a parameter with
the unit N^a mm^b is multiplied by s_F^a s_L^b, and its bounds with it. Dimensions across the muscle
and turns follow from the force instead: they are in the formulas only as constants of the force.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from itertools import product

import numpy as np

from plant.errors import PlantError
from plant.fitting.data import Points
from plant.fitting.fit import fit
from plant.models.model import Geometry, Model, Parameter
from plant.models.units import powers

SAME_LENGTH = (0.9, 1.1)
"""Longest length over the shipped rest length for which the muscle counts as that one, if no rest
length is stated. Loads stretch the muscle of the thesis to 72.5 mm; many tests stay shorter."""
SAME_FORCE = (0.5, 2.0)
"""Force over that of the shipped values for which these values are good start values."""
REST = "rest_length"
GRID: dict[str, dict[str, tuple[float, ...]]] = {
    "sarosi": {"p3": (-0.05, -0.1, -0.2, -0.4, -0.8)},
    "sarosi-five": {"a2": (-0.05, -0.1, -0.2, -0.4, -0.8)},
    "fluidic": {"braid_angle": (15.0, 25.0, 40.0), "elastic_strain": (1.0, 2.5, 6.0)},
}
"""Start values that are tried for the parameters in which a law is far from linear."""


@dataclass(frozen=True)
class Scaling:
    """Factors applied to start values and bounds; 1 if the muscle is like the shipped one.

    `rest_length_mm` is the rest length used, or None where the shipped values were kept;
    `stated` tells whether it was given or is the longest length of the data.
    """

    length: float
    force: float
    rest_length_mm: float | None
    stated: bool

    @property
    def changed(self) -> bool:
        """Whether anything was scaled."""
        return self.length != 1.0 or self.force != 1.0 or self.stated


def scaled(model: Model, points: Points, geometry: Geometry | None = None) -> tuple[Model, Scaling]:
    """The model with start values and bounds for the muscle of these points.

    Args:
        model: a shipped model; its domain states the size of its muscle.
        points: of the other muscle.
        geometry: measured dimensions, if known. Without, the longest length of the points counts as
            rest length if it is not like that of the shipped muscle.

    Raises:
        PlantError: a stated rest length that the points exceed by more than a tenth.
    """
    own = model.domain.length_mm[1]
    longest = float(points.length_m.max()) * 1e3
    rest = longest if geometry is None else geometry.rest_length_mm
    if geometry is not None and longest > 1.1 * rest:
        raise PlantError(
            f"rest length {rest:g} mm, and {points.source or 'the data'} reach {longest:g} mm; "
            "state the length of the muscle slack and without pressure"
        )
    length = rest / own
    if geometry is None and SAME_LENGTH[0] <= length <= SAME_LENGTH[1]:
        length = 1.0
    force = _force_ratio(model, points, length)
    if SAME_FORCE[0] <= force <= SAME_FORCE[1]:
        force = 1.0
    found = Scaling(length, force, rest if length != 1.0 or geometry else None, bool(geometry))
    if not found.changed:
        return model, found
    parameters = tuple(_scaled(p, found, geometry) for p in model.parameters)
    model = dataclasses.replace(
        model, parameters=parameters, geometry=geometry, covariance=None,
        noise_n=None, model_error_n=None,
    )  # fmt: skip
    return _best_start(model, points), found


def _force_ratio(model: Model, points: Points, length: float) -> float:
    """Force of the points over that of the model at the same pressure and contraction."""
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        own = model.law.force(
            model.q, points.pressure_pa, points.length_m / length, points.temperature_c, points.path
        )
    sound = np.isfinite(own)
    own, measured = own[sound], points.force_n[sound]
    square = float(own @ own)
    ratio = float(own @ measured) / square if square > 0 else 1.0
    return ratio if np.isfinite(ratio) and ratio > 0 else 1.0


def _scaled(p: Parameter, by: Scaling, geometry: Geometry | None) -> Parameter:
    across = {
        "turns": by.length / by.force**0.5,
        "radius": by.force**0.5,
        "diameter": by.force**0.5,
        "diameter_at_90": by.force / by.length,
    }
    units = powers(p.unit)
    factor = across.get(
        p.name,
        by.force ** units.get("N", 0) * by.length ** (units.get("mm", 0) + units.get("m", 0)),
    )
    value, low, high = p.value * factor, p.low * factor, p.high * factor
    if p.name == REST and by.rest_length_mm is not None:
        value = by.rest_length_mm
    if p.name == "diameter" and geometry is not None:
        value = geometry.diameter_mm
    return dataclasses.replace(p, value=value, low=min(low, value), high=max(high, value), sd=None)


def _best_start(model: Model, points: Points) -> Model:
    """The start from which the parameters that are nearly linear fit best."""
    grid = _grid(model)
    if not grid:
        return model
    linear = tuple(p.name for p in model.parameters if not p.fixed and p.name not in grid)
    best, least = model, np.inf
    for values in product(*grid.values()):
        start = model.with_values(dict(zip(grid, values, strict=True)))
        try:
            found = fit(start, points, free=linear)
        except PlantError:
            continue
        if found.rmse_n < least:
            best, least = found.model, found.rmse_n
    return model.with_values(best.values)


def _grid(model: Model) -> dict[str, tuple[float, ...]]:
    from plant.models.catalogue import LAWS

    name = next((n for n, law in LAWS.items() if law is model.law), "")
    return GRID.get(name, {})
