"""Remaining opening times of the valves, written by a scheme and driven by the controller."""

# Longer than any pulse: open until changed. The board's own timer limits it.
VENT_HOLD_US = 1000000


class Valves:
    """Remaining times, us from the current tick; the controller counts them down."""

    def __init__(self) -> None:
        self.shut()
        self.prox = 0  # proximity inputs at this tick: bit 0 is A, bit 1 is B

    def shut(self) -> None:
        """Close both valves."""
        self.inlet_us = self.vent_us = 0
