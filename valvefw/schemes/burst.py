"""Model-based bursts: the scheme that knows the valve's delays and its smallest opening.

Reading: both valves shut, the mean of a window of samples. Then one of three.

- *Fill* or *vent*: the valve is opened and, every tick, the pressure is predicted that would
  remain if its command ended now, the valve falling shut one off-delay later. When that reaches
  the set-point within the coming tick, the command ends at the very 5 us. The prediction starts
  from the reading, so a wrong model is worth only its error over the off-delay.
- *Pair*, where even the shortest opening of one valve goes too far: both valves open, overlapped,
  each for at least its shortest opening, and the longer one is as much longer as the error asks.
  Found by bisection over the model, one trial a tick; the shorter opening lies in the middle of the
  longer, so that the excursion is shared between both sides.

Within the dead zone nothing moves, and once there it is half as wide again, so that noise at its
edge does not ask for a cure that is worse. Each pair that did not end there widens it by a quarter:
a model that is wrong by more than the zone must not become a limit cycle.
"""

from valvefw.schemes.gas import Gas
from valvefw.schemes.scheme import HOLD_US, Scheme
from valvefw.schemes.valves import VENT_HOLD_US, Valves

READ = 0
FILL = 1
VENT = 2
PLAN = 3
PAIR = 4

LONGER_US = 80000  # a pair's inlet or outlet may be open longer than the shortest by so much
ROUGH_TRIALS = 8
FINE_TRIALS = 14
MAX_WIDER = 8


class Burst(Scheme):
    """Parameters ``valve_*`` (delays), ``gas_*`` (model) and ``burst_*``."""

    name = "burst"

    def __init__(self) -> None:
        self._gas = Gas()
        self._atm = 0
        self._on_in = 0
        self._off_in = 0
        self._on_out = 0
        self._on_out_slope = 0
        self._off_out = 0
        self._off_out_slope = 0
        self._margin = 0
        self._settle = 0
        self._window = 1
        self._rest = 0
        self._longest = 0
        self._dead_x16 = 0
        self._phase = READ
        self._wait = 0
        self._sum = 0
        self._n = 0
        self._p = 0
        self._target = 0
        self._setpoint_x16 = 0
        self._wider = 0
        self._quiet = False
        self._since = 0
        self._delay = 0
        self._trial = 0
        self._low = 0
        self._high = 0
        self._shift = 0
        self._fill_at = 0
        self._vent_at = 0
        self._fill_width = 0
        self._vent_width = 0
        self._pair_us = 0

    def start(self, values: dict[str, int]) -> None:
        """Copy parameters and begin with a reading."""
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
        self._longest = values["inlet_max_ms"] * 1000 - 3 * HOLD_US
        self._dead_x16 = values["burst_dead_x16"]
        self._setpoint_x16 = -1
        self._wider = 0
        self._read_after(self._off_out)

    def _read_after(self, shut_us: int) -> None:
        """Read once both valves have shut, which the last does in ``shut_us``."""
        self._phase = READ
        wait = shut_us + self._settle
        self._wait = wait if wait > self._rest else self._rest
        self._sum = 0
        self._n = 0

    def _out_on_us(self, p: int) -> int:
        return self._on_out + ((p >> 8) - self._atm) * self._on_out_slope // 4095

    def _out_off_us(self, p: int) -> int:
        return self._off_out + ((p >> 8) - self._atm) * self._off_out_slope // 4095

    def step(self, counts: int, setpoint_x16: int, dt_us: int, valves: Valves) -> None:
        """One sample."""
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
        self._sum = 0
        self._n = 0
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
        if since < 0:  # the command begins with this tick
            self._since = 0
            valves.inlet_us = self._on_in + self._margin
            return
        since += dt_us
        self._since = since
        gas = self._gas
        p = self._p
        open_us = since - self._on_in
        if open_us > 0:
            p = gas.after_fill(p, open_us if open_us < dt_us else dt_us)
            p += (((counts + self._atm) << 8) - p) >> 1
            self._p = p
        left = self._on_in + self._margin - since
        if left >= dt_us:
            return  # the shortest pulse still runs on its own
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
        open_us = since - self._delay
        if open_us > 0:
            p = gas.after_vent(p, open_us if open_us < dt_us else dt_us)
            p += (((counts + self._atm) << 8) - p) >> 1
            self._p = p
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
        """One trial of the bisection: how much longer the vent (above 0) or the fill is open."""
        p = self._p
        longer = (self._low + self._high) >> 1
        fill_us = self._off_in + self._margin
        vent_us = self._out_off_us(self._target) + self._margin
        if longer > 0:
            vent_us += longer
        else:
            fill_us -= longer
        shift = self._shift  # from the opening of the outlet to that of the inlet
        end = self._gas.after_both(p, shift, shift + fill_us, 0, vent_us)
        if end > self._target:
            self._low = longer
        else:
            self._high = longer
        self._trial += 1
        if self._trial == ROUGH_TRIALS:
            # Commands begin on ticks: the shift is what whole ticks and the delays make of it.
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
