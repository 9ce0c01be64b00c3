"""Reduction of the tests of a joint between two muscles to one table of points or steps."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from analysis.reduction.columns import valve_test_frame
from analysis.reduction.points import Reduction, point_events, put_mean, without_excluded
from analysis.reduction.uncertainty import NO_READINGS, WindowMean, window_mean
from daq.errors import RecordError
from daq.store.derive import sample_host_ns
from plant.arrays import Array

if TYPE_CHECKING:
    from daq.calibration import Calibration
    from daq.store.run import Run

SIDES = {"valve": "pressure_a_kpa", "valve_b": "pressure_b_kpa"}
"""Stream of a controller to the column of its muscle's pressure."""
MEASURED = ("pressure_a_kpa", "pressure_b_kpa", "angle_deg", "torque_n_m")
POINT_LABELS = (
    "state", "direction", "repeat", "common_kpa", "difference_kpa", "set_a_kpa", "set_b_kpa",
    "set_angle_deg", "trial", "slot", "mounting", "order", "settled",
)  # fmt: skip
POINT_COLUMNS = (
    *MEASURED, *POINT_LABELS, "n_samples",
    *(f"u_{name}{part}" for part in ("", "_noise", "_cal") for name in MEASURED),
)  # fmt: skip
STEP_FIGURES = (
    "start_deg", "final_deg", "rise_s", "peak_s", "overshoot_deg", "settle_s", "skew_s",
)  # fmt: skip
STEP_LABELS = (
    "direction", "repeat", "common_kpa", "from_kpa", "difference_kpa", "trial", "slot", "mounting",
    "order", "settled",
)  # fmt: skip
STEP_COLUMNS = (
    *STEP_FIGURES, *STEP_LABELS, "u_start_deg", "u_final_deg", "u_rise_s", "u_peak_s",
    "u_overshoot_deg", "u_settle_s",
)  # fmt: skip
CLOCK_S = 1e-3
"""Standard uncertainty of a reading's time beside its period: of the clock fit and of the line."""


class JointRecord:
    """The streams of a run on a joint, with their calibrations.

    Args:
        run: an opened run.

    Attributes:
        notes: defects, for the reader.
        angle, torque: streams of the instruments; ``torque`` may be "".

    Raises:
        RecordError: the record states no joint.
    """

    def __init__(self, run: Run) -> None:
        self.run = run
        self.notes: list[str] = []
        self.joint: dict[str, Any] = dict(run.manifest["joint"])
        self.angle, self.torque = str(self.joint["angle"]), str(self.joint["torque"])
        self._streams: dict[str, dict[str, npt.NDArray[Any]]] = {}
        self.pressures = {
            "valve": run.calibration("pressure_kpa"),
            "valve_b": run.calibration("pressure_b_kpa"),
        }
        own = run.instrument_calibrations
        self.calibrations: dict[str, Calibration] = {
            "pressure_kpa": self.pressures["valve"],
            "pressure_b_kpa": self.pressures["valve_b"],
            **{own[name].quantity: own[name] for name in (self.angle, self.torque) if name},
        }
        self.angles = own[self.angle]
        self.torques = own[self.torque] if self.torque else None

    def stream(self, name: str) -> dict[str, npt.NDArray[Any]]:
        """Columns of a stream; empty, with a note, where it is lost."""
        if name not in self._streams:
            try:
                self._streams[name] = dict(self.run.samples(name))
            except RecordError as error:
                self.notes.append(str(error))
                self._streams[name] = {}
        return self._streams[name]

    def values(self, event: Mapping[str, Any], name: str, column: str) -> npt.NDArray[Any]:
        """A column over the samples or readings that an event names."""
        key = "seq" if column == "counts" else "row"
        stream = self.stream(name)
        span = event.get(f"{name}_seq" if key == "seq" else f"{name}_rows")
        if span is None or key not in stream:
            return np.zeros(0)
        found: npt.NDArray[Any] = stream[column][(stream[key] >= span[0]) & (stream[key] < span[1])]
        if (missing := span[1] - span[0] - len(found)) and event.get("kind") == "point":
            self.notes.append(f"point {event['order']}: {missing} of {name} are missing")
        return found

    def pressure(self, event: Mapping[str, Any], name: str) -> WindowMean:
        """Mean pressure behind a controller."""
        counts = self.values(event, name, "counts")
        calibration = self.pressures[name]
        return window_mean(calibration.apply(counts), abs(calibration.scale))

    def angle_mean(self, event: Mapping[str, Any]) -> WindowMean:
        """Mean angle in degrees; of marks with the uncertainty of a picture in quadrature."""
        readings = self.values(event, self.angle, "reading")
        mean = window_mean(self.angles.apply(readings))
        return replace(mean, u=math.hypot(mean.u, self.u_picture_deg(event)))

    def u_picture_deg(self, event: Mapping[str, Any]) -> float:
        """Standard uncertainty of the angle in one picture; 0 where no marks give it.

        Pictures of a link at rest err in the same way, so that a mean is not better than one of
        them; at another angle they err in another way.
        """
        if "u_deg" not in self.stream(self.angle):
            return 0.0
        each = self.values(event, self.angle, "u_deg")
        return float(np.mean(each)) if len(each) else 0.0

    def torque_mean(self, event: Mapping[str, Any]) -> WindowMean:
        """Mean torque in N m; of a load cell its force times the lever."""
        if self.torques is None:
            return NO_READINGS
        readings = self.values(event, self.torque, "reading")
        return window_mean(self.torques.apply(readings) * self.lever_m)

    @property
    def lever_m(self) -> float:
        """Metres of lever for a reading in newtons; 1 for a reading in newton metres."""
        lever_mm = float(self.joint.get("lever_mm") or 0.0)
        return lever_mm * 1e-3 if lever_mm else 1.0

    @property
    def torque_zero_n_m(self) -> float:
        """Standard uncertainty of the torque's zero."""
        return 0.0 if self.torques is None else self.torques.u_offset * self.lever_m

    @property
    def torque_gain(self) -> float:
        """Relative standard uncertainty of the torque, that of the lever included."""
        if self.torques is None:
            return 0.0
        lever_mm = float(self.joint.get("lever_mm") or 0.0)
        u_lever = float(self.joint.get("u_lever_mm") or 0.0) / lever_mm if lever_mm else 0.0
        return math.hypot(self.torques.u_gain, u_lever)

    def u_torque(self, torque_n_m: float) -> float:
        """Standard uncertainty of a torque by calibration and lever."""
        return math.hypot(self.torque_zero_n_m, self.torque_gain * torque_n_m)

    def finish(self, rows: list[dict[str, Any]], columns: tuple[str, ...], what: str) -> Reduction:
        """The table, with the notes of this record."""
        if self.run.outcome != "clean":
            self.notes.append(
                f"the run is {self.run.outcome}: the table holds the {len(rows)} {what} it reached"
            )
        if unsettled := sum(not row["settled"] for row in rows):
            self.notes.append(f"{unsettled} {what} did not settle (column settled)")
        table = valve_test_frame(rows, columns)
        zeros = tuple(
            {
                "trial": event["trial"],
                "when": event["when"],
                "pressure_kpa": mean.mean,
                "u_pressure_kpa": mean.u,
            }
            for event in self.run.events
            if event.get("kind") == "zero"
            for mean in (self.pressure(event, "valve"),)
        )
        made = Reduction(table, tuple(self.notes), self.calibrations, zeros)
        return without_excluded(self.run, made)


def reduce_joint_static(run: Run) -> Reduction:
    """One row per point: both pressures, angle and torque, each with both parts of its uncertainty.

    ``u_*_noise`` is estimated from the window, ``u_*_cal`` is common to all points.
    """
    record = JointRecord(run)
    rows = []
    for event in point_events(run):
        row: dict[str, Any] = {name: event.get(name) for name in POINT_LABELS}
        row["repeat"], row["settled"] = event["replicate"], bool(event["settled"])
        if row["set_angle_deg"] is None:
            row["set_angle_deg"] = math.nan
        for stream, column in SIDES.items():
            mean = record.pressure(event, stream)
            put_mean(row, column, mean, float(record.pressures[stream].u(mean.mean)))
            row["n_samples"] = float(mean.n)
        angle, torque = record.angle_mean(event), record.torque_mean(event)
        put_mean(row, "angle_deg", angle, float(record.angles.u(angle.mean)))
        put_mean(row, "torque_n_m", torque, record.u_torque(torque.mean))
        rows.append(row)
    return record.finish(rows, POINT_COLUMNS, "points")


def reduce_joint_step(run: Run) -> Reduction:
    """One row per step of the differential pressure: figures of the angle's answer.

    Time counts from the sample in which the first of both set-points changed; ``skew_s`` is how
    much later the other one did.
    """
    record = JointRecord(run)
    parameters = run.manifest.get("parameters") or {}
    last_s = float(parameters.get("last_s", 0.5))
    band = float(parameters.get("band_percent", 5.0)) / 100.0
    rows = []
    for event in point_events(run):
        row: dict[str, Any] = {name: event.get(name) for name in STEP_LABELS}
        row["repeat"], row["settled"] = event["replicate"], False
        row |= dict.fromkeys(STEP_COLUMNS[: len(STEP_FIGURES)], math.nan)
        answer = angle_answer(record, event)
        if answer is None:
            record.notes.append(f"point {event['order']}: no change of a set-point, or no angle")
        else:
            time_s, angle_deg, row["skew_s"] = answer
            u_picture = record.u_picture_deg(event)
            made = angle_figures(time_s, angle_deg, last_s, band, u_picture)
            row |= made
            u_zero, u_gain = record.angles.u_offset, record.angles.u_gain
            for name in ("start_deg", "final_deg"):
                row[f"u_{name}"] = math.hypot(made[f"u_{name}"], u_zero, u_gain * made[name])
            row["u_overshoot_deg"] = math.hypot(
                made["u_overshoot_deg"], u_gain * made["overshoot_deg"]
            )
            row["settled"] = math.isfinite(made["settle_s"])
        rows.append(row)
    return record.finish(rows, STEP_COLUMNS, "steps")


def angle_answer(
    record: JointRecord, event: Mapping[str, Any]
) -> tuple[Array, Array, float] | None:
    """The angle around a step: times in s from the step, angles in degrees, and the skew in s.

    None where no set-point changed in the samples, or the angle is missing.
    """
    changed_ns = []
    for name in SIDES:
        stream, span = record.stream(name), event.get(f"{name}_seq")
        if span is None or "seq" not in stream:
            return None
        inside = (stream["seq"] >= span[0]) & (stream["seq"] < span[1])
        part = {column: values[inside] for column, values in stream.items()}
        at = np.flatnonzero(part["setpoint_x16"] != part["setpoint_x16"][:1])
        if len(at):
            changed_ns.append(int(sample_host_ns(record.run, name, part)[at[0]]))
    encoder = record.stream(record.angle)
    span = event.get(f"{record.angle}_rows")
    if not changed_ns or span is None or "row" not in encoder:
        return None
    use = (encoder["row"] >= span[0]) & (encoder["row"] < span[1])
    if use.sum() < 8:
        return None
    time_s = (encoder["host_ns"][use].astype(np.int64) - min(changed_ns)) * 1e-9
    skew_s = (max(changed_ns) - min(changed_ns)) * 1e-9
    return time_s, record.angles.apply(encoder["reading"][use]), skew_s


def angle_figures(
    time_s: Array, angle_deg: Array, last_s: float, band: float, u_reading_deg: float = 0.0
) -> dict[str, float]:
    """Figures of the answer of an angle to a step, with their uncertainties by noise and sampling.

    Args:
        time_s: from the step, increasing, shape (n,); readings before 0 give the start.
        angle_deg: shape (n,).
        last_s: the end of the stretch gives the final angle.
        band: half-width of the tolerance band, as a share of the step.
        u_reading_deg: standard uncertainty of one reading at rest that its scatter does not show.

    Returns:
        ``start_deg`` and ``final_deg``; ``rise_s``: from 10 to 90 % of the step; ``peak_s``: until
        the largest excursion; ``overshoot_deg``: beyond the final angle, at least 0; ``settle_s``:
        until the angle stays in the band, NaN if that is within the last part; and their ``u_``.
    """
    before, end = time_s <= 0.0, time_s > time_s[-1] - last_s
    start = window_mean(angle_deg[before] if before.any() else angle_deg[:1])
    final = window_mean(angle_deg[end])
    sign = 1.0 if final.mean >= start.mean else -1.0
    size = abs(final.mean - start.mean)
    after, progress = time_s[~before], sign * (angle_deg[~before] - start.mean)
    noise = 1.4826 * float(np.median(np.abs(np.diff(angle_deg, 2)))) / math.sqrt(6.0)
    noise = math.hypot(noise, u_reading_deg)
    period_s = float(np.median(np.diff(time_s)))
    low, u_low = _crossing(after, progress, 0.1 * size, noise)
    high, u_high = _crossing(after, progress, 0.9 * size, noise)
    peak = int(np.argmax(progress))
    over = float(progress[peak]) - size
    out = {
        "start_deg": start.mean,
        "u_start_deg": math.hypot(start.u, u_reading_deg) if start.n > 1 else noise,
        "final_deg": final.mean, "u_final_deg": math.hypot(final.u, u_reading_deg),
        "rise_s": high - low, "u_rise_s": math.hypot(u_low, u_high, CLOCK_S),
        "peak_s": float(after[peak]), "u_peak_s": math.hypot(period_s, CLOCK_S),
        "overshoot_deg": max(0.0, over),
        "u_overshoot_deg": math.hypot(2.0 * noise, final.u, _between(progress, peak)),
    }  # fmt: skip
    outside = np.flatnonzero(np.abs(progress - size) > band * size)
    settled = not len(outside) or after[outside[-1]] <= time_s[-1] - last_s
    at = float(after[outside[-1]]) + period_s / 2.0 if len(outside) else 0.0
    out["settle_s"] = at if settled and size > 0.0 else math.nan
    slope = _slope(after, progress, at)
    out["u_settle_s"] = math.hypot(
        period_s / math.sqrt(3.0), CLOCK_S, math.hypot(noise, final.u) / slope if slope else 0.0
    )
    return out


def _crossing(time_s: Array, values: Array, level: float, noise: float) -> tuple[float, float]:
    """First time above a level, between two readings, and its uncertainty by noise and sampling."""
    above = np.flatnonzero(values >= level)
    if not len(above):
        return math.nan, math.nan
    if above[0] == 0:  # between the step, where it is 0, and the first reading after it
        first_s = float(time_s[0])
        return first_s * level / float(values[0]), first_s / math.sqrt(12.0)
    k = int(above[0])
    rise = float(values[k] - values[k - 1])
    step_s = float(time_s[k] - time_s[k - 1])
    at = float(time_s[k - 1]) + step_s * (level - float(values[k - 1])) / rise
    slope = _slope(time_s, values, at)
    bend = float(np.abs(np.diff(values[max(k - 2, 0) : k + 2], 2)).max(initial=0.0)) / 8.0
    return at, math.hypot(noise, bend) / slope if slope else step_s


def _between(values: Array, peak: int) -> float:
    """How much higher a peak may be than the highest reading, by the parabola through three."""
    if not 0 < peak < len(values) - 1:
        return 0.0
    low, top, high = (float(v) for v in values[peak - 1 : peak + 2])
    bend = 2.0 * top - low - high
    return (high - low) ** 2 / (8.0 * bend) if bend > 0.0 else 0.0


def _slope(time_s: Array, values: Array, at_s: float, readings: int = 3) -> float:
    """Size of the mean slope around a time, from the readings next to it."""
    k = int(np.clip(np.searchsorted(time_s, at_s), readings, max(len(time_s) - readings, readings)))
    part = slice(max(k - readings, 0), k + readings)
    if len(time_s[part]) < 3:
        return 0.0
    return abs(float(np.polyfit(time_s[part], values[part], 1)[0]))
