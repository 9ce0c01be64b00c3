"""Proportional pulse-width modulation of inlet and outlet.

One cycle: a pulse proportional to the error, a wait until the valve has closed and the pressure
has settled, the mean of a window of samples. Readings without flow remove the valve's delays
from the loop, so the gain can be near dead-beat. A cycle takes ``pwm_period_ms``, or longer if
the pulse needs it.

A valve cannot open for less than its smallest pulse, which may be larger than the error. Such a
pulse overshoots. The other valve, with another smallest pulse, corrects the rest; the dead zone
ends it. Inside the zone, readings are filtered over several windows, and after ``CALM`` of them
the
zone is wider by half: a correction would disturb a settled pressure more than the noise does.
"""

from valvefw.schemes.scheme import Scheme
from valvefw.schemes.valves import VENT_HOLD_US, Valves
from valvefw.wire import TICK_US

CALM = 4  # windows inside the dead zone before it widens


class Pwm(Scheme):
    """Parameters ``pwm_*``; a set-point of 0 keeps the outlet open."""

    name = "pwm"

    def start(self, values: dict[str, int]) -> None:
        self._calm = 0
        self._gain_in = values["pwm_gain_in"]
        self._gain_out = values["pwm_gain_out"]
        self._atm = values["pwm_atm"]
        self._dead = values["pwm_dead_x16"]
        self._min_in = values["pwm_min_in_us"]
        self._min_out = values["pwm_min_out_us"]
        self._lag_in = values["pwm_lag_in_us"]
        self._lag_out = values["pwm_lag_out_us"]
        self._max_in = values["pwm_max_in_us"]
        self._max_out = values["pwm_max_out_us"]
        self._settle = values["pwm_settle_us"] + TICK_US  # a request takes effect a tick later
        self._window = values["pwm_window"]
        self._rest = values["pwm_period_ms"] * 1000 - self._window * 1000
        # The outlet was open until now: wait until it has closed.
        self._wait = self._settle
        self._sum = self._n = 0
        self._level = -1

    def step(self, counts: int, setpoint_x16: int, dt_us: int, valves: Valves) -> None:
        """One sample; starts a pulse when a window is full and the error requires one."""
        if setpoint_x16 == 0:
            valves.inlet_us = 0
            valves.vent_us = VENT_HOLD_US
            self._wait = self._settle
            self._sum = self._n = 0
            self._level = -1
            return
        if valves.vent_us > self._max_out:  # left over from a set-point of 0
            valves.vent_us = 0
        if self._wait > 0:
            self._wait -= dt_us
            if self._wait > 0:
                return
        total = self._sum + counts
        n = self._n + 1
        if n < self._window:
            self._sum = total
            self._n = n
            return
        self._sum = self._n = 0
        reading = (total << 4) // n
        level = self._level
        dead = self._dead
        if level < 0:
            level = reading
            self._calm = CALM
        else:
            level += (reading - level) >> 2
            error = setpoint_x16 - reading
            if error > 3 * dead or error < -3 * dead:
                level = reading
            elif self._calm:
                self._calm -= 1
            else:
                dead += dead >> 1
        self._level = level
        error = setpoint_x16 - level
        if error > dead:
            pulse = self._lag_in + (error * self._gain_in >> 4)
            if pulse < self._min_in:
                pulse = self._min_in
            elif pulse > self._max_in:
                pulse = self._max_in
            pulse -= pulse % 5
            valves.inlet_us = pulse
        elif error < -dead:
            gain = self._gain_out
            if self._atm:
                gain = gain * self._atm // (self._atm + (level >> 4))
            pulse = self._lag_out + (-error * gain >> 4)
            if pulse < self._min_out:
                pulse = self._min_out
            elif pulse > self._max_out:
                pulse = self._max_out
            pulse -= pulse % 5
            valves.vent_us = pulse
        else:
            return
        self._level = -1
        wait = pulse + self._settle
        self._wait = wait if wait > self._rest else self._rest
