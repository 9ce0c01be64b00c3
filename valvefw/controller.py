"""The controller: one ``tick`` per millisecond runs safety checks, requests, scheme and telemetry.

States: disarmed or fault (always vented), or armed with a scheme (``idle`` is vented too). Only
``tick`` drives the valves, except for a fault.
"""

from valvefw import VERSION, config
from valvefw.board import Board
from valvefw.capture import Capture
from valvefw.commands import Commands
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
from valvefw.sensorwatch import SensorWatch
from valvefw.telemetry import Telemetry
from valvefw.wire import EVENT, REPLY, REQUEST, TICK_US, Decoder, encode_frame, lfsr_next

VENTED_READINGS = 8  # consecutive readings below the threshold that confirm a vent


class Controller:
    """Firmware of the valve controller on any ``Board``.

    Args:
        board: the hardware, real or simulated; it is vented first.
    """

    def __init__(self, board: Board) -> None:
        board.drive(0, VENT_HOLD_US)
        self.board = board
        self.version = VERSION
        self.values = config.defaults()
        self.checksum = config.Checksum()
        self.checksum.of(self.values)
        self.safety = Safety(self.values)
        self.valves = Valves()
        boot_id = board.random16() & 0xFFFF
        self.telemetry = Telemetry(boot_id or 1)
        self.openloop = OpenLoop()
        self.regulated = Regulated()
        self.schemes: dict[str, Scheme] = {"open": self.openloop, "reg": self.regulated}
        for kind in (Pwm, TwoPosition, InletDuty, BothDuty, Sliding, Ram, Burst):
            self.schemes[kind.name] = kind()
        self.scheme: Scheme | None = None  # None: vented
        self.setpoint_x16 = 0
        self.counts = 0
        self.decoder = Decoder()
        self.capture = Capture(board)
        self._commands = Commands(self)
        self._black_box_due = False
        self._regulator = 0
        self._vented_run = self._lost_run = self._vent_left_us = self._vent_lost_at = 0
        self._led = self._led_state = self._led_bit_us = self._led_left_us = 0
        self._watch = SensorWatch()
        self._driven_inlet_us = self._driven_vent_us = 0
        self._last_us = board.ticks_us()
        self._confirm_vent()
        board.regulator(0)
        board.led(0)
        boot = (self.telemetry.boot_id, board.reset_cause, VERSION)
        self.event("boot id=%d cause=%s fw=%s" % boot)

    def tick(self) -> None:
        """One control step: read, check, handle requests, drive, send telemetry."""
        board = self.board
        now_us = board.ticks_us()
        dt_us = (now_us - self._last_us) & 0xFFFFFFFF
        self._last_us = now_us
        counts = board.adc()
        safety = self.safety
        if counts < 0:  # no reading: continue with the last one
            counts = self.counts
            cause = safety.check_silent(dt_us)
        else:
            self.counts = counts
            cause = safety.check(counts, dt_us)
        scheme = self.scheme
        if scheme is not None and not cause:
            cause = self._watch.check(
                counts, dt_us, self._driven_inlet_us, self._driven_vent_us, scheme.renews
            )
        if cause:
            self.trip(cause)
        data = board.rx()
        if data:
            self.decoder.push(data)
            self._handle_requests()
        scheme = self.scheme
        prox = board.prox()
        if scheme is not None:
            valves = self.valves
            valves.prox = prox
            inlet_us = valves.inlet_us
            if inlet_us:
                valves.inlet_us = inlet_us - dt_us if inlet_us > dt_us else 0
            vent_us = valves.vent_us
            if vent_us:
                valves.vent_us = vent_us - dt_us if vent_us > dt_us else 0
            scheme.step(counts, self.setpoint_x16, dt_us, valves)
            inlet_us = valves.inlet_us
            vent_us = valves.vent_us
            if scheme.renews:
                safety.renewed_inlet()
            else:
                inlet_us = safety.bound_inlet(inlet_us, TICK_US)
                if inlet_us < 0:
                    self.trip("inlet_bound")
                    inlet_us = 0
                    vent_us = VENT_HOLD_US
        else:
            inlet_us = 0
            vent_us = VENT_HOLD_US
            if safety.inlet_run_us:
                safety.bound_inlet(0, TICK_US)
            if self._vent_left_us:
                self._watch_vent(counts, dt_us)
            elif counts >= self._vent_lost_at:
                self._watch_vented()
            elif self._lost_run:
                self._lost_run = 0
        self._driven_inlet_us = inlet_us
        self._driven_vent_us = vent_us
        board.drive(inlet_us, vent_us)
        if self.capture.waiting:
            self.capture.on_drive(inlet_us, vent_us)
        if self._led_bit_us:
            self._blink(dt_us)
        flags = (
            (1 if inlet_us else 0)
            | (2 if vent_us else 0)
            | (4 if safety.armed else 0)
            | (8 if safety.faults else 0)
            | (16 if self._led else 0)
            | (32 if safety.heartbeat_seen else 0)
            | (prox << 6)
        )
        telemetry = self.telemetry
        if telemetry.add(
            now_us,
            dt_us,
            counts,
            flags,
            200 if inlet_us >= 1000 else inlet_us // 5,
            200 if vent_us >= 1000 else vent_us // 5,
        ):
            board.tx(telemetry.frame(self.setpoint_x16))
        if self._black_box_due:
            self._black_box_due = False
            safety.black_box = telemetry.black_box()
        board.wdt_feed()

    def _handle_requests(self) -> None:
        while True:
            payload = self.decoder.next()
            if payload is None:
                return
            if payload[0] == REQUEST:
                reply = self._commands.answer(payload[1:])
                self.board.tx(encode_frame(bytes((REPLY,)) + reply.encode()))

    def event(self, text: str) -> None:
        """Send an unsolicited message."""
        self.board.tx(encode_frame(bytes((EVENT,)) + text.encode()))

    def trip(self, cause: str) -> None:
        """Vent, latch a fault and report it; on the chip the report takes longest."""
        self.board.drive(0, VENT_HOLD_US)
        known = len(self.safety.faults)
        if self.safety.latch(cause, self._last_us):
            self._black_box_due = True
        if len(self.safety.faults) > known:
            self.event("fault cause=%s t=%d counts=%d" % (cause, self._last_us, self.counts))
        self.vent()

    def disarm(self) -> None:
        """Vent and stop the heartbeat check."""
        self.safety.armed = False
        self.vent()

    def vent(self) -> None:
        """Close the inlet, open the outlet, set-point 0; the pressure must then fall in time."""
        self.set_setpoint(0)
        if self.scheme is not None:
            self.scheme = None
            self.valves.shut()
            self._confirm_vent()

    def choose(self, name: str) -> None:
        """Run scheme ``name`` from the next tick; the caller has checked the conditions."""
        self.set_setpoint(0)
        self.valves.shut()
        scheme = self.schemes[name]
        scheme.start(self.values)
        self._watch.start(self.values, self.counts)
        self.scheme = scheme
        self._vent_left_us = 0

    def set_setpoint(self, setpoint_x16: int) -> None:
        """Change the set-point; first send the samples taken under the old one."""
        if setpoint_x16 != self.setpoint_x16:
            self.send_held()
            self.setpoint_x16 = setpoint_x16
        regulator = setpoint_x16 if self.scheme is self.regulated else 0
        if regulator != self._regulator:
            self._regulator = regulator
            self.board.regulator(regulator)

    def send_held(self) -> None:
        """Send the collected samples as a short frame."""
        frame = self.telemetry.frame(self.setpoint_x16)
        if frame:
            self.board.tx(frame)

    def _confirm_vent(self) -> None:
        self._vent_left_us = self.values["vent_ms"] * 1000
        self._vent_since_us = self._last_us
        self._vented_run = self._lost_run = 0
        self._vent_lost_at = 2 * self.values["vent_below"]

    def _watch_vent(self, counts: int, dt_us: int) -> None:
        if counts < self.values["vent_below"]:
            self._vented_run += 1
            if self._vented_run >= VENTED_READINGS:
                self._vent_left_us = 0
                took_ms = ((self._last_us - self._vent_since_us) & 0xFFFFFFFF) // 1000
                self.event("vented t=%d ms=%d" % (self._last_us, took_ms))
            return
        self._vented_run = 0
        self._vent_left_us -= dt_us
        if self._vent_left_us <= 0:
            self._vent_left_us = 0
            self.trip("vent_failed")

    def _watch_vented(self) -> None:
        """Check for a high reading after a confirmed or failed vent."""
        self._lost_run += 1
        if self._lost_run == VENTED_READINGS:
            self.trip("vent_lost")

    def led_steady(self, on: int) -> None:
        """Switch the sync LED on or off."""
        self._led_bit_us = 0
        self._led = on
        self.board.led(on)

    def led_pattern(self, seed: int, bit_ms: int) -> None:
        """Start a pseudo-random pattern on the sync LED (see ``wire.lfsr_next``)."""
        self._led_state = seed
        self._led_bit_us = bit_ms * 1000
        self._led_left_us = -1  # bit 0 starts at this tick
        self._led = seed & 1
        self.board.led(self._led)

    def _blink(self, dt_us: int) -> None:
        if self._led_left_us < 0:
            self._led_left_us = self._led_bit_us
            return
        self._led_left_us -= dt_us
        while self._led_left_us <= 0:
            self._led_left_us += self._led_bit_us
            self._led_state = lfsr_next(self._led_state)
        led = self._led_state & 1
        if led != self._led:
            self._led = led
            self.board.led(led)
