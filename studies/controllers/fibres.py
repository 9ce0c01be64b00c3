"""Torque of braid friction along the reference motion, per newton of friction at 300 kPa.

The friction model is that of `plant.physics.friction`, driven by pressure and length. Here these
are the values of the reference motion, which have no noise. The travel until all fibres slip is
that of the catalogue of effects; the law estimates the magnitude of the friction.
"""

from __future__ import annotations

import numpy as np

from plant.arrays import Array
from plant.effects.muscle.braid_friction import BRAID_FRICTION
from plant.physics.friction import REFERENCE_PRESSURE_PA
from plant.physics.layout import SLIP_ELEMENTS
from studies.controllers.muscles import Pairs


class Fibres:
    """State of the fibres of every muscle along one path; `torque` updates it."""

    def __init__(self, pairs: Pairs) -> None:
        self._travel_kpa = _catalogued("travel_kpa")
        self._travel_m = _catalogued("travel_mm") * 1e-3
        self._pairs = pairs
        _, self._rest, self._arm = pairs.finger.tendons.T
        # The stiffest element slips first; see plant.physics.friction.
        self._share = 2.0 ** np.arange(SLIP_ELEMENTS - 1, -1, -1)[:, None]
        self.start()

    def start(self) -> None:
        """Start with muscles filled from vented: all fibres have slipped in one direction."""
        self._slip = np.ones((SLIP_ELEMENTS, len(self._rest)))
        self._place: Array | None = None

    def torque(self, q: Array, pressure_kpa: Array) -> Array:
        """Move the fibres to `q` and pressures; returns the torque (n,) per newton of friction.

        Args:
            q: reference angles (n,), rad.
            pressure_kpa: reference pressures (2 n,).
        """
        length = self._rest + self._arm * np.repeat(q, 2)
        place = pressure_kpa / self._travel_kpa - length / self._travel_m
        if self._place is not None:
            moved = self._slip + self._share * (place - self._place)
            self._slip = np.clip(moved, -1.0, 1.0)
        self._place = place
        lost = pressure_kpa * 1e3 / REFERENCE_PRESSURE_PA * self._slip.mean(axis=0)
        agonist, antagonist = lost.reshape(-1, 2).T
        return np.asarray(self._pairs.radius * (agonist - antagonist))


def _catalogued(name: str) -> float:
    """Default value of a parameter of braid friction in the catalogue."""
    parameters = BRAID_FRICTION.parameters
    return float(next(p.default for p in parameters if p.name == name) or 0.0)
