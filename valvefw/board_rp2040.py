# ruff: noqa: F821
# mypy: ignore-errors
"""The RP2040 board; the only firmware file that accesses hardware.

A Raspberry Pi Pico or a clone. The link uses UART0 and a USB adapter, not the Pico's own USB:
its driver may wait half a second for a host that does not read. USB is used for installation.
Wiring
and pneumatics: docs/reference/wiring.md.

The PIO times the valve pulses to 1 us, with one state machine per valve. A state machine counts
its last value down and switches off at the end. If the processor fails, both coils are
therefore de-energised within 20 ms. The hardware watchdog resets the chip after
``WATCHDOG_MS``.
"""

import os
import time

import machine
import rp2

from valvefw.board import DRIVE_SILENCE_US, Board
from valvefw.controller import Controller
from valvefw.wire import CAPTURE_N, CAPTURE_US, TICK_US

# Board facts.
PIN_UART_TX = 0
PIN_UART_RX = 1
PIN_INLET = 2  # gate of the inlet's transistor, 10 kOhm to ground
PIN_OUTLET = 3
PIN_LED = 4
PIN_REGULATOR = 5  # PWM through a low-pass, if there is a regulator
PIN_PROX_A = 6  # open collector to ground, active low
PIN_PROX_B = 7
PIN_PRESSURE = 26  # ADC0: 0.5 to 4.5 V through a divider of 2:3, or 0 to 3.3 V
PIN_SECOND = 27  # ADC1
OUTLET_NORMALLY_OPEN = True
HAS_REGULATOR = False
BAUD = 115200
WATCHDOG_MS = 200
CPU_HZ = 200000000  # the chip's highest certified clock; a tick in Python needs it
TX_BYTES = 2048
RX_BYTES = 256  # per tick
MAKE_UP_US = 20000  # ticks with a larger delay are skipped
REGULATOR_HZ = 10000

PIO_HZ = 5000000  # five instructions per loop: 1 us
ADC_BASE = 0x4004C000  # RP2040 data sheet 4.9.6
ADC_CS = ADC_BASE
ADC_FCS = ADC_BASE + 0x08
ADC_FIFO = ADC_BASE + 0x0C
ADC_DIV = ADC_BASE + 0x10
ADC_HZ = 48000000
DREQ_ADC = 36
TIMER_RAW_LOW = 0x40054028  # 4.6.5: microseconds, 32 bits
WATCHDOG_CTRL = 0x40058000  # 4.7.6: bit 30 enables


@rp2.asm_pio(set_init=rp2.PIO.OUT_LOW)
def pulse():
    """Pin high for the number of us in the newest word; a word of 0 ends the pulse."""
    label("loop")
    pull(noblock)  # without a new word, OSR becomes X
    mov(x, osr)
    jmp(not_x, "off")
    set(pins, 1)
    jmp(x_dec, "loop")
    label("off")
    set(pins, 0)
    jmp("loop")


@rp2.asm_pio(set_init=rp2.PIO.OUT_LOW)
def hold_shut():
    """Normally open outlet. Y is 20000; a word is the time until the coil is de-energised, us.

    The coil is energised when the count passes Y. A word of Y closes the outlet at once, a word
    of Y + n after n us of venting (send 0 first, which vents at once).
    """
    label("loop")
    pull(noblock)
    mov(x, osr)
    jmp(not_x, "off")
    jmp(x_not_y, "count")
    set(pins, 1)
    label("count")
    jmp(x_dec, "loop")
    label("off")
    set(pins, 0)
    jmp("loop")


class RP2040(Board):
    """A Pico with two valves, a pressure sensor and the options of the constants above."""

    name = "rp2040"
    outlet_normally_open = OUTLET_NORMALLY_OPEN
    has_regulator = HAS_REGULATOR

    def __init__(self) -> None:
        self._inlet = rp2.StateMachine(
            0, pulse, freq=PIO_HZ, set_base=machine.Pin(PIN_INLET, machine.Pin.OUT, value=0)
        )
        self._outlet = rp2.StateMachine(
            1,
            hold_shut if OUTLET_NORMALLY_OPEN else pulse,
            freq=PIO_HZ,
            set_base=machine.Pin(PIN_OUTLET, machine.Pin.OUT, value=0),
        )
        if OUTLET_NORMALLY_OPEN:
            self._outlet.put(DRIVE_SILENCE_US)
            self._outlet.exec("pull()")
            self._outlet.exec("mov(y, osr)")
        self._inlet.put(0)
        self._outlet.put(0)
        self._inlet.active(1)
        self._outlet.active(1)
        self.serial = "".join(["%02x" % byte for byte in machine.unique_id()])
        cause = machine.reset_cause()
        self.reset_cause = "watchdog" if cause == machine.WDT_RESET else "power"
        self._led = machine.Pin(PIN_LED, machine.Pin.OUT, value=0)
        self._prox_a = machine.Pin(PIN_PROX_A, machine.Pin.IN, machine.Pin.PULL_UP)
        self._prox_b = machine.Pin(PIN_PROX_B, machine.Pin.IN, machine.Pin.PULL_UP)
        self._pressure = machine.ADC(PIN_PRESSURE)
        self._second = machine.ADC(PIN_SECOND)
        self._regulator = None
        if HAS_REGULATOR:
            self._regulator = machine.PWM(machine.Pin(PIN_REGULATOR), freq=REGULATOR_HZ, duty_u16=0)
        self._uart = machine.UART(
            0,
            BAUD,
            tx=machine.Pin(PIN_UART_TX),
            rx=machine.Pin(PIN_UART_RX),
            txbuf=TX_BYTES,
            rxbuf=1024,
            timeout=0,
        )
        self._queued = 0
        self._queued_at_us = self.ticks_us()
        self._watchdog = None
        self._dma = None
        self._block = bytearray(4 * CAPTURE_N)  # samples of both inputs alternate
        self._source = 0

    def ticks_us(self) -> int:
        return machine.mem32[TIMER_RAW_LOW] & 0xFFFFFFFF

    def adc(self) -> int:
        """One conversion, 2 us; during a capture the newest sample."""
        dma = self._dma
        if dma is not None:
            done = 2 * CAPTURE_N - dma.count
            if done < 2:
                return -1
            if done < 2 * CAPTURE_N:
                at = ((done - 2) & ~1) * 2
                return self._block[at] | (self._block[at + 1] & 0x0F) << 8
            self._end_capture()
        return self._pressure.read_u16() >> 4

    def drive(self, inlet_us: int, vent_us: int) -> None:
        """Words for the state machines, limited to the board's time-out."""
        self._inlet.put(inlet_us if inlet_us < DRIVE_SILENCE_US else DRIVE_SILENCE_US)
        outlet = self._outlet
        if not OUTLET_NORMALLY_OPEN:
            outlet.put(vent_us if vent_us < DRIVE_SILENCE_US else DRIVE_SILENCE_US)
        elif vent_us >= DRIVE_SILENCE_US:
            outlet.put(0)
        elif vent_us > 0:
            outlet.put(0)
            outlet.put(DRIVE_SILENCE_US + vent_us)
        else:
            outlet.put(DRIVE_SILENCE_US)

    def regulator(self, counts_x16: int) -> None:
        if self._regulator is not None:
            self._regulator.duty_u16(counts_x16)

    def led(self, on: int) -> None:
        self._led.value(on)

    def prox(self) -> int:
        return (1 - self._prox_a.value()) | (1 - self._prox_b.value()) << 1

    def rx(self) -> bytes:
        # A request for more bytes than available would wait 1 to 2 ms for the rest.
        held = self._uart.any()
        return self._uart.read(held if held < RX_BYTES else RX_BYTES) or b"" if held else b""

    def tx(self, data: bytes) -> None:
        """Write to the UART buffer; drop ``data`` as a whole if it does not fit."""
        now_us = self.ticks_us()
        sent = ((now_us - self._queued_at_us) & 0xFFFFFFFF) * (BAUD // 100) // 100000
        if sent:
            self._queued_at_us = now_us
            self._queued = self._queued - sent if self._queued > sent else 0
        if self._queued + len(data) <= TX_BYTES - 64:
            self._uart.write(data)
            self._queued += len(data)

    def wdt_feed(self) -> None:
        """The first call starts the watchdog; from then on only regular ticks prevent a reset."""
        if self._watchdog is None:
            self._watchdog = machine.WDT(timeout=WATCHDOG_MS)
        self._watchdog.feed()

    def random16(self) -> int:
        two = os.urandom(2)
        return two[0] << 8 | two[1]

    def capture(self, source: int) -> bool:
        """Sample both inputs alternately by DMA; pressure readings continue."""
        self._source = source
        machine.mem32[ADC_CS] = 1
        machine.mem32[ADC_FCS] = 1 << 24 | 1 << 3 | 1  # request at one sample, to the DMA
        machine.mem32[ADC_DIV] = (ADC_HZ * CAPTURE_US // 2000000 - 1) << 8
        while machine.mem32[ADC_FCS] >> 16 & 0x0F:
            _ = machine.mem32[ADC_FIFO]
        dma = rp2.DMA()
        dma.config(
            read=ADC_FIFO,
            write=self._block,
            count=2 * CAPTURE_N,
            ctrl=dma.pack_ctrl(size=1, inc_read=False, treq_sel=DREQ_ADC),
            trigger=True,
        )
        self._dma = dma
        machine.mem32[ADC_CS] = 0b11 << 16 | 1 << 3 | 1  # inputs 0 and 1, free running
        return True

    def _end_capture(self) -> None:
        machine.mem32[ADC_CS] = 1
        machine.mem32[ADC_FCS] = 0
        self._dma.close()
        self._dma = None

    def captured(self) -> bytes:
        """Every second sample."""
        if self._dma is not None:
            return b""
        block = self._block
        out = bytearray(2 * CAPTURE_N)
        for k in range(CAPTURE_N):
            out[2 * k] = block[4 * k + 2 * self._source]
            out[2 * k + 1] = block[4 * k + 2 * self._source + 1] & 0x0F
        return bytes(out)

    def let_go(self) -> None:
        """De-energise both coils, as without power."""
        self._inlet.put(0)
        self._outlet.put(0)

    def stop_watchdog(self) -> None:
        """For use at the prompt, with de-energised coils."""
        machine.mem32[WATCHDOG_CTRL] = machine.mem32[WATCHDOG_CTRL] & ~(1 << 30)


def run() -> None:
    """Tick every millisecond; de-energise the valves on any exception."""
    machine.freq(CPU_HZ)
    board = RP2040()
    try:
        controller = Controller(board)
        due_us = time.ticks_us()
        while True:
            now_us = time.ticks_us()
            late_us = time.ticks_diff(now_us, due_us)
            if late_us >= 0:
                # An unlimited delay would exceed the range of ticks_diff and stop the ticks.
                due_us = time.ticks_add(due_us if late_us < MAKE_UP_US else now_us, TICK_US)
                controller.tick()
    except KeyboardInterrupt:
        board.let_go()
        board.stop_watchdog()
        raise
    except BaseException:
        board.let_go()
        machine.reset()
