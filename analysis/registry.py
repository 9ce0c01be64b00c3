"""The analysis of each protocol by name. Its module is imported only when it is needed."""

from __future__ import annotations

from importlib import import_module

from analysis.findings.findings import Analysis

ANALYSES: dict[str, str] = {
    **{
        name: name
        for name in (
            "isometric", "isobaric", "isotonic", "isothermal", "hysteresis", "flow", "step", "ram",
        )
    },
    "switching-time": "switching",
    "switching-voltage": "switching",
    "simulate": "simulation",
}  # fmt: skip
"""Protocol to module of ``analysis.findings``; its ``ANALYSES`` has an entry with that name."""


def analysis_of(protocol: object) -> Analysis:
    """The analysis of a protocol; that of isometric tests if the protocol is unknown."""
    name = protocol if isinstance(protocol, str) and protocol in ANALYSES else "isometric"
    found = {a.name: a for a in import_module(f"analysis.findings.{ANALYSES[name]}").ANALYSES}[name]
    assert isinstance(found, Analysis)
    return found
