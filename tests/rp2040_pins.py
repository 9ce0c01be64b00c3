"""An RP2040 made of Python: just enough of ``machine`` and ``rp2`` to run the board's file.

The state machines are stepped instruction by instruction, so that what a test sees on the pins is
what the PIO programs do, to 0.2 us.
"""

from __future__ import annotations

import importlib
import sys
from collections import deque
from collections.abc import Callable
from types import ModuleType
from typing import Any, ClassVar

Program = list[tuple[str, tuple[Any, ...]]]


def asm_pio(**_options: Any) -> Callable[[Callable[[], None]], Program]:
    """Run the function with instructions that write themselves down."""

    def decorate(function: Callable[[], None]) -> Program:
        out: Program = []
        labels: dict[str, int] = {}

        def instruction(name: str) -> Callable[..., None]:
            return lambda *args: out.append((name, args))

        names: dict[str, Any] = {n: instruction(n) for n in ("pull", "mov", "jmp", "set")}
        names["label"] = lambda name: labels.__setitem__(name, len(out))
        names.update({n: n for n in ("noblock", "x", "y", "osr", "not_x", "x_dec", "x_not_y")})
        names["pins"] = "pins"
        function.__globals__.update(names)
        function()
        for name in names:
            del function.__globals__[name]
        return [(n, (*a[:-1], labels[a[-1]])) if n == "jmp" else (n, a) for n, a in out]

    return decorate


class StateMachine:
    """One PIO state machine on one pin."""

    made: ClassVar[list[StateMachine]] = []

    def __init__(self, number: int, program: Program, freq: int, set_base: Any) -> None:
        del number, set_base
        self.program = program
        self.freq = freq
        self.fifo: deque[int] = deque()
        self.x = self.y = self.osr = self.pc = self.pin = 0
        self.running = False
        self.edges: list[tuple[float, int]] = []
        self.cycle = 0
        StateMachine.made.append(self)

    def put(self, word: int) -> None:
        assert len(self.fifo) < 4, "the FIFO is full: put would block"
        assert 0 <= word < 2**32
        self.fifo.append(word)

    def exec(self, text: str) -> None:
        if text == "pull()":
            self.osr = self.fifo.popleft()
        else:
            assert text == "mov(y, osr)"
            self.y = self.osr

    def active(self, on: int) -> None:
        self.running = bool(on)

    def run_us(self, us: float) -> None:
        for _ in range(round(us * self.freq / 1e6)):
            self._cycle()

    def _cycle(self) -> None:
        name, args = self.program[self.pc]
        self.pc = (self.pc + 1) % len(self.program)
        if name == "pull":
            self.osr = self.fifo.popleft() if self.fifo else self.x
        elif name == "mov":
            self.x = self.osr
        elif name == "set":
            if args[1] != self.pin:
                self.pin = args[1]
                self.edges.append((self.cycle / self.freq * 1e6, self.pin))
        else:
            condition = args[0] if len(args) == 2 else ""
            taken = {
                "": True,
                "not_x": self.x == 0,
                "x_dec": self.x != 0,
                "x_not_y": self.x != self.y,
            }[condition]
            if condition == "x_dec":
                self.x = (self.x - 1) & 0xFFFFFFFF
            if taken:
                self.pc = args[-1]
        self.cycle += 1


class Memory(dict[int, int]):
    """Registers."""

    def __missing__(self, key: int) -> int:
        return 0


class Registers:
    """What machine code sees at an address: words of the devices that the board's file uses."""

    TIMER = 0x40054000 + 4 * 10
    ADC_CS = 0x4004C000
    ADC_RESULT = 0x4004C004
    GPIO_IN = 0xD0000004
    PIO0_TX = 0x50200010

    def __init__(self, memory: Memory, address: int) -> None:
        self.memory = memory
        self.address = address

    def __getitem__(self, word: int) -> int:
        address = self.address + 4 * word
        if address == self.ADC_CS:
            return 1 << 8  # ready
        if address == self.ADC_RESULT:
            return 0x123
        if address == self.GPIO_IN:
            return 0b11 << 6  # pulled up
        return self.memory[address]

    def __setitem__(self, word: int, value: int) -> None:
        address = self.address + 4 * word
        machine = (address - self.PIO0_TX) // 4
        if 0 <= machine < len(StateMachine.made):
            StateMachine.made[machine].put(value)
        else:
            self.memory[address] = value


class Fake:
    """Any device that remembers what it was told and answers from ``values``."""

    def __init__(self, *args: Any, **options: Any) -> None:
        self.args = args
        self.options = options
        self.told: list[Any] = []

    def value(self, *new: int) -> int:
        self.told += new
        return 1

    def read_u16(self) -> int:
        return 0x1230

    def any(self) -> int:
        return 0

    def write(self, data: bytes, n: int) -> None:
        self.told.append(bytes(data[:n]))

    def deinit(self) -> None:
        self.told.append("off")

    def feed(self) -> None:
        self.told.append("fed")


def load(chip_name: str = "rp2040") -> tuple[ModuleType, ModuleType]:
    """The boards' file, loaded anew, with its ``chip``; and its ``machine``."""
    machine = ModuleType("machine")
    machine.mem32 = Memory()  # type: ignore[attr-defined]
    for name in ("ADC", "UART", "WDT", "PWM", "Pin", "Timer"):
        constants = {"OUT": 1, "IN": 0, "PULL_UP": 1, "PERIODIC": 1}
        setattr(machine, name, type(name, (Fake,), constants))
    machine.WDT_RESET = 3  # type: ignore[attr-defined]
    machine.reset_cause = lambda: 3  # type: ignore[attr-defined]
    machine.unique_id = lambda: b"\xe6\x61\x01\x02"  # type: ignore[attr-defined]
    machine.reset = lambda: None  # type: ignore[attr-defined]
    rp2 = ModuleType("rp2")
    rp2.asm_pio = asm_pio  # type: ignore[attr-defined]
    rp2.PIO = type("PIO", (), {"OUT_LOW": 0})  # type: ignore[attr-defined]
    rp2.StateMachine = StateMachine  # type: ignore[attr-defined]
    StateMachine.made.clear()
    micropython = ModuleType("micropython")
    micropython.native = lambda function: function  # type: ignore[attr-defined]
    micropython.viper = lambda function: function  # type: ignore[attr-defined]
    micropython.const = lambda value: value  # type: ignore[attr-defined]
    micropython.asm_thumb = lambda function: lambda *args: machine.idle()  # type: ignore[attr-defined]
    uctypes = ModuleType("uctypes")
    uctypes.addressof = lambda memory: 0  # type: ignore[attr-defined]
    clock = ModuleType("time")
    timer = Registers.TIMER
    clock.ticks_us = lambda: machine.mem32[timer] % 2**30  # type: ignore[attr-defined]
    clock.ticks_diff = lambda a, b: (a - b + 2**29) % 2**30 - 2**29  # type: ignore[attr-defined]
    fakes = {"machine": machine, "rp2": rp2, "micropython": micropython, "time": clock}
    fakes["uctypes"] = uctypes
    ours = ("valvefw.boards.pico", f"valvefw.boards.{chip_name}")
    kept = {name: sys.modules.get(name) for name in fakes} | dict.fromkeys(ours)
    sys.modules.update(fakes)
    try:
        module = importlib.import_module("valvefw.boards.pico")
        chip = importlib.import_module(f"valvefw.boards.{chip_name}")
    finally:
        for name, old in kept.items():
            if old is None:
                del sys.modules[name]
            else:
                sys.modules[name] = old

    def pointer(to: Any) -> Any:
        return Registers(machine.mem32, to) if isinstance(to, int) else to

    module.__dict__.update(ptr8=pointer, ptr32=pointer, chip=chip)
    return module, machine
