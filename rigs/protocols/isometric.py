"""The isometric test (``rigs.isometric``) among the other protocols."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from daq.layout import LiveLayout
from rigs.config import RigConfig
from rigs.isometric import Isometric, load_isometric
from rigs.protocols.procedure import Procedure
from rigs.reduction import reduce_isometric


def read(name: str, config: RigConfig) -> Isometric:
    """Its protocol file, held against the rig's limits."""
    return load_isometric(name, config.limits)


def layout(parameters: Mapping[str, Any]) -> LiveLayout:
    """Its screen."""
    from rigs.liveview import isometric_layout

    return isometric_layout(pressure_max_kpa=max(parameters.get("pressures_kpa") or [600.0]))


PROCEDURE = Procedure("isometric", "Isometric test", read, reduce_isometric, layout)
