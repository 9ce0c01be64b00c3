"""The board interface of the firmware, and a template for a new board.

Only a board's own file may import ``machine``. Copy this class, implement every method and run

    controller = Controller(Board())
    # then call controller.tick() every millisecond from a timer or a polling loop; or, better,
    # controller.step() from an interrupt and controller.loop() as often as possible

The board itself must ensure three properties, because they must hold when the controller fails:

1. At power-on and reset, before any Python runs, the pins keep the inlet closed. A normally
open outlet then vents without current. Behind a normally closed one the air stays trapped until
the firmware opens it shortly after. 2. Hardware times ``drive``: a pulse ends on time even
without a further call. 3. A timer of the board de-energises both outputs when ``drive`` was not
called for ``DRIVE_SILENCE_US``. A hardware watchdog resets the chip when ``wdt_feed`` is not
called.

If ``tick`` raises, the board closes the inlet, opens the outlet and resets itself.
"""

from valvefw.core import REPLY_HIGH, REPLY_LOW

DRIVE_SILENCE_US = 20000
I2C_BUSY = -1
I2C_NOBODY = -2


class Board:
    """The interface; the attributes are read once at boot."""

    name = "template"
    serial = "0"
    outlet_normally_open = True
    has_regulator = False
    reset_cause = "power"

    def ticks_us(self) -> int:
        """Device time, us, 32 bits, overflows."""
        raise NotImplementedError

    def adc(self) -> int:
        """Pressure reading of this step, 12 bits; negative if there is none."""
        raise NotImplementedError

    def drive(self, inlet_us: int, vent_us: int) -> None:
        """From now on: open the inlet for ``inlet_us`` and the outlet for ``vent_us``.

        Called each tick with the remaining times; a later call replaces an earlier one. A valve
        that is already open stays open without a switching edge.
        """
        raise NotImplementedError

    def regulator(self, counts_x16: int) -> None:
        """Analogue output to a pressure regulator, in units of the pressure reading."""

    def led(self, on: int) -> None:
        """Sync LED."""

    def prox(self) -> int:
        """Proximity inputs: bit 0 is A, bit 1 is B."""
        return 0

    def rx(self, inbox: bytearray) -> int:
        """Copy received bytes to ``inbox``; returns how many there were. Must not wait."""
        return 0

    def tx(self, data: bytes | bytearray, n: int) -> None:
        """Send the first ``n`` bytes without waiting; drop all if there is no space."""

    def stamp(self, state) -> None:  # type: ignore[no-untyped-def]
        """Write the device time to ``REPLY_LOW`` and ``REPLY_HIGH`` of the core's state."""
        now_us = self.ticks_us()
        state[REPLY_LOW] = now_us & 0xFFFF
        state[REPLY_HIGH] = now_us >> 16

    def capture(self, source: int) -> bool:
        """Start ``CAPTURE_N`` samples every ``CAPTURE_US``, without the firmware.

        Source 0 is the pressure, 1 the second sensor. False if the board has no capture.
        """
        return False

    def captured(self) -> bytes:
        """The block, two bytes per sample, low byte first; empty until it is complete."""
        return b""

    # Further inputs, which a board may lack. None of these may wait, and what the loop calls each
    # millisecond may not allocate; those named ``start`` are called while disarmed only.

    def bridge_start(self, pulses: int) -> None:
        """Read a bridge converter (HX711, ADS1232) with so many clock pulses a conversion; 0: no
        more."""

    def bridge(self) -> int:
        """The next conversion, 24 bits as they came; negative if there is none."""
        return -1

    def i2c_start(self, on: int) -> None:
        """Use the two-wire bus; its only device is an ADS1115 at the address 0x48."""

    def i2c_begin(self, register: int, word: int) -> None:
        """Begin to write 16 bits to a register, or to read them where ``word`` is negative."""

    def i2c_done(self) -> int:
        """What became of the last transfer: ``I2C_BUSY``, ``I2C_NOBODY``, or the word (0 after
        writing)."""
        return I2C_NOBODY

    def encoder_start(self, on: int) -> None:
        """Count the edges of both lines of a quadrature encoder from 0 on."""

    def encoder(self) -> int:
        """The count, 24 bits; bit 24 is set if both lines changed at once since the last call."""
        return -1

    def analogue(self, which: int) -> int:
        """Reading of the second (1) or third (2) analogue input now, 12 bits; negative: none."""
        return -1

    def tidy(self) -> None:
        """Free memory, which may take milliseconds: called while vented."""

    def wdt_feed(self) -> None:
        """Feed the hardware watchdog."""

    def random16(self) -> int:
        """A random 16-bit number for the boot id."""
        raise NotImplementedError
