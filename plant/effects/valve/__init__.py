"""Effects of the timing of the valves, in the order of the specification."""

from __future__ import annotations

from plant.effects.effect import Effect
from plant.effects.valve.transport_delay import TRANSPORT_DELAY
from plant.effects.valve.valve_delay import VALVE_DELAY
from plant.effects.valve.valve_delay_pressure import VALVE_DELAY_PRESSURE

VALVE: tuple[Effect, ...] = (VALVE_DELAY, VALVE_DELAY_PRESSURE, TRANSPORT_DELAY)
