"""The isometric test (``rigs.protocols.isometric_method``) among the other protocols."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from analysis.reduction.points import reduce_isometric
from daq.live.layout import LiveLayout
from rigs.execution.procedure import Procedure
from rigs.protocols.isometric_method import Isometric, load_isometric
from rigs.rigfile.config import RigConfig


def read(name: str, config: RigConfig) -> Isometric:
    """Its protocol file, held against the rig's limits."""
    return load_isometric(name, config.limits)


def layout(parameters: Mapping[str, Any]) -> LiveLayout:
    """Its screen."""
    from analysis.layouts.layouts import isometric_layout

    return isometric_layout(pressure_max_kpa=max(parameters.get("pressures_kpa") or [600.0]))


PROCEDURE = Procedure("isometric", "Isometric test", read, reduce_isometric, layout)
