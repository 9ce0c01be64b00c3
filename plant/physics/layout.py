"""Where each number stands in the state and parameter arrays of the compiled bench.

The arrays are what crosses into compiled code; everything else uses these names. Slots are added
at the end, so that recorded states keep their meaning.
"""

from __future__ import annotations

from plant.constants import PlantConstants

# State: what changes with time. Paired slots (inlet, outlet) are adjacent: OUTLET_x = INLET_x + 1.
TIME = 0  # s
PRESSURE = 1  # gauge Pa in the muscle
LENGTH = 2  # m
LENGTH_RATE = 3  # m/s, positive when lengthening
FORCE = 4  # N, tension of the muscle at TIME
SUPPLY = 5  # gauge Pa upstream of the inlet
REGULATOR_SET = 6  # gauge Pa
INLET_OPEN = 7  # 0 to 1, the valve itself, as a share of its full conductance
OUTLET_OPEN = 8
INLET_COMMAND = 9  # 0 to 1; inlet 1 = fill, outlet 1 = vent
OUTLET_COMMAND = 10
MASS_IN = 11  # kg passed by the inlet (or regulator) since the start
MASS_OUT = 12  # kg passed by the outlet and leaks since the start
TEMPERATURE = 13  # K, of the muscle's wall
SLIP = 14  # four elements of the braid friction, each -1 to 1
SLIP_ELEMENTS = 4
QUEUE_HEAD = 18  # (inlet, outlet) index of the oldest pending valve edge
QUEUE_COUNT = 20  # (inlet, outlet) number of pending valve edges
EDGES_MERGED = 22  # pending edges that cancelled each other because the queue was full
MEMORY = 23  # eight slots, numbered in the file of the effect with that memory; free: 30
MEMORY_SLOTS = 8
PRESSURE_READ = 27  # gauge Pa behind the transducer's lag; kept only while PRESSURE_LAG > 0
TRIAL = 29  # trials that the muscle has behind it
QUEUE = 32  # due times, s: QUEUE_LENGTH for the inlet, then as many for the outlet
QUEUE_LENGTH = 256
QUEUED = QUEUE + 2 * QUEUE_LENGTH  # commands that act at those times, 0 to 1, in the same order
SPOOL = QUEUED + 2 * QUEUE_LENGTH  # (inlet, outlet) opening that the valve goes to, 0 to 1
STATE_SIZE = SPOOL + 2

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
EFFECTS = 31  # from here on numbered in the files of the effects but for the next three
FORCE_EFFECTS = 37  # 1 when an effect changes the force of the muscle
REMEMBERS = 53  # 1 when an effect must be followed in time
PRESSURE_LAG = 59  # s, of the transducer
DEAD_BAND = 64  # (inlet, outlet) share of the command up to which the valve is shut
CLOSING = 66  # Pa; (inlet, outlet) difference of pressures below which the valve falls shut
SPOOL_LAG = 68  # s, of the opening; 0 without one
LAG_WITH_PRESSURE = 70  # power of the absolute pressure that the transducer's lag falls with
SUBSONIC_INDEX = 72  # what is added to 0.5, the subsonic index of the ellipse (ISO 6358-1)
RATIO = 73  # (inlet, outlet) change of the conductance with the ratio of the pressures
FREE_SLOT = 75  # from here on for effects of installed packages; 69 and 71 are of ours
PARAMS_SIZE = 96  # the rest is kept at zero for what is still to come

# Inputs that a recording may hold, as numbered in the compiled batch runner.
CHANNEL_INLET = 0  # 0 to 1
CHANNEL_OUTLET = 1  # 0 to 1
CHANNEL_LENGTH_RATE = 2  # m/s
CHANNEL_REGULATOR = 3  # gauge Pa
CHANNEL_SUPPLY = 4  # gauge Pa


def nominal_slots(c: PlantConstants) -> dict[int, float]:
    """What the constants alone say of gas, valves, braid and stops."""
    return {
        ATMOSPHERE: c.atmosphere_pa,
        GAS_TEMPERATURE: c.gas_temperature_k,
        BRAID_LENGTH: c.braid_length_m,
        TURNS: c.turns,
        INLET_CONDUCTANCE: c.inlet_conductance_m3_s_pa,
        OUTLET_CONDUCTANCE: c.outlet_conductance_m3_s_pa,
        INLET_CRITICAL_RATIO: c.critical_ratio,
        OUTLET_CRITICAL_RATIO: c.critical_ratio,
        DEAD_VOLUME: c.dead_volume_m3,
        EXPONENT: c.polytropic_exponent,
        LENGTH_MIN: c.length_min_m,
        LENGTH_MAX: c.length_max_m,
        STOP_STIFFNESS: c.stop_stiffness_n_m,
        STOP_DAMPING: c.stop_damping_n_s_m,
        LOAD_DAMPING: c.load_damping_n_s_m,
        # What a proportional valve is told it does in the end, however short.
        DELAY_MODE: float(c.delay_mode == "transport" or c.valve == "proportional"),
        DELAY: c.inlet_on_s,
        DELAY + 1: c.inlet_off_s,
        DELAY + 2: c.outlet_on_s,
        DELAY + 3: c.outlet_off_s,
        DELAY_SLOPE: c.inlet_on_s_per_pa,
        DELAY_SLOPE + 1: c.inlet_off_s_per_pa,
        DELAY_SLOPE + 2: c.outlet_on_s_per_pa,
        DELAY_SLOPE + 3: c.outlet_off_s_per_pa,
        DEAD_BAND: max(c.inlet_dead_band, 0.0),
        DEAD_BAND + 1: max(c.outlet_dead_band, 0.0),
        CLOSING: max(c.inlet_closing_pa, 0.0),
        CLOSING + 1: max(c.outlet_closing_pa, 0.0),
        SPOOL_LAG: max(c.valve_lag_s, 0.0),
    }
