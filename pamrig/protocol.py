"""What a protocol of your own is written with; docs/use/own-protocols.md has an example."""

from __future__ import annotations

from analysis.findings.findings import Analysis, Findings, Section
from analysis.findings.points import points_analysis
from rigs.protocols.own import OwnTest
from rigs.steps.custom_step import CustomStep, Steps
from rigs.steps.steps import (
    Dwell,
    EndTrial,
    Measure,
    SetLength,
    SetPressure,
    Settle,
    SettleCriterion,
    State,
    Tare,
    Trial,
    Vent,
    Zero,
)

__all__ = [
    "Analysis",
    "CustomStep",
    "Dwell",
    "EndTrial",
    "Findings",
    "Measure",
    "OwnTest",
    "Section",
    "SetLength",
    "SetPressure",
    "Settle",
    "SettleCriterion",
    "State",
    "Steps",
    "Tare",
    "Trial",
    "Vent",
    "Zero",
    "points_analysis",
]
