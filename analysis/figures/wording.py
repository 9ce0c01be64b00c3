"""Numbers and outcomes as a report says them."""

from __future__ import annotations

import math
from typing import Any

from analysis.regression.force_lines import LengthLaw, LengthLine

_OUTCOMES = {
    "clean": "The test ran to its end.",
    "stopped": "The test was stopped by hand before its end; the bench vented.",
    "aborted": "The test was broken off by an error in the program; the bench vented.",
    "faulted": "The bench reported a fault; the test ended there.",
    "interrupted": "The program ended without finishing the record (power, kill or crash);"
    " everything up to that moment was kept.",
}


def outcome_sentence(outcome: str, reason: str) -> str:
    """How the run ended, in a sentence or two."""
    sentence = _OUTCOMES.get(outcome, f"The run ended as {outcome}.")
    return f"{sentence} Reason: {reason}" if reason else sentence


def headline(
    lines: list[LengthLine], law: LengthLaw | None, points: int, region_kpa: tuple[float, float]
) -> str:
    """The result in one sentence."""
    if not points:
        return "No settled point was reached, so there is no result."
    low, high = region_kpa
    if not lines:
        return (
            f"{points} settled points were measured, too few between {low:g} and {high:g} kPa"
            " for a straight line at any length."
        )
    gradients = sorted(line.gradient_n_per_kpa for line in lines)
    lengths = sorted(line.length_mm for line in lines)
    if len(lines) == 1:
        line = lines[0]
        return (
            f"Held at {line.length_mm:.2f} mm, the muscle pulls"
            f" {line.gradient_n_per_kpa:.3g} N harder for each kPa"
            f" between {low:g} and {high:g} kPa."
        )
    text = (
        f"Between {low:g} and {high:g} kPa the force rises by {gradients[0]:.3f} to"
        f" {gradients[-1]:.3f} N for each kPa, over lengths from {lengths[0]:.2f} to"
        f" {lengths[-1]:.2f} mm"
    )
    if law is not None:
        text += (
            f"; the gradient grows with length as"
            f" {law.gradient.slope:.4f} L {signed(law.gradient.intercept, 3)} N/kPa"
        )
    return text + "."


def signed(value: float | None, decimals: int) -> str:
    """A term with its sign set apart: "− 0.426"."""
    if value is None:
        return "+ –"
    return f"{'−' if value < 0 else '+'} {abs(value):.{decimals}f}"


def with_u(value: float | None, u: float | None, k: float = 2.0) -> str:
    """A value with its expanded uncertainty, both cut where the uncertainty says."""
    if value is None:
        return "–"
    if u is None or not math.isfinite(u) or u <= 0.0:
        return f"{value:.5g}".replace("-", "−")
    expanded = k * u
    decimals = min(max(1 - math.floor(math.log10(expanded)), 0), 6)
    return f"{value:.{decimals}f} ± {expanded:.{decimals}f}".replace("-", "−")


def value_cell(value: Any) -> str:
    """Any plain value as a table cell."""
    if value is None or value == "":
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return (f"{value:.6g}" if abs(value) < 1e-3 else f"{value:.7g}").replace("-", "−")
    return str(value)
