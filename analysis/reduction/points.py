"""From the record of a run to one tidy table of settled points.

Only raw data are read: counts, grams as the balance sent them, and the frames as stored,
measured anew. What a number is worth is carried in two parts that behave differently when
points are averaged: noise (``u_*_noise``, seen in the window itself, averages out) and
calibration (``u_*_cal``, zero and gain, common to all points, does not).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from analysis.reduction.columns import COLUMNS as COLUMNS
from analysis.reduction.columns import QUANTITIES, points_frame
from analysis.reduction.uncertainty import FEW_INDEPENDENT, WindowMean, window_mean
from daq.calibration import Calibration
from daq.errors import RecordError

if TYPE_CHECKING:
    import pandas as pd

    from daq.store.run import Run

CODES = 4096
"""12-bit pressure counts run from 0 to 4095; both ends may hide a value beyond."""

BALANCE_STEP_G = 0.001
STRANGERS = "excluded, but not among the points of this run"

MeasureGap = Callable[[npt.NDArray[np.uint8]], Any]


@dataclass(frozen=True)
class Reduction:
    """The table of settled points and what a reader of it should know.

    Attributes:
        table: one row a point, columns as ``COLUMNS``; empty if the run has no points.
        notes: sentences; the first says why where the table is empty.
        calibrations: those that were applied, by quantity.
        zeros: vented readings, one row each: trial, when, pressure_kpa, u_pressure_kpa.
        excluded: points left out afterwards: order, reason and what they read.
    """

    table: pd.DataFrame
    notes: tuple[str, ...]
    calibrations: dict[str, Calibration]
    zeros: tuple[dict[str, Any], ...] = ()
    excluded: tuple[dict[str, Any], ...] = ()


def reduce_isometric(run: Run, measure: MeasureGap | None = None) -> Reduction:
    """Reduce an isometric run; see :func:`reduce_points`."""
    return reduce_points(run, measure)


def reduce_points(
    run: Run, measure: MeasureGap | None = None, extra: Mapping[str, str] = {}
) -> Reduction:
    """Reduce a run, whole or interrupted, to its settled points.

    Of a point that was made again the last take counts.

    Args:
        run: an opened run; one with a stream ``points`` was imported and is passed through.
        measure: replaces ``vision.marker.edge.measure_gap`` (for tests).
        extra: fields of its points that become columns as well, with their kinds as in
            ``COLUMNS``. Points with a ``mass_kg`` have the hung mass's weight for their force.
    """
    every = [event for event in run.events if event.get("kind") == "point"]
    points = list({event.get("order", k): event for k, event in enumerate(every)}.values())
    if not points:
        why = "the run holds no settled points"
        if run.outcome != "clean":
            why += f" (it is {run.outcome}: it ended before the first one)"
        return Reduction(points_frame([], extra), (why,), {})
    if points[0].get("row") is not None:
        return without_excluded(run, _imported(run, every, extra))
    reduction = _Bench(run, measure, extra).reduce(points)
    if len(points) < len(every):
        note = f"{len(every) - len(points)} takes were made again; the last of each counts"
        reduction = replace(reduction, notes=(*reduction.notes, note))
    return without_excluded(run, reduction)


def without_excluded(run: Run, reduction: Reduction) -> Reduction:
    """The reduction without the points that were excluded afterwards, which it lists.

    Raises:
        RecordError: the file of exclusions is damaged.
    """
    from daq.store.annotations import excluded_points

    reasons = excluded_points(run.folder)
    if not reasons:
        return reduction
    table = reduction.table
    out = table["order"].isin(list(reasons))
    rows = table[out].to_dict("records")
    listed = tuple(
        {"reason": reasons[int(row["order"])], **{str(k): v for k, v in row.items()}}
        for row in rows
    )
    notes = [f"{len(rows)} points are excluded, each with a reason (see the list)"] if rows else []
    unknown = sorted(set(reasons) - {int(order) for order in table["order"]})
    if unknown:
        some = ", ".join(str(order) for order in unknown)
        notes.append(f"{STRANGERS}: {some}")
    return replace(
        reduction,
        table=table[~out].reset_index(drop=True),
        notes=(*reduction.notes, *notes),
        excluded=listed,
    )


class _Bench:
    """One recorded run's raw streams, calibrated on demand."""

    def __init__(self, run: Run, measure: MeasureGap | None, extra: Mapping[str, str] = {}) -> None:
        self.run = run
        self.measure = measure
        self.extra = extra
        self.notes: list[str] = []
        self._outside: dict[str, int] = {}
        self._places: dict[str, list[str]] = {}
        self.valve = self._samples("valve", ("seq", "counts"))
        self.balance = self._samples("balance", ("row", "grams"))
        self.live_pixels = {
            event["frame"]: event["pixels"]
            for event in run.events
            if event.get("kind") == "length" and event.get("trusted")
        }
        self.calibrations = {
            name: run.calibration(name) for name in ("pressure_kpa", "length_mm", "force_n")
        }

    def reduce(self, points: list[dict[str, Any]]) -> Reduction:
        rows = [self._row(point) for point in points]
        zeros = tuple(self._zeros())
        for what, places in self._places.items():
            more = f" and {len(places) - 1} more" if len(places) > 1 else ""
            self.notes.append(f"{what}: {places[0]}{more}")
        if self.run.outcome != "clean":
            self.notes.append(
                f"the run is {self.run.outcome}: the table holds the {len(rows)} points it reached"
            )
        for quantity, count in self._outside.items():
            (low, high), unit = self.calibrations[quantity].domain, self.calibrations[quantity].unit
            self.notes.append(
                f"{quantity}: {count} points outside the calibrated {low:g} to {high:g} {unit}"
            )
        unsettled = sum(not row["settled"] for row in rows)
        if unsettled:
            self.notes.append(f"{unsettled} points were taken without settling (column settled)")
        table = points_frame(rows, self.extra)
        return Reduction(table, tuple(self.notes), self.calibrations, zeros)

    def _samples(self, stream: str, needed: tuple[str, ...]) -> dict[str, npt.NDArray[Any]]:
        """A stream's columns; empty ones, and a note, where nothing of it survived."""
        try:
            columns = self.run.samples(stream)
        except RecordError as error:
            self.notes.append(str(error))
            columns = {}
        return {name: columns.get(name, np.empty(0, dtype=np.int64)) for name in needed}

    def _met(self, what: str, place: str) -> None:
        """Remember a defect and where it was; one note is made of all its places."""
        self._places.setdefault(what, []).append(place)

    def _row(self, point: dict[str, Any]) -> dict[str, Any]:
        name = f"point {point['order']}"
        pressure = self._pressure(point["valve_seq"], name)
        row: dict[str, Any] = {
            "direction": point["direction"],
            "repeat": point["replicate"],
            "n_samples": pressure.n,
            "settled": bool(point["settled"]),
            **{key: point[key] for key in ("trial", "slot", "mounting", "order")},
            **{key: point.get(key) for key in ("set_pressure_kpa", "set_length_mm", *self.extra)},
        }
        self._put(row, "pressure_kpa", pressure)
        if point.get("mass_kg") is None:
            self._put(row, "force_n", self._force(point["balance_rows"], name))
        else:
            self._put_weight(row, float(point["mass_kg"]))
        self._put(row, "length_mm", self._length(point["frames"], name))
        self._put_temperature(row, point)
        return row

    def _put_weight(self, row: dict[str, Any], mass_kg: float) -> None:
        """The force of a hung mass: no noise, only what is known of mass and gravity."""
        gravity = float(self.run.manifest["conditions"]["gravity_m_s2"])
        u_mass = float((self.run.manifest.get("load") or {}).get("u_mass", math.nan))
        row["force_n"] = mass_kg * gravity
        row["u_force_n_noise"] = 0.0
        row["u_force_n_cal"] = row["u_force_n"] = mass_kg * gravity * u_mass

    def _put(self, row: dict[str, Any], quantity: str, mean: WindowMean) -> None:
        u_cal = float(self.calibrations[quantity].u(mean.mean))
        if self.calibrations[quantity].outside(mean.mean):
            self._outside[quantity] = self._outside.get(quantity, 0) + 1
        row[quantity] = mean.mean
        row[f"u_{quantity}_noise"] = mean.u
        row[f"u_{quantity}_cal"] = u_cal
        row[f"u_{quantity}"] = math.hypot(mean.u, u_cal)

    def _put_temperature(self, row: dict[str, Any], point: dict[str, Any]) -> None:
        """Temperature by the thermometer at the point, or as entered for the rig.

        Of one that was entered no noise is known, only what was stated.
        """
        if point.get("temperature_c") is not None:
            row["temperature_c"] = float(point["temperature_c"])
            row["u_temperature_c_noise"] = 0.0
            row["u_temperature_c_cal"] = row["u_temperature_c"] = float(point["u_temperature_c"])
            return
        stated = self.run.manifest.get("conditions") or {}
        row["temperature_c"] = _number(stated.get("temperature_c"))
        row["u_temperature_c_noise"] = 0.0 if math.isfinite(row["temperature_c"]) else math.nan
        row["u_temperature_c_cal"] = row["u_temperature_c"] = _number(stated.get("u_temperature_c"))

    def _pressure(self, window: list[int], name: str) -> WindowMean:
        seq = self.valve["seq"]
        inside = (seq >= window[0]) & (seq < window[1])
        counts = self.valve["counts"][inside]
        missing = window[1] - window[0] - len(counts)
        if missing:
            self._met("pressure samples are missing", f"{name} ({missing})")
        if len(counts) and (counts.min() == 0 or counts.max() >= CODES - 1):
            self._met("pressure touches the end of the sensor's range", name)
        calibration = self.calibrations["pressure_kpa"]
        return window_mean(_applied(calibration, counts), abs(calibration.scale))

    def _force(self, window: list[int], name: str) -> WindowMean:
        row = self.balance["row"]
        grams = self.balance["grams"][(row >= window[0]) & (row < window[1])]
        missing = window[1] - window[0] - len(grams)
        if missing:
            self._met("balance readings are missing", f"{name} ({missing})")
        calibration = self.calibrations["force_n"]
        return window_mean(_applied(calibration, grams), abs(calibration.scale) * BALANCE_STEP_G)

    def _length(self, frames: list[int], name: str) -> WindowMean:
        """Mean over the point's frames, each measured anew from its stored picture."""
        pixels, variances = [], []
        for number in frames:
            gap = self._gap(number)
            if isinstance(gap, str):
                self._met("no length", f"{name}, frame {number}: {gap}")
                continue
            if self.live_pixels.get(number, gap.pixels) != gap.pixels:
                self._met("length differs from the one taken live", f"{name}, frame {number}")
            pixels.append(float(gap.pixels))
            variances.append(float(gap.u_pixels) ** 2)
        if not pixels:
            return WindowMean(math.nan, math.nan, 0, 0.0, math.nan)
        scale = abs(self.calibrations["length_mm"].scale)
        lengths = _applied(self.calibrations["length_mm"], np.array(pixels))
        u_frames = scale * math.sqrt(sum(variances)) / len(pixels)
        u_scatter = float(lengths.std(ddof=1)) / math.sqrt(len(lengths)) if len(lengths) > 3 else 0
        return WindowMean(
            mean=float(lengths.mean()),
            u=max(u_frames, u_scatter),
            n=len(lengths),
            n_effective=float(len(lengths)),
            sd=u_frames * math.sqrt(len(lengths)),
        )

    def _gap(self, number: int) -> Any:
        """The measured gap, or the reason why there is none."""
        from analysis.reduction.pictures import camera_of, decode, measure_stored

        try:
            gray = decode(self.run.frame_bytes(number))
        except RecordError as error:
            return error.what
        if gray is None:
            return "the stored picture cannot be decoded"
        if self.measure is not None:
            gap = self.measure(gray)
        else:
            gap = measure_stored(gray, camera_of(self.run))
        return gap if gap.trusted else str(gap.reason)

    def _zeros(self) -> list[dict[str, Any]]:
        """Vented pressure readings; they check the zero, they do not correct it.

        The calibration's own zero uncertainty already covers what they show, and a muscle
        that is not quite vented would turn a correction into an error.
        """
        zeros = []
        calibration = self.calibrations["pressure_kpa"]
        beyond: list[tuple[float, float, str]] = []
        for event in self.run.events:
            if event.get("kind") != "zero":
                continue
            name = f"zero {event['when']} trial {event['trial']}"
            mean = self._pressure(event["valve_seq"], name)
            limit = 3.0 * math.hypot(mean.u, calibration.u_offset)
            if abs(mean.mean) > limit:
                beyond.append((mean.mean, limit, name))
            zeros.append(
                {
                    "trial": event["trial"],
                    "when": event["when"],
                    "pressure_kpa": mean.mean,
                    "u_pressure_kpa": mean.u,
                    "few": mean.n_effective < FEW_INDEPENDENT,
                }
            )
        if beyond:
            worst, limit, name = max(beyond, key=lambda entry: abs(entry[0]))
            self.notes.append(
                f"pressure zero: {len(beyond)} of {len(zeros)} vented readings lie beyond three"
                f" standard uncertainties ({limit:.2f} kPa), worst {worst:.2f} kPa at {name};"
                " nothing was corrected"
            )
        return zeros


def write_table(reduction: Reduction, folder: Path) -> list[Path]:
    """Write table.parquet and table.csv into ``folder``: the same bytes for the same table."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / "table.parquet", folder / "table.csv"]
    pq.write_table(pa.Table.from_pandas(reduction.table, preserve_index=False), paths[0])
    reduction.table.to_csv(paths[1], index=False, lineterminator="\n")
    return paths


def _imported(run: Run, points: list[dict[str, Any]], extra: Mapping[str, str] = {}) -> Reduction:
    """Points as they were imported, with the uncertainty given or stated, else NaN."""
    stream = run.samples("points")
    index = {int(row): position for position, row in enumerate(stream["row"])}
    stated = run.manifest.get("stated_uncertainty") or {}
    rows, lost = [], 0
    for point in points:
        position = index.get(int(point["row"]))
        if position is None:
            lost += 1
            continue
        row: dict[str, Any] = {
            "direction": point["direction"],
            "repeat": point["replicate"],
            "n_samples": 1,
            "settled": bool(point["settled"]),
            **{key: point[key] for key in ("trial", "slot", "mounting", "order")},
            **{key: _number(point.get(key)) for key in ("set_pressure_kpa", "set_length_mm")},
            **{key: point.get(key) for key in extra},
        }
        for name in QUANTITIES:
            given = float(stream[f"u_{name}"][position])
            row[name] = float(stream[name][position])
            u = given if math.isfinite(given) else _number(stated.get(f"u_{name}"))
            row[f"u_{name}"] = row[f"u_{name}_noise"] = u
            row[f"u_{name}_cal"] = math.nan
        rows.append(row)
    notes = list(run.manifest.get("notes") or [])
    if lost:
        notes.append(f"{lost} points are missing: their samples did not survive")
    table = points_frame(rows, extra)
    unknown = [name for name in QUANTITIES if table[f"u_{name}"].isna().any()]
    if unknown:
        notes.append(f"no uncertainty is known for all of {', '.join(unknown)}: left empty (NaN)")
    notes.append(
        "uncertainties of imported points are as given or stated; no calibration is known,"
        " so what all points have in common is not in them"
    )
    return Reduction(table, tuple(notes), {})


def _applied(calibration: Calibration, raw: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
    return np.asarray(calibration.apply(raw.astype(np.float64)), dtype=np.float64)


def _number(value: Any) -> float:
    return math.nan if value is None else float(value)
