"""Switching capture: a block of fast samples around one pulse, instead of an oscilloscope.

The board samples on its own, ``CAPTURE_N`` readings every ``CAPTURE_US``. The pulse starts
``CAPTURE_LEAD_US`` after the first reading, with a resolution of one tick. The true lead time
is measured.
"""

from valvefw.board import Board
from valvefw.core import CAPTURE_LEAD, CAPTURE_SINCE, CAPTURE_WAITS, TIME_MASK, Core
from valvefw.wire import CAPTURE_N

UNKNOWN = -1


class Capture:
    """The last block, and the start time of its pulse."""

    def __init__(self, board: Board, core: Core) -> None:
        self._board = board
        self._state = core.state
        self._state[CAPTURE_LEAD] = UNKNOWN

    @property
    def lead_us(self) -> int:
        """Time from the first reading to the pulse; negative before it."""
        return self._state[CAPTURE_LEAD]

    def begin(self, source: int) -> bool:
        """Start sampling now; False if this board has no capture."""
        if not self._board.capture(source):
            return False
        s = self._state
        s[CAPTURE_SINCE] = self._board.ticks_us() & TIME_MASK
        s[CAPTURE_LEAD] = UNKNOWN
        s[CAPTURE_WAITS] = 1
        return True

    def part(self, first: int, n: int) -> str:
        """Readings of three hexadecimal digits each; empty until the block is complete."""
        block = self._board.captured()
        if len(block) < 2 * CAPTURE_N:
            return ""
        last = min(first + n, CAPTURE_N)
        return "".join(
            ["%03x" % (block[2 * k] | block[2 * k + 1] << 8) for k in range(first, last)]
        )
