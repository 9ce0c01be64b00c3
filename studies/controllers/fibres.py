"""Friction of the braids along the wanted motion, a newton at 300 kPa: what a law can learn from.

Fibres slide as `plant.physics.friction` says, driven by pressure and length alike; here by the
pressures and lengths of the wanted motion, so that no noise enters. How far they must slide until
all of them slip is taken from the catalogue; how much friction there is, is for the law to find
out.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from plant.effects.catalogue import CATALOGUE
from plant.physics.friction import REFERENCE_PRESSURE_PA
from plant.physics.layout import SLIP_ELEMENTS
from studies.controllers.muscles import Pairs

Array = npt.NDArray[np.float64]


class Fibres:
    """The fibres of every muscle along one path; `torque` moves them on."""

    def __init__(self, pairs: Pairs) -> None:
        self._travel_kpa = _catalogued("travel_kpa")
        self._travel_m = _catalogued("travel_mm") * 1e-3
        self._pairs = pairs
        _, self._rest, self._arm = pairs.finger.tendons.T
        # The stiffest element yields first; see plant.physics.friction.
        self._share = 2.0 ** np.arange(SLIP_ELEMENTS - 1, -1, -1)[:, None]
        self.start()

    def start(self) -> None:
        """Begin with muscles that were filled from vented: every fibre has slid the one way."""
        self._slip = np.ones((SLIP_ELEMENTS, len(self._rest)))
        self._place: Array | None = None

    def torque(self, q: Array, pressure_kpa: Array) -> Array:
        """Torque (n,) a newton of friction takes with the fibres brought to `q` and pressures.

        Args:
            q: wanted angles (n,), rad.
            pressure_kpa: pressures wanted there (2 n,).
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
    """The catalogue's own figure for how far fibres slide."""
    entry = CATALOGUE["braid_friction"]
    return float(next(p.default for p in entry.parameters if p.name == name) or 0.0)
