"""The Pico's further inputs on pins made of Python: its PIO programs against emulated parts."""

from __future__ import annotations

import itertools
import random
from typing import Any

import pytest

import rp2040_pins
from rp2040_pins import StateMachine
from valvefw.board import I2C_BUSY, I2C_NOBODY
from valvefw.controller import Controller


class Converter:
    """HX711 or ADS1232 at its two lines: bits at rising edges, high after the 25th."""

    def __init__(self) -> None:
        self.line = 1
        self.word = 0
        self.pulses = 0
        self.counts: list[int] = []
        self.highest = 0

    def ready(self, word: int) -> None:
        if self.pulses:
            self.counts.append(self.pulses)
        self.word, self.pulses, self.line = word & 0xFFFFFF, 0, 0

    def clock(self, level: int) -> None:
        if level:
            self.pulses += 1
            self.line = self.word >> 24 - self.pulses & 1 if self.pulses <= 24 else 1


def pico() -> tuple[Any, Any]:
    """The board's module, and the board."""
    module: Any = rp2040_pins.load()[0]
    return module, module.Pico(module.chip)


def with_converter(pulses: int) -> tuple[Any, StateMachine, Converter]:
    _, board = pico()
    board.bridge_start(pulses)
    machine = StateMachine.made[-1]
    converter = Converter()
    machine.lines = lambda: converter.line
    machine.on_side = converter.clock
    return board, machine, converter


@pytest.mark.parametrize("pulses", [25, 26, 27])
@pytest.mark.parametrize("word", [0, 1, -1, 0x7FFFFF, -0x800000, 0x2AAAAA, -0x123456])
def test_every_bit_and_the_gain_pulses(pulses: int, word: int) -> None:
    board, machine, converter = with_converter(pulses)
    machine.run_us(200)
    assert board.bridge() == -1  # not ready
    for _ in range(3):
        converter.ready(word)
        machine.run_us(200)
        assert board.bridge() == word & 0xFFFFFF
        assert board.bridge() == -1
    assert converter.counts == [pulses] * 2
    assert converter.pulses == pulses


def test_the_clock_is_never_high_long_enough_to_switch_an_hx711_off() -> None:
    _, machine, converter = with_converter(27)
    edges: list[tuple[int, int]] = []
    clock = converter.clock

    def told(level: int) -> None:
        clock(level)
        edges.append((machine.cycle, level))

    machine.on_side = told
    machine.run_us(200)
    converter.ready(0x555555)
    machine.run_us(200)
    assert len(edges) == 54
    times = [cycle / machine.freq * 1e6 for cycle, _ in edges]
    widths = [b - a for a, b in itertools.pairwise(times)]
    assert max(widths[0::2]) <= 2.0  # high: 50 us at most
    assert min(widths) >= 0.5  # high and low: 0.2 us at least


def test_a_line_that_is_stuck_low_or_high_gives_nothing() -> None:
    board, machine, converter = with_converter(25)
    machine.run_us(200)
    converter.ready(5)
    machine.run_us(200)
    assert board.bridge() == 5
    for level in (0, 1):
        machine.lines = lambda level=level: level  # type: ignore[misc]
        machine.run_us(5000)
        words = [board.bridge() for _ in range(4)]
        assert [word for word in words if word >= 0] in ([], [0])  # low in its last transfer
        assert len([w for w in words if w >= 0]) <= 1


def test_readings_of_the_chip_reach_the_wire_as_those_of_the_simulated_board() -> None:
    module, board = pico()
    controller = Controller(board, module._core)
    controller.values["bridge"] = 5
    controller.channels.load(controller.values)
    machine = StateMachine.made[-1]
    converter = Converter()
    machine.lines, machine.on_side = (lambda: converter.line), converter.clock
    timer = rp2040_pins.Registers.TIMER
    memory = module.machine.mem32
    for ms in range(1, 400):
        if ms % 13 == 0:
            converter.ready(-1000 - ms)
        for made in StateMachine.made:
            made.run_us(200 if made is machine else 10)
        memory[timer] += 1000
        module._interrupt(None)
        while controller.loop():
            pass
    sent = [frame for frame in board._uart.told if len(frame) > 2 and b"X" in frame[:3]]
    assert len(sent) >= 3


# ---- encoder --------------------------------------------------------------------------

GRAY = (0b00, 0b01, 0b11, 0b10)  # BA, A first


def with_encoder() -> tuple[Any, StateMachine, list[int]]:
    _, board = pico()
    lines = [0b00]
    made = StateMachine.__init__

    def wired(self: StateMachine, *args: Any, **options: Any) -> None:
        made(self, *args, **options)
        self.lines = lambda: lines[0]

    StateMachine.__init__ = wired  # type: ignore[method-assign]
    try:
        board.encoder_start(1)
    finally:
        StateMachine.__init__ = made  # type: ignore[method-assign]
    return board, StateMachine.made[-1], lines


def test_edges_are_counted_both_ways_at_300_khz() -> None:
    board, machine, lines = with_encoder()
    rng = random.Random(1)
    position = 0
    for _ in range(3000):
        position += rng.choice((-1, 1, 1, 0))
        lines[0] = GRAY[position % 4]
        machine.run_us(1e6 / 300_000)
        assert board.encoder() == board.encoder()
    machine.run_us(10)
    assert board.encoder() == position & 0xFFFFFF
    for _ in range(2000):
        position -= 1
        lines[0] = GRAY[position % 4]
        machine.run_us(1e6 / 300_000)
    machine.run_us(10)
    assert position < 0
    assert board.encoder() == position & 0xFFFFFF


def test_both_lines_at_once_are_told_once() -> None:
    board, machine, lines = with_encoder()
    machine.run_us(10)
    assert board.encoder() == 0
    lines[0] = 0b11
    machine.run_us(10)
    assert board.encoder() == 0x1000000
    assert board.encoder() == 0


@pytest.mark.parametrize("level", GRAY)
def test_the_count_begins_at_0_wherever_the_lines_are(level: int) -> None:
    board, machine, lines = with_encoder()
    lines[0] = level
    board.encoder_start(0)
    board.encoder_start(1)
    machine.run_us(50)
    assert board.encoder() == 0


def test_the_table_fills_the_whole_memory_so_that_it_lies_at_0() -> None:
    module, _ = pico()
    assert len(module.quadrature) == 32
    assert len(module.pulse) + len(module.hold_shut) + len(module.bridge_bits) <= 32


# ---- two-wire bus ---------------------------------------------------------------------


class Bus:
    """Registers of the bus's controller, as far as a transfer uses them."""

    def __init__(self) -> None:
        self.commands: list[int] = []
        self.received: list[int] = []
        self.abort = 0
        self.busy = 0

    def __getitem__(self, word: int) -> int:
        if word == 21:
            self.abort = 0
        return {
            4: lambda: self.received.pop(0), 13: lambda: self.abort, 21: lambda: 0,
            28: lambda: 33 if self.busy else 4, 30: lambda: len(self.received),
        }[word]()  # fmt: skip

    def __setitem__(self, word: int, value: int) -> None:
        assert word == 4
        self.commands.append(value)


def with_bus() -> tuple[Any, Bus]:
    module, board = pico()
    bus, pointer = Bus(), module.ptr32
    base = module._FURTHER[0]
    module.ptr32 = lambda to: bus if to == base and isinstance(to, int) else pointer(to)
    return board, bus


def test_a_write_and_a_read_on_the_bus() -> None:
    board, bus = with_bus()
    bus.received = [9, 9, 9]  # left over
    bus.busy = 1
    board.i2c_begin(1, 0xC383)
    assert bus.commands == [1, 0xC3, 0x83 | 0x200]
    assert bus.received == []
    assert board.i2c_done() == I2C_BUSY
    bus.busy = 0
    assert board.i2c_done() == 0
    bus.commands.clear()
    board.i2c_begin(0, -1)
    assert bus.commands == [0, 0x100 | 0x400, 0x100 | 0x200]
    bus.received = [0x12]
    assert board.i2c_done() == I2C_BUSY
    bus.received = [0x12, 0x34]
    assert board.i2c_done() == 0x1234


def test_nobody_on_the_bus_is_told_and_forgotten_with_the_next_transfer() -> None:
    board, bus = with_bus()
    board.i2c_begin(1, 5)
    bus.abort = 64
    assert board.i2c_done() == I2C_NOBODY
    board.i2c_begin(1, 5)
    assert board.i2c_done() == 0
