"""What one tick may cost: a tick that takes longer than 20 ms on the chip latches `loop_stalled`."""

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
from valvefw.valves import VENT_HOLD_US
from valvefw.wire import EVENT, TICK_US, Decoder, crc16, encode_frame


class Work:
    """Counts bytes that go through the CRC, and lines of firmware that are executed."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.bytes = self.lines = 0

        def counted(data: bytes, *start: int) -> int:
            self.bytes += len(data)
            return crc16(data, *start)

        for module in (config, wire):
            monkeypatch.setattr(module, "crc16", counted)

    def _trace(self, frame: FrameType, event: str, argument: object) -> Any:
        if "valvefw" not in frame.f_code.co_filename:
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
        decoder = Decoder()
        decoder.push(sent)
        payloads = []
        while (payload := decoder.next()) is not None:
            payloads.append(payload)
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
