"""A simulated board: a simple pressure chamber in integers, equal on every interpreter.

The wire conformance tests run the firmware on it, under CPython and MicroPython. It is also the
shortest complete example of a ``Board``. Its only noise is the last bit of the reading, which
alternates: two runs are equal.
"""

from valvefw.board import I2C_NOBODY, Board
from valvefw.controller import Controller
from valvefw.wire import CAPTURE_N, CAPTURE_US, TICK_US

FILL_X16_PER_MS = 96  # 1.5 kPa/ms where 1000 kPa are 4095 counts
VENT_SHARE = 500  # per ms the pressure falls by 1/500, and by one sixteenth of a count
TOP_X16 = 4095 * 16


class BufferedBoard(Board):
    """A board whose serial line is two buffers in memory."""

    def __init__(self) -> None:
        self._received = b""
        self._sent: list[bytes] = []

    def feed(self, data: bytes) -> None:
        """Bytes from the host arrive."""
        self._received += data

    def rx(self, inbox: bytearray) -> int:
        data = self._received
        if not data:
            return 0
        n = min(len(data), len(inbox))
        inbox[:n] = data[:n]
        self._received = data[n:]
        return n

    def tx(self, data: bytes | bytearray, n: int) -> None:
        self._sent.append(bytes(data[:n]))

    def take_tx(self) -> bytes:
        """All bytes sent since the last call."""
        data = b"".join(self._sent)
        self._sent.clear()
        return data


class DeskBoard(BufferedBoard):
    """Firmware, chamber and byte buffers; ``run`` advances the virtual time."""

    name = "desk"
    serial = "DESK-1"
    gone = 0
    """Inputs whose plug is pulled: bit k is that of ``wire.INPUTS[k]``."""

    def __init__(self, boot_id: int = 4660, has_regulator: bool = False) -> None:
        self.has_regulator = has_regulator
        self.now_us = 0
        self.pressure_x16 = 0
        self.inlet_us = 0
        self.vent_us = 0
        self.regulator_x16 = 0
        self.led_on = 0
        self.override = -1
        self._boot_id = boot_id
        self._block_us = -1
        self._pulses = 0
        self._bridge_us = 0
        self._registers = [0, 0]
        self._chosen = 0
        self._edges = 0
        self.edges_lost = 0
        super().__init__()
        self.controller = Controller(self)

    def run(self, ticks: int, data: bytes = b"") -> bytes:
        """Receive ``data``, run ``ticks`` ticks, return all bytes sent."""
        self.feed(data)
        for _ in range(ticks):
            self.now_us = (self.now_us + TICK_US) & 0xFFFFFFFF
            self.controller.tick()
            self._flow()
        return self.take_tx()

    def _flow(self) -> None:
        pressure = self.pressure_x16
        inlet_us = min(self.inlet_us, TICK_US)
        vent_us = min(self.vent_us, TICK_US)
        if inlet_us and self.has_regulator:
            pressure += (self.regulator_x16 - pressure) // 100
        else:
            pressure += FILL_X16_PER_MS * inlet_us // TICK_US
        pressure -= (pressure // VENT_SHARE + 1) * vent_us // TICK_US
        self.pressure_x16 = max(0, min(TOP_X16, pressure))

    def ticks_us(self) -> int:
        return self.now_us

    def adc(self) -> int:
        """The chamber's pressure, or the override of a test."""
        if self.override >= 0:
            return self.override
        return (self.pressure_x16 >> 4) ^ ((self.now_us // TICK_US) & 1)

    def drive(self, inlet_us: int, vent_us: int) -> None:
        self.inlet_us = inlet_us
        self.vent_us = vent_us

    def regulator(self, counts_x16: int) -> None:
        self.regulator_x16 = counts_x16

    def led(self, on: int) -> None:
        self.led_on = on

    def bridge_start(self, pulses: int) -> None:
        self._pulses = pulses
        self._bridge_us = self.now_us

    def bridge(self) -> int:
        """A bridge of 1000 steps for each count of pressure, 80 conversions a second."""
        if not self._pulses or self.gone & 1 or self.now_us - self._bridge_us < 12500:
            return -1
        self._bridge_us += 12500
        value = (self.pressure_x16 * 64 >> 4) - 30000 + (self.now_us // TICK_US & 7)
        return value & 0xFFFFFF

    def i2c_begin(self, register: int, word: int) -> None:
        """A conversion takes no time here: its result is there at once."""
        self._chosen = register if word < 0 else -1
        if word >= 0:
            self._registers[register] = word
            self._registers[0] = (self.pressure_x16 >> 1) - 200 & 0xFFFF

    def i2c_done(self) -> int:
        if self.gone & 2:
            return I2C_NOBODY
        return self._registers[self._chosen] if self._chosen >= 0 else 0

    def encoder_start(self, on: int) -> None:
        self._edges = self.pressure_x16 >> 6

    def encoder(self) -> int:
        """One step for each four counts of pressure."""
        lost = self.edges_lost
        self.edges_lost = 0
        return (self._edges - (self.pressure_x16 >> 6)) & 0xFFFFFF | (lost and 0x1000000)

    def analogue(self, which: int) -> int:
        if self.gone >> which + 2 & 1:
            return -1
        return (self.pressure_x16 >> 4) // which

    def capture(self, source: int) -> bool:
        """Start a ramp, in which each sample is different."""
        self._block_us = self.now_us
        return source == 0

    def captured(self) -> bytes:
        """Complete after the capture time."""
        if self._block_us < 0 or self.now_us - self._block_us < CAPTURE_N * CAPTURE_US:
            return b""
        return b"".join([bytes((k & 255, k >> 8)) for k in range(CAPTURE_N)])

    def random16(self) -> int:
        return self._boot_id
