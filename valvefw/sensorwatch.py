"""Plausibility checks of the pressure reading, on raw counts only.

The converter has no live zero: a broken wire may read 0, which is also a valid pressure. In
addition to the rails (``safety``), the reading must therefore be physically possible. Causes:

    sensor_stuck    constant reading for ``stuck_ms``: a working sensor has noise. 0 does not
                    count, where a small negative offset hides the noise
    sensor_jump     four samples further away than ``slew`` allows
    sensor_no_rise  the inlet open for ``rise_ms`` in total, reading still below ``rise_counts``
    inlet_stuck     both valves commanded closed, but the pressure rises by ``leak_counts``
    outlet_stuck    the same, but it falls

Active while a scheme runs. When vented, only the pressure's fall is checked.
"""

from valvefw.config import defaults

JUMP_N = 4
LEAK_N = 3
LEAK_SPAN_US = 50000


class SensorWatch:
    """Checks one sample at a time against the valve commands of the past tick."""

    def __init__(self) -> None:
        self._reference = 0
        self.start(defaults(), 0)

    def start(self, values: dict[str, int], counts: int) -> None:
        """Copy parameters when a scheme starts at this reading."""
        self._stuck_us = values["stuck_ms"] * 1000
        self._slew = values["slew"]
        self._jump = values["jump"]
        self._rise_us = values["rise_ms"] * 1000
        self._rise_counts = values["rise_counts"]
        self._leak = values["leak_counts"]
        self._rest_us = values["inlet_rest_ms"] * 1000
        self._on_in_us = values["valve_on_in_us"]
        self._off_in_us = values["valve_off_in_us"]
        self._last = -1
        self._track = counts
        self._same_us = self._away = self._leaks = 0
        self._filling_us = self._filled_us = self._idle_us = self._shut_us = 0

    def check(self, counts: int, dt_us: int, inlet_us: int, vent_us: int, renews: bool) -> str:
        """Check one sample; returns a cause, or an empty text.

        ``inlet_us`` and ``vent_us`` were driven at the start of the tick. ``renews`` is True
        with a regulator: then an open inlet may leave the pressure constant.
        """
        if counts != self._last:
            self._last = counts
            self._same_us = 0
        elif counts and self._stuck_us:
            self._same_us += dt_us
            if self._same_us >= self._stuck_us:
                return "sensor_stuck"
        track = self._track
        slew = self._slew
        if counts > track + slew:
            track += slew
        elif counts < track - slew:
            track -= slew
        else:
            track = counts
        self._track = track
        away = not track - self._jump <= counts <= track + self._jump
        if not away:
            self._away = 0
        else:
            self._away += 1
            if self._away >= JUMP_N:
                return "sensor_jump"
        if inlet_us:
            self._idle_us = 0
            if self._filling_us <= self._on_in_us:
                self._filling_us += inlet_us if inlet_us < dt_us else dt_us
            if counts >= self._rise_counts or renews:
                self._filled_us = 0
            elif self._rise_us and not vent_us:
                if self._filling_us > self._on_in_us:
                    self._filled_us += dt_us
                    if self._filled_us >= self._rise_us:
                        return "sensor_no_rise"
            self._shut_us = 0
            return ""
        if self._filling_us:
            self._idle_us += dt_us
            if self._idle_us > self._off_in_us:  # the closing delay is over
                self._filling_us = 0
        if vent_us or not self._leak:
            self._shut_us = 0
            return ""
        if away:  # no valid reading to compare
            return ""
        shut_us = self._shut_us + dt_us
        rest_us = self._rest_us
        self._shut_us = shut_us
        change = counts - self._reference
        if shut_us > rest_us and not -self._leak < change < self._leak:
            self._leaks += 1
            if self._leaks < LEAK_N:
                return ""
            return "inlet_stuck" if change > 0 else "outlet_stuck"
        self._leaks = 0
        if shut_us <= rest_us or shut_us > rest_us + LEAK_SPAN_US:
            self._shut_us = shut_us if shut_us <= rest_us else rest_us
            self._reference = counts
        return ""
