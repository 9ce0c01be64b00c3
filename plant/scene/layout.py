"""Where each number of a scene stands: muscles with valves, and the coordinates they move.

A scene's units (a muscle or cylinder, its chamber and its valve block) are rows of states and
parameters as `plant.physics.layout` numbers them. This module numbers what stands around them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

# What a unit is made of.
BRAID = 0  # the braid of `plant.physics.muscle`, with the effects of its parameter row
TABLE = 1  # a model of `plant.models`, from its table
CYLINDER = 2  # a piston: pushes its ends apart

# Columns of `shape`, a row a unit.
PULLS_ONLY = 0  # 1: a tendon, which goes slack instead of pushing
AREA = 1  # m2 of a cylinder's piston
TABLE_ROW = 2  # which table of a TABLE unit
MEMORY_KIND = 3  # of a model with memory: one of the four below
NO_MEMORY, PLAY, STOP, LATE = 0.0, 1.0, 2.0, 3.0
MEMORY_SIZE = 4  # operators at most
MEMORY_WEIGHT = 4
MEMORY_WIDTH = MEMORY_WEIGHT + MEMORY_SIZE  # half-width Pa, travel m, or time constant s
MEMORY_STATE = MEMORY_WIDTH + MEMORY_SIZE
SHAPE_SIZE = MEMORY_STATE + MEMORY_SIZE

# Columns of `coords`, a row a coordinate (m or rad).
MASS = 0  # kg (or kg m2); not used where an arm moves
PULL = 1  # N (or N m) along +q that is always there, such as weight; on an arm a load torque
DAMPING = 2  # N s/m; an arm's own joint damping is in its table
SPRING = 3  # N/m
SPRING_REST = 4  # m
LOW = 5
HIGH = 6
STOP_STIFFNESS = 7
STOP_DAMPING = 8
COULOMB = 9  # N; not on an arm
COORDS_SIZE = 10

# Rows of `motion`, a column a coordinate.
PLACE = 0
RATE = 1
SLIDING = 2  # -1 or 1: the way Coulomb friction lets it go; 0 stuck (or without friction)
PUSH = 3  # net force on it at the present time, friction left out
MOTION_ROWS = 4

# Columns of `switches`, a row a proximity switch.
SWITCH_COORD = 0
SWITCH_AT = 1  # m
SWITCH_REACH = 2  # m: on within so much of SWITCH_AT
SWITCH_GAP = 3  # m: hysteresis, goes off that much later
SWITCH_ON = 4  # 0 or 1
SWITCHES_SIZE = 5

# Columns of `log`, a row an event; CLOCK's LOGGED says how many there are.
LOG_TIME = 0
LOG_KIND = 1
LOG_WHICH = 2
LOG_VALUE = 3
LOG_SIZE = 4
LOG_INLET, LOG_OUTLET, LOG_LOW, LOG_HIGH, LOG_SWITCH, LOG_STUCK, LOG_FREED = range(7)
LOG_WORDS = ("inlet", "outlet", "low stop", "high stop", "switch", "stuck", "freed")

# `clock`: a few numbers of the whole scene.
STEP_MAX = 0  # s
GAS_SAFETY = 1  # substep as a share of the gas's fastest time constant
LOAD_SAFETY = 2  # substep times the mechanism's highest angular frequency
LOGGED = 3
SUBSTEPS = 4
TROUBLE = 5  # 1: the mechanism's inertia matrix was singular
DAMPING_SAFETY = 6  # substep times the mechanism's fastest rate of damping
LONGEST = 7  # s, step that follows the mechanism; for an arm kept a while, as it costs a step
LONGEST_UNTIL = 8  # s
LONGEST_TOUCH = 9  # what it was worked out for: which stops were touched
CLOCK_SIZE = 10

# Rows of `work`.
Y0, Y, DY, DY_SUM, IN, OUT, FLOW_IN, FLOW_OUT = range(8)
Q, QD, DQD, Q_SUM, QD_SUM, TORQUE, STIFF, TOUCH, OPEN = range(8, 17)
WORK_ROWS = 17

# OPEN: how the gas of a unit goes over the coming substep.
SEALED, FLOWING, REGULATED, LEVEL = 0.0, 1.0, 2.0, 3.0


class World(NamedTuple):
    """Every array of a scene, M units and n coordinates.

    units (M, STATE_SIZE), params (M, PARAMS_SIZE): rows of `plant.physics.layout`.
    kinds (M): BRAID, TABLE or CYLINDER; shape (M, SHAPE_SIZE).
    reach (M, n + 1): dL/dq of each unit's length, and last its length at q = 0.
    coords (n, COORDS_SIZE), motion (MOTION_ROWS, n).
    arm (n, 16) and gravity (3) of `plant.links.kernel`; (0, 16) where masses move by themselves.
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
