"""Numbers and outcomes as text for reports."""

from __future__ import annotations

import math
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


def with_u(value: float | None, u: float | None) -> str:
    """A value with its expanded uncertainty (k = 2).

    Both are rounded to two significant digits of the uncertainty (GUM, 7.2.6). Without one the
    value has four significant digits; a whole number stays whole.
    """
    if value is None:
        return "–"
    if u is None or not math.isfinite(u) or u <= 0.0:
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


def fixed(value: float | None, decimals: int) -> str:
    """A number with this many decimals; −1 rounds to tens. Zero has no sign."""
    if value is None:
        return "–"
    rounded = round(value, decimals) if decimals < 0 else value
    return f"{rounded:z.{max(decimals, 0)}f}".replace("-", "−")


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
