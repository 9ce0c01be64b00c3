"""What the firmware asks of a board: a template to copy for a new one.

Only a board's own file may import ``machine``. Copy this class, fill in every method and run

    controller = Controller(Board())
    # then call controller.tick() every millisecond from a timer or a polling loop

Three duties are the board's and cannot be the controller's, because they must hold when the
controller is dead:

1. At power-on and reset, before any Python runs, the pins leave the inlet shut. A normally
   open outlet then vents without current; on a normally closed one the air stays trapped until
   the firmware, a moment later, drives it open.
2. ``drive`` is timed by hardware: a pulse ends on time even if no further call comes.
3. A timer of the board's own lets go of both outputs when ``drive`` has not been called for
   ``DRIVE_SILENCE_US``, and a hardware watchdog resets the chip when ``wdt_feed`` stops.

If ``tick`` raises, the board shuts the inlet, opens the outlet and resets itself.
"""

DRIVE_SILENCE_US = 20000


class Board:
    """The interface; the attributes are read once at boot."""

    name = "template"
    serial = "0"
    outlet_normally_open = True
    has_regulator = False
    reset_cause = "power"

    def ticks_us(self) -> int:
        """Device time in us, 32 bits, wrapping."""
        raise NotImplementedError

    def adc(self) -> int:
        """Newest pressure reading, 12 bits; below 0 if none came since the last call."""
        raise NotImplementedError

    def drive(self, inlet_us: int, vent_us: int) -> None:
        """From now: fill for ``inlet_us`` then shut; vent for ``vent_us`` then shut.

        Called each tick with the time still to go, so a later call replaces an earlier one.
        A valve that is already open stays open without an edge.
        """
        raise NotImplementedError

    def regulator(self, counts_x16: int) -> None:
        """Analogue output to a pressure regulator, on the scale of the pressure reading."""

    def led(self, on: int) -> None:
        """Sync LED."""

    def prox(self) -> int:
        """Proximity inputs: bit 0 is A, bit 1 is B."""
        return 0

    def rx(self) -> bytes:
        """Bytes received since the last call; empty if none. Must not wait."""
        return b""

    def tx(self, data: bytes) -> None:
        """Send; must not wait, what does not fit is dropped whole."""

    def capture(self, source: int) -> bool:
        """Sample ``CAPTURE_N`` times every ``CAPTURE_US`` from now on, without the firmware.

        Source 0 is the pressure, 1 the second sensor. False if the board cannot.
        """
        return False

    def captured(self) -> bytes:
        """The block, two bytes a sample, low byte first; empty until it is complete."""
        return b""

    def wdt_feed(self) -> None:
        """Feed the hardware watchdog."""

    def random16(self) -> int:
        """A random number of 16 bits for the boot id."""
        raise NotImplementedError
