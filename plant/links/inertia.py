"""Mass, centre of mass and inertia of one rigid link, and a check of their validity.

Tensors are about the centre of mass, in the axes of the link's frame, given as six elements
(xx, yy, zz, xy, xz, yz) of the tensor: xy is minus the integral of x y dm.
"""

from __future__ import annotations

import math

import numpy as np

from plant.arrays import Array
from plant.errors import LinkError

Three = tuple[float, float, float]
Six = tuple[float, float, float, float, float, float]

SLACK = 1e-9
"""Tolerance of the inequalities for rounding in a file, relative to the largest moment."""


def tensor(inertia: Six) -> Array:
    """The 3 x 3 tensor (kg m2) from its six elements."""
    xx, yy, zz, xy, xz, yz = inertia
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def elements(full: Array) -> Six:
    """The six elements of a symmetric 3 x 3 tensor."""
    pairs = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
    return tuple(float(full[i, k]) for i, k in pairs)  # type: ignore[return-value]


def rod_inertia(mass_kg: float, length_m: float, diameter_m: float) -> Six:
    """A uniform round rod along x, about its middle, kg m2.

    Diameter 0 gives the thin rod of Appendix A, with the only moment m l^2 / 12 (m l^2 / 3 about
    its end).
    """
    along = mass_kg * diameter_m**2 / 8.0
    across = mass_kg * (length_m**2 / 12.0 + diameter_m**2 / 16.0)
    return (along, across, across, 0.0, 0.0, 0.0)


def pseudo_inertia(mass_kg: float, com_m: Three, inertia: Six) -> Array:
    """The 4 x 4 pseudo-inertia J about the origin of the link's frame: integral of r r^T dm.

    Here r = (x, y, z, 1). With moments about that origin, the diagonal is (-Ixx + Iyy + Izz)/2,
    (Ixx - Iyy + Izz)/2, (Ixx + Iyy - Izz)/2, m. The erratum of the thesis prints the first one
    three times, which is correct only for a sphere. Its H_xy are the integrals of x y dm, with the
    opposite sign of the tensor elements.
    """
    com = np.array(com_m, dtype=float)
    about_com = tensor(inertia)
    second = np.trace(about_com) / 2.0 * np.eye(3) - about_com
    out = np.empty((4, 4))
    out[:3, :3] = second + mass_kg * np.outer(com, com)
    out[:3, 3] = out[3, :3] = mass_kg * com
    out[3, 3] = mass_kg
    return out


def from_pseudo_inertia(matrix: Array, origin: str = "pseudo-inertia") -> tuple[float, Three, Six]:
    """Mass (kg), centre of mass (m) and tensor (kg m2) of a 4 x 4 pseudo-inertia.

    Raises `LinkError` if the matrix is not symmetric or not physically possible.
    """
    j = np.array(matrix, dtype=float)
    if j.shape != (4, 4) or not np.allclose(j, j.T, rtol=SLACK, atol=0.0):
        raise LinkError(f"{origin}: expected a symmetric 4 x 4 matrix, got shape {j.shape}\n{j}")
    mass = float(j[3, 3])
    com = j[:3, 3] / mass if mass else np.zeros(3)
    second = j[:3, :3] - mass * np.outer(com, com)
    full = np.trace(second) * np.eye(3) - second
    inertia = elements(full)
    position: Three = (float(com[0]), float(com[1]), float(com[2]))
    check_inertia(mass, position, inertia, origin)
    return mass, position, inertia


def check_inertia(mass_kg: float, com_m: Three, inertia: Six, origin: str) -> None:
    """Check that a rigid body can have these values; `origin` names the link in the message.

    Raises:
        LinkError: a mass that is negative or not finite, a massless link with inertia, or a tensor
            with a negative principal moment or one larger than the other two together.
    """
    if not all(math.isfinite(v) for v in (mass_kg, *com_m, *inertia)):
        raise LinkError(f"{origin}: mass, centre of mass and inertia must be finite numbers")
    if mass_kg < 0.0:
        raise LinkError(
            f"{origin}: negative mass, {mass_kg * 1e3:g} g; a link has mass 0 or more "
            "(0 for a joint whose link is a point)"
        )
    if mass_kg == 0.0:
        if any(inertia):
            raise LinkError(
                f"{origin}: an inertia without mass; give the link a mass or omit the inertia"
            )
        return
    a, b, c = np.linalg.eigvalsh(tensor(inertia))
    stated = f"principal moments {a * 1e9:g}, {b * 1e9:g}, {c * 1e9:g} g mm2"
    if a < -SLACK * max(abs(c), abs(a)):
        raise LinkError(
            f"{origin}: not a valid inertia: {stated}, one of them negative; about the "
            "centre of mass all must be 0 or more (check the signs of the products xy, xz, yz)"
        )
    if a + b < c * (1.0 - SLACK):
        raise LinkError(
            f"{origin}: not a valid inertia: {stated}; one moment cannot be larger than the "
            "sum of the other two (are they about the centre of mass?)"
        )
