"""How long the controller's loop is busy with a request, as measured on the emulated chip.

Figures of an RP2040 at 125 MHz with a stock MicroPython 1.28 (docs/evidence/board.md, `make
board`). A step of the safety core always runs in time. What a scheme requests takes effect at the
next step, on the chip as here, so shorter times than a millisecond change nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

from valvefw.controller import MORE, QUICK, SLOW


@dataclass(frozen=True)
class LoopTiming:
    """Times for which the loop runs no scheme, us.

    Attributes:
        quick_us: heartbeat or set-point.
        slow_us: any other request.
        collect_us: collection of garbage, when arming.
        more_us: bytes that make no request.
    """

    quick_us: int = 950
    slow_us: int = 3500
    collect_us: int = 21_000
    more_us: int = 250

    def busy_us(self, work: int) -> int:
        """After a pass of the loop that returned ``work``."""
        return {QUICK: self.quick_us, SLOW: self.slow_us, MORE: self.more_us}[work]


IDEAL = LoopTiming(0, 0, 0, 0)
"""A loop that takes no time."""
