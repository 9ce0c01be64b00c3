"""Reduction of a recorded run to one table of settled points.

The reduction reads raw data only: pressure counts, balance readings in grams, and the stored
pictures, which it measures again. Each uncertainty has two parts. Noise (``u_*_noise``) is
estimated from the window itself and decreases on averaging. Calibration (``u_*_cal``: zero and
gain) is common to all points and does not.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from analysis.reduction.columns import QUANTITIES, number_or_nan, points_frame
from analysis.reduction.uncertainty import FEW_INDEPENDENT, NO_READINGS, WindowMean, window_mean
from daq.calibration import Calibration
from daq.errors import RecordError

if TYPE_CHECKING:
    import pandas as pd

    from daq.store.run import Run

CODES = 4096
"""The 12-bit pressure counts range from 0 to 4095. At both ends the sensor may be saturated."""

BALANCE_STEP_G = 0.001
DISPROPORTION = 10.0
"""A reading's noise is out of proportion above this many times the median of its run, if it also
exceeds its calibration's uncertainty. Of 664 points of four undisturbed virtual tests one is: the
pressure moved while it was measured. The largest of the others is 7.1 times the median.
"""
FEWEST_COMPARED = 4
SLACK_REASON = "slack: the muscle hangs loose, so its force is not a measurement"

MeasureGap = Callable[[npt.NDArray[np.uint8]], Any]


@dataclass(frozen=True)
class Reduction:
    """The table of points of a run, with its notes and calibrations.

    Attributes:
        table: one row per point, columns as ``COLUMNS``; empty if the run has no points.
        own_notes: sentences for the reader; the first gives the reason if the table is empty.
        calibrations: the calibrations that were applied, by quantity.
        zeros: vented readings, one dict each: trial, when, pressure_kpa, u_pressure_kpa.
        excluded: points that were excluded after the run: order, reason and readings.
        unknown_exclusions: orders that were excluded but are not points of this run.
        rounding_only: columns whose uncertainty is only the rounding of printed numbers.
    """

    table: pd.DataFrame
    own_notes: tuple[str, ...]
    calibrations: dict[str, Calibration]
    zeros: tuple[dict[str, Any], ...] = ()
    excluded: tuple[dict[str, Any], ...] = ()
    unknown_exclusions: tuple[int, ...] = ()
    rounding_only: tuple[str, ...] = ()

    @property
    def notes(self) -> tuple[str, ...]:
        """All notes, including the one about unknown exclusions."""
        if not self.unknown_exclusions:
            return self.own_notes
        orders = ", ".join(str(order) for order in self.unknown_exclusions)
        return (*self.own_notes, f"excluded, but not among the points of this run: {orders}")


def point_events(run: Run) -> list[dict[str, Any]]:
    """The point events of a run. If a point was repeated, only the last take is returned."""
    events = [event for event in run.events if event.get("kind") == "point"]
    return list({event.get("order", k): event for k, event in enumerate(events)}.values())


def is_imported(run: Run) -> bool:
    """True if the points of the run were imported from other data."""
    return any(e.get("kind") == "point" and e.get("row") is not None for e in run.events)


def rounding_only(run: Run) -> tuple[str, ...]:
    """Columns whose uncertainty is only the rounding of printed numbers, as the import states."""
    source = run.manifest.get("source")
    named = source.get("rounding_only") if isinstance(source, dict) else None
    return tuple(str(name) for name in named) if isinstance(named, list) else ()


def reduce_isometric(run: Run, measure: MeasureGap | None = None) -> Reduction:
    """Reduce an isometric run; see :func:`reduce_points`."""
    return reduce_points(run, measure)


def reduce_points(
    run: Run,
    measure: MeasureGap | None = None,
    extra: Mapping[str, str] = {},
    trend: bool = False,
) -> Reduction:
    """Reduce a complete or interrupted run to its settled points.

    If a point was repeated, the last take is used.

    Args:
        run: an opened run. The points of an imported run are taken from its stream ``points``.
        measure: replaces ``vision.marker.edge.measure_gap`` (for tests).
        extra: event fields that become additional columns, with types as in ``COLUMNS``. For
            points with a ``mass_kg`` the force is the weight of that mass.
        trend: force and length change steadily in each window; see ``window_mean``.
    """
    takes = sum(event.get("kind") == "point" for event in run.events)
    points = point_events(run)
    if not points:
        why = "the run holds no settled points"
        if run.outcome != "clean":
            why += f" (it is {run.outcome}: it ended before the first one)"
        return Reduction(points_frame([], extra), (why,), {})
    if points[0].get("row") is not None:
        return without_excluded(run, _imported(run, extra))
    reduction = PointReducer(run, measure, extra, trend).reduce(points)
    if len(points) < takes:
        note = f"{takes - len(points)} points were repeated; the last take of each is used"
        reduction = replace(reduction, own_notes=(*reduction.own_notes, note))
    return without_excluded(run, reduction)


def without_excluded(run: Run, reduction: Reduction) -> Reduction:
    """The reduction without the points that were excluded after the run.

    Raises:
        RecordError: the file of exclusions is damaged.
    """
    from daq.store.annotations import excluded_points

    reasons = excluded_points(run.folder)
    if not reasons:
        return reduction
    unknown = set(reasons) - {int(order) for order in reduction.table["order"]}
    before = len(reduction.table)
    reduction = exclude(reduction, reasons)
    count = before - len(reduction.table)
    note = [f"{count} points are excluded, each with a reason (see the list)"] if count else []
    return replace(
        reduction,
        own_notes=(*reduction.own_notes, *note),
        unknown_exclusions=tuple(sorted(unknown)),
    )


def exclude(reduction: Reduction, reasons: Mapping[int, str]) -> Reduction:
    """Move the points with these orders from the table to the list of excluded points."""
    table = reduction.table
    out = table["order"].isin(list(reasons))
    listed = [
        {"reason": reasons[int(row["order"])], **{str(k): v for k, v in row.items()}}
        for row in table[out].to_dict("records")
    ]
    return replace(
        reduction,
        table=table[~out].reset_index(drop=True),
        excluded=(*reduction.excluded, *listed),
    )


def pressure_sensor(run: Run) -> str:
    """Stream of the instrument whose reading is the pressure of a run; "" for the controller."""
    stated = run.manifest.get("pressure_sensor") or {}
    return str(stated.get("instrument") or "")


def length_source(run: Run) -> str:
    """Stream of the instrument whose reading is the length of a run; "" for the camera."""
    stated = run.manifest.get("length_source")
    return stated if isinstance(stated, str) else ""


class PointReducer:
    """Reduction of the settled points of one recorded run, with notes on defects.

    The table of a run, its report, its export and the trials of the diagnosis all use it.

    Args:
        run: an opened run with recorded streams.
        measure, extra, trend: as for :func:`reduce_points`.
    """

    def __init__(
        self,
        run: Run,
        measure: MeasureGap | None = None,
        extra: Mapping[str, str] = {},
        trend: bool = False,
    ) -> None:
        self.run = run
        self.trend = trend
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
            if event.get("kind") == "length" and event.get("trusted") and run.pictures is None
        }
        self.calibrations = {
            name: run.calibration(name) for name in ("pressure_kpa", "length_mm", "force_n")
        }
        self._controller = self.calibrations["pressure_kpa"]
        self._differences: list[float] = []
        self.sensor = pressure_sensor(run)
        if self.sensor:
            self.transducer = self._samples(self.sensor, ("row", "reading"))
            self.calibrations["pressure_kpa"] = run.instrument_calibrations[self.sensor]

        self.length_source = length_source(run)
        if self.length_source:
            self.lengths = self._samples(self.length_source, ("row", "reading"))

    def reduce(self, points: list[dict[str, Any]]) -> Reduction:
        """The table of these point events."""
        rows = [self.row(point) for point in points]
        zeros = tuple(self._zeros())
        self._find_disproportion(rows)
        for what, places in self._places.items():
            more = f" and {len(places) - 1} more" if len(places) > 1 else ""
            self.notes.append(f"{what}: {places[0]}{more}")
        if self._differences:
            low, high = min(self._differences), max(self._differences)
            self.notes.append(
                f"pressure is the reading of {self.sensor}; the controller's own reading differs"
                f" from it by {low:+.2f} to {high:+.2f} kPa"
            )
        counters = (self.run.final or {}).get("counters") or {}
        bunch_ms = number_or_nan((counters.get("balance") or {}).get("bunch_ms"))
        if bunch_ms > 0:
            self.notes.append(
                f"force readings came together, each up to {bunch_ms:.0f} ms late: the standard"
                f" uncertainty of their times is {bunch_ms / math.sqrt(12.0):.0f} ms"
            )
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

    def _find_disproportion(self, rows: list[dict[str, Any]]) -> None:
        """Report readings whose uncertainty is out of all proportion to that of the others."""
        for quantity in ("pressure_kpa", "force_n", "length_mm"):
            noise = np.array([row[f"u_{quantity}_noise"] for row in rows], dtype=np.float64)
            known = noise[np.isfinite(noise)]
            if len(known) < FEWEST_COMPARED:
                continue
            limit = DISPROPORTION * float(np.median(known))
            for row, u in zip(rows, noise, strict=True):
                if u > max(limit, row[f"u_{quantity}_cal"]):
                    place = f"point {row['order']} ({row[quantity]:.4g}, u = {u:.2g})"
                    self._add_defect(
                        f"standard uncertainty of {quantity} is out of proportion to that of the"
                        " other points",
                        place,
                    )

    def _samples(self, stream: str, needed: tuple[str, ...]) -> dict[str, npt.NDArray[Any]]:
        """Columns of a stream. If the stream is lost, they are empty and a note is added."""
        try:
            columns = self.run.samples(stream)
        except RecordError as error:
            self.notes.append(str(error))
            columns = {}
        return {name: columns.get(name, np.empty(0, dtype=np.int64)) for name in needed}

    def _add_defect(self, what: str, place: str) -> None:
        """Store a defect and its place. One note is made of all places of a defect."""
        self._places.setdefault(what, []).append(place)

    def row(self, point: dict[str, Any]) -> dict[str, Any]:
        """One row of the table: means, uncertainties and labels of a point event."""
        name = f"point {point['order']}"
        pressure = self._pressure(point, name, point.get("set_pressure_kpa") == 0.0)
        row: dict[str, Any] = {
            "n_samples": pressure.n,
            **_labels(point),
            **{key: point.get(key) for key in ("set_pressure_kpa", "set_length_mm", *self.extra)},
        }
        self._put(row, "pressure_kpa", pressure)
        if point.get("mass_kg") is None:
            self._put(row, "force_n", self._force(point["balance_rows"], name))
        else:
            self._put_weight(row, float(point["mass_kg"]))
        if self.length_source:
            length = self._read_length(point.get("length_rows") or [0, 0], name)
        else:
            length = self._length(point["frames"], name)
        self._put(row, "length_mm", length)
        self._put_temperature(row, point)
        return row

    def _put_weight(self, row: dict[str, Any], mass_kg: float) -> None:
        """The weight of a hung mass. It has no noise; its uncertainty is that of the mass."""
        gravity = float(self.run.manifest["conditions"]["gravity_m_s2"])
        u_mass = float((self.run.manifest.get("load") or {}).get("u_mass", math.nan))
        _put_stated(row, "force_n", mass_kg * gravity, mass_kg * gravity * u_mass)

    def _put(self, row: dict[str, Any], quantity: str, mean: WindowMean) -> None:
        u_cal = float(self.calibrations[quantity].u(mean.mean))
        if self.calibrations[quantity].outside(mean.mean):
            self._outside[quantity] = self._outside.get(quantity, 0) + 1
        put_mean(row, quantity, mean, u_cal)

    def _put_temperature(self, row: dict[str, Any], point: dict[str, Any]) -> None:
        """Temperature of the thermometer at the point, otherwise that stated for the rig."""
        source = point
        if point.get("temperature_c") is None:
            source = self.run.manifest.get("conditions") or {}
        value = number_or_nan(source.get("temperature_c"))
        _put_stated(row, "temperature_c", value, number_or_nan(source.get("u_temperature_c")))
        if not math.isfinite(value):
            row["u_temperature_c_noise"] = math.nan

    def _pressure(self, event: Mapping[str, Any], name: str, vented: bool) -> WindowMean:
        """Pressure in the window of an event: by its own sensor, or by the controller."""
        controller = self._controller_pressure(event["valve_seq"], name, vented)
        if not self.sensor:
            return controller
        readings = self._window(
            self.transducer, event["pressure_rows"], name, "pressure readings are missing"
        )
        mean = window_mean(_applied(self.calibrations["pressure_kpa"], readings))
        if event.get("kind") == "point":
            self._differences.append(controller.mean - mean.mean)
        return mean

    def _controller_pressure(self, window: list[int], name: str, vented: bool) -> WindowMean:
        """Mean of the controller's reading in a window.

        At no pressure some samples of a sensor without a live zero are at its lower end; that is
        a defect only where all of them are, because the zero is then unknown.
        """
        counts = self._window(self.valve, window, name, "pressure samples are missing")
        if len(counts) and (
            counts.max() >= CODES - 1 or (counts.max() if vented else counts.min()) == 0
        ):
            self._add_defect("pressure is at the end of the sensor's range", name)
        return window_mean(_applied(self._controller, counts), abs(self._controller.scale))

    def _force(self, window: list[int], name: str) -> WindowMean:
        grams = self._window(self.balance, window, name, "balance readings are missing")
        calibration = self.calibrations["force_n"]
        step = abs(calibration.scale) * BALANCE_STEP_G
        return window_mean(_applied(calibration, grams), step, self.trend)

    def _window(
        self, stream: Mapping[str, npt.NDArray[Any]], window: list[int], name: str, defect: str
    ) -> npt.NDArray[Any]:
        """Values of a stream (number, value) in a half-open range of numbers."""
        number, values = stream.values()
        inside = values[(number >= window[0]) & (number < window[1])]
        missing = window[1] - window[0] - len(inside)
        if missing:
            self._add_defect(defect, f"{name} ({missing})")
        return inside

    def _read_length(self, window: list[int], name: str) -> WindowMean:
        """Mean of the readings of the instrument that is the source of the length."""
        readings = self._window(self.lengths, window, name, "length readings are missing")
        lengths = _applied(self.calibrations["length_mm"], readings)
        return window_mean(lengths, trend=self.trend)

    def _length(self, frames: list[int], name: str) -> WindowMean:
        """Mean over the frames of a point, each measured again in its stored picture."""
        pixels, variances = [], []
        for number in frames:
            gap = self._gap(number)
            if isinstance(gap, str):
                self._add_defect("no length", f"{name}, frame {number}: {gap}")
                continue
            if self.live_pixels.get(number, gap.pixels) != gap.pixels:
                self._add_defect("length differs from the live value", f"{name}, frame {number}")
            pixels.append(float(gap.pixels))
            variances.append(float(gap.u_pixels) ** 2)
        if not pixels:
            return NO_READINGS
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
        """Vented pressure readings. They check the zero; they do not correct it.

        The zero uncertainty of the calibration already covers what they show. If the muscle is
        not completely vented, a correction would introduce an error.
        """
        zeros = []
        calibration = self.calibrations["pressure_kpa"]
        beyond: list[tuple[float, float, str]] = []
        for event in self.run.events:
            if event.get("kind") != "zero":
                continue
            name = f"zero {event['when']} trial {event['trial']}"
            mean = self._pressure(event, name, vented=True)
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
                f"pressure zero: {len(beyond)} of {len(zeros)} vented readings differ from zero by"
                f" more than three standard uncertainties ({limit:.2f} kPa), worst {worst:.2f} kPa"
                f" at {name}; nothing was corrected"
            )
        return zeros


def put_mean(row: dict[str, Any], quantity: str, mean: WindowMean, u_cal: float) -> None:
    """Store the mean of a window, its uncertainty and the two parts of the uncertainty."""
    row[quantity] = mean.mean
    row[f"u_{quantity}_noise"] = mean.u
    row[f"u_{quantity}_cal"] = u_cal
    row[f"u_{quantity}"] = math.hypot(mean.u, u_cal)


def _put_stated(row: dict[str, Any], quantity: str, value: float, u: float) -> None:
    """Store a value without noise, with a stated uncertainty."""
    row[quantity], row[f"u_{quantity}_noise"] = value, 0.0
    row[f"u_{quantity}_cal"] = row[f"u_{quantity}"] = u


def _labels(point: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "direction": point["direction"],
        "repeat": point["replicate"],
        "settled": bool(point["settled"]),
        **{key: point[key] for key in ("trial", "slot", "mounting", "order")},
    }


def write_table(reduction: Reduction, folder: Path) -> list[Path]:
    """Write table.parquet and table.csv into ``folder``. Equal tables give equal bytes."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / "table.parquet", folder / "table.csv"]
    pq.write_table(pa.Table.from_pandas(reduction.table, preserve_index=False), paths[0])
    reduction.table.to_csv(paths[1], index=False, lineterminator="\n")
    return paths


def imported_rows(
    run: Run, points: Iterable[dict[str, Any]]
) -> tuple[list[tuple[dict[str, Any], int]], list[str]]:
    """Point events with their positions in the stream ``points``, and the notes of the run."""
    stream = run.samples("points")
    index = {int(row): position for position, row in enumerate(stream["row"])}
    every = [(point, index.get(int(point["row"]))) for point in points]
    found = [(point, position) for point, position in every if position is not None]
    notes = list(run.manifest.get("notes") or [])
    if len(found) < len(every):
        notes.append(f"{len(every) - len(found)} points are missing: their samples were lost")
    return found, notes


def _imported(run: Run, extra: Mapping[str, str]) -> Reduction:
    """Imported points. An uncertainty that is neither given nor stated is NaN."""
    stream = run.samples("points")
    stated = run.manifest.get("stated_uncertainty") or {}
    found, notes = imported_rows(run, [e for e in run.events if e.get("kind") == "point"])
    rows: list[dict[str, Any]] = []
    slack: list[dict[str, Any]] = []
    for point, position in found:
        row: dict[str, Any] = {
            "n_samples": 1,
            **_labels(point),
            **{key: number_or_nan(point.get(key)) for key in ("set_pressure_kpa", "set_length_mm")},
            **{key: point.get(key) for key in extra},
        }
        for name in QUANTITIES:
            given = float(stream[f"u_{name}"][position])
            row[name] = float(stream[name][position])
            u = given if math.isfinite(given) else number_or_nan(stated.get(f"u_{name}"))
            row[f"u_{name}"] = row[f"u_{name}_noise"] = u
            row[f"u_{name}_cal"] = math.nan
        (slack if point.get("slack") else rows).append(row)
    table = points_frame(rows, extra)
    if slack:
        notes.insert(
            0, f"{len(slack)} points are slack, left out: their force is not a measurement"
        )
    unknown = [name for name in QUANTITIES if table[f"u_{name}"].isna().any()]
    if unknown:
        notes.append(f"no uncertainty is known for all of {', '.join(unknown)}: left empty (NaN)")
    notes.append(
        "uncertainties of imported points are as given or stated; no calibration is known,"
        " so they do not include errors that are common to all points"
    )
    listed = tuple({"reason": SLACK_REASON, **row} for row in slack)
    return Reduction(table, tuple(notes), {}, excluded=listed, rounding_only=rounding_only(run))


def _applied(calibration: Calibration, raw: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
    return np.asarray(calibration.apply(raw.astype(np.float64)), dtype=np.float64)
