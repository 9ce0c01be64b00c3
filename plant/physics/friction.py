"""Rate-independent friction between the fibres of the braid.

A Maxwell-slip operator (Iwan 1966; for McKibben muscles Minh et al. 2010): four elasto-slip
elements in parallel, driven by one coordinate u that says how far the fibres have slid,

    du = dp / travel_p - dL / travel_L        (inflating and shortening slide them the same way)
    dz_i = du / y_i,  kept within [-1, 1]     (y = 1/8, 1/4, 1/2, 1)
    F_friction = friction_n (p / 300 kPa) mean(z_i),   F = F_braid - F_friction

Because threads stretch as pressure rises, fibres slide at constant length too, so pressure cycles
at fixed length show loops: less force on the way up than on the way down. The load on the contacts
is the pressure (Davis and Caldwell 2006), so loops close at zero pressure. Once u has moved by 2
after a reversal every element slips, and up and down differ by exactly twice
friction_n (p / 300 kPa): `friction_n` is half the loop height at 300 kPa.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from plant.physics.layout import SLIP_ELEMENTS

REFERENCE_PRESSURE_PA = 300e3
"""Gauge pressure at which `friction_n` is stated."""


# Compiled into the kernel as well: scalar floats.
def element_slip(z: float, travel: float, index: int) -> float:
    """Slip of element `index` (0 = first to yield) after the fibres slid by `travel`."""
    moved = z + travel * 2.0 ** (SLIP_ELEMENTS - 1 - index)
    return min(1.0, max(-1.0, moved))


def slip_history(
    p_pa: Iterable[float],
    length_m: Iterable[float],
    travel_pa: float,
    travel_m: float,
) -> npt.NDArray[np.float64]:
    """Mean slip (-1 to 1) along a path of pressures and lengths that starts with fresh fibres.

    Rate-independent: only the turning points matter, not how many samples lie between them.
    """
    u = np.asarray(list(p_pa)) / travel_pa - np.asarray(list(length_m)) / travel_m
    z = np.zeros(SLIP_ELEMENTS)
    mean = np.zeros(len(u))
    for row in range(1, len(u)):
        step = float(u[row] - u[row - 1])
        for i in range(SLIP_ELEMENTS):
            z[i] = element_slip(float(z[i]), step, i)
        mean[row] = z.mean()
    return mean
