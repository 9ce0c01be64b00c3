"""Eight valve controllers with the real firmware on the eight muscles of a simulated finger.

Each millisecond the finger advances with the last valve times of the firmware. Then every
controller runs one tick with its own noisy 12-bit reading. The commands of the host (set-points,
heartbeats) are frames on the wire with the delay of the line. The joint angles that the host reads
are quantised, noisy and delayed.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from plant.constants import PlantConstants
from plant.finger import FingerSim
from plant.physics import layout
from rigs.virtual.board.pressure_sensor import ADC_TOP, PressureSensor
from rigs.virtual.board.tuning import burst_parameters, safety_parameters
from valvefw.config import config_crc
from valvefw.controller import Controller
from valvefw.deskboard import BufferedBoard
from valvefw.wire import TICK_US, encode_frame

Array = npt.NDArray[np.float64]

TICK_S = TICK_US * 1e-6
HEARTBEAT_MS = 100
NOISE_BLOCK = 2048
LEAST_SETPOINT_KPA = 10.0
"""Lowest set-point of the host; a set-point of 0 means vent."""


@dataclass(frozen=True)
class Sensing:
    """Sensors and line between finger and host; standard deviations of white noise.

    The pressure sensors are those of the reference bench (12 bit, 0.5 kPa; random zero 0.3 kPa
    and gain 0.3 %). The angle sensors are 12-bit magnetic encoders. The delay of the line is that
    of a frame of 20 bytes at 115200 baud.
    """

    angle_bits: int = 12
    angle_noise_deg: float = 0.03
    angle_delay_ms: int = 2
    line_delay_ms: int = 2
    pressure_noise_kpa: float = 0.5
    pressure_zero_kpa: float = 0.3
    pressure_gain: float = 0.003


class MuscleBoard(BufferedBoard):
    """The board of one muscle: two valves and one pressure sensor."""

    name = "sim"
    outlet_normally_open = True

    def __init__(self, serial: str, boot_id: int) -> None:
        super().__init__()
        self.serial = serial
        self.reset_cause = "power"
        self.now_us = 0
        self.counts = 0
        self.inlet_us = 0
        self.vent_us = 0
        self.switchings = 0
        self._boot_id = boot_id
        self._was_in = self._was_out = False
        self.controller = Controller(self)

    def ticks_us(self) -> int:
        """Device time."""
        return self.now_us & 0xFFFFFFFF

    def adc(self) -> int:
        """Reading at this tick."""
        return self.counts

    def drive(self, inlet_us: int, vent_us: int) -> None:
        """Set the valve times; counts how often a valve is energised."""
        self.inlet_us = inlet_us
        self.vent_us = vent_us
        now_in, now_out = inlet_us > 0, vent_us > 0
        self.switchings += (now_in and not self._was_in) + (now_out and not self._was_out)
        # A pulse shorter than a tick ends before the next tick.
        self._was_in, self._was_out = inlet_us >= TICK_US, vent_us >= TICK_US

    def tx(self, data: bytes | bytearray, n: int) -> None:
        """Discard telemetry and replies."""

    def random16(self) -> int:
        """Boot id."""
        return self._boot_id


class FingerBench:
    """Firmware and finger, synchronised. The firmware is armed by `begin`.

    Args:
        sim: the finger.
        scheme: the firmware scheme of every muscle.
        rng: for noise and errors of the sensors.
        sensing: sensors and line.
        parameters: firmware parameters in addition to those for the valve block.
        known: the constants for the setup of the firmware, if they differ from the plant's.
    """

    def __init__(
        self,
        sim: FingerSim,
        scheme: str,
        rng: np.random.Generator,
        sensing: Sensing | None = None,
        parameters: dict[str, int] | None = None,
        known: PlantConstants | None = None,
    ) -> None:
        self.sim = sim
        self.scheme = scheme
        self.sensing = sensing or Sensing()
        self._rng = rng
        count = len(sim.muscles)
        s = self.sensing
        self._sensors = [
            PressureSensor(
                noise_kpa=s.pressure_noise_kpa,
                zero_kpa=float(rng.normal(0.0, s.pressure_zero_kpa)),
                gain=float(rng.normal(0.0, s.pressure_gain)),
            )
            for _ in range(count)
        ]
        self._scale = np.array([k.counts_per_kpa * (1.0 + k.gain) * 1e-3 for k in self._sensors])
        self._offset = np.array([k.nominal_counts(k.zero_kpa) + 0.5 for k in self._sensors])
        self._noise = np.zeros((0, count))
        self._noise_at = 0
        self._on_s = np.zeros((count, 2))
        self._outbox: deque[tuple[int, int, bytes]] = deque()
        n = count // 2
        self._past = deque([sim.q_rad] * (s.angle_delay_ms + 1), maxlen=s.angle_delay_ms + 1)
        self._joints = n
        self._last_x16 = [-1] * count
        self.ms = 0
        self.beats = 0
        self.boards = [MuscleBoard(f"MUSCLE-{i}", 1 + i) for i in range(count)]
        values = firmware_parameters(known or sim.constants, parameters)
        for board in self.boards:
            board.controller.values.update(values)

    @property
    def faults(self) -> list[str]:
        """Latched faults, as "muscle: cause"."""
        return [
            f"{i}: {fault[0]}"
            for i, board in enumerate(self.boards)
            for fault in board.controller.safety.faults
        ]

    @property
    def switchings(self) -> int:
        """Number of times that a valve was energised."""
        return sum(board.switchings for board in self.boards)

    def begin(self) -> None:
        """Arm every controller and select the scheme, over the wire."""
        for i, board in enumerate(self.boards):
            crc = config_crc(board.controller.values)
            self._send(i, f"arm {crc:04x} {board.controller.telemetry.boot_id}")
            self._send(i, f"scheme {self.scheme}")
        self.run(self.sensing.line_delay_ms + 2)

    def set_pressures(self, pressure_kpa: Array) -> None:
        """Send set-points (2 n,) that changed by at least 1/16 count."""
        top = self.sim.constants.supply_pa * 1e-3
        for i, kpa in enumerate(np.clip(pressure_kpa, LEAST_SETPOINT_KPA, top)):
            x16 = round(float(kpa) * ADC_TOP / 1000.0 * 16)
            if x16 != self._last_x16[i]:
                self._last_x16[i] = x16
                self._send(i, f"sp {x16}")

    def angles(self) -> Array:
        """Angles that the host reads now: delayed, noisy, quantised (rad)."""
        s = self.sensing
        true = self._past[0]
        noisy = true + self._rng.normal(0.0, np.radians(s.angle_noise_deg), true.shape)
        step = 2.0 * np.pi / 2**s.angle_bits
        return np.asarray(np.round(noisy / step) * step)

    def run(self, ms: int) -> None:
        """Advance the simulation."""
        on_s, sim, boards = self._on_s, self.sim, self.boards
        for _ in range(ms):
            if self.ms % HEARTBEAT_MS == 0:
                self.beats += 1
                for i in range(len(boards)):
                    self._send(i, f"hb {self.beats}")
            for i, board in enumerate(boards):
                on_s[i, 0] = TICK_S if board.inlet_us >= TICK_US else board.inlet_us * 1e-6
                on_s[i, 1] = TICK_S if board.vent_us >= TICK_US else board.vent_us * 1e-6
            sim.advance(TICK_S, on_s)
            self.ms += 1
            self._past.append(sim.q_rad)
            while self._outbox and self._outbox[0][0] <= self.ms:
                _, i, data = self._outbox.popleft()
                boards[i].feed(data)
            if self._noise_at >= len(self._noise):
                self._draw()
            reading = sim.muscles[:, layout.PRESSURE] * self._scale + self._noise[self._noise_at]
            self._noise_at += 1
            counts = np.clip(reading, 0, ADC_TOP).astype(int).tolist()
            for i, board in enumerate(boards):
                board.now_us += TICK_US
                board.counts = counts[i]
                board.controller.tick()

    def _send(self, i: int, text: str) -> None:
        frame = encode_frame(f"Q1 {text}".encode())
        self._outbox.append((self.ms + self.sensing.line_delay_ms, i, frame))

    def _draw(self) -> None:
        noise = self._rng.standard_normal((NOISE_BLOCK, len(self.boards)))
        scale = np.array([k.noise_kpa * k.counts_per_kpa for k in self._sensors])
        self._noise = noise * scale + self._offset
        self._noise_at = 0


def firmware_parameters(
    constants: PlantConstants, changes: dict[str, int] | None = None
) -> dict[str, int]:
    """Parameters of every muscle's controller, from the data of the valve block.

    The leak monitor is off, because the pressure changes with closed valves when a joint moves.
    With a fast valve the burst scheme reads earlier: four samples, as soon as the valve is closed.
    """
    rest_ms = max(2, int(np.ceil(1.3e3 * max(constants.inlet_off_s, constants.outlet_off_s))))
    return {
        **burst_parameters(constants, length_mm=62.0),
        **safety_parameters(constants),
        "leak_counts": 0,
        "inlet_rest_ms": min(10, rest_ms),
        "inlet_max_ms": 2000,
        "burst_settle_us": 1000,
        "burst_window": 4,
        **(changes or {}),
    }
