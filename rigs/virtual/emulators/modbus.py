"""A Modbus RTU transmitter at byte level."""

from __future__ import annotations

import struct
from collections.abc import Callable

from rigs.rigfile.modbus_form import ModbusForm
from rigs.virtual.emulators.emulator import Send
from rigs.virtual.emulators.injected_fault import Wire

READY_NS = 5_000_000


def crc16(data: bytes) -> bytes:
    """Modbus CRC of some bytes, low byte first (polynomial 0xA001, start 0xFFFF)."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ 0xA001 if crc & 1 else crc >> 1
    return struct.pack("<H", crc)


class VirtualModbus:
    """Answers reads of its registers; does not use the library that its driver uses.

    Attributes:
        unit_code: what its unit register holds (the keypad's setting).
        flag: "overload" or "underload" puts that number into the value's registers.
        wire: injects faults.
        mute: True answers nothing.
    """

    def __init__(self, form: ModbusForm, read: Callable[[], float], send: Send) -> None:
        self._form = form
        self._read = read
        self._buffer = b""
        self._now_ns = 0
        self._heard_ns = 0
        self._due: list[tuple[int, bytes]] = []
        self.unit_code = form.unit_code
        self.flag = ""
        self.mute = False
        self.wire = Wire(send)

    def registers(self) -> dict[int, int]:
        """What its registers hold now."""
        form = self._form
        number = (self._read() - form.offset) / form.scale
        if self.flag == "overload":
            number = form.overload
        elif self.flag == "underload":
            number = form.underload
        out = {form.register + k: w for k, w in enumerate(form.words(number))}
        if form.unit_register >= 0:
            out[form.unit_register] = self.unit_code
        return out

    def feed(self, data: bytes) -> None:
        """Bytes from the host."""
        self._buffer += data
        while len(self._buffer) >= 8:
            frame, self._buffer = self._buffer[:8], self._buffer[8:]
            if crc16(frame[:-2]) != frame[-2:]:
                self._buffer = b""
                return
            if frame[0] == self._form.device_id:
                self._due.append((self._now_ns + READY_NS, frame))

    def _answer(self, frame: bytes) -> bytes:
        device, function, first, count = struct.unpack(">BBHH", frame[:6])
        if function == 8 and first == 0:
            return frame
        wanted = 3 if self._form.function == "holding" else 4
        if function != wanted:
            body = bytes([device, function | 0x80, 1])
        else:
            held = self.registers()
            if all(first + k in held or self._form.unit_register >= 0 for k in range(count)):
                words = [held.get(first + k, 0) for k in range(count)]
                body = bytes([device, function, 2 * count]) + struct.pack(f">{count}H", *words)
            else:
                body = bytes([device, function | 0x80, 2])
        return body + crc16(body)

    @property
    def next_ns(self) -> int | None:
        """When it next has something to do."""
        times = [t for t, _ in self._due]
        if self.wire.next_ns is not None:
            times.append(self.wire.next_ns)
        return min(times) if times else None

    def advance(self, to_ns: int) -> None:
        """Let time pass to ``to_ns`` (bench time)."""
        self._now_ns = to_ns
        for due in [d for d in self._due if d[0] <= to_ns]:
            self._due.remove(due)
            if not self.mute:
                self.wire.send(self._answer(due[1]), to_ns)
        self.wire.advance(to_ns)
