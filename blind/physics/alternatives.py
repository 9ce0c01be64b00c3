"""Forms 3 and up of every effect: those that are held out, compiled.

Only the campaign of `gap.check` may ask for them (`blind.physics.forms`). Each is scaled so that
the headline parameter means what the catalogue says, at the place where the catalogue states it.
Equations and sources stand in `blind.physics.forms`; units as in `blind.physics.laws`.
"""

from __future__ import annotations

import math
from typing import Any

from blind.physics import numbers as n
from blind.physics.compiled import compiled

Array = Any
STATED_MM = 60.0
STATED_KPA = 300.0
FULL_KPA = 500.0


@compiled
def lost_pressure(form: float, limit: float, p: float) -> float:
    """Gauge pressure the liner keeps, kPa."""
    if p <= 0.0 or limit <= 0.0:
        return 0.0
    if form == 3.0:  # a balloon passes its greatest pressure before it meets the braid
        x = p / 80.0
        return float(min(p, limit * (1.0 + 0.5 * x * math.exp(1.0 - x))))
    wide = 130.0  # places along the liner meet the braid one after the other
    return float(min(p, limit * p / (p + wide) * (FULL_KPA + wide) / FULL_KPA))


@compiled
def shortening(form: float, length: float, p: float, c: Array) -> float:
    """Share of the stated shortening that the ends take."""
    b = c[n.BRAID]
    if form == 3.0:  # a truncated cone down to the fitting's diameter
        fitting = math.sqrt(max(b * b - (c[n.L_MAX] + 3.5) ** 2, 1.0))
        here = math.sqrt(max(b * b - length * length, 1.0))
        at = math.sqrt(b * b - STATED_MM * STATED_MM)
        return float(max(here - fitting, 0.0) / max(at - fitting, 1.0))
    if form == 5.0:  # a factor on the contraction that falls with the pressure, kept by the ends
        factor = 1.0 + 0.7 * math.exp(-max(p, 0.0) / 130.0)
        return float(factor / (1.0 + 0.7 * math.exp(-FULL_KPA / 130.0)))
    # the bladder bridges the clamp, less so the harder it is blown up
    bridged = 1.0 - math.exp(-max(p, 0.0) / 170.0)
    return float(0.35 + 0.65 * bridged / (1.0 - math.exp(-FULL_KPA / 170.0)))


@compiled
def stretch(form: float, p: float) -> float:
    """Lengthening of the threads over that at 500 kPa."""
    if form == 3.0:  # crimp is pulled out first: compliant toe, then stiff
        toe = 90.0
        x = max(p, -0.5 * toe)
        return float(1.25 * x / (x + toe) * (FULL_KPA + toe) / FULL_KPA - 0.25 * x / FULL_KPA)
    x = p / FULL_KPA  # Ramberg and Osgood
    return float((x + 0.8 * x * abs(x) ** 3) / 1.8)


@compiled
def warmth(form: float, per_k: float, warm: float, p: float) -> float:
    """Factor of the force `warm` K above the reference temperature."""
    if form == 3.0:  # Arrhenius, felt by the rubber's share, which pressure outgrows
        room = 294.15
        felt = 2.0 / (1.0 + max(p, 0.0) / FULL_KPA)
        return float(math.exp(felt * per_k * warm * room / (room + warm)))
    wide = 51.6  # Williams, Landel and Ferry
    return float(math.exp(per_k * warm * wide / (wide + warm)))


@compiled
def wear(form: float, share: float, trial: float) -> float:
    """Factor of the force after so many trials."""
    x = trial / 100.0
    if form == 3.0:  # bathtub: bedded in early, worn out late
        early, early_at = 1.0 - math.exp(-x / 0.15), 1.0 - math.exp(-1.0 / 0.15)
        return float(1.0 + share * (0.45 * early / early_at + 0.55 * x**3))
    softened, softened_at = 1.0 - math.exp(-x / 0.55), 1.0 - math.exp(-1.0 / 0.55)  # Mullins
    return float(1.0 + share * softened / softened_at)


@compiled
def spring(form: float, k: float, rest: float, locking: float, length: float) -> float:
    """Force of the rubber tube, N; slope k at 60 mm."""
    u = length / rest
    at = STATED_MM / rest
    neo = u - 1.0 / (u * u)
    slope = 1.0 + 2.0 / at**3
    if form == 3.0:  # neo-Hookean
        return float(k * rest * neo / slope)
    j = max(locking - (u * u + 2.0 / u - 3.0), 0.05 * locking)  # Gent
    j_at = locking - (at * at + 2.0 / at - 3.0)
    neo_at = at - 1.0 / (at * at)
    slope = slope / j_at + neo_at * (2.0 * at - 2.0 / (at * at)) / (j_at * j_at)
    return float(k * rest * neo / j / slope)


@compiled
def jammed(form: float, reach: float, x: float) -> float:
    """Share of the stated loss at x mm above the place where it is stated."""
    wide = 2.0 * reach
    near = max(wide - x, 0.0)
    if form == 3.0:  # threads in contact
        return float((near / wide) ** 1.5)
    end = 2.0 * wide + 4.3  # finitely extensible
    near = min(near, 0.95 * end)
    return float(near / (1.0 - (near / end) ** 2) * (1.0 - (wide / end) ** 2) / wide)


@compiled
def rate_force(form: float, d: float, bend: float, v: float) -> float:
    """Force of the rate of lengthening, N; d is force per speed at 10 mm/s."""
    if form == 3.0:  # Hill's hyperbola
        return float(d * v * (10.0 + bend) / (abs(v) + bend))
    return float(10.0 * d * math.asinh(v / bend) / math.asinh(10.0 / bend))  # Eyring


@compiled
def slip_rate(form: float, rate: float, z: float, slow: float) -> float:
    """Rate of the slip state of braid or slide; `rate` and `slow` in slip lengths per second."""
    way = 1.0 if rate > 0.0 else -1.0
    if form == 3.0:  # LuGre: the bristles bend further while all is slow
        pace = rate / slow
        bristle = 1.0 + 0.3 * math.exp(-pace * pace)
        return float(rate * (1.0 - way * z / bristle))
    along = 1.0 if way * z > 0.0 else -1.0  # Bouc and Wen
    return float(rate * (1.0 - abs(z) ** 1.6 * (0.7 * along + 0.3)))


@compiled
def level(form: float, share: float, p: float) -> float:
    """Friction of the braid over that at 300 kPa."""
    x = max(p, 0.0) / STATED_KPA
    if form == 3.0:
        return float(1.0 - share + share * x)
    return float(1.0 - share + share * (x**0.667))  # contact of round threads


@compiled
def side_flow(over: float, tau: float) -> float:
    """Rate of change of the pressure in a side volume, kPa/s, `over` kPa below the muscle's."""
    return float(over / tau * math.sqrt(35.0 / (abs(over) + 1.5)))  # turbulent orifice


@compiled
def valved_flow(over: float, tau: float) -> float:
    """The same into a side volume that fills past a check valve and empties through a throttle."""
    return float(over / tau if over > 0.0 else over / (5.5 * tau))


@compiled
def sorbed_rate(gauge: float, held: float, tau: float) -> float:
    """Rate in kPa/s at which a drying agent takes up air, of `held` kPa that it holds.

    It tends to a Langmuir isotherm; what it holds is that of a vessel at `held`, at 300 kPa the
    pressure itself.
    """
    above = max(gauge, 0.0)
    return float((above * (STATED_KPA + 210.0) / (above + 210.0) - held) / (14.0 * tau))


@compiled
def slow_wall(gauge: float, follows: float) -> float:
    """Rate in kPa/s at which a viscous wall comes after the pressure, as a gauge pressure."""
    return float((gauge - follows) / 0.23)


@compiled
def swollen(gauge: float) -> float:
    """Volume of a soft hose over that at 300 kPa: arctangent."""
    return float(0.45 + 0.55 * math.atan(gauge / 110.0) / math.atan(STATED_KPA / 110.0))


@compiled
def swelling(gauge: float) -> float:
    """Its derivative, 1/kPa."""
    x = gauge / 110.0
    return float(0.55 / 110.0 / (1.0 + x * x) / math.atan(STATED_KPA / 110.0))


@compiled
def preloaded(gauge: float) -> float:
    """Volume behind a spring over that at 300 kPa: none below the spring's preload."""
    return float(max(gauge - 72.0, 0.0) / (STATED_KPA - 72.0))


@compiled
def springing(gauge: float) -> float:
    """Its derivative, 1/kPa."""
    return float(1.0 / (STATED_KPA - 72.0) if gauge > 72.0 else 0.0)


@compiled
def leak(form: float, g: float, p: float, pa: float, density: float) -> float:
    """Leaking mass flow, mg/s, equal to the choked one at 300 kPa gauge; p absolute."""
    if p <= pa:
        return 0.0
    full = g * density * 1e9 * (STATED_KPA + 101.325)
    top = (STATED_KPA + 101.325) ** 2 - 101.325**2
    if form == 3.0:  # a crack that gapes: cubic law
        gape = (1.0 + (p - pa) / 170.0) / (1.0 + STATED_KPA / 170.0)
        return float(full * (p * p - pa * pa) / top * gape**3)
    # permeation past a lip that the pressure presses down
    return float(full * (p - pa) / STATED_KPA * math.exp((STATED_KPA - (p - pa)) / 260.0))


@compiled
def discharge(x: float) -> float:
    """Coefficient of a sharp orifice over the pressure ratio (Perry 1949)."""
    return 0.8414 + x * (-0.1002 + x * (0.8415 + x * (-3.9 + x * (4.6001 - 1.6827 * x))))


@compiled
def area(form: float, r: float, p1: float, p2: float) -> float:
    """Factor of a valve's conductance whose ratio is stated as r."""
    if form == 3.0:  # discharge coefficient of a sharp orifice
        return float(1.0 + (r - 1.0) * discharge(min(p2 / max(p1, 1.0), 1.0)) / 0.749)
    if form == 5.0:  # a reed or poppet that the flow lifts against its spring
        return float(1.0 + (r - 1.0) * (0.32 + 0.68 * math.sqrt(max(p1 - p2, 0.0) / STATED_KPA)))
    return float(1.0 + (r - 1.0) * (1.0 + 0.0007 * (p1 - 400.0)))  # linear in supply pressure


@compiled
def choking(form: float, p1: float, p2: float, ratio: float) -> float:
    """Flow over the choked flow, whose pressure ratio is `ratio`."""
    if p1 <= p2:
        return 0.0
    x = p2 / p1
    if form == 3.0:  # isentropic, stretched to the stated ratio, through a sharp orifice
        ideal = 0.5283
        if x <= ratio:
            return 1.0
        y = min(ideal + (x - ratio) * (1.0 - ideal) / (1.0 - ratio), 1.0)
        most = ideal ** (2.0 / 1.4) - ideal ** (2.4 / 1.4)
        flow = math.sqrt(max(y ** (2.0 / 1.4) - y ** (2.4 / 1.4), 0.0) / most)
        return float(flow * discharge(y) / discharge(ideal))
    if form == 5.0:  # the jet is the more contracted the denser the gas is
        bent = min(max(ratio + 0.00021 * (p1 - 385.0), 0.01), 0.97)
        u = max((x - bent) / (1.0 - bent), 0.0)
        return float(math.sqrt(1.0 - u * u))
    crack = 4.0 / p1  # a check that needs some pressure to open, and a blunt passage
    x += crack
    if x >= 1.0:
        return 0.0
    if x <= ratio:
        return 1.0
    u = (x - ratio) / (1.0 - ratio)
    return float((1.0 - u * u) ** 0.58)


@compiled
def exponent(extra: float, since_s: float) -> float:
    """Polytropic exponent some time after a valve opened: adiabatic first, the wall's later."""
    return float(1.0 + extra * (0.75 + 0.5 * math.exp(-max(since_s, 0.0) / 0.06)))


@compiled
def wall_rate(over: float, tau: float) -> float:
    """How fast natural convection takes a pressure back, kPa/s, `over` kPa above room's."""
    return float(over / tau * (abs(over) / 25.0 + 0.02) ** 0.333)


@compiled
def stirred_rate(over: float, tau: float, flow: float) -> float:
    """The same where the jet stirs the gas: `flow` through the valves in mg/s."""
    return float(over / tau * (0.12 + 9.4 * (flow / 900.0) ** 0.78))


@compiled
def sag_rate(form: float, gain: float, tau: float, inflow: float, fall: float) -> float:
    """Rate of the fall of the supply, kPa/s."""
    if form == 3.0:  # receiver filled again through an orifice
        return float(gain * inflow - fall / tau * math.sqrt(27.0 / (abs(fall) + 2.3)))
    if form == 4.0:  # friction of the line: goes with the flow squared
        return float((gain * inflow * inflow - fall) / 0.004)
    if form == 6.0:  # holds its pressure up to its capacity, then gives way
        over = max(inflow - 310.0, 0.0)
        return float((gain * over - fall) / 0.009)
    opening = (inflow + 1.0) ** (1.0 / 3.0) - 1.0  # a regulator falls most as it begins to open
    return float((gain * opening - fall) / 0.012)


@compiled
def late(form: float, delay: float, fills: float, rested_s: float) -> float:
    """Delay of a stroke, ms."""
    if form == 3.0:  # what has rested sticks
        rest = min(max(rested_s, 1e-3), 100.0)
        return float(delay * (1.0 + 0.045 * math.log(rest / 0.4)))
    return float(delay * (0.88 + 0.24 * math.exp(-fills / 9.0)))  # residual flux is worn down


@compiled
def late_with_pressure(form: float, slope: float, p: float) -> float:
    """Delay, ms, whose slope over pressure is the stated one at 300 kPa."""
    x = max(p, 0.0)
    if form == 3.0:  # current rises evenly, force with its square
        return float(2.0 * slope * math.sqrt(STATED_KPA * x))
    most = 1500.0  # the current of a coil tends to an end
    steep = 0.5 / math.sqrt(STATED_KPA * most) / (1.0 - math.sqrt(STATED_KPA / most))
    return float(-slope / steep * math.log(1.0 - math.sqrt(min(x, 0.9 * most) / most)))


@compiled
def edge_after(form: float, due: float, before: float) -> float:
    """When an edge happens that follows another one at `before`, s; nan: both come to nothing."""
    width = due - before
    if form == 3.0:  # a short pulse is degraded: its end comes early
        return float(due - 0.45 * width * math.exp(-max(width, 0.0) / 5e-3))
    if form == 4.0:  # pulses below a limit are rejected
        return float(math.nan) if width < 2.6e-3 else due
    return float(max(due, before + 6.5e-3))  # dead time after each stroke


@compiled
def slide_drag(form: float, v: float, z: float) -> float:
    """Friction of the slide over its sliding friction."""
    if form == 3.0:  # LuGre with some damping of the bristles
        return float(z + 0.017 * math.tanh(v / 3.0))
    return z


@compiled
def tap_rates(form: float, tau: float, p: float, y: float, y1: float, pa: float) -> Any:
    """Rates of the tap's two states, kPa/s: pressure shown, and its scaled speed (form 3)
    or its slow part (form 5).
    """
    if form == 3.0:  # a line that rings: damping ratio 0.6
        omega = 1.2 / tau
        return omega * y1, omega * (p - y) - 1.2 * omega * y1
    if form == 5.0:  # a quick part and a slow one side by side; y1 is the slow one
        quick, slow, part = 0.37 * tau, 2.89 * tau, 0.75
        of_slow = (p - y1) / slow
        of_quick = (p - (y - (1.0 - part) * y1) / part) / quick
        return part * of_quick + (1.0 - part) * of_slow, of_slow
    if form == 6.0:  # slower down than up
        return (p - y) / (tau if p > y else 1.63 * tau), 0.0
    # compressible laminar flow in the line, exact at 300 kPa
    mean = 0.5 * (p + y) + pa
    return (p - y) / tau * max(mean, 20.0) / (STATED_KPA + 101.325), 0.0


@compiled
def lever(length: float) -> float:
    """Pull of a load on a lever over that at 60 mm."""
    angle = (STATED_MM - length) / 35.0
    return float(math.cos(angle) + 0.35 * math.sin(angle))


@compiled
def chain(length: float, longest: float) -> float:
    """Weight of a chain that is lifted off its heap over that at 60 mm."""
    lifted = max(longest - length, 0.0) / (longest - STATED_MM)
    return float(0.55 + 0.45 * lifted * lifted)


@compiled
def label_shift(form: float, length: float) -> float:
    """Error of a held length over the stated one."""
    if form == 3.0:  # the screw's own error repeats with its pitch
        return float(1.0 + 0.12 * math.sin(2.0 * math.pi * length / 2.6))
    if form == 5.0:  # a scale in two sections, the upper one set against the lower one
        return 0.73 if length < 59.3 else 1.31
    tilt = (length - STATED_MM) / 6.2  # an arm that tilts as it is drawn out
    return float(1.0 + 0.37 * tilt * tilt)
