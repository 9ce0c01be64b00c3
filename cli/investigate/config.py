"""Thresholds of an investigation."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class InvestigationConfig:
    """When an investigation diagnoses, repeats and gives up."""

    repeats: int = 3
    """Repeats of every setting of a test: two more than one give the floor."""
    first_diagnosis_after: int = 2
    """Tests before the first diagnosis: muscle and sensors at rest, and the valves. A name given on
    either alone would be one among what that test can show."""
    hold_s: float = 60.0
    """Time of a hold, in which creep shows."""
    nearly_certain: float = 0.7
    """Reliability of one family from which it is tested before anything else is looked at. Set on:
    not recorded."""
    most_failed: int = 2
    """Tests that did not come out as predicted after which no more are made for that."""


INVESTIGATION = InvestigationConfig()
"""The configuration that ships."""
