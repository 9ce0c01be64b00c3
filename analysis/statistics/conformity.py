"""Decisions whether a result is within limits, with a guard band (JCGM 106, ILAC-G8)."""

from __future__ import annotations

import math

PASS, FAIL, UNDECIDED, NOT_MEASURED = "pass", "fail", "undecided", "not measured"
ORDER = (FAIL, NOT_MEASURED, UNDECIDED, PASS)


def decide(
    value: float, expanded: float, lower: float | None, upper: float | None, guard: float = 1.0
) -> str:
    """Whether a result conforms.

    Pass: within the limits, narrowed by the guard band. Fail: beyond a limit by more than the
    guard band. Between the two the result is undecided. The guard band is ``guard`` times the
    expanded uncertainty: 1 is the guarded acceptance of ILAC-G8:09/2019 with w = U, 0 its simple
    acceptance, which always decides.

    Args:
        value: result; NaN: not measured.
        expanded: its expanded uncertainty; NaN: not known, so that no guarded decision is made.
        lower, upper: limits, in the unit of the result; None: no limit on this side.
        guard: guard band in expanded uncertainties.
    """
    if not math.isfinite(value):
        return NOT_MEASURED
    if guard and not math.isfinite(expanded):
        return UNDECIDED
    band = guard * expanded if guard else 0.0
    low = -math.inf if lower is None else lower
    high = math.inf if upper is None else upper
    if low + band <= value <= high - band:
        return PASS
    if value < low - band or value > high + band:
        return FAIL
    return UNDECIDED


def overall(verdicts: list[str]) -> str:
    """One verdict for all: the worst, in the order of ``ORDER``; "" for none."""
    return next((word for word in ORDER if word in verdicts), "")
