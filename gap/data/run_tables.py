"""The settled points of a run as trials without time: its own table, or one from elsewhere."""

from __future__ import annotations

from collections.abc import Iterator

import pandas as pd

from daq.errors import RecordError
from daq.store.run import Run
from gap.data.run_trials import RunTrial

CHANNELS = ("pressure_kpa", "length_mm", "force_n", "temperature_c")


def table_trials(run: Run) -> Iterator[RunTrial]:
    """One trial for each trial (or slot) of the run's table.

    Raises:
        RecordError: the run has no table.
    """
    table = run.table
    if table.empty:
        raise RecordError(str(run.folder), "its table has no points")
    protocol = str(run.manifest.get("protocol", "unnamed"))
    conditions = run.manifest.get("conditions") or {}
    wall_s = int(run.manifest["started"].get("wall_ns", 0)) * 1e-9
    key = "trial" if "trial" in table and table["trial"].notna().all() else "slot"
    if "order" in table:
        table = table.sort_values("order", kind="stable")
    for count, (name, rows) in enumerate(table.groupby(key, sort=False)):
        yield RunTrial(
            {
                "trial": f"{run.run_id}:{name}",
                "slot": f"{protocol}:{_first(rows, 'slot', name)}",
                "replicate": _first(rows, "repeat", ""),
                "protocol": protocol,
                "mounting": _first(rows, "mounting", ""),
                "held_length_mm": _held(rows),
                "load_kg": _first(rows, "mass_kg", None),
                "temperature_c": _mean(rows, "temperature_c", conditions.get("temperature_c")),
                "start_s": wall_s + float(count),
                "note": run.run_id,
            },
            _points(rows),
        )


def _points(rows: pd.DataFrame) -> pd.DataFrame:
    columns = [name for name in CHANNELS if name in rows and rows[name].notna().any()]
    out = rows[columns].reset_index(drop=True)
    if "direction" in rows:
        words = rows["direction"].astype(str).reset_index(drop=True)
        out["direction"] = words.where(words.isin(["up", "down"]), None)
    return out


def _first(rows: pd.DataFrame, name: str, default: object) -> object:
    if name not in rows or pd.isna(rows[name].iloc[0]):
        return default
    return rows[name].iloc[0]


def _held(rows: pd.DataFrame) -> object:
    """The length of a trial that was held at one; None where the length was not prescribed."""
    if "set_length_mm" not in rows or rows["set_length_mm"].isna().any():
        return None
    return rows["set_length_mm"].iloc[0] if rows["set_length_mm"].nunique() == 1 else None


def _mean(rows: pd.DataFrame, name: str, default: object) -> object:
    if name not in rows or rows[name].isna().all():
        return default
    return float(rows[name].mean())
