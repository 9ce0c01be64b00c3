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
    """A value with its expanded uncertainty (k = 2), both rounded to digits of the uncertainty."""
    if value is None:
        return "–"
    if u is None or not math.isfinite(u) or u <= 0.0:
        return f"{value + 0.0:.5g}".replace("-", "−")
    expanded = 2.0 * u
    decimals = min(max(1 - math.floor(math.log10(expanded)), 0), 6)
    return f"{fixed(value, decimals)} ± {expanded:.{decimals}f}"


def fixed(value: float | None, decimals: int) -> str:
    """A number with this many decimals; zero has no sign."""
    return "–" if value is None else f"{value:z.{decimals}f}".replace("-", "−")


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
