"""A Trinamic module with one motor at byte level: nine bytes in, nine bytes out."""

from __future__ import annotations

import struct

from rigs.rigfile.tables.stage import StageDevice
from rigs.virtual.emulators.emulator import Emulator, Send
from rigs.virtual.emulators.motion.axis import SetMotion, StageEmulator

HOST = 2
TYPE_AND_VERSION = 1140 << 16 | 1 << 8 | 47
TELEGRAM = ">BBBBi"


class VirtualTmcl(StageEmulator):
    """A module whose speeds are microsteps a second.

    Args:
        device: of the rig file: address, motor, scale.
        limits_mm: lengths of its limit switches; it stops there.
        start_mm: length at power-up, after a reference search.
        set_motion: told of every start and end of a move.
        send: takes the bytes that go to the host.

    Attributes:
        wire: injects faults.
    """

    def __init__(
        self,
        device: StageDevice,
        limits_mm: tuple[float, float],
        start_mm: float,
        set_motion: SetMotion,
        send: Send,
    ) -> None:
        super().__init__(set_motion, send, start_mm)
        self._device = device
        self._limits_mm = limits_mm
        self._parameters = {4: 1000}
        self._variables = [0] * 56
        self._shift = 0
        self._buffer = b""

    def restart(self) -> None:
        """A brown-out: it stops, counts from 0 and forgets its user variables."""
        self._axis.halt()
        self._shift += self._count()
        self._variables = [0] * 56

    def stall(self) -> None:
        """The load detection stops the motor; TMCL says nothing by itself."""
        self._axis.halt()

    def _count(self) -> int:
        along = self._axis.where_mm() - self._device.zero_mm
        return round(along * self._device.counts_per_mm) - self._shift

    def feed(self, data: bytes) -> None:
        """Bytes from the host."""
        self._buffer += data
        while len(self._buffer) >= 9:
            telegram, self._buffer = self._buffer[:9], self._buffer[9:]
            address, command, kind, motor, value = struct.unpack(TELEGRAM, telegram[:8])
            if address != self._device.address:
                continue
            if sum(telegram[:8]) % 256 != telegram[8]:
                self._reply(1, command, 0)
                continue
            status, answer = self._do(command, kind, motor, value)
            self._reply(status, command, answer)

    def _reply(self, status: int, command: int, value: int) -> None:
        head = struct.pack(TELEGRAM, HOST, self._device.address, status, command, value)
        self.wire.send(head + bytes([sum(head) % 256]), self._now_ns)

    def _do(self, command: int, kind: int, motor: int, value: int) -> tuple[int, int]:
        axis_command = command in (3, 4, 5, 6)
        if axis_command and motor != self._device.axis:
            return 4, 0
        match command:
            case 3:
                self._axis.halt()
            case 4:
                self._go(value)
            case 5:
                self._parameters[kind] = value
            case 6:
                return self._parameter(kind)
            case 9 if motor == 2 and kind < len(self._variables):
                self._variables[kind] = value
            case 10 if motor == 2 and kind < len(self._variables):
                return 100, self._variables[kind]
            case 136:
                return 100, TYPE_AND_VERSION
            case 9 | 10:
                return 3, 0
            case _:
                return 2, 0
        return 100, value

    def _parameter(self, kind: int) -> tuple[int, int]:
        if kind == 1:
            return 100, self._count()
        if kind == 3:
            return 100, round(self._axis.rate_mm_s * self._device.counts_per_mm)
        if kind in self._parameters:
            return 100, self._parameters[kind]
        return 3, 0

    def _go(self, count: int) -> None:
        scale = self._device.counts_per_mm
        target = self._device.zero_mm + (count + self._shift) / scale
        low, high = self._limits_mm
        self._axis.move(min(max(target, low), high), self._parameters[4] / abs(scale))


def emulator(
    device: StageDevice,
    limits_mm: tuple[float, float],
    start_mm: float,
    set_motion: SetMotion,
    send: Send,
) -> Emulator:
    """The stage of a virtual bench."""
    return VirtualTmcl(device, limits_mm, start_mm, set_motion, send)
