"""Where the gap lies: shares of the stages, and designed comparisons of residuals."""

from __future__ import annotations

from gap.inquiry import Inquiry, State
from gap.verdict import Contrast, Share


def stage_shares(q: Inquiry, state: State) -> tuple[Share, ...]:
    """Share of the gap by stage."""
    return ()


def contrasts_of(q: Inquiry) -> tuple[Contrast, ...]:
    """Designed comparisons of the recalibrated residual."""
    return ()
