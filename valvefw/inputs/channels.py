# mypy: disable-error-code="no-untyped-def"
"""Further inputs of the controller: force and length with the device time of the pressure.

There are five inputs, each on fixed pins: a bridge converter (HX711 or ADS1232), an ADS1115, a
quadrature encoder, and two analogue inputs of the chip. A parameter switches each on (``config``).
The loop looks at them once after each step of the safety core, which knows nothing of them: an
input can delay neither a check nor a valve.

A reading is never repeated, and one that is not certain is no value but a state:

    overload    the converter is at its end
    silent      no conversion for three periods; again each second
    stuck       a bridge converter whose noise is gone: the same value ``SAME_N`` times
    early       a bridge conversion before half its period: its data line is not connected
    lost_count  the encoder jumped by two steps: its count is wrong from then on

Readings of a converter are held until the next one came in time, because a plug that is pulled in
the middle of a transfer leaves half a reading. Those after a silence are dropped until the
converter's filter has settled, and so is one that the loop reads too late to know its time.
"""

from valvefw.board import Board
from valvefw.core import NOW, REPLY_HIGH, REPLY_LOW, TIME_MASK, Core
from valvefw.inputs.ads1115 import Ads1115
from valvefw.native import const, copy, micropython, ptr8, ptr32, words
from valvefw.wire import MAX_READINGS, ONE_BLOCK, READING_SIZE, seal

BRIDGE = const(0)  # wire.INPUTS
ADC16 = const(1)
ENCODER = const(2)
SECOND = const(3)
THIRD = const(4)
INPUTS = const(5)

OVERLOAD = const(1)  # wire.STATES
SILENT = const(2)
STUCK = const(3)
EARLY = const(4)
LOST_COUNT = const(5)

LOST = const(0x1000000)  # a bit of an encoder's reading
SETTLE_N = const(5)  # conversions; both bridge converters have settled after four
SAME_N = const(6)
LATE_US = const(3000)
AGAIN_US = const(1000000)
SEND_US = const(60000)  # a reading waits at most so long for a frame ...
SEND_N = const(12)  # ... that holds as many
HELD_READINGS = const(64)

# Words of each input; the first eight are settings.
ON = const(0)
PERIOD = const(1)  # us
LOWEST = const(2)
HIGHEST = const(3)
SIGN = const(4)  # the bit that makes a value negative
SILENT_US = const(5)
CHECKED = const(6)  # 1: a bridge, with noise and an even rate
HOLDS = const(7)
SINCE = const(8)  # us since the last conversion
SILENT_LEFT = const(9)
SETTLE = const(10)
SAME = const(11)
LAST_VALUE = const(12)
HELD = const(13)
HELD_VALUE = const(14)
HELD_LOW = const(15)
HELD_HIGH = const(16)
DUE = const(17)
COUNT_LOST = const(18)
PLACES = const(19)
# Words of all.
FIRST = const(95)  # place of the oldest reading that waits
WAITING = const(96)
SEQUENCE_LOW = const(97)  # of the next reading
SEQUENCE_HIGH = const(98)
WAITED = const(99)  # us
CHANNEL_WORDS = const(100)

KEYS = ("bridge", "adc16", "adc16_ms", "encoder_ms", "second_ms", "third_ms")
# Clock pulses for each setting of ``bridge``: they choose what is converted next.
PULSES = (0, 25, 27, 26, 25, 25, 27, 26, 25)
BITS24 = 0x800000
BITS16 = 0x8000


@micropython.viper
def put(w: ptr32, ring: ptr8, tag: int, value: int, low: int, high: int):
    """Add a reading to those that wait; the oldest is lost where there is no space."""
    n = w[WAITING]
    if n == HELD_READINGS:
        n -= 1
        w[FIRST] = (w[FIRST] + 1) % HELD_READINGS
    at = (w[FIRST] + n) % HELD_READINGS * READING_SIZE
    ring[at] = low & 255
    ring[at + 1] = low >> 8
    ring[at + 2] = high & 255
    ring[at + 3] = high >> 8
    ring[at + 4] = tag
    ring[at + 5] = value & 255
    ring[at + 6] = (value >> 8) & 255
    ring[at + 7] = (value >> 16) & 255
    ring[at + 8] = (value >> 24) & 255
    w[WAITING] = n + 1
    number = w[SEQUENCE_LOW] + 1
    if number > 65535:
        number = 0
        w[SEQUENCE_HIGH] = (w[SEQUENCE_HIGH] + 1) & 65535
    w[SEQUENCE_LOW] = number


@micropython.viper
def pass_time(w: ptr32, dt: int) -> int:
    """Let ``dt`` us pass. Bits: 0 on, the input is to be looked at; 12 on, it is due to be read;
    20 on, it has been silent for too long, unless a conversion is there now. Only a converter is
    looked at in between."""
    mask = 0
    bit = 1
    at = 0
    while at < INPUTS * PLACES:
        if w[at + ON]:
            look = 0
            if at < ENCODER * PLACES:
                look = bit
            since = w[at + SINCE]
            if since < 0x10000000:
                w[at + SINCE] = since + dt
            left = w[at + SILENT_LEFT] - dt
            w[at + SILENT_LEFT] = left
            if left <= 0:
                look = bit | bit << 20
            due = w[at + DUE] - dt
            if due <= 0:
                look = look | bit | bit << 12
                due += w[at + PERIOD]
                if due <= 0:
                    due = w[at + PERIOD]
            w[at + DUE] = due
            mask = mask | look
        bit = bit << 1
        at += PLACES
    return mask


@micropython.viper
def miss(w: ptr32, ring: ptr8, which: int, low: int, high: int):
    """No conversion has come for too long."""
    at = which * PLACES
    put(w, ring, which | SILENT << 4, w[at + SINCE] // 1000, low, high)
    w[at + SILENT_LEFT] = AGAIN_US
    w[at + HELD] = 0
    if w[at + CHECKED]:
        w[at + SETTLE] = SETTLE_N


@micropython.viper
def heard(w: ptr32, which: int) -> int:
    """A conversion came: the time since the one before it, us."""
    at = which * PLACES
    since = w[at + SINCE]
    w[at + SINCE] = 0
    w[at + SILENT_LEFT] = w[at + SILENT_US]
    return since


@micropython.viper
def take(w: ptr32, ring: ptr8, which: int, raw: int, low: int, high: int):
    """A conversion that was read now: a value, a state, or nothing yet."""
    at = which * PLACES
    since = int(heard(w, which))
    if raw & LOST:
        w[at + COUNT_LOST] = 1
        raw = raw & 0xFFFFFF
    value = raw
    if raw & w[at + SIGN]:
        value = raw - 2 * w[at + SIGN]
    if w[at + COUNT_LOST]:
        put(w, ring, which | LOST_COUNT << 4, value, low, high)
        return
    if w[at + CHECKED] and since < w[at + PERIOD] // 2:
        w[at + HELD] = 0
        w[at + SETTLE] = SETTLE_N
        put(w, ring, which | EARLY << 4, since, low, high)
        return
    if w[at + SETTLE]:
        w[at + SETTLE] = w[at + SETTLE] - 1
        return
    if w[at + HELD]:
        w[at + HELD] = 0
        put(w, ring, which, w[at + HELD_VALUE], w[at + HELD_LOW], w[at + HELD_HIGH])
    if value <= w[at + LOWEST] or value >= w[at + HIGHEST]:
        w[at + SAME] = 0
        put(w, ring, which | OVERLOAD << 4, value, low, high)
        return
    same = 0
    if value == w[at + LAST_VALUE]:
        same = w[at + SAME] + 1
    w[at + LAST_VALUE] = value
    if w[at + CHECKED] and same + 1 >= SAME_N:
        put(w, ring, which | STUCK << 4, value, low, high)
        return
    w[at + SAME] = same
    if w[at + HOLDS]:
        w[at + HELD] = 1
        w[at + HELD_VALUE] = value
        w[at + HELD_LOW] = low
        w[at + HELD_HIGH] = high
        return
    put(w, ring, which, value, low, high)


@micropython.viper
def gather_readings(w: ptr32, ring: ptr8, boot: int, out: ptr8) -> int:
    """Write the oldest readings that wait as a payload into ``out`` from byte 1; its length."""
    n = w[WAITING]
    low = w[SEQUENCE_LOW] - n
    high = w[SEQUENCE_HIGH]
    if low < 0:
        low += 65536
        high = (high - 1) & 65535
    if n > MAX_READINGS:
        n = MAX_READINGS
    first = w[FIRST]
    w[FIRST] = (first + n) % HELD_READINGS
    w[WAITING] = w[WAITING] - n
    w[WAITED] = 0
    out[1] = 0x58
    out[2] = boot & 255
    out[3] = boot >> 8
    out[4] = low & 255
    out[5] = low >> 8
    out[6] = high & 255
    out[7] = high >> 8
    out[8] = n
    over = first + n - HELD_READINGS
    if over < 0:
        over = 0
    n -= over
    copy(out, 9, ring, first * READING_SIZE, n * READING_SIZE)
    to = 9 + n * READING_SIZE
    copy(out, to, ring, 0, over * READING_SIZE)
    return to + over * READING_SIZE - 1


class Channels:
    """The inputs that are on, and frames of their readings.

    Args:
        board: reads the pins.
        core: its state has the device time.
        boot_id: of the telemetry.
    """

    def __init__(self, board: Board, core: Core, boot_id: int) -> None:
        self._board = board
        self._state = core.state
        self._boot_id = boot_id
        self._adc16 = Ads1115(board)
        self._words = words(CHANNEL_WORDS)
        self._ring = bytearray(HELD_READINGS * READING_SIZE)
        self.buffer = bytearray(ONE_BLOCK + 1)
        self._now = 0
        self._set = [0] * len(KEYS)
        self.on = False

    def load(self, values: "dict[str, int]") -> None:
        """Take the parameters ``KEYS`` over; only while disarmed.

        An input whose parameters are as before goes on: an encoder keeps its count.
        """
        before = self._set
        new = self._set = [values[key] for key in KEYS]
        if new[0] != before[0]:
            self._board.bridge_start(PULSES[new[0]])
            period = 12500 if new[0] > 4 else 100000
            self._begin(BRIDGE, new[0], period, BITS24, 3 * period)
        if new[1] != before[1] or new[2] != before[2]:
            self._adc16.start(new[1], new[2])
            self._begin(ADC16, new[1], 1000 * new[2], BITS16, 3000 * new[2])
        if new[3] != before[3]:
            self._board.encoder_start(new[3] > 0)
            self._begin(ENCODER, new[3], 1000 * new[3], BITS24, AGAIN_US)
        for k in (4, 5):
            if new[k] != before[k]:
                silent = 3000 * new[k] + 50000  # a capture uses the converter for 40 ms
                self._begin(k - 1, new[k], 1000 * new[k], 0, silent)
        self.on = new[0] + new[1] + new[3] + new[4] + new[5] > 0

    def _begin(self, which: int, on: int, period: int, sign: int, silent: int) -> None:
        w = self._words
        at = which * PLACES
        for k in range(PLACES):
            w[at + k] = 0
        w[at + ON] = 1 if on else 0
        w[at + DUE] = w[at + PERIOD] = period
        w[at + SILENT_LEFT] = w[at + SILENT_US] = silent
        w[at + SIGN] = sign
        if which >= SECOND:
            w[at + HIGHEST] = 4095
        elif which == ENCODER:  # the host counts the overflows
            w[at + LOWEST] = -LOST
            w[at + HIGHEST] = LOST
        else:
            w[at + LOWEST] = -sign
            w[at + HIGHEST] = sign - 1
            w[at + HOLDS] = 1
        if which == BRIDGE:
            w[at + CHECKED] = 1
            w[at + SETTLE] = SETTLE_N
            w[at + SINCE] = period  # the first one is not early
            w[at + SILENT_LEFT] = 600000  # a converter wakes up first

    @micropython.native
    def poll(self) -> int:
        """Look at every input that is on; 1 if a frame should be sent."""
        w = self._words
        ring = self._ring
        board = self._board
        s = self._state
        now = s[NOW]
        dt = (now - self._now) & TIME_MASK
        self._now = now
        mask = pass_time(w, dt)
        which = 0
        while mask & 31:
            if mask & 1:
                raw = -1
                if which == BRIDGE:
                    raw = board.bridge()
                elif which == ADC16:
                    raw = self._adc16.step(mask & 0x1000)
                elif mask & 0x1000:
                    raw = board.encoder() if which == ENCODER else board.analogue(which - ENCODER)
                if raw >= 0 or mask & 0x100000:
                    board.stamp(s)
                    low = s[REPLY_LOW]
                    high = s[REPLY_HIGH]
                    if raw < 0:
                        miss(w, ring, which, low, high)
                    elif dt <= LATE_US or which > ADC16:
                        take(w, ring, which, raw, low, high)
                    else:  # nobody knows when it was made
                        heard(w, which)
                        w[which * PLACES + SINCE] = w[which * PLACES + PERIOD]  # nor of the next
                        while which == BRIDGE and board.bridge() >= 0:
                            pass
            mask >>= 1
            which += 1
        waiting = w[WAITING]
        if waiting == 0:
            return 0
        w[WAITED] += dt
        return 1 if waiting >= SEND_N or w[WAITED] >= SEND_US else 0

    @micropython.native
    def frame(self) -> int:
        """Write the oldest readings that wait into ``buffer`` as a frame; returns its length."""
        size = gather_readings(self._words, self._ring, self._boot_id, self.buffer)
        return seal(self.buffer, size)
