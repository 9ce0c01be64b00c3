"""Framers and codec: whatever the line does, no wrong value and no unbounded memory."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from daq.link.codec import (
    SAMPLE_DTYPE,
    CodecError,
    decode_event,
    decode_reply,
    encode_request,
    telemetry_head,
)
from daq.link.framer import CobsFramer, LineFramer
from valvefw import wire

payloads = st.lists(st.binary(min_size=1, max_size=60), max_size=12)
SAMPLES = st.lists(
    st.tuples(
        st.integers(0, 65535),
        st.integers(0, 65535),
        st.integers(0, 255),
        st.integers(0, 255),
        st.integers(0, 255),
    ),
    max_size=32,
)


def cut(data: bytes, cuts: list[int]) -> list[bytes]:
    """``data`` in pieces, cut at any places."""
    places = sorted({c % (len(data) + 1) for c in cuts})
    return [data[a:b] for a, b in zip([0, *places], [*places, len(data)], strict=True)]


@given(payloads, st.lists(st.integers(0, 10_000)))
def test_frames_come_out_the_same_however_the_bytes_are_chunked(
    sent: list[bytes], cuts: list[int]
) -> None:
    data = b"".join(wire.encode_frame(p) for p in sent)
    framer = CobsFramer()
    got = [p for piece in cut(data, cuts) for p in framer.feed(piece)]
    assert got == sent
    assert (framer.frames, framer.damaged, framer.oversize) == (len(sent), 0, 0)


@given(payloads, st.binary(max_size=200), st.lists(st.integers(0, 10_000)))
def test_garbage_between_frames_costs_at_most_the_next_frame(
    sent: list[bytes], garbage: bytes, cuts: list[int]
) -> None:
    data = garbage + b"\x00" + b"".join(wire.encode_frame(p) for p in sent)
    framer = CobsFramer()
    got = [p for piece in cut(data, cuts) for p in framer.feed(piece)]
    assert got[len(got) - len(sent) :] == sent


TELEMETRY = struct.pack(
    wire.TELEMETRY_HEADER, wire.TELEMETRY, 0x1234, 800, 70_000, 123_456_789, 10
) + b"".join(struct.pack(wire.SAMPLE, 1000, 50 * k, 5, 20 * k, 0) for k in range(10))


@pytest.mark.parametrize(
    "sent", [TELEMETRY, b"R17 ok name=valve t=123456", b"R18 err range 99 is above 80", b"Eboot"]
)
def test_no_single_flipped_bit_on_the_wire_gives_a_wrong_payload(sent: bytes) -> None:
    encoded = wire.encode_frame(sent)
    for bit in range(8 * len(encoded)):
        data = bytearray(encoded)
        data[bit // 8] ^= 1 << bit % 8
        framer = CobsFramer()
        # A flip of the closing zero glues the next frame on; the one after is found again.
        got = framer.feed(bytes(data) + wire.encode_frame(b"next"))
        got += framer.feed(wire.encode_frame(b"after"))
        assert got in ([b"next", b"after"], [b"after"])
        assert framer.damaged >= 1


def test_an_endless_frame_is_bounded_and_counted() -> None:
    framer = CobsFramer(max_bytes=100)
    for _ in range(1000):
        assert framer.feed(b"\x55" * 64) == []
    assert len(framer._tail) <= 100
    assert framer.oversize == 1
    assert framer.dropped_bytes == 64_000
    assert framer.feed(b"\x00" + wire.encode_frame(b"T1")) == [b"T1"]


def test_half_a_frame_at_the_start_is_counted_as_damaged() -> None:
    framer = CobsFramer()
    frame = wire.encode_frame(b"T" + bytes(range(40)))
    assert framer.feed(frame[17:] + frame) == [b"T" + bytes(range(40))]
    assert framer.damaged == 1
    assert framer.dropped_bytes == len(frame) - 18


lines = st.lists(st.text("SIDZT +-.0123456789g", max_size=30).map(str.encode), max_size=12)


@given(lines, st.lists(st.integers(0, 10_000)))
def test_lines_come_out_the_same_however_the_bytes_are_chunked(
    sent: list[bytes], cuts: list[int]
) -> None:
    framer = LineFramer()
    data = b"".join(line + b"\r\n" for line in sent)
    assert [x for piece in cut(data, cuts) for x in framer.feed(piece)] == sent


def test_a_line_without_end_is_bounded_and_the_next_one_is_found() -> None:
    framer = LineFramer(max_bytes=80)
    for _ in range(500):
        assert framer.feed(b"x" * 33) == []
        assert len(framer._tail) <= 81
    assert framer.oversize == 1
    assert framer.feed(b"xyz\r") == []
    assert framer.feed(b"\nS S  12.3 g\r\n") == [b"S S  12.3 g"]
    assert framer.dropped_bytes == 500 * 33 + 3


@given(SAMPLES, st.integers(0, 65535), st.integers(0, 65535), st.integers(0, 2**32 - 1))
def test_telemetry_decodes_to_what_was_packed(
    samples: list[tuple[int, int, int, int, int]], boot: int, setpoint: int, seq0: int
) -> None:
    head = struct.pack(
        wire.TELEMETRY_HEADER, wire.TELEMETRY, boot, setpoint, seq0, 77, len(samples)
    )
    payload = head + b"".join(struct.pack(wire.SAMPLE, *s) for s in samples)
    assert telemetry_head(payload) == (boot, setpoint, seq0, 77, len(samples))
    decoded = np.frombuffer(payload, SAMPLE_DTYPE, offset=wire.TELEMETRY_HEADER_SIZE)
    assert [tuple(int(v) for v in s) for s in decoded] == samples


@pytest.mark.parametrize("payload", [b"", b"T", b"R1 ok", b"T" + bytes(13) + b"x"])
def test_what_is_not_telemetry_is_refused(payload: bytes) -> None:
    with pytest.raises(CodecError):
        telemetry_head(payload)


def test_telemetry_whose_length_belies_its_count_is_refused() -> None:
    head = struct.pack(wire.TELEMETRY_HEADER, wire.TELEMETRY, 1, 2, 3, 4, 10)
    with pytest.raises(CodecError, match="10 samples has 15 bytes"):
        telemetry_head(head + b"x")


@given(st.integers(0, 65535), st.text("abc 0123456789-_", min_size=1, max_size=60))
def test_a_request_arrives_as_it_was_meant(request_id: int, text: str) -> None:
    (payload,) = CobsFramer().feed(encode_request(request_id, text))
    assert payload == b"Q" + f"{request_id} {text}".encode()


@pytest.mark.parametrize(
    ("request_id", "text"), [(-1, "id"), (65536, "id"), (1, "a\nb"), (1, "ä"), (1, "x" * 200)]
)
def test_a_request_that_cannot_be_sent_is_refused(request_id: int, text: str) -> None:
    with pytest.raises(CodecError):
        encode_request(request_id, text)


def test_replies_name_their_request_and_their_values() -> None:
    reply = decode_reply(b"R17 ok name=valve fw=1.2 t=123")
    assert (reply.id, reply.ok) == (17, True)
    assert reply.values == {"name": "valve", "fw": "1.2", "t": "123"}
    refused = decode_reply(b"R18 err range setpoint 99 is above 80; send less")
    assert (refused.id, refused.ok, refused.code) == (18, False, "range")
    assert refused.text == "setpoint 99 is above 80; send less"
    assert decode_event(b"Eboot cause=brownout") == "boot cause=brownout"


@pytest.mark.parametrize(
    "payload", [b"R", b"Rx ok", b"R1 maybe", b"R1", b"E1 ok", "Rä ok".encode(), b"R\xb2 ok"]
)
def test_what_is_not_a_reply_is_refused(payload: bytes) -> None:
    with pytest.raises(CodecError):
        decode_reply(payload)


@settings(max_examples=200)
@given(st.binary(max_size=300))
def test_any_bytes_are_either_decoded_or_refused(payload: bytes) -> None:
    for decode in (telemetry_head, decode_reply, decode_event):
        try:
            value = decode(payload)
        except CodecError:
            continue
        assert value is not None


def test_sample_layout_is_that_of_the_firmware() -> None:
    assert struct.calcsize(wire.SAMPLE) == wire.SAMPLE_SIZE
    packed = struct.pack(wire.SAMPLE, 1000, 2048, wire.FLAG_INLET, 200, 0)
    head = struct.pack(wire.TELEMETRY_HEADER, wire.TELEMETRY, 1, 2, 3, 4, 1)
    assert telemetry_head(head + packed)[-1] == 1
    sample = np.frombuffer(head + packed, SAMPLE_DTYPE, offset=wire.TELEMETRY_HEADER_SIZE)
    assert sample["counts"].dtype == np.uint16
    assert sample[0].item() == (1000, 2048, 1, 200, 0)
