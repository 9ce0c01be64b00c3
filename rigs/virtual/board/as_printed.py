"""The thesis's listings (Appendix D-3) as printed, defects and all: for the simulation only.

Each is a twin of a scheme in ``valvefw`` and runs in its place on a simulated board, to tell
what of the reported oscillation is the orifice and what the code. Nothing here goes onto a real
board: :func:`install_as_printed` wants a :class:`SimBoard`.

Every listing is a generator that has its statements in their printed order and yields how long
each one takes. A valve therefore acts on a reading only after the ``writeln`` statements between
the reading and the port, and keeps its state until the statement that changes it.

What the listings do, against what they were meant to:

- ``y DIV $20`` makes 0, 2, 4, 6 of the two low bits of the converter, so that the reading jumps
  from 6 back to 4 at every fourth count (:func:`adc_as_printed`).
- Every pass prints its readings before it acts: 31 to 38 ms at 4800 baud. A valve that is open
  stays open for that time and for the time of the pass.
- ``for loopy:= 1 to pwm_on do p1.0:=true`` shuts the inlet in its first turn: a burst lasts as
  long as the ``writeln`` before it takes on the serial line, whatever the error (version 8, 9).
- The outlet's loop of version 9 has its ``writeln`` after it. The outlet opens for microseconds,
  which is not at all, unless ``pwm_on`` is zero or negative (an error of -3 to -6, or an
  overflow): then the loop has no turn, and the outlet is open while ``writeln`` prints.
- Version 9 never leaves its inner ``repeat ... until false``: one pass, then no reading ever.
- ``difference * 100`` and ``100000 * height`` overflow 16 bits (:func:`int16`).
- Version 7 writes 0 to the two pins of its proximity switches in every pass. A port pin of the
  80C552 with a 0 in its latch pulls its line low, so that it reads 0 whatever the switch says. If
  the switch overcomes the pin, the difference is 0 for as long as it is on: the ram cannot leave.
- Version 10 differentiates desired minus actual, whose rate is negative during a fill, so that its
  boundary brakes the falling pressure and never the rising one. Its 16-bit timer laps at 65.5 ms.

The listings do not tell baud rate, crystal or time per instruction. Chosen here: 4800 baud, one
count of the timer a microsecond, 20 us for one turn of an empty loop, nothing for the rest.
"""

from __future__ import annotations

from collections.abc import Iterator

from rigs.virtual.board.board import SimBoard
from valvefw.schemes.scheme import HOLD_US, Scheme
from valvefw.schemes.valves import Valves

BAUD = 4800
LOOP_US = 20
FOREVER_US = 1 << 40
"""For a loop that never ends and changes nothing."""

Listing = Iterator[int]
"""Statements of a program; yields the time of each in us, and changes ports between."""


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
    """A listing that runs as the simulated board's clock allows.

    A statement is carried out at the first tick after its time has come, at most 1 ms late; what
    it was late is not added to the next.

    Args:
        baud: of the serial line the listing prints to.
    """

    def __init__(self, baud: int = BAUD) -> None:
        self.baud = baud
        super().__init__()

    def start(self, values: dict[str, int]) -> None:
        """Begin at the top."""
        self.passes = 0
        self.actual = self.desired = self.difference = 0
        self.clock_us = 0
        self._until_us = 0
        self._reading = self._setpoint = 0
        self._valves = Valves()
        self._inlet_held = self._outlet_held = False
        self._program = self.program()

    def step(self, counts: int, setpoint_x16: int, dt_us: int, valves: Valves) -> None:
        """Carry out every statement whose time has come; a valve that is held stays open."""
        self._reading, self._setpoint, self._valves = counts >> 2, setpoint_x16 >> 6, valves
        while self._until_us <= 0:
            spent_us = next(self._program)
            self._until_us += spent_us
            self.clock_us += spent_us
        self._until_us -= dt_us
        if self._inlet_held:
            valves.inlet_us = HOLD_US
        if self._outlet_held:
            valves.vent_us = HOLD_US

    # What the listings have in common.

    def program(self) -> Listing:
        """``reset(serial)``, two empty lines, then the main loop."""
        yield from self.writeln()
        yield from self.writeln()
        while True:
            self.passes += 1
            yield from self.begin_pass()
            yield from self.read()
            yield from self.operate()

    def begin_pass(self) -> Listing:
        """What a pass does before it reads."""
        return iter(())

    def operate(self) -> Listing:
        """Everything after the reading of one pass."""
        raise NotImplementedError

    def read(self) -> Listing:
        """Both conversions and the difference, each printed before the next."""
        self.actual = adc_as_printed(self._reading)
        yield from self.writeln(self.printed_actual())
        self.desired = adc_as_printed(self._setpoint)
        yield from self.writeln(" ", self.desired)
        self.difference = int16(self.desired - self.actual)
        yield from self.writeln(" ", self.difference)

    def printed_actual(self) -> int:
        """What the listing prints of its reading."""
        return self.actual

    def writeln(self, *words: object) -> Listing:
        """Wait while words are printed."""
        yield print_us(*words, baud=self.baud)

    def loops(self, turns: int) -> Listing:
        """Wait in an empty loop; no turn if the count is not positive."""
        yield max(0, turns) * LOOP_US

    def inlet(self, opened: bool) -> None:
        """Write the inlet's bit."""
        self._inlet_held = opened
        self._valves.inlet_us = HOLD_US if opened else 0

    def outlet(self, opened: bool) -> None:
        """Write the outlet's bit."""
        self._outlet_held = opened
        self._valves.vent_us = HOLD_US if opened else 0

    def pulse_inlet(self, us: int) -> None:
        """Open for a known time: exact, where :meth:`inlet` keeps to the ticks."""
        self._inlet_held, self._valves.inlet_us = False, us

    def pulse_outlet(self, us: int) -> None:
        """The same for the outlet."""
        self._outlet_held, self._valves.vent_us = False, us

    def two_position(self) -> None:
        """``operate_valve`` of versions 4 and 7: both off, then one on until the next time."""
        self.inlet(self.difference > 5)
        self.outlet(self.difference < -5)


class TwoPositionAsPrinted(AsPrinted):
    """Version 4: right but for the reading, and a print late."""

    name = "two_as_printed"

    def operate(self) -> Listing:
        """Open one valve until the next pass comes here."""
        self.two_position()
        return iter(())


class RamAsPrinted(AsPrinted):
    """Version 7, with pins that read 0 because the program has just written 0 to them."""

    name = "ram_as_printed"
    overcomes = False
    """Whether a proximity switch is strong enough to pull its pin up all the same."""

    def printed_actual(self) -> int:
        """``700-actual_strain``, as a word."""
        return (700 - self.actual) & 0xFFFF

    def operate(self) -> Listing:
        """``check_posn``, then as version 4."""
        if self.overcomes and self._valves.prox:
            yield from self.writeln("sensor on")
            self.difference = 0
        self.two_position()


class RamOvercomeAsPrinted(RamAsPrinted):
    """Version 7 with switches that overcome the pins: it stops, and cannot leave."""

    name = "ram_overcome_as_printed"
    overcomes = True


class InletDutyAsPrinted(AsPrinted):
    """Version 8."""

    name = "duty_in_as_printed"

    def operate(self) -> Listing:
        """``operate_valve``, ``start_pwm`` and ``outlet_valve``, which keeps the outlet open."""
        self.inlet(False)
        self.outlet(False)
        yield from self.start_pwm()
        self.outlet(self.difference < -2)

    def start_pwm(self) -> Listing:
        """``valve_on`` opens the inlet while it prints; ``off`` waits with it shut."""
        if self.difference <= 2:
            return
        full = self.difference >= 700
        on = 101 if full else div(int16(self.difference * 100), 700)
        self.pulse_inlet(print_us("on", on, baud=self.baud))
        yield from self.writeln("on", on)
        yield from self.loops(on)
        yield from self.loops(1 if full else 101 - on)
        if not full:
            yield from self.writeln("up", on)


class BothDutyAsPrinted(InletDutyAsPrinted):
    """Version 9: one pass, then its inner loop has no end."""

    name = "duty_as_printed"

    def operate(self) -> Listing:
        """The inlet once, the outlet ever after; the difference never changes."""
        self.inlet(False)
        self.outlet(False)
        yield from self.start_pwm()
        while self.difference < -2:
            yield from self.end_pwm()
        yield FOREVER_US

    def end_pwm(self) -> Listing:
        """The loop shuts the outlet in its first turn, if it has one, before the print."""
        full = self.difference <= -700
        on = 101 if full else -div(int16(self.difference * 100), 700)
        printing_us = print_us("outlet", baud=self.baud)
        self.pulse_outlet(LOOP_US if on > 0 else printing_us)
        yield from self.loops(on)
        yield from self.writeln("outlet")
        yield from self.loops(1 if full else 101 - on)


class SlidingAsPrinted(AsPrinted):
    """Version 10."""

    name = "slide_as_printed"

    def start(self, values: dict[str, int]) -> None:
        """The error before the first is zero, and the timer runs, as in the listing."""
        super().start(values)
        self._old = 0
        self._timer_us = 0

    def operate(self) -> Listing:
        """``derivative_term``: the timer stands still while two of its seven lines print."""
        yield from self.writeln("actual strain", self._old)
        yield from self.writeln("difference of error term", self.difference)
        timer = max(1, (self.clock_us - self._timer_us) & 0xFFFF)
        height = int16(self.difference - self._old)
        yield from self.writeln("height", height)
        yield from self.writeln("tim", timer)
        derivative = int16(div(int16(100000 * height), timer))
        self._old = self.difference
        self._timer_us = self.clock_us
        yield from self.writeln(" ", self._old)
        yield from self.writeln(" ", derivative)
        yield from self.writeln("deriv", derivative)
        self.switch(derivative)

    def switch(self, derivative: int) -> None:
        """``operate_valve``: compare error and rate with the boundaries."""
        fill = self.difference > 5 and derivative < 50
        self.inlet(fill)
        self.outlet(not fill and (derivative >= 50 or self.difference < -5))


TWINS: tuple[type[AsPrinted], ...] = (
    TwoPositionAsPrinted,
    InletDutyAsPrinted,
    BothDutyAsPrinted,
    SlidingAsPrinted,
    RamAsPrinted,
    RamOvercomeAsPrinted,
)


def install_as_printed(board: SimBoard) -> None:
    """Let a simulated board choose the twins by their names."""
    for twin in TWINS:
        scheme = twin()
        board.controller.schemes[scheme.name] = scheme
