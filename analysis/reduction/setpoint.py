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

    The slope is that between the neighbours in the same trial and direction. The noise of the
    pressure is added to ``u_VALUE_noise``. ``pressure_kpa`` becomes the set pressure. Vented
    points and points without neighbours stay unchanged.

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
        offset = good["set_pressure_kpa"].to_numpy(dtype=np.float64) - p
        use = np.abs(offset) <= MAX_CORRECTION_KPA
        use &= good["set_pressure_kpa"].to_numpy() > 0.0
        at = good.index[use]
        out.loc[at, value] = good.loc[at, value] + slope[use] * offset[use]
        noise = good.loc[at, f"u_{value}_noise"].to_numpy(dtype=np.float64)
        by_pressure = slope[use] * good.loc[at, "u_pressure_kpa_noise"].to_numpy(dtype=np.float64)
        out.loc[at, f"u_{value}_noise"] = np.hypot(noise, by_pressure)
        out.loc[at, "pressure_kpa"] = good.loc[at, "set_pressure_kpa"]
    return out
