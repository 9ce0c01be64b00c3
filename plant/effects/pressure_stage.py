"""Slots of the diagnosis's pressure stage (`gap.model.pressure`) that effects write to; SI.

Those that the plant has as well are numbered as in `plant.physics.layout`.
"""

from __future__ import annotations

from plant.physics.layout import (
    PARAMS_SIZE,
)

LEAK = PARAMS_SIZE  # m3/(s Pa), choked and subsonic flow
LEAK_LAMINAR = PARAMS_SIZE + 1  # m3/(s Pa)
DROOP = PARAMS_SIZE + 2  # Pa
DROOP_TIME = PARAMS_SIZE + 3  # s
DROOP_BACK = PARAMS_SIZE + 4  # s, on the way back; DROOP_TIME where 0
HEAT_RATE = PARAMS_SIZE + 5  # 1/s
ZERO = PARAMS_SIZE + 6  # Pa, of the gauge
GAIN = PARAMS_SIZE + 7
LAG = PARAMS_SIZE + 8  # s, of the gauge
LAG_BEFORE = PARAMS_SIZE + 9  # s, of a tube before it
CLOCK = PARAMS_SIZE + 10  # s that the pressure is stamped early
FOLLOW = PARAMS_SIZE + 11  # s in which the prediction is drawn to the reading; 0 runs free
ELASTIC = PARAMS_SIZE + 12  # m3/Pa
LINE = PARAMS_SIZE + 13  # m3 behind a throttle
LINE_TIME = PARAMS_SIZE + 14  # s
INLET_DROP = PARAMS_SIZE + 15  # change of the areas at 500 kPa over the valve
OUTLET_DROP = PARAMS_SIZE + 16
SUPPLY_SHIFT = PARAMS_SIZE + 17  # Pa
HEAT_BY_MASS = PARAMS_SIZE + 18  # 1 where the heat that the gas holds counts
LAG_WITH_PRESSURE = PARAMS_SIZE + 19  # power of the absolute pressure that LAG falls with
STIFFENING = PARAMS_SIZE + 20  # m3 that a hose takes at most whose wall stiffens
STIFFENING_PA = PARAMS_SIZE + 21  # pressure in which it does
DROOP_POWER = PARAMS_SIZE + 22  # of the flow that DROOP grows with; 0 as with the ellipse alone
LINE_ORIFICE = PARAMS_SIZE + 23  # 1 where the throttle before LINE is an orifice
LAG_DAMPING = PARAMS_SIZE + 24  # of a gauge that swings; 0 where it has no inertia
YIELDING = PARAMS_SIZE + 25  # m3/Pa of a hose whose wall comes after the pressure
YIELDING_TIME = PARAMS_SIZE + 26  # s in which it does
FADING = PARAMS_SIZE + 27  # s in which the exponent falls after a valve opened; 0 where it stays
STIFFENING_LATE = PARAMS_SIZE + 28  # as STIFFENING, of what the same wall takes up later
STIFFENING_LATE_PA = PARAMS_SIZE + 29
LINE_EMPTIES = PARAMS_SIZE + 30  # times LINE_TIME, where a check valve lets LINE fill past it; or 0
SIZE = PARAMS_SIZE + 31
LEAK_OF_TRIAL = SIZE  # m3/(s Pa) beside LEAK, one for each trial, where trials differ in it
