"""Integer parameters with bounds, and one CRC over all of them, which arming must state.

Pressures are raw ADC counts (``_x16``: sixteenths of a count), so that no calibration or tare
can change a limit. Values change only while disarmed; arming copies them.
"""

from valvefw.wire import crc16

# key, default, lowest, highest, meaning. The CRC and `conf <index>` use this order.
PARAMETERS = (
    ("trip", 2703, 1, 4095, "over-pressure limit, counts"),
    ("trip_n", 3, 1, 10, "number of samples at or above trip ..."),
    ("trip_m", 5, 1, 10, "... among this number of last samples"),
    ("sat_high", 4095, 1, 4096, "readings at or above are invalid; 4096 = off"),
    ("sat_low", 0, 0, 4095, "readings below are invalid; 0 = off"),
    ("sat_n", 5, 1, 10, "consecutive invalid readings that trip"),
    ("stuck_ms", 200, 0, 10000, "constant reading for this time: sensor_stuck; 0 = off"),
    ("slew", 60, 1, 4095, "fastest change of the pressure, counts per ms"),
    ("jump", 40, 1, 4095, "deviation beyond slew that is a jump, counts"),
    ("rise_ms", 60, 0, 2000, "inlet open this long without a rise: sensor_no_rise; 0 = off"),
    ("rise_counts", 20, 1, 4095, "lowest reading that counts as a rise"),
    ("leak_counts", 24, 0, 4095, "change in 50 ms with both valves closed: stuck valve; 0 = off"),
    ("hb_ms", 300, 50, 1000, "heartbeat deadline"),
    ("inlet_max_ms", 1000, 1, 2000, "longest inlet opening, including renewals"),
    ("inlet_rest_ms", 10, 1, 100, "inlet closed at least this long between openings"),
    ("clear_below", 82, 1, 4095, "faults can be cleared below, counts"),
    ("vent_below", 82, 1, 4095, "vented when below, counts"),
    ("vent_ms", 2000, 50, 10000, "longest time to vent, else vent_failed"),
    ("sp_max", 2540, 0, 4095, "highest set-point, counts"),
    ("pwm_period_ms", 20, 2, 1000, "shortest time from pulse to pulse"),
    ("pwm_gain_in", 137, 1, 16383, "inlet us per count of error"),
    ("pwm_gain_out", 1120, 1, 16383, "outlet us per count of error, at 0 gauge if pwm_atm"),
    ("pwm_atm", 415, 0, 4095, "atmosphere, counts: outlet gain falls as absolute; 0 = constant"),
    ("pwm_dead_x16", 36, 0, 65535, "dead zone each side"),
    ("pwm_min_in_us", 2050, 0, 100000, "shortest inlet pulse that opens"),
    ("pwm_min_out_us", 2050, 0, 100000, "shortest outlet pulse that opens"),
    ("pwm_lag_in_us", 500, 0, 100000, "inlet: opening delay minus closing delay"),
    ("pwm_lag_out_us", 500, 0, 100000, "outlet: opening delay minus closing delay"),
    ("pwm_max_in_us", 60000, 5, 500000, "longest inlet pulse"),
    ("pwm_max_out_us", 100000, 5, 500000, "longest outlet pulse"),
    ("pwm_settle_us", 4000, 0, 100000, "wait after a pulse before reading"),
    ("pwm_window", 16, 1, 64, "samples averaged for a reading"),
    ("two_dead", 5, 0, 1023, "two: half the differential gap, 10-bit counts"),
    ("duty_dead", 2, 0, 1023, "duty, duty_in: dead zone, 10-bit counts"),
    ("duty_gain", 100, 0, 1000, "units of pulse at duty_full"),
    ("duty_full", 700, 1, 1023, "error from which the pulse is the whole period"),
    ("duty_period", 101, 1, 1000, "units of one pass"),
    ("duty_unit_us", 1000, 5, 1000, "length of a unit, multiple of 5"),
    ("slide_dead", 5, 0, 1023, "slide: dead zone, 10-bit counts"),
    ("slide_bound", 50, 1, 1023, "fastest approach, 10-bit counts per 100 ms"),
    ("slide_ms", 5, 1, 200, "time of one pass"),
    ("ram_dead", 5, 0, 1023, "ram: dead zone, 10-bit counts"),
    ("valve_on_in_us", 2000, 0, 30000, "inlet: opening delay"),
    ("valve_off_in_us", 1500, 0, 30000, "inlet: closing delay"),
    ("valve_on_out_us", 2000, 0, 30000, "outlet: opening delay at 0 counts"),
    ("valve_on_out_top_us", 2000, 0, 30000, "outlet: opening delay at 4095 counts"),
    ("valve_off_out_us", 1500, 0, 30000, "outlet: closing delay at 0 counts"),
    ("valve_off_out_top_us", 1500, 0, 30000, "outlet: closing delay at 4095 counts"),
    ("gas_supply", 2867, 1, 4095, "supply, gauge counts"),
    ("gas_atm", 415, 1, 4095, "atmosphere, counts"),
    ("gas_rate_in", 1727, 1, 50000, "inlet: share of supply per ms when choked, millionths"),
    ("gas_rate_out", 1727, 1, 50000, "outlet: share of the pressure per ms, millionths"),
    ("burst_margin_us", 150, 0, 5000, "shortest pulse minus opening delay"),
    ("burst_dead_x16", 64, 1, 65535, "burst: dead zone each side"),
    ("burst_settle_us", 3000, 0, 100000, "from closing to reading"),
    ("burst_window", 16, 1, 64, "samples averaged for a reading"),
    ("out_scale", 4096, 1, 16383, "reg: output counts per 4096 counts of set-point"),
    ("out_zero_x16", 65536, 0, 131072, "reg: output at set-point 0, count/16, plus 65536"),
    ("bridge", 0, 0, 8, "0 none; HX711: 1 gain 128, 2 gain 64, 3 input B; 4 ADS1232; +4: 80/s"),
    ("adc16", 0, 0, 48, "ADS1115: 0 none, else 1 + its multiplexer + 8 * its range"),
    ("adc16_ms", 20, 8, 1000, "ADS1115: time between two conversions, ms"),
    ("encoder_ms", 0, 0, 1000, "quadrature encoder: time between two readings, ms; 0 none"),
    ("second_ms", 0, 0, 1000, "second analogue input: time between two readings, ms; 0 none"),
    ("third_ms", 0, 0, 1000, "third analogue input: time between two readings, ms; 0 none"),
)


def config_crc(values: dict[str, int]) -> int:
    """CRC-16 over the ``key=value`` lines in table order; the host calculates the same."""
    text = ""
    for row in PARAMETERS:
        text += "%s=%d\n" % (row[0], values[row[0]])
    return crc16(text.encode())


def _times(a: int, b: int) -> int:
    """Product of two 16-bit polynomials, modulo the CRC's polynomial."""
    out = 0
    while b:
        if b & 1:
            out ^= a
        a <<= 1
        if a & 0x10000:
            a ^= 0x11021
        b >>= 1
    return out


class Checksum:
    """Incremental ``config_crc`` for values that change one at a time.

    On the RP2040 the CRC of the whole text takes 20 ms or more, longer than a tick may take. A
    CRC is linear: that of two pieces is ``crc(first) * x^(8 * len(second)) + crc(second)``. A
    binary tree therefore keeps the CRC (initial value 0) and the power of x of every line,
    every two lines, every four lines and so on. After a change only one line and the nodes
    above it are calculated again.
    """

    def __init__(self) -> None:
        leaves = 1
        while leaves < len(PARAMETERS):
            leaves *= 2
        self._leaves = leaves
        self._known: dict[str, int] = {}
        self._crc = [0] * (2 * leaves)  # node 1 is the root, 2k and 2k + 1 are the children of k
        self._power = [1] * (2 * leaves)
        self._whole = 0

    def of(self, values: dict[str, int]) -> int:
        """The CRC of these values; fast if none has changed since the last call."""
        known = self._known
        if values == known:
            return self._whole
        nodes: list[int] = []
        node = self._leaves
        for row in PARAMETERS:
            key = row[0]
            value = values[key]
            if value != known.get(key):
                known[key] = value
                line = ("%s=%d\n" % (key, value)).encode()
                self._crc[node] = crc16(line, 0)
                self._power[node] = crc16(bytes(len(line)), 1)
                _append_new(nodes, node >> 1)
            node += 1
        if nodes:
            self._join(nodes)
        return self._whole

    def _join(self, nodes: list[int]) -> None:
        """Calculate these nodes of one level, in ascending order, and all nodes above them."""
        crc = self._crc
        power = self._power
        while nodes[0]:
            above: list[int] = []
            for node in nodes:
                right = 2 * node + 1
                crc[node] = _times(crc[right - 1], power[right]) ^ crc[right]
                power[node] = _times(power[right - 1], power[right])
                _append_new(above, node >> 1)
            nodes = above
        self._whole = _times(0xFFFF, power[1]) ^ crc[1]


def _append_new(nodes: list[int], node: int) -> None:
    if not nodes or nodes[-1] != node:
        nodes.append(node)


def defaults() -> dict[str, int]:
    """The default values."""
    values = {}
    for row in PARAMETERS:
        values[row[0]] = row[1]
    return values


def bounds(key: str) -> tuple[int, int] | None:
    """Lowest and highest value of ``key``, or None if the key is unknown."""
    for row in PARAMETERS:
        if row[0] == key:
            return row[2], row[3]
    return None


def problem(values: dict[str, int]) -> str:
    """The first conflict between these values, or an empty text."""
    for low, high in (
        ("trip_n", "trip_m"),
        ("sp_max", "trip"),
        ("sat_low", "trip"),
        ("vent_below", "trip"),
        ("clear_below", "trip"),
        ("trip", "sat_high"),
    ):
        if values[low] > values[high]:
            return "%s %d is above %s %d" % (low, values[low], high, values[high])
    for side in ("in", "out"):
        low = "pwm_min_%s_us" % side
        high = "pwm_max_%s_us" % side
        if values[low] > values[high]:
            return "%s %d is above %s %d" % (low, values[low], high, values[high])
    if values["pwm_max_in_us"] > values["inlet_max_ms"] * 1000:
        return "pwm_max_in_us %d is above inlet_max_ms" % values["pwm_max_in_us"]
    if values["duty_unit_us"] % 5:
        return "duty_unit_us %d is no multiple of 5" % values["duty_unit_us"]
    # Between two pulses the inlet must count as closed, else the pulses add up to a fault.
    if values["pwm_settle_us"] + values["pwm_window"] * 1000 < values["inlet_rest_ms"] * 1000:
        return "pwm_settle_us + pwm_window is below inlet_rest_ms"
    return ""
