"""The valve controller's board over the simulated ram: its proximity inputs are the ram's."""

from __future__ import annotations

from typing import Any

import numpy as np

from plant.scene.ram import Ram
from rigs.virtual.board.board import SimBoard


class RamBoard(SimBoard):
    """As `SimBoard`, which see for the keywords, on a `plant.scene.ram.Ram`."""

    def __init__(self, ram: Ram, rng: np.random.Generator, **more: Any) -> None:
        self.ram = ram
        super().__init__(ram, rng, advance=ram.step, **more)

    def prox(self) -> int:
        """Proximity inputs, as they stand at the present tick."""
        return self.ram.prox_bits
