"""What effects add to the muscle's force: plain formulas, zero when their parameter is zero.

SI throughout: p gauge Pa, lengths m, rates m/s (positive when lengthening), forces N that pull the
ends together. Arguments may be floats or arrays of matching shapes. The kernel compiles these same
functions; `plant.simulator.force_law` puts them together for whole arrays.
"""

from __future__ import annotations

from typing import Any

import numpy as np

REFERENCE_LENGTH_M = 0.060
"""Length at which the stiffness of the bladder and the shortening of the ends are stated."""
STRETCH_PRESSURE_PA = 500e3
"""Pressure at which the stretch of the fibres and the change with temperature are stated."""
VISCOUS_RATE_M_S = 0.010
"""Speed at which the damping is stated."""
VISCOUS_PRESSURE_PA = 300e3
"""Pressure at which the damping is stated, where it depends on the pressure."""
VISCOUS_FLOOR_M_S = 1e-4
"""Speed below which a power law of the speed becomes a straight line."""
LIMIT_OFFSET_M = 1e-3
"""How far above the shortest length the force lost to the contraction limit is stated."""
CREEP_AFTER_S = 60.0
"""Time after a step at which the relaxation is stated."""
CREEP_ELEMENTS = 4


def stretched(b: Any, p: Any, per_pa: float) -> Any:
    """Braid length under the load of its threads, which is the pressure's: b (1 + s p).

    After Davis, Tsagarakis, Canderle and Caldwell (2003), whose threads lengthen in proportion
    to their tension.
    """
    return b * (1.0 + per_pa * np.maximum(p, 0.0))


def effective_length(length: Any, share: float, rest: float) -> Any:
    """Length of the cylinder that would pull as this muscle with its tapering ends does.

        L_e = L - s (L_rest - L)

    i.e. contraction counted 1 + s times, the factor k of Tondu and Lopez (2000).
    """
    return length - share * (rest - length)


def cap_share(shortening: float, rest: float) -> float:
    """Share s of `effective_length`, from the shortening at 60 mm."""
    return shortening / (rest - REFERENCE_LENGTH_M)


def bladder_force(length: Any, stiffness: float, rest: float, hardening: float) -> Any:
    """Spring of the rubber tube along the muscle, force zero at `rest`.

        F = k (x + h x^3) / (1 + 3 h x_60^2),   x = L - L_rest

    so that dF/dL at 60 mm is k whatever the hardening. A passive spring beside the braid, as in
    Chou and Hannaford (1996); the cubic term stands for the stiffening of rubber (Klute and
    Hannaford 2000).
    """
    x = length - rest
    at = REFERENCE_LENGTH_M - rest
    return stiffness * (x + hardening * x * x * x) / (1.0 + 3.0 * hardening * at * at)


def bladder_slope(length: Any, stiffness: float, rest: float, hardening: float) -> Any:
    """dF/dL of the bladder's spring."""
    x = length - rest
    at = REFERENCE_LENGTH_M - rest
    return stiffness * (1.0 + 3.0 * hardening * x * x) / (1.0 + 3.0 * hardening * at * at)


def limit_force(length: Any, lost: float, shortest: float, scale: float) -> Any:
    """Force lost as the braid jams: lost exp(-(L - L_min - 1 mm) / scale).

    The wall term that Tondu (2012) asks for near the greatest contraction, as an exponential.
    """
    return lost * np.exp(-(length - shortest - LIMIT_OFFSET_M) / scale)


def viscous_force(rate: Any, p: Any, damping: float, exponent: float, with_pressure: float) -> Any:
    """Force against the motion, damping times speed at 10 mm/s.

        F = c v ((v^2 + e^2) / (v_0^2 + e^2))^((q - 1) / 2) (1 - s + s p / 300 kPa)

    v_0 = 10 mm/s, e = 0.1 mm/s. q = 1 is the dashpot of Reynolds, Repperger, Phillips and Bandry
    (2003), who also saw it grow with pressure (s); q < 1 saturates as in Hill's law, which Klute,
    Czerniecki and Hannaford (2002) used beside such a muscle.
    """
    pace = rate * rate + VISCOUS_FLOOR_M_S * VISCOUS_FLOOR_M_S
    pace0 = VISCOUS_RATE_M_S * VISCOUS_RATE_M_S + VISCOUS_FLOOR_M_S * VISCOUS_FLOOR_M_S
    bend = (pace / pace0) ** (0.5 * (exponent - 1.0))
    load = 1.0 - with_pressure + with_pressure * np.maximum(p, 0.0) / VISCOUS_PRESSURE_PA
    return damping * rate * bend * load


def follow(value: float, before: float, after: float, duration: float, tau: float) -> float:
    """First-order follower of an input that runs straight from `before` to `after`.

    Exact for any duration: with z = t / tau and e = exp(-z),
    y' = e y + (1 - e) after - (after - before) ((1 - e) / z - e).
    """
    z = duration / tau
    if z < 1e-9:
        return value + z * (0.5 * (before + after) - value)
    e = np.exp(-z)
    mean = -np.expm1(-z) / z
    return float(e * value + (1.0 - e) * after - (after - before) * (mean - e))


def creep_times(fast: float, slow: float) -> Any:
    """Time constants of the creep elements in s, evenly spread over the logarithm of time."""
    return fast * (slow / fast) ** (np.arange(CREEP_ELEMENTS) / (CREEP_ELEMENTS - 1))


def creep_gain(relaxation: float, fast: float, slow: float) -> float:
    """Weight of each element, so that a step has lost `relaxation` of itself after 60 s.

    Equal weights over the logarithm of time: the nearly straight line over log t that rubber
    shows (quasi-linear viscoelasticity, Fung 1993; on such muscles Vo-Minh, Tjahjowidodo, Ramon
    and Van Brussel 2011).
    """
    times = creep_times(fast, slow)
    return relaxation / float(np.sum(-np.expm1(-CREEP_AFTER_S / times)))
