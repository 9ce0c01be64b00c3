"""Columns and types of the tables of points."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
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
"""Columns of the table of settled points, in order.

A "label" column is int64 if all its values are integers, otherwise text."""

LABEL_TYPES = {
    **dict.fromkeys(
        (
            "direction",
            "scheme",
            "switch",
            "valve",
            "slot",
            "mounting",
            "state",
            "shape",
            "pair",
        ),
        "str",
    ),
    **dict.fromkeys(("repeat", "trial", "order"), "int64"),
    "settled": "bool",
}
"""Types of the label columns of valve tests; all other columns are float64."""


def points_frame(rows: list[dict[str, Any]], extra: Mapping[str, str] = {}) -> pd.DataFrame:
    """Rows as a table with the columns of ``COLUMNS``, then those of ``extra``."""
    return _typed_frame(rows, {**COLUMNS, **extra})


def valve_test_frame(rows: Sequence[Mapping[str, Any]], columns: Iterable[str]) -> pd.DataFrame:
    """Rows as the table of a valve test with these columns."""
    return _typed_frame(rows, {column: LABEL_TYPES.get(column, "float64") for column in columns})


def number_or_nan(value: Any) -> float:
    """The value as a float, NaN for None."""
    return math.nan if value is None else float(value)


def _typed_frame(rows: Sequence[Mapping[str, Any]], kinds: Mapping[str, str]) -> pd.DataFrame:
    import pandas as pd

    frame = pd.DataFrame(list(rows), columns=list(kinds))
    for column, kind in kinds.items():
        if kind == "label":
            whole = all(isinstance(value, int) for value in frame[column])
            kind = "int64" if whole else "str"
        # Python's str, because the name "str" would select the string type of pandas.
        dtype: Any = str if kind == "str" else kind
        frame[column] = frame[column].astype(dtype)
    return frame.sort_values("order", kind="stable", ignore_index=True)
