"""The time line of a run: pressure, force, and the times of its points."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from analysis.figures.drawing import (
    DOUBLE_COLUMN,
    INK,
    MEASURED,
    SET,
    new_figure,
    style,
)
from daq.errors import RecordError
from plant.arrays import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from daq.store.run import Run


def timeline_figure(run: Run) -> Figure | None:
    """Set-point and measured pressure, force, and the times of the points; None without samples.

    The curves are decimated to their min/max envelope, so that short events stay visible. The
    force is drawn from the first tare on, because earlier balance readings are not forces.
    """
    try:
        valve, balance = run.samples("valve"), run.samples("balance")
    except RecordError:
        return None
    if not len(valve.get("seq", ())):
        return None
    pressure_cal, force_cal = run.calibration("pressure_kpa"), run.calibration("force_n")
    start_ns = int(valve["host_ns"][0])
    time_s = (valve["host_ns"].astype(np.int64) - start_ns) / 1e9
    pressure = np.asarray(pressure_cal.apply(valve["counts"].astype(np.float64)))
    setpoint = np.asarray(pressure_cal.apply(valve["setpoint_x16"] / 16.0))
    tares = [event["t_ns"] for event in run.events if event.get("kind") == "tare"]
    forces = run.manifest.get("protocol") == "simulate" or bool(tares)
    with style():
        if forces:
            figure, (top, bottom) = new_figure(DOUBLE_COLUMN, 4.2, rows=2, sharex=True)
        else:
            figure, top = new_figure(DOUBLE_COLUMN, 2.6)
            bottom = top
        top.plot(*broken(*min_max(time_s, setpoint)), color=SET, linewidth=1.4, label="set-point")
        drawn = broken(*min_max(time_s, pressure))
        top.plot(*drawn, color=MEASURED, linewidth=0.7, label="measured")
        top.set_ylabel("pressure (kPa)")
        if forces and len(balance.get("grams", ())):
            force = np.asarray(force_cal.apply(balance["grams"].astype(np.float64)))
            force_ns = balance["host_ns"].astype(np.int64)
            zero_ns = int(run.manifest["started"]["monotonic_ns"])
            tared = force_ns >= (zero_ns + tares[0] if tares else 0)
            force_s = (force_ns[tared] - start_ns) / 1e9
            bottom.plot(
                *broken(*min_max(force_s, force[tared])),
                color=MEASURED,
                linewidth=0.8,
                label="force",
            )
        if forces:
            bottom.set_ylabel("force (N)")
            figure.align_ylabels([top, bottom])
        bottom.set_xlabel("time since the first sample (s)")
        middles = _point_times(run, valve["seq"], time_s)
        top.plot(
            middles, np.full(len(middles), 0.03), "|", color=INK, markersize=7,
            transform=top.get_xaxis_transform(), label="settled point",
        )  # fmt: skip
        top.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, fontsize=8)
    return figure


ENVELOPE_BINS = 1200
GAP_S = 1.0


def broken(x: Array, y: Array) -> tuple[Array, Array]:
    """A curve with a gap where nothing was recorded for a second and more."""
    steps = np.diff(x)
    if not len(steps):
        return x, y
    gaps = np.flatnonzero(steps > max(GAP_S, 5.0 * float(np.percentile(steps, 90)))) + 1
    return np.insert(x, gaps, np.nan), np.insert(y, gaps, np.nan)


def min_max(x: Array, y: Array) -> tuple[Array, Array]:
    """The min/max envelope: minimum, then maximum of each of 1200 equal ranges of samples."""
    if len(x) <= 2 * ENVELOPE_BINS:
        return x, y
    edges = np.linspace(0, len(x), ENVELOPE_BINS + 1).astype(int)[:-1]
    low, high = np.minimum.reduceat(y, edges), np.maximum.reduceat(y, edges)
    return np.repeat(x[edges], 2), np.column_stack([low, high]).ravel()


def on_spans(seconds: Array, on: npt.NDArray[np.bool_]) -> list[tuple[float, float]]:
    """(begin, length) of each time in which a signal was on, exact to the sample.

    A sample counts until the next one. Of a signal that switches more often than the figure can
    show, spans within the same of 1200 equal ranges of samples are joined: its envelope.
    """
    if not len(on):
        return []
    edges = np.diff(np.concatenate(([0], on.astype(np.int8), [0])))
    first, end = np.flatnonzero(edges > 0), np.flatnonzero(edges < 0)
    if len(first) > ENVELOPE_BINS:
        bins = np.linspace(0, len(on), ENVELOPE_BINS + 1).astype(int)
        in_bin = np.searchsorted(bins, first, side="right")
        new = np.concatenate(([True], in_bin[1:] != in_bin[:-1]))
        first, end = first[new], end[np.concatenate((new[1:], [True]))]
    until = np.append(seconds, 2 * seconds[-1] - seconds[-2] if len(seconds) > 1 else seconds[-1])
    return [(float(a), float(b - a)) for a, b in zip(until[first], until[end], strict=True)]


def _point_times(run: Run, seq: npt.NDArray[Any], time_s: Array) -> Array:
    """Middle of each settled window in s, on the axis of the figure."""
    middles = []
    for event in run.events:
        if event.get("kind") == "point" and "valve_seq" in event:
            first, end = event["valve_seq"]
            index = int(np.searchsorted(seq, (first + end) // 2))
            if index < len(time_s):
                middles.append(float(time_s[index]))
    return np.array(middles)
