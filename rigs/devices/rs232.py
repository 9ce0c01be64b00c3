"""The thesis's open-loop driver as a board: two valves on the control lines of an RS-232 port.

Appendix D-3 and D-4: inlet on DTR, outlet on RTS, CTS and DSR as inputs, the null-modem cable's
wiring. The firmware's controller runs in this process, on the host's clock.

This is history, not a bench to leave alone. The lines are timed by a program, to a millisecond or
two; a process that hangs holds what it last switched, where a board of its own would let go; and
there is no pressure reading unless one is handed in, so that over-pressure is the relief valve's.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Protocol

from daq.clock import NS_PER_S, Clock
from valvefw.board import DRIVE_SILENCE_US
from valvefw.controller import Controller
from valvefw.deskboard import BufferedBoard
from valvefw.wire import TICK_US


class Lines(Protocol):
    """What is needed of ``daq.link.ports.ModemLines``."""

    name: str

    def set(self, dtr: bool, rts: bool) -> None:
        """Switch DTR and RTS."""
        ...

    def get(self) -> tuple[bool, bool]:
        """CTS and DSR."""
        ...

    def close(self) -> None:
        """Both off."""
        ...


class Rs232Board(BufferedBoard):
    """A board whose hardware is a serial port; ``run`` lets it live.

    Args:
        lines: the port's control lines.
        clock: real or virtual time.
        read_counts: pressure in 12-bit counts from another instrument; without one the reading is
            0 for ever, and only the scheme ``open`` makes sense (with ``rise_ms`` 0).
    """

    name = "rs232"
    outlet_normally_open = False

    def __init__(
        self, lines: Lines, clock: Clock, read_counts: Callable[[], int] | None = None
    ) -> None:
        self._lines = lines
        self._clock = clock
        self._read_counts = read_counts
        self.serial = lines.name
        self._origin_ns = clock.now_ns()
        self._inlet_until_us = 0
        self._vent_until_us = 0
        self._driven_us = 0
        self._state = (False, False)
        super().__init__()
        self.controller = Controller(self)

    # What the firmware calls.

    def _now_us(self) -> int:
        return (self._clock.now_ns() - self._origin_ns) // 1000

    def ticks_us(self) -> int:
        """The host's clock since the board was made."""
        return self._now_us() & 0xFFFFFFFF

    def adc(self) -> int:
        """What was handed in."""
        return 0 if self._read_counts is None else self._read_counts()

    def drive(self, inlet_us: int, vent_us: int) -> None:
        """Deadlines, and the lines at once."""
        now_us = self._now_us()
        self._driven_us = now_us
        self._inlet_until_us = now_us + inlet_us
        self._vent_until_us = now_us + vent_us
        self._switch(now_us)

    def prox(self) -> int:
        """CTS is A, DSR is B."""
        cts, dsr = self._lines.get()
        return int(cts) | int(dsr) << 1

    def random16(self) -> int:
        """Boot id."""
        return int.from_bytes(os.urandom(2), "little")

    # What the program around it calls.

    def run(self, seconds: float, period_s: float = TICK_US * 1e-6 / 4) -> None:
        """Tick each millisecond for so long, and end pulses when they are due in between."""
        end_ns = self._clock.now_ns() + round(seconds * NS_PER_S)
        tick_ns = TICK_US * 1000
        due_ns = self._clock.now_ns()
        while self._clock.now_ns() < end_ns:
            if self._clock.now_ns() >= due_ns:
                self.controller.tick()
                due_ns += tick_ns
            else:
                self._switch(self._now_us())
            self._clock.sleep(period_s)

    def close(self) -> None:
        """Both lines off: on this valve the air stays in, so vent and wait before."""
        self._lines.close()

    def _switch(self, now_us: int) -> None:
        alive = now_us - self._driven_us < DRIVE_SILENCE_US
        state = (alive and now_us < self._inlet_until_us, alive and now_us < self._vent_until_us)
        if state != self._state:
            self._state = state
            self._lines.set(*state)
