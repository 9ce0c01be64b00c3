# ruff: noqa: F821
# mypy: ignore-errors
"""The boards of the Raspberry Pi Pico family; the only firmware file that accesses hardware.

A Pico, a Pico 2 or a clone; what differs stands in the chip's own file (``rp2040``, ``rp2350``).
The link uses UART0 and a USB adapter, not the Pico's own USB: its driver may wait half a second
for a host that does not read. USB is used for installation. Wiring and pneumatics:
docs/reference/wiring.md.

The safety core (``core``) runs in a hard interrupt each millisecond, the rest in the loop of
``run``. The clock is the one that MicroPython starts with: neither core voltage nor flash clock
have to be changed for it.

The PIO times the valve pulses to 1 us, with one state machine per valve. A state machine counts
its last value down and switches off at the end. If the processor fails, both coils are therefore
de-energised within 20 ms. The hardware watchdog resets the chip after ``WATCHDOG_MS``; it is fed
by the loop, and only while the interrupt runs. Nothing writes files while the firmware runs: that
would hold up the interrupt for 45 ms or more.
"""

import gc
import os
import sys
import time
from array import array

import machine
import rp2
import uctypes

import micropython
from micropython import const
from valvefw.board import DRIVE_SILENCE_US, Board
from valvefw.controller import Controller
from valvefw.core import (
    INLET_US,
    LED,
    NOW,
    NOW_HIGH,
    NOW_LOW,
    PROX,
    READING,
    REPLY_HIGH,
    REPLY_LOW,
    STEP_WORST,
    TICKS,
    TIME_MASK,
    VENT_US,
    Core,
    decide,
    note,
)
from valvefw.wire import CAPTURE_N, CAPTURE_US

# Board facts.
PIN_UART_TX = 0
PIN_UART_RX = 1
PIN_INLET = 2  # gate of the inlet's transistor, 10 kOhm to ground
PIN_OUTLET = 3
PIN_LED = 4
PIN_REGULATOR = 5  # PWM through a low-pass, if there is a regulator
PIN_PROX_A = 6  # open collector to ground, active low
PIN_PROX_B = 7
PIN_BRIDGE = 8  # DOUT of a bridge converter
PIN_BRIDGE_CLOCK = 9
PIN_SDA = 10  # of I2C1: an ADS1115
PIN_SCL = 11
PIN_ENCODER = 12  # A; B is the next one
PIN_PRESSURE = 26  # ADC0: 0.5 to 4.5 V through a divider of 2:3, or 0 to 3.3 V
PIN_SECOND = 27  # ADC1
PIN_THIRD = 28  # ADC2
OUTLET_NORMALLY_OPEN = True
HAS_REGULATOR = False
BAUD = 115200
WATCHDOG_MS = 200
MICROPYTHON = (1, 28)  # the oldest that was tried; hard timer interrupts on these chips are recent
TX_BYTES = 2048
TX_FORGET_US = 200000  # by then the UART has sent them all
REGULATOR_HZ = 10000
I2C_HZ = 400000

PIO_HZ = 5000000  # five instructions per loop: 1 us
ADC_HZ = 48000000
SIO = 0xD0000000
PIO0 = 0x50200000  # words 4 and 5 are the transmit FIFOs of state machines 0 and 1
NVIC_IPR0 = 0xE000E400  # priorities of interrupts 0 to 3
DMA = 0x50000000  # 0x40 bytes a channel, word 2 is the number of transfers left
# Further inputs. The bridge's state machine is the third of PIO0, the encoder's has PIO1 to itself:
# its table fills nearly all of the memory, from address 0 on.
BRIDGE_MACHINE = const(2)
BRIDGE_HZ = 2000000  # 0.5 us an instruction
ENCODER_MACHINE = const(4)
ENCODER_HZ = 5000000  # an edge takes at most 14 instructions: 350000 a second
PIO_FSTAT = const(1)  # bits 8 to 11: receive FIFOs that are empty
PIO_RXF = const(8)
PIO_IRQ = const(12)
PIO1 = 0x50300000
DREQ_PIO1_RX0 = 12
ADS1115 = 0x48
I2C_DATA_CMD = const(4)  # words of the bus's registers
I2C_STOP = const(0x200)
I2C_RESTART = const(0x400)
I2C_READ = const(0x100)
I2C_RAW_STAT = const(13)  # bit 6: the transfer was aborted
I2C_CLR_ABRT = const(21)
I2C_STATUS = const(28)  # bit 2: all was sent, bit 5: it is active
I2C_RXFLR = const(30)

# What the interrupt needs, as addresses and numbers: a global of machine code is an object. The
# chip's file adds the addresses that differ.
_SETUP = array("I", [0, 0, SIO, PIO0, int(OUTLET_NORMALLY_OPEN), 1 << PIN_LED, 0, 0, 0, 0])
_FURTHER = array("I", [0, PIO0, PIO1, 0])  # I2C1, both PIOs; 1 while the bus reads
_COUNT = array("i", [0])  # the encoder's, written by its DMA
_TIMER = const(0)  # word 10 is the time in microseconds, 32 bits
_ADC = const(1)  # words 0 to 4 are CS, RESULT, FCS, FIFO, DIV
_GPIO = const(2)  # word 1 is GPIO_IN
_PIO = const(3)
_NORMALLY_OPEN = const(4)
_LED_BIT = const(5)
_LED_SET = const(7)
_LED_CLEAR = const(8)
_ARRIVAL = const(9)  # time of the newest interrupt, had it come at once
_EVEN = const(25)  # us; p99.9 of the arrivals is below
_DMA_CHANNEL = const(6)  # its address while a capture runs, else 0
_BLOCK = bytearray(4 * CAPTURE_N)  # samples of both inputs alternate
_core = Core()
_state = _core.state
_ring = _core.ring
_times = _core.times


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


@rp2.asm_pio(
    sideset_init=rp2.PIO.OUT_LOW, in_shiftdir=rp2.PIO.SHIFT_LEFT, out_shiftdir=rp2.PIO.SHIFT_RIGHT
)
def bridge_bits():
    """24 bits of an HX711 or ADS1232 when it is ready. Y: pulses beyond them, less one.

    The clock is high for 1 us at a time: 60 us would switch an HX711 off. The line must be high
    after the last pulse, so one that is stuck low gives nothing at all.
    """
    wrap_target()
    wait(1, pin, 0).side(0)
    wait(0, pin, 0).side(0)
    set(x, 23).side(0)
    label("bit")
    nop().side(1)
    in_(pins, 1).side(1)
    jmp(x_dec, "bit").side(0)[1]
    mov(x, y).side(0)
    label("gain")
    nop().side(1)[1]
    jmp(x_dec, "gain").side(0)[1]
    push(noblock).side(0)
    wrap()


@rp2.asm_pio(in_shiftdir=rp2.PIO.SHIFT_LEFT)
def quadrature():
    """Count in X the edges of A (first pin) and B; each new count is sent.

    Y holds the lines as they were. The first 16 instructions are the table of old BA, new BA: the
    jump into it is the decision. Both lines at once is no step: flag 0 says so.
    """
    jmp("look")  # 00 00
    jmp("up")  # 00 01
    jmp("down")  # 00 10
    jmp("bad")  # 00 11
    jmp("down")  # 01 00
    jmp("look")  # 01 01
    jmp("bad")  # 01 10
    jmp("up")  # 01 11
    jmp("up")  # 10 00
    jmp("bad")  # 10 01
    jmp("look")  # 10 10
    jmp("down")  # 10 11
    jmp("bad")  # 11 00
    jmp("down")  # 11 01
    jmp("up")  # 11 10
    jmp("look")  # 11 11
    label("bad")
    irq(0)
    jmp("look")
    label("up")
    mov(x, invert(x))
    jmp(x_dec, "back")
    label("back")
    mov(x, invert(x))
    jmp("send")
    label("down")
    jmp(x_dec, "send")
    label("send")
    mov(isr, x)
    push(noblock)
    wrap_target()
    label("look")
    mov(isr, null)
    in_(y, 2)
    in_(pins, 2)
    mov(y, isr)
    mov(pc, isr)
    wrap()
    nop()  # 32 instructions: no other place fits than from 0 on
    nop()


@micropython.viper
def _bridge() -> int:
    """The oldest word of the bridge, or -1."""
    further = ptr32(_FURTHER)
    pio = ptr32(further[1])
    if pio[PIO_FSTAT] & (256 << BRIDGE_MACHINE):
        return -1
    return pio[PIO_RXF + BRIDGE_MACHINE] & 0xFFFFFF


@micropython.viper
def _encoder() -> int:
    """The count, 24 bits; bit 24 where both lines changed at once since the last call."""
    further = ptr32(_FURTHER)
    pio = ptr32(further[2])
    count = ptr32(_COUNT)
    lost = 0
    if pio[PIO_IRQ] & 1:
        pio[PIO_IRQ] = 1
        lost = 0x1000000
    return (count[0] & 0xFFFFFF) | lost


@micropython.viper
def _i2c_send(register: int, word: int):
    """Begin to write 16 bits to a register; a negative word: to read them."""
    further = ptr32(_FURTHER)
    bus = ptr32(further[0])
    further[3] = 0
    _ = bus[I2C_CLR_ABRT]
    while bus[I2C_RXFLR]:
        _ = bus[I2C_DATA_CMD]
    bus[I2C_DATA_CMD] = register
    if word < 0:
        further[3] = 1
        bus[I2C_DATA_CMD] = I2C_READ | I2C_RESTART
        bus[I2C_DATA_CMD] = I2C_READ | I2C_STOP
    else:
        bus[I2C_DATA_CMD] = word >> 8
        bus[I2C_DATA_CMD] = (word & 255) | I2C_STOP


@micropython.viper
def _i2c_done() -> int:
    """-1 while the bus is busy, -2 without an answer, else the word that was read, or 0."""
    further = ptr32(_FURTHER)
    bus = ptr32(further[0])
    if bus[I2C_RAW_STAT] & 64:
        return -2
    if further[3]:
        if bus[I2C_RXFLR] < 2:
            return -1
        high = bus[I2C_DATA_CMD] & 255
        return high << 8 | (bus[I2C_DATA_CMD] & 255)
    if bus[I2C_STATUS] & 36 != 4:
        return -1
    return 0


@micropython.asm_thumb
def _convert(r0, r1):
    """One conversion of input ``r1``, 2 us; ``r0`` is the address of ``_SETUP``.

    The interrupt uses the converter too, so it is masked meanwhile. During a capture, and where
    the converter does not end within a few microseconds, it is -1.
    """
    lsl(r1, r1, 12)
    add(r1, r1, 5)
    cpsid(2)
    ldr(r2, [r0, 24])  # the DMA channel of a capture
    cmp(r2, 0)
    bne(NONE)
    ldr(r0, [r0, 4])  # the converter
    str(r1, [r0, 0])
    mov(r3, 100)
    mov(r2, 1)
    lsl(r2, r2, 8)
    label(WAIT)
    sub(r3, 1)
    beq(NONE)
    ldr(r1, [r0, 0])
    tst(r1, r2)
    beq(WAIT)
    ldr(r0, [r0, 4])
    b(DONE)
    label(NONE)
    mov(r0, 0)
    sub(r0, 1)
    label(DONE)
    cpsie(2)


@micropython.viper
def _interrupt(source):
    """One step of the safety core: convert, check, drive, then record."""
    setup = ptr32(_SETUP)
    s = ptr32(_state)
    timer = ptr32(setup[_TIMER])
    adc = ptr32(setup[_ADC])
    # The timer is even; how soon after it this line is reached is not: code in flash may have to
    # be fetched. Samples are therefore taken a fixed time after the earliest arrival.
    now = timer[10]
    late = now - setup[_ARRIVAL] - 1000
    if late < 0 or late > 500:
        late = 0
    arrival = now - late
    setup[_ARRIVAL] = arrival
    tries = 200
    while tries and timer[10] - arrival < _EVEN:
        tries -= 1
    now = timer[10]
    reading = -1
    channel = setup[_DMA_CHANNEL]
    if channel:
        dma = ptr32(channel)
        done = 2 * CAPTURE_N - dma[2]
        if done >= 2 * CAPTURE_N:
            adc[0] = 1  # end of the capture
            adc[2] = 0
            setup[_DMA_CHANNEL] = 0
            channel = 0
        elif done >= 2:
            block = ptr8(_BLOCK)
            at = ((done - 2) >> 1) * 4
            reading = block[at] | (block[at + 1] & 15) << 8
    if channel == 0:
        adc[0] = 5  # one conversion of input 0, 2 us
        tries = 100
        while tries:
            tries -= 1
            if adc[0] & 256:
                reading = adc[1] & 4095
                tries = 0
    s[NOW] = now & TIME_MASK
    s[NOW_LOW] = now & 65535
    s[NOW_HIGH] = (now >> 16) & 65535
    s[READING] = reading
    gpio = ptr32(setup[_GPIO])
    s[PROX] = ((gpio[1] >> 6) & 3) ^ 3
    decide(_state)
    pio = ptr32(setup[_PIO])
    inlet = s[INLET_US]
    if inlet > DRIVE_SILENCE_US:
        inlet = DRIVE_SILENCE_US
    pio[4] = inlet
    vent = s[VENT_US]
    if setup[_NORMALLY_OPEN] == 0:
        if vent > DRIVE_SILENCE_US:
            vent = DRIVE_SILENCE_US
        pio[5] = vent
    elif vent >= DRIVE_SILENCE_US:
        pio[5] = 0
    elif vent > 0:
        pio[5] = 0
        pio[5] = DRIVE_SILENCE_US + vent
    else:
        pio[5] = DRIVE_SILENCE_US
    if s[LED]:
        led = ptr32(setup[_LED_SET])
        led[0] = setup[_LED_BIT]
    else:
        led = ptr32(setup[_LED_CLEAR])
        led[0] = setup[_LED_BIT]
    note(_state, _ring, _times)
    took = timer[10] - now
    if took > s[STEP_WORST]:
        s[STEP_WORST] = took


@micropython.viper
def _stamp():
    """Device time for a reply."""
    setup = ptr32(_SETUP)
    s = ptr32(_state)
    timer = ptr32(setup[_TIMER])
    now = timer[10]
    s[REPLY_LOW] = now & 65535
    s[REPLY_HIGH] = (now >> 16) & 65535


@micropython.asm_thumb
def _wait(r0, r1):
    """Sleep until the word at address ``r0`` is no longer ``r1``: until the next step.

    Interrupts are masked between the look and the sleep, which ends all the same when one is due;
    else a step in between would be seen a millisecond late.
    """
    label(AGAIN)
    cpsid(2)
    ldr(r2, [r0, 0])
    cmp(r2, r1)
    bne(DONE)
    wfi()
    cpsie(2)
    b(AGAIN)
    label(DONE)
    cpsie(2)


class Pico(Board):
    """A Pico with two valves, a pressure sensor and the options of the constants above."""

    outlet_normally_open = OUTLET_NORMALLY_OPEN
    has_regulator = HAS_REGULATOR

    def __init__(self, chip) -> None:
        self.name = chip.NAME
        self._dreq = chip.DREQ_ADC
        self._watchdog_ctrl = chip.WATCHDOG_CTRL
        _SETUP[_TIMER] = chip.TIMER
        _SETUP[_ADC] = chip.ADC
        _SETUP[_LED_SET] = chip.GPIO_SET
        _SETUP[_LED_CLEAR] = chip.GPIO_CLEAR
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
        machine.Pin(PIN_LED, machine.Pin.OUT, value=0)
        machine.Pin(PIN_PROX_A, machine.Pin.IN, machine.Pin.PULL_UP)
        machine.Pin(PIN_PROX_B, machine.Pin.IN, machine.Pin.PULL_UP)
        machine.ADC(PIN_PRESSURE)
        machine.ADC(PIN_SECOND)
        machine.ADC(PIN_THIRD)
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
        self._queued_at_us = time.ticks_us()
        self._watchdog = None
        self._dma = None
        self._timer = None
        self._source = 0
        self._bridge = None
        self._encoder = None
        self._counted = None
        self.bridge = _bridge
        self.i2c_begin = _i2c_send
        self.i2c_done = _i2c_done
        _FURTHER[0] = chip.I2C1
        _FURTHER[1] = PIO0
        _FURTHER[2] = PIO1

    def start(self) -> None:
        """Run the safety core each millisecond from now on."""
        self._timer = machine.Timer(
            -1, freq=1000, mode=machine.Timer.PERIODIC, callback=_interrupt, hard=True
        )
        # Timer 3, byte 3: before the UART's interrupt, which would delay a step by up to 40 us.
        machine.mem32[NVIC_IPR0] = machine.mem32[NVIC_IPR0] & 0x00FFFFFF

    def stop(self) -> None:
        """No more steps; de-energise both coils."""
        if self._timer is not None:
            self._timer.deinit()
        self.let_go()

    def ticks_us(self) -> int:
        return machine.mem32[_SETUP[_TIMER] + 0x28] & 0xFFFFFFFF

    def stamp(self, state) -> None:
        _stamp()

    def drive(self, inlet_us: int, vent_us: int) -> None:
        """Vent, for the time until the interrupt drives."""
        self._inlet.put(0)
        self._outlet.put(0 if OUTLET_NORMALLY_OPEN else DRIVE_SILENCE_US)

    def regulator(self, counts_x16: int) -> None:
        if self._regulator is not None:
            self._regulator.duty_u16(counts_x16)

    @micropython.native
    def rx(self, inbox) -> int:
        # A request for more bytes than available would wait 1 to 2 ms for the rest.
        held = self._uart.any()
        if not held:
            return 0
        return self._uart.readinto(inbox, held if held < len(inbox) else len(inbox)) or 0

    @micropython.native
    def tx(self, data, n: int) -> None:
        """Write to the UART buffer; drop all if it does not fit."""
        now_us = time.ticks_us()
        past_us = time.ticks_diff(now_us, self._queued_at_us)
        if not 0 <= past_us < TX_FORGET_US:
            self._queued = 0
            self._queued_at_us = now_us
        else:
            sent = past_us * (BAUD // 100) // 100000
            if sent:
                self._queued_at_us = now_us
                self._queued = self._queued - sent if self._queued > sent else 0
        if self._queued + n <= TX_BYTES - 64:
            self._uart.write(data, n)
            self._queued += n

    def bridge_start(self, pulses: int) -> None:
        if self._bridge is None:
            if not pulses:
                return
            data = machine.Pin(PIN_BRIDGE, machine.Pin.IN, machine.Pin.PULL_UP)
            clock = machine.Pin(PIN_BRIDGE_CLOCK, machine.Pin.OUT, value=0)
            self._bridge = rp2.StateMachine(
                BRIDGE_MACHINE, bridge_bits, freq=BRIDGE_HZ, in_base=data, sideset_base=clock
            )
        self._bridge.active(0)
        self._bridge.restart()
        while self._bridge.rx_fifo():
            self._bridge.get()
        if pulses:
            self._bridge.put(pulses - 25)
            self._bridge.exec("pull()")
            self._bridge.exec("mov(y, osr)")
            self._bridge.active(1)

    def i2c_start(self, on: int) -> None:
        """Set the bus up; from then on its registers are used directly, so that nothing waits."""
        if not on:
            return
        machine.I2C(1, sda=machine.Pin(PIN_SDA), scl=machine.Pin(PIN_SCL), freq=I2C_HZ)
        base = _FURTHER[0]
        machine.mem32[base + 0x6C] = 0  # the address can be set while it is off
        machine.mem32[base + 0x04] = ADS1115
        machine.mem32[base + 0x6C] = 1

    def encoder_start(self, on: int) -> None:
        """Count from 0 on. A DMA channel writes each count to memory, the newest one last."""
        if self._counted is not None:
            self._encoder.active(0)
            self._counted.close()
            self._counted = None
        if not on:
            return
        first = machine.Pin(PIN_ENCODER, machine.Pin.IN, machine.Pin.PULL_UP)
        machine.Pin(PIN_ENCODER + 1, machine.Pin.IN, machine.Pin.PULL_UP)
        if self._encoder is None:
            self._encoder = rp2.StateMachine(
                ENCODER_MACHINE, quadrature, freq=ENCODER_HZ, in_base=first
            )
        self._encoder.restart()
        while self._encoder.rx_fifo():
            self._encoder.get()
        _COUNT[0] = 0
        self._encoder.exec("set(x, 0)")
        self._encoder.exec("mov(isr, null)")
        self._encoder.exec("in_(pins, 2)")
        self._encoder.exec("mov(y, isr)")
        machine.mem32[PIO1 + 4 * PIO_IRQ] = 1
        self._counted = rp2.DMA()
        self._counted.config(
            read=PIO1 + 4 * PIO_RXF,
            write=_COUNT,
            count=0x0FFFFFFF,  # as many as an RP2350 takes
            ctrl=self._counted.pack_ctrl(
                size=2, inc_read=False, inc_write=False, treq_sel=DREQ_PIO1_RX0
            ),
        )
        self._counted.active(1)
        self._encoder.active(1)

    def encoder(self) -> int:
        if not self._counted.count:  # its last transfer was made: 1.3 km at 5 um
            return 0x1000000
        return _encoder()

    def analogue(self, which: int) -> int:
        return _convert(_SETUP, which)

    def tidy(self) -> None:
        gc.collect()

    @micropython.native
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
        if self._dma is not None:
            self._dma.close()
        self._source = source
        dma = self._dma = rp2.DMA()
        dma.config(
            read=_SETUP[_ADC] + 0x0C,
            write=_BLOCK,
            count=2 * CAPTURE_N,
            ctrl=dma.pack_ctrl(size=1, inc_read=False, treq_sel=self._dreq),
        )
        adc = _SETUP[_ADC]
        machine.mem32[adc + 0x10] = (ADC_HZ * CAPTURE_US // 2000000 - 1) << 8
        while machine.mem32[adc + 8] >> 16 & 0x0F:
            _ = machine.mem32[adc + 0x0C]
        masked = machine.disable_irq()
        dma.active(1)
        machine.mem32[adc + 8] = 1 << 24 | 1 << 3 | 1  # request at one sample, to the DMA
        machine.mem32[adc] = 0b11 << 16 | 1 << 3 | 1  # inputs 0 and 1, free running
        _SETUP[_DMA_CHANNEL] = DMA + 0x40 * dma.channel
        machine.enable_irq(masked)
        return True

    def captured(self) -> bytes:
        """Every second sample."""
        if self._dma is None or _SETUP[_DMA_CHANNEL]:
            return b""
        out = bytearray(2 * CAPTURE_N)
        for k in range(CAPTURE_N):
            out[2 * k] = _BLOCK[4 * k + 2 * self._source]
            out[2 * k + 1] = _BLOCK[4 * k + 2 * self._source + 1] & 0x0F
        return bytes(out)

    def let_go(self) -> None:
        """De-energise both coils, as without power."""
        self._inlet.put(0)
        self._outlet.put(0)

    def stop_watchdog(self) -> None:
        """For use at the prompt, with de-energised coils."""
        ctrl = self._watchdog_ctrl
        machine.mem32[ctrl] = machine.mem32[ctrl] & ~(1 << 30)  # bit 30 enables


def run(chip) -> None:
    """The loop around the safety core; de-energise the valves on any exception."""
    if sys.implementation.version < MICROPYTHON:
        raise RuntimeError("valvefw needs MicroPython %d.%d or newer" % MICROPYTHON)
    if machine.freq() != chip.CPU_HZ:
        machine.freq(chip.CPU_HZ)
    board = Pico(chip)
    try:
        controller = Controller(board, _core)
        board.start()
        count = uctypes.addressof(_state) + 4 * TICKS
        while True:
            if not controller.loop():
                _wait(count, _state[TICKS])
    except KeyboardInterrupt:
        board.stop()
        board.stop_watchdog()
        raise
    except BaseException:
        board.stop()
        machine.reset()
