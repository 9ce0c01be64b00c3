"""Limits, arming and latched faults: the loop's side of the safety core (``core``).

The core detects faults on raw counts, independent of the host, and vents. Its causes are:

    host_silent       armed, and no heartbeat before its deadline
    over_pressure     N of the last M readings at or above the limit
    sensor_saturated  several consecutive invalid readings
    sensor_silent     two sample periods without a reading
    sensor_stuck      constant reading for ``stuck_ms``: a working sensor has noise. 0 does not
                      count, where a small negative offset hides the noise
    sensor_jump       four samples further away than ``slew`` allows
    sensor_no_rise    the inlet open for ``rise_ms`` in total, reading below ``rise_counts``
    inlet_stuck       both valves commanded closed, but the pressure rises by ``leak_counts``
    outlet_stuck      the same, but it falls
    inlet_bound       a scheme kept the inlet open longer than allowed
    vent_failed       vented, but the pressure did not fall in time
    vent_lost         vented, but the pressure rose again
    loop_stalled      no step for longer than the board's drive time-out, or no pass of the loop
                      for 50 ms

The checks of plausibility are active while a scheme runs.
"""

from valvefw.core import (
    ARMED,
    BEATEN,
    BOX_N,
    CAUSES,
    FAULT_N,
    FAULT_WORDS,
    FAULTS,
    FIRST_FAULT,
    HEARTBEAT_LEFT,
    INLET_MAX,
    INLET_REST,
    JUMP,
    LEAK,
    LOOP,
    LOOP_LEFT,
    LOST_AT,
    OFF_IN,
    ON_IN,
    OVER,
    RISE,
    RISE_COUNTS,
    SAT_HIGH,
    SAT_LOW,
    SAT_N,
    SATURATED,
    SILENT,
    SLEW,
    STUCK,
    TICK,
    TRIP,
    TRIP_MASK,
    TRIP_N,
    VENT_BELOW,
    VENT_LIMIT,
    Core,
)

# Parameter, its place in the core, factor (milliseconds to microseconds).
_LIMITS = (
    ("trip", TRIP, 1),
    ("trip_n", TRIP_N, 1),
    ("sat_high", SAT_HIGH, 1),
    ("sat_low", SAT_LOW, 1),
    ("sat_n", SAT_N, 1),
    ("inlet_max_ms", INLET_MAX, 1000),
    ("inlet_rest_ms", INLET_REST, 1000),
    ("vent_below", VENT_BELOW, 1),
    ("vent_ms", VENT_LIMIT, 1000),
    ("stuck_ms", STUCK, 1000),
    ("slew", SLEW, 1),
    ("jump", JUMP, 1),
    ("rise_ms", RISE, 1000),
    ("rise_counts", RISE_COUNTS, 1),
    ("leak_counts", LEAK, 1),
    ("valve_on_in_us", ON_IN, 1),
    ("valve_off_in_us", OFF_IN, 1),
)


class Safety:
    """Limits, copied when armed and on each change while disarmed; latched faults."""

    def __init__(self, core: Core, values: dict[str, int]) -> None:
        self._state = core.state
        self._heartbeat = 0
        self.load(values)

    def load(self, values: dict[str, int]) -> None:
        """Copy the limits; never called while armed."""
        s = self._state
        for key, place, factor in _LIMITS:
            s[place] = values[key] * factor
        s[LOST_AT] = 2 * values["vent_below"]
        s[TRIP_MASK] = (1 << values["trip_m"]) - 1
        # The next step already counts down a whole millisecond.
        self._hb_us = values["hb_ms"] * 1000 + TICK
        self._clear_below = values["clear_below"]

    @property
    def armed(self) -> bool:
        """Armed, and no fault since."""
        return bool(self._state[ARMED])

    @property
    def heartbeat_seen(self) -> bool:
        """A heartbeat was received since arming."""
        return bool(self._state[BEATEN])

    @property
    def faults(self) -> list[tuple[str, int]]:
        """Latched faults with their device times, in order."""
        return [self.fault(k)[:2] for k in range(self._state[FAULT_N])]

    def fault(self, k: int) -> tuple[str, int, int]:
        """Cause, device time and reading of the fault with number ``k``."""
        s = self._state
        at = FIRST_FAULT + k * FAULT_WORDS
        return CAUSES[s[at] - 1], s[at + 1] | s[at + 2] << 16, s[at + 3]

    def arm(self, values: dict[str, int]) -> None:
        """Start the heartbeat check."""
        self.load(values)
        s = self._state
        s[BEATEN] = 0
        s[HEARTBEAT_LEFT] = self._hb_us
        s[LOOP_LEFT] = LOOP
        s[ARMED] = 1

    def disarm(self) -> None:
        """Stop the heartbeat check; the core vents."""
        self._state[ARMED] = 0

    def heartbeat(self, counter: int) -> bool:
        """Process a heartbeat; False, without a new deadline, if its counter did not increase."""
        s = self._state
        if s[ARMED]:
            if s[BEATEN] and not 0 < ((counter - self._heartbeat) & 0xFFFF) < 0x8000:
                return False
            s[BEATEN] = 1
            self._heartbeat = counter
            s[HEARTBEAT_LEFT] = self._hb_us
        return True

    def clear(self, counts: int) -> str:
        """Clear the faults; returns the reason if that is not allowed, else an empty text."""
        s = self._state
        if not s[FAULTS]:
            return ""
        if counts >= self._clear_below:
            return "pressure %d counts, clear_below %d: vent first" % (counts, self._clear_below)
        if s[OVER] or s[SATURATED] or s[SILENT]:
            return "its cause is still present"
        self.forget()
        return ""

    def forget(self) -> None:
        """Clear the faults whatever the pressure is."""
        s = self._state
        s[FAULT_N] = 0
        s[BOX_N] = 0
        s[FAULTS] = 0
