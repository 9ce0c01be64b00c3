"""The ADS1115 on the two-wire bus: one conversion at a time, each step of it in another tick.

A conversion is started, its flag is read until it is set, then its result is read. Each transfer
takes 0.1 ms on the bus; it is begun in one pass of the loop and its result is looked at in the
next, so that nothing waits. What is read belongs to the start before it: a result can be neither
old nor repeated. Registers and bits: data sheet SBAS444, 8.6.
"""

from valvefw.board import I2C_BUSY, Board
from valvefw.native import const, micropython

CONVERSION = const(0)  # registers
CONFIG = const(1)
START = const(0x8000)  # write: begin; read: no conversion runs
SINGLE = const(0x0100)
NO_COMPARATOR = const(0x0003)

OFF = const(0)
IDLE = const(1)
STARTING = const(2)
CONVERTING = const(3)
READING = const(4)

LOOKS_MS = const(6)  # a conversion is begun, asked for and read in passes of their own
RATES = (8, 16, 32, 64, 128, 250, 475, 860)


class Ads1115:
    """One of these converters, at the address 0x48."""

    def __init__(self, board: Board) -> None:
        self._board = board
        self._stage = OFF
        self._config = 0

    def start(self, setting: int, period_ms: int) -> None:
        """Settings: 0 for off, else 1 + multiplexer + 8 * range.

        The rate is the slowest, and so the quietest, whose conversions fit the period.
        """
        self._board.i2c_start(setting > 0)
        self._stage = IDLE if setting else OFF
        rate = 0
        while rate < 7 and 1100 // RATES[rate] + LOOKS_MS > period_ms:  # it is off by a tenth
            rate += 1
        mux = setting - 1 & 7
        gain = setting - 1 >> 3
        self._config = START | mux << 12 | gain << 9 | SINGLE | rate << 5 | NO_COMPARATOR

    @micropython.native
    def step(self, due: int) -> int:
        """One pass: a result of 16 bits, or a negative number."""
        board = self._board
        stage = self._stage
        if stage == IDLE:
            if due:
                board.i2c_begin(CONFIG, self._config)
                self._stage = STARTING
            return -1
        word = board.i2c_done()
        if word == I2C_BUSY:
            return -1
        if word < 0:  # nobody answers: begin anew with the next one that is due
            self._stage = IDLE
            return -1
        if stage == READING:
            self._stage = IDLE
            return word
        if stage == CONVERTING and word & START:
            board.i2c_begin(CONVERSION, -1)
            self._stage = READING
            return -1
        board.i2c_begin(CONFIG, -1)
        self._stage = CONVERTING
        return -1
