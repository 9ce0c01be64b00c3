"""Channels out of time, or smoothed both ways in time: no effect moves before its cause.

What one channel shows is predicted from the others by the plant as stated. If the channel is that
prediction some time earlier or later, a clock is off. If it is a running mean of the prediction,
it was smoothed; if the prediction is a running mean of the channel, one of those it was made from
was. Everything is tried beside one-sided lags, and counts only where it leaves far less.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from gap.data.dataset import DataSet
from gap.data.trial import Channel
from gap.estimation.fit_problem import FitProblem
from gap.selection.config import SELECTION, SelectionConfig
from plant.arrays import Array
from plant.effects.arguments import Points

Pair = tuple[Array, Array, bool]

_STEP_S = 0.01
_REACH = 60


@dataclass(frozen=True)
class TimingFault:
    """A channel that is out of time (`late_s`, negative if early) or smoothed over `width_s`."""

    channel: str
    late_s: float = 0.0
    width_s: float = 0.0

    @property
    def defect(self) -> str:
        """What is wrong with the channel."""
        if self.width_s:
            return (
                f"is smoothed both ways in time (over about {self.width_s:.2g} s), "
                "the other channels are not"
            )
        word = "late" if self.late_s > 0.0 else "early"
        shift_ms = 1e3 * abs(self.late_s)
        return f"is out of time with the other channels, {word} by about {shift_ms:.0f} ms"


def in_time(data: DataSet, fault: TimingFault) -> DataSet:
    """The data with a late channel put right; what was smoothed stays as it is."""
    trials = []
    for trial in data.trials:
        channels = dict(trial.channels)
        if fault.channel in channels:
            late = channels[fault.channel]
            channels[fault.channel] = Channel(late.time_s - fault.late_s, late.value)
        trials.append(replace(trial, channels=channels))
    return replace(data, trials=tuple(trials))


def channel_with_timing_fault(
    problem: FitProblem, config: SelectionConfig = SELECTION
) -> TimingFault | None:
    """The channel that is out of time or smoothed both ways, if one surely is."""
    for block, own in (("pressure", "pressure_kpa"), ("force", "force_n")):
        pairs = _pairs(problem, block, config)
        if len(pairs) < 2:
            continue
        width = _is_mean_of(pairs, block, config)
        if width is not None:
            return TimingFault(own, width_s=width)
        still = [pair for pair in pairs if not pair[2]]
        # Where the length moves it may be the camera that is late.
        late = _is_late(still, block, config) if len(still) > 1 else None
        if late is not None:
            return TimingFault(own, late_s=late)
        # The chamber's prediction is made from commands, which nobody smooths.
        width = (
            _is_mean_of([(x, y, m) for y, x, m in pairs], block, config)
            if block == "force"
            else None
        )
        if width is not None:
            moved = float(np.mean([m for _, _, m in pairs])) > 0.5
            return TimingFault("length_mm" if moved else "pressure_kpa", width_s=width)
    return None


def _is_late(pairs: list[Pair], block: str, config: SelectionConfig) -> float | None:
    """By how many seconds the first of each pair is late behind the second, if it surely is."""
    steps = np.arange(-_REACH, _REACH + 1)
    left = np.array(
        [[_unexplained(y, _delayed(x, k)) for k in steps.tolist()] for y, x, _ in pairs]
    )
    lagged = np.array(
        [[_unexplained(y, v) for v in [x, *_lags(x, config)]] for y, x, _ in pairs]
    )  # fmt: skip
    size = sum(len(y) for y, _, _ in pairs)
    rival = lagged.sum(axis=0).min()
    if np.sqrt(rival / size) < _least_left(block, config):
        return None
    at = int(np.argmin(left.sum(axis=0)))
    if (
        abs(int(steps[at])) < config.timing_least_shift
        or left[:, at].sum() > config.timing_far_better * rival
    ):
        return None
    weight = lagged.min(axis=1)
    agree = left[:, at] < config.timing_trial_better * weight
    if float(weight[agree].sum()) < config.timing_most_trials * float(weight.sum()):
        return None
    return float(steps[at]) * _STEP_S


def _least_left(block: str, config: SelectionConfig) -> float:
    pressure = block == "pressure"
    return config.timing_least_left_kpa if pressure else config.timing_least_left_n


def _least_span(block: str, config: SelectionConfig) -> float:
    pressure = block == "pressure"
    return config.timing_least_span_kpa if pressure else config.timing_least_span_n


def _delayed(x: Array, steps: int) -> Array:
    """The signal some steps later (earlier if negative), ends held."""
    if steps == 0:
        return x
    if steps > 0:
        return np.asarray(np.r_[np.full(min(steps, len(x)), x[0]), x[:-steps]])
    return np.asarray(np.r_[x[-steps:], np.full(min(-steps, len(x)), x[-1])])


def _lags(x: Array, config: SelectionConfig) -> list[Array]:
    made = []
    for lag in config.timing_lags_s:
        made += [_lagged(x, lag), _lagged(x[::-1], lag)[::-1]]
    return made


def _pairs(problem: FitProblem, block: str, config: SelectionConfig) -> list[Pair]:
    """Measured, predicted, and whether the length moves, on an even clock, trial by trial."""
    points = problem.grid.points.get(block)
    if points is None:
        return []
    raw = getattr(problem.model, f"_{block}")(
        points, problem.data.constants, problem.stated_effects
    )
    scale = 1e-3 if block == "pressure" else 1.0
    measured = points.reading * scale
    predicted = measured - np.nan_to_num(raw) * scale
    made = []
    for a, b in zip(points.first[:-1].tolist(), points.first[1:].tolist(), strict=True):
        if b - a < 40:
            continue
        pair = _even(points, measured, predicted, a, b)
        if min(float(np.ptp(pair[0])), float(np.ptp(pair[1]))) > _least_span(block, config):
            made.append((*pair, bool(np.ptp(points.length[a:b]) > 1e-3)))
    return made


def _even(points: Points, y: Array, x: Array, a: int, b: int) -> tuple[Array, Array]:
    t = points.time_s[a:b]
    clock = np.arange(t[0], t[-1], _STEP_S)
    # A common short mean keeps the noise of one side from passing for sharpness.
    return tuple(_mean(np.interp(clock, t, v[a:b]), 3) for v in (y, x))  # type: ignore[return-value]


def _is_mean_of(pairs: list[Pair], block: str, config: SelectionConfig) -> float | None:
    """Width in s over which the first of each pair is a running mean of the second, if it is."""
    best_of = [_left(y, x, config) for y, x, _ in pairs]
    others = np.array([other for other, _ in best_of])
    smooth = np.array([widths for _, widths in best_of])
    size = np.array([len(y) for y, _, _ in pairs], dtype=np.float64)
    if np.sqrt(others.sum(axis=0).min() / size.sum()) < _least_left(block, config):
        return None
    at = int(np.argmin(smooth.sum(axis=0)))
    rival = others.sum(axis=0).min()
    if smooth[:, at].sum() > config.timing_far_better * rival:
        return None
    agree = smooth[:, at] < config.timing_trial_better * others.min(axis=1)
    weight = others.min(axis=1)
    if float(weight[agree].sum()) < config.timing_most_trials * float(weight.sum()):
        return None
    return config.timing_widths_s[at]


def _left(y: Array, x: Array, config: SelectionConfig) -> tuple[Array, Array]:
    """Squares left of y after relations that may be innocent, and after each smoothing of x."""
    innocent = [x, *_lags(x, config)]
    for shift in config.timing_shifts_s:
        k = round(shift / _STEP_S)
        innocent += [_delayed(x, k), _delayed(x, -k)]
    smoothed = [_mean(x, max(round(width / _STEP_S), 3)) for width in config.timing_widths_s]
    return (
        np.array([_unexplained(y, v) for v in innocent]),
        np.array([_unexplained(y, v) for v in smoothed]),
    )


def _unexplained(y: Array, x: Array) -> float:
    """Squares left of y after an offset and a gain of x."""
    a, b = y - y.mean(), x - x.mean()
    power = float(b @ b)
    return float(a @ a) - (float(a @ b) ** 2 / power if power > 0.0 else 0.0)


def _lagged(x: Array, lag_s: float) -> Array:
    """First-order lag, started at rest."""
    share = 1.0 - np.exp(-_STEP_S / lag_s)
    return np.asarray(lfilter([share], [1.0, share - 1.0], x, zi=[(1.0 - share) * x[0]])[0])


def _mean(x: Array, width: int) -> Array:
    """Centred running mean over an odd number of samples, ends repeated."""
    width += 1 - width % 2
    padded = np.pad(x, width // 2, mode="edge")
    return np.convolve(padded, np.full(width, 1.0 / width), mode="valid")
