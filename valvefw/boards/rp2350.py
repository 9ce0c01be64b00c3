"""The RP2350 (Raspberry Pi Pico 2). Numbers from its data sheet.

Not tried: there is no emulation of this chip. The contract, the pins and the source are those of
the RP2040. Its inputs leak with pull-downs (erratum E9); this firmware uses pull-ups.
"""

import sys

from valvefw.boards import pico

NAME = "rp2350"
CPU_HZ = 150000000
TIMER = 0x400B0000  # 12.8.5, TIMER0
ADC = 0x400A0000  # 12.4.6
GPIO_SET = 0xD0000018  # 3.1.11
GPIO_CLEAR = 0xD0000020
DREQ_ADC = 48  # 12.6.4.1
WATCHDOG_CTRL = 0x400D8000  # 12.9.7
I2C1 = 0x40098000  # 12.2.17


def run() -> None:
    """Run the firmware."""
    pico.run(sys.modules[__name__])
