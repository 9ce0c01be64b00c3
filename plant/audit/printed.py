"""Printed numbers of the thesis; a value reproduces if it rounds to the printed digits."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from dataclasses import dataclass
from importlib import resources
from typing import Literal

Verdict = Literal["reproduces", "reproduces if mended", "does not reproduce"]


@dataclass(frozen=True)
class Row:
    """One line of the audit.

    Attributes:
        item: table or equation of the thesis.
        published: printed value.
        recomputed: value from the shipped tables.
        verdict: "if mended" means after correction of the misprints named in `reason`.
        reason: explanation.
        anomalies: related entries of the shipped ANOMALIES.md.
    """

    item: str
    published: str
    recomputed: str
    verdict: Verdict
    reason: str
    anomalies: tuple[str, ...] = ()


def printed_rows(table: str) -> list[dict[str, str]]:
    """Rows of a shipped table with every cell as printed."""
    text = resources.files("plant.data").joinpath(f"{table}.csv").read_text(encoding="utf-8")
    return list(csv.DictReader(text.splitlines()))


def unit_in_last_place(printed: str) -> float:
    """The unit of the last digit: 0.01 for "-1.25", 1 for "421", 1e-18 for "1.79200E-13"."""
    mantissa, _, exponent = printed.strip().lower().partition("e")
    decimals = len(mantissa.partition(".")[2])
    return float(10.0 ** (-decimals + int(exponent or 0)))


def same(printed: str, value: float) -> bool:
    """Whether the value rounds to the printed number (a tie may round up or down)."""
    return abs(value - float(printed)) <= unit_in_last_place(printed) * 0.5000001


def truncated(printed: str, value: float) -> bool:
    """Whether the printed number is the truncated value."""
    gap = abs(value) - abs(float(printed))
    return 0 <= gap < unit_in_last_place(printed) and value * float(printed) >= 0


def verdict(good: bool, mended: bool = False) -> Verdict:
    """The verdict: `good` as printed, `mended` after correction of misprints."""
    return "reproduces" if good else "reproduces if mended" if mended else "does not reproduce"


def listing(items: Iterable[str], most: int = 6) -> str:
    """A text such as "a, b, c and 4 more"."""
    every = list(items)
    shown = ", ".join(every[:most])
    return shown + (f" and {len(every) - most} more" if len(every) > most else "")
