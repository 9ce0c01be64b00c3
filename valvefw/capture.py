"""Switching capture: a block of fast samples around one pulse, in place of an oscilloscope.

The board samples on its own, ``CAPTURE_N`` readings every ``CAPTURE_US``; the pulse begins
``CAPTURE_LEAD_US`` after the first of them, to a tick. What the lead really was is measured.
"""

from valvefw.board import Board
from valvefw.wire import CAPTURE_N

UNKNOWN = -1


class Capture:
    """The last block, and the pulse it is about."""

    def __init__(self, board: Board) -> None:
        self._board = board
        self._started_us = 0
        self.waiting = False
        self.lead_us = UNKNOWN

    def begin(self, source: int) -> bool:
        """Start sampling now; False if this board cannot."""
        if not self._board.capture(source):
            return False
        self._started_us = self._board.ticks_us()
        self.waiting = True
        self.lead_us = UNKNOWN
        return True

    def driven(self, inlet_us: int, vent_us: int) -> None:
        """The valves have just been driven while ``waiting``: the first pulse is the edge."""
        if inlet_us or vent_us:
            self.waiting = False
            self.lead_us = (self._board.ticks_us() - self._started_us) & 0xFFFFFFFF

    def part(self, first: int, n: int) -> str:
        """Readings as three hexadecimal digits each; empty until the block is complete."""
        block = self._board.captured()
        if len(block) < 2 * CAPTURE_N:
            return ""
        last = min(first + n, CAPTURE_N)
        return "".join(
            ["%03x" % (block[2 * k] | block[2 * k + 1] << 8) for k in range(first, last)]
        )
