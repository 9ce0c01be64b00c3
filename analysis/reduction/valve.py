"""Reduction of a valve test to its table, from raw counts, blocks and voltages."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from analysis.reduction.columns import valve_test_frame
from analysis.reduction.points import Reduction, point_events, without_excluded
from analysis.reduction.uncertainty import window_mean
from analysis.reduction.valve_points import columns_of, imported_points, labels_of, put
from daq.errors import DeviceError, RecordError
from plant.arrays import Array

if TYPE_CHECKING:
    from daq.store.run import Run

Samples = dict[str, npt.NDArray[Any]]
BEFORE = 20
"""Number of pressure samples before a pulse that give the upstream pressure."""
AROUND = 3
"""Number of pressure samples on each side of the end of a pulse."""
WHOLE = 0.97
"""Required fraction of the samples between two readings of the meter (1 kHz)."""
ALIKE = 0.85
"""Readings of one opening are averaged down to this fraction of their highest pressure."""


class ValveRecord:
    """The streams and point events of a valve test, and the rows and notes of its table."""

    def __init__(self, run: Run, protocol: str) -> None:
        self.run = run
        self.protocol = protocol
        self.events = point_events(run)
        self.parameters: dict[str, Any] = dict(run.manifest.get("parameters") or {})
        self.notes: list[str] = []
        self.pressure = run.calibration("pressure_kpa")
        self.valve = self.stream("valve")
        self.rows: list[dict[str, Any]] = []

    def stream(self, name: str) -> Samples:
        """The columns of a stream. If it is lost, none are returned and a note is added."""
        try:
            return self.run.samples(name)
        except RecordError as error:
            self.notes.append(str(error))
            return {}

    def samples(self, window: list[int]) -> Samples:
        """The valve's samples of a half-open range of sequence numbers."""
        if not self.valve:
            return {}
        seq = self.valve["seq"]
        inside = (seq >= window[0]) & (seq < window[1])
        return {name: values[inside] for name, values in self.valve.items()}

    def window_from_set_point(self, event: Mapping[str, Any]) -> list[int]:
        """The window of a point, starting at the sample when its set-point was sent.

        The window in the event starts with the newest sample that the host had then, about 50 ms
        earlier. Older records do not hold the time of the set-point; for them that window is
        returned.
        """
        first, end = event["valve_seq"]
        sent_ns = event.get("asked_t_ns")
        part = self.samples([first, end])
        if sent_ns is None or not len(part.get("device_us", ())):
            return [first, end]
        sent_ns += int(self.run.manifest["started"]["monotonic_ns"])
        # Device times, shifted to the sample with the smallest latency. A clock fit would not be
        # valid after a restart, and over some seconds it is not necessary.
        device_ns = part["device_us"] * 1000
        host_ns = device_ns + (part["host_ns"] - device_ns).min()
        later = host_ns >= sent_ns
        if not later.any():
            return [first, end]
        at, seq = int(np.argmax(later)), part["seq"]
        lost = int((host_ns[at] - sent_ns) // 1_000_000)  # samples missing before this one
        return [max(first, int(seq[at]) - lost), end]

    def on_time_grid(self, window: list[int]) -> tuple[Samples, npt.NDArray[np.bool_]]:
        """The valve's samples of a range, one per millisecond, and which of them were received.

        Missing counts are interpolated; all other columns repeat the sample before. If no sample
        was received, both results are empty.
        """
        part = self.samples(window)
        if not len(part.get("counts", ())):
            return {}, np.zeros(0, dtype=bool)
        grid = np.arange(window[0], window[1])
        before = np.maximum(np.searchsorted(part["seq"], grid, side="right") - 1, 0)
        out = {name: values[before] for name, values in part.items()}
        out["counts"] = np.interp(grid, part["seq"], part["counts"])
        return out, np.isin(grid, part["seq"])

    def kpa(self, counts: npt.NDArray[Any]) -> Array:
        """Counts as pressure."""
        return np.asarray(self.pressure.apply(counts.astype(np.float64)), dtype=np.float64)

    def add_failed(self, row: dict[str, Any], names: Iterable[str], why: str) -> None:
        """Set these quantities of a point to NaN, mark it as not settled and add a note."""
        self.notes.append(f"point {row['order']} ({row['slot']} kPa): {why}")
        for name in names:
            put(row, name)
        row["settled"] = False

    def finish(self, calibrations: Mapping[str, Any] = {}) -> Reduction:
        """The table without the points that were excluded after the run."""
        unsettled = sum(not row["settled"] for row in self.rows)
        notes = [f"{unsettled} points are marked as invalid (column settled)"] if unsettled else []
        return self._reduction(
            columns_of(self.protocol), f"{len(self.rows)} points it reached", notes, calibrations
        )

    def finish_steps(self, columns: Iterable[str], what: str) -> Reduction:
        """The same for a test of steps or moves, with columns of its own."""
        return self._reduction(columns, f"{len(self.rows)} {what} made", [], {})

    def _reduction(
        self,
        columns: Iterable[str],
        held: str,
        notes: Iterable[str],
        calibrations: Mapping[str, Any],
    ) -> Reduction:
        if self.run.outcome != "clean":
            self.notes.append(f"the run is {self.run.outcome}: the table holds the {held}")
        table = valve_test_frame(self.rows, columns)
        found = {"pressure_kpa": self.pressure, **calibrations}
        return without_excluded(self.run, Reduction(table, (*self.notes, *notes), found))


def reduce_switching_time(run: Run) -> Reduction:
    """Delays from the blocks, with the pressure at each edge of the command.

    A point is one block: ``on_ms``, ``off_ms``, ``pressure_kpa`` (upstream, before the pulse) and
    ``off_pressure_kpa`` (upstream, at its end; for the inlet it is the constant supply).
    """
    if (imported := imported_points(run, "switching-time")) is not None:
        return imported
    from analysis.reduction.switching import Block, air_delay_ms, switching_times

    record = ValveRecord(run, "switching-time")
    p = record.parameters
    blocks = record.stream("capture")
    delay_ms = air_delay_ms(p.get("line_mm", 62.0), p.get("air_m_s", 65.0))
    u_delay = delay_ms * math.hypot(
        p.get("u_line_mm", 0.0) / max(p.get("line_mm", 62.0), 1e-9),
        p.get("u_air_m_s", 0.0) / p.get("air_m_s", 65.0),
    )
    for event in record.events:
        row = labels_of(event)
        on_kpa, off_kpa, noise = _upstream(record, event)
        cal = float(record.pressure.u(on_kpa)) if event["valve"] == "outlet" else p["u_supply_kpa"]
        put(row, "pressure_kpa", on_kpa, noise, cal)
        put(row, "off_pressure_kpa", off_kpa, noise, cal)
        put(row, "air_delay_ms", delay_ms, 0.0, u_delay)
        a, b = event["capture_rows"]
        counts = blocks["counts"][a:b].astype(np.float64) if "counts" in blocks else np.empty(0)
        block = Block(
            event["valve"], event["width_us"], event["lead_us"], event["period_us"], counts
        )
        try:
            if len(counts) < b - a:
                raise DeviceError(event["slot"], "samples of its block were lost")
            found = switching_times(block, delay_ms)
            # The position of an edge is known to one sample period at best. It is nearly the same
            # in every block, because pulse and samples are synchronous.
            period_ms = block.period_us * 1e-3
            noise, common = period_ms / math.sqrt(12.0), period_ms / math.sqrt(3.0)
            put(row, "on_ms", found.on_ms, noise, math.hypot(u_delay, common))
            put(row, "off_ms", found.off_ms, noise, math.hypot(u_delay, common))
        except DeviceError as error:
            record.add_failed(row, ("on_ms", "off_ms"), error.what)
        record.rows.append(row)
    record.notes.append(
        f"corrected for propagation delay to the sensor: {p.get('line_mm', 62.0):g} mm at"
        f" {p.get('air_m_s', 65.0):g} m/s, {delay_ms:.3f} ± {2 * u_delay:.3f} ms (k = 2)"
    )
    return record.finish()


def _upstream(record: ValveRecord, event: Mapping[str, Any]) -> tuple[float, float, float]:
    """Pressure upstream of the tested valve at both edges of its command, and its noise."""
    if event["valve"] == "inlet":
        return float(event["supply_kpa"]), float(event["supply_kpa"]), 0.0
    part = record.samples(event["valve_seq"])
    driven = np.flatnonzero(part["vent_u5"] > 0) if "vent_u5" in part else np.empty(0, dtype=int)
    if not len(driven):
        return math.nan, math.nan, math.nan
    kpa = record.kpa(part["counts"])
    first, last = int(driven[0]), int(driven[-1])
    before = window_mean(kpa[max(0, first - BEFORE) : first + 1], abs(record.pressure.scale))
    around = kpa[max(first, last - AROUND) : last + AROUND + 1]
    return before.mean, float(around.mean()), max(before.u, 0.0)


def reduce_flow(run: Run) -> Reduction:
    """Velocity and pressure over the same periods while the valve was open.

    A reading of the meter is the mean since the reading before. It is used if that period lies
    completely within the opening, without the delay of the valve.
    """
    if (imported := imported_points(run, "flow")) is not None:
        return imported
    from daq.store.derive import sample_host_ns

    record = ValveRecord(run, "flow")
    meter = run.instrument_calibrations.get("flow")
    readings = record.stream("flow")
    host_ns = sample_host_ns(run, "valve", record.valve) if record.valve else np.empty(0)
    lead_ns = round(float(record.parameters.get("lead_ms", 15.0)) * 1e6)
    for event in record.events:
        row = labels_of(event)
        pairs = _pairs(record, event, readings, host_ns, lead_ns)
        if meter is None or not len(pairs):
            why = "no reading of the meter lies completely within the opening"
            record.add_failed(row, ("pressure_kpa", "velocity_m_s"), why)
        else:
            # Flow is not linear in pressure: only readings at similar pressures are averaged.
            pairs = pairs[pairs[:, 0] >= ALIKE * pairs[:, 0].max()]
            v = np.asarray(meter.apply(pairs[:, 1]), dtype=np.float64)
            kpa = pairs[:, 0]
            n = len(pairs)
            # The pressure falls during the readings: the scatter about their line is the noise.
            slope = np.polyfit(kpa, v, 1) if n > 2 and np.ptp(kpa) > 0 else None
            left = v - np.polyval(slope, kpa) if slope is not None else v * 0.0
            dof = max(n - 2, 1)
            noise = float(np.sqrt((left**2).sum() / dof) / math.sqrt(n)) if n > 2 else 0.0
            put(row, "pressure_kpa", float(kpa.mean()), 0.5 / math.sqrt(100.0 * n),
                float(record.pressure.u(kpa.mean())))  # fmt: skip
            mean = float(v.mean())
            put(row, "velocity_m_s", mean, noise, float(meter.u(mean)))
        record.rows.append(row)
    return record.finish({"velocity_m_s": meter} if meter is not None else {})


def _pairs(
    record: ValveRecord,
    event: Mapping[str, Any],
    readings: Mapping[str, npt.NDArray[Any]],
    host_ns: npt.NDArray[Any],
    lead_ns: int,
) -> Array:
    """(mean pressure in kPa, reading) of each reading within the opening, shape (n, 2)."""
    if not record.valve or "reading" not in readings:
        return np.empty((0, 2))
    seq = record.valve["seq"]
    first, end = event["valve_seq"]
    inside = (seq >= first) & (seq < end)
    driven = np.flatnonzero(inside & (record.valve["vent_u5"] > 0))
    if not len(driven):
        return np.empty((0, 2))
    opened, shut = host_ns[driven[0]] + lead_ns, host_ns[driven[-1]]
    at = readings["host_ns"]
    out = []
    for k in range(1, len(at)):
        if at[k - 1] >= opened and at[k] <= shut:
            use = (host_ns > at[k - 1]) & (host_ns <= at[k])
            # The pressure falls: a mean over a part of the period belongs to another time.
            if use.sum() >= WHOLE * (at[k] - at[k - 1]) * 1e-6:
                kpa = float(record.kpa(record.valve["counts"][use]).mean())
                out.append((kpa, float(readings["reading"][k])))
    return np.array(out, dtype=np.float64).reshape(-1, 2)


def reduce_switching_voltage(run: Run) -> Reduction:
    """Voltages between which a valve does and does not switch, evaluated again from every try.

    The pressure upstream or downstream shows whether a valve was open. The live result is not
    used.
    """
    if (imported := imported_points(run, "switching-voltage")) is not None:
        return imported
    record = ValveRecord(run, "switching-voltage")
    tries = [e for e in run.events if e.get("kind") == "try"]
    supply = record.stream("supply")
    u_supply = float(record.parameters.get("u_supply_v", 0.0))
    for event in record.events:
        row = labels_of(event)
        take = int(event.get("take", 1))
        own = [t for t in tries if t["order"] == event["order"] and t.get("take", 1) == take]
        kpa = float(event["supply_kpa"])
        noise, cal = 0.0, float(record.parameters.get("u_supply_kpa", 3.0))
        if event["valve"] == "outlet":
            found = [w for t in own if t["edge"] == "on" and (w := _before(record, t)) is not None]
            if found:
                kpa = float(np.mean([w for w, _ in found]))
                noise = float(np.mean([u for _, u in found]))
            cal = float(record.pressure.u(kpa))
        put(row, "pressure_kpa", kpa, noise, cal)
        for edge in ("on", "off"):
            low, high = bracket(
                [
                    (_measured(supply, t), open_in(record.kpa(part["counts"]), t, part))
                    for t in own
                    if t["edge"] == edge
                    and len((part := record.samples(t["valve_seq"])).get("counts", ()))
                    == t["valve_seq"][1] - t["valve_seq"][0]
                ]
            )
            if not (math.isfinite(low) and math.isfinite(high)):
                record.notes.append(
                    f"point {event['order']} ({event['slot']} kPa): no voltage at which it"
                    f" {'opens' if edge == 'on' else 'closes'} was found"
                )
                row["settled"] = False
            half = (high - low) / 2.0
            put(row, f"{edge}_v", low + half, half / math.sqrt(3.0), u_supply)
        record.rows.append(row)
    return record.finish()


def bracket(tries: list[tuple[float, bool]]) -> tuple[float, float]:
    """The highest voltage at which a valve was closed and the lowest at which it was open."""
    shut = [v for v, opened in tries if not opened]
    opened = [v for v, is_open in tries if is_open]
    return max(shut, default=math.nan), min(opened, default=math.nan)


def open_in(kpa: Array, event: Mapping[str, Any], part: Mapping[str, npt.NDArray[Any]]) -> bool:
    """Whether the valve was open in the window of a try, from the change of pressure.

    For switching on: the pressure after the pulse minus that before it. For switching off: the
    change over the last part of the command, when the voltage had been lowered.
    """
    column = "inlet_u5" if event["valve"] == "inlet" else "vent_u5"
    driven = np.flatnonzero(part[column] > 0)
    if not len(driven) or not len(kpa):
        return False
    first, last = int(driven[0]), int(driven[-1])
    sign = 1.0 if event["valve"] == "inlet" else -1.0
    limit = float(event["limit_kpa"])
    if event["edge"] == "on":
        if len(kpa) <= last + 15:  # the record ends before an answer could be seen
            return False
        return bool(sign * (kpa[last + 15 :].mean() - kpa[: first + 1].mean()) > limit)
    tail = kpa[max(first, last - int(event["tail"])) : last + 1]
    third = max(len(tail) // 3, 1)
    return bool(sign * (tail[-third:].mean() - tail[:third].mean()) > limit)


def _before(record: ValveRecord, event: Mapping[str, Any]) -> tuple[float, float] | None:
    """Mean pressure before the command of a try, and its noise; None if unknown."""
    part = record.samples(event["valve_seq"])
    driven = np.flatnonzero(part["vent_u5"] > 0) if "vent_u5" in part else np.empty(0, dtype=int)
    if not len(driven):
        return None
    kpa = record.kpa(part["counts"])[: int(driven[0]) + 1]
    mean = window_mean(kpa, abs(record.pressure.scale))
    return mean.mean, mean.u


def _measured(supply: Mapping[str, npt.NDArray[Any]], event: Mapping[str, Any]) -> float:
    """Voltage that the supply measured in this try; the set voltage if that reading is lost."""
    if "voltage_v" in supply:
        at = np.flatnonzero(supply["row"] == event["supply_row"])
        if len(at):
            return float(supply["voltage_v"][at[0]])
    return float(event["set_v"])
