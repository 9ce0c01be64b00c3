"""Requests from the received bytes, in buffers that are made once."""

from array import array

from valvefw.board import Board
from valvefw.native import const, micropython, ptr8, ptr32
from valvefw.wire import ONE_BLOCK, unseal

INBOX = 256

_AT = const(0)
_N = const(1)
_HELD = const(2)
_LOST = const(3)


@micropython.viper
def _collect(w: ptr32, inbox: ptr8, frame: ptr8) -> int:
    """Move bytes from the inbox to the frame up to a zero; 1 if there was one.

    A frame that is too long is counted and skipped: its length is then beyond ``ONE_BLOCK``.
    """
    at = w[_AT]
    n = w[_N]
    held = w[_HELD]
    found = 0
    while at < n and found == 0:
        byte = inbox[at]
        at += 1
        if byte == 0:
            found = 1
        elif held < ONE_BLOCK:
            frame[held] = byte
            held += 1
        else:
            if held == ONE_BLOCK:
                w[_LOST] = w[_LOST] + held
                held += 1
            w[_LOST] = w[_LOST] + 1
    w[_AT] = at
    w[_HELD] = held
    return found


class Receiver:
    """Frames from a board's bytes; the newest valid payload stands in ``frame`` from byte 1 on."""

    def __init__(self, board: Board) -> None:
        self._board = board
        self._inbox = bytearray(INBOX)
        self._state = array("i", [0] * 4)
        self.frame = bytearray(ONE_BLOCK)
        self.bad_frames = 0

    @property
    def lost_bytes(self) -> int:
        """Bytes in frames that were too long."""
        return self._state[_LOST]

    def next(self) -> int:
        """Length of the next valid payload; 0 if no byte was there, negative if more may follow.

        One call takes at most one frame or one inbox, so that a flood of bytes cannot hold up the
        loop.
        """
        w = self._state
        if w[_AT] == w[_N]:
            w[_AT] = 0
            w[_N] = self._board.rx(self._inbox)
            if not w[_N]:
                return 0
        if not _collect(w, self._inbox, self.frame):
            return -1
        size = w[_HELD]
        w[_HELD] = 0
        if not size or size > ONE_BLOCK:
            return -1  # a host may send zeros to resynchronise
        size = unseal(self.frame, size)
        if size <= 0:
            self.bad_frames += 1
            return -1
        return size


@micropython.viper
def split(frame: ptr8, size: int, words: ptr32) -> int:
    """Find the words of a request of ``size`` bytes (with its type byte) in ``frame``.

    ``words`` gets start, length and decimal value of each of the first four; the value is -1 if
    the word is no decimal number of up to nine digits, and -2 less the number behind an ``@``.
    Returns the number of words, or -1 if a character is not printable.
    """
    n = 0
    at = 2
    end = size + 1
    length = 0
    value = 0
    mark = 0
    while at <= end:
        byte = 32
        if at < end:
            byte = frame[at]
        if byte < 32 or byte > 126:
            return -1
        if byte != 32:
            length += 1
            if byte == 64 and length == 1:
                mark = 1
            else:
                if byte < 48 or byte > 57 or length > 9:
                    value = -1
                if value >= 0:
                    value = value * 10 + byte - 48
        elif length:
            if mark and value >= 0:
                value = -2 - value
            if n < 4:
                words[3 * n] = at - length
                words[3 * n + 1] = length
                words[3 * n + 2] = value
            n += 1
            length = 0
            value = 0
            mark = 0
        at += 1
    return n
