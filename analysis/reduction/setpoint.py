"""Correction of points to their set pressures, so that a cycle compares values at one pressure.

A valve leaves the pressure anywhere in its dead zone. A regulator approaches from below when the
pressure rises and from above when it falls. Without the correction this difference in pressure
would appear as hysteresis.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import pandas as pd

MAX_CORRECTION_KPA = 10.0
"""A point farther than this from its set pressure is not corrected."""


def at_set_pressure(table: pd.DataFrame, value: str) -> pd.DataFrame:
    """The table with ``value`` corrected to each point's set pressure.

    The slope is that between the neighbours in the same trial and direction. Where a cycle turns,
    the muscle is still on the rising branch: a reading there at falling pressure has the slope of
    that branch, and is no neighbour of the falling one. The noise of the pressure is added to
    ``u_VALUE_noise``. ``pressure_kpa`` becomes the set pressure. Vented points and points without
    neighbours stay unchanged.

    Args:
        table: settled points.
        value: "force_n" or "length_mm".
    """
    out = table.copy()
    for _, trial in table.groupby("trial", sort=False):
        good = trial.dropna(subset=["pressure_kpa", value, "set_pressure_kpa"])
        slope = _slopes(good, value).dropna()
        good = good.loc[slope.index]
        set_kpa = good["set_pressure_kpa"].astype(np.float64)
        offset = set_kpa - good["pressure_kpa"].astype(np.float64)
        at = good.index[(offset.abs() <= MAX_CORRECTION_KPA) & (set_kpa > 0.0)]
        out.loc[at, value] = good.loc[at, value] + slope[at] * offset[at]
        noise, by_pressure = good.loc[at, f"u_{value}_noise"], good.loc[at, "u_pressure_kpa_noise"]
        out.loc[at, f"u_{value}_noise"] = np.hypot(noise, slope[at] * by_pressure)
        out.loc[at, "pressure_kpa"] = set_kpa[at]
    return out


def _slopes(points: pd.DataFrame, value: str) -> pd.Series:
    """Slope of the own branch at each point of a trial; NaN without neighbours."""
    slopes = points["pressure_kpa"].astype(np.float64) * np.nan
    up = points[points["direction"] == "up"]
    turn = points["set_pressure_kpa"].max()
    for direction, branch in points.groupby("direction", sort=False):
        at_turn = (branch["set_pressure_kpa"] == turn) & (direction == "down") & bool(len(up))
        branch = branch[~at_turn].sort_values("pressure_kpa", kind="stable")
        p = branch["pressure_kpa"].to_numpy(dtype=np.float64)
        if len(p) >= 2 and (np.diff(p) > 0).all():
            slopes[branch.index] = np.gradient(branch[value].to_numpy(dtype=np.float64), p)
    top = slopes[up.index[up["set_pressure_kpa"] == turn]]
    if len(top):
        down = (points["direction"] == "down") & (points["set_pressure_kpa"] == turn)
        slopes[points.index[down]] = float(top.iloc[-1])
    return slopes
