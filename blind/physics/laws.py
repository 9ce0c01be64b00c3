"""Force, volume and flow: the nominal equations and every addition to them, compiled.

Units: kPa, mm, N, mm/s, degC; mass flow in mg/s, volumes in ml (1 kPa ml = 1e-3 J).
Forms are numbered: 0 is the plainest one, 1 and 2 are the alternatives that blind data use, and
those from 3 on are held out (`blind.physics.alternatives`). Nominal force and volume: Chou and
Hannaford 1996; flow: ISO 6358. The equation and the source of every form: `blind.physics.forms`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy.optimize import nnls

from blind.physics import alternatives
from blind.physics import numbers as n
from blind.physics.compiled import compiled

RHO = 1.185  # kg/m3 at the reference condition of ISO 6358
T_REF = 293.15
GAS = 287.05
WARM_REFERENCE_C = 21.0
Array = Any


@compiled
def lost_pressure(p: float, e: Array) -> float:
    """Gauge pressure the liner keeps for itself, kPa."""
    form, limit = e[n.LINER, 0], e[n.LINER, 1]
    if form == 1.0:  # exponential approach
        return limit * (1.0 - math.exp(-max(p, 0.0) / limit)) if limit != 0.0 else 0.0
    if form == 2.0:  # sigmoid: little at first, all of it soon after
        c = 0.7 * limit
        return limit * p * p / (p * p + c * c) if p > 0.0 else 0.0
    if form == 0.0:
        return min(max(p, 0.0), limit) if limit > 0.0 else 0.0
    if form >= 3.0:
        return alternatives.lost_pressure(form, limit, p)
    return 0.0


@compiled
def effective_length(length: float, p: float, c: Array, e: Array) -> float:
    """Length the braid's angle belongs to, mm."""
    b = c[n.BRAID]
    out = length
    form, s = e[n.CAP, 0], e[n.CAP, 1]
    if form == 0.0:
        out -= s
    elif form == 1.0:  # the cone at each end grows with the diameter
        out -= s * math.sqrt(max(b * b - length * length, 1.0) / (b * b - 3600.0))
    elif form == 2.0:  # ... with the swelling beyond the stretched diameter
        top = c[n.L_MAX] + 6.0
        out -= s * max(top - length, 0.0) / (top - 60.0)
    elif form >= 3.0:
        out -= s * alternatives.shortening(form, length, p, c)
    if e[n.BACKLASH, 0] >= 0.0:  # play in the mount is taken up as the muscle pulls
        out -= e[n.BACKLASH, 1] * math.exp(-max(p, 0.0) / e[n.BACKLASH, 2])
    return out


@compiled
def warmth_factor(p: float, c: Array, e: Array) -> float:
    """Factor of the braid's force at the muscle's temperature."""
    form, s = e[n.WARMTH, 0], e[n.WARMTH, 1] / 100.0
    warm = c[n.MUSCLE_C] - WARM_REFERENCE_C
    if form == 0.0:
        return float(1.0 + s * warm * p / 500.0)
    if form == 1.0:  # saturates with pressure
        return float(1.0 + s * warm * (p / (p + 100.0)) * 1.2)
    if form == 2.0:  # exponential in temperature, square root in pressure
        return math.exp(s * warm * math.sqrt(max(p, 0.0) / 500.0))
    return alternatives.warmth(form, s, warm, p)


@compiled
def wear_factor(c: Array, e: Array) -> float:
    """Factor of the braid's force after the trials it has seen."""
    form, s = e[n.WEAR, 0], e[n.WEAR, 1] / 100.0
    if form == 0.0:
        return float(1.0 + s * c[n.TRIAL] / 100.0)
    if form == 1.0:  # running in: fast at first
        return float(1.0 + s * math.log(1.0 + c[n.TRIAL] / 25.0) / math.log(5.0))
    if form == 2.0:  # ages faster and faster
        x = c[n.TRIAL] / 100.0
        return float(1.0 + s * x * (0.6 + 0.4 * x))
    return alternatives.wear(form, s, c[n.TRIAL])


@compiled
def braid_force(p: float, length: float, c: Array, e: Array) -> float:
    """Static pull of the braid, N, for gauge pressure in kPa and length in mm."""
    pe = p - lost_pressure(p, e)
    le = effective_length(length, p, c, e)
    b = c[n.BRAID]
    form, s = e[n.FIBRE, 0], e[n.FIBRE, 1] / 100.0
    if form == 0.0:
        b *= 1.0 + s * p / 500.0
    elif form == 1.0:  # thread tension grows with the diameter too
        swell = math.sqrt(max(b * b - length * length, 1.0) / (b * b - 3600.0))
        b *= 1.0 + s * p / 500.0 * swell
    elif form == 2.0:  # slack is taken up first: stiffer under load
        b *= 1.0 + s * (1.0 - math.exp(-p / 300.0)) / (1.0 - math.exp(-500.0 / 300.0))
    elif form >= 3.0:
        b *= 1.0 + s * alternatives.stretch(form, p)
    force = 1e-3 * pe * (3.0 * le * le - b * b) / (4.0 * math.pi * c[n.TURNS] ** 2)
    if e[n.WARMTH, 0] >= 0.0:
        force *= warmth_factor(p, c, e)
    if e[n.WEAR, 0] >= 0.0:
        force *= wear_factor(c, e)
    return float(force)


@compiled
def static_force(p: float, length: float, c: Array, e: Array) -> float:
    """Pull of the muscle at rest and without memory, N."""
    force = braid_force(p, length, c, e)
    form, k = e[n.BLADDER, 0], e[n.BLADDER, 1]
    if form >= 0.0:
        x = length - e[n.BLADDER, 2]
        if form == 0.0:
            force += k * x
        elif form == 1.0:  # hardening cubic, slope k at 60 mm
            beta = e[n.BLADDER, 3]
            x60 = 60.0 - e[n.BLADDER, 2]
            force += k * (x + beta * x**3) / (1.0 + 3.0 * beta * x60 * x60)
        elif form >= 3.0:
            force += alternatives.spring(form, k, e[n.BLADDER, 2], e[n.BLADDER, 3], length)
        else:  # exponential (Fung), slope k at 60 mm
            s = e[n.BLADDER, 3]
            force += k * s * (math.exp(x / s) - 1.0) / math.exp((60.0 - e[n.BLADDER, 2]) / s)
    form, lost = e[n.LIMIT, 0], e[n.LIMIT, 1]
    if form >= 0.0:
        reach = e[n.LIMIT, 2]
        x = length - c[n.L_MIN] - 1.0
        if form == 0.0:
            force -= lost * max(reach - x, 0.0) / reach
        elif form == 1.0:
            force -= lost * math.exp(-x / reach)
        elif form >= 3.0:
            force -= lost * alternatives.jammed(form, reach, x)
        elif x < 2.5 * reach:  # locking braid: quadratic
            force -= lost * ((2.5 * reach - x) / (2.5 * reach)) ** 2
    if e[n.BUCKLE, 0] >= 0.0:  # a fold in one place of the map
        dl = (length - e[n.BUCKLE, 2]) / 1.2
        dp = (p - e[n.BUCKLE, 3]) / 55.0
        force -= e[n.BUCKLE, 1] * math.exp(-dl * dl - dp * dp)
    return force


@compiled
def viscous_force(v: float, e: Array) -> float:
    """Force of the rate of lengthening, N."""
    form, d = e[n.VISCOSITY, 0], e[n.VISCOSITY, 1]
    if form == 0.0:
        return float(d * v)
    if form == 1.0:  # saturates
        vs = e[n.VISCOSITY, 2]
        return float(10.0 * d * math.tanh(v / vs) / math.tanh(10.0 / vs))
    if form == 2.0:  # power law, smooth at rest
        m = e[n.VISCOSITY, 2]
        return float(10.0 * d * v / 10.0 * ((v * v + 0.01) / 100.01) ** (0.5 * (m - 1.0)))
    if form >= 3.0:
        return alternatives.rate_force(form, d, e[n.VISCOSITY, 2], v)
    return 0.0


@compiled
def friction_level(p: float, e: Array) -> float:
    """Half the loop's height at gauge pressure p, N: exactly the headline at 300 kPa."""
    share = e[n.BRAID_FRICTION, 2]
    if e[n.BRAID_FRICTION, 0] >= 3.0:
        shares = alternatives.level(e[n.BRAID_FRICTION, 0], share, p)
        return float(e[n.BRAID_FRICTION, 1] * shares)
    return float(e[n.BRAID_FRICTION, 1] * (1.0 - share + share * max(p, 0.0) / 300.0))


@compiled
def slip(y: Array, e: Array) -> float:
    """State of the slip elements together, -1..1."""
    if e[n.BRAID_FRICTION, 0] == 2.0:
        return float(0.25 * (y[n.Y_SLIP] + y[n.Y_SLIP + 1] + y[n.Y_SLIP + 2] + y[n.Y_SLIP + 3]))
    return float(y[n.Y_SLIP])


@compiled
def muscle_force(p: float, length: float, v: float, y: Array, c: Array, e: Array, w: Array) -> Any:
    """Pull of the muscle with its memories, and its static part, N."""
    static = static_force(p, length, c, e)
    force = static
    if e[n.CREEP, 0] >= 0.0:
        for i in range(n.MEMORIES):
            force -= e[n.CREEP, 1] / 100.0 * w[0, i] * y[n.Y_CREEP + i]
    if e[n.VISCOSITY, 0] >= 0.0:
        force += viscous_force(v, e)
    if e[n.BRAID_FRICTION, 0] >= 0.0:
        force += friction_level(p, e) * slip(y, e)
    return force, static


@compiled
def volume(length: float, c: Array) -> float:
    """Inner volume of the muscle with the line, ml."""
    braid = c[n.BRAID] ** 2 * length - length**3
    return float(1e-3 * braid / (4.0 * math.pi * c[n.TURNS] ** 2) + c[n.DEAD_ML])


@compiled
def volume_slope(length: float, c: Array) -> float:
    """Derivative of the volume, ml/mm."""
    return float(1e-3 * (c[n.BRAID] ** 2 - 3.0 * length**2) / (4.0 * math.pi * c[n.TURNS] ** 2))


@compiled
def orifice(p1: float, p2: float, conductance: float, ratio: float, m: float, t: float) -> float:
    """Mass flow in mg/s from p1 to p2 (kPa absolute), none backwards."""
    if p1 <= p2:
        return 0.0
    flow = conductance * RHO * p1 * 1e9 * math.sqrt(T_REF / t)
    x = p2 / p1
    if x <= ratio:
        return flow
    u = (x - ratio) / (1.0 - ratio)
    return float(flow * max(1.0 - u * u, 0.0) ** m)


@compiled
def valve_flow(p1: float, p2: float, side: int, opened_ms: float, c: Array, e: Array) -> float:
    """Mass flow of an open inlet (side 0) or outlet (side 1), mg/s."""
    conductance = c[n.C_IN] if side == 0 else c[n.C_OUT]
    ratio, m = c[n.RATIO], 0.5
    if e[n.AREA, 0] >= 0.0 and e[n.AREA, 2] == side:
        r = e[n.AREA, 1]
        if e[n.AREA, 0] == 1.0:  # the seat lifts in a moment
            conductance *= 1.0 + (r - 1.0) * (1.0 - 0.5 * math.exp(-opened_ms / 1.5))
        elif e[n.AREA, 0] == 2.0:  # discharge coefficient moves with the pressure ratio
            conductance *= 1.0 + (r - 1.0) * (0.9 + 0.2 * min(p2 / max(p1, 1.0), 1.0))
        elif e[n.AREA, 0] >= 3.0:
            conductance *= alternatives.area(e[n.AREA, 0], r, p1, p2)
        else:
            conductance *= r
    if e[n.CRITICAL, 0] >= 0.0:
        ratio = min(max(e[n.CRITICAL, 1], 0.02), 0.98)
        if e[n.CRITICAL, 0] == 1.0:
            m = 0.48
        elif e[n.CRITICAL, 0] == 2.0:
            m = 0.53
        elif e[n.CRITICAL, 0] >= 3.0:
            choked = conductance * RHO * p1 * 1e9 * math.sqrt(T_REF / c[n.GAS_K])
            return float(choked * alternatives.choking(e[n.CRITICAL, 0], p1, p2, ratio))
    return float(orifice(p1, p2, conductance, ratio, m, c[n.GAS_K]))


@compiled
def leak_flow(p: float, c: Array, e: Array) -> float:
    """Air that escapes whatever the command, mg/s; p in kPa absolute."""
    pa = c[n.ATMOSPHERE]
    form, g = e[n.LEAK, 0], e[n.LEAK, 1]
    flow = 0.0
    if form == 0.0:
        flow = orifice(p, pa, g, 0.5, 0.5, c[n.GAS_K])
    elif form == 1.0:  # laminar crack, equal to the choked one at 300 kPa gauge
        ref = 401.325
        flow = g * RHO * 1e9 * ref * (p * p - pa * pa) / (ref * ref - 101.325**2)
    elif form == 2.0:  # long capillary: chokes late
        flow = orifice(p, pa, g, 0.2, 0.5, c[n.GAS_K])
    elif form >= 3.0:
        flow = alternatives.leak(form, g, p, pa, RHO * math.sqrt(T_REF / c[n.GAS_K]))
    if e[n.WEEP, 0] >= 0.0:  # a relief seat that weeps above its pressure
        over = max(p - pa - e[n.WEEP, 2], 0.0)
        flow += e[n.WEEP, 1] * over * over / (40.0 + over)
    return float(max(flow, 0.0))


def relaxation(form: float, shape: float) -> np.ndarray:
    """Weights and times (s) of a Prony series whose growth is 1 at 60 s; shape (2, MEMORIES).

    Form 0: one exponential of `shape` seconds; 1: two Kelvin elements; 2: logarithmic (equal
    weights in equal steps of the logarithm of time, from `shape` on); 3: a power of time with the
    exponent `shape`; 4: a stretched exponential of `shape` seconds, exponent 0.45.
    """
    times = np.ones(n.MEMORIES)
    weights = np.zeros(n.MEMORIES)
    if form == 0.0:
        times[0], weights[0] = shape, 1.0
    elif form == 1.0:
        times[:2], weights[:2] = (0.12 * shape, 1.6 * shape), (0.45, 0.55)
    elif form >= 3.0:
        times[:] = np.geomspace(0.37, 1700.0, n.MEMORIES)
        t = np.geomspace(0.19, 700.0, 80)
        goal = t**shape / 60.0**shape if form == 3.0 else 1.0 - np.exp(-((t / shape) ** 0.45))
        weights[:], _ = nnls(1.0 - np.exp(-t[:, None] / times), goal)
    else:
        times[:] = np.geomspace(0.15 * shape, 900.0, n.MEMORIES)
        weights[:] = 1.0
    grown = float(np.sum(weights * (1.0 - np.exp(-60.0 / times))))
    return np.array([weights / grown, times])
