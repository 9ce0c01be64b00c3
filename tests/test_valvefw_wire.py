"""Frames: what goes in comes out, and what was damaged does not."""

from __future__ import annotations

import binascii
import itertools
import random
import re
import struct
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from valvefw import safety, wire
from valvefw.config import PARAMETERS, config_crc, defaults
from valvefw.core import (
    CAUSES,
    COUNTS,
    DT,
    FAULTS,
    NOW_HIGH,
    NOW_LOW,
    TICKS,
    VENT_US,
    Core,
    note,
)
from valvefw.deskboard import BufferedBoard, DeskBoard
from valvefw.receiver import Receiver
from valvefw.telemetry import Telemetry

DOC = Path(__file__).parent.parent / "docs" / "reference" / "wire-format.md"

FRAMES = [
    wire.encode_frame(b"Q17 arm 1a2b 4660"),
    wire.encode_frame(b"R17 ok"),
    wire.encode_frame(
        struct.pack("<BHHIIB", wire.TELEMETRY, 4660, 30000, 70000, 70_000_000, 3)
        + b"".join(struct.pack("<HHBBB", 1000, 1900 + i, 7, 0, 200 * (i == 1)) for i in range(3))
    ),
]


@given(st.binary(max_size=700))
def test_payload_survives_the_wire_and_no_zero_lies_inside(payload: bytes) -> None:
    frame = wire.encode_frame(payload)
    assert frame.endswith(b"\x00")
    assert b"\x00" not in frame[:-1]
    assert len(frame) <= len(payload) + 4 + len(payload) // 254 + 1
    assert wire.decode_frame(frame[:-1]) == (payload or None)


@pytest.mark.parametrize("size", [253, 254, 255, 507, 508, 509])
@pytest.mark.parametrize("tail", [b"", b"\x00", b"\x00\x00"])
def test_cobs_block_borders(size: int, tail: bytes) -> None:
    data = b"\x01" * size + tail
    assert wire.cobs_decode(wire.cobs_encode(data)) == data


def test_cobs_examples_from_the_paper() -> None:
    assert wire.cobs_encode(b"\x00") == b"\x01\x01"
    assert wire.cobs_encode(b"\x11\x22\x00\x33") == b"\x03\x11\x22\x02\x33"
    assert wire.cobs_decode(b"\xff" + b"a" * 254) == b"a" * 254  # the other legal ending
    assert wire.cobs_decode(b"") is None
    assert wire.cobs_decode(b"\x05abc") is None


@given(st.binary(max_size=300))
def test_the_crc_loop_for_micropython_equals_the_fast_one(data: bytes) -> None:
    assert wire.crc16_loop(data, 0, len(data), 0xFFFF) == binascii.crc_hqx(data, 0xFFFF)


@given(st.binary(min_size=1, max_size=wire.ONE_BLOCK - 3))
def test_a_frame_made_in_a_buffer_is_the_same_frame(payload: bytes) -> None:
    buffer = bytearray(wire.ONE_BLOCK + 1)
    buffer[1 : len(payload) + 1] = payload
    size = wire.seal_loop(buffer, len(payload))
    assert bytes(buffer[:size]) == wire.encode_frame(payload)
    assert wire.unseal(buffer, size - 1) == len(payload)
    assert bytes(buffer[1 : len(payload) + 1]) == payload


@given(st.binary(max_size=60) | st.builds(wire.encode_frame, st.binary(min_size=1, max_size=60)))
def test_both_decoders_agree_on_any_bytes(data: bytes) -> None:
    frame = data.rstrip(b"\x00")
    buffer = bytearray(frame + bytes(4))
    size = wire.unseal(buffer, len(frame))
    expected = wire.decode_frame(frame)
    assert (bytes(buffer[1 : size + 1]) if size > 0 else None) == expected


def test_crc_check_value() -> None:
    assert wire.crc16(b"123456789") == 0x29B1  # CRC-16/CCITT-FALSE


def _flip(frame: bytes, *bits: int) -> bytes:
    damaged = bytearray(frame)
    for bit in bits:
        damaged[bit >> 3] ^= 1 << (bit & 7)
    return bytes(damaged)


def _payloads(data: bytes) -> list[bytes]:
    return _received(data)[1]


def _received(*chunks: bytes) -> tuple[Receiver, list[bytes]]:
    """What the firmware's receiver makes of these bytes."""
    board = BufferedBoard()
    receiver = Receiver(board)
    found = []
    for chunk in chunks:
        board.feed(chunk)
        while size := receiver.next():
            if size > 0:
                found.append(bytes(receiver.frame[1 : size + 1]))
    return receiver, found


@pytest.mark.parametrize("frame", FRAMES)
def test_every_single_bit_flip_is_rejected(frame: bytes) -> None:
    for bit in range(8 * len(frame)):
        assert _payloads(_flip(frame, bit)) == []


@pytest.mark.parametrize("frame", FRAMES)
def test_every_double_bit_flip_is_rejected(frame: bytes) -> None:
    """All pairs of these frames. (A flipped COBS code moves several bits, so for frames in
    general a CRC-16 leaves about 1 in 65536 of such pairs; see docs.)"""
    got = [
        pair
        for pair in itertools.combinations(range(8 * len(frame)), 2)
        if _payloads(_flip(frame, *pair))
    ]
    assert got == []


def test_double_bit_flips_of_random_telemetry_pass_less_than_once_in_ten_thousand() -> None:
    rng = random.Random(5)
    passed = 0
    for _ in range(40_000):
        payload = b"T" + rng.randbytes(20) + bytes(20) + rng.randbytes(20)
        frame = wire.encode_frame(payload)
        bits = rng.sample(range(8 * len(frame)), 2)
        passed += payload != b"" and _payloads(_flip(frame, *bits)) != []
    assert passed <= 4


@given(st.lists(st.binary(min_size=1, max_size=40), max_size=5), st.binary(max_size=60))
def test_garbage_costs_no_frame_after_the_next_zero(payloads: list[bytes], junk: bytes) -> None:
    stream = junk + b"\x00" + b"".join(wire.encode_frame(p) for p in payloads)
    got = _payloads(stream)
    assert got[len(got) - len(payloads) :] == payloads


@given(st.data())
def test_frames_arrive_whatever_the_chunks(data: st.DataObject) -> None:
    stream = b"".join(FRAMES)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=8)))
    receiver, got = _received(
        *(stream[a:b] for a, b in zip([0, *cuts], [*cuts, len(stream)], strict=True))
    )
    assert got == [wire.decode_frame(f[:-1]) for f in FRAMES]
    assert receiver.bad_frames == 0


def test_a_flood_is_bounded_and_counted() -> None:
    receiver, got = _received(b"x" * 1000, b"\x00" + FRAMES[0])
    assert receiver.lost_bytes == 1000
    assert got == [b"Q17 arm 1a2b 4660"]


def test_sync_pattern_has_the_full_period() -> None:
    state, steps = 1, 0
    while True:
        state = wire.lfsr_next(state)
        steps += 1
        if state == 1:
            break
    assert steps == 65535


def test_telemetry_frame_layout_across_the_ring_border() -> None:
    core = Core()
    s = core.state
    telemetry = Telemetry(core, 0x1234)
    seen = []
    for i in range(130):
        s[NOW_LOW], s[NOW_HIGH] = i * 1000 & 0xFFFF, i * 1000 >> 16
        s[DT], s[COUNTS], s[VENT_US] = 1000, i, 5 * (i % 201)
        s[TICKS] += 1
        note(s, core.ring, core.times)
        if telemetry.full():
            size = telemetry.frame(777)
            payload = wire.decode_frame(bytes(telemetry.buffer[: size - 1]))
            assert payload is not None
            kind, boot, setpoint, seq0, t0_us, n = struct.unpack_from("<BHHIIB", payload)
            assert (kind, boot, setpoint, n) == (ord("T"), 0x1234, 777, 10)
            assert len(payload) == 14 + 7 * n
            rows = [struct.unpack_from("<HHBBB", payload, 14 + 7 * k) for k in range(n)]
            assert t0_us == seq0 * 1000
            seen += rows
    assert [row[1] for row in seen] == list(range(130))
    assert [row[4] for row in seen] == [i % 201 for i in range(130)]
    assert seen[0][0] == 65535  # nothing before the first sample
    assert {row[0] for row in seen[1:]} == {1000}
    s[FAULTS], s[COUNTS] = 2, 130
    for _ in range(5):  # the loop is late
        s[TICKS] += 1
        note(s, core.ring, core.times)
        s[COUNTS] += 1
    telemetry.keep()
    box = telemetry.black_box()
    assert [struct.unpack_from("<HHBBB", box, 7 * k)[1] for k in range(64)] == list(range(67, 131))
    for _ in range(100):
        s[TICKS] += 1
        note(s, core.ring, core.times)
    telemetry.keep()  # too late for all of them
    assert len(telemetry.black_box()) == 7 * (128 - 104)


def test_a_loop_that_is_late_loses_the_oldest_samples_and_the_numbers_show_it() -> None:
    core = Core()
    telemetry = Telemetry(core, 1)
    for i in range(264):
        core.state[COUNTS] = i
        core.state[TICKS] += 1
        note(core.state, core.ring, core.times)
    first = []
    while size := telemetry.frame(0):
        payload = wire.decode_frame(bytes(telemetry.buffer[: size - 1]))
        assert payload is not None
        seq0, _, n = struct.unpack_from("<IIB", payload, 5)
        rows = [struct.unpack_from("<HHBBB", payload, 14 + 7 * k) for k in range(n)]
        assert [row[1] for row in rows] == list(range(seq0, seq0 + n))
        first.append((seq0, n))
    assert first == [(136, 32), (168, 32), (200, 32), (232, 32)]


def _doc_hex(label: str) -> bytes:
    found = re.search(rf"{re.escape(label)}:\n+((?:    [0-9a-f ]+\n)+)", DOC.read_text())
    assert found, f"docs/reference/wire-format.md has no example {label!r}"
    return bytes.fromhex(found.group(1))


def test_examples_in_the_document_are_what_the_firmware_makes() -> None:
    assert _doc_hex("Request `7 hb 42`") == wire.encode_frame(b"Q7 hb 42")
    board = DeskBoard(boot_id=4660)
    sent = board.run(4, wire.encode_frame(b"Q6 telemetry 2") + wire.encode_frame(b"Q7 hb 42"))
    frames = [f + b"\x00" for f in sent.split(b"\x00")[:-1]]
    assert _doc_hex("Its reply on the desk board, first tick") in frames
    assert _doc_hex("Telemetry, the second and third sample after boot") in frames


def test_the_document_lists_every_verb_parameter_and_cause() -> None:
    text = DOC.read_text()
    board = DeskBoard()
    for verb in board.controller._commands._verbs:
        assert f"| `{verb}" in text, verb
    for key, default, low, high, _ in PARAMETERS:
        assert f"| `{key}` | {default} | {low} | {high} |" in text, key
    source = (safety.__doc__ or "").split("Its causes are")[1]
    assert re.findall(r"^    (\w+)  +\w", source, re.M) == list(CAUSES)
    listed = " ".join(line.split("|")[1] for line in text.splitlines() if line[:3] == "| `")
    for cause in CAUSES:
        assert f"`{cause}`" in listed, cause
    assert f"`{config_crc(defaults()):04x}`" in text
