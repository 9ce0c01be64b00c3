"""Flow of air through an open valve: ISO 6358.

    m_dot = C rho_0 P1 sqrt(T_0 / T) * psi(P2 / P1)

with P1, P2 absolute pressures upstream and downstream. An open inlet passes nothing when P2 >= P1;
a way to the atmosphere lets air in where the muscle is below it, with the same C and b.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from plant.constants import REFERENCE_DENSITY_KG_M3, REFERENCE_TEMPERATURE_K
from plant.errors import PlantError

LINEAR_BELOW = 1e-5
"""Relative pressure difference below which psi is a straight line to zero.

The ellipse meets zero with infinite slope, which no fixed step can follow. At 650 kPa this
touches the last 6.5 Pa only.
"""
MOST_DROOP = 0.45
"""Share of the supply that a droop takes at most."""
_NEWTON_STEPS = 20
"""Most that are taken; three are usual."""
_SETTLED_PA = 0.02
"""Last of Newton's steps that is small enough: what it leaves goes with its square."""
_SETTLED_LOG = 1e-5
"""The same of the logarithm of a flow."""


# The functions below are also compiled into the kernel: scalar floats, no validation.
def subsonic_factor(ratio: float, critical_ratio: float) -> float:
    """psi: 1 when choked, the quarter ellipse of ISO 6358 when not, 0 for a reversed ratio."""
    if ratio <= critical_ratio:
        return 1.0
    if ratio >= 1.0:
        return 0.0
    width = 1.0 - critical_ratio
    below = 1.0 - ratio
    # 1 - s^2 = (1 - s)(1 + s) with 1 - s = below / width: no cancellation near equal pressures.
    if below < LINEAR_BELOW:
        edge = LINEAR_BELOW / width
        return math.sqrt(edge * (2.0 - edge)) * below / LINEAR_BELOW
    share = below / width
    return math.sqrt(share * (2.0 - share))


def with_index(psi: float, more: float) -> float:
    """Psi with a subsonic index of 0.5 + `more` (0.2 to 1) where `psi` is that with 0.5.

    ISO 6358-1:2013: psi = (1 - s^2)^m, s = (ratio - b) / (1 - b); m = 0.5 is the ellipse.
    """
    return float(psi ** min(max(1.0 + 2.0 * more, 0.4), 2.0)) if psi < 1.0 else 1.0


def outward_drive(absolute: float, outside: float, critical_ratio: float) -> float:
    """Upstream pressure times psi of a way to the outside, Pa; below zero where air comes in."""
    if absolute >= outside:
        return absolute * subsonic_factor(outside / absolute, critical_ratio)
    return -outside * subsonic_factor(absolute / outside, critical_ratio)


def drooped(
    supply: float, downstream: float, droop: float, critical_ratio: float, power: float
) -> float:
    """Absolute pressure P1 in Pa at the inlet of a source that falls with the flow it gives.

        P1 = P_s - droop (q / q_choked)^power,    q_choked: the flow choked at P_s - droop

    `power` 1 is the droop line of a regulator's flow characteristic (ISO 6953-2), 2 a line or
    fitting in turbulent flow (Darcy 1857, Weisbach 1845), below 1 a regulator that gives way at
    once. With the ellipse of ISO 6358 power 1 is a quadratic in P1. The result is P_s - droop when
    choked and P_s without flow. A droop beyond 45 % of the supply counts as that much.
    """
    if downstream >= supply:
        return supply
    fall = min(droop, MOST_DROOP * supply)
    choked = supply - fall
    if downstream <= critical_ratio * choked:
        return choked
    if power != 1.0:
        return inlet_behind(supply, downstream, fall, choked, critical_ratio, power)
    slope = (fall / choked) ** 2
    bend = slope / (1.0 - critical_ratio) ** 2
    a = 1.0 - slope + bend * critical_ratio * critical_ratio
    b = supply + bend * downstream * critical_ratio
    c = supply * supply + bend * downstream * downstream
    # The smaller root, in the form that does not cancel.
    return c / (b + math.sqrt(max(0.0, b * b - a * c)))


def inlet_behind(
    source: float, downstream: float, fall: float, choked: float, critical_ratio: float,
    power: float,
) -> float:  # fmt: skip
    """Absolute pressure P1 in Pa at an inlet behind a line that takes a power of the flow.

        P_s - P1 = fall q^power,    q = psi(P2 / P1) P1 / `choked`

    `source` P_s lies above `downstream` P2; both absolute, in Pa.
    """
    # (w P_c q)^2 = (w P1)^2 - (P2 - b P1)^2, w = 1 - b, is the ellipse without its root: in q there
    # is no end where the slope is infinite. Its last term is nothing where the flow is choked.
    width = 1.0 - critical_ratio
    most = width * choked
    free = subsonic_factor(downstream / source, critical_ratio) * source / choked
    share = free
    for _ in range(_NEWTON_STEPS):
        lost = fall * share**power
        if lost > source - downstream:  # no flow leaves less than is downstream
            share *= ((source - downstream) / lost) ** (1.0 / power)
            lost = source - downstream
        inlet: float = source - lost
        beyond = max(downstream - critical_ratio * inlet, 0.0)
        excess = (most * share) ** 2 - (width * inlet) ** 2 + beyond * beyond
        bend = power * lost / share
        slope = most * most * share
        slope += bend * (width * width * inlet + critical_ratio * beyond)
        step = 0.5 * excess / slope
        if abs(bend * step) < _SETTLED_PA:
            inlet += bend * step
            if inlet - downstream > LINEAR_BELOW * inlet:
                return inlet
            break
        share = min(share - step, free) if step < share else 0.5 * share
    # Near equal pressures psi is a straight line, P1 = P2 + q `each`: in logarithms nearly one too.
    edge = LINEAR_BELOW / width
    each = LINEAR_BELOW * choked / math.sqrt(edge * (2.0 - edge))
    for _ in range(_NEWTON_STEPS):
        lost = fall * share**power
        both = lost + each * share
        off = math.log(both / (source - downstream))
        share *= math.exp(-off * both / (power * lost + each * share))
        if abs(off) < _SETTLED_LOG:
            break
    return downstream + each * share


def subsonic_factors(
    ratios: npt.NDArray[np.float64], critical_ratio: float
) -> npt.NDArray[np.float64]:
    """Psi of each pressure ratio, see `subsonic_factor`."""
    return np.array([subsonic_factor(float(ratio), critical_ratio) for ratio in ratios])


def subsonic_slope(ratio: float, critical_ratio: float) -> float:
    """Return -d psi / d ratio (>= 0), at and beyond equal pressures that of the straight line."""
    if ratio <= critical_ratio:
        return 0.0
    width = 1.0 - critical_ratio
    below = 1.0 - ratio
    if below < LINEAR_BELOW:
        edge = LINEAR_BELOW / width
        return math.sqrt(edge * (2.0 - edge)) / LINEAR_BELOW
    share = below / width
    return (1.0 - share) / (width * math.sqrt(share * (2.0 - share)))


def outward_slope(absolute: float, outside: float, critical_ratio: float) -> float:
    """Derivative of `outward_drive` in the pressure within (>= 0)."""
    if absolute >= outside:
        ratio = outside / absolute
        slope = ratio * subsonic_slope(ratio, critical_ratio)
        return subsonic_factor(ratio, critical_ratio) + slope
    return subsonic_slope(absolute / outside, critical_ratio)


def mass_flow_kg_s(
    upstream_pa: float,
    downstream_pa: float,
    conductance_m3_s_pa: float,
    critical_ratio: float,
    temperature_k: float = REFERENCE_TEMPERATURE_K,
) -> float:
    """Mass flow in kg/s between two absolute pressures (ISO 6358-1, subsonic index 0.5).

    Raises `PlantError` for pressures that are not positive or a ratio outside [0, 1).
    """
    if not (upstream_pa > 0.0 and downstream_pa >= 0.0):
        raise PlantError(
            f"flow from {upstream_pa!r} to {downstream_pa!r} Pa: "
            "absolute pressures must be positive"
        )
    if not 0.0 <= critical_ratio < 1.0:
        raise PlantError(f"critical_ratio = {critical_ratio!r}; allowed 0 <= critical_ratio < 1")
    choked = conductance_m3_s_pa * REFERENCE_DENSITY_KG_M3 * upstream_pa
    choked *= math.sqrt(REFERENCE_TEMPERATURE_K / temperature_k)
    return choked * subsonic_factor(downstream_pa / upstream_pa, critical_ratio)
