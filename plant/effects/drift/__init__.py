"""Effects that may sit anywhere and change from trial to trial."""

from __future__ import annotations

from plant.effects.drift.wear import WEAR
from plant.effects.effect import Effect

DRIFT: tuple[Effect, ...] = (WEAR,)
