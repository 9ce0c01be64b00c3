"""Effects of the load that hangs on the muscle, in the order of the specification."""

from __future__ import annotations

from plant.effects.effect import Effect
from plant.effects.load.link_friction import LINK_FRICTION
from plant.effects.load.payload import PAYLOAD

LOAD: tuple[Effect, ...] = (LINK_FRICTION, PAYLOAD)
