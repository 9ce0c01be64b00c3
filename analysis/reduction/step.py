"""From the record of a step test to figures of merit, one row a step."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from analysis.reduction.points import Reduction, without_excluded
from analysis.reduction.valve import ValveRecord

if TYPE_CHECKING:
    import pandas as pd

    from daq.store.run import Run

Floats = npt.NDArray[np.float64]
SMOOTH = 5
"""Samples (ms) over which pressure is averaged before its extremes are taken: noise has extremes,
too, and no valve here acts faster."""
WHOLE = 0.9
"""Share of a step's time from which on the samples that had come are those of the whole step."""
FIGURES = ("error_kpa", "overshoot_kpa", "ripple_kpa", "rise_s", "settle_s", "switchings_per_s")
LABELS = (
    "scheme", "from_kpa", "set_pressure_kpa", "direction", "repeat", "trial", "slot", "mounting",
    "order", "settled",
)  # fmt: skip


def smoothed(kpa: Floats) -> Floats:
    """Running mean over ``SMOOTH`` samples."""
    return np.convolve(kpa, np.ones(SMOOTH) / SMOOTH, mode="valid") if len(kpa) >= SMOOTH else kpa


def judge(
    kpa: Floats, driven: npt.NDArray[np.bool_], goal: float, before: float, last: int, band: float
) -> dict[str, float]:
    """Figures of merit of one response.

    Args:
        kpa: pressure each ms from the change of set-point on, shape (n,).
        driven: whether any valve was energised, shape (n, 2).
        goal, before: set-points in kPa.
        last: samples at the end over which error and ripple are taken.
        band: kPa either side of the goal within which a response counts as settled.

    Returns:
        ``error_kpa`` (mean of the last stretch less the goal, as a size), ``overshoot_kpa`` (beyond
        the goal, 0 if never), ``ripple_kpa`` (range in the last stretch), ``rise_s`` (to nine
        tenths of the step), ``settle_s`` (last time outside the band; NaN if that is in the last
        stretch) and ``switchings_per_s`` in the last stretch. A mean counts at its middle; what
        the first of them shows already was so from the change of set-point on.
    """
    y = smoothed(kpa)
    middle = (len(kpa) - len(y)) // 2
    at_s = 1e-3 * np.concatenate(([0.0], np.arange(1, len(y) + 1) + middle))
    sign = 1.0 if goal >= before else -1.0
    tail = y[-last:]
    way = sign * (y - before)
    risen = np.flatnonzero(way >= 0.9 * abs(goal - before))
    outside = np.flatnonzero(np.abs(y - goal) > band)
    quiet_s = float(at_s[outside[-1] + 1]) if len(outside) else 0.0
    settled = not len(outside) or outside[-1] < len(y) - last
    edges = np.diff(driven[-last:].astype(np.int8), axis=0) > 0
    return {
        "error_kpa": abs(float(kpa[-last:].mean()) - goal),
        "overshoot_kpa": max(0.0, float((sign * (y - goal)).max())),
        "ripple_kpa": float(np.ptp(tail)),
        "rise_s": float(at_s[risen[0]]) if len(risen) else math.nan,
        "settle_s": quiet_s if settled else math.nan,
        "switchings_per_s": float(edges.sum()) / (last * 1e-3),
    }


def unknown(figures: dict[str, Any], came: npt.NDArray[np.bool_], last: int) -> list[str]:
    """Figures of a response of which samples are missing that cannot be told any more.

    Args:
        figures: as :func:`judge` gives them, of samples that are filled in.
        came: which of them are real, shape (n,).
        last: as for :func:`judge`.
    """
    out = []
    for name in ("rise_s", "settle_s"):
        seconds = figures[name]
        at = round(seconds * 1e3) if math.isfinite(seconds) else 0
        if not came[max(0, at - SMOOTH) : at + 2 * SMOOTH].all():
            out.append(name)
    if not came[:-last].all():
        out.append("overshoot_kpa")
    if not came[-last - SMOOTH :].all():
        out += ["overshoot_kpa", "ripple_kpa", "switchings_per_s", "error_kpa", "settle_s"]
    return out


def reduce_step(run: Run) -> Reduction:
    """Each step's figures with their uncertainty.

    That of error and overshoot is the calibration's; that of overshoot and ripple also holds the
    noise left in a mean of five samples, of which an extreme shows some three standard deviations.
    """
    record = ValveRecord(run, "switching-time")
    p = record.parameters
    last = round(1e3 * float(p.get("last_s", 0.5)))
    planned = round(1e3 * float(p.get("step_s", 0.0)))
    band = float(p.get("band_percent", 3.0)) / 100.0 * float(p.get("supply_kpa", 550.0))
    rows = []
    for event in record.events:
        first, end = record.asked(event)
        if end - first < WHOLE * planned:  # the program stood still; the rest came in later
            end = first + planned
        part, came = record.on_time([first, end])
        row: dict[str, Any] = {k: event.get(k) for k in LABELS}
        row["repeat"] = event["replicate"]
        if int(came.sum()) > last:
            kpa = record.kpa(part["counts"])
            driven = np.column_stack([part["inlet_u5"] > 0, part["vent_u5"] > 0])
            goal, before = float(event["set_pressure_kpa"]), float(event["from_kpa"])
            row.update(judge(kpa, driven, goal, before, last, band))
            if not came.all():
                n = int((~came).sum())
                record.notes.append(
                    f"point {event['order']}: {n} samples are missing; figures that hang on them"
                    " are left out"
                )
                row.update(dict.fromkeys(unknown(row, came, last), math.nan))
            # Second differences see noise and hardly the gas, their median no edge at all.
            noise = 1.4826 * float(np.median(np.abs(np.diff(kpa, 2)))) / math.sqrt(6.0 * SMOOTH)
            cal = float(record.pressure.u(goal))
            row["u_error_kpa"] = cal
            row["u_overshoot_kpa"] = math.hypot(cal, 3.0 * noise)
            row["u_ripple_kpa"] = 6.0 * noise / 2.0
            row["settled"] = math.isfinite(row["settle_s"])
        else:
            record.notes.append(f"point {event['order']}: too few samples survived")
            row.update(dict.fromkeys(FIGURES, math.nan))
            row["settled"] = False
        rows.append(row)
    if run.outcome != "clean":
        record.notes.append(f"the run is {run.outcome}: the table holds the {len(rows)} steps made")
    table = _frame(rows)
    return without_excluded(
        run, Reduction(table, tuple(record.notes), {"pressure_kpa": record.pressure})
    )


def _frame(rows: list[dict[str, Any]]) -> pd.DataFrame:
    import pandas as pd

    u = ("u_error_kpa", "u_overshoot_kpa", "u_ripple_kpa")
    frame = pd.DataFrame(rows, columns=[*FIGURES, *LABELS, *u])
    for column in frame:
        if column in ("scheme", "direction", "slot", "mounting"):
            frame[column] = frame[column].astype(str)
        elif column in ("repeat", "trial", "order"):
            frame[column] = frame[column].astype("int64")
        elif column == "settled":
            frame[column] = frame[column].astype(bool)
        else:
            frame[column] = frame[column].astype("float64")
    return frame.sort_values("order", kind="stable", ignore_index=True)
