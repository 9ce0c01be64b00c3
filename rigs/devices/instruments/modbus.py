"""A transmitter over Modbus RTU: registers in, one reading out.

Frames, checksums and messages are pymodbus's (its framer and its PDUs); the bytes go over our
own link, so that the port is opened, locked, stamped and lost like every other, and a reading
is one question and one answer under the bench's clock.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from daq.calibration import Calibration
from daq.clock import NS_PER_S
from daq.errors import ConfigError
from daq.link.transport import Chunk, Link
from rigs.devices.event_loop import Pump
from rigs.devices.instruments.instrument import Instrument
from rigs.rigfile.form import Parsed

KINDS = {"int16": (1, ">h"), "uint16": (1, ">H"), "int32": (2, ">i"), "float32": (2, ">f")}
ORDERS = {"ABCD": (0, 1, 2, 3), "CDAB": (2, 3, 0, 1), "BADC": (1, 0, 3, 2), "DCBA": (3, 2, 1, 0)}
MOST_REGISTERS = 32
LOOPBACK = 0x5041


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


class ModbusInstrument(Instrument):
    """A Modbus RTU transmitter, asked at its rate.

    Raises:
        ConfigError: pymodbus is not installed.
    """

    def __init__(
        self,
        link: Link,
        pump: Pump,
        name: str,
        form: ModbusForm,
        *,
        baud: int = 9600,
        calibration: Calibration | None = None,
        reopen: Callable[[], Link] | None = None,
    ) -> None:
        super().__init__(
            link,
            pump,
            name,
            quantity=form.quantity,
            unit=form.unit,
            rate_hz=form.rate_hz,
            timeout_s=form.timeout_s,
            polled=True,
            calibration=calibration,
            reopen=reopen,
        )
        self.form = form
        self._codec = modbus_codec()
        # 3.5 characters end a frame; adapters and pseudo-terminals make larger pauses.
        self._silence_ns = round(max(3.5 * 11 / baud, 0.01) * NS_PER_S)
        self._buffer = b""
        self._heard_ns = 0
        self._question: Any = None

    def _query(self) -> bytes:
        return self._codec.read(self.form)

    def _sentinel(self) -> bytes:
        return self._codec.loopback(self.form.device_id) if self.form.loopback else b""

    def _partial(self) -> bool:
        return bool(self._buffer)

    def _drop_partial(self) -> int:
        lost = len(self._buffer)
        self._buffer = b""
        return lost

    def _decode(self, chunk: Chunk) -> Iterator[Parsed | None]:
        self._buffer = (self._buffer + chunk.data)[-1024:]
        self._heard_ns = chunk.host_ns
        return iter(())

    def _turn(self, now_ns: int) -> None:
        """A frame is whatever came between two silences, as Modbus RTU has it."""
        # A chunk is stamped when it was read, so silence counts from there.
        if self._buffer and now_ns - self._heard_ns >= self._silence_ns:
            message, self._buffer = self._buffer, b""
            for item in self._messages(message):
                self._item(item, self._heard_ns)
        super()._turn(now_ns)

    def _messages(self, message: bytes) -> Iterator[Parsed | None]:
        """What a stretch of bytes is: nothing is searched for in it, it is right or it is not."""
        form = self.form
        size = self._codec.size(message)
        if size and len(message) > size and self._codec.size(message[size:]):
            # Two frames in one breath: two answers.
            yield from self._messages(message[:size])
            yield from self._messages(message[size:])
            return
        if not size or len(message) < size:
            yield Parsed("half", detail=message.hex(" "))
            return
        if len(message) > size:
            yield Parsed("damaged", detail=message.hex(" "))
            return
        pdu = self._codec.open(message)
        if pdu is None:
            yield Parsed("checksum", detail=message.hex(" "))
        elif message[0] != form.device_id:
            yield Parsed("stale", detail=f"device {message[0]} answered: {message.hex(' ')}")
        elif message[1] in (0x08, 0x88):
            if message[1] == 0x88 or message[4:6] == LOOPBACK.to_bytes(2, "big"):
                yield None
        elif pdu.isError():
            yield Parsed("refused", detail=f"Modbus exception {pdu.exception_code}")
        elif message[1] != (3 if form.function == "holding" else 4):
            yield Parsed("damaged", detail=message.hex(" "))
        elif len(pdu.registers) != form.count:
            yield Parsed("stale", detail=f"{len(pdu.registers)} registers, asked for {form.count}")
        else:
            yield form.parse(list(pdu.registers))


class _Codec:
    """The few things that are taken from pymodbus."""

    def __init__(self) -> None:
        from pymodbus.framer import FramerRTU
        from pymodbus.pdu import DecodePDU
        from pymodbus.pdu.diag_message import ReturnQueryDataRequest
        from pymodbus.pdu.register_message import (
            ReadHoldingRegistersRequest,
            ReadInputRegistersRequest,
        )

        self._framer = FramerRTU(DecodePDU(is_server=False))
        self._reads = {
            "holding": ReadHoldingRegistersRequest,
            "input": ReadInputRegistersRequest,
        }
        self._echo = ReturnQueryDataRequest

    def read(self, form: ModbusForm) -> bytes:
        """Question for the block of registers."""
        request = self._reads[form.function](
            address=form.first, count=form.count, dev_id=form.device_id
        )
        return bytes(self._framer.buildFrame(request))

    def loopback(self, device_id: int) -> bytes:
        """Function 8: the device sends the same bytes back."""
        request = self._echo(message=LOOPBACK.to_bytes(2, "big"), dev_id=device_id)
        return bytes(self._framer.buildFrame(request))

    def size(self, message: bytes) -> int:
        """Length of the frame that begins here, 0 when that cannot be told."""
        if len(message) < 5:
            return 0
        if message[1] & 0x80:
            return 5
        if message[1] == 0x08:
            return 8
        return 5 + message[2] if message[1] in (3, 4) else 0

    def open(self, message: bytes) -> Any:
        """The PDU in a whole frame; None where the checksum does not hold."""
        from pymodbus.exceptions import ModbusException

        try:
            used, _, _, body = self._framer.decode(message)
            if used != len(message) or not body:
                return None
            return self._framer.decoder.decode(body)
        except ModbusException:
            return None


def modbus_codec() -> _Codec:
    """pymodbus, or a message that says what to install."""
    try:
        return _Codec()
    except ImportError:
        raise ConfigError(
            "pressure_transmitter",
            "needs the Python package pymodbus, which is not installed",
            "install pymodbus, or take the table out of the rig file",
        ) from None
