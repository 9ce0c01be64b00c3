"""Thresholds of the next experiment."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class DesignConfig:
    """Thresholds of `gap.design`."""

    enough_sd: float = 3.3
    """Separation of two explanations from which an experiment tells them apart: the nearer one is
    right 95 times in 100."""
    most_trials: int = 24
    """Most trials that an advised experiment has. Set on: not recorded."""
    least_repeats: int = 2
    """Least repeats of each of its settings: one alone has no floor."""
    begin_min: float = 3.0
    """Minutes of bench time that it takes to begin a run."""
    shut_s: float = 30.0
    """Time for which a chamber is shut at each pressure, s: a leak of 0.02 kPa/s is then 0.6 kPa,
    about the scatter of one reading. No other value was tried."""


DESIGN = DesignConfig()
"""The configuration that ships."""
