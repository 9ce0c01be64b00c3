# mypy: disable-error-code="no-untyped-def"
"""The safety core: one ``step`` per millisecond that nothing else on the board can delay.

On the chip ``step`` runs in a hard interrupt, as machine code (see ``native``). It allocates
nothing and keeps running while Python collects garbage, builds a frame or answers a request. It

1. takes the reading of the interrupt and checks it (over-pressure, invalid, silent, implausible);
2. counts down the deadlines of the host (heartbeat) and of the loop (``controller``);
3. takes over what the loop requested, within limits, and decides how long each valve is open;
4. records the sample.

The board drives the valves directly after ``step``. The loop reports a fault later.

The state is an array of integers, so that machine code can read it. The constants below are the
places in it. Both sides write whole words only; a request counts once ``REQUESTED`` is set.
Faults latch here: with a fault, or disarmed, the inlet stays closed whatever the loop requests.
"""

from array import array

from valvefw.native import const, copy, micropython, ptr8, ptr16, ptr32, words

# Written by the interrupt before each step.
NOW = const(0)  # device time, us, 30 bits
NOW_LOW = const(1)  # device time, us, 32 bits in two halves
NOW_HIGH = const(2)
READING = const(3)  # counts; negative: no reading
PROX = const(4)
# Results of a step.
INLET_US = const(5)  # open from now on for so long
VENT_US = const(6)
LED = const(7)
COUNTS = const(8)  # the last reading
DT = const(9)  # us since the step before
TICKS = const(10)  # steps, 30 bits
# Set by the loop.
ARMED = const(11)
RUNNING = const(12)  # a scheme runs; else vented
RENEWS = const(13)  # its inlet may stay open
REQUESTED = const(14)  # which of the two below are new
WANT_INLET = const(15)
WANT_VENT = const(16)
HEARTBEAT_LEFT = const(17)  # us to the deadline
LOOP_LEFT = const(18)
BEATEN = const(19)  # a heartbeat was received since arming
# Faults: a bit for each cause, and a list of those latched in order of time.
FAULTS = const(20)
FAULT_N = const(21)
FIRST_FAULT = const(22)  # eight times: cause, time (low, high), counts
FAULT_WORDS = const(4)
MAX_FAULTS = const(8)
# Limits; the loop copies them while disarmed.
TRIP = const(54)
TRIP_N = const(55)
TRIP_MASK = const(56)
SAT_HIGH = const(57)
SAT_LOW = const(58)
SAT_N = const(59)
INLET_MAX = const(60)
INLET_REST = const(61)
VENT_BELOW = const(62)
STUCK = const(63)
SLEW = const(64)
JUMP = const(65)
RISE = const(66)
RISE_COUNTS = const(67)
LEAK = const(68)
ON_IN = const(69)
OFF_IN = const(70)
# Running values of the checks.
LAST = const(71)
OVER = const(72)
SATURATED = const(73)
SILENT = const(74)
INLET_LEFT = const(75)
VENT_LEFT = const(76)
INLET_RUN = const(77)
SHUT = const(78)
OLD = const(79)
SAME = const(80)
TRACK = const(81)
AWAY = const(82)
FILLING = const(83)
FILLED = const(84)
IDLE = const(85)
QUIET = const(86)
REFERENCE = const(87)
LEAKS = const(88)
# Venting.
VENT_TIME = const(89)  # us left to be vented; 0: not watched
VENT_FOR = const(90)  # us since the vent began
VENTED_RUN = const(91)
LOST_RUN = const(92)
LOST_AT = const(93)  # counts
VENTED_NEWS = const(94)  # 1: the vent was confirmed; its time and duration below
VENTED_LOW = const(95)
VENTED_HIGH = const(96)
VENTED_MS = const(97)
# Samples.
SEQ_LOW = const(98)
SEQ_HIGH = const(99)
SENT = const(100)  # of TICKS samples so many were sent; written by the loop
AT = const(101)  # place of the next sample
BOX_N = const(102)  # samples in the black box
BOX_AT = const(103)  # place behind the newest
# Sync LED.
LED_STATE = const(104)
LED_BIT = const(105)
LED_LEFT = const(106)
# Switching capture.
CAPTURE_WAITS = const(107)
CAPTURE_SINCE = const(108)
CAPTURE_LEAD = const(109)
# Timing since it was last read: the longest step (measured by the board), the longest and the
# shortest time between two steps, us.
STEP_WORST = const(110)
DT_LONGEST = const(111)
DT_SHORTEST = const(112)
VENT_LIMIT = const(113)  # us in which a vent must succeed
# Of telemetry frames.
BOOT_ID = const(114)
SETPOINT = const(115)  # counts x16
# Device time of a reply, us, 32 bits in two halves.
REPLY_LOW = const(116)
REPLY_HIGH = const(117)
HAS_RUN = const(118)  # a scheme ran at the step before
# More timing, written by the loop: most steps between two of its passes, and steps it missed.
LOOP_WORST = const(119)
MISSED = const(120)
BOX_TICKS = const(121)  # step of the first fault
WORDS = const(122)

CAUSES = (
    "host_silent",
    "over_pressure",
    "sensor_saturated",
    "sensor_silent",
    "sensor_stuck",
    "sensor_jump",
    "sensor_no_rise",
    "inlet_stuck",
    "outlet_stuck",
    "inlet_bound",
    "vent_failed",
    "vent_lost",
    "loop_stalled",
)
HOST_SILENT = const(1)
OVER_PRESSURE = const(2)
SENSOR_SATURATED = const(3)
SENSOR_SILENT = const(4)
SENSOR_STUCK = const(5)
SENSOR_JUMP = const(6)
SENSOR_NO_RISE = const(7)
INLET_STUCK = const(8)
OUTLET_STUCK = const(9)
INLET_BOUND = const(10)
VENT_FAILED = const(11)
VENT_LOST = const(12)
LOOP_STALLED = const(13)

TICK = const(1000)
TIME_MASK = const(0x3FFFFFFF)
LATE = const(20000)  # no step for longer: a fault. The board's outputs are off by then
LOOP = const(50000)  # no pass of the loop for longer: a fault
VENT_HOLD = const(1000000)  # longer than any pulse: open until changed
SHUT_MIN = const(5)
SILENT_N = const(2)
JUMP_N = const(4)
LEAK_N = const(3)
LEAK_SPAN = const(50000)
VENTED_READINGS = const(8)  # consecutive readings that confirm a vent, or its loss
REQUEST_INLET = const(1)
REQUEST_VENT = const(2)
RING = const(128)
BOX = const(64)  # samples of the black box
SAMPLE_BYTES = const(7)
SAMPLES_MAX = const(32)  # wire.MAX_SAMPLES
DT_UNKNOWN = const(65535)


@micropython.viper
def latch(s: ptr32, cause: int):
    """Record a fault once, with its time and reading; disarm."""
    s[ARMED] = 0
    s[RUNNING] = 0
    bit = 1 << cause
    if not s[FAULTS] & bit:
        n = s[FAULT_N]
        s[FAULTS] = s[FAULTS] | bit
        if n < MAX_FAULTS:
            at = FIRST_FAULT + n * FAULT_WORDS
            s[at] = cause
            s[at + 1] = s[NOW_LOW]
            s[at + 2] = s[NOW_HIGH]
            s[at + 3] = s[COUNTS]
            s[FAULT_N] = n + 1


@micropython.viper
def check_plausible(s: ptr32) -> int:
    """Is the reading physically possible, given what was driven during the past tick?

    The converter has no live zero: a broken wire may read 0, which is also a valid pressure.
    """
    counts = s[COUNTS]
    dt = s[DT]
    if counts != s[OLD]:
        s[OLD] = counts
        s[SAME] = 0
    elif counts and s[STUCK]:
        same = s[SAME] + dt
        s[SAME] = same
        if same >= s[STUCK]:
            return SENSOR_STUCK
    track = s[TRACK]
    slew = s[SLEW]
    if counts > track + slew:
        track += slew
    elif counts < track - slew:
        track -= slew
    else:
        track = counts
    s[TRACK] = track
    away = 0
    if counts > track + s[JUMP] or counts < track - s[JUMP]:
        away = s[AWAY] + 1
    s[AWAY] = away
    if away >= JUMP_N:
        return SENSOR_JUMP
    inlet = s[INLET_US]
    vent = s[VENT_US]
    if inlet:
        s[IDLE] = 0
        if s[FILLING] <= s[ON_IN]:
            if inlet < dt:
                s[FILLING] = s[FILLING] + inlet
            else:
                s[FILLING] = s[FILLING] + dt
        if counts >= s[RISE_COUNTS] or s[RENEWS]:
            s[FILLED] = 0
        elif s[RISE] and vent == 0 and s[FILLING] > s[ON_IN]:
            filled = s[FILLED] + dt
            s[FILLED] = filled
            if filled >= s[RISE]:
                return SENSOR_NO_RISE
        s[QUIET] = 0
        return 0
    if s[FILLING]:
        idle = s[IDLE] + dt
        s[IDLE] = idle
        if idle > s[OFF_IN]:  # the closing delay is over
            s[FILLING] = 0
    leak = s[LEAK]
    if vent or leak == 0:
        s[QUIET] = 0
        return 0
    if away:  # no valid reading to compare
        return 0
    quiet = s[QUIET] + dt
    rest = s[INLET_REST]
    s[QUIET] = quiet
    change = counts - s[REFERENCE]
    if quiet > rest and (change >= leak or change <= 0 - leak):
        leaks = s[LEAKS] + 1
        s[LEAKS] = leaks
        if leaks < LEAK_N:
            return 0
        if change > 0:
            return INLET_STUCK
        return OUTLET_STUCK
    s[LEAKS] = 0
    if quiet <= rest or quiet > rest + LEAK_SPAN:
        if quiet > rest:
            s[QUIET] = rest
        s[REFERENCE] = counts
    return 0


@micropython.viper
def bound_inlet(s: ptr32, inlet: int, tick: int) -> int:
    """The part of ``inlet`` that may be driven; -1 at the limit: a fault.

    Openings add up until the inlet was closed for ``INLET_REST``, which is longer than the valve's
    closing time. Short gaps therefore do not reset the limit.
    """
    if inlet <= 0:
        if s[INLET_RUN]:
            shut = s[SHUT] + tick
            s[SHUT] = shut
            if shut >= s[INLET_REST]:
                s[INLET_RUN] = 0
        return 0
    run = s[INLET_RUN]
    left = s[INLET_MAX] - run
    if left < SHUT_MIN:
        return -1
    s[SHUT] = 0
    if inlet > left:
        inlet = left
    if inlet < tick:  # a pulse that ends within the tick: closed for the rest of it
        s[SHUT] = tick - inlet
        s[INLET_RUN] = run + inlet
    else:
        s[INLET_RUN] = run + tick
    return inlet


@micropython.viper
def watch_vent(s: ptr32):
    """While vented: the pressure must fall in time, and stay low."""
    counts = s[COUNTS]
    if s[VENT_TIME]:
        s[VENT_FOR] = s[VENT_FOR] + s[DT]
        if counts < s[VENT_BELOW]:
            run = s[VENTED_RUN] + 1
            s[VENTED_RUN] = run
            if run >= VENTED_READINGS:
                s[VENT_TIME] = 0
                s[VENTED_LOW] = s[NOW_LOW]
                s[VENTED_HIGH] = s[NOW_HIGH]
                s[VENTED_MS] = s[VENT_FOR] // 1000
                s[VENTED_NEWS] = 1
            return
        s[VENTED_RUN] = 0
        left = s[VENT_TIME] - s[DT]
        if left <= 0:
            left = 0
            latch(s, VENT_FAILED)
        s[VENT_TIME] = left
    elif counts >= s[LOST_AT]:
        run = s[LOST_RUN] + 1
        if run <= VENTED_READINGS:
            s[LOST_RUN] = run
        if run == VENTED_READINGS:
            latch(s, VENT_LOST)
    else:
        s[LOST_RUN] = 0


@micropython.viper
def blink(s: ptr32):
    """Next state of the sync LED's pattern (``wire.lfsr_next``)."""
    left = s[LED_LEFT]
    if left < 0:  # bit 0 starts at this step
        s[LED_LEFT] = s[LED_BIT]
    else:
        left -= s[DT]
        state = s[LED_STATE]
        while left <= 0:
            left += s[LED_BIT]
            if state & 1:
                state = (state >> 1) ^ 0xB400
            else:
                state = state >> 1
        s[LED_LEFT] = left
        s[LED_STATE] = state
    s[LED] = s[LED_STATE] & 1


@micropython.viper
def note(s: ptr32, ring: ptr8, times: ptr16):
    """Add the sample of this step to the ring (``wire.SAMPLE``) and its time to ``times``."""
    slot = s[AT]
    times[2 * slot] = s[NOW_LOW]
    times[2 * slot + 1] = s[NOW_HIGH]
    dt = s[DT]
    if dt > DT_UNKNOWN or (s[SEQ_LOW] == 0 and s[SEQ_HIGH] == 0):
        dt = DT_UNKNOWN
    inlet = s[INLET_US]
    vent = s[VENT_US]
    flags = s[PROX] << 6
    if inlet:
        flags = flags | 1
    if vent:
        flags = flags | 2
    if s[ARMED]:
        flags = flags | 4
    if s[FAULTS]:
        flags = flags | 8
    if s[LED]:
        flags = flags | 16
    if s[BEATEN]:
        flags = flags | 32
    if inlet > TICK:
        inlet = TICK
    if vent > TICK:
        vent = TICK
    counts = s[COUNTS]
    at = slot * SAMPLE_BYTES
    ring[at] = dt & 255
    ring[at + 1] = dt >> 8
    ring[at + 2] = counts & 255
    ring[at + 3] = counts >> 8
    ring[at + 4] = flags
    ring[at + 5] = inlet // 5
    ring[at + 6] = vent // 5
    slot += 1
    if slot == RING:
        slot = 0
    s[AT] = slot
    low = s[SEQ_LOW] + 1
    if low > 65535:
        low = 0
        s[SEQ_HIGH] = (s[SEQ_HIGH] + 1) & 65535
    s[SEQ_LOW] = low
    if dt > s[DT_LONGEST] and dt < DT_UNKNOWN:
        s[DT_LONGEST] = dt
    if dt < s[DT_SHORTEST]:
        s[DT_SHORTEST] = dt
    if s[FAULTS] and s[BOX_N] == 0:  # the loop copies the samples before this one
        n = BOX
        if s[SEQ_HIGH] == 0 and low < BOX:
            n = low
        s[BOX_N] = n
        s[BOX_AT] = slot
        s[BOX_TICKS] = s[TICKS]


@micropython.viper
def begin_vent(s: ptr32):
    """Both pulses end; the fall of the pressure is watched from now on."""
    s[INLET_LEFT] = 0
    s[VENT_LEFT] = 0
    s[VENT_TIME] = s[VENT_LIMIT]
    s[VENT_FOR] = 0
    s[VENTED_RUN] = 0
    s[LOST_RUN] = 0


@micropython.viper
def begin_run(s: ptr32):
    """Start the checks of a scheme at the present reading; both valves are closed."""
    s[OLD] = -1
    s[TRACK] = s[COUNTS]
    s[SAME] = 0
    s[AWAY] = 0
    s[LEAKS] = 0
    s[FILLING] = 0
    s[FILLED] = 0
    s[IDLE] = 0
    s[QUIET] = 0
    s[WANT_INLET] = 0
    s[WANT_VENT] = 0
    s[REQUESTED] = REQUEST_INLET | REQUEST_VENT
    s[RUNNING] = 1


@micropython.viper
def decide(s: ptr32):
    """Checks, deadlines and the times of both valves, from this step's reading."""
    dt = (s[NOW] - s[LAST]) & TIME_MASK
    s[LAST] = s[NOW]
    s[DT] = dt
    s[TICKS] = (s[TICKS] + 1) & TIME_MASK
    cause = 0
    counts = s[READING]
    if counts < 0:
        silent = s[SILENT] + 1
        if silent >= SILENT_N:
            silent = SILENT_N
            cause = SENSOR_SILENT
        s[SILENT] = silent
    else:
        s[SILENT] = 0
        s[COUNTS] = counts
        over = s[OVER]
        if counts >= s[TRIP] or over:
            over = over << 1
            if counts >= s[TRIP]:
                over = over | 1
            over = over & s[TRIP_MASK]
            s[OVER] = over
            n = 0
            while over:
                n += over & 1
                over = over >> 1
            if n >= s[TRIP_N]:
                cause = OVER_PRESSURE
        if counts >= s[SAT_HIGH] or counts < s[SAT_LOW]:
            n = s[SATURATED] + 1
            if n >= s[SAT_N]:
                n = s[SAT_N]
                if cause == 0:
                    cause = SENSOR_SATURATED
            s[SATURATED] = n
        else:
            s[SATURATED] = 0
    if cause == 0 and s[ARMED]:
        left = s[HEARTBEAT_LEFT] - dt
        s[HEARTBEAT_LEFT] = left
        loop_left = s[LOOP_LEFT] - dt
        s[LOOP_LEFT] = loop_left
        if left <= 0:
            cause = HOST_SILENT
        elif dt > LATE or loop_left <= 0:
            cause = LOOP_STALLED
    if cause == 0 and s[RUNNING]:
        cause = int(check_plausible(s))
    if cause:
        latch(s, cause)
    if s[FAULTS]:
        s[ARMED] = 0
    if s[ARMED] == 0:
        s[RUNNING] = 0
    inlet = s[INLET_LEFT]
    if inlet:
        inlet -= dt
        if inlet < 0:
            inlet = 0
    vent = s[VENT_LEFT]
    if vent:
        vent -= dt
        if vent < 0:
            vent = 0
    requested = s[REQUESTED]
    if requested:
        s[REQUESTED] = 0
        if requested & REQUEST_INLET:
            inlet = s[WANT_INLET]
        if requested & REQUEST_VENT:
            vent = s[WANT_VENT]
    if s[RUNNING]:
        s[HAS_RUN] = 1
        s[INLET_LEFT] = inlet
        s[VENT_LEFT] = vent
        if s[RENEWS]:  # a later scheme must first keep the inlet closed
            s[INLET_RUN] = s[INLET_MAX]
            s[SHUT] = 0
        elif inlet or s[INLET_RUN]:
            inlet = int(bound_inlet(s, inlet, TICK))
            if inlet < 0:
                latch(s, INLET_BOUND)
    if s[RUNNING] == 0:
        inlet = 0
        vent = VENT_HOLD
        if s[INLET_RUN]:
            bound_inlet(s, 0, TICK)
        if s[HAS_RUN]:
            s[HAS_RUN] = 0
            begin_vent(s)
        else:
            watch_vent(s)
    s[INLET_US] = inlet
    s[VENT_US] = vent
    if s[CAPTURE_WAITS] and s[RUNNING] and (inlet or vent):
        s[CAPTURE_WAITS] = 0
        s[CAPTURE_LEAD] = (s[NOW] - s[CAPTURE_SINCE]) & TIME_MASK
    if s[LED_BIT]:
        blink(s)


@micropython.viper
def gather(s: ptr32, ring: ptr8, times: ptr16, out: ptr8) -> int:
    """Write the oldest samples not yet sent as a telemetry payload into ``out`` from byte 1.

    At most ``SAMPLES_MAX``. Called by the loop; an interrupt in the middle adds a sample behind
    those that are copied. Returns the length of the payload; 0 without a sample.
    """
    while True:
        ticks = s[TICKS]
        low = s[SEQ_LOW]
        high = s[SEQ_HIGH]
        at = s[AT]
        if ticks == s[TICKS]:
            break
    held = (ticks - s[SENT]) & TIME_MASK
    if held == 0:
        return 0
    if held > RING:  # overwritten: the host sees a gap in the numbers
        held = RING
    n = held
    if n > SAMPLES_MAX:
        n = SAMPLES_MAX
    s[SENT] = (ticks - held + n) & TIME_MASK
    low -= held
    if low < 0:
        low += 65536
        high = (high - 1) & 65535
    at -= held
    if at < 0:
        at += RING
    out[1] = 0x54
    out[2] = s[BOOT_ID] & 255
    out[3] = s[BOOT_ID] >> 8
    out[4] = s[SETPOINT] & 255
    out[5] = s[SETPOINT] >> 8
    out[6] = low & 255
    out[7] = low >> 8
    out[8] = high & 255
    out[9] = high >> 8
    out[10] = times[2 * at] & 255
    out[11] = times[2 * at] >> 8
    out[12] = times[2 * at + 1] & 255
    out[13] = times[2 * at + 1] >> 8
    out[14] = n
    first = at + n - RING
    if first > 0:  # over the border of the ring
        n -= first
    copy(out, 15, ring, at * SAMPLE_BYTES, n * SAMPLE_BYTES)
    to = 15 + n * SAMPLE_BYTES
    if first > 0:
        copy(out, to, ring, 0, first * SAMPLE_BYTES)
        to += first * SAMPLE_BYTES
    return to - 1


class Core:
    """The state, its sample memory, and one step for boards that are written in Python."""

    def __init__(self) -> None:
        self.state = words(WORDS)
        self.timing()
        self.ring = bytearray(RING * SAMPLE_BYTES)
        self.times = array("H", [0] * (2 * RING))

    def timing(self) -> "tuple[int, int, int, int, int]":
        """Timing since the last call.

        Returns:
            longest step, shortest and longest time between two steps, us; most steps between two
            passes of the loop; steps without one.
        """
        s = self.state
        read = s[STEP_WORST], s[DT_SHORTEST], s[DT_LONGEST], s[LOOP_WORST], s[MISSED]
        s[STEP_WORST] = s[DT_LONGEST] = s[MISSED] = 0
        s[LOOP_WORST] = 1
        s[DT_SHORTEST] = TIME_MASK
        return read
