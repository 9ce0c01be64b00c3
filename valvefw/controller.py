"""The controller: a safety core each millisecond, and a loop around it.

``step`` reads, checks, drives and records (``core``). ``loop`` runs the scheme once after each
step, then sends a telemetry frame and answers a request. What a scheme requests takes effect
at the next step, so the time from a reading to its command is one millisecond however long the
loop takes. A loop that is late misses readings; the core then continues the last request.

States: disarmed or fault (always vented), or armed with a scheme (``idle`` is vented too).
"""

from array import array

from valvefw import VERSION, config
from valvefw.board import Board
from valvefw.capture import Capture
from valvefw.commands import Commands
from valvefw.core import (
    ARMED,
    COUNTS,
    FAULT_N,
    FAULTS,
    HAS_RUN,
    INLET_LEFT,
    INLET_US,
    LAST,
    LED,
    LED_BIT,
    LED_LEFT,
    LED_STATE,
    LOOP,
    LOOP_LEFT,
    LOOP_WORST,
    MISSED,
    NOW,
    NOW_HIGH,
    NOW_LOW,
    PROX,
    READING,
    RENEWS,
    REPLY_HIGH,
    REPLY_LOW,
    REQUEST_INLET,
    REQUEST_VENT,
    REQUESTED,
    RUNNING,
    TICK,
    TICKS,
    TIME_MASK,
    VENT_LEFT,
    VENT_US,
    VENTED_HIGH,
    VENTED_LOW,
    VENTED_MS,
    VENTED_NEWS,
    WANT_INLET,
    WANT_VENT,
    Core,
    begin_run,
    decide,
    note,
)
from valvefw.inputs.channels import Channels
from valvefw.native import copy
from valvefw.receiver import Receiver, split
from valvefw.replies import put_number
from valvefw.safety import Safety
from valvefw.schemes.bothduty import BothDuty
from valvefw.schemes.burst import Burst
from valvefw.schemes.inletduty import InletDuty
from valvefw.schemes.openloop import OpenLoop
from valvefw.schemes.pwm import Pwm
from valvefw.schemes.ram import Ram
from valvefw.schemes.regulated import Regulated
from valvefw.schemes.scheme import Scheme
from valvefw.schemes.sliding import Sliding
from valvefw.schemes.twoposition import TwoPosition
from valvefw.schemes.valves import VENT_HOLD_US, Valves
from valvefw.telemetry import Telemetry
from valvefw.wire import EVENT, ONE_BLOCK, REPLY, REQUEST, encode_frame, seal

IDLE = 0
QUICK = 1  # a heartbeat or set-point was answered
SLOW = 2  # another request was
MORE = 3  # bytes were received that are no request yet, or none

_HB = b" ok hb="
_SP = b" ok sp="
_T = b" t="


class Controller:
    """Firmware of the valve controller on any ``Board``.

    Args:
        board: the hardware, real or simulated; it is vented first.
        core: the safety core, where the board has made it for its interrupt.
    """

    def __init__(self, board: Board, core: Core | None = None) -> None:
        board.drive(0, VENT_HOLD_US)
        self.board = board
        self.version = VERSION
        self.values = config.defaults()
        self.checksum = config.Checksum()
        self.checksum.of(self.values)
        self.core = Core() if core is None else core
        self._state = s = self.core.state
        self.safety = Safety(self.core, self.values)
        self.valves = Valves()
        boot_id = board.random16() & 0xFFFF
        self.telemetry = Telemetry(self.core, boot_id or 1)
        self.channels = Channels(board, self.core, self.telemetry.boot_id)
        self.openloop = OpenLoop()
        self.regulated = Regulated()
        self.schemes: dict[str, Scheme] = {"open": self.openloop, "reg": self.regulated}
        for kind in (Pwm, TwoPosition, InletDuty, BothDuty, Sliding, Ram, Burst):
            self.schemes[kind.name] = kind()
        self.scheme: Scheme | None = None  # None: vented
        self.setpoint_x16 = 0
        self.session = 0  # of the host that armed; 0: none was named
        self.foreign = 0  # refused commands of others since arming
        self.receiver = Receiver(board)
        self.capture = Capture(board, self.core)
        self._commands = Commands(self)
        self._words = array("i", [0] * 12)
        self._reply = bytearray(ONE_BLOCK)
        self._regulator = 0
        self._reported = 0
        self._ticks = 0
        self._led = 0
        s[LAST] = self._now = board.ticks_us() & TIME_MASK
        s[HAS_RUN] = 1  # a vent whose success is watched
        board.regulator(0)
        board.led(0)
        boot = (self.telemetry.boot_id, board.reset_cause, VERSION)
        self.event("boot id=%d cause=%s fw=%s" % boot)

    def tick(self) -> None:
        """One millisecond of a board without an interrupt: a step, then the loop until idle."""
        self.step()
        while self.loop():
            pass

    def step(self) -> None:
        """One step of the safety core; on the chip the interrupt does the same in machine code."""
        board = self.board
        core = self.core
        s = core.state
        now_us = board.ticks_us()
        s[NOW] = now_us & TIME_MASK
        s[NOW_LOW] = now_us & 0xFFFF
        s[NOW_HIGH] = now_us >> 16
        s[READING] = board.adc()
        s[PROX] = board.prox()
        decide(s)
        board.drive(s[INLET_US], s[VENT_US])
        if s[LED] != self._led:
            self._led = s[LED]
            board.led(s[LED])
        note(s, core.ring, core.times)

    def loop(self) -> int:
        """One pass of the loop; returns what it did: ``IDLE``, ``QUICK``, ``SLOW`` or ``MORE``."""
        s = self._state
        s[LOOP_LEFT] = LOOP
        if s[FAULT_N] != self._reported or s[VENTED_NEWS]:
            self._report()
        ticks = s[TICKS]
        if ticks != self._ticks:
            now = s[NOW]
            while ticks != s[TICKS]:  # a step in between
                ticks = s[TICKS]
                now = s[NOW]
            late = (ticks - self._ticks) & TIME_MASK
            if late > 1:
                s[MISSED] += late - 1
                if late > s[LOOP_WORST]:
                    s[LOOP_WORST] = late
            self._ticks = ticks
            self.board.wdt_feed()
            # A request that the core has not taken over yet must not be replaced: the pass before
            # was late, and this reading is missed.
            if not s[REQUESTED]:
                dt_us = (now - self._now) & TIME_MASK
                self._now = now
                if self.scheme is not None:
                    self._run(self.scheme, dt_us)
            if self.telemetry.full():
                self.send_held()
            channels = self.channels
            if channels.on and channels.poll():
                self.board.tx(channels.buffer, channels.frame())
        size = self.receiver.next()
        if size <= 0:
            return MORE if size else IDLE
        if self.receiver.frame[1] != REQUEST or self._answered(size):
            return QUICK
        request = bytes(self.receiver.frame[2 : size + 1])
        self._send(REPLY, self._commands.answer(request))
        return SLOW

    def _run(self, scheme: Scheme, dt_us: int) -> None:
        """One step of the scheme; what it changes is requested, the core continues the rest."""
        s = self._state
        valves = self.valves
        valves.prox = s[PROX]
        left_us = s[INLET_LEFT] - TICK  # at the next step, where a request takes effect
        inlet_us = valves.inlet_us = left_us if left_us > 0 else 0
        left_us = s[VENT_LEFT] - TICK
        vent_us = valves.vent_us = left_us if left_us > 0 else 0
        scheme.step(s[COUNTS], self.setpoint_x16, dt_us, valves)
        requested = 0
        if valves.inlet_us != inlet_us:
            s[WANT_INLET] = valves.inlet_us
            requested = REQUEST_INLET
        if valves.vent_us != vent_us:
            s[WANT_VENT] = valves.vent_us
            requested |= REQUEST_VENT
        s[REQUESTED] = requested

    def _answered(self, size: int) -> bool:
        """Answer a heartbeat or set-point without allocating; False if it is another request.

        What is refused also counts as another request: ``commands`` states the reason.
        """
        frame = self.receiver.frame
        words = self._words
        n = split(frame, size, words)
        if n < 3 or n > 4 or words[1] > 5 or words[4] != 2:
            return False
        if n == 4 and words[11] > -2:
            return False  # no session
        request_id = words[2]
        value = words[8]
        if not 0 <= request_id <= 65535 or value < 0:
            return False
        verb = frame[words[3]] << 8 | frame[words[3] + 1]
        scheme = self.scheme
        s = self._state
        if self.session and s[ARMED] and (n == 3 or words[11] != -2 - self.session):
            return False
        out = self._reply
        out[1] = REPLY
        at = put_number(out, 2, request_id, 0)
        if verb == 0x6862:  # hb
            if value > 65535 or not self.safety.heartbeat(value):
                return False
            if scheme is not None:
                scheme.renew()
            copy(out, at, _HB, 0, 7)
            at += 7
            at = put_number(out, at, value, 0)
            copy(out, at, _T, 0, 3)
            at += 3
            self.board.stamp(s)
            at = put_number(out, at, s[REPLY_LOW], s[REPLY_HIGH])
        elif verb == 0x7370:  # sp
            if value > self.values["sp_max"] * 16 or s[FAULTS] or not s[ARMED]:
                return False
            if scheme is None or scheme is self.openloop:
                return False
            self.set_setpoint(value)
            scheme.renew()
            copy(out, at, _SP, 0, 7)
            at += 7
            at = put_number(out, at, value, 0)
        else:
            return False
        self.board.tx(out, seal(out, at - 1))
        return True

    def event(self, text: str) -> None:
        """Send an unsolicited message."""
        self._send(EVENT, text)

    def _send(self, kind: int, text: str) -> None:
        frame = encode_frame(bytes((kind,)) + text.encode())
        self.board.tx(frame, len(frame))

    def _report(self) -> None:
        """Report new faults and a confirmed vent; the core has already vented."""
        s = self._state
        if s[FAULT_N] and not self._reported:
            self.telemetry.keep()
        while self._reported < s[FAULT_N]:
            self.event("fault cause=%s t=%d counts=%d" % self.safety.fault(self._reported))
            self._reported += 1
        self._reported = s[FAULT_N]
        if s[VENTED_NEWS]:
            s[VENTED_NEWS] = 0
            at_us = s[VENTED_LOW] | s[VENTED_HIGH] << 16
            self.event("vented t=%d ms=%d" % (at_us, s[VENTED_MS]))
        if s[FAULT_N]:
            self.vent()

    def clear(self) -> str:
        """Clear the faults; returns the reason if that is not allowed, else an empty text."""
        reason = self.safety.clear(self._state[COUNTS])
        if not reason:
            self._reported = 0  # a fault that latches from now on is a new one
        return reason

    def disarm(self) -> None:
        """Vent and stop the heartbeat check."""
        self.safety.disarm()
        self.vent()

    def vent(self) -> None:
        """Close the inlet, open the outlet, set-point 0; the pressure must then fall in time."""
        self._state[RUNNING] = 0
        self.set_setpoint(0)
        if self.scheme is not None:
            self.scheme = None
            self.valves.shut()

    def choose(self, name: str) -> None:
        """Run scheme ``name`` from the next step; the caller has checked the conditions."""
        self.set_setpoint(0)
        self.valves.shut()
        scheme = self.schemes[name]
        scheme.start(self.values)
        self.scheme = scheme
        self._state[RENEWS] = scheme.renews
        begin_run(self._state)

    def set_setpoint(self, setpoint_x16: int) -> None:
        """Change the set-point; first send the samples taken under the old one."""
        if setpoint_x16 != self.setpoint_x16:
            self.send_held()
            self.setpoint_x16 = setpoint_x16
        regulator = 0
        if self.scheme is self.regulated:
            values = self.values
            regulator = (setpoint_x16 * values["out_scale"] >> 12) + values["out_zero_x16"] - 65536
            regulator = min(max(regulator, 0), 65535)
        if regulator != self._regulator:
            self._regulator = regulator
            self.board.regulator(regulator)

    def send_held(self) -> None:
        """Send the samples not yet sent."""
        telemetry = self.telemetry
        n = telemetry.frame(self.setpoint_x16)
        if n:
            self.board.tx(telemetry.buffer, n)

    def led_steady(self, on: int) -> int:
        """Switch the sync LED on or off at the next step; returns that step's device time."""
        s = self._state
        while True:
            at = s[NOW]
            s[LED_BIT] = 0
            s[LED] = on
            if at == s[NOW]:
                return self._next_step_us()

    def led_pattern(self, seed: int, bit_ms: int) -> int:
        """Start a pseudo-random pattern on the sync LED (see ``wire.lfsr_next``).

        Returns the device time of its first bit.
        """
        s = self._state
        while True:  # an interrupt in the middle would start it earlier
            at = s[NOW]
            s[LED_BIT] = 0
            s[LED_STATE] = seed
            s[LED_LEFT] = -1
            s[LED_BIT] = bit_ms * 1000
            if at == s[NOW]:
                return self._next_step_us()

    def _next_step_us(self) -> int:
        s = self._state
        return ((s[NOW_LOW] | s[NOW_HIGH] << 16) + TICK) & 0xFFFFFFFF
