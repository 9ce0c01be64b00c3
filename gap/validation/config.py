"""Thresholds of validation: predictions of new trials, and designed comparisons of residuals."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ValidationConfig:
    """Thresholds of `gap.validation`."""

    shown_chi2: float = 120.0
    """Chi-square that new trials must leave without an explanation beyond what they leave with it:
    below it they show nothing for or against it. Set on: investigations of withheld benches."""
    predicted_share: float = 0.9
    """Least share of the gap of new trials that a confirmed explanation predicts."""
    refuted_share: float = 0.5
    """Share below which new trials refute an explanation."""
    most_rivals: int = 4
    """Other explanations of the search that new trials are compared with."""
    least_rivals: int = 2
    """Rivals of other families in any case: the nearest are fitted for it."""
    family_wise: float = 0.01
    """Rate of data sets without a gap in which any designed comparison may raise an alarm."""
    drift_sd: float = 3.6
    """Sd from which a drift that an explanation leaves is no chance: the explanation was chosen
    among many, and not for its drift. Set on: not recorded."""


VALIDATION = ValidationConfig()
"""The configuration that ships."""
