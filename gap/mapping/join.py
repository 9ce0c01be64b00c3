"""Two clocks joined by an event that both saw: the table [join] of a mapping file.

The test of another machine and the record of this bench have each their own clock. What both saw
is a step: of the pressure in one, of the force (or length) in the other. The times of the steps,
where half of each step is done, give the offset; the times at a quarter and at three quarters show
how well the shapes of both agree.
"""

from __future__ import annotations

import math
from collections.abc import Set
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gap.errors import GapError
from gap.mapping.section import Section
from plant.arrays import Array

BY = ("steps", "stated")
SMALLEST = 0.2
"""Smallest step that counts, as a part of the largest change in the record."""
WINDOW_S = 0.5
LEVELS = (0.25, 0.5, 0.75)
RIVAL = 0.5
"""Refused as ambiguous: another offset that fits at least this part as many steps."""
CLOCK_KEYS = {
    "pressure_kpa": "pressure_clock_ms", "force_n": "force_clock_ms",
    "length_mm": "length_clock_ms",
}  # fmt: skip
"""Channel to the key of `calibration.toml` for the time of it."""
COMMANDS = frozenset({"inlet_cmd", "outlet_cmd"})
FEWEST_SPREAD = 3
"""From so many steps on, their spread is an estimate of its own."""


@dataclass(frozen=True)
class Join:
    """How the clock of a companion file is joined to that of the main file.

    Attributes:
        channel: of the companion file.
        to: of the main file.
        by: of `BY`.
        channel_s, to_s, u_s: times of the event on each clock, and the standard uncertainty of
            their difference (by "stated").
        opposite: the steps of both have opposite signs.
        smallest, window_s: smallest step as a part of the range; time over which a step is done.
        lag_s, u_lag_s: how much later the event shows in `to`, and its standard uncertainty.
        about_s, within_s: the offset is within_s around about_s; None where nothing is known.
    """

    channel: str
    to: str
    by: str
    channel_s: float = 0.0
    to_s: float = 0.0
    u_s: float = 0.0
    opposite: bool = False
    smallest: float = SMALLEST
    window_s: float = WINDOW_S
    lag_s: float = 0.0
    u_lag_s: float = 0.0
    about_s: float | None = None
    within_s: float = 0.0


@dataclass(frozen=True)
class Offset:
    """Time on the main clock less time on the companion's, in s, with its standard uncertainty."""

    offset_s: float
    u_s: float
    steps: int

    def words(self, name: str) -> str:
        """A note for the reader."""
        how = f"from {self.steps} steps" if self.steps > 1 else "from one step"
        how = how if self.steps else "as stated"
        return f"{name}: clock shifted by {self.offset_s:.4f} s, u {self.u_s:.2g} s (k = 1), {how}"


@dataclass(frozen=True)
class Steps:
    """Steps of one series, all of shape (n,) or (n, 3).

    Attributes:
        at_s: times at a quarter, half and three quarters of each step.
        u_s: standard uncertainty of the time at half, from noise and sampling.
        sign: +1 up, -1 down.
        begin_s, end_s: of the record, less a window: in here a step would have been seen.
    """

    at_s: Array
    u_s: Array
    sign: npt.NDArray[np.int64]
    begin_s: float
    end_s: float


def read_join(table: Section | None) -> Join | None:
    """The table [join]; None where there is none.

    Raises:
        GapError: names the key.
    """
    if table is None:
        return None
    by = table.choice("by", BY)
    channel, to = table.text("channel", required=True), table.text("to", required=True)
    lag, u_lag = table.number("lag_s", 0.0) or 0.0, table.number("u_lag_s", 0.0) or 0.0
    if u_lag < 0.0:
        raise table.error("u_lag_s", "is negative")
    if by == "stated":
        values = {}
        for key in ("channel_s", "to_s"):
            value = table.number(key)
            if value is None:
                raise table.error(key, "is missing", "the time of the event on that clock")
            values[key] = value
        u_s = table.positive("u_s", required=True) or 0.0
        made = Join(
            channel, to, by, values["channel_s"], values["to_s"], u_s, lag_s=lag, u_lag_s=u_lag
        )
    else:
        smallest = table.positive("smallest") or SMALLEST
        if smallest >= 1.0:
            raise table.error("smallest", f"expected a part below 1, got {smallest:g}")
        about = table.number("about_s")
        within = table.positive("within_s", required=about is not None) or 0.0
        if within and about is None:
            raise table.error("about_s", "is missing", "within_s is around it")
        made = Join(
            channel, to, by, opposite=table.flag("opposite"), smallest=smallest,
            window_s=table.positive("window_s") or WINDOW_S, lag_s=lag, u_lag_s=u_lag,
            about_s=about, within_s=within,
        )  # fmt: skip
    table.close()
    return made


def offset_of(
    join: Join, where: str, own: tuple[Array, Array], main: tuple[Array, Array]
) -> Offset:
    """Offset of a companion's clock.

    Args:
        join: how.
        where: mapping file and table, for messages.
        own: times in s and values of the companion's channel, each shape (n,).
        main: the same of the main file's.

    Raises:
        GapError: no step in one of them, or more than one offset that fits.
    """
    if join.by == "stated":
        u_s = math.hypot(join.u_s, join.u_lag_s)
        return Offset(join.to_s - join.channel_s - join.lag_s, u_s, 0)
    seen = [
        find_steps(time_s, value, join.window_s, join.smallest)
        for time_s, value in (own, main)
    ]  # fmt: skip
    for name, steps in zip((join.channel, join.to), seen, strict=True):
        if not len(steps.at_s):
            raise GapError(
                where, f"{name} has no step of {join.smallest:g} of its range "
                f"within {join.window_s:g} s",
                'make a step that both see, change smallest or window_s, or use by = "stated"',
            )  # fmt: skip
    return _matched(join, where, *seen)


def clock_keys(one: Set[str], other: Set[str]) -> tuple[str, ...]:
    """Keys of `calibration.toml` that take up the uncertainty of a join.

    Only the difference of both clocks matters, so that the channels of either file may carry it.
    Commands have no such key: the file without them does, and of two the one with fewer channels.

    Args:
        one, other: names of the channels and commands of both files.
    """
    sides = [side for side in (one, other) if not side & COMMANDS] or [one]
    names = min(sides, key=lambda side: len(side & CLOCK_KEYS.keys()))
    return tuple(key for name, key in CLOCK_KEYS.items() if name in names)


def find_steps(time_s: Array, value: Array, window_s: float, smallest: float) -> Steps:
    """Steps of a series: changes of its level that are done within a window.

    Args:
        time_s: ascending times, shape (n,).
        value: values, shape (n,).
        window_s: time over which the level before and after is taken.
        smallest: smallest change, as a part of the largest.
    """
    total = np.r_[0.0, np.cumsum(value)]

    def mean(begin_s: Array, end_s: Array) -> Array:
        low = np.searchsorted(time_s, begin_s)
        high = np.searchsorted(time_s, end_s)
        with np.errstate(invalid="ignore"):
            each = (total[high] - total[low]) / np.where(high > low, high - low, np.nan)
        return np.asarray(each, dtype=np.float64)

    change = mean(time_s, time_s + window_s) - mean(time_s - window_s, time_s)
    inside = (time_s - window_s >= time_s[0]) & (time_s + window_s <= time_s[-1])
    change = np.where(inside & np.isfinite(change), change, 0.0)
    spread = float(np.ptp(np.percentile(value, (1, 99)))) if len(value) > 1 else 0.0
    size = np.abs(change)
    found: list[tuple[Array, float, int]] = []
    while len(size) and size.max() >= smallest * spread > 0.0:
        k = int(np.argmax(size))
        sign = 1 if change[k] > 0 else -1
        size = np.where(np.abs(time_s - time_s[k]) <= window_s, 0.0, size)
        one = _crossings(time_s, sign * value, float(time_s[k]), window_s)
        if one is not None:
            found.append((*one, sign))
    found.sort(key=lambda step: float(step[0][1]))
    begin_s, end_s = (float(time_s[0]), float(time_s[-1])) if len(time_s) else (0.0, 0.0)
    return Steps(
        np.array([at for at, _, _ in found]).reshape(-1, len(LEVELS)),
        np.array([u for _, u, _ in found]),
        np.array([sign for _, _, sign in found], dtype=np.int64),
        begin_s + window_s,
        end_s - window_s,
    )


def _crossings(
    time_s: Array, rising: Array, middle_s: float, window_s: float
) -> tuple[Array, float] | None:
    """Times at the levels of one step up, and the uncertainty of the middle one."""
    early = (time_s >= middle_s - 1.5 * window_s) & (time_s < middle_s - 0.5 * window_s)
    late = (time_s > middle_s + 0.5 * window_s) & (time_s <= middle_s + 1.5 * window_s)
    near = np.flatnonzero(np.abs(time_s - middle_s) <= window_s)
    if not early.any() or not late.any() or len(near) < 2:
        return None
    low, high = float(np.median(rising[early])), float(np.median(rising[late]))
    if high <= low:
        return None
    noise = float(np.median(np.abs(rising[early] - low))) * 1.4826
    at = []
    for level in LEVELS:
        goal = low + level * (high - low)
        # Noise crosses a level several times: the middle of the first and last crossing.
        over = rising[near] >= goal
        turns = np.flatnonzero(~over[:-1] & over[1:])
        if not len(turns):
            return None
        each = []
        for turn in (turns[0], turns[-1]):
            k = near[turn]
            share = (goal - rising[k]) / (rising[k + 1] - rising[k])
            each.append(float(time_s[k] + share * (time_s[k + 1] - time_s[k])))
        at.append(sum(each) / 2.0)
    gap_s = float(np.median(np.diff(time_s[near])))
    rise_s = max(at[-1] - at[0], gap_s)
    slope = (LEVELS[-1] - LEVELS[0]) * (high - low) / rise_s
    # Of linear interpolation; a step between two samples may be anywhere between them.
    sampling_s = min(gap_s / math.sqrt(12.0), gap_s**2 / (8.0 * rise_s))
    return np.array(at), math.hypot(noise / slope, sampling_s)


def _matched(join: Join, where: str, own: Steps, main: Steps) -> Offset:
    """The one offset at which the steps of both fall together."""
    sign = -own.sign if join.opposite else own.sign
    middle = len(LEVELS) // 2
    fits: list[tuple[float, float, list[tuple[int, int]]]] = []
    for i, j in np.argwhere(main.sign[:, None] == sign[None, :]).tolist():
        trial_s = float(main.at_s[i, middle] - own.at_s[j, middle])
        pairs = _pairs(trial_s, own, main, sign, join.window_s / 2.0)
        offset_s = float(np.mean([main.at_s[m, middle] - own.at_s[o, middle] for m, o in pairs]))
        if join.about_s is not None and abs(offset_s - join.about_s) > join.within_s:
            continue
        fits.append((2.0 * len(pairs) - _visible(offset_s, own, main), offset_s, pairs))
    if not fits:
        raise GapError(
            where, "no offset fits the steps of both", "check opposite, about_s, within_s"
        )
    score, offset_s, pairs = max(fits, key=lambda fit: (fit[0], len(fit[2])))
    if score <= 0.0:
        raise GapError(
            where, f"at most {len(pairs)} steps fall together, and more do not",
            "change smallest or window_s so that both see the same steps, or state the event",
        )  # fmt: skip
    rivals = [f for f in fits if abs(f[1] - offset_s) > join.window_s and f[0] >= RIVAL * score]
    if rivals:
        other = max(rivals, key=lambda fit: fit[0])
        raise GapError(
            where,
            f"ambiguous: {len(pairs)} steps fall together at {offset_s:.3f} s, "
            f"and {len(other[2])} at {other[1]:.3f} s",
            "state about_s and within_s, or the event itself (by = \"stated\")",
        )  # fmt: skip
    apart = np.array([main.at_s[m] - own.at_s[o] for m, o in pairs])
    n = len(apart)
    u_each = np.array([math.hypot(main.u_s[m], own.u_s[o]) for m, o in pairs])
    u_mean = float(np.sqrt(np.mean(u_each**2) / n))
    if n >= FEWEST_SPREAD:
        u_mean = max(u_mean, float(np.std(apart[:, middle], ddof=1)) / math.sqrt(n))
    shape = float(np.ptp(apart.mean(axis=0))) / (2.0 * math.sqrt(3.0))
    return Offset(offset_s - join.lag_s, math.hypot(u_mean, shape, join.u_lag_s), n)


def _pairs(
    offset_s: float, own: Steps, main: Steps, sign: npt.NDArray[np.int64], tolerance_s: float
) -> list[tuple[int, int]]:
    """Steps (main, own) of one sign that fall together; each is used once."""
    middle = len(LEVELS) // 2
    out: list[tuple[int, int]] = []
    free = set(range(len(own.at_s)))
    for m in range(len(main.at_s)):
        near = [
            (abs(float(main.at_s[m, middle] - own.at_s[o, middle]) - offset_s), o)
            for o in free
            if sign[o] == main.sign[m]
        ]
        if near and min(near)[0] <= tolerance_s:
            out.append((m, min(near)[1]))
            free.discard(min(near)[1])
    return out


def _visible(offset_s: float, own: Steps, main: Steps) -> float:
    """Steps of each record that the other would have seen, too, at this offset; mean of both."""
    middle = len(LEVELS) // 2
    begin = max(main.begin_s, own.begin_s + offset_s)
    end = min(main.end_s, own.end_s + offset_s)
    at_main, at_own = main.at_s[:, middle], own.at_s[:, middle] + offset_s
    count = np.sum((at_main >= begin) & (at_main <= end)) + np.sum(
        (at_own >= begin) & (at_own <= end)
    )
    return float(count) / 2.0
