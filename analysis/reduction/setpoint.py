"""Points brought to their set pressures: what a cycle compares must be at one pressure.

A valve leaves the pressure anywhere in its dead zone, and a regulator comes from below on the
way up and from above on the way down; taken at face value that difference would pass for
hysteresis.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import pandas as pd

FARTHEST_KPA = 10.0
"""A point further away than this from its set pressure is left as it is."""


def at_set_pressure(table: pd.DataFrame, value: str) -> pd.DataFrame:
    """The table with ``value`` moved to each point's set pressure.

    Along the curve of its own trial and direction, by the slope between its neighbours. What
    the pressure's noise leaves unknown goes into ``u_VALUE_noise``; ``pressure_kpa`` becomes
    the set pressure. Vented points and those of a trial without neighbours stay.

    Args:
        table: settled points.
        value: "force_n" or "length_mm".
    """
    out = table.copy()
    for _, rows in table.groupby(["trial", "direction"], sort=False):
        good = rows.dropna(subset=["pressure_kpa", value, "set_pressure_kpa"])
        good = good.sort_values("pressure_kpa", kind="stable")
        p = good["pressure_kpa"].to_numpy(dtype=np.float64)
        if len(p) < 2 or (np.diff(p) <= 0).any():
            continue
        slope = np.gradient(good[value].to_numpy(dtype=np.float64), p)
        away = good["set_pressure_kpa"].to_numpy(dtype=np.float64) - p
        use = (np.abs(away) <= FARTHEST_KPA) & (good["set_pressure_kpa"].to_numpy() > 0.0)
        at = good.index[use]
        out.loc[at, value] = good.loc[at, value] + slope[use] * away[use]
        noise = good.loc[at, f"u_{value}_noise"].to_numpy(dtype=np.float64)
        by_pressure = slope[use] * good.loc[at, "u_pressure_kpa_noise"].to_numpy(dtype=np.float64)
        out.loc[at, f"u_{value}_noise"] = np.hypot(noise, by_pressure)
        out.loc[at, "pressure_kpa"] = good.loc[at, "set_pressure_kpa"]
    return out
