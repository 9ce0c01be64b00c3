"""The analysis of each protocol by name; none is imported before it is needed."""

from __future__ import annotations

from importlib import import_module

from analysis.findings.findings import Analysis

ANALYSES: dict[str, str] = {
    "isometric": "isometric",
    "isobaric": "isobaric",
    "isotonic": "isotonic",
    "isothermal": "isothermal",
    "hysteresis": "hysteresis",
    "switching-time": "switching",
    "switching-voltage": "switching",
    "flow": "flow",
    "step": "step",
    "ram": "ram",
    "simulate": "simulation",
}
"""Protocol to module of ``analysis.findings``, whose ``ANALYSES`` has an entry of that name."""


def analysis_of(protocol: object) -> Analysis:
    """The analysis of a record's protocol; the isometric one where the protocol is unknown."""
    name = protocol if isinstance(protocol, str) and protocol in ANALYSES else "isometric"
    found = {a.name: a for a in import_module(f"analysis.findings.{ANALYSES[name]}").ANALYSES}[name]
    assert isinstance(found, Analysis)
    return found
