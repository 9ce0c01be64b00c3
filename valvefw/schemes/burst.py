"""Model-based bursts: uses the valve's delays and its shortest opening.

After a reading (both valves closed, mean of a window of samples) the scheme selects one action:

- *Fill* or *vent*: open one valve. Every tick, predict the pressure after the closing delay if
  the command ended at the next step, where a request takes effect. When the prediction reaches
  the set-point within the tick after it, end the command with a resolution of 5 us. The
  prediction starts from the reading, so a model error matters only during the closing delay.
- *Pair*, if even the shortest opening of one valve overshoots: open both valves, overlapped, each
  for at least its shortest opening. The error determines the additional opening of one of them.
  Bisection over the model finds it, one trial per tick. The shorter opening lies in the middle of
  the longer one, so that the excursion is equal on both sides.

Within the dead zone nothing moves; once inside, the zone is wider by half, so that noise at its
border causes no action. Each pair that ends outside widens the zone by a quarter: a model error
larger than the zone must not cause a limit cycle.
"""

from valvefw.schemes.gas import Gas
from valvefw.schemes.scheme import HOLD_US, Scheme
from valvefw.schemes.valves import VENT_HOLD_US, Valves
from valvefw.wire import TICK_US

READ = 0
FILL = 1
VENT = 2
PLAN = 3
PAIR = 4

LAST_US = 6000  # time in which a long fill is ended
LONGER_US = 80000  # limit of the additional opening in a pair
ROUGH_TRIALS = 8
FINE_TRIALS = 14
MAX_WIDER = 8


class Burst(Scheme):
    """Parameters ``valve_*`` (delays), ``gas_*`` (model) and ``burst_*``."""

    name = "burst"

    def __init__(self) -> None:
        self._gas = Gas()
        super().__init__()

    def start(self, values: dict[str, int]) -> None:
        self._p = self._target = self._since = self._delay = 0
        self._trial = self._low = self._high = self._shift = 0
        self._fill_at = self._vent_at = self._fill_width = self._vent_width = self._pair_us = 0
        self._quiet = False
        self._gas.load(values)
        self._atm = values["gas_atm"]
        self._on_in = values["valve_on_in_us"]
        self._off_in = values["valve_off_in_us"]
        self._on_out = values["valve_on_out_us"]
        self._on_out_slope = values["valve_on_out_top_us"] - self._on_out
        self._off_out = values["valve_off_out_us"]
        self._off_out_slope = values["valve_off_out_top_us"] - self._off_out
        self._margin = values["burst_margin_us"]
        self._settle = values["burst_settle_us"]
        self._window = values["burst_window"]
        self._rest = values["inlet_rest_ms"] * 1000
        self._longest = values["inlet_max_ms"] * 1000 - LAST_US
        self._dead_x16 = values["burst_dead_x16"]
        self._setpoint_x16 = -1
        self._wider = 0
        self._read_after(self._off_out)

    def _read_after(self, shut_us: int) -> None:
        """Read once both valves have closed, the last one ``shut_us`` after the next step."""
        self._phase = READ
        wait = TICK_US + shut_us + self._settle
        self._wait = wait if wait > self._rest else self._rest
        self._sum = self._n = 0

    def _out_on_us(self, p: int) -> int:
        return self._on_out + ((p >> 8) - self._atm) * self._on_out_slope // 4095

    def _out_off_us(self, p: int) -> int:
        return self._off_out + ((p >> 8) - self._atm) * self._off_out_slope // 4095

    def step(self, counts: int, setpoint_x16: int, dt_us: int, valves: Valves) -> None:
        if setpoint_x16 != self._setpoint_x16:
            if self._setpoint_x16 == 0:  # the outlet has been open
                valves.vent_us = 0
                self._read_after(self._off_out)
            self._setpoint_x16 = setpoint_x16
            self._target = (setpoint_x16 << 4) + (self._atm << 8)
            self._wider = 0
            self._quiet = False
        if setpoint_x16 == 0:
            valves.inlet_us = 0
            valves.vent_us = VENT_HOLD_US
            return
        phase = self._phase
        if phase == READ:
            self._read(counts, dt_us)
        if self._phase == FILL:
            self._fill(counts, dt_us, valves)
        elif phase == VENT or self._phase == VENT:
            self._vent(counts, dt_us, valves)
        elif phase == PLAN:
            self._plan()
        elif phase == PAIR:
            self._pair(dt_us, valves)

    def _read(self, counts: int, dt_us: int) -> None:
        if self._wait > 0:
            self._wait -= dt_us
            if self._wait > 0:
                return
        self._sum += counts
        self._n += 1
        if self._n < self._window:
            return
        p = (self._sum << 8) // self._n + (self._atm << 8)
        self._sum = self._n = 0
        self._p = p
        error = self._target - p
        dead = self._dead_x16 << 4
        dead += dead * self._wider >> 2
        if self._quiet:
            dead += dead >> 1
        self._quiet = -dead <= error <= dead
        if self._quiet:
            return
        self._since = -1
        if error > 0:
            if self._gas.after_fill(p, self._off_in + self._margin) <= self._target + dead:
                self._phase = FILL
                self._delay = self._on_in
                return
        elif self._gas.after_vent(p, self._out_off_us(p) + self._margin) >= self._target - dead:
            self._phase = VENT
            self._delay = self._out_on_us(p)
            return
        self._phase = PLAN
        self._trial = 0
        self._low = -LONGER_US
        self._high = LONGER_US
        self._shift = 0

    def _fill(self, counts: int, dt_us: int, valves: Valves) -> None:
        since = self._since
        if since < 0:  # the command starts at this tick
            self._since = 0
            valves.inlet_us = self._on_in + self._margin
            return
        since += dt_us
        self._since = since
        gas = self._gas
        p = self._p
        open_us = since - self._on_in  # at the next step, where a request takes effect
        if open_us > TICK_US:
            before_us = open_us - TICK_US
            p = gas.after_fill(p, before_us if before_us < dt_us else dt_us)
            p += (((counts + self._atm) << 8) - p) >> 1
            self._p = p
        if open_us > 0:
            p = gas.after_fill(p, open_us if open_us < TICK_US else TICK_US)
        left = self._on_in + self._margin - since
        if left >= dt_us:
            return  # the shortest pulse is still running
        end = gas.after_fill(p, self._off_in)
        lacking = self._target - end
        per_ms = gas.inflow(end)
        more = lacking * 1000 // per_ms if 0 < lacking < per_ms else 0
        if lacking >= per_ms and since < self._longest:
            valves.inlet_us = HOLD_US
            return
        if more < left:
            more = left
        more -= more % 5
        valves.inlet_us = more if more > 0 else 0
        self._read_after(more + self._off_in)

    def _vent(self, counts: int, dt_us: int, valves: Valves) -> None:
        since = self._since
        if since < 0:
            self._since = 0
            valves.vent_us = self._delay + self._margin
            return
        since += dt_us
        self._since = since
        gas = self._gas
        p = self._p
        open_us = since - self._delay  # at the next step, where a request takes effect
        if open_us > TICK_US:
            before_us = open_us - TICK_US
            p = gas.after_vent(p, before_us if before_us < dt_us else dt_us)
            p += (((counts + self._atm) << 8) - p) >> 1
            self._p = p
        if open_us > 0:
            p = gas.after_vent(p, open_us if open_us < TICK_US else TICK_US)
        left = self._delay + self._margin - since
        if left >= dt_us:
            return
        off_us = self._out_off_us(p)
        end = gas.after_vent(p, off_us)
        excess = end - self._target
        per_ms = gas.outflow(end)
        if excess >= per_ms and per_ms > 0:
            valves.vent_us = HOLD_US
            return
        more = excess * 1000 // per_ms if excess > 0 and per_ms > 0 else 0
        if more < left:
            more = left
        more -= more % 5
        valves.vent_us = more if more > 0 else 0
        self._read_after(more + off_us)

    def _plan(self) -> None:
        """One bisection trial: additional opening of the outlet (positive) or inlet (negative)."""
        p = self._p
        longer = (self._low + self._high) >> 1
        fill_us = self._off_in + self._margin
        vent_us = self._out_off_us(self._target) + self._margin
        if longer > 0:
            vent_us += longer
        else:
            fill_us -= longer
        shift = self._shift  # delay of the inlet after the outlet
        end = self._gas.after_both(p, shift, shift + fill_us, 0, vent_us)
        if end > self._target:
            self._low = longer
        else:
            self._high = longer
        self._trial += 1
        if self._trial == ROUGH_TRIALS:
            # Commands start on ticks: the shift results from whole ticks and the delays.
            lead = self._on_in - self._out_on_us(p)
            ticks = (((vent_us - fill_us) >> 1) - lead + 500) // 1000
            self._shift = ticks * 1000 + lead
            self._fill_at = ticks * 1000 if ticks > 0 else 0
            self._vent_at = -ticks * 1000 if ticks < 0 else 0
            self._low = -LONGER_US
            self._high = LONGER_US
        elif self._trial == FINE_TRIALS + ROUGH_TRIALS:
            on_out_us = self._out_on_us(p)
            width = fill_us + self._on_in - self._off_in
            self._fill_width = width - width % 5
            width = vent_us + on_out_us - self._out_off_us(self._target)
            self._vent_width = width - width % 5
            shut = self._fill_at + self._on_in + fill_us
            self._pair_us = self._vent_at + on_out_us + vent_us
            if shut > self._pair_us:
                self._pair_us = shut
            if self._wider < MAX_WIDER:
                self._wider += 1
            self._since = 0
            self._phase = PAIR

    def _pair(self, dt_us: int, valves: Valves) -> None:
        since = self._since
        if self._fill_width and since >= self._fill_at:
            valves.inlet_us = self._fill_width
            self._fill_width = 0
        if self._vent_width and since >= self._vent_at:
            valves.vent_us = self._vent_width
            self._vent_width = 0
        self._since = since + dt_us
        if since >= self._pair_us:
            self._read_after(0)
