"""Switching capture: a block of fast samples around one pulse, instead of an oscilloscope.

The board samples on its own, ``CAPTURE_N`` readings every ``CAPTURE_US``. The pulse starts
``CAPTURE_LEAD_US`` after the first reading, with a resolution of one tick. The true lead time
is measured.
"""

from valvefw.board import Board
from valvefw.wire import CAPTURE_N

UNKNOWN = -1


class Capture:
    """The last block, and the start time of its pulse."""

    def __init__(self, board: Board) -> None:
        self._board = board
        self._started_us = 0
        self.waiting = False
        self.lead_us = UNKNOWN

    def begin(self, source: int) -> bool:
        """Start sampling now; False if this board has no capture."""
        if not self._board.capture(source):
            return False
        self._started_us = self._board.ticks_us()
        self.waiting = True
        self.lead_us = UNKNOWN
        return True

    def on_drive(self, inlet_us: int, vent_us: int) -> None:
        """Called after each drive while ``waiting``: the first pulse determines the lead time."""
        if inlet_us or vent_us:
            self.waiting = False
            self.lead_us = (self._board.ticks_us() - self._started_us) & 0xFFFFFFFF

    def part(self, first: int, n: int) -> str:
        """Readings of three hexadecimal digits each; empty until the block is complete."""
        block = self._board.captured()
        if len(block) < 2 * CAPTURE_N:
            return ""
        last = min(first + n, CAPTURE_N)
        return "".join(
            ["%03x" % (block[2 * k] | block[2 * k + 1] << 8) for k in range(first, last)]
        )
