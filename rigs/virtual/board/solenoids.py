"""The solenoids of a valve block under the voltage that a bench supply gives them.

A solenoid without current pulls in only at its pull-in voltage, which grows with the pressure
that it opens against; once in, it stays in down to its drop-out voltage (Tables D-4).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from plant.constants import PlantConstants
from plant.physics.layout import PRESSURE, SUPPLY
from plant.physics.valve import drop_out_v, pull_in_v
from plant.simulator.bench import advance

Array = npt.NDArray[np.float64]


class Solenoids:
    """Stands between the board's valve commands and the plant.

    Args:
        constants: pull-in and drop-out voltages.
        volts: the voltage at the coils now.
        step: the plant's stepping function.
    """

    def __init__(
        self,
        constants: PlantConstants,
        volts: Callable[[], float],
        step: Any = advance,
    ) -> None:
        self._constants = constants
        self._volts = volts
        self._step = step
        self._open_at_rest = constants.outlet_normally == "open"
        self.inlet_in = False
        self.outlet_in = False

    def _pulls(self, which: Any, is_in: bool, upstream_pa: float) -> bool:
        volts = self._volts()
        if is_in:
            return volts > drop_out_v(which, self._constants)
        return volts >= pull_in_v(which, upstream_pa, self._constants)

    def advance(
        self, state: Array, params: Array, dt_s: float, inlet_on_s: float, vent_on_s: float
    ) -> None:
        """One control tick: a solenoid that does not pull leaves its valve where its spring is."""
        if inlet_on_s > 0.0:
            self.inlet_in = self._pulls("inlet", self.inlet_in, float(state[SUPPLY]))
            if not self.inlet_in:
                inlet_on_s = 0.0
        # Energised is "shut" for a normally open outlet, "open" for a normally closed one.
        energised = vent_on_s < dt_s if self._open_at_rest else vent_on_s > 0.0
        if energised:
            self.outlet_in = self._pulls("outlet", self.outlet_in, float(state[PRESSURE]))
            if not self.outlet_in:
                vent_on_s = dt_s if self._open_at_rest else 0.0
        self._step(state, params, dt_s, inlet_on_s, vent_on_s)
        if inlet_on_s < dt_s:
            self.inlet_in = False
        if (vent_on_s > 0.0) if self._open_at_rest else (vent_on_s < dt_s):
            self.outlet_in = False
