"""The RP2040 (Raspberry Pi Pico). Numbers from its data sheet."""

import sys

from valvefw.boards import pico

NAME = "rp2040"
CPU_HZ = 125000000
TIMER = 0x40054000  # 4.6.5
ADC = 0x4004C000  # 4.9.6
GPIO_SET = 0xD0000014  # 2.3.1.7
GPIO_CLEAR = 0xD0000018
DREQ_ADC = 36  # 2.5.3.1
WATCHDOG_CTRL = 0x40058000  # 4.7.6
I2C1 = 0x40048000  # 4.3.17


def run() -> None:
    """Run the firmware."""
    pico.run(sys.modules[__name__])
