"""The sections of a report in the form that the page template uses."""

from __future__ import annotations

import base64
import math
import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.figures.wording import column_decimals, r2_text, value_cell, with_u

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from analysis.findings.findings import Section


NUMBER = re.compile(r"–|([<>] ?)?[−+-]?\d+(\.\d+)?( ± \d+(\.\d+)?)?")
"""A text that stands on the right of its column, as numbers do."""
SHADED = ("same", "settled")
"""A row is shaded if one of these columns is false."""


def section_parts(section: Section) -> dict[str, Any]:
    """A section with its figure as an address and its cells as text."""
    records = [] if section.table is None else section.table.to_dict("records")
    decimals = {name: _decimals(records, name) for name, _ in section.columns}
    rows: list[dict[str, Any]] = [
        {
            "off": any(name in record and not record[name] for name in SHADED),
            "cells": [_cell(record, name, decimals[name]) for name, _ in section.columns],
        }
        for record in records
    ]
    for k in range(len(section.columns)):
        left = any(row["cells"][k]["left"] for row in rows)
        for row in rows:
            row["cells"][k]["left"] = left
    figure = figure_parts(section.figure() if section.figure is not None else None)
    return {
        "title": section.title,
        "words": section.words,
        "heads": [heading.rsplit(", ", 1) for _, heading in section.columns],
        "rows": rows,
        "image": figure["address"],
        "width_mm": figure["width_mm"],
        "caption": section.caption,
    }


def figure_parts(figure: Figure | None) -> dict[str, Any]:
    """A figure as a data address, and its width on paper in mm; empty for None."""
    if figure is None:
        return {"address": "", "width_mm": 0}
    from analysis.figures.drawing import as_svg

    address = "data:image/svg+xml;base64," + base64.b64encode(as_svg(figure)).decode()
    return {"address": address, "width_mm": round(25.4 * float(figure.get_size_inches()[0]), 1)}


def _decimals(records: Sequence[Mapping[Any, Any]], name: str) -> int | None:
    """Decimals of the numbers of a column that have no uncertainty."""
    values = [record[name] for record in records if not _positive(record.get(f"u_{name}"))]
    return column_decimals([float(v) for v in values if isinstance(v, (float, np.floating))])


def _positive(value: Any) -> bool:
    return value is not None and math.isfinite(value) and value > 0.0


def _cell(record: Mapping[Any, Any], name: str, decimals: int | None) -> dict[str, Any]:
    """A value as text, with its expanded uncertainty or else the decimals of its column."""
    value: Any = record[name]
    if hasattr(value, "item"):
        value = value.item()
    text = isinstance(value, str) and NUMBER.fullmatch(value) is None
    if isinstance(value, float):
        if not math.isfinite(value):
            return {"text": "–", "left": False}
        if name == "r2":
            return {"text": r2_text(value), "left": False}
        u = record.get(f"u_{name}")
        if u is not None or abs(value) < 1e5:
            return {"text": with_u(value, u, decimals), "left": False}
    return {"text": value_cell(value), "left": text}
