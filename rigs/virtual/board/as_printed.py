"""The thesis's listings (Appendix D-3) as printed, defects and all: for the simulation only.

Each is a twin of a scheme in ``valvefw`` and runs in its place on a simulated board, to tell
what of the reported oscillation is the orifice and what the code. Nothing here goes onto a real
board: :func:`install_as_printed` wants a :class:`SimBoard`.

What the listings do, against what they were meant to:

- ``y DIV $20`` makes 0, 2, 4, 6 of the two low bits of the converter, so that the reading jumps
  from 6 back to 4 at every fourth count (:func:`adc_as_printed`).
- ``for loopy:= 1 to pwm_on do p1.0:=true`` shuts the inlet in its first turn: a burst lasts as
  long as the ``writeln`` before it takes on the serial line, whatever the error (version 8, 9).
  The outlet's loop has no ``writeln`` before it: it opens for microseconds, which is not at all.
- Version 9 never leaves its inner ``repeat ... until false``: one pass, then no reading ever.
- ``difference * 100`` and ``100000 * height`` overflow 16 bits (:func:`int16`).
- Version 10 differentiates desired minus actual, whose rate is negative during a fill, so that its
  boundary brakes the falling pressure and never the rising one. Its 16-bit timer laps at 65.5 ms.

The listings do not tell baud rate, crystal or time per instruction. Chosen here: 4800 baud, one
count of the timer a microsecond, 20 us for one turn of an empty loop.
"""

from __future__ import annotations

from rigs.virtual.board.board import SimBoard
from valvefw.schemes.scheme import HOLD_US, Scheme
from valvefw.schemes.valves import Valves

BAUD = 4800
LOOP_US = 20


def adc_as_printed(reading: int) -> int:
    """The 10-bit reading that the listings compute from a true one."""
    return (reading >> 2) * 4 + (reading & 3) * 2


def int16(value: int) -> int:
    """What is left of a number in a 16-bit integer."""
    return (value + 0x8000) % 0x10000 - 0x8000


def div(a: int, b: int) -> int:
    """Pascal's DIV, which cuts towards zero."""
    return int(a / b)


def print_us(*words: object, baud: int = BAUD) -> int:
    """How long ``writeln`` of these words takes: ten bits a character, and a line end of two."""
    characters = sum(len(str(word)) for word in words) + 2
    return characters * 10_000_000 // baud


class AsPrinted(Scheme):
    """A listing's main loop: passes that take as long as they print.

    Args:
        baud: of the serial line the listing prints to.
    """

    def __init__(self, baud: int = BAUD) -> None:
        self.baud = baud
        self.passes = 0
        self._busy_us = 0
        self._inlet_held = False
        self._outlet_held = False

    def start(self, values: dict[str, int]) -> None:
        """Begin at the top."""
        self.passes = 0
        self._busy_us = 0
        self._inlet_held = False
        self._outlet_held = False

    def step(self, counts: int, setpoint_x16: int, dt_us: int, valves: Valves) -> None:
        """Begin another pass when the last is over; outputs stay as it left them."""
        if self._inlet_held:
            valves.inlet_us = HOLD_US
        if self._outlet_held:
            valves.vent_us = HOLD_US
        self._busy_us -= dt_us
        if self._busy_us > 0:
            return
        actual = adc_as_printed(counts >> 2)
        desired = adc_as_printed(setpoint_x16 >> 6)
        difference = int16(desired - actual)
        self._inlet_held = self._outlet_held = False
        valves.inlet_us = valves.vent_us = 0
        self.passes += 1
        reading_us = sum(
            print_us(*words, baud=self.baud)
            for words in ((actual,), (" ", desired), (" ", difference))
        )
        self._busy_us = reading_us + self.operate(difference, valves)
        if self._inlet_held:
            valves.inlet_us = HOLD_US
        if self._outlet_held:
            valves.vent_us = HOLD_US

    def operate(self, difference: int, valves: Valves) -> int:
        """Everything after the reading of one pass; returns how long it takes in us."""
        raise NotImplementedError


class TwoPositionAsPrinted(AsPrinted):
    """Version 4: right but for the reading, and as slow as its prints."""

    name = "two_as_printed"

    def operate(self, difference: int, valves: Valves) -> int:
        """Open one valve until the next pass."""
        self._inlet_held = difference > 5
        self._outlet_held = difference < -5
        return 0


class InletDutyAsPrinted(AsPrinted):
    """Version 8."""

    name = "duty_in_as_printed"

    def pulse_inlet(self, difference: int, valves: Valves) -> int:
        """``start_pwm``: a burst as long as ``writeln('on', pwm_on)``."""
        if difference <= 2:
            return 0
        on = div(int16(difference * 100), 700) if difference < 700 else 101
        off = 101 - on if difference < 700 else 1
        burst_us = print_us("on", on, baud=self.baud)
        valves.inlet_us = burst_us
        up_us = print_us("up", on, baud=self.baud) if difference < 700 else 0
        return burst_us + (max(0, on) + max(0, off)) * LOOP_US + up_us

    def operate(self, difference: int, valves: Valves) -> int:
        """Pulse the inlet; open the outlet until the next pass."""
        spent_us = self.pulse_inlet(difference, valves)
        self._outlet_held = difference < -2
        return spent_us


class BothDutyAsPrinted(InletDutyAsPrinted):
    """Version 9: one pass, then its inner loop has no end."""

    name = "duty_as_printed"

    def step(self, counts: int, setpoint_x16: int, dt_us: int, valves: Valves) -> None:
        """The first pass, and nothing after it."""
        if self.passes == 0:
            super().step(counts, setpoint_x16, dt_us, valves)

    def operate(self, difference: int, valves: Valves) -> int:
        """Pulse the inlet; the outlet's pulse is over before the solenoid has noticed it."""
        return self.pulse_inlet(difference, valves)


class SlidingAsPrinted(AsPrinted):
    """Version 10."""

    name = "slide_as_printed"

    def __init__(self, baud: int = BAUD) -> None:
        super().__init__(baud)
        self._old = 0
        self._pass_us = 1

    def start(self, values: dict[str, int]) -> None:
        """The error before the first is zero, as in the listing."""
        super().start(values)
        self._old = 0
        self._pass_us = 1

    def operate(self, difference: int, valves: Valves) -> int:
        """Compare error and rate with the boundaries."""
        timer = max(1, self._pass_us & 0xFFFF)
        height = int16(difference - self._old)
        derivative = int16(div(int16(100000 * height), timer))
        prints = (
            ("actual strain", self._old),
            ("difference of error term", difference),
            ("height", height),
            ("tim", timer),
            (" ", difference),
            (" ", derivative),
            ("deriv", derivative),
        )
        spent_us = sum(print_us(*words, baud=self.baud) for words in prints)
        self._old = difference
        self._inlet_held = difference > 5 and derivative < 50
        self._outlet_held = not self._inlet_held and (derivative >= 50 or difference < -5)
        self._pass_us = spent_us
        return spent_us


TWINS: tuple[type[AsPrinted], ...] = (
    TwoPositionAsPrinted,
    InletDutyAsPrinted,
    BothDutyAsPrinted,
    SlidingAsPrinted,
)


def install_as_printed(board: SimBoard) -> None:
    """Let a simulated board choose the twins by their names."""
    for twin in TWINS:
        scheme = twin()
        board.controller.schemes[scheme.name] = scheme
