"""How a Modbus transmitter writes its reading, as a rig file states it."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass

from rigs.rigfile.form import Parsed

KINDS = {"int16": (1, ">h"), "uint16": (1, ">H"), "int32": (2, ">i"), "float32": (2, ">f")}
ORDERS = {"ABCD": (0, 1, 2, 3), "CDAB": (2, 3, 0, 1), "BADC": (1, 0, 3, 2), "DCBA": (3, 2, 1, 0)}
MOST_REGISTERS = 32


@dataclass(frozen=True)
class ModbusForm:
    """Where a transmitter keeps its reading and how it is written there.

    Attributes:
        quantity: what it measures, with unit: ``pressure_kpa``.
        unit: unit of the reading after ``scale``.
        device_id: Modbus address, 1 to 247.
        register: address of the first register, counted from 0.
        function: "holding" (3) or "input" (4).
        kind: int16, uint16, int32 or float32.
        word_order: byte order of a two-register value: ABCD is as Modbus says, CDAB has the
            words swapped, BADC the bytes, DCBA both. A single register uses AB or BA.
        scale, offset: reading = offset + scale * number.
        overload, underload: numbers that stand for a flag, where the transmitter has such.
        unit_register, unit_code: a register that tells the unit set on the keypad, and what it
            must hold; -1 for none.
        low, high: what the transmitter can read.
        loopback: the transmitter answers Modbus function 8 or refuses it; used to be sure
            that a late answer is not taken for the next one.
    """

    quantity: str
    unit: str
    device_id: int
    register: int
    function: str = "holding"
    kind: str = "float32"
    word_order: str = "ABCD"
    scale: float = 1.0
    offset: float = 0.0
    overload: float = math.nan
    underload: float = math.nan
    unit_register: int = -1
    unit_code: int = 0
    low: float = -1e9
    high: float = 1e9
    rate_hz: float = 5.0
    timeout_s: float = 0.3
    loopback: bool = True

    @property
    def first(self) -> int:
        """First register of the block that is read."""
        return self.register if self.unit_register < 0 else min(self.register, self.unit_register)

    @property
    def count(self) -> int:
        """Registers in the block."""
        last = max(self.register + KINDS[self.kind][0] - 1, self.unit_register)
        return last - self.first + 1

    def _order(self, size: int) -> tuple[int, ...]:
        """Which byte stands where, of one or two registers."""
        if size == 2:
            return ORDERS[self.word_order]
        return (1, 0) if self.word_order in ("BADC", "DCBA") else (0, 1)

    def number(self, words: list[int]) -> float:
        """The number in one or two registers."""
        size, code = KINDS[self.kind]
        data = struct.pack(f">{size}H", *words[:size])
        order = self._order(size)
        return float(struct.unpack(code, bytes(data[k] for k in order))[0])

    def words(self, number: float) -> list[int]:
        """Registers that hold a number: the inverse of :meth:`number`."""
        size, code = KINDS[self.kind]
        data = struct.pack(code, number if code == ">f" else round(number))
        order = self._order(size)
        out = bytearray(len(data))
        for at, k in enumerate(order):
            out[k] = data[at]
        return list(struct.unpack(f">{size}H", bytes(out)))

    def parse(self, registers: list[int]) -> Parsed:
        """The reading in a block of registers, or the fault that it shows."""
        if self.unit_register >= 0:
            code = registers[self.unit_register - self.first]
            if code != self.unit_code:
                return Parsed("unit", detail=f"unit register holds {code}, not {self.unit_code}")
        number = self.number(registers[self.register - self.first :])
        if math.isnan(number) or number == math.inf or _same(number, self.overload):
            return Parsed("overload", detail=f"registers {registers}")
        if number == -math.inf or _same(number, self.underload):
            return Parsed("underload", detail=f"registers {registers}")
        value = self.offset + self.scale * number
        if not self.low <= value <= self.high:
            return Parsed("range", detail=f"{value:g} {self.unit} (registers {registers})")
        return Parsed("", value)


def _same(number: float, flag: float) -> bool:
    """A flag as it comes back through a float32."""
    return math.isclose(number, flag, rel_tol=1e-6)
