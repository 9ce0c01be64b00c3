"""The analysis of each protocol by name. Its module is imported only when it is needed."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from analysis.findings.findings import Analysis
from daq.errors import ConfigError

if TYPE_CHECKING:
    from daq.live.layout import LiveLayout
    from daq.store.run import Run

GROUP = "pamrig.analyses"
"""Entry points of installed packages: protocol name to an ``Analysis``."""

ANALYSES: dict[str, str] = {
    **{
        name: name
        for name in (
            "isometric", "isobaric", "isotonic", "isothermal", "hysteresis", "flow", "step", "ram",
        )
    },
    "switching-time": "switching",
    "switching-voltage": "switching",
    "blocked-force": "muscle.limits",
    "free-contraction": "muscle.limits",
    "creep": "muscle.held",
    "relaxation": "muscle.held",
    "dynamic": "muscle.dynamic",
    "fatigue": "muscle.fatigue",
    "joint-static": "joint",
    "joint-step": "joint",
    "simulate": "simulation",
    "interactive": "points",
    "record": "own_controller.recording",
}  # fmt: skip
"""Protocol to module of ``analysis.findings``; its ``ANALYSES`` has an entry with that name."""


def analysis_of(protocol: object) -> Analysis:
    """The analysis of a protocol.

    A protocol that is not listed here has the analysis that an installed package brings, or else
    its settled points as result. A record that names no protocol is an isometric test.
    """
    name = protocol if isinstance(protocol, str) else "isometric"
    if name not in ANALYSES:
        return _own(name)
    found = {a.name: a for a in import_module(f"analysis.findings.{ANALYSES[name]}").ANALYSES}[name]
    assert isinstance(found, Analysis)
    return found


def layout_of(run: Run) -> LiveLayout:
    """The live layout of a recorded run; without the camera where it has no pictures.

    Raises:
        ConfigError: its protocol's analysis cannot be loaded.
    """
    from analysis.layouts.layouts import without_camera

    kind = analysis_of(run.manifest.get("protocol"))
    layout = kind.layout(run.manifest.get("parameters") or {})
    return layout if run.frames else without_camera(layout)


def _own(name: str) -> Analysis:
    from analysis.findings.points import points_analysis
    from daq.user_program import installed, load_installed

    if name not in installed(GROUP):
        return points_analysis(name)
    found = load_installed(GROUP, name)
    if not isinstance(found, Analysis):
        raise ConfigError(f"{GROUP}: {name}", "is not an Analysis")
    return found
