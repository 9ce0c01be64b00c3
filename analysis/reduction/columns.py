"""The table of settled points: its columns, in order, and their types."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pandas as pd

QUANTITIES = ("pressure_kpa", "length_mm", "temperature_c", "force_n")

COLUMNS: dict[str, str] = {
    **dict.fromkeys(QUANTITIES, "float64"),
    "direction": "str",
    "repeat": "label",
    "set_pressure_kpa": "float64",
    "set_length_mm": "float64",
    "trial": "label",
    "slot": "str",
    "mounting": "str",
    "order": "int64",
    "settled": "bool",
    "n_samples": "int64",
    **{f"u_{name}": "float64" for name in QUANTITIES},
    **{f"u_{name}_noise": "float64" for name in QUANTITIES},
    **{f"u_{name}_cal": "float64" for name in QUANTITIES},
}
"""Columns of the table in order; a label is a whole number where all are, else text."""

_DTYPES: dict[str, Any] = {"str": str, "float64": "float64", "int64": "int64", "bool": "bool"}


def points_frame(rows: list[dict[str, Any]], extra: Mapping[str, str] = {}) -> pd.DataFrame:
    """Rows as a table with the columns of ``COLUMNS``, then those of ``extra``, in order."""
    import pandas as pd

    kinds = {**COLUMNS, **extra}
    frame = pd.DataFrame(rows, columns=list(kinds))
    for column, kind in kinds.items():
        if kind == "label":
            whole = all(isinstance(value, int) for value in frame[column])
            kind = "int64" if whole else "str"
        frame[column] = frame[column].astype(_DTYPES[kind])
    return frame.sort_values("order", kind="stable", ignore_index=True)
