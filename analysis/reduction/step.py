"""Reduction of a step test to figures of merit, one row per step."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from analysis.reduction.points import Reduction
from analysis.reduction.valve import ValveRecord
from plant.arrays import Array

if TYPE_CHECKING:
    from daq.store.run import Run

SMOOTH = 5
"""Samples (ms) of the running mean before extremes are taken, so that they are not those of the
noise. No valve here is faster."""
WHOLE = 0.9
"""A step is complete if the samples up to this fraction of its planned time have arrived."""
FIGURES = ("error_kpa", "overshoot_kpa", "ripple_kpa", "rise_s", "settle_s", "switchings_per_s")
LABELS = (
    "scheme", "from_kpa", "set_pressure_kpa", "direction", "repeat", "trial", "slot", "mounting",
    "order", "settled",
)  # fmt: skip
COLUMNS = (*FIGURES, *LABELS, "u_error_kpa", "u_overshoot_kpa", "u_ripple_kpa")


def smoothed(kpa: Array) -> Array:
    """Running mean over ``SMOOTH`` samples."""
    return np.convolve(kpa, np.ones(SMOOTH) / SMOOTH, mode="valid") if len(kpa) >= SMOOTH else kpa


def figures_of_merit(
    kpa: Array, driven: npt.NDArray[np.bool_], goal: float, before: float, last: int, band: float
) -> dict[str, float]:
    """Figures of merit of one step response.

    Args:
        kpa: pressure each ms from the change of the set-point, shape (n,).
        driven: whether each valve was energised, shape (n, 2).
        goal, before: set-points in kPa.
        last: number of samples at the end for error and ripple.
        band: half-width of the tolerance band in kPa.

    Returns:
        ``error_kpa`` (absolute difference of the mean over the last samples from the goal),
        ``overshoot_kpa`` (beyond the goal, at least 0), ``ripple_kpa`` (range in the last
        samples), ``rise_s`` (to 90 % of the step), ``settle_s`` (last time outside the band; NaN
        if that is within the last samples) and ``switchings_per_s`` in the last samples. The time
        of a running mean is the middle of its samples; a condition that the first mean fulfils
        has time 0.
    """
    y = smoothed(kpa)
    middle = (len(kpa) - len(y)) // 2
    at_s = 1e-3 * np.concatenate(([0.0], np.arange(1, len(y) + 1) + middle))
    sign = 1.0 if goal >= before else -1.0
    risen = np.flatnonzero(sign * (y - before) >= 0.9 * abs(goal - before))
    outside = np.flatnonzero(np.abs(y - goal) > band)
    settle_s = float(at_s[outside[-1] + 1]) if len(outside) else 0.0
    settled = not len(outside) or outside[-1] < len(y) - last
    edges = np.diff(driven[-last:].astype(np.int8), axis=0) > 0
    return {
        "error_kpa": abs(float(kpa[-last:].mean()) - goal),
        "overshoot_kpa": max(0.0, float((sign * (y - goal)).max())),
        "ripple_kpa": float(np.ptp(y[-last:])),
        "rise_s": float(at_s[risen[0]]) if len(risen) else math.nan,
        "settle_s": settle_s if settled else math.nan,
        "switchings_per_s": float(edges.sum()) / (last * 1e-3),
    }


def unknown(figures: dict[str, Any], received: npt.NDArray[np.bool_], last: int) -> list[str]:
    """Figures that are unknown because samples are missing.

    Args:
        figures: from :func:`figures_of_merit`, with missing samples interpolated.
        received: which samples are real, shape (n,).
        last: as for :func:`figures_of_merit`.
    """
    out = []
    for name in ("rise_s", "settle_s"):
        seconds = figures[name]
        at = round(seconds * 1e3) if math.isfinite(seconds) else 0
        if not received[max(0, at - SMOOTH) : at + 2 * SMOOTH].all():
            out.append(name)
    if not received[:-last].all():
        out.append("overshoot_kpa")
    if not received[-last - SMOOTH :].all():
        out += ["overshoot_kpa", "ripple_kpa", "switchings_per_s", "error_kpa", "settle_s"]
    return out


def reduce_step(run: Run) -> Reduction:
    """Figures of merit of each step, with their uncertainty.

    The uncertainty of error and overshoot includes the calibration. That of overshoot and ripple
    includes the noise of a mean of five samples; an extreme is about three of its standard
    deviations from the mean.
    """
    record = ValveRecord(run, "switching-time")
    p = record.parameters
    last = round(1e3 * float(p.get("last_s", 0.5)))
    planned = round(1e3 * float(p.get("step_s", 0.0)))
    band = float(p.get("band_percent", 3.0)) / 100.0 * float(p.get("supply_kpa", 550.0))
    for event in record.events:
        first, end = record.window_from_set_point(event)
        if end - first < WHOLE * planned:  # the host was delayed; the other samples arrived later
            end = first + planned
        part, received = record.on_time_grid([first, end])
        row: dict[str, Any] = {k: event.get(k) for k in LABELS}
        row["repeat"] = event["replicate"]
        row["settled"] = False
        if int(received.sum()) > last:
            kpa = record.kpa(part["counts"])
            driven = np.column_stack([part["inlet_u5"] > 0, part["vent_u5"] > 0])
            goal, before = float(event["set_pressure_kpa"]), float(event["from_kpa"])
            row.update(figures_of_merit(kpa, driven, goal, before, last, band))
            if not received.all():
                n = int((~received).sum())
                record.notes.append(
                    f"point {event['order']}: {n} samples are missing; figures that depend on"
                    " them are left out"
                )
                row.update(dict.fromkeys(unknown(row, received, last), math.nan))
            # Second differences contain the noise and almost nothing of the slow pressure. Their
            # median is not affected by edges.
            noise = 1.4826 * float(np.median(np.abs(np.diff(kpa, 2)))) / math.sqrt(6.0 * SMOOTH)
            cal = float(record.pressure.u(goal))
            row["u_error_kpa"] = cal
            row["u_overshoot_kpa"] = math.hypot(cal, 3.0 * noise)
            row["u_ripple_kpa"] = 6.0 * noise / 2.0
            row["settled"] = math.isfinite(row["settle_s"])
        else:
            record.notes.append(f"point {event['order']}: too few samples were received")
            row.update(dict.fromkeys(FIGURES, math.nan))
        record.rows.append(row)
    return record.finish_steps(COLUMNS, "steps")
