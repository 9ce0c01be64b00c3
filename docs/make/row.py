"""One key of one file, as the page shows it."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Row:
    """A key: kind of file, table, type, range, default, and its line of description."""

    kind: str
    table: str
    key: str
    form: str
    limits: str
    default: str
    line: str = ""


def number(value: float) -> str:
    """A bound or a default as a person writes it."""
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    if value == 2**63 - 1:
        return "2^63 - 1"
    if float(value).is_integer() and abs(value) < 1e6:
        return str(int(value))
    return f"{value:.12g}"
