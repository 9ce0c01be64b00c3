"""What a control scheme is: ``start`` when chosen, then one ``step`` per tick."""

from valvefw.schemes.valves import Valves

# A valve that shall stay open until the next tick says otherwise is given this long.
HOLD_US = 2000


class Scheme:
    """Base of all schemes. A step uses small integers only and allocates nothing.

    Small means below 2**30: MicroPython keeps larger ones on the heap.
    """

    name = ""
    # True: the inlet may stay open for ever so long as the host renews it (regulator benches).
    renews = False

    def start(self, values: dict[str, int]) -> None:
        """Copy parameters and forget the past."""

    def step(self, counts: int, setpoint_x16: int, dt_us: int, valves: Valves) -> None:
        """One sample. ``valves`` holds what is left of earlier pulses; write to begin others."""

    def renew(self) -> None:
        """A heartbeat or set-point came."""
