"""Where each number stands in the state and parameter arrays of the compiled bench.

The arrays are what crosses into compiled code; everything else uses these names. Slots are added
at the end, so that recorded states keep their meaning.
"""

# State: what changes with time. Paired slots (inlet, outlet) are adjacent: OUTLET_x = INLET_x + 1.
TIME = 0  # s
PRESSURE = 1  # gauge Pa in the muscle
LENGTH = 2  # m
LENGTH_RATE = 3  # m/s, positive when lengthening
FORCE = 4  # N, tension of the muscle at TIME
SUPPLY = 5  # gauge Pa upstream of the inlet
REGULATOR_SET = 6  # gauge Pa
INLET_OPEN = 7  # 0 or 1, the valve itself
OUTLET_OPEN = 8
INLET_COMMAND = 9  # 0 or 1; inlet 1 = fill, outlet 1 = vent
OUTLET_COMMAND = 10
MASS_IN = 11  # kg passed by the inlet (or regulator) since the start
MASS_OUT = 12  # kg passed by the outlet and leaks since the start
TEMPERATURE = 13  # K, of the muscle's wall
SLIP = 14  # four elements of the braid friction, each -1 to 1
SLIP_ELEMENTS = 4
QUEUE_HEAD = 18  # (inlet, outlet) index of the oldest pending valve edge
QUEUE_COUNT = 20  # (inlet, outlet) number of pending valve edges
EDGES_MERGED = 22  # pending edges that cancelled each other because the queue was full
MEMORY = 23  # eight slots for effects with memory, the next four names
MEMORY_SLOTS = 8
CREEP = 23  # N, four followers of the lasting force, each with its own time constant
CREEP_ELEMENTS = 4
PRESSURE_READ = 27  # gauge Pa behind the transducer's lag; kept only while PRESSURE_LAG > 0
LINK_SLIP = 28  # slip of the friction that carries the load, -1 to 1
TRIAL = 29  # trials that the muscle has behind it
QUEUE = 32  # due times, s: QUEUE_LENGTH for the inlet, then as many for the outlet
QUEUE_LENGTH = 256
STATE_SIZE = QUEUE + 2 * QUEUE_LENGTH

# Parameters: what stays constant over a run, already with the effects that only change a constant.
SOURCE = 0  # 0 supply through the inlet valve, 1 regulator behind the inlet valve
LOAD = 1  # 0 length prescribed, 1 hung mass
ATMOSPHERE = 2  # Pa
GAS_TEMPERATURE = 3  # K
BRAID_LENGTH = 4  # m
TURNS = 5
INLET_CONDUCTANCE = 6  # m3/(s Pa); OUTLET next
OUTLET_CONDUCTANCE = 7
INLET_CRITICAL_RATIO = 8
OUTLET_CRITICAL_RATIO = 9
DEAD_VOLUME = 10  # m3
EXPONENT = 11
LENGTH_MIN = 12  # m
LENGTH_MAX = 13  # m
STOP_STIFFNESS = 14  # N/m
STOP_DAMPING = 15  # N s/m
LOAD_DAMPING = 16  # N s/m
MASS = 17  # kg
GRAVITY = 18  # m/s2
REGULATOR_LAG = 19  # s
DELAY_MODE = 20  # 0 inertial, 1 transport
DELAY = 21  # s: inlet on, inlet off, outlet on, outlet off
DELAY_SLOPE = 25  # s/Pa, same order
STEP_MAX = 29  # s
STEP_SAFETY = 30  # substep as a share of the fastest time constant
LEAK_CONDUCTANCE = 31  # m3/(s Pa)
LINER_LOST = 32  # Pa
LINER_WIDTH = 33  # Pa
FRICTION_FORCE = 34  # N at FRICTION_PRESSURE
FRICTION_TRAVEL_PRESSURE = 35  # Pa of rise after which every element slips
FRICTION_TRAVEL_LENGTH = 36  # m of shortening after which every element slips
MUSCLE_ADDITIONS = 37  # 1 when any of the next sixteen slots is in force
STRETCH = 38  # braid length gained per Pa
CAP_SHARE = 39  # contraction counted 1 + this many times
CAP_REST = 40  # m
BLADDER = 41  # N/m at 60 mm
BLADDER_REST = 42  # m
BLADDER_HARDENING = 43  # 1/m2
LIMIT_FORCE = 44  # N at 1 mm above LENGTH_MIN
LIMIT_SCALE = 45  # m
VISCOUS = 46  # N s/m at 10 mm/s
VISCOUS_EXPONENT = 47
VISCOUS_PRESSURE = 48  # share that goes with the pressure
WARMING = 49  # change of force per K
WARMING_FROM = 50  # K
WARMING_FLAT = 51  # share of the change that does not grow with the pressure
WEAR = 52  # change of force per trial
REMEMBERS = 53  # 1 when creep or the transducer's lag must be followed in time
CREEP_GAIN = 54
CREEP_TIME = 55  # s, CREEP_ELEMENTS of them
PRESSURE_LAG = 59  # s
LINK_FRICTION = 60  # N
LINK_TRAVEL = 61  # m of motion after which the link slips
SUPPLY_DROOP = 62  # Pa that the supply falls at choked flow
EXTRA_MASS = 63  # kg that hangs beside MASS without being written down
PARAMS_SIZE = 96  # the rest is kept at zero for what is still to come

# Inputs that a recording may hold, as numbered in the compiled batch runner.
CHANNEL_INLET = 0  # 0 or 1
CHANNEL_OUTLET = 1  # 0 or 1
CHANNEL_LENGTH_RATE = 2  # m/s
CHANNEL_REGULATOR = 3  # gauge Pa
CHANNEL_SUPPLY = 4  # gauge Pa
