"""Array layout of a scene: units (muscles or cylinders with valves) and coordinates.

The state and parameter rows of a unit are those of `plant.physics.layout`. This module defines the
other arrays.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from plant.arrays import Array

Ints = npt.NDArray[np.int64]

# Kinds of units.
BRAID = 0  # braid of `plant.physics.muscle`, with the effects of its parameter row
TABLE = 1  # table of a model of `plant.models`
CYLINDER = 2  # piston; pushes its ends apart

# Columns of `shape`, one row per unit.
PULLS_ONLY = 0  # 1: a tendon, which cannot push
AREA = 1  # m2 of a cylinder's piston
TABLE_ROW = 2  # index of the table of a TABLE unit
MEMORY_KIND = 3  # memory of a model: one of the four below
NO_MEMORY, PLAY, STOP, LATE = 0.0, 1.0, 2.0, 3.0
MEMORY_SIZE = 4  # maximum number of operators
MEMORY_WEIGHT = 4
MEMORY_WIDTH = MEMORY_WEIGHT + MEMORY_SIZE  # half-width Pa, travel m, or time constant s
MEMORY_STATE = MEMORY_WIDTH + MEMORY_SIZE
SHAPE_SIZE = MEMORY_STATE + MEMORY_SIZE

# Columns of `coords`, one row per coordinate (m or rad).
MASS = 0  # kg (or kg m2); not used with an arm
PULL = 1  # N (or N m) along +q: constant force, such as weight; with an arm a load torque
DAMPING = 2  # N s/m; the joint damping of an arm is in its table
SPRING = 3  # N/m
SPRING_REST = 4  # m
LOW = 5
HIGH = 6
STOP_STIFFNESS = 7
STOP_DAMPING = 8
COULOMB = 9  # N; not with an arm
COORDS_SIZE = 10

# Rows of `motion`, one column per coordinate.
PLACE = 0
RATE = 1
SLIDING = 2  # -1 or 1: direction of sliding; 0 stuck (or without friction)
PUSH = 3  # present net force without friction
MOTION_ROWS = 4

# Columns of `switches`, one row per proximity switch.
SWITCH_COORD = 0
SWITCH_AT = 1  # m
SWITCH_REACH = 2  # m: on within this distance of SWITCH_AT
SWITCH_GAP = 3  # m: hysteresis; goes off at this additional distance
SWITCH_ON = 4  # 0 or 1
SWITCHES_SIZE = 5

# Columns of `log`, one row per event; clock[LOGGED] is their number.
LOG_TIME = 0
LOG_KIND = 1
LOG_WHICH = 2
LOG_VALUE = 3
LOG_SIZE = 4
LOG_INLET, LOG_OUTLET, LOG_LOW, LOG_HIGH, LOG_SWITCH, LOG_STUCK, LOG_FREED = range(7)
LOG_WORDS = ("inlet", "outlet", "low stop", "high stop", "switch", "stuck", "freed")

# `clock`: values of the whole scene.
STEP_MAX = 0  # s
GAS_SAFETY = 1  # substep relative to the fastest time constant of the gas
LOAD_SAFETY = 2  # substep times the highest angular frequency of the mechanism
LOGGED = 3
SUBSTEPS = 4
TROUBLE = 5  # 1: the inertia matrix of the mechanism was singular
DAMPING_SAFETY = 6  # substep times the fastest damping rate of the mechanism
LONGEST = (
    7  # s, longest step for the mechanism; kept for some time with an arm, to save computation
)
LONGEST_UNTIL = 8  # s
LONGEST_TOUCH = 9  # stops in contact when LONGEST was computed
CLOCK_SIZE = 10

# Rows of `work`.
Y0, Y, DY, DY_SUM, IN, OUT, FLOW_IN, FLOW_OUT = range(8)
Q, QD, DQD, Q_SUM, QD_SUM, TORQUE, STIFF, TOUCH, OPEN = range(8, 17)
WORK_ROWS = 17

# OPEN: state of the gas of a unit in the next substep.
SEALED, FLOWING, REGULATED, LEVEL = 0.0, 1.0, 2.0, 3.0


class World(NamedTuple):
    """All arrays of a scene with M units and n coordinates.

    units (M, STATE_SIZE), params (M, PARAMS_SIZE): rows of `plant.physics.layout`.
    kinds (M): BRAID, TABLE or CYLINDER; shape (M, SHAPE_SIZE).
    reach (M, n + 1): dL/dq of the length of each unit, and in the last column its length at q = 0.
    coords (n, COORDS_SIZE), motion (MOTION_ROWS, n).
    arm (n, 16) and gravity (3) of `plant.links.kernel`; (0, 16) without an arm.
    tables (T, cells in pressure, cells in length, 16), volumes (T, cells in length, 4) and axes
    (T, 6): force and gas volume of models, see `plant.scene.model_table`.
    switches (S, SWITCHES_SIZE); log (rows, LOG_SIZE); clock (CLOCK_SIZE).
    work (WORK_ROWS, max(M, n)), links (n, 8) and matrix (n, n): scratch.
    """

    units: Array
    params: Array
    kinds: Ints
    shape: Array
    reach: Array
    coords: Array
    motion: Array
    arm: Array
    gravity: Array
    tables: Array
    volumes: Array
    axes: Array
    switches: Array
    log: Array
    clock: Array
    work: Array
    links: Array
    matrix: Array
