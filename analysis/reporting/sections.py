"""The sections of a report in the form that the page template uses."""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from analysis.figures.wording import value_cell, with_u

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from analysis.findings.findings import Section


SHADED = ("same", "settled")
"""A row is shaded if one of these columns is false."""


def section_parts(section: Section) -> dict[str, Any]:
    """A section with its figure as an address and its cells as text."""
    records = [] if section.table is None else section.table.to_dict("records")
    rows = [
        {
            "off": any(name in record and not record[name] for name in SHADED),
            "cells": [_cell(record, name) for name, _ in section.columns],
        }
        for record in records
    ]
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


def _cell(record: Mapping[Any, Any], name: str) -> dict[str, Any]:
    """A value as text, with its expanded uncertainty if it has one."""
    value: Any = record[name]
    if hasattr(value, "item"):
        value = value.item()
    text = isinstance(value, str)
    if isinstance(value, float):
        if not math.isfinite(value):
            return {"text": "–", "left": False}
        u = record.get(f"u_{name}")
        if u is not None:
            return {"text": with_u(value, float(u)), "left": False}
        if abs(value) < 1e5:  # five digits are sufficient without an uncertainty
            return {"text": with_u(value, None), "left": False}
    return {"text": value_cell(value), "left": text}
