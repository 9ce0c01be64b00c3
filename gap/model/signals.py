"""The measured signals of one trial at any instant: pressure, length, their slopes, valve edges."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline
from scipy.stats import chi2

from gap.data.motion import frame_noise, is_white, moves
from gap.data.trial import Channel, Trial
from gap.model.clipping import at_lower_end
from plant.arrays import Array
from plant.constants import STANDARD_GRAVITY_M_S2, PlantConstants

Mask = npt.NDArray[np.bool_]

_NEAR_STOP_M = 0.8e-3
_AFTER_STOP_S = 0.08
_RISE_KPA = 25.0
_FRAME_NOISE_M = 0.015e-3
_MOST_FRAME_NOISE_M = 0.1e-3
_MOST_WHITE_NOISE_M = 0.5e-3
# Noise of an acceleration as `_length_of` has it, over that of a second difference alone.
_OF_BEND = 1.7
# Three sd of what white noise of one sd makes of a second difference's second difference.
_NOISE_OF_BEND = 9.0
# Stops stand where they should to half a millimetre (docs/reference/plant.md): three sd of that.
_STOP_ZONE_M = 1.5e-3
_REST_M = 0.35e-3
_PROPPED_N = 2.0
_LONG_REST = 0.15


def edges_of(trial: Trial) -> tuple[Array, Array, npt.NDArray[np.int64]]:
    """Command edges: times, value after each (0 to 1), and which valve (0 inlet, 1 outlet).

    A command that is on at the first row counts as an edge there. Of a proportional valve's command
    that runs, stretches within 0.2 % of the whole opening are one edge with their mean.
    """
    times: list[Array] = []
    values: list[Array] = []
    which: list[npt.NDArray[np.int64]] = []
    for number, name in enumerate(("inlet_cmd", "outlet_cmd")):
        channel = trial.get(name)
        if trial.settled or not len(channel):
            continue
        value = channel.value
        if np.any((value > 0.0) & (value < 1.0)):
            value = _in_steps(channel.time_s, value)
        changed = np.r_[value[0] != 0.0, np.diff(value) != 0.0]
        times.append(channel.time_s[changed])
        values.append(value[changed])
        which.append(np.full(int(changed.sum()), number))
    if not times:
        return np.empty(0), np.empty(0), np.empty(0, dtype=np.int64)
    time_s = np.concatenate(times)
    order = np.argsort(time_s, kind="stable")
    return time_s[order], np.concatenate(values)[order], np.concatenate(which)[order]


_COMMAND_STEP = 0.002
"""Range of a running command, as a share of the whole, that counts as one opening."""


def _in_steps(time_s: Array, value: Array) -> Array:
    """A command with each stretch that stays within `_COMMAND_STEP` at its mean over the time."""
    made = value.copy()
    width = np.r_[np.diff(time_s), 0.0]
    course = value.tolist()
    starts, low, high = [0], course[0], course[0]
    for k, told in enumerate(course[1:], start=1):
        lower, higher = min(low, told), max(high, told)
        # Shut and wholly open are kept as they are.
        inside = (lower > 0.0) == (higher > 0.0) and (lower < 1.0) == (higher < 1.0)
        if inside and higher - lower <= _COMMAND_STEP:
            low, high = lower, higher
        else:
            starts.append(k)
            low = high = told
    for begin, end in pairwise([*starts, len(course)]):
        own = slice(begin, end)
        total = float(width[own].sum())
        if total > 0.0 and np.ptp(value[own]) > 0.0:
            made[own] = float(value[own] @ width[own]) / total
    return made


def smooth_slope(channel: Channel, half_s: float) -> Array:
    """|slope| in units per second over +/- half_s at each sample."""
    t = channel.time_s
    if len(t) < 3:
        return np.zeros(len(t))
    span = max(half_s, 2.0 * float(np.median(np.diff(t))))
    return np.abs(np.interp(t + span, t, channel.value) - np.interp(t - span, t, channel.value)) / (
        2.0 * span
    )


@dataclass(frozen=True)
class Signal:
    """One trial's inputs as functions of time; SI.

    Attributes:
        held: the length is held, and the one written down is used.
        loaded: a known mass hangs on the muscle and moves.
        regulated: the pressure comes from elsewhere than the valves whose commands are known.
    """

    trial: Trial
    held: bool
    loaded: bool
    regulated: bool
    has_length: bool
    _time: Array
    _length: Array
    _rate: Array
    _rate_sd: Array
    _acceleration: Array
    _stops: tuple[float, float]
    _doubt: tuple[Array, Array]
    _give: float

    @classmethod
    def of(cls, trial: Trial, constants: PlantConstants) -> Signal:
        """Decide what is held, loaded and regulated, and prepare the length."""
        camera = trial.get("length_mm")
        seen_to_move = moves(camera.value)
        known = np.isfinite(trial.held_length_mm)
        held = bool(known and not seen_to_move)
        loaded = bool(np.isfinite(trial.load_kg) and trial.load_kg > 0.0 and not held)
        time_s, length, rate, acceleration = _length_of(trial, camera, held)
        rate_sd = np.zeros(len(rate))
        if np.any(rate):
            rate, rate_sd = _adaptive_slope(time_s, length, rate)
        stops = (constants.length_min_m + _NEAR_STOP_M, constants.length_max_m - _NEAR_STOP_M)
        return cls(
            trial, held, loaded, _regulated(trial), held or len(camera) > 0,
            time_s, length, rate, rate_sd, acceleration, stops,
            _doubts(time_s, acceleration, max(_FRAME_NOISE_M, _frame_noise(length))),
            _give_of_stops(trial, constants),
        )  # fmt: skip

    @cached_property
    def clipped(self) -> Mask:
        """Which readings of the pressure are at the lower end of what the gauge can show."""
        return at_lower_end(self.trial.get("pressure_kpa").value)

    def clipped_at(self, time_s: Array) -> Array:
        """Share of the readings at and about each instant that are clipped."""
        if not self.clipped.any():
            return np.zeros(len(time_s))
        at = self.trial["pressure_kpa"].time_s
        return np.interp(time_s, at, self.clipped.astype(np.float64))

    def covered(self, time_s: Array) -> Mask:
        """Where pressure and length are known: inside their records and not in a long gap."""
        if self.trial.settled:
            return self._here("pressure_kpa", time_s) & (
                np.ones(len(time_s), dtype=bool) if self.held else self._here("length_mm", time_s)
            )
        good = np.ones(len(time_s), dtype=bool)
        for name in ("pressure_kpa",) if self.held else ("pressure_kpa", "length_mm"):
            channel = self.trial.get(name)
            if not len(channel):
                continue
            t = channel.time_s
            reach = 3.0 * float(np.median(np.diff(t))) if len(t) > 1 else 1.0
            after = np.clip(np.searchsorted(t, time_s), 1, max(len(t) - 1, 1))
            before = t[after - 1]
            behind = t[np.minimum(after, len(t) - 1)]
            good &= (time_s >= t[0] - 1e-9) & (time_s <= t[-1] + 1e-9)
            good &= (behind - before <= reach) | (np.abs(time_s - before) < 1e-6)
        return good

    def _here(self, name: str, time_s: Array) -> Mask:
        channel = self.trial.get(name)
        if not len(channel):
            return np.ones(len(time_s), dtype=bool)
        return np.isin(time_s, channel.time_s)

    def pressure_at(self, time_s: Array) -> Array:
        """Read gauge pressure in Pa; NaN without the channel."""
        channel = self.trial.get("pressure_kpa")
        if not len(channel):
            return np.full(len(time_s), np.nan)
        return np.interp(time_s, channel.time_s, channel.value) * 1e3

    def path_at(self, time_s: Array) -> Array:
        """Pressure in Pa, eased over +/- 4 ms: noise is less, edges keep their place."""
        channel = self.trial.get("pressure_kpa")
        if self.trial.settled or len(channel) < 3:
            return self.pressure_at(time_s)
        taps = np.linspace(-0.004, 0.004, 9)
        total = np.zeros(len(time_s))
        for tap in taps:
            total += np.interp(time_s + tap, channel.time_s, channel.value)
        return total / len(taps) * 1e3

    def pressure_slope_at(self, time_s: Array) -> Array:
        """Slope of the reading in Pa/s over +/- 4 ms, or a sample where that is longer."""
        channel = self.trial.get("pressure_kpa")
        if self.trial.settled or len(channel) < 3:
            return np.zeros(len(time_s))
        t = channel.time_s
        spacing = float(np.median(np.diff(t)))
        half = max(0.004, spacing)
        taps = np.linspace(-0.4, 0.4, 5) * half if spacing < 0.2 * half else np.zeros(1)
        total = np.zeros(len(time_s))
        for tap in taps:
            total += np.interp(time_s + half + tap, t, channel.value)
            total -= np.interp(time_s - half + tap, t, channel.value)
        return total / len(taps) / (2.0 * half) * 1e3

    def length_at(self, time_s: Array) -> Array:
        """Length in m: the one written down where it is held, else the one read."""
        if self.held:
            return np.full(len(time_s), self.trial.held_length_mm * 1e-3)
        if len(self._time) < 3 or self.trial.settled:
            if not len(self._time):
                return np.full(len(time_s), np.nan)
            return np.interp(time_s, self._time, self._length)
        inside = np.clip(time_s, self._time[0], self._time[-1])
        return np.asarray(CubicSpline(self._time, self._length)(inside))

    def rate_at(self, time_s: Array) -> Array:
        """Speed of lengthening in m/s."""
        return self._interpolated(time_s, self._rate)

    def rate_sd_at(self, time_s: Array) -> Array:
        """One sd in m/s of what the camera's noise makes of that speed."""
        return self._interpolated(time_s, self._rate_sd)

    def acceleration_at(self, time_s: Array) -> Array:
        """Second derivative of the length in m/s2."""
        return self._interpolated(time_s, self._acceleration)

    def length_doubt_at(self, time_s: Array) -> Array:
        """How far, in m, the length may be off between frames of a quickly moving muscle.

        Beyond the first and the last frame the length stays what it was there, and is off by what
        the muscle may have moved since.
        """
        made = self._interpolated(time_s, self._doubt[0])
        if self.held or len(self._time) < 5 or self.trial.settled:
            return made
        for end, beyond in (
            (slice(None, _END_FRAMES), self._time[0] - time_s),
            (slice(-_END_FRAMES, None), time_s - self._time[-1]),
        ):
            since = np.maximum(beyond, 0.0)
            speed = float(np.abs(self._rate[end]).max())
            made = made + speed * since
            made = made + 0.5 * float(np.abs(self._acceleration[end]).max()) * since**2
        return made

    def acceleration_doubt_at(self, time_s: Array) -> Array:
        """How far, in m/s2, the acceleration may be off where it changes between frames."""
        return self._interpolated(time_s, self._doubt[1])

    def swing_at(self, time_s: Array) -> Array:
        """How far, in m, the length departs from a straight course over a few frames around.

        Beyond what the camera's own noise makes.
        """
        noise = min(_frame_noise(self._length), _MOST_NOISE_OF_SWING_M)
        swing = np.maximum(_swing(self._time, self._length) - _SWING_OF_NOISE_SD * noise, 0.0)
        return self._interpolated(time_s, swing)

    @property
    def bend_noise_m_s2(self) -> float:
        """One sd in m/s2 of what a camera's noise of a frame adds to its neighbours' acceleration.

        To its own it adds twice as much with the other sign.
        """
        if self.held or self.trial.settled or len(self._time) < 5:
            return 0.0
        return _OF_BEND * _frame_noise(self._length) * self.frame_rate_hz**2

    @property
    def frame_rate_hz(self) -> float:
        """Frames a second of the length; infinite where it is held."""
        if self.held or len(self._time) < 3:
            return float("inf")
        return 1.0 / max(float(np.median(np.diff(self._time))), 1e-9)

    def _interpolated(self, time_s: Array, values: Array) -> Array:
        if self.held or not len(self._time) or self.trial.settled:
            return np.zeros(len(time_s))
        return np.interp(time_s, self._time, values)

    def temperature_at(self, time_s: Array) -> Array:
        """Temperature in degC, NaN where unknown."""
        channel = self.trial.get("temperature_c")
        if len(channel):
            return np.interp(time_s, channel.time_s, channel.value)
        return np.full(len(time_s), self.trial.temperature_c)

    def _propped(self, high: Mask, low: Mask) -> Mask:
        """Frames at the ends of the travel where something other than the muscle has the load.

        A camera that errs shows a stop elsewhere than it is. What gives it away is the force: it
        falls short of the weight, or exceeds it, at the end of the travel alone. Without a force
        nothing tells a rest on a stop from a rest in mid air, and long rests are left out.
        """
        force = self.trial.get("force_n")
        between = ~(high | low)
        made = np.zeros(len(high), dtype=bool)
        if self.trial.settled or between.sum() < 5:
            return made
        if not len(force):
            for end in (high, low):
                made |= end & (float(end.mean()) > _LONG_REST)
            return made
        pull = np.interp(self._time, force.time_s, force.value)
        hung = self.trial.load_kg * (STANDARD_GRAVITY_M_S2 - self._acceleration) - pull
        usual = float(np.median(hung[between]))
        for end in (high, low):
            if end.sum() >= 5 and abs(float(np.median(hung[end])) - usual) > _PROPPED_N:
                made |= end
        return made

    def direction_at(self, time_s: Array) -> Array:
        """+1 up, -1 down for settled points, else 0."""
        if not self.trial.settled:
            return np.zeros(len(time_s))
        return self.trial.direction[np.round(time_s).astype(np.int64)].astype(np.float64)

    def taken_at(self, time_s: Array) -> Array:
        """When a settled point was read, s; NaN where unknown, or where there is a time axis."""
        if not self.trial.settled or not len(self.trial.taken_s):
            return np.full(len(time_s), np.nan)
        return self.trial.taken_s[np.round(time_s).astype(np.int64)]

    def free_of_stops(self, time_s: Array) -> Mask:
        """Where the load hangs freely, away from both stops and a moment after leaving them.

        Not at the first and the last frame of a moving load: its acceleration there is a guess.
        """
        inner = np.ones(len(time_s), dtype=bool)
        if len(self._time) > 4 and not self.trial.settled and np.any(self._acceleration):
            inner = (time_s > self._time[1] - 1e-9) & (time_s < self._time[-2] + 1e-9)
        low, high = self._stops
        travel = np.zeros(len(self._time))
        if len(self._time) > 4 and not self.trial.settled:
            travel = np.abs(self._rate) * np.gradient(self._time)
        touching = (self._length - travel < low) | (self._length + travel > high)
        if len(self._length):
            # A stop within its tolerance is where the length goes no further.
            top, bottom = float(self._length.max()), float(self._length.min())
            if top > high - _STOP_ZONE_M:
                touching |= self._length > top - _REST_M - self._give
            if bottom < low + _STOP_ZONE_M:
                touching |= self._length < bottom + _REST_M + self._give
            reach = _REST_M + self._give
            touching |= self._propped(self._length > top - reach, self._length < bottom + reach)
        if not touching.any():
            return inner
        at = self._time[touching]
        after = np.searchsorted(at, time_s)
        near = np.full(len(time_s), np.inf)
        near = np.minimum(near, np.abs(time_s - at[np.clip(after, 0, len(at) - 1)]))
        near = np.minimum(near, np.abs(time_s - at[np.clip(after - 1, 0, len(at) - 1)]))
        return np.asarray(inner & (near > (0.0 if self.trial.settled else _AFTER_STOP_S)))


def _give_of_stops(trial: Trial, constants: PlantConstants) -> float:
    """How far in m the stops yield under the whole load, at most 3 mm."""
    if not np.isfinite(trial.load_kg) or constants.stop_stiffness_n_m <= 0.0:
        return 0.0
    return float(min(max(trial.load_kg, 0.0) * 9.81 / constants.stop_stiffness_n_m, 3e-3))


def _length_of(trial: Trial, camera: Channel, held: bool) -> tuple[Array, Array, Array, Array]:
    length = camera.value * 1e-3
    t = camera.time_s
    flat = np.zeros(len(t))
    if held or trial.settled or len(t) < 5:
        return t, length, flat, flat
    before = np.diff(t)[:-1]
    after = np.diff(t)[1:]
    bend = np.zeros(len(t))
    bend[1:-1] = (
        2.0 * (np.diff(length)[1:] / after - np.diff(length)[:-1] / before) / (before + after)
    )
    bend[0], bend[-1] = bend[1], bend[-2]
    # Second differences fall short of a quick swing by as much as a spline overshoots it.
    spline = CubicSpline(t, length)
    return t, length, np.asarray(spline(t, 1)), 0.5 * (bend + np.asarray(spline(t, 2)))


def _adaptive_slope(time_s: Array, length: Array, rate: Array) -> tuple[Array, Array]:
    """Speed in m/s from the widest window about each frame in which the motion is straight; its sd.

    Straight to within the camera's own noise (adaptive windowing: Janabi-Sharifi, Hayward and Chen
    2000, here about each frame and fitted by least squares). Between neighbours that noise makes
    millimetres a second, which hide the direction of a load that creeps. `rate` stays where no
    window of five frames is straight.
    """
    noise, n = _frame_noise(length), len(length)
    made, straight = rate.copy(), np.full(n, noise > 0.0)
    sd = _OF_SLOPE * noise / np.gradient(time_s)
    for half in range(2, min(_WIDEST_HALF, (n - 1) // 2) + 1):
        if not straight.any():
            break
        width = 2 * half + 1
        t = np.lib.stride_tricks.sliding_window_view(time_s, width)
        y = np.lib.stride_tricks.sliding_window_view(length, width)
        x = t - t.mean(axis=1, keepdims=True)
        up = y - y.mean(axis=1, keepdims=True)
        square = np.sum(x * x, axis=1)
        slope = np.sum(x * up, axis=1) / square
        bend = np.sum(up * up, axis=1) - slope**2 * square
        chance = float(chi2.isf(_BENT_BY_CHANCE, width - 2))
        # At the ends the nearest whole window serves.
        of = np.clip(np.arange(n) - half, 0, n - width)
        straight &= (bend <= chance * noise**2)[of]
        made = np.where(straight, slope[of], made)
        # Where a window holds a start or a stop, its halves differ in speed by more than noise.
        ends = _slope(x[:, half:], y[:, half:]) - _slope(x[:, : half + 1], y[:, : half + 1])
        sd = np.where(straight, np.hypot(noise / np.sqrt(square), 0.5 * ends)[of], sd)
    return made, sd


def _slope(x: Array, y: Array) -> Array:
    """Slopes of lines through the rows of two arrays."""
    off = x - x.mean(axis=1, keepdims=True)
    return np.asarray(np.sum(off * y, axis=1) / np.sum(off * off, axis=1))


_OF_SLOPE = 1.18
"""Sd of a cubic spline's slope at a frame, in sd of the noise over the frames' spacing: the root of
the sum of squares of its weights, 3 (2 - sqrt(3)) ** k to each side, k = 1, 2, ..."""
_BENT_BY_CHANCE = 1e-4
"""Share of straight windows that noise makes look bent. A matter of definition."""
_WIDEST_HALF = 15
"""Frames to each side of the widest window. No other value was tried."""


def _frame_noise(length: Array) -> float:
    """One sd in m of a camera's own noise; more than usual only where it is plainly noise."""
    most = _MOST_WHITE_NOISE_M if is_white(length) else _MOST_FRAME_NOISE_M
    return min(frame_noise(length), most)


def _doubts(time_s: Array, acceleration: Array, noise_m: float) -> tuple[Array, Array]:
    """What is lost between frames of a bouncing load, from how rough the acceleration is.

    A kink of the motion costs h² / 8 times the roughness in length. What the camera's own noise
    makes of second differences does not count.
    """
    if len(time_s) < 5 or not np.any(acceleration):
        return np.zeros(len(time_s)), np.zeros(len(time_s))
    step = np.gradient(time_s)
    quiet = _NOISE_OF_BEND * noise_m / np.maximum(step, 1e-4) ** 2
    rough = np.zeros(len(time_s))
    rough[1:-1] = np.abs(acceleration[1:-1] - 0.5 * (acceleration[:-2] + acceleration[2:]))
    rough = np.maximum(rough - quiet, 0.0)

    def spread(x: Array) -> Array:
        return np.maximum(x, np.maximum(np.r_[x[1:], 0.0], np.r_[0.0, x[:-1]]))

    return spread(spread(rough * step**2 / 8.0)), spread(0.5 * rough)


_SWING_OF_NOISE_SD = 3.0
"""Largest departure that noise makes among a few frames, in its sd. A matter of definition."""
_MOST_NOISE_OF_SWING_M = 0.05e-3
"""Most of it that is taken for noise: a swing that never ends looks like noise from frame to frame.
"""
_SWING_FRAMES = 5
_END_FRAMES = 4


def _swing(time_s: Array, length: Array) -> Array:
    """Largest departure from the line through the frames around, shape of `length`."""
    width = 2 * _SWING_FRAMES + 1
    if len(length) < width:
        return np.full(len(length), float(np.ptp(length)) if len(length) else 0.0)
    window = np.lib.stride_tricks.sliding_window_view(length, width)
    x = np.arange(width) - _SWING_FRAMES
    slope = window @ x / float(x @ x)
    off = window - window.mean(axis=1)[:, None] - slope[:, None] * x[None, :]
    inside = np.abs(off).max(axis=1)
    made = np.empty(len(length))
    made[_SWING_FRAMES:-_SWING_FRAMES] = inside
    made[:_SWING_FRAMES], made[-_SWING_FRAMES:] = inside[0], inside[-1]
    return made


def _regulated(trial: Trial) -> bool:
    """Whether something other than the commanded valves sets the pressure."""
    if trial.settled or not ("inlet_cmd" in trial or "outlet_cmd" in trial):
        return True
    pressure = trial.get("pressure_kpa")
    if len(pressure) < 5:
        return True
    if np.any(trial.get("inlet_cmd").value > 0.0):
        return False
    # Pressure that rises with the inlet never commanded open comes from elsewhere, unless the
    # muscle is being squeezed.
    value = pressure.value
    width = max(1, len(value) // 200)
    block = value[: len(value) // width * width].reshape(-1, width).mean(axis=1)
    rise = float(np.max(block - np.minimum.accumulate(block)))
    return rise > _RISE_KPA and not moves(trial.get("length_mm").value)
