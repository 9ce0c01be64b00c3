"""Text requests `<id> <verb> [arg ...] [@session]` and their replies.

A reply is `<id> ok ...` or `<id> err <code> ...`.

Invalid arguments are refused, never clipped. All verbs: docs/reference/wire-format.md.
"""

from valvefw import config
from valvefw.core import COUNTS
from valvefw.inputs.channels import KEYS
from valvefw.wire import (
    CAPTURE_LEAD_US,
    CAPTURE_N,
    CAPTURE_US,
    GUARDED,
    MAX_REQUEST,
    MAX_SAMPLES,
    PROTO,
    PULSE_UNIT_US,
    SAMPLE_SIZE,
    TICK_US,
)

PULSE_VENT_MAX_US = 500000
PULSE_COUNT_MAX = 10000
PULSE_PERIOD_MAX_US = 60000000
BLACK_BOX_ROWS = 8
BLOCK_ROWS = 100
CAPTURE_PULSE_MAX_US = 30000

_DIGITS = "0123456789"
_HEX_DIGITS = "0123456789abcdefABCDEF"


class Refused(Exception):
    """A rejected request: an error code for programs, a text with the remedy."""

    def __init__(self, code: str, text: str) -> None:
        self.code = code
        self.text = text


def _number(text: str, low: int, high: int, name: str) -> int:
    value = _plain(text)
    if value < 0:
        raise Refused("syntax", "%s must be a decimal number" % name)
    if not low <= value <= high:
        raise Refused("range", "%s %d is outside %d..%d" % (name, value, low, high))
    return value


def _plain(text: str) -> int:
    # int() accepts signs, blanks and underscores, depending on the interpreter.
    if not 0 < len(text) <= 10:
        return -1
    for char in text:
        if char not in _DIGITS:
            return -1
    return int(text)


class Commands:
    """The verbs; the controller calls only ``answer``."""

    def __init__(self, controller) -> None:  # type: ignore[no-untyped-def]
        self._c = controller
        self._session = 0  # of the present request
        self._told = False
        self._verbs = {
            "id": (0, 0, self._id),
            "help": (0, 0, self._help),
            "stat": (0, 0, self._stat),
            "conf": (0, 1, self._conf),
            "get": (1, 1, self._get),
            "set": (2, 2, self._set),
            "arm": (2, 2, self._arm),
            "hb": (1, 1, self._hb),
            "sp": (1, 1, self._sp),
            "scheme": (1, 1, self._scheme),
            "pulse": (2, 4, self._pulse),
            "capture": (3, 3, self._capture),
            "block": (1, 1, self._block),
            "vent": (0, 0, self._vent),
            "stop": (0, 0, self._stop),
            "faults": (0, 0, self._faults),
            "blackbox": (1, 1, self._blackbox),
            "clear": (0, 0, self._clear),
            "led": (1, 3, self._led),
            "telemetry": (1, 1, self._telemetry),
            "timing": (0, 0, self._timing),
        }

    def answer(self, request: bytes) -> str:
        """Execute one request (without its type byte) and return the reply."""
        request_id = 0
        try:
            if len(request) > MAX_REQUEST:
                raise Refused("syntax", "request is longer than %d bytes" % MAX_REQUEST)
            for byte in request:
                if not 32 <= byte < 127:
                    raise Refused("syntax", "request must be printable ASCII")
            words = request.decode().split()
            request_id = _plain(words[0]) if words else -1
            if not 0 <= request_id <= 65535:
                request_id = 0
                raise Refused("syntax", "request must begin with an id 0..65535")
            if len(words) < 2:
                raise Refused("syntax", "no verb, try help")
            verb = self._verbs.get(words[1])
            if verb is None:
                raise Refused("verb", "unknown verb, try help")
            args = words[2:]
            self._session = 0
            if args and args[-1][0] == "@":
                self._session = _number(args.pop()[1:], 1, 65535, "session")
            self._check_session(words[1])
            if not verb[0] <= len(args) <= verb[1]:
                raise Refused(
                    "syntax", "%s takes %d to %d arguments" % (words[1], verb[0], verb[1])
                )
            text = verb[2](args)
        except Refused as refused:
            return "%d err %s %s" % (request_id, refused.code, refused.text)
        return "%d ok %s" % (request_id, text) if text else "%d ok" % request_id

    def _check_session(self, verb: str) -> None:
        c = self._c
        if verb not in GUARDED or not c.safety.armed or self._session == c.session:
            return
        if c.session:
            c.foreign += 1
            if not self._told:
                self._told = True
                c.event("foreign verb=%s n=%d" % (verb, c.foreign))
            raise Refused("session", "another host has armed: vent, or stop and arm anew")

    def _need_armed(self) -> None:
        c = self._c
        if c.safety.faults:
            raise Refused("fault", "%s is latched, clear it and arm" % c.safety.faults[0][0])
        if not c.safety.armed:
            raise Refused("not_armed", "arm first")

    def _need_disarmed(self) -> None:
        if self._c.safety.armed:
            raise Refused("armed", "stop first")

    def _need_idle_openloop(self) -> None:
        self._need_armed()
        if self._c.scheme is not self._c.openloop:
            raise Refused("scheme", "choose scheme open first")
        if self._c.openloop.busy():
            raise Refused("busy", "pulses are still running, wait or vent")

    def _pulse_width(self, text: str, longest: int) -> int:
        width = _number(text, PULSE_UNIT_US, longest, "us")
        if width % PULSE_UNIT_US:
            raise Refused("range", "us must be a multiple of %d" % PULSE_UNIT_US)
        return width

    def _is_inlet(self, valve: str) -> bool:
        if valve not in ("inlet", "vent"):
            raise Refused("range", "valve is inlet or vent")
        return valve == "inlet"

    def _id(self, args: list[str]) -> str:
        c = self._c
        board = c.board
        return "name=valvefw fw=%s proto=%d board=%s serial=%s boot=%d cause=%s conf=%04x" % (
            c.version,
            PROTO,
            board.name,
            board.serial,
            c.telemetry.boot_id,
            board.reset_cause,
            c.checksum.of(c.values),
        )

    def _help(self, args: list[str]) -> str:
        return "verbs=" + ",".join(sorted(self._verbs))

    def _stat(self, args: list[str]) -> str:
        c = self._c
        state = "fault" if c.safety.faults else "armed" if c.safety.armed else "disarmed"
        return "state=%s scheme=%s sp=%d counts=%d t=%d bad=%d lost=%d foreign=%d" % (
            state,
            c.scheme.name if c.scheme is not None else "idle",
            c.setpoint_x16,
            c.core.state[COUNTS],
            c.board.ticks_us(),
            c.receiver.bad_frames,
            c.receiver.lost_bytes,
            c.foreign,
        )

    def _conf(self, args: list[str]) -> str:
        values = self._c.values
        rows = config.PARAMETERS
        if not args:
            return "conf=%04x n=%d" % (self._c.checksum.of(values), len(rows))
        row = rows[_number(args[0], 0, len(rows) - 1, "index")]
        return "key=%s value=%d low=%d high=%d default=%d" % (
            row[0],
            values[row[0]],
            row[2],
            row[3],
            row[1],
        )

    def _key(self, key: str) -> tuple[int, int]:
        limits = config.bounds(key)
        if limits is None:
            raise Refused("key", "no such parameter, conf <index> lists them")
        return limits

    def _get(self, args: list[str]) -> str:
        self._key(args[0])
        return "%s=%d" % (args[0], self._c.values[args[0]])

    def _set(self, args: list[str]) -> str:
        c = self._c
        low, high = self._key(args[0])
        value = _number(args[1], low, high, args[0])
        self._need_disarmed()
        c.values[args[0]] = value
        c.safety.load(c.values)
        if args[0] in KEYS:
            c.channels.load(c.values)
        return "conf=%04x" % c.checksum.of(c.values)

    def _arm(self, args: list[str]) -> str:
        c = self._c
        if c.safety.faults:
            raise Refused("fault", "%s is latched, clear it first" % c.safety.faults[0][0])
        self._need_disarmed()
        for char in args[0]:
            if char not in _HEX_DIGITS:
                raise Refused("syntax", "conf_crc must be hexadecimal")
        crc = c.checksum.of(c.values)
        if len(args[0]) > 4 or int(args[0], 16) != crc:
            raise Refused("conf", "config is %04x: set the parameters again" % crc)
        boot = c.telemetry.boot_id
        if _number(args[1], 0, 65535, "boot") != boot:
            raise Refused("boot", "boot is %d: the board has been reset" % boot)
        reason = config.problem(c.values)
        if reason:
            raise Refused("conf", reason)
        c.board.tidy()  # not needed again for minutes
        c.session = self._session
        c.foreign = 0
        self._told = False
        c.safety.arm(c.values)
        return ""

    def _hb(self, args: list[str]) -> str:
        c = self._c
        counter = _number(args[0], 0, 65535, "counter")
        if not c.safety.heartbeat(counter):
            raise Refused("stale", "counter %d does not go on" % counter)
        if c.scheme is not None:
            c.scheme.renew()
        return "hb=%d t=%d" % (counter, c.board.ticks_us())

    def _sp(self, args: list[str]) -> str:
        c = self._c
        setpoint_x16 = _number(args[0], 0, c.values["sp_max"] * 16, "setpoint_x16")
        self._need_armed()
        if c.scheme is None or c.scheme is c.openloop:
            raise Refused("scheme", "no set-point in this scheme, choose pwm or reg")
        c.set_setpoint(setpoint_x16)
        c.scheme.renew()
        return "sp=%d" % setpoint_x16

    def _scheme(self, args: list[str]) -> str:
        c = self._c
        name = args[0]
        if name != "idle" and name not in c.schemes:
            raise Refused("range", "schemes are idle," + ",".join(sorted(c.schemes)))
        if name == "reg" and not c.board.has_regulator:
            raise Refused("scheme", "this board has no regulator")
        self._need_armed()
        if name == "idle":
            c.vent()
        else:
            c.choose(name)
        return ""

    def _pulse(self, args: list[str]) -> str:
        c = self._c
        inlet = self._is_inlet(args[0])
        if len(args) == 3:
            raise Refused("syntax", "a train needs count and period_us")
        longest = c.values["inlet_max_ms"] * 1000 if inlet else PULSE_VENT_MAX_US
        width = self._pulse_width(args[1], longest)
        rest = c.values["inlet_rest_ms"] * 1000 if inlet else 0
        count = 1
        period = width + rest
        if len(args) == 4:
            count = _number(args[2], 1, PULSE_COUNT_MAX, "count")
            period = _number(args[3], period, PULSE_PERIOD_MAX_US, "period_us")
            if period % TICK_US:
                raise Refused("range", "period_us must be a multiple of %d" % TICK_US)
        self._need_idle_openloop()
        c.openloop.begin(inlet, width, count, period)
        return ""

    def _capture(self, args: list[str]) -> str:
        c = self._c
        inlet = self._is_inlet(args[0])
        width = self._pulse_width(
            args[1], min(CAPTURE_PULSE_MAX_US, c.values["inlet_max_ms"] * 1000)
        )
        source = _number(args[2], 0, 1, "source")
        self._need_idle_openloop()
        if not c.capture.begin(source):
            raise Refused("board", "this board cannot capture from source %d" % source)
        rest = c.values["inlet_rest_ms"] * 1000
        # A request takes effect one tick after its step.
        c.openloop.begin(inlet, width, 1, width + rest, CAPTURE_LEAD_US - TICK_US)
        return "n=%d period_us=%d" % (CAPTURE_N, CAPTURE_US)

    def _block(self, args: list[str]) -> str:
        capture = self._c.capture
        first = _number(args[0], 0, CAPTURE_N - 1, "first")
        data = capture.part(first, BLOCK_ROWS)
        if not data or capture.lead_us < 0:
            raise Refused("busy", "no block yet, capture and wait 50 ms")
        return "first=%d n=%d lead_us=%d data=%s" % (first, len(data) // 3, capture.lead_us, data)

    def _vent(self, args: list[str]) -> str:
        self._c.vent()
        return ""

    def _stop(self, args: list[str]) -> str:
        self._c.disarm()
        return ""

    def _faults(self, args: list[str]) -> str:
        safety = self._c.safety
        samples = len(self._c.telemetry.black_box()) // SAMPLE_SIZE
        text = "n=%d samples=%d" % (len(safety.faults), samples)
        at = 1
        for fault in safety.faults:
            text += " f%d=%s t%d=%d" % (at, fault[0], at, fault[1])
            at += 1
        return text

    def _blackbox(self, args: list[str]) -> str:
        box = self._c.telemetry.black_box()
        rows = len(box) // SAMPLE_SIZE
        if not rows:
            raise Refused("range", "no fault is latched")
        first = _number(args[0], 0, rows - 1, "first")
        part = box[first * SAMPLE_SIZE : (first + BLACK_BOX_ROWS) * SAMPLE_SIZE]
        return "first=%d n=%d data=%s" % (
            first,
            len(part) // SAMPLE_SIZE,
            "".join(["%02x" % byte for byte in part]),
        )

    def _clear(self, args: list[str]) -> str:
        c = self._c
        reason = c.clear()
        if reason:
            raise Refused("pressure", reason)
        return ""

    def _led(self, args: list[str]) -> str:
        c = self._c
        if args[0] == "sync":
            if len(args) != 3:
                raise Refused("syntax", "led sync takes seed and bit_ms")
            seed = _number(args[1], 1, 65535, "seed")
            bit_ms = _number(args[2], 2, 1000, "bit_ms")
            at_us = c.led_pattern(seed, bit_ms)
        elif len(args) == 1:
            at_us = c.led_steady(_number(args[0], 0, 1, "led"))
        else:
            raise Refused("syntax", "led takes 0, 1 or sync seed bit_ms")
        return "t=%d" % at_us

    def _telemetry(self, args: list[str]) -> str:
        c = self._c
        n = _number(args[0], 1, MAX_SAMPLES, "samples_per_frame")
        c.send_held()
        c.telemetry.samples_per_frame = n
        return ""

    def _timing(self, args: list[str]) -> str:
        text = "step_us=%d dt_min_us=%d dt_max_us=%d loop_ms=%d missed=%d"
        out: str = text % self._c.core.timing()
        return out
