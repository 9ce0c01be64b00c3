"""A Zaber stage at byte level: the part of its ASCII protocol that a length axis uses."""

from __future__ import annotations

import re

from rigs.rigfile.tables.stage import StageDevice
from rigs.virtual.emulators.emulator import Emulator, Send
from rigs.virtual.emulators.motion.axis import SetMotion, StageEmulator

_COMMAND = re.compile(r"/(?:(\d+)(?: (\d+))?(?: (\d+|--))?)?\s*([a-z][^:]*)?(?::([0-9A-F]{2}))?")
DEVICE_ID = "50081"
VERSION = "7.38"


class VirtualZaber(StageEmulator):
    """A device with one axis that counts microsteps.

    Args:
        device: of the rig file: address, scale, serial number.
        limits_mm: lengths between which it can go; a target beyond them is refused (BADDATA).
        start_mm: length at power-up, at which it is homed.
        set_motion: told of every start and end of a move.
        send: takes the bytes that go to the host.

    Attributes:
        flags: warning flags, the highest first.
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
        self.flags: list[str] = []
        self._settings = {"comm.checksum": 0, "maxspeed": 153_600}
        self._shift = 0
        self._buffer = b""

    def restart(self) -> None:
        """A brown-out: it stops, counts from 0 and has no reference."""
        self._axis.halt()
        self._shift = round(self._true_count())
        self.flags = ["WR"]

    def stall(self) -> None:
        """The carriage meets an obstacle."""
        self._axis.halt()
        self.flags = ["FS"]

    def _true_count(self) -> float:
        return (self._axis.where_mm() - self._device.zero_mm) * self._device.counts_per_mm

    def feed(self, data: bytes) -> None:
        """Bytes from the host; a line ends with LF or CR."""
        *lines, self._buffer = re.split(rb"[\r\n]", self._buffer + data)
        for raw in lines:
            line = raw.decode("ascii", "replace").strip()
            match = _COMMAND.fullmatch(line)
            if match is None or not self._sums_up(line):
                continue  # it does not answer what it cannot read
            if int(match[1] or 0) in (0, self._device.address):
                self._answer(int(match[2] or 0), match[3], (match[4] or "").split())

    @staticmethod
    def _sums_up(line: str) -> bool:
        body, colon, given = line.partition(":")
        total = sum(ord(c) for c in body[1:])
        return not colon or (total + int(given, 16)) % 256 == 0

    def _answer(self, axis: int, number: str | None, words: list[str]) -> None:
        ok, data = self._do(axis, words)
        motion = "BUSY" if self._axis.moving else "IDLE"
        flag = self.flags[0] if self.flags else "--"
        named = f" {number}" if number is not None else ""
        taken = "OK" if ok else "RJ"
        text = f"@{self._device.address:02d} {axis}{named} {taken} {motion} {flag} {data}"
        if self._settings["comm.checksum"]:
            total = sum(ord(c) for c in text[1:])
            text += f":{(256 - total % 256) % 256:02X}"
        self.wire.send(text.encode("ascii") + b"\r\n", self._now_ns)

    def _do(self, axis: int, words: list[str]) -> tuple[bool, str]:
        if axis not in (0, self._device.axis):
            return False, "BADAXIS"
        match words:
            case []:
                return True, "0"
            case ["get", "pos"]:
                return True, str(round(self._true_count()) - self._shift)
            case ["get", "system.serial"]:
                return True, self._device.serial
            case ["get", "device.id"]:
                return True, DEVICE_ID
            case ["get", "version"]:
                return True, VERSION
            case ["set", name, value] if name in self._settings:
                self._settings[name] = int(value)
                return True, "0"
            case ["move", "abs", count]:
                return self._go(int(count))
            case ["stop"]:
                self._axis.halt()
                return True, "0"
        return False, "BADCOMMAND"

    def _go(self, count: int) -> tuple[bool, str]:
        target = self._device.zero_mm + (count + self._shift) / self._device.counts_per_mm
        low, high = self._limits_mm
        if not low - 1e-3 <= target <= high + 1e-3:
            return False, "BADDATA"
        per_s = self._settings["maxspeed"] / 1.6384
        self._axis.move(target, per_s / abs(self._device.counts_per_mm))
        return True, "0"


def emulator(
    device: StageDevice,
    limits_mm: tuple[float, float],
    start_mm: float,
    set_motion: SetMotion,
    send: Send,
) -> Emulator:
    """The stage of a virtual bench."""
    return VirtualZaber(device, limits_mm, start_mm, set_motion, send)
