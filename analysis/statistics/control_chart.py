"""Control chart of individual values and moving ranges (ISO 7870-2), with run rules."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

D2 = 1.128379167
"""Mean range of two normal values in standard deviations: 2 / sqrt(pi)."""
D4 = 3.266531919
"""Upper limit of a moving range of two, in mean ranges: 1 + 3 d3 / d2."""
EXACT = 1e-12
"""A relative difference below this is the rounding of a sum, as of runs with equal values."""
ENOUGH = 20
"""Limits from fewer values are provisional."""

RULES = {
    "beyond": "one value beyond three standard deviations",
    "side": "nine values in a row on one side of the centre",
    "trend": "six values in a row rising or falling",
    "warning": "two of three values in a row beyond two standard deviations on one side",
    "range": "a moving range above its limit",
}
"""Rules that are applied (Nelson, J. Quality Technology 16 (1984) 237, tests 1, 2, 3 and 5)."""


@dataclass(frozen=True)
class ControlChart:
    """A chart of individual values.

    Attributes:
        values: in order of time, shape (n,).
        ranges: moving ranges of two, shape (n - 1,).
        centre, sd: centre line and standard deviation of the limits.
        lower, upper: control limits, centre -+ 3 sd.
        range_limit: upper limit of the moving range.
        base: number of values that the limits are from; 0: the limits were stated.
        alarms: rule to the positions at which it is broken, from 0; only broken rules.
        remark: what the limits rest on.
    """

    values: npt.NDArray[np.float64]
    ranges: npt.NDArray[np.float64]
    centre: float
    sd: float
    lower: float
    upper: float
    range_limit: float
    base: int
    alarms: dict[str, tuple[int, ...]]
    remark: str

    @property
    def in_control(self) -> bool:
        """No rule is broken."""
        return not self.alarms


def control_chart(
    values: npt.ArrayLike, base: int | None = None, stated: tuple[float, float] | None = None
) -> ControlChart:
    """Chart of values in order of time.

    Args:
        values: shape (n,), all finite.
        base: the limits are from the first ``base`` values; None: from all.
        stated: centre and standard deviation, where they are known from before.

    Raises:
        ValueError: fewer than two values for the limits, or a value is not finite.
    """
    x = np.asarray(values, dtype=np.float64)
    if not np.isfinite(x).all():
        raise ValueError("a value of a control chart is not finite")
    used = len(x) if base is None else base
    if stated is None and not 2 <= used <= len(x):
        raise ValueError(f"limits need from 2 to {len(x)} values, not {used}")
    ranges = np.abs(np.diff(x))
    if stated is None:
        centre = float(x[:used].mean())
        sd = float(ranges[: used - 1].mean()) / D2
        if sd <= EXACT * abs(centre):
            centre, sd = float(x[0]), 0.0
        few = f"; provisional: fewer than {ENOUGH}" if used < ENOUGH else ""
        remark = f"limits from {'all' if used == len(x) else 'the first'} {used} values{few}"
    else:
        used, (centre, sd) = 0, stated
        remark = "limits as stated"
    limit = D4 * D2 * sd
    return ControlChart(
        x, ranges, centre, sd, centre - 3 * sd, centre + 3 * sd, limit, used,
        _alarms(x, ranges, centre, sd, limit), remark,
    )  # fmt: skip


def _alarms(
    x: npt.NDArray[np.float64], ranges: npt.NDArray[np.float64], centre: float, sd: float,
    limit: float,
) -> dict[str, tuple[int, ...]]:  # fmt: skip
    least = EXACT * abs(centre)
    off = np.where(np.abs(x - centre) <= least, 0.0, x - centre)
    z = off / sd if sd > 0.0 else np.where(off > 0.0, math.inf, np.where(off < 0.0, -math.inf, 0.0))
    step = np.where(ranges <= least, 0.0, np.sign(np.diff(x)))
    found = {
        "beyond": [i for i, v in enumerate(z) if abs(v) > 3.0],
        "side": _runs(np.sign(z), 9),
        "trend": [i + 1 for i in _runs(step, 5)],
        "warning": [
            i
            for i in range(2, len(z))
            for side in (1.0, -1.0)
            if side * z[i] > 2.0 and sum(side * z[i - 2 : i + 1] > 2.0) >= 2
        ],
        "range": [i + 1 for i, r in enumerate(ranges) if r > limit + least],
    }
    return {rule: tuple(at) for rule, at in found.items() if at}


def _runs(signs: npt.NDArray[np.float64], length: int) -> list[int]:
    """Positions at which ``length`` equal signs other than 0 end."""
    count, out = 0, []
    for i, sign in enumerate(signs):
        count = count + 1 if sign != 0.0 and i and sign == signs[i - 1] else int(sign != 0.0)
        if count >= length:
            out.append(i)
    return out
