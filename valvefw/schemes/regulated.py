"""Regulator behind the inlet valve: inlet open, outlet closed, the regulator sets the pressure."""

from valvefw.board import DRIVE_SILENCE_US
from valvefw.schemes.scheme import Scheme
from valvefw.schemes.valves import Valves


class Regulated(Scheme):
    """The inlet stays open only while heartbeats or set-points renew it."""

    name = "reg"
    renews = True

    def start(self, values: dict[str, int]) -> None:
        self._bound_us = values["inlet_max_ms"] * 1000
        self._left_us = self._bound_us

    def renew(self) -> None:
        self._left_us = self._bound_us

    def step(self, counts: int, setpoint_x16: int, dt_us: int, valves: Valves) -> None:
        self._left_us -= dt_us
        valves.vent_us = 0
        if self._left_us > 0:
            valves.inlet_us = min(self._left_us, DRIVE_SILENCE_US)
        else:
            self._left_us = 0
            valves.inlet_us = 0
