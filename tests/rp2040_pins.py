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


class Op:
    """One instruction; ``side`` is None where it leaves the side-set pin as it is."""

    def __init__(self, name: str, args: tuple[Any, ...]) -> None:
        self.name = name
        self.args = args
        self.level: int | None = None
        self.delay = 0

    def side(self, level: int) -> Op:
        """Set the side-set pin with it."""
        self.level = level
        return self

    def __getitem__(self, cycles: int) -> Op:
        self.delay = cycles
        return self


class Program(list[Op]):
    """Instructions, and where they begin anew."""

    def __init__(self, ops: list[Op], labels: dict[str, int]) -> None:
        super().__init__(ops)
        self.target = labels.get(".wrap_target", 0)
        self.wrap = labels.get(".wrap", len(ops) - 1)
        for op in self:
            if op.name == "jmp":
                op.args = (*op.args[:-1], labels[op.args[-1]])


NAMES = (
    "noblock",
    "x",
    "y",
    "osr",
    "not_x",
    "x_dec",
    "x_not_y",
    "pins",
    "isr",
    "null",
    "pc",
    "pin",
)
INSTRUCTIONS = ("pull", "mov", "jmp", "set", "in_", "push", "wait", "irq", "nop")


def asm_pio(**_options: Any) -> Callable[[Callable[[], None]], Program]:
    """Run the function with instructions that write themselves down."""

    def decorate(function: Callable[[], None]) -> Program:
        out: list[Op] = []
        labels: dict[str, int] = {}

        def instruction(name: str) -> Callable[..., Op]:
            def made(*args: Any) -> Op:
                out.append(Op(name, args))
                return out[-1]

            return made

        names: dict[str, Any] = {n: instruction(n) for n in INSTRUCTIONS}
        names["label"] = lambda name: labels.__setitem__(name, len(out))
        names["wrap_target"] = lambda: labels.__setitem__(".wrap_target", len(out))
        names["wrap"] = lambda: labels.__setitem__(".wrap", len(out) - 1)
        names["invert"] = lambda name: "~" + name
        names.update({n: n for n in NAMES})
        function.__globals__.update(names)
        function()
        for name in names:
            del function.__globals__[name]
        assert len(out) <= 32, "a PIO has space for 32 instructions"
        return Program(out, labels)

    return decorate


WORD = 0xFFFFFFFF


class StateMachine:
    """One PIO state machine on its pins.

    Attributes:
        fifo: transmit FIFO; ``sent`` the receive FIFO.
        lines: levels of the input pins, the first in bit 0.
        on_side: told every change of the side-set pin.
        on_push: takes words instead of the receive FIFO, as a DMA channel does.
        flag: its interrupt flag 0.
    """

    made: ClassVar[list[StateMachine]] = []

    def __init__(self, number: int, program: Program, freq: int, **pins: Any) -> None:
        del pins
        self.number = number
        self.program = program
        self.freq = freq
        self.fifo: deque[int] = deque()
        self.sent: deque[int] = deque()
        self.x = self.y = self.osr = self.isr = self.pc = self.pin = self.clock = 0
        self.running = False
        self.edges: list[tuple[float, int]] = []
        self.cycle = self.pause = 0
        self.flag = False
        self.lines: Callable[[], int] = lambda: 0
        self.on_side: Callable[[int], None] = lambda level: None
        self.on_push: Callable[[int], None] | None = None
        StateMachine.made.append(self)

    def put(self, word: int) -> None:
        assert len(self.fifo) < 4, "the FIFO is full: put would block"
        assert 0 <= word < 2**32
        self.fifo.append(word)

    def get(self) -> int:
        return self.sent.popleft()

    def rx_fifo(self) -> int:
        return len(self.sent)

    def restart(self) -> None:
        self.pc = self.pause = 0

    def exec(self, text: str) -> None:
        if text == "pull()":
            self.osr = self.fifo.popleft()
            return
        name, _, rest = text.removesuffix(")").partition("(")
        words = [word.strip() for word in rest.split(",")]
        self._carry_out(name, tuple(int(w) if w.isdigit() else w for w in words))

    def active(self, on: int) -> None:
        self.running = bool(on)

    def run_us(self, us: float) -> None:
        for _ in range(round(us * self.freq / 1e6)):
            self._cycle()

    def _cycle(self) -> None:
        self.cycle += 1
        if self.pause:
            self.pause -= 1
            return
        op, at = self.program[self.pc], self.pc
        if op.level is not None and op.level != self.clock:
            self.clock = op.level
            self.on_side(op.level)
        self.pc = self.program.target if at == self.program.wrap else at + 1
        if not self._carry_out(op.name, op.args):
            self.pc = at  # it waits
        else:
            self.pause = op.delay

    def _source(self, name: str) -> int:
        if name.startswith("~"):
            return ~self._source(name[1:]) & WORD
        if name == "pins":
            return self.lines()
        return 0 if name == "null" else int(getattr(self, name))

    def _carry_out(self, name: str, args: tuple[Any, ...]) -> bool:
        """One instruction; False where it waits."""
        if name == "pull":
            self.osr = self.fifo.popleft() if self.fifo else self.x
        elif name == "mov":
            setattr(self, args[0], self._source(args[1]))
        elif name == "set" and args[0] == "x":
            self.x = args[1]
        elif name == "set":
            if args[1] != self.pin:
                self.pin = args[1]
                self.edges.append(((self.cycle - 1) / self.freq * 1e6, self.pin))
        elif name == "in_":
            bits = self._source(args[0]) & ((1 << args[1]) - 1)
            self.isr = (self.isr << args[1] | bits) & WORD
        elif name == "push":
            self._push()
        elif name == "wait":
            return self.lines() >> args[2] & 1 == args[0]
        elif name == "irq":
            self.flag = True
        elif name == "jmp":
            self._jump(args)
        else:
            assert name == "nop"
        return True

    def _push(self) -> None:
        word, self.isr = self.isr, 0
        if self.on_push is not None:
            self.on_push(word)
        elif len(self.sent) < 4:
            self.sent.append(word)

    def _jump(self, args: tuple[Any, ...]) -> None:
        condition = args[0] if len(args) == 2 else ""
        taken = {
            "": True,
            "not_x": self.x == 0,
            "x_dec": self.x != 0,
            "x_not_y": self.x != self.y,
        }[condition]
        if condition == "x_dec":
            self.x = (self.x - 1) & WORD
        if taken:
            self.pc = args[-1]


class Dma:
    """A channel that empties the encoder's FIFO into memory."""

    def __init__(self) -> None:
        self.count = 0

    def config(self, *, read: int, write: Any, count: int, ctrl: int) -> None:
        del read, ctrl
        self.count, self._write = count, write

    def pack_ctrl(self, **_options: Any) -> int:
        return 0

    def active(self, on: int) -> None:
        (encoder,) = [machine for machine in StateMachine.made if machine.number == 4]
        encoder.on_push = self._take if on else None

    def _take(self, word: int) -> None:
        self._write[0] = word - (1 << 32) if word >> 31 else word
        self.count -= 1

    def close(self) -> None:
        self.active(0)


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
    PIOS = (0x50200000, 0x50300000)

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
        for machine in StateMachine.made:
            base = self.PIOS[machine.number // 4]
            if address == base + 0x20 + 4 * (machine.number % 4):
                return machine.sent.popleft()
            if address == base + 0x04:
                return 0xF00 & ~sum(0x100 << m.number % 4 for m in StateMachine.made if m.sent)
            if address == base + 0x30:
                return int(machine.flag)
        return self.memory[address]

    def __setitem__(self, word: int, value: int) -> None:
        address = self.address + 4 * word
        machine = (address - self.PIO0_TX) // 4
        if address == self.PIOS[1] + 0x30:
            for made in StateMachine.made:
                made.flag = False
        elif 0 <= machine < len(StateMachine.made):
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
    for name in ("ADC", "UART", "WDT", "PWM", "Pin", "Timer", "I2C"):
        constants = {"OUT": 1, "IN": 0, "PULL_UP": 1, "PERIODIC": 1}
        setattr(machine, name, type(name, (Fake,), constants))
    machine.WDT_RESET = 3  # type: ignore[attr-defined]
    machine.reset_cause = lambda: 3  # type: ignore[attr-defined]
    machine.unique_id = lambda: b"\xe6\x61\x01\x02"  # type: ignore[attr-defined]
    machine.reset = lambda: None  # type: ignore[attr-defined]
    rp2 = ModuleType("rp2")
    rp2.asm_pio = asm_pio  # type: ignore[attr-defined]
    constants = {"OUT_LOW": 0, "SHIFT_LEFT": 0, "SHIFT_RIGHT": 1}
    rp2.PIO = type("PIO", (), constants)  # type: ignore[attr-defined]
    rp2.DMA = Dma  # type: ignore[attr-defined]
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
