"""A protocol's own sections of a report, as the page's template wants them."""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from rigs.wording import value_cell, with_u

if TYPE_CHECKING:
    from rigs.protocols.procedure import Section


def section_parts(section: Section) -> dict[str, Any]:
    """A section with its figure drawn and its cells written out."""
    from rigs.drawing import as_svg

    image = ""
    if section.figure is not None:
        image = data_address(as_svg(section.figure()))
    rows = []
    if section.table is not None:
        for record in section.table.to_dict("records"):
            rows.append([_cell(record, name) for name, _ in section.columns])
    return {
        "title": section.title,
        "words": section.words,
        "heads": [heading.split(", ") for _, heading in section.columns],
        "rows": rows,
        "image": image,
        "caption": section.caption,
    }


def data_address(svg: bytes) -> str:
    """A figure as an address that holds it."""
    return "data:image/svg+xml;base64," + base64.b64encode(svg).decode()


def _cell(record: Mapping[Any, Any], name: str) -> dict[str, Any]:
    """A value as text, with its expanded uncertainty where there is one."""
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
    return {"text": value_cell(value), "left": text}
