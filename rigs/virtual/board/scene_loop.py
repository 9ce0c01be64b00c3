"""The firmware in the loop of a scene: one valve controller for each unit, all on one tick.

Every controller is the firmware itself on a simulated board (`rigs.virtual.board.board`): it reads
its own noisy converter, obeys its own serial line and drives its own two solenoids. What is
simulated between two ticks is the whole scene at once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from plant.scene.layout import SWITCH_ON
from plant.scene.scene import Scene
from rigs.virtual.board.board import TICK_S, SimBoard
from rigs.virtual.board.pressure_sensor import PressureSensor
from valvefw.wire import TICK_US, encode_frame

Array = npt.NDArray[np.float64]

BEAT_TICKS = 100
BOOT_TICKS = 100


@dataclass
class _Row:
    state: Array
    params: Array


def _elsewhere(*_: object) -> None:
    """The scene advances for all boards together, before any of them ticks."""


class SceneBoard(SimBoard):
    """The board of one unit of a scene."""

    def __init__(self, scene: Scene, unit: int, rng: np.random.Generator, **more: Any) -> None:
        row = _Row(scene.world.units[unit], scene.world.params[unit])
        super().__init__(row, rng, advance=_elsewhere, truth_every=0, **more)
        self.rng = rng

    @property
    def on_s(self) -> tuple[float, float]:
        """How long inlet and outlet are driven within the coming tick."""
        return min(self._inlet_us, TICK_US) * 1e-6, min(self._vent_us, TICK_US) * 1e-6


class SceneLoop:
    """A scene under its controllers.

    Args:
        scene: the plant.
        seed: of the sensors' noise and the boot ids.
        sensors: one a unit, or none for nominal ones.
        parameters: firmware parameters of each unit; set before it is armed.
        sinks: by unit, takes what the firmware sends, as ``sink(bench_us, data)``.

    Attributes:
        boards: one a unit, in the scene's order.
    """

    def __init__(
        self,
        scene: Scene,
        seed: int = 1,
        sensors: Sequence[PressureSensor] | None = None,
        parameters: Sequence[Mapping[str, int]] | None = None,
        sinks: Sequence[Callable[[int, bytes], None]] | None = None,
    ) -> None:
        self.scene = scene
        self.boards = []
        for k, unit in enumerate(scene.units):
            board = SceneBoard(
                scene,
                k,
                np.random.default_rng([seed, k]),
                sensor=sensors[k] if sensors else None,
                serial=f"SIM-{k + 1:04d}",
                outlet_normally_open=unit.constants.outlet_normally == "open",
                has_regulator=unit.source == "regulator",
                sink=sinks[k] if sinks else None,
            )
            board.controller.values.update(parameters[k] if parameters else {})
            self.boards.append(board)
        self._fill, self._vent = np.zeros((2, len(self.boards)))
        self._ticks = 0
        self._beats = 0

    def boot(self) -> None:
        """Let the controllers vent and settle, then arm them."""
        for _ in range(BOOT_TICKS):
            self.tick()
        for board in self.boards:
            board.controller.safety.arm(board.controller.values)

    def ask(self, unit: int, text: str) -> None:
        """Send a request to the controller of a unit, such as ``scheme two`` or ``sp 12000``."""
        self.boards[unit].feed(encode_frame(f"Q1 {text}".encode()))

    def tick(self) -> None:
        """One millisecond: the scene advances under the last commands, then the boards tick."""
        if self._ticks % BEAT_TICKS == 0:
            self._beats += 1
            for unit in range(len(self.boards)):
                self.ask(unit, f"hb {self._beats & 0xFFFF}")
        self._ticks += 1
        for k, board in enumerate(self.boards):
            self._fill[k], self._vent[k] = board.on_s
        self.scene.advance(TICK_S, self._fill, self._vent)
        prox = self.prox_bits
        for board in self.boards:
            board.prox_bits = prox
            board.run_until_us(board.bench_us + TICK_US)

    def run_ms(self, milliseconds: int) -> None:
        """Let so many ticks pass."""
        for _ in range(milliseconds):
            self.tick()

    @property
    def prox_bits(self) -> int:
        """The scene's first switches as every controller reads them: bit 0 is A, bit 1 is B."""
        on = self.scene.world.switches[:2, SWITCH_ON]
        return sum(1 << i for i, value in enumerate(on) if value)

    @property
    def faults(self) -> list[tuple[str, str]]:
        """Latched faults: (unit, cause)."""
        return [
            (unit.name, cause)
            for unit, board in zip(self.scene.units, self.boards, strict=True)
            for cause, _ in board.controller.safety.faults
        ]
