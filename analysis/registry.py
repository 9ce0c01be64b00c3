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
    "interactive": "points",
}  # fmt: skip
"""Protocol to module of ``analysis.findings``; its ``ANALYSES`` has an entry with that name."""


def analysis_of(protocol: object) -> Analysis:
    """The analysis of a protocol.

    A protocol that is not listed here has its settled points as result; a record that names no
    protocol is an isometric test.
    """
    name = protocol if isinstance(protocol, str) else "isometric"
    if name not in ANALYSES:
        from analysis.findings.points import points_analysis

        return points_analysis(name)
    found = {a.name: a for a in import_module(f"analysis.findings.{ANALYSES[name]}").ANALYSES}[name]
    assert isinstance(found, Analysis)
    return found
