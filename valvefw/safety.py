"""Safety checks independent of the host: latched faults, on raw counts only.

``Safety`` detects faults; the controller reacts (vents). The causes are:

    host_silent       armed, and no heartbeat before its deadline
    over_pressure     N of the last M readings at or above the limit
    sensor_saturated  several consecutive invalid readings
    sensor_silent     two sample periods without a reading
    sensor_stuck, sensor_jump, sensor_no_rise, inlet_stuck, outlet_stuck: see sensorwatch
    inlet_bound       a scheme kept the inlet open longer than allowed
    vent_failed       vented, but the pressure did not fall in time
    vent_lost         vented, but the pressure rose again
    loop_stalled      no tick for longer than the board's drive time-out
"""

from valvefw.board import DRIVE_SILENCE_US

MAX_FAULTS = 8
SHUT_MIN_US = 5
SILENT_N = 2


class Safety:
    """Limits, copied when armed and on each change while disarmed; latched faults."""

    def __init__(self, values: dict[str, int]) -> None:
        self.armed = False
        self.faults: list[tuple[str, int]] = []
        self.black_box = b""
        self.heartbeat_seen = False
        self._heartbeat = self._hb_left_us = 0
        self._over = self._saturated = self._silent = 0
        self.inlet_run_us = self._shut_us = 0
        self.load(values)

    def load(self, values: dict[str, int]) -> None:
        """Copy the limits; never called while armed."""
        self._trip = values["trip"]
        self._trip_n = values["trip_n"]
        self._trip_mask = (1 << values["trip_m"]) - 1
        self._sat_high = values["sat_high"]
        self._sat_low = values["sat_low"]
        self._sat_n = values["sat_n"]
        self._hb_us = values["hb_ms"] * 1000
        self._inlet_max_us = values["inlet_max_ms"] * 1000
        self._inlet_rest_us = values["inlet_rest_ms"] * 1000
        self._clear_below = values["clear_below"]

    def arm(self, values: dict[str, int]) -> None:
        """Start the heartbeat check."""
        self.load(values)
        self.armed = True
        self.heartbeat_seen = False
        self._hb_left_us = self._hb_us

    def heartbeat(self, counter: int) -> bool:
        """Process a heartbeat; False, without a new deadline, if its counter did not increase."""
        if self.armed:
            if self.heartbeat_seen and not 0 < ((counter - self._heartbeat) & 0xFFFF) < 0x8000:
                return False
            self.heartbeat_seen = True
            self._heartbeat = counter
            self._hb_left_us = self._hb_us
        return True

    def check(self, counts: int, dt_us: int) -> str:
        """Check one sample; returns the cause of a fault, or an empty text."""
        cause = ""
        self._silent = 0
        over = self._over
        if counts >= self._trip or over:
            over = ((over << 1) | (1 if counts >= self._trip else 0)) & self._trip_mask
            self._over = over
            n = 0
            while over:
                n += over & 1
                over >>= 1
            if n >= self._trip_n:
                cause = "over_pressure"
        if counts >= self._sat_high or counts < self._sat_low:
            if self._saturated < self._sat_n:
                self._saturated += 1
            if self._saturated >= self._sat_n:
                cause = cause or "sensor_saturated"
        elif self._saturated:
            self._saturated = 0
        return cause or self.check_host(dt_us)

    def check_silent(self, dt_us: int) -> str:
        """Check a tick without a reading."""
        self._silent += 1
        if self._silent >= SILENT_N:
            self._silent = SILENT_N
            return "sensor_silent"
        return self.check_host(dt_us)

    def check_host(self, dt_us: int) -> str:
        """Count down to the heartbeat deadline."""
        if self.armed:
            left = self._hb_left_us - dt_us
            self._hb_left_us = left
            if left <= 0:
                return "host_silent"
            if dt_us > DRIVE_SILENCE_US:
                return "loop_stalled"
        return ""

    def bound_inlet(self, inlet_us: int, tick_us: int) -> int:
        """The part of ``inlet_us`` that may be driven; -1 at the limit: a fault.

        Openings add up until the inlet was commanded closed for ``inlet_rest_ms``, which is
        longer than the valve's closing time. Short gaps therefore do not reset the limit.
        """
        if inlet_us <= 0:
            if self.inlet_run_us:
                self._shut_us += tick_us
                if self._shut_us >= self._inlet_rest_us:
                    self.inlet_run_us = 0
            return 0
        run = self.inlet_run_us
        left = self._inlet_max_us - run
        if left < SHUT_MIN_US:
            return -1
        self._shut_us = 0
        if inlet_us > left:
            inlet_us = left
        # A pulse that ends within the tick: closed for the rest of the tick.
        if inlet_us < tick_us:
            self._shut_us = tick_us - inlet_us
            self.inlet_run_us = run + inlet_us
        else:
            self.inlet_run_us = run + tick_us
        return inlet_us

    def renewed_inlet(self) -> None:
        """A scheme with renewal holds the inlet open; a later scheme must first keep it closed."""
        self.inlet_run_us = self._inlet_max_us
        self._shut_us = 0

    def latch(self, cause: str, device_us: int) -> bool:
        """Record a fault; True if it is the first since the last clear."""
        self.armed = False
        first = not self.faults
        for known in self.faults:
            if known[0] == cause:
                return False
        if len(self.faults) < MAX_FAULTS:
            self.faults.append((cause, device_us))
        return first

    def clear(self, counts: int) -> str:
        """Clear the faults; returns the reason if that is not allowed, else an empty text."""
        if not self.faults:
            return ""
        if counts >= self._clear_below:
            return "pressure %d counts, clear_below %d: vent first" % (counts, self._clear_below)
        if self._over or self._saturated or self._silent:
            return "its cause is still present"
        self.faults = []
        self.black_box = b""
        return ""
