"""Points of the valve tests: columns, labels, and the reduction of imported points."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from analysis.reduction.columns import number_or_nan, valve_test_frame
from analysis.reduction.points import (
    Reduction,
    imported_rows,
    is_imported,
    point_events,
    rounding_only,
    without_excluded,
)

if TYPE_CHECKING:
    from daq.store.run import Run

LABELS = ("valve", "repeat", "trial", "slot", "mounting", "order", "settled")
NUMBERS = {
    "switching-time": ("pressure_kpa", "off_pressure_kpa", "on_ms", "off_ms", "air_delay_ms"),
    "switching-voltage": ("pressure_kpa", "on_v", "off_v"),
    "flow": ("pressure_kpa", "velocity_m_s"),
}
"""Quantities that each test measures. The table also has ``u_<name>`` of each, and its parts
``u_<name>_noise`` (decreases on averaging) and ``u_<name>_cal`` (common to all points)."""


def columns_of(protocol: str) -> list[str]:
    """All columns of a valve test's table, in order."""
    numbers = NUMBERS[protocol]
    parts = [f"u_{n}{part}" for part in ("", "_noise", "_cal") for n in numbers]
    return [*numbers, *LABELS, "set_pressure_kpa", *parts]


def labels_of(event: Mapping[str, Any]) -> dict[str, Any]:
    """The labels of a point event: valve, repeat, trial, slot and so on."""
    return {
        "valve": event.get("valve", ""),
        "repeat": event.get("replicate", 1),
        "set_pressure_kpa": number_or_nan(event.get("set_pressure_kpa")),
        **{k: event[k] for k in ("trial", "slot", "mounting", "order", "settled")},
    }


def put(
    row: dict[str, Any],
    name: str,
    value: float = math.nan,
    noise: float = math.nan,
    cal: float = math.nan,
) -> None:
    """Store a value, its standard uncertainty and the two parts of the uncertainty."""
    row[name] = value
    row[f"u_{name}_noise"], row[f"u_{name}_cal"] = noise, cal
    row[f"u_{name}"] = math.hypot(noise, 0.0 if math.isnan(cal) else cal)


def imported_points(run: Run, protocol: str) -> Reduction | None:
    """The table of an imported valve test, with the stated uncertainty; None if not imported."""
    if not is_imported(run):
        return None
    stream = run.samples("points")
    stated = run.manifest.get("stated_uncertainty") or {}
    found, notes = imported_rows(run, point_events(run))
    rows = []
    for event, k in found:
        row = labels_of(event)
        for name in NUMBERS[protocol]:
            if name in stream:
                put(row, name, float(stream[name][k]), number_or_nan(stated.get(f"u_{name}")))
        rows.append(row)
    table = valve_test_frame(rows, columns_of(protocol))
    made = Reduction(table, tuple(notes), {}, rounding_only=rounding_only(run))
    return without_excluded(run, made)
