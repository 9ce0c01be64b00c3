"""The trials of a recorded run: when each began and ended, what was held, and its channels.

A trial is what lies between the two vented readings around its points: before the first of them the
force is still being tared and the length set. Where there are none it is what lies between its
`trial` events, from the last tare on. Where the length moved and was looked at at the settled
points alone, a trial is a table of these: between two pictures nobody knows it. Times count from
the start of the trial, on the controller's clock where the run has fitted it; pictures are put back
by the camera's delay, where the run has measured it.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd

from analysis.reduction.points import (
    PointReducer,
    length_source,
    point_events,
    pressure_sensor,
)
from daq.errors import RecordError
from daq.record.segments import Columns
from daq.store.derive import COMMANDS, VALVE_STREAM, engineering
from daq.store.run import Run
from plant import tomlfile
from plant.arrays import Array

HELD = ("held_length_mm", "load_kg", "temperature_c")
FULL = 1.0 - 1e-9
TICK_S = 1e-3


@dataclass(frozen=True)
class RunTrial:
    """One trial of a run: its row of trials.csv and its rows of samples."""

    row: dict[str, Any]
    samples: pd.DataFrame


@dataclass
class _Span:
    """Where a trial lies in the run: seconds since the run's start."""

    begin_s: float
    end_s: float
    facts: dict[str, Any] = field(default_factory=dict)
    zeros: int = 0


def tares(run: Run, before_mm: float | None = None) -> list[tuple[float, float | None]]:
    """Times (s) of the tares of a run, and where the stage held the muscle, mm; None if unknown.

    The first is the one from before the run.
    """
    found: list[tuple[float, float | None]] = [(-np.inf, before_mm)]
    held: float | None = None
    for event in run.events:
        if event["kind"] == "command" and event.get("device") == "stage":
            held = event.get("length_mm", held)
        elif event["kind"] == "tare":
            found.append((event["t_ns"] * 1e-9, held))
    return found


def run_trials(
    run: Run, commands: bool = True, tared_mm: float | None = None
) -> Iterator[RunTrial]:
    """Every whole trial of a run with its channels, in order; valve commands where wanted.

    `tared_mm` is where the force was last set to zero before the run.

    Raises:
        RecordError: the run holds no trial, or its record is damaged.
    """
    spans = _spans(run)
    if not spans:
        raise RecordError(
            str(run.folder), "holds no whole trial", "a run that was stopped early may have none"
        )
    channels = _Channels(run, commands)
    settled = _settled_points(run)
    reducer: PointReducer | None = None
    protocol = str(run.manifest.get("protocol", "unnamed"))
    conditions = run.manifest.get("conditions", {})
    wall_s = int(run.manifest["started"]["wall_ns"]) * 1e-9
    tared = tares(run, tared_mm)
    for span in spans:
        facts = span.facts
        kind = str(facts.get("protocol", protocol))
        row = {
            "trial": f"{run.run_id}:{facts['trial']}",
            "slot": f"{kind}:{facts.get('slot', facts['trial'])}",
            "replicate": facts.get("replicate", ""),
            "protocol": kind,
            "mounting": facts.get("mounting", ""),
            **{name: facts.get(name) for name in HELD},
            "start_s": wall_s + span.begin_s,
            "tare_length_mm": [at for time, at in tared if time <= span.begin_s][-1],
            "note": run.run_id,
        }
        if row["temperature_c"] is None:
            row["temperature_c"] = conditions.get("temperature_c")
        samples = channels.between(span.begin_s, span.end_s)
        points = settled.get(facts["trial"], [])
        if _moved_unseen(row, points, samples):
            reducer = reducer or PointReducer(run)
            samples = _settled_samples(reducer, points)
        if row["load_kg"]:  # what a load hangs on is not joined to the balance
            samples = samples.drop(columns="force_n", errors="ignore")
        yield RunTrial(row, samples)


def _settled_points(run: Run) -> dict[Any, list[dict[str, Any]]]:
    """The point events of each trial, the last take of each."""
    found: dict[Any, list[dict[str, Any]]] = {}
    for event in point_events(run):
        if "valve_seq" in event:
            found.setdefault(event["trial"], []).append(event)
    return found


def _settled_samples(reducer: PointReducer, points: list[dict[str, Any]]) -> pd.DataFrame:
    """One row per settled point, its means, and when it was read."""
    rows = []
    # The muscle came to the first point as long before it as the test waited there.
    begun_s = points[0]["t_ns"] * 1e-9 - float(points[0].get("waited_s", np.nan))
    for point in points:
        reduced = reducer.row(point)
        rows.append(
            {
                **{name: reduced[name] for name in ("pressure_kpa", "force_n", "length_mm")},
                "temperature_c": point.get("temperature_c", np.nan),
                "direction": reduced["direction"],
                "taken_s": point["t_ns"] * 1e-9 - begun_s,
            }
        )
    return pd.DataFrame(rows).dropna(axis="columns", how="all")


def _moved_unseen(row: dict[str, Any], points: list[dict[str, Any]], samples: pd.DataFrame) -> bool:
    """Whether the length was free to move and all its pictures are those of the points."""
    if row["held_length_mm"] is not None or "length_mm" not in samples:
        return False
    pictures = sum(len(point.get("frames", ())) for point in points)
    return 0 < int(samples["length_mm"].notna().sum()) <= pictures


def _spans(run: Run) -> list[_Span]:
    around = _around_points(run)
    marked = _marked(run.events)
    if not marked:
        return [span for span in around.values() if "slot" in span.facts]
    for span in marked:
        read = around.get(span.facts["trial"])
        if read is not None and read.zeros == 2:
            span.begin_s, span.end_s = read.begin_s, read.end_s
    return marked


def _marked(events: list[dict[str, Any]]) -> list[_Span]:
    """Spans between `trial` events, from the last tare in each that no point precedes."""
    open_trial: dict[str, Any] | None = None
    begin_s, measured = 0.0, False
    spans = []
    for event in events:
        at_s = event["t_ns"] * 1e-9
        if event["kind"] == "tare" and not measured:
            begin_s = at_s
        elif event["kind"] == "point":
            measured = True
        elif event["kind"] != "trial":
            continue
        elif event.get("phase") == "begin":
            open_trial, begin_s, measured = event, at_s, False
        elif open_trial is not None and event["trial"] == open_trial["trial"]:
            facts = {k: v for k, v in open_trial.items() if k not in ("n", "t_ns", "kind", "phase")}
            spans.append(_Span(begin_s, at_s, facts))
            open_trial = None
    return spans


def _around_points(run: Run) -> dict[Any, _Span]:
    """Spans from the first to the last vented reading or point of each trial."""
    columns, _ = engineering(run, VALVE_STREAM)
    seq, time_s = columns["seq"], np.asarray(columns["time_s"], dtype=np.float64)

    def at(number: int) -> float:
        return float(time_s[min(int(np.searchsorted(seq, number)), len(time_s) - 1)])

    found: dict[Any, _Span] = {}
    for event in run.events:
        if event["kind"] not in ("zero", "point") or "valve_seq" not in event:
            continue
        low, high = (at(number) for number in event["valve_seq"])
        span = found.setdefault(event["trial"], _Span(low, high, {"trial": event["trial"]}))
        span.begin_s, span.end_s = min(span.begin_s, low), max(span.end_s, high)
        if event["kind"] == "zero":
            span.zeros += 1
        else:
            span.facts.update({k: event.get(k, "") for k in ("slot", "replicate", "mounting")})
            span.facts["held_length_mm"] = event.get("set_length_mm")
            span.facts["load_kg"] = event.get("mass_kg")
    return found


class _Channels:
    """Every channel of a run as (times, values), cut to a trial on demand."""

    def __init__(self, run: Run, commands: bool) -> None:
        self._parts: list[tuple[str, Array, Array]] = []
        valve, _ = engineering(run, VALVE_STREAM)
        time_s = np.asarray(valve["time_s"], dtype=np.float64)
        self._parts.append(("pressure_kpa", *_pressure(run, time_s, valve)))
        if commands and not _regulated(run):
            for name in COMMANDS.values():
                self._parts.append((name, *_edges(time_s, np.asarray(valve[name]))))
        if "balance" in run.streams:
            columns, _ = engineering(run, "balance")
            if "force_n" in columns and len(columns["force_n"]):
                self._parts.append(("force_n", columns["time_s"], columns["force_n"]))
        self._parts += _instruments(run)
        lengths = _lengths(run) or _placed(run)
        if lengths is not None:
            self._parts.append(("length_mm", *lengths))

    def between(self, begin_s: float, end_s: float) -> pd.DataFrame:
        """Rows of one trial: one for each instant at which some channel has a sample."""
        made: dict[str, pd.Series[Any]] = {}
        for name, time_s, value in self._parts:
            held = name.endswith("_cmd")
            first = int(np.searchsorted(time_s, begin_s))
            last = int(np.searchsorted(time_s, end_s))
            times, values = time_s[first:last] - begin_s, value[first:last]
            if held and first and (not len(times) or times[0] > 0.0):
                # A command given before the trial holds until the next one.
                times = np.concatenate([[0.0], times])
                values = np.concatenate([[value[first - 1]], values])
            if not len(times):
                continue
            series = pd.Series(values, index=np.round(times, 6))
            made[name] = series[~series.index.duplicated(keep="last")]
        frame = pd.DataFrame(made).sort_index()
        return frame.rename_axis("time_s").reset_index()


def _regulated(run: Run) -> bool:
    """Whether a regulator sets the pressure, so that the valve's commands do not explain it."""
    try:
        rig = tomlfile.loads(run.manifest.get("rig", {}).get("text", ""))
    except tomllib.TOMLDecodeError:
        return False
    return bool(rig.get("valve", {}).get("static_scheme", "pwm") == "reg")


def _edges(time_s: Array, share: Array) -> tuple[Array, Array]:
    """Times and values of a command's edges: it is on for the first `share` of each tick."""
    on = share > 0.0
    full = share >= FULL
    rises = on & ~np.concatenate([[False], full[:-1]])
    # Off inside a tick that is on in part, and at the start of one that is off after a full one.
    inside = on & ~full
    falls = ~on & np.concatenate([[False], full[:-1]])
    times = np.concatenate([time_s[:1], time_s[rises], time_s[inside] + share[inside] * TICK_S,
                            time_s[falls]])  # fmt: skip
    values = np.concatenate(
        [[0.0], np.ones(rises.sum()), np.zeros(inside.sum()), np.zeros(falls.sum())]
    )
    order = np.lexsort((values, times))
    return times[order], values[order]


def _pressure(run: Run, time_s: Array, valve: Columns) -> tuple[Array, Array]:
    """Times and values of the pressure: by its own sensor where the run has one."""
    sensor = pressure_sensor(run)
    if not sensor:
        return time_s, np.asarray(valve["pressure_kpa"])
    columns, _ = engineering(run, sensor)
    return np.asarray(columns["time_s"]), np.asarray(columns["pressure_kpa"])


def _instruments(run: Run) -> list[tuple[str, Array, Array]]:
    """Temperature and supply pressure, where an instrument of the run reads them."""
    found = []
    for stream, calibration in run.instrument_calibrations.items():
        channel = calibration.quantity
        if channel == "pressure_kpa" and "supply" in stream:
            channel = "supply_kpa"
        if channel not in ("temperature_c", "supply_kpa") or stream not in run.streams:
            continue
        columns, _ = engineering(run, stream)
        value = columns.get(calibration.quantity)
        if value is not None and len(value):
            found.append((channel, np.asarray(columns["time_s"]), np.asarray(value)))
    return found


def _placed(run: Run) -> tuple[Array, Array] | None:
    """Lengths as a simulation's own sensor of place read them."""
    if "place" not in run.streams:
        return None
    columns, _ = engineering(run, "place")
    if "length_mm" not in columns or not len(columns["length_mm"]):
        return None
    return np.asarray(columns["time_s"]), np.asarray(columns["length_mm"])


def _lengths(run: Run) -> tuple[Array, Array] | None:
    """Times and lengths of the trusted live measurements of the pictures, in order of time."""
    source = length_source(run)
    if source:
        columns, _ = engineering(run, source)
        if "length_mm" not in columns or not len(columns["length_mm"]):
            return None
        return np.asarray(columns["time_s"]), np.asarray(columns["length_mm"])
    calibration = run.calibrations.get("length_mm")
    pixels = {
        e["frame"]: e["pixels"] for e in run.events if e["kind"] == "length" and e.get("trusted")
    }
    if calibration is None or not pixels:
        return None
    start_ns = int(run.manifest["started"]["monotonic_ns"])
    synced = [e for e in run.events if e["kind"] == "camera_sync" and e.get("found")]
    late_s = float(synced[-1]["delay_ms"]) * 1e-3 if synced else 0.0
    seen = {
        f["frame"]: (
            (f["host_ns"] - start_ns) * 1e-9 - late_s,
            float(calibration.apply(pixels[f["frame"]])),
        )
        for f in run.frames
        if f["frame"] in pixels
    }
    if not seen:
        return None
    table = np.array(sorted(seen.values()), dtype=np.float64)
    return table[:, 0], table[:, 1]
