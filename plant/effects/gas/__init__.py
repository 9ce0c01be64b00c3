"""Effects of gas, conductances and supply, in the order of the specification."""

from __future__ import annotations

from plant.effects.effect import Effect
from plant.effects.gas.critical_ratio import CRITICAL_RATIO
from plant.effects.gas.dead_volume import DEAD_VOLUME
from plant.effects.gas.flow_area import FLOW_AREA
from plant.effects.gas.leak import LEAK
from plant.effects.gas.polytropic import POLYTROPIC
from plant.effects.gas.supply_droop import SUPPLY_DROOP

GAS: tuple[Effect, ...] = (DEAD_VOLUME, POLYTROPIC, LEAK, FLOW_AREA, CRITICAL_RATIO, SUPPLY_DROOP)
