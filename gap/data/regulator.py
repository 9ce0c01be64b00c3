"""What a run says of the regulator that made its pressures, where the rig file names its dynamics.

Forces are compared at the measured pressure, so that a regulator's dead time, lag, dead band and
hysteresis are not in the gap of a muscle. What the pressure itself departs from the set-points is
explained here by the regulator's calibration, or it is not.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from analysis.reduction.points import point_events
from analysis.regression.regulator import Regulator, respond
from daq.store.derive import VALVE_STREAM, engineering
from daq.store.run import Run

OPEN = 0.99
BEYOND_U = 3.0
"""More than so many standard uncertainties: the regulator is not as it was calibrated."""


def regulator_notes(run: Run) -> tuple[str, ...]:
    """One note for a run with a calibrated regulator; none for others."""
    given = run.manifest.get("regulator")
    points = [e for e in point_events(run) if "valve_seq" in e]
    if not isinstance(given, dict) or not points:
        return ()
    u = given.get("u", {})
    values = {name: value for name, value in given.items() if name not in ("u", "date")}
    regulator = Regulator(**{k: math.inf if v is None else float(v) for k, v in values.items()})
    columns, _ = engineering(run, VALVE_STREAM)
    time_s = np.asarray(columns["time_s"], dtype=np.float64)
    kpa = np.asarray(columns["pressure_kpa"], dtype=np.float64)
    sets = _set_points(run, columns, time_s)
    if not sets:
        return ()
    at = [_window(event, np.asarray(columns["seq"])) for event in points]
    measured = np.array([kpa[low:high].mean() for low, high in at])
    middle_s = np.array([time_s[(low + high) // 2] for low, high in at])
    order = np.argsort(middle_s)
    measured, middle_s = measured[order], middle_s[order]
    wanted = np.array([p for _, p in sets])[
        np.searchsorted([t for t, _ in sets], middle_s, side="right") - 1
    ]
    used = wanted > 0.0
    if not used.any():
        return ()
    expected = respond(
        regulator, np.array([t for t, _ in sets]), np.array([p for _, p in sets]), middle_s
    )
    apart = measured - wanted
    left = float(np.sqrt(np.mean((measured - expected)[used] ** 2)))
    top = float(wanted.max())
    known = math.hypot(
        float(u.get("offset_kpa", 0.0)),
        float(u.get("gain_error", 0.0)) * top,
        float(u.get("hysteresis_kpa", 0.0)),
        regulator.dead_band_kpa / math.sqrt(3.0),
    )
    text = (
        f"{run.run_id}: pressures rest up to {np.abs(apart[used]).max():.1f} kPa from their"
        f" set-points; the regulator's calibration ({given.get('date', '')}) leaves {left:.1f} kPa"
        f" of it (its standard uncertainty is {known:.1f} kPa)"
    )
    if left > BEYOND_U * known:
        return (f"{text}: the regulator is not as it was calibrated",)
    return (f"{text}: regulator, not muscle",)


def _window(event: dict[str, Any], seq: Any) -> tuple[int, int]:
    low, high = np.searchsorted(seq, event["valve_seq"])
    return int(low), max(int(high), int(low) + 1)


def _set_points(run: Run, columns: Any, time_s: Any) -> list[tuple[float, float]]:
    """When each set-point was commanded, and 0 where the outlet opened: (s, kPa), in order."""
    found = [
        (e["t_ns"] * 1e-9, float(e["pressure_kpa"]))
        for e in run.events
        if e["kind"] == "command" and "pressure_kpa" in e
    ]
    venting = np.asarray(columns["outlet_cmd"]) > OPEN
    begins = np.flatnonzero(venting[1:] & ~venting[:-1]) + 1
    return sorted([*found, *((float(time_s[k]), 0.0) for k in begins)])
