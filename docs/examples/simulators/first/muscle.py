"""The user's own simulator: force of a muscle after Tondu and Lopez (2000)."""

import numpy as np


def force(pressure_kpa, length_mm, parameters):
    """Force in N at pressures and lengths of equal shape."""
    angle = np.radians(20.0)
    a, b = 3.0 / np.tan(angle) ** 2, 1.0 / np.sin(angle) ** 2
    shortened = 1.0 - length_mm / 70.0
    area_m2 = np.pi * (parameters["radius_mm"] * 1e-3) ** 2
    bracket = a * (1.0 - parameters["ends"] * shortened) ** 2 - b
    return area_m2 * pressure_kpa * 1e3 * bracket
