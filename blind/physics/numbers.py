"""Where each constant, effect and state sits in the arrays that the compiled kernels read.

Kernels take plain float arrays; these names are their index. Nothing here has a value.
"""

from __future__ import annotations

from typing import Final

# Constants of a bench, in the units of the edges (kPa absolute for pressures, mm, ms).
SUPPLY: Final = 0
ATMOSPHERE: Final = 1
GAS_K: Final = 2
BRAID: Final = 3
TURNS: Final = 4
C_IN: Final = 5
C_OUT: Final = 6
RATIO: Final = 7
DEAD_ML: Final = 8
EXPONENT: Final = 9
L_MIN: Final = 10
L_MAX: Final = 11
STOP_K: Final = 12
STOP_C: Final = 13
LOAD_C: Final = 14
IN_ON: Final = 15  # eight delays: on, its slope, off, its slope; inlet then outlet
IN_OFF: Final = 17
OUT_ON: Final = 19
OUT_OFF: Final = 21
REGULATOR_S: Final = 23
MUSCLE_C: Final = 24
TRIAL: Final = 25  # count of trials the muscle has seen, for wear
MASS: Final = 26  # kg; 0 = length prescribed
CONSTANTS: Final = 27

# Rows of the effect matrix: form (-1 = off), headline value, three shape numbers.
EFFECT_IDS: Final = (
    "liner_threshold", "bladder_elasticity", "contraction_limit", "end_cap", "fibre_stretch",
    "braid_friction", "viscosity", "creep", "temperature_stiffening", "dead_volume", "polytropic",
    "leak", "flow_area", "critical_ratio", "supply_droop", "valve_delay", "valve_delay_pressure",
    "transport_delay", "link_friction", "payload", "pressure_zero", "pressure_gain", "pressure_lag",
    "force_zero", "force_gain", "length_label", "camera_scale", "camera_distortion", "camera_delay",
    "wear",
)  # fmt: skip
(
    LINER, BLADDER, LIMIT, CAP, FIBRE, BRAID_FRICTION, VISCOSITY, CREEP, WARMTH, VOLUME, POLYTROPIC,
    LEAK, AREA, CRITICAL, DROOP, DELAY, DELAY_SLOPE, TRANSPORT, SLIDE, PAYLOAD, P_ZERO, P_GAIN,
    P_LAG, F_ZERO, F_GAIN, LABEL, SCALE, DISTORTION, FRAME_DELAY, WEAR,
) = range(30)  # fmt: skip
# What no entry of the catalogue describes.
OUTSIDE_IDS: Final = (
    "pressure_ripple", "local_buckle", "slide_stick", "supply_surge", "mains_pickup",
    "cell_gradient", "mount_backlash", "weeping_valve", "pixel_locking", "coil_heating",
)  # fmt: skip
(
    RIPPLE, BUCKLE, STICK, SURGE, MAINS, GRADIENT, BACKLASH, WEEP, PIXELS, COIL,
) = range(30, 40)  # fmt: skip
ROWS: Final = 40
OFF: Final = -1.0

# The state of one trial.
Y_P: Final = 0  # kPa absolute
Y_L: Final = 1  # mm
Y_V: Final = 2  # mm/s
Y_TAP: Final = 3  # two states of the pressure tap, kPa gauge
Y_CREEP: Final = 5  # six memories, N
Y_ISO: Final = 11  # pressure the same mass would have at room temperature, kPa absolute
Y_SIDE: Final = 12  # pressure in a side volume, kPa absolute
Y_FALL: Final = 13  # fall of the supply, kPa
Y_SLIP: Final = 14  # four slip elements of the braid, -1..1
Y_SLIDE: Final = 18  # presliding of the load's slide, -1..1
STATES: Final = 19
MEMORIES: Final = 6
