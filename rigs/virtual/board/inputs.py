"""Converters and an encoder at the pins of the simulated board, as their data sheets describe them.

They give raw counts, with noise, rate, settling and ends of the real part. The firmware reads them
by the same calls as on the chip. What may go wrong with each is an attribute that a test sets.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping

import numpy as np

from rigs.rigfile.tables.channel import BRIDGES, ENDS, ControllerChannel
from valvefw.board import I2C_NOBODY
from valvefw.inputs.ads1115 import RATES

Truth = Callable[[], float]
"""The reading, in counts, that an ideal converter would give now; not rounded."""

BRIDGE_PPM = 12_000.0
"""The HX711's own oscillator is slower than the data sheet's typical value by this much."""
ADC16_FAST = 0.04
"""Share by which the ADS1115 is faster; its data sheet allows a tenth."""
HX711_NOISE = {(128, 10): 21.0, (128, 80): 38.0, (64, 10): 17.0, (64, 80): 30.0,
               (32, 10): 15.0, (32, 80): 26.0}  # fmt: skip
"""Counts, rms: 50 and 90 nV at gain 128 (data sheet), of 20 mV over 2**23 counts."""
ADS1232_NOISE = {10: 6.0, 80: 14.0}
"""Counts, rms, at gain 128: 17 and 44 nV (data sheet), of 19.5 mV over 2**23 counts."""
ADC16_NOISE = 0.4
"""Counts, rms; the data sheet has one count peak to peak from +-2.048 V on."""
CHIP_NOISE = 1.2
"""Counts, rms, of the RP2040's converter."""
STEPS = 4
"""Conversions after which a bridge converter has settled; each mean has so many parts of each."""
WAKE_CONVERSIONS = 4


class VirtualBridge:
    """HX711 or ADS1232: 24 bits, a mean over four conversions, ready at its own rate.

    Attributes:
        gone: its plug is pulled. The transfer that runs then ends in ones.
        stuck: it converts no more and repeats its last result.
        pull: added to the input, counts: an overload, or the zero after a fall.
    """

    def __init__(self, channel: ControllerChannel, truth: Truth, rng: np.random.Generator) -> None:
        rate = round(channel.form.rate_hz)
        known = HX711_NOISE.get((channel.gain, rate), 0.0)
        self._noise = known or ADS1232_NOISE[rate]
        self._truth = truth
        self._rng = rng
        self._low, self._high = ENDS[channel.chip]
        self._period_us = 1e6 / rate * (1.0 + BRIDGE_PPM * 1e-6)
        self._parts: deque[float] = deque(maxlen=STEPS * STEPS)
        self._next_us = self._part_us = 0.0
        self._on = False
        self._word = 0
        self._torn = False
        self._gone = False
        self.stuck = False
        self.pull = 0.0

    @property
    def gone(self) -> bool:
        """Whether its plug is pulled."""
        return self._gone

    @gone.setter
    def gone(self, gone: bool) -> None:
        self._torn = gone and not self._gone
        self._gone = gone
        self._parts.clear()

    def start(self, pulses: int, now_us: int) -> None:
        """Power and clock; 0 pulses: none."""
        self._on = pulses > 0
        self._next_us = now_us + WAKE_CONVERSIONS * self._period_us
        self._part_us = float(now_us)
        self._parts.clear()

    def read(self, now_us: int) -> int:
        """The word of a conversion that is ready, else a negative number."""
        if not self._on:
            return -1
        if now_us >= self._part_us and not self._gone:
            self._part_us = now_us + self._period_us / STEPS
            self._parts.append(self._truth() + self.pull)
        if now_us < self._next_us:
            return -1
        self._next_us += self._period_us
        if self._gone:
            if not self._torn:
                self._next_us = now_us + WAKE_CONVERSIONS * self._period_us
                return -1
            self._torn = False
            return self._word | (1 << int(self._rng.integers(1, 24))) - 1
        if not self.stuck and self._parts:
            mean = sum(self._parts) / len(self._parts)
            value = round(mean + float(self._rng.normal(0.0, self._noise)))
            self._word = min(max(value, self._low), self._high) & 0xFFFFFF
        return self._word


class VirtualAds1115:
    """Registers of the converter, and one conversion at a time.

    Attributes:
        gone: its plug is pulled.
        pull: added to the input, counts.
    """

    def __init__(self, truth: Truth, rng: np.random.Generator) -> None:
        self._truth = truth
        self._rng = rng
        self._config = 0x8583
        self._result = 0
        self._done_us = 0.0
        self._before = 0.0
        self._answer = 0
        self.gone = False
        self.pull = 0.0

    def write(self, register: int, word: int, now_us: int) -> None:
        """Two bytes to a register; bit 15 of the configuration begins a conversion."""
        self._answer = 0
        if self.gone or register != 1:
            return
        self._config = word & 0x7FFF
        if word & 0x8000:
            rate = RATES[word >> 5 & 7] * (1.0 + ADC16_FAST)
            self._done_us = now_us + 1e6 / rate
            self._before = self._truth()

    def read(self, register: int, now_us: int) -> None:
        """Two bytes of a register."""
        if self._done_us and now_us >= self._done_us:
            self._done_us = 0.0
            mean = 0.5 * (self._before + self._truth()) + self.pull
            value = round(mean + float(self._rng.normal(0.0, ADC16_NOISE)))
            self._result = min(max(value, -(2**15)), 2**15 - 1)
        idle = 0 if self._done_us else 0x8000
        self._answer = self._result & 0xFFFF if register == 0 else self._config | idle

    def done(self) -> int:
        """The answer to the last transfer."""
        return I2C_NOBODY if self.gone else self._answer


class VirtualEncoder:
    """Counts edges since it was started; the first start is where its calibration has its zero.

    Attributes:
        gone: its plug is pulled: no more edges.
        glitch: both lines change at once, as by a disturbance, before the next reading.
    """

    def __init__(self, truth: Truth) -> None:
        self._truth = truth
        self._started = False
        self._zero = 0
        self._count = 0
        self.gone = False
        self.glitch = False

    def start(self, on: int) -> None:
        """Count from 0 on, wherever it stands."""
        if on:
            self._zero = int(np.floor(self._truth())) if self._started else 0
            self._started = True

    def read(self) -> int:
        """Count of 24 bits, and whether it is not valid any more."""
        if not self.gone:
            self._count = int(np.floor(self._truth())) - self._zero
        lost, self.glitch = self.glitch, False
        if lost:
            self._zero += 2
        return self._count & 0xFFFFFF | (0x1000000 if lost else 0)


class VirtualAnalogue:
    """An input of the chip's own converter.

    Attributes:
        gone: its wire is broken; the input then reads 0.
    """

    def __init__(self, truth: Truth, rng: np.random.Generator) -> None:
        self._truth = truth
        self._rng = rng
        self.gone = False

    def read(self) -> int:
        """One conversion."""
        if self.gone:
            return 0
        return min(max(round(self._truth() + float(self._rng.normal(0.0, CHIP_NOISE))), 0), 4095)


class VirtualInputs:
    """Everything at the further inputs of one board.

    Args:
        channels: of the rig file.
        truth: gives the ideal reading of each, in counts, by the channel's name.
        rng: source of the noise.

    Attributes:
        parts: the emulated parts by the channel's name.
    """

    def __init__(
        self,
        channels: Mapping[str, ControllerChannel],
        truth: Mapping[str, Truth],
        rng: np.random.Generator,
    ) -> None:
        self._bridge: VirtualBridge | None = None
        self._adc16: VirtualAds1115 | None = None
        self._encoder: VirtualEncoder | None = None
        self._analogue: dict[int, VirtualAnalogue] = {}
        self.parts: dict[str, VirtualBridge | VirtualAds1115 | VirtualEncoder | VirtualAnalogue]
        self.parts = {}
        for name, channel in channels.items():
            if channel.chip in BRIDGES:
                self.parts[name] = self._bridge = VirtualBridge(channel, truth[name], rng)
            elif channel.chip == "ads1115":
                self.parts[name] = self._adc16 = VirtualAds1115(truth[name], rng)
            elif channel.chip == "encoder":
                self.parts[name] = self._encoder = VirtualEncoder(truth[name])
            else:
                analogue = VirtualAnalogue(truth[name], rng)
                self.parts[name] = analogue
                self._analogue[1 if channel.input == "second" else 2] = analogue

    def bridge_start(self, pulses: int, now_us: int) -> None:
        """See ``Board``."""
        if self._bridge is not None:
            self._bridge.start(pulses, now_us)

    def bridge(self, now_us: int) -> int:
        """See ``Board``."""
        return -1 if self._bridge is None else self._bridge.read(now_us)

    def i2c_begin(self, register: int, word: int, now_us: int) -> None:
        """See ``Board``."""
        if self._adc16 is not None and word < 0:
            self._adc16.read(register, now_us)
        elif self._adc16 is not None:
            self._adc16.write(register, word, now_us)

    def i2c_done(self) -> int:
        """See ``Board``."""
        return I2C_NOBODY if self._adc16 is None else self._adc16.done()

    def encoder_start(self, on: int) -> None:
        """See ``Board``."""
        if self._encoder is not None:
            self._encoder.start(on)

    def encoder(self) -> int:
        """See ``Board``."""
        return -1 if self._encoder is None else self._encoder.read()

    def analogue(self, which: int) -> int:
        """See ``Board``."""
        part = self._analogue.get(which)
        return -1 if part is None else part.read()
