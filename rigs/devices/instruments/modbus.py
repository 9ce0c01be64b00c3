"""A transmitter over Modbus RTU: registers in, one reading out.

Frames, checksums and messages are pymodbus's (its framer and its PDUs); the bytes go over our
own link, so that the port is opened, locked, stamped and lost like every other, and a reading
is one question and one answer under the bench's clock.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from daq.calibration import Calibration
from daq.clock import NS_PER_S
from daq.errors import ConfigError
from daq.link.transport import Chunk, Link
from rigs.devices.event_loop import EventLoop
from rigs.devices.instruments.instrument import PortInstrument
from rigs.rigfile.form import Parsed
from rigs.rigfile.modbus_form import ModbusForm

LOOPBACK = 0x5041


class ModbusInstrument(PortInstrument):
    """A Modbus RTU transmitter, polled at its rate.

    Raises:
        ConfigError: pymodbus is not installed.
    """

    def __init__(
        self,
        link: Link,
        event_loop: EventLoop,
        name: str,
        form: ModbusForm,
        *,
        baud: int = 9600,
        calibration: Calibration | None = None,
        reopen: Callable[[], Link] | None = None,
    ) -> None:
        super().__init__(
            link, event_loop, name, form, polled=True, calibration=calibration, reopen=reopen
        )
        self.form = form
        self._codec = modbus_codec()
        # 3.5 characters end a frame; adapters and pseudo-terminals make larger pauses.
        self._silence_ns = round(max(3.5 * 11 / baud, 0.01) * NS_PER_S)
        self._buffer = b""
        self._heard_ns = 0

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
        """Length of the frame that begins here, 0 when that is not known yet."""
        if len(message) < 5:
            return 0
        if message[1] & 0x80:
            return 5
        if message[1] == 0x08:
            return 8
        return 5 + message[2] if message[1] in (3, 4) else 0

    def open(self, message: bytes) -> Any:
        """The PDU in a whole frame; None where the wrong checksum."""
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
