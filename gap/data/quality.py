"""Whether the data are fit to be diagnosed: gaps, saturation, stuck or starved channels.

Clock offsets and two-sided smoothing are candidates of the search (`gap.effects.candidates`),
because only against the other channels do they show; what a channel shows alone is checked here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gap.data.dataset import DataSet
from gap.data.trial import Channel
from plant.arrays import Array


@dataclass(frozen=True)
class Unfit:
    """A defect of one channel that a diagnosis cannot look past."""

    channel: str
    defect: str
    trial: str = ""

    def __str__(self) -> str:
        return f"{self.channel} {self.defect}"


_CHECKED = ("pressure_kpa", "force_n", "length_mm")
_RAIL_SHARE = 0.04
_GAP_SHARE = 0.25
_PILE = 15.0
"""How many times more readings a rail holds than a level beside it."""
_USUAL_RUN = 10
_RANDOM = 1.5
# Spread from which a channel carries more than its own noise (20 times the nominal noise and more).
_LIVELY = {"force_n": 1.0, "length_mm": 0.5}


def unfit_channels(data: DataSet) -> list[Unfit]:
    """Defects found in single channels, worst first; empty when there are none."""
    found: list[Unfit] = []
    for name in _CHECKED:
        there = [
            (trial.name, trial[name])
            for trial in data.trials
            if name in trial and not trial.settled
        ]
        if not there:
            continue
        rail = _saturated([channel for _, channel in there])
        if rail is not None:
            found.append(Unfit(name, f"is saturated at {rail:g} for part of the data", there[0][0]))
        stuck = _stuck([channel for _, channel in there])
        if stuck:
            trials = ", ".join(there[k][0] for k in stuck[:3])
            found.append(
                Unfit(name, f"stands still in {len(stuck)} trials ({trials})", there[stuck[0]][0])
            )
        if name in _LIVELY and _unordered(data, name):
            found.append(Unfit(name, "has no order in time while pressure has", there[0][0]))
        holes = [(trial, hole) for trial, channel in there if (hole := _hole(channel)) > 0.0]
        if len(holes) > 0.3 * len(there):
            worst = max(holes, key=lambda item: item[1])
            found.append(
                Unfit(name, f"has gaps of up to {worst[1]:.3g} s in {len(holes)} trials", worst[0])
            )
    return found


def _saturated(channels: list[Channel]) -> float | None:
    """Value at which a channel is clipped: its extreme, reached again and again, exactly."""
    values = np.concatenate([channel.value for channel in channels])
    if len(values) < 200:
        return None
    for extreme, inside in (
        (values.max(), values < values.max()),
        (values.min(), values > values.min()),
    ):
        share = 1.0 - float(inside.mean())
        if share < _RAIL_SHARE or not inside.any():
            continue
        # Many readings on the very edge, and few on each level just inside it: a rail, not a
        # resting value.
        spread = float(values.max() - values.min())
        near = values[(np.abs(values - extreme) < 0.05 * spread) & inside]
        levels = np.unique(np.round(near, 9), return_counts=True)[1]
        usual = float(np.median(levels)) if len(levels) else 0.0
        count = share * len(values)
        if abs(extreme) > 0.2 * spread > 0.0 and count > _PILE * max(usual, 1.0):
            return float(extreme)
    return None


def _stuck(channels: list[Channel]) -> list[int]:
    """Trials in which a channel repeats one value for long while elsewhere it never does.

    A channel without any noise rests on one value everywhere, and is not stuck.
    """
    runs = [_longest_run(channel.value) for channel in channels]
    if len(runs) < 3 or float(np.median(runs)) > _USUAL_RUN:
        return []
    return [
        k
        for k, (run, channel) in enumerate(zip(runs, channels, strict=True))
        if run > max(5 * _USUAL_RUN, 0.25 * len(channel)) and len(np.unique(channel.value)) > 1
    ]


def _longest_run(values: Array) -> int:
    """Most neighbouring samples that equal each other, the lowest reading (a vent) aside."""
    if len(values) < 2:
        return len(values)
    change = np.flatnonzero(np.r_[True, np.diff(values) != 0.0, True])
    length = np.diff(change)
    length[values[change[:-1]] <= values.min()] = 1
    return int(length.max())


def _hole(channel: Channel) -> float:
    """Length in s of the longest hole when holes take a good part of the trial, else 0."""
    if len(channel) < 20:
        return 0.0
    step = np.diff(channel.time_s)
    usual = float(np.median(step))
    long = step[step > 8.0 * usual]
    span = float(channel.time_s[-1] - channel.time_s[0])
    return float(long.max()) if len(long) and long.sum() > _GAP_SHARE * span else 0.0


def _unordered(data: DataSet, name: str) -> bool:
    """Whether neighbouring samples differ as much as distant ones, in most trials that move.

    Von Neumann's ratio (mean square of successive differences over the variance) is 2 for values
    in random order and small for a signal that is sampled fast enough. Only trials count in which
    the channel spans a good part of what it spans anywhere and pressure itself is in order.
    """
    trials = [t for t in data.trials if name in t and "pressure_kpa" in t and not t.settled]
    if not trials:
        return False
    whole = float(np.concatenate([trial[name].value for trial in trials]).std())
    judged = [
        _von_neumann(trial[name]) > _RANDOM
        for trial in trials
        if min(len(trial[name]), len(trial["pressure_kpa"])) >= 20
        and trial[name].value.std() > max(0.25 * whole, _LIVELY[name])
        and _von_neumann(trial["pressure_kpa"]) < 0.25 * _RANDOM
    ]
    return len(judged) > 0 and float(np.mean(judged)) > 0.5


def _von_neumann(channel: Channel) -> float:
    spread = float(channel.value.var())
    return float(np.mean(np.diff(channel.value) ** 2)) / spread if spread > 0.0 else 0.0
