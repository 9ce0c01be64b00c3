"""Points of the valve tests: their columns, and those that were imported."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from analysis.reduction.points import Reduction

if TYPE_CHECKING:
    import pandas as pd

    from daq.store.run import Run

LABELS = ("valve", "repeat", "trial", "slot", "mounting", "order", "settled")
NUMBERS = {
    "switching-time": ("pressure_kpa", "off_pressure_kpa", "on_ms", "off_ms", "air_delay_ms"),
    "switching-voltage": ("pressure_kpa", "on_v", "off_v"),
    "flow": ("pressure_kpa", "velocity_m_s"),
}
"""What each test measures; every number has ``u_<name>`` beside it, and its parts
``u_<name>_noise`` (averages out) and ``u_<name>_cal`` (common to all points)."""


def columns_of(protocol: str) -> list[str]:
    """All columns of a valve test's table, in order."""
    numbers = NUMBERS[protocol]
    parts = [f"u_{n}{part}" for part in ("", "_noise", "_cal") for n in numbers]
    return [*numbers, *LABELS, "set_pressure_kpa", *parts]


def valve_frame(protocol: str, rows: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """Rows as the table of a valve test, in the order in which they were taken."""
    import pandas as pd

    frame = pd.DataFrame(list(rows), columns=columns_of(protocol))
    for column in frame:
        if column in ("valve", "slot", "mounting"):
            frame[column] = frame[column].astype(str)
        elif column in ("repeat", "trial", "order"):
            frame[column] = frame[column].astype("int64")
        elif column == "settled":
            frame[column] = frame[column].astype(bool)
        else:
            frame[column] = frame[column].astype("float64")
    return frame.sort_values("order", kind="stable", ignore_index=True)


def point_events(run: Run) -> list[dict[str, Any]]:
    """The points of a run, each as it was last taken."""
    found: dict[int, dict[str, Any]] = {}
    for event in run.events:
        if event.get("kind") == "point":
            found[int(event["order"])] = event
    return list(found.values())


def labels_of(event: Mapping[str, Any]) -> dict[str, Any]:
    """What the event of a point says of where it belongs."""
    return {
        "valve": event.get("valve", ""),
        "repeat": event.get("replicate", 1),
        "set_pressure_kpa": _number(event.get("set_pressure_kpa")),
        **{k: event[k] for k in ("trial", "slot", "mounting", "order", "settled")},
    }


def put(row: dict[str, Any], name: str, value: float, noise: float, cal: float) -> None:
    """A number with its uncertainty and the two parts of it."""
    row[name] = value
    row[f"u_{name}_noise"], row[f"u_{name}_cal"] = noise, cal
    row[f"u_{name}"] = math.hypot(noise, 0.0 if math.isnan(cal) else cal)


def imported_points(run: Run, protocol: str) -> Reduction:
    """An imported valve table, with the uncertainty stated of it."""
    stream = run.samples("points")
    at = {int(row): k for k, row in enumerate(stream["row"])}
    stated = run.manifest.get("stated_uncertainty") or {}
    rows, lost = [], 0
    for event in point_events(run):
        k = at.get(int(event["row"]))
        if k is None:
            lost += 1
            continue
        row = labels_of(event)
        for name in NUMBERS[protocol]:
            if name in stream:
                u = _number(stated.get(f"u_{name}"))
                put(row, name, float(stream[name][k]), u, math.nan)
        rows.append(row)
    notes = list(run.manifest.get("notes") or [])
    if lost:
        notes.append(f"{lost} points are missing: their samples did not survive")
    return Reduction(valve_frame(protocol, rows), tuple(notes), {})


def _number(value: Any) -> float:
    return math.nan if value is None else float(value)
