"""How large the noise of the points is, and how large the systematic error of a fitted law."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from plant.arrays import Array
from plant.errors import PlantError
from plant.fitting.compare import held_pressures
from plant.fitting.data import Points
from plant.fitting.fit import Fit

LEAST_REPEATS = 5
"""Degrees of freedom of repeated points from which they give the noise (its own uncertainty is then
a third)."""
LEAST_TRIPLES = 10
"""Triples of neighbouring pressures from which the roughness of the residuals gives the noise."""


@dataclass(frozen=True)
class Misfit:
    """Noise of a force reading (1 sd) and rms systematic error of the law, in N, with their origin.

    `noise_from` is "repeats", "roughness" (of the residuals along the pressure) or "scatter" (of
    the fit). `error_from` is "held-out pressures" or "residuals". With "scatter" the two cannot be
    told apart, and each is an upper limit that contains the other.
    """

    noise_n: float
    noise_from: str
    model_error_n: float
    error_from: str


def misfit(found: Fit, points: Points) -> Misfit:
    """Separate the residuals of a fit into noise and systematic error.

    Noise: the scatter of repeated points, if there are enough. Otherwise the roughness of the
    residuals: each residual less the straight line between its neighbours in pressure at the same
    length (Gasser, Sroka and Jennen-Steinmetz 1986), which a smooth error of the law hardly enters.
    Otherwise the scatter of the fit. Systematic error: what the points at held-out pressures miss
    by (every other pressure is fitted), less the noise in quadrature; 0 if the noise explains it.
    The scatter of the fit is not subtracted, because it contains the systematic error.
    """
    noise, noise_from = _noise(found, points)
    try:
        missed, error_from = (
            held_pressures(found.model, points, found.free)[0],
            "held-out pressures",
        )
    except PlantError:
        missed, error_from = np.full(1, found.sd_n), "residuals"
    square = float(np.mean(np.square(missed))) - (0.0 if noise_from == "scatter" else noise**2)
    return Misfit(noise, noise_from, float(np.sqrt(max(square, 0.0))), error_from)


def with_misfit(found: Fit, points: Points) -> tuple[Fit, Misfit]:
    """The fit with `noise_n` and `model_error_n` in its model."""
    sizes = misfit(found, points)
    model = dataclasses.replace(
        found.model, noise_n=sizes.noise_n, model_error_n=sizes.model_error_n
    )
    return dataclasses.replace(found, model=model), sizes


def _noise(found: Fit, points: Points) -> tuple[float, str]:
    residual = found.residual_n
    if points.cell is not None:
        square, dof = 0.0, 0
        for cell in np.unique(points.cell):
            here = residual[points.cell == cell]
            square += float(np.sum((here - here.mean()) ** 2))
            dof += here.size - 1
        if dof >= LEAST_REPEATS:
            return float(np.sqrt(square / dof)), "repeats"
    rough = _roughness(residual, points)
    if rough.size >= LEAST_TRIPLES:
        return min(float(np.sqrt(np.mean(rough**2))), found.sd_n), "roughness"
    return found.sd_n, "scatter"


def _roughness(residual: Array, points: Points) -> Array:
    """Residuals less the line between their neighbours in pressure, with the variance of one."""
    keys = [points.labels("length"), points.labels("temperature"), points.labels("mounting")]
    line = np.array(["/".join(parts) for parts in zip(*keys, strict=True)])
    found: list[float] = []
    for name in np.unique(line):
        at = np.flatnonzero(line == name)
        at = at[np.argsort(points.pressure_pa[at], kind="stable")]
        p, r = points.pressure_pa[at], residual[at]
        for k in range(1, at.size - 1):
            if not p[k - 1] < p[k] < p[k + 1]:
                continue
            weight = (p[k] - p[k - 1]) / (p[k + 1] - p[k - 1])
            rest = r[k] - (1 - weight) * r[k - 1] - weight * r[k + 1]
            found.append(float(rest / np.sqrt(1.0 + (1 - weight) ** 2 + weight**2)))
    return np.array(found)
