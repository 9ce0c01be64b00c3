"""From the record of a valve test to its table: from raw counts, blocks and voltages alone."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from analysis.reduction.points import Reduction, without_excluded
from analysis.reduction.uncertainty import window_mean
from analysis.reduction.valve_points import (
    imported_points,
    labels_of,
    point_events,
    put,
    valve_frame,
)
from daq.errors import DeviceError, RecordError

if TYPE_CHECKING:
    from daq.store.run import Run

Floats = npt.NDArray[np.float64]
BEFORE = 20
"""Pressure samples before a pulse that tell what was upstream; so many around its end, too."""
AROUND = 3
WHOLE = 0.97
"""Share of the samples between two readings of the meter that must be there (1 kHz)."""
ALIKE = 0.85
"""Readings of one opening are averaged down to this share of the highest pressure among them."""


class ValveRecord:
    """The streams that a valve test needs, its events, and what is said of both."""

    def __init__(self, run: Run, protocol: str) -> None:
        self.run = run
        self.protocol = protocol
        self.events = point_events(run)
        self.parameters: dict[str, Any] = dict(run.manifest.get("parameters") or {})
        self.notes: list[str] = []
        self.pressure = run.calibration("pressure_kpa")
        self.valve = self.stream("valve")
        self.rows: list[dict[str, Any]] = []

    def stream(self, name: str) -> dict[str, npt.NDArray[Any]]:
        """A stream's columns; none, and a note, where nothing of it survived."""
        try:
            return self.run.samples(name)
        except RecordError as error:
            self.notes.append(str(error))
            return {}

    def samples(self, window: list[int]) -> dict[str, npt.NDArray[Any]]:
        """The valve's samples of a half-open range of sequence numbers."""
        if not self.valve:
            return {}
        seq = self.valve["seq"]
        inside = (seq >= window[0]) & (seq < window[1])
        return {name: values[inside] for name, values in self.valve.items()}

    def asked(self, event: Mapping[str, Any]) -> list[int]:
        """The window of a point from the sample on at which its set-point was asked for.

        The window of the event begins with the newest sample that the host had then, some 50 ms
        before. An older record does not say when it was asked for, and keeps that.
        """
        first, end = event["valve_seq"]
        asked_ns = event.get("asked_t_ns")
        if asked_ns is None or not self.valve:
            return [first, end]
        zero_ns = int(self.run.manifest["started"]["monotonic_ns"])
        part = self.samples([first, end])
        if not len(part.get("device_us", ())):
            return [first, end]
        # The device's own intervals, behind the arrival of the sample that was under way least:
        # no clock fit outlives a restart, and over seconds none is needed.
        device_ns = part["device_us"] * 1000
        host_ns = device_ns + (part["host_ns"] - device_ns).min()
        later = host_ns >= zero_ns + asked_ns
        if not later.any():
            return [first, end]
        at, seq = int(np.argmax(later)), part["seq"]
        late = int((host_ns[at] - zero_ns - asked_ns) // 1_000_000)  # of samples lost there
        return [max(first, int(seq[at]) - late), end]

    def on_time(
        self, window: list[int]
    ) -> tuple[dict[str, npt.NDArray[Any]], npt.NDArray[np.bool_]]:
        """The valve's samples of a range, one each millisecond, and which of them came.

        One that was lost on the way is put between its neighbours (counts), or as the one before
        it (all else), so that what follows keeps its time. Nothing where none came.
        """
        part = self.samples(window)
        if not len(part.get("counts", ())):
            return {}, np.zeros(0, dtype=bool)
        grid = np.arange(window[0], window[1])
        before = np.maximum(np.searchsorted(part["seq"], grid, side="right") - 1, 0)
        out = {name: values[before] for name, values in part.items()}
        out["counts"] = np.interp(grid, part["seq"], part["counts"])
        return out, np.isin(grid, part["seq"])

    def kpa(self, counts: npt.NDArray[Any]) -> Floats:
        """Counts as pressure."""
        return np.asarray(self.pressure.apply(counts.astype(np.float64)), dtype=np.float64)

    def finish(self, calibrations: Mapping[str, Any] = {}) -> Reduction:
        """The table, without what was excluded afterwards."""
        run, table = self.run, valve_frame(self.protocol, self.rows)
        if run.outcome != "clean":
            self.notes.append(
                f"the run is {run.outcome}: the table holds the {len(table)} points it reached"
            )
        unsettled = int((~table["settled"]).sum())
        if unsettled:
            self.notes.append(f"{unsettled} points are marked as not as they should be (settled)")
        found = {"pressure_kpa": self.pressure, **calibrations}
        return without_excluded(run, Reduction(table, tuple(self.notes), found))


def is_imported(run: Run) -> bool:
    """Whether the points of a run were imported."""
    return any(e.get("kind") == "point" and e.get("row") is not None for e in run.events)


def reduce_switching_time(run: Run) -> Reduction:
    """Delays from the blocks, with the pressure at the moment when each command changed.

    A point is one block: ``on_ms``, ``off_ms``, ``pressure_kpa`` (upstream, before the pulse) and
    ``off_pressure_kpa`` (upstream, at its end; the inlet's is the supply, which stays).
    """
    if is_imported(run):
        return without_excluded(run, imported_points(run, "switching-time"))
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
                raise DeviceError(event["slot"], "samples of its block did not survive")
            found = switching_times(block, delay_ms)
            # Where an edge lies between two samples is known to one period at best, and is
            # much the same in every block, since pulse and samples keep step.
            period_ms = block.period_us * 1e-3
            noise, common = period_ms / math.sqrt(12.0), period_ms / math.sqrt(3.0)
            put(row, "on_ms", found.on_ms, noise, math.hypot(u_delay, common))
            put(row, "off_ms", found.off_ms, noise, math.hypot(u_delay, common))
        except DeviceError as error:
            record.notes.append(f"point {event['order']} ({event['slot']} kPa): {error.what}")
            for name in ("on_ms", "off_ms"):
                put(row, name, math.nan, math.nan, math.nan)
            row["settled"] = False
        record.rows.append(row)
    record.notes.append(
        f"the air's way to the sensor is taken off: {p.get('line_mm', 62.0):g} mm at"
        f" {p.get('air_m_s', 65.0):g} m/s, {delay_ms:.3f} ± {2 * u_delay:.3f} ms (k = 2)"
    )
    return record.finish()


def _upstream(record: ValveRecord, event: Mapping[str, Any]) -> tuple[float, float, float]:
    """Pressure upstream of the tried valve at both edges of its command, and the noise of it."""
    if event["valve"] == "inlet":
        return float(event["supply_kpa"]), float(event["supply_kpa"]), 0.0
    part = record.samples(event["valve_seq"])
    column = "vent_u5"
    driven = np.flatnonzero(part[column] > 0) if column in part else np.empty(0, dtype=int)
    if not len(driven):
        return math.nan, math.nan, math.nan
    kpa = record.kpa(part["counts"])
    first, last = int(driven[0]), int(driven[-1])
    before = window_mean(kpa[max(0, first - BEFORE) : first + 1], abs(record.pressure.scale))
    around = kpa[max(first, last - AROUND) : last + AROUND + 1]
    return before.mean, float(around.mean()), max(before.u, 0.0)


def reduce_flow(run: Run) -> Reduction:
    """Velocity and pressure over the same stretches of time while the valve stood open.

    A reading of the meter is a mean since the one before it; it counts where all of that time
    lies within the opening, the valve's own delay left out.
    """
    if is_imported(run):
        return without_excluded(run, imported_points(run, "flow"))
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
            record.notes.append(
                f"point {event['order']} ({event['slot']} kPa): no reading of the meter lies"
                " wholly within the opening"
            )
            for name in ("pressure_kpa", "velocity_m_s"):
                put(row, name, math.nan, math.nan, math.nan)
            row["settled"] = False
        else:
            # Flow bends with pressure: only readings at much the same pressure may be averaged.
            pairs = pairs[pairs[:, 0] >= ALIKE * pairs[:, 0].max()]
            v = np.asarray(meter.apply(pairs[:, 1]), dtype=np.float64)
            kpa = pairs[:, 0]
            n = len(pairs)
            # The vessel empties while it is read: what is left about the common line is noise.
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
) -> Floats:
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
            # Pressure falls meanwhile: a mean over part of that time is that of another moment.
            if use.sum() >= WHOLE * (at[k] - at[k - 1]) * 1e-6:
                kpa = float(record.kpa(record.valve["counts"][use]).mean())
                out.append((kpa, float(readings["reading"][k])))
    return np.array(out, dtype=np.float64).reshape(-1, 2)


def reduce_switching_voltage(run: Run) -> Reduction:
    """Voltages between which a valve does and does not act, from every try anew.

    Whether a valve was open is seen in the pressure behind or before it, not taken from what was
    noted live.
    """
    if is_imported(run):
        return without_excluded(run, imported_points(run, "switching-voltage"))
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
                    f" {'opens' if edge == 'on' else 'lets go'} was found"
                )
                row["settled"] = False
            half = (high - low) / 2.0
            put(row, f"{edge}_v", low + half, half / math.sqrt(3.0), u_supply)
        record.rows.append(row)
    return record.finish()


def bracket(tries: list[tuple[float, bool]]) -> tuple[float, float]:
    """The highest voltage at which a valve was shut and the lowest at which it was open."""
    shut = [v for v, opened in tries if not opened]
    opened = [v for v, is_open in tries if is_open]
    low = max(shut) if shut else math.nan
    high = min(opened) if opened else math.nan
    return low, high


def open_in(kpa: Floats, event: Mapping[str, Any], part: Mapping[str, npt.NDArray[Any]]) -> bool:
    """Whether the valve was open in a try's window, by what the pressure did there.

    For turning on: the pressure after the pulse against that before it. For turning off: its
    slope over the last stretch of the command, when the voltage had been lowered.
    """
    column = "inlet_u5" if event["valve"] == "inlet" else "vent_u5"
    driven = np.flatnonzero(part[column] > 0)
    if not len(driven) or not len(kpa):
        return False
    first, last = int(driven[0]), int(driven[-1])
    sign = 1.0 if event["valve"] == "inlet" else -1.0
    limit = float(event["limit_kpa"])
    if event["edge"] == "on":
        return bool(sign * (kpa[last + 15 :].mean() - kpa[: first + 1].mean()) > limit)
    tail = kpa[max(first, last - int(event["tail"])) : last + 1]
    third = max(len(tail) // 3, 1)
    return bool(sign * (tail[-third:].mean() - tail[:third].mean()) > limit)


def _before(record: ValveRecord, event: Mapping[str, Any]) -> tuple[float, float] | None:
    part = record.samples(event["valve_seq"])
    if not len(part.get("counts", ())):
        return None
    driven = np.flatnonzero(part["vent_u5"] > 0)
    if not len(driven):
        return None
    kpa = record.kpa(part["counts"])[: int(driven[0]) + 1]
    mean = window_mean(kpa, abs(record.pressure.scale))
    return mean.mean, mean.u


def _measured(supply: Mapping[str, npt.NDArray[Any]], event: Mapping[str, Any]) -> float:
    """Voltage as the supply measured it in this try, or as it was set where that is lost."""
    if "voltage_v" in supply:
        at = np.flatnonzero(supply["row"] == event["supply_row"])
        if len(at):
            return float(supply["voltage_v"][at[0]])
    return float(event["set_v"])
