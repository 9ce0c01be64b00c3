"""Encodes and decodes the payloads of the valve controller."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from valvefw import wire

_HEADER = struct.Struct(wire.TELEMETRY_HEADER)
SAMPLE_DTYPE = np.dtype(
    [("dt_us", "<u2"), ("counts", "<u2"), ("flags", "u1"), ("inlet_u5", "u1"), ("vent_u5", "u1")]
)
assert SAMPLE_DTYPE.itemsize == wire.SAMPLE_SIZE == struct.calcsize(wire.SAMPLE)

_CHANNELS = struct.Struct(wire.CHANNELS_HEADER)
READING_DTYPE = np.dtype([("t_us", "<u4"), ("tag", "u1"), ("value", "<i4")])
assert READING_DTYPE.itemsize == wire.READING_SIZE == struct.calcsize(wire.READING)


class CodecError(ValueError):
    """A payload has a correct CRC but an invalid structure (wrong firmware?)."""


@dataclass(frozen=True)
class Reply:
    """The reply to one request.

    Attributes:
        id: id of the request.
        ok: True for ``ok``, False for ``err``.
        values: ``key=value`` pairs of an ``ok``.
        code: error code, one word.
        text: error message with remedy, or the words of an ``ok`` without ``=``.
    """

    id: int
    ok: bool
    values: dict[str, str] = field(default_factory=dict)
    code: str = ""
    text: str = ""


def telemetry_head(payload: bytes) -> tuple[int, int, int, int, int]:
    """``boot, setpoint_x16, seq0, t0_us, n`` of a telemetry payload.

    ``seq0`` and ``t0_us`` are sequence number and device time of the first sample (32 bits,
    overflow). ``n`` samples of ``SAMPLE_DTYPE`` follow the header.

    Raises:
        CodecError: not telemetry, or its length does not match ``n``.
    """
    if len(payload) < _HEADER.size or payload[0] != wire.TELEMETRY:
        raise CodecError(f"not a telemetry payload: {payload[:24].hex(' ')}")
    _, boot, setpoint_x16, seq0, t0_us, n = _HEADER.unpack_from(payload)
    if len(payload) != _HEADER.size + n * wire.SAMPLE_SIZE:
        raise CodecError(f"telemetry of {n} samples has {len(payload)} bytes")
    return boot, setpoint_x16, seq0, t0_us, n


def channels_payload(payload: bytes) -> tuple[int, int, npt.NDArray[np.void]]:
    """``boot, seq0, readings`` of a payload of the further inputs.

    ``seq0`` is the number of the first reading since boot (32 bits, overflow); the readings are
    of ``READING_DTYPE``, shape (n,).

    Raises:
        CodecError: it is none, or its length does not match its number of readings.
    """
    if len(payload) < _CHANNELS.size or payload[0] != wire.CHANNELS:
        raise CodecError(f"no readings of further inputs: {payload[:24].hex(' ')}")
    _, boot, seq0, n = _CHANNELS.unpack_from(payload)
    if len(payload) != _CHANNELS.size + n * wire.READING_SIZE:
        raise CodecError(f"{n} readings of further inputs have {len(payload)} bytes")
    return boot, seq0, np.frombuffer(payload, READING_DTYPE, n, _CHANNELS.size)


def encode_request(request_id: int, text: str) -> bytes:
    """The bytes of a request on the wire.

    Raises:
        CodecError: the id is outside 0..65535, or the text is too long or not printable ASCII.
    """
    if not 0 <= request_id <= 0xFFFF:
        raise CodecError(f"request id {request_id} is outside 0..65535")
    if not text.isascii() or not text.isprintable():
        raise CodecError(f"request {text!r} is not printable ASCII")
    body = f"{request_id} {text}".encode("ascii")
    if len(body) > wire.MAX_REQUEST:
        raise CodecError(f"request of {len(body)} bytes, at most {wire.MAX_REQUEST}: {text!r}")
    return wire.encode_frame(bytes((wire.REQUEST,)) + body)


def decode_reply(payload: bytes) -> Reply:
    """Decode a reply payload.

    Raises:
        CodecError: not ``R<id> ok ...`` or ``R<id> err <code> ...``.
    """
    text = _text(payload, wire.REPLY)
    number, _, rest = text.partition(" ")
    word, _, rest = rest.partition(" ")
    if not (number.isascii() and number.isdigit()) or word not in ("ok", "err"):
        raise CodecError(f"not a reply: {text!r}")
    if word == "err":
        code, _, message = rest.partition(" ")
        return Reply(int(number), False, code=code, text=message)
    values: dict[str, str] = {}
    words: list[str] = []
    for part in rest.split():
        key, equals, value = part.partition("=")
        if equals:
            values[key] = value
        else:
            words.append(part)
    return Reply(int(number), True, values, text=" ".join(words))


def decode_event(payload: bytes) -> str:
    """The text of an unsolicited event.

    Raises:
        CodecError: not an event.
    """
    return _text(payload, wire.EVENT)


def _text(payload: bytes, kind: int) -> str:
    if not payload or payload[0] != kind:
        raise CodecError(f"expected a payload {chr(kind)!r}, got {payload[:24]!r}")
    try:
        return payload[1:].decode("ascii")
    except UnicodeDecodeError:
        raise CodecError(f"payload is not ASCII: {payload[:48]!r}") from None
