"""The flow of ISO 6358, written anew for the oracles that SciPy integrates."""

from __future__ import annotations

import numpy as np


def mass_flow(conductance: float, up: float, down: float) -> float:
    """Mass flow in kg/s, critical ratio 0.5."""
    if down >= up:
        return 0.0
    ratio = down / up
    choked = 1.185 * conductance * up
    return float(choked if ratio <= 0.5 else choked * np.sqrt(1.0 - ((ratio - 0.5) / 0.5) ** 2))
