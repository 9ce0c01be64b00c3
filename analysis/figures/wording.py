"""Numbers and outcomes as text for reports."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

_OUTCOMES = {
    "clean": "The test ran to its end.",
    "stopped": "The test was stopped by hand before its end; the bench was vented.",
    "aborted": "The test was aborted by an error in the program; the bench was vented.",
    "faulted": "The bench reported a fault; the test ended there.",
    "interrupted": "The program ended without completing the record (power failure, kill or"
    " crash); all data until then are in the record.",
}

MOST_DECIMALS = 9
"""Decimals of any number in a report; smaller parts are noise of the computation."""


def outcome_sentence(outcome: str, reason: str) -> str:
    """How the run ended, in one or two sentences."""
    sentence = _OUTCOMES.get(outcome, f"The run ended as {outcome}.")
    return f"{sentence} Reason: {reason}" if reason else sentence


def signed(value: float | None, digits: int | str) -> str:
    """A term with a separate sign: "− 0.426". ``digits``: decimals, or a format such as ".3g"."""
    if value is None:
        return "+ –"
    form = f".{digits}f" if isinstance(digits, int) else digits
    return f"{'−' if value < 0 else '+'} {abs(value):{form}}"


def with_u(value: float | None, u: float | None, decimals: int | None = None) -> str:
    """A value with its expanded uncertainty (k = 2).

    Both are rounded to two significant digits of the uncertainty (GUM, 7.2.6). Without one the
    value has ``decimals``, those of its column; if these are None, it has four significant digits,
    and a whole number stays whole.
    """
    if value is None:
        return "–"
    if u is None or not math.isfinite(u) or u <= 0.0:
        if decimals is not None:
            return fixed(value, decimals)
        return fixed(value, 0) if float(value).is_integer() else significant(value)
    expanded = 2.0 * u
    decimals = decimals_of(expanded)
    return f"{fixed(value, decimals)} ± {fixed(expanded, decimals)}"


def decimals_of(u: float, digits: int = 2) -> int:
    """Decimals that show ``digits`` significant digits of ``u`` > 0; −1 stands for tens."""
    rounded = float(f"{u:.{digits - 1}e}")  # 0.0996 is 0.10, with two decimals
    return min(digits - 1 - math.floor(math.log10(rounded)), MOST_DECIMALS)


def significant(value: float, digits: int = 4) -> str:
    """A number with at most this many significant digits, never with an exponent of ten."""
    if not math.isfinite(value):
        return "–"
    decimals = decimals_of(abs(value), digits) if value else 0
    text = fixed(value, decimals)
    return text.rstrip("0").rstrip(".") if "." in text else text


def column_decimals(values: Iterable[float | None]) -> int | None:
    """The decimals of every number of a column without uncertainties.

    They are those of its finest number with four significant digits, but not more than give the
    largest one five. None where a small number would then be lost: each has its own decimals.
    """
    sizes = [abs(v) for v in values if v is not None and math.isfinite(v)]
    if all(size.is_integer() for size in sizes):
        return 0
    most = decimals_of(max(sizes), 4) + 1
    decimals = max(min(most, max(written_decimals(float(significant(v))) for v in sizes)), 0)
    lost = any(0.0 < size < 0.5 * 10.0**-decimals for size in sizes)
    return None if lost else decimals


def written_decimals(value: float) -> int:
    """Decimals of the shortest text that stands for a number: 2 of 6.50, 3 of 6.507."""
    text = f"{value:.{MOST_DECIMALS}f}".rstrip("0")
    return len(text) - text.index(".") - 1


def r2_text(r2: float) -> str:
    """A coefficient of determination: never "1", which only a fit without residuals has."""
    return "> 0.9999" if r2 >= 0.99995 else fixed(r2, 4)


def p_text(p: float) -> str:
    """A probability of no effect: three decimals, and never "0.000"."""
    return "< 0.001" if p < 0.0005 else fixed(p, 3)


def percent_r2(r2: float) -> str:
    """The same in percent, as regression programs print it: "99.7 %"."""
    return "> 99.9 %" if r2 >= 0.9995 else f"{100.0 * r2:.1f} %"


def fixed(value: float | None, decimals: int) -> str:
    """A number with this many decimals; −1 rounds to tens. Zero has no sign."""
    if value is None:
        return "–"
    rounded = round(value, decimals) if decimals < 0 else value
    return f"{rounded:z.{max(decimals, 0)}f}".replace("-", "−")


def from_to(low: float, high: float, decimals: int | None = None) -> str:
    """A range, or one number where both ends read the same.

    Args:
        decimals: of both ends; by default as many as show two significant digits of the larger
            one, two at least.
    """
    if decimals is None:
        largest = max(abs(low), abs(high))
        decimals = max(decimals_of(largest), 2) if largest > 0.0 else 2
    ends = (fixed(low, decimals), fixed(high, decimals))
    return ends[0] if ends[0] == ends[1] else f"{ends[0]} to {ends[1]}"


def ratio_unit(unit: str, raw_unit: str) -> str:
    """The unit of a scale: "kPa/count"; "m/s per V"; none where a reading has the unit already."""
    if unit == raw_unit:
        return ""
    return f"{unit} per {raw_unit}" if "/" in unit + raw_unit else f"{unit}/{raw_unit}"


def value_cell(value: Any) -> str:
    """Any plain value as a table cell."""
    if value is None or value == "":
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        value += 0.0  # zero has no sign
        return (f"{value:.6g}" if abs(value) < 1e-3 else f"{value:.7g}").replace("-", "−")
    return str(value)
