"""Thresholds of the next experiment."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class DesignConfig:
    """Thresholds of `gap.design`."""

    enough_sd: float = 3.3
    """Separation of two explanations from which an experiment tells them apart: the nearer one is
    right 95 times in 100, as far as the forms of the catalogue go."""
    kept_sd: float = 5.0
    """Separation below which an advised experiment is said to be barely enough: the true form may
    differ from that of the catalogue, and repeats do not help against that. Set on: practice sets
    300 to 600, where 2 of 5 experiments that promised less preferred the right explanation, and 11
    of 11 that promised more."""
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
