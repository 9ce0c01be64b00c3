"""Reduction of a fatigue test: one row for each cycle, in the units of its quantities."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.reduction.columns import valve_test_frame
from analysis.reduction.points import Reduction, length_source, without_excluded
from daq.errors import RecordError
from plant.arrays import Array

if TYPE_CHECKING:
    from daq.calibration import Calibration
    from daq.store.run import Run

STREAM = "cycles"
MEASURED = (
    "pressure_high_kpa", "pressure_low_kpa", "pressure_max_kpa", "pressure_min_kpa",
    "force_high_n", "force_low_n", "force_max_n", "force_min_n", "length_high_mm",
    "length_low_mm", "force_range_n", "stroke_mm", "work_j", "leak_kpa_s", "temperature_c",
)  # fmt: skip
UNCERTAIN = ("pressure_high_kpa", "force_high_n", "length_high_mm", "force_range_n", "stroke_mm",
             "work_j", "leak_kpa_s")  # fmt: skip
COLUMNS = (
    "order", "trial", "slot", "repeat", "mounting", "settled", "utc_s", *MEASURED,
    *(f"u_{name}" for name in UNCERTAIN),
)  # fmt: skip


def scatter(values: Array) -> float:
    """Standard deviation of one cycle about a slow drift, from neighbouring cycles (robust)."""
    steps = np.diff(values[np.isfinite(values)])
    return 1.4826 * float(np.median(np.abs(steps))) / math.sqrt(2.0) if len(steps) > 2 else math.nan


def reduce_fatigue(run: Run) -> Reduction:
    """One row per cycle: pressures, force or length at both ends, range, work, leak, temperature.

    ``u_`` of a value holds its scatter from cycle to cycle and its calibration; that of a range
    (``force_range_n``, ``stroke_mm``) has no share of the zero, which cancels. ``order`` is the
    number of the cycle over all parts of a test, ``utc_s`` its time in s since 1970.
    """
    names = ("pressure_kpa", "force_n", "length_mm")
    calibrations = {name: run.calibration(name) for name in names}
    notes: list[str] = []
    try:
        raw = dict(run.samples(STREAM))
    except RecordError as error:
        notes.append(f"no cycle was made ({error.what})")
        raw = {}
    if not len(raw.get("cycle", ())):
        empty = Reduction(valve_test_frame([], COLUMNS), tuple(notes or ("no cycle was made",)), {})
        return without_excluded(run, empty)
    pressure, force, length = (calibrations[name] for name in names)
    count = len(raw["cycle"])
    started = run.manifest["started"]
    mass_kg = _hung_kg(run)
    out: dict[str, Array] = {name: np.full(count, math.nan) for name in COLUMNS[6:]}
    out["utc_s"] = (raw["host_ns"] - started["monotonic_ns"] + started["wall_ns"]) * 1e-9
    for end in ("high", "low", "max", "min"):
        out[f"pressure_{end}_kpa"] = np.asarray(pressure.apply(raw[f"counts_{end}"]))
        if not mass_kg:
            out[f"force_{end}_n"] = np.asarray(force.apply(raw[f"force_{end}"]))
    if not mass_kg and force.scale < 0.0:  # what takes weight off a balance is a larger force
        out["force_max_n"], out["force_min_n"] = out["force_min_n"], out["force_max_n"]
    for end in ("high", "low"):
        out[f"length_{end}_mm"] = np.asarray(length.apply(raw[f"length_{end}"]))
    out["leak_kpa_s"] = raw["leak_counts_s"] * pressure.scale  # a loss is positive
    thermometer = run.instrument_calibrations.get("thermometer")
    warm = raw["temperature"]
    out["temperature_c"] = np.asarray(warm if thermometer is None else thermometer.apply(warm))
    _uncertainties(out, run, mass_kg, calibrations)
    labels = {
        "slot": "cycles", "repeat": 1, "settled": True,
        "mounting": str(((run.manifest.get("parameters") or {}).get("method") or {}).get(
            "mountings", ["m1"])[0]),
    }  # fmt: skip
    rows: list[dict[str, Any]] = [
        {**labels, "order": int(n), "trial": int(t)}
        for n, t in zip(raw["cycle"], raw["trial"], strict=True)
    ]
    table = valve_test_frame(rows, COLUMNS)
    for name, values in out.items():
        table[name] = values
    if length_source(run):
        notes.append(f"lengths are readings of {length_source(run)}")
    if lost := run.lost_rows(STREAM):
        notes.append(f"{sum(b - a for a, b in lost)} cycles are damaged in the record, left out")
    return without_excluded(run, Reduction(table, tuple(notes), calibrations))


def _hung_kg(run: Run) -> float:
    """What hung, which a person may have typed, or else what was requested; 0 without a load."""
    asked = float((run.manifest.get("parameters") or {}).get("mass_kg") or 0.0)
    hung = [float(e["mass_kg"]) for e in run.events if e.get("kind") == "load" and e["mass_kg"]]
    return hung[0] if asked and hung else asked


def _uncertainties(
    out: dict[str, Array], run: Run, mass_kg: float, calibrations: dict[str, Calibration]
) -> None:
    pressure, force, length = (
        calibrations[name] for name in ("pressure_kpa", "force_n", "length_mm")
    )
    out["force_range_n"] = out["force_high_n"] - out["force_low_n"]
    out["stroke_mm"] = out["length_low_mm"] - out["length_high_mm"]
    for name, calibration in (
        ("pressure_high_kpa", pressure), ("force_high_n", force), ("length_high_mm", length),
    ):  # fmt: skip
        cal = np.asarray(calibration.u(out[name]), dtype=np.float64)
        out[f"u_{name}"] = np.hypot(scatter(out[name]), cal)
    for name, calibration in (("force_range_n", force), ("stroke_mm", length)):
        out[f"u_{name}"] = np.hypot(scatter(out[name]), calibration.u_gain * out[name])
    load = run.manifest.get("load") or {}
    if mass_kg:
        weight = mass_kg * float(run.manifest["conditions"]["gravity_m_s2"])
        out["work_j"] = weight * out["stroke_mm"] * 1e-3
        by_mass = out["work_j"] * float(load.get("u_mass", math.nan))
        out["u_work_j"] = np.hypot(weight * out["u_stroke_mm"] * 1e-3, by_mass)
    known = out["leak_kpa_s"][np.isfinite(out["leak_kpa_s"])]
    if len(known):
        u = scatter(known) if len(known) > 3 else math.nan
        out["u_leak_kpa_s"] = np.where(np.isfinite(out["leak_kpa_s"]), u, math.nan)
