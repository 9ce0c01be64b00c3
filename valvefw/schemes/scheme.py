"""Interface of a control scheme: ``start`` when selected, then one ``step`` per tick."""

from valvefw.config import defaults
from valvefw.schemes.valves import Valves

# Opening time of a valve that stays open until a later step closes it. A loop that is late for
# less, such as by a collection of garbage (21 ms), does not interrupt the pulse.
HOLD_US = 30000


class Scheme:
    """Base of all schemes. A step uses small integers only and allocates no memory.

    Small means below 2**30: MicroPython allocates larger ones on the heap. ``start`` sets every
    attribute; the constructor calls it, so that no later call enlarges the object.
    """

    name = ""
    # True: the inlet may stay open while the host renews it (benches with a regulator).
    renews = False

    def __init__(self) -> None:
        self.start(defaults())

    def start(self, values: dict[str, int]) -> None:
        """Copy parameters and reset the state."""

    def step(self, counts: int, setpoint_x16: int, dt_us: int, valves: Valves) -> None:
        """One sample; ``valves`` holds the remaining times of pulses, write to start others."""

    def renew(self) -> None:
        """A heartbeat or set-point was received."""
