"""Fast sampling of the simulated bench: one block at 20 kHz, while the firmware ticks on.

The second sensor stands 62 mm down the line of the valve that is tried, as in the thesis's
switching tests: what flows through the valves, later by the time that the air needs.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from plant.physics.layout import ATMOSPHERE, INLET_CONDUCTANCE, MASS_IN, MASS_OUT
from valvefw.wire import CAPTURE_N, CAPTURE_US, TICK_US

Array = npt.NDArray[np.float64]

LINE_DELAY_US = 62.0 / 65.0 * 1e3
"""62 mm at 65 m/s (thesis 5.12)."""
FLOW_TOP_KPA = 700.0
FLOW_TOP_COUNTS = 3000.0
FLOW_ZERO_COUNTS = 200.0
FLOW_NOISE_COUNTS = 8.0
BLUR_US = 5
"""The flow sensor shows the mean over this time; also the grid of commands."""
DENSITY_KG_M3 = 1.185


class Sampled(Protocol):
    """What is sampled: a simulated board."""

    plant: Any
    sensor: Any

    @property
    def pressure_slot(self) -> int:
        """Where in the plant's state the pressure sensor reads."""
        ...


class FastCapture:
    """One block in the making; ``block`` is empty until it is complete.

    Args:
        board: the board with its plant and pressure sensor.
        source: 0 pressure, 1 flow.
        rng: noise.
    """

    def __init__(self, board: Sampled, source: int, rng: np.random.Generator) -> None:
        self._board = board
        self._source = source
        self._rng = rng
        self._pressure_pa: list[float] = []
        self._mass_kg: list[float] = []
        self.block = b""

    def tick(self, advance: Callable[..., object], inlet_us: int, vent_us: int) -> None:
        """Advance the plant by one tick of the firmware, sampling as it goes."""
        state: Array = self._board.plant.state
        params: Array = self._board.plant.params
        step_us = BLUR_US if self._source else CAPTURE_US
        for at_us in range(0, TICK_US, step_us):
            if at_us % CAPTURE_US == 0:
                self._pressure_pa.append(float(state[self._board.pressure_slot]))
            self._mass_kg.append(float(state[MASS_IN] + state[MASS_OUT]))
            on_us = min(max(inlet_us - at_us, 0), step_us)
            out_us = min(max(vent_us - at_us, 0), step_us)
            advance(state, params, step_us * 1e-6, on_us * 1e-6, out_us * 1e-6)
        if len(self._pressure_pa) >= CAPTURE_N:
            self._finish(params)

    def _conductance(self, params: Array) -> float:
        """That of the inlet the sensor was scaled for, whatever the inlet has become."""
        constants = getattr(self._board.plant, "constants", None)
        if constants is None:
            return float(params[INLET_CONDUCTANCE])
        return float(constants.inlet_conductance_m3_s_pa)

    def _finish(self, params: Array) -> None:
        if self._source == 0:
            sensor = self._board.sensor
            kpa = np.array(self._pressure_pa) * 1e-3 * (1.0 + sensor.gain) + sensor.zero_kpa
            values = (kpa - sensor.low_kpa) * sensor.counts_per_kpa
            noise = sensor.noise_kpa * sensor.counts_per_kpa
        else:
            mass_us = np.arange(len(self._mass_kg)) * float(BLUR_US)
            begin_us = np.arange(len(self._pressure_pa)) * CAPTURE_US - LINE_DELAY_US - BLUR_US / 2
            mass = np.array(self._mass_kg)
            rate = np.interp(begin_us + BLUR_US, mass_us, mass) - np.interp(begin_us, mass_us, mass)
            top_pa = FLOW_TOP_KPA * 1e3 + params[ATMOSPHERE]
            top = self._conductance(params) * DENSITY_KG_M3 * top_pa * BLUR_US * 1e-6
            values = FLOW_ZERO_COUNTS + FLOW_TOP_COUNTS * rate / top
            noise = FLOW_NOISE_COUNTS
        values = values + self._rng.standard_normal(len(values)) * noise
        counts = np.clip(np.rint(values), 0, 4095)[:CAPTURE_N].astype("<u2")
        self.block = counts.tobytes()
