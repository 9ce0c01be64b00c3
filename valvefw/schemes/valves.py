"""How much longer each valve shall stay open: what a scheme writes and the controller drives."""

# Longer than any pulse: means "open until told otherwise". The board's own timer bounds it.
VENT_HOLD_US = 1000000


class Valves:
    """Times to go, in us from the present tick; the controller counts them down."""

    def __init__(self) -> None:
        self.inlet_us = 0
        self.vent_us = 0
        self.prox = 0  # proximity inputs at this tick: bit 0 is A, bit 1 is B

    def shut(self) -> None:
        """Both valves shut."""
        self.inlet_us = 0
        self.vent_us = 0
