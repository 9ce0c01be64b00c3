"""What one tick may cost: one that takes longer than 20 ms on the chip latches `loop_stalled`."""

from __future__ import annotations

import random
import sys
from types import FrameType
from typing import Any

import pytest

import rp2040_pins
from valvefw import config, wire
from valvefw.config import PARAMETERS, config_crc
from valvefw.deskboard import DeskBoard
from valvefw.schemes.valves import VENT_HOLD_US
from valvefw.wire import EVENT, TICK_US, crc16, decode_frame, encode_frame, seal

INTERPRETED = ("config.py", "commands.py", "controller.py", "safety.py")


class Work:
    """Counts bytes that go through the CRC, and lines of firmware that are executed."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.bytes = self.lines = 0

        def counted(data: bytes, *start: int) -> int:
            self.bytes += len(data)
            return crc16(data, *start)

        def counted_part(data: bytes, first: int, end: int, crc: int) -> int:
            self.bytes += end - first
            return crc16(data[first:end], crc)

        for module in (config, wire):
            monkeypatch.setattr(module, "crc16", counted)
        monkeypatch.setattr(wire, "crc16_part", counted_part)

    def _trace(self, frame: FrameType, event: str, argument: object) -> Any:
        # The rest is machine code on the chip.
        if not frame.f_code.co_filename.endswith(INTERPRETED):
            return None
        self.lines += event == "line"
        return self._trace

    def of(self, board: DeskBoard, text: str) -> tuple[int, int, str]:
        """Bytes besides those of the frames, lines, and the reply, of one tick with a request."""
        request = encode_frame(b"Q1 " + text.encode())
        before = sys.gettrace()
        self.bytes = self.lines = 0
        sys.settrace(self._trace)
        try:
            sent = board.run(1, request)
        finally:
            sys.settrace(before)
        took, lines = self.bytes, self.lines
        payloads = [decode_frame(frame) or b"" for frame in sent.split(b"\x00")[:-1]]
        reply = next(p for p in payloads if p[:1] == b"R")
        own = len(b"Q1 " + text.encode()) + sum(map(len, payloads))
        return took - own, lines, reply.decode()


def test_arming_computes_no_crc_of_the_parameters(monkeypatch: pytest.MonkeyPatch) -> None:
    """57 lines of text took 24 to 34 ms on an RP2040, and the tick after `arm` was too late."""
    board = DeskBoard()
    work = Work(monkeypatch)
    board.run(12)
    plain = work.of(board, "hb 1")[1]
    word = f"{config_crc(board.controller.values):04x}"
    for text in ("id", "conf", f"arm {word} 4660"):
        took, lines, reply = work.of(board, text)
        assert reply.startswith("R1 ok")
        assert took == 0
        assert lines < plain + 6 * len(PARAMETERS)
    board.run(1)
    assert board.controller.safety.armed
    assert board.controller.safety.faults == []


def test_a_changed_parameter_costs_its_own_line_not_all(monkeypatch: pytest.MonkeyPatch) -> None:
    board = DeskBoard()
    work = Work(monkeypatch)
    board.run(12)
    for row in (PARAMETERS[0], PARAMETERS[len(PARAMETERS) // 2], PARAMETERS[-1]):
        took, lines, reply = work.of(board, f"set {row[0]} {row[3]}")
        assert reply == f"R1 ok conf={config_crc(board.controller.values):04x}"
        assert took <= 2 * len(f"{row[0]}={row[3]}\n")
        assert lines < 2000


def test_the_crc_kept_is_that_of_the_text_whatever_changes() -> None:
    rng = random.Random(5)
    values = config.defaults()
    kept = config.Checksum()
    assert kept.of(values) == config_crc(values)
    for _ in range(400):
        for _ in range(rng.choice((0, 1, 1, 1, 2, 60))):
            row = rng.choice(PARAMETERS)
            values[row[0]] = rng.choice((row[1], row[2], row[3], rng.randint(row[2], row[3])))
        assert kept.of(values) == config_crc(values)


class Logged(DeskBoard):
    """Writes down in which order the firmware drives, listens and sends."""

    def __init__(self) -> None:
        self.log: list[str] = []
        super().__init__()

    def drive(self, inlet_us: int, vent_us: int) -> None:
        super().drive(inlet_us, vent_us)
        self.log.append(f"drive {inlet_us} {vent_us}")

    def rx(self, inbox: bytearray) -> int:
        self.log.append("rx")
        return super().rx(inbox)


@pytest.mark.parametrize("cause", ["over_pressure", "inlet_bound", "host_silent"])
def test_a_fault_vents_before_anything_is_told(cause: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Event and held samples take 3 to 5 ms to encode, and the valve stayed open meanwhile."""
    board = Logged()
    c = board.controller
    c.values["hb_ms"] = 200 if cause == "host_silent" else 1000
    c.values["inlet_max_ms"] = 60
    c.values["stuck_ms"] = 0
    c.safety.arm(c.values)
    c.choose("pwm" if cause == "host_silent" else "two")
    board.run(5)
    if cause != "host_silent":
        c.set_setpoint(40_000)
        board.run(5)
        assert board.inlet_us > 0
    if cause == "over_pressure":
        board.override = 2800

    def encoded(payload: bytes) -> bytes:
        board.log.append("event" if payload[0] == EVENT else "frame")
        return encode_frame(payload)

    def sealed(frame: bytearray, size: int) -> int:
        board.log.append("frame")
        return seal(frame, size)

    monkeypatch.setattr("valvefw.controller.encode_frame", encoded)
    monkeypatch.setattr("valvefw.telemetry.seal", sealed)
    ticks = 0
    while not c.safety.faults:
        board.log.clear()
        board.run(1)
        ticks += 1
        assert ticks < 300
    assert c.safety.faults[0][0] == cause
    log = board.log
    assert log[0] == f"drive 0 {VENT_HOLD_US}"
    assert {word for word in log if word[:5] == "drive"} == {log[0]}
    assert "event" in log


class Uart:
    """As the chip's: a read of more than is held waits."""

    def __init__(self, held: bytes) -> None:
        self.held = held

    def any(self) -> int:
        return len(self.held)

    def readinto(self, buffer: bytearray, n: int) -> int:
        assert n <= len(self.held), "this read would wait"
        buffer[:n], self.held = self.held[:n], self.held[n:]
        return n


def test_the_board_reads_only_what_the_uart_holds() -> None:
    module: Any = rp2040_pins.load()[0]
    board = module.Pico(module.chip)
    sent = bytes(range(256)) * 3 + b"end"
    inbox = bytearray(256)
    for part in (b"", sent[:1], sent):
        board._uart = Uart(part)
        got = []
        while board._uart.held:
            got.append(bytes(inbox[: board.rx(inbox)]))
        assert b"".join(got) == part
        assert board.rx(inbox) == 0


class Chip:
    """A desk board whose interrupt comes when the test says so, whatever the loop does."""

    def __init__(self, scheme: str) -> None:
        self.board = DeskBoard()
        self.c = self.board.controller
        self.c.values.update(stuck_ms=0, rise_ms=0, leak_counts=0, hb_ms=1000)
        self.board.run(12)
        self.c.safety.arm(self.c.values)
        self.c.choose(scheme)
        self.board.run(3)

    def step(self) -> int:
        """One interrupt; what the inlet is driven for."""
        self.board.now_us += TICK_US
        self.c.step()
        return self.board.inlet_us


def test_a_pulse_requested_by_a_pass_that_crossed_a_step_is_not_lost() -> None:
    chip = Chip("open")
    chip.c.openloop.begin(True, 5000, 1, 15_000)
    step = chip.c.openloop.step

    def late(*args: Any) -> None:
        step(*args)
        chip.step()  # while the scheme computes

    chip.step()
    chip.c.openloop.step = late  # type: ignore[method-assign]
    chip.c.loop()
    chip.c.openloop.step = step  # type: ignore[method-assign]
    chip.c.loop()  # for the step it crossed; the pulse is still only requested
    driven = []
    for _ in range(8):
        driven.append(min(chip.step(), TICK_US))
        chip.c.loop()
    assert sum(driven) == 5000


def test_a_scheme_that_is_chosen_late_begins_with_closed_valves() -> None:
    chip = Chip("two")
    chip.c.set_setpoint(40_000)
    for _ in range(4):
        chip.step()
        chip.c.loop()
    assert chip.board.inlet_us > TICK_US
    chip.step()
    chip.c.choose("open")  # by a slow request: the loop has not seen the newest step yet
    chip.c.loop()
    assert chip.step() == 0
    chip.c.loop()
    assert chip.step() == 0


def test_a_fault_right_after_clear_is_reported() -> None:
    chip = Chip("open")
    c = chip.c
    chip.board.override = 4000
    for _ in range(12):
        chip.step()
    c.loop()
    assert c.safety.faults[0][0] == "over_pressure"
    chip.board.override = 3
    for _ in range(12):
        chip.step()
        c.loop()
    chip.board.take_tx()
    assert c.clear() == ""
    chip.board.override = 4000
    for _ in range(12):
        chip.step()
    while c.loop():
        pass
    assert b"over_pressure" in chip.board.take_tx()
