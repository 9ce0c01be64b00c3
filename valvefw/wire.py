"""Wire format: COBS frames with CRC-16, five payload types (see docs/reference/wire-format.md).

A frame is COBS(payload + crc16(payload), high byte first) + one zero byte. Zero bytes occur
nowhere else, so a receiver resynchronises at the next zero: invalid bytes damage only one
frame. The host imports this file too; there is no second implementation.
"""

import binascii
from array import array

from valvefw.native import micropython, ptr8, ptr16

PROTO = 1

REQUEST = 0x51  # "Q", host to device
REPLY = 0x52  # "R"
TELEMETRY = 0x54  # "T"
EVENT = 0x45  # "E", unsolicited text
CHANNELS = 0x58  # "X", readings of the further inputs; only where a parameter switches one on

TELEMETRY_HEADER = "<BHHIIB"  # type, boot_id, setpoint_x16, seq0, t0_us, n
TELEMETRY_HEADER_SIZE = 14
SAMPLE = "<HHBBB"  # dt_us, counts, flags, inlet_u5, vent_u5
SAMPLE_SIZE = 7
MAX_SAMPLES = 32
DT_UNKNOWN = 65535
PULSE_UNIT_US = 5
TICK_US = 1000

CHANNELS_HEADER = "<BHIB"  # type, boot_id, seq0, n
CHANNELS_HEADER_SIZE = 8
READING = "<IBi"  # t_us, tag: input + 16 * state, value
READING_SIZE = 9
MAX_READINGS = 24
INPUTS = ("bridge", "adc16", "encoder", "second", "third")
STATES = ("ok", "overload", "silent", "stuck", "early", "lost_count", "no_answer")

CAPTURE_N = 800  # samples of a switching capture
CAPTURE_US = 50  # sample period, us
CAPTURE_LEAD_US = 5000  # from first sample to edge

FLAG_INLET = 1
FLAG_VENT = 2
FLAG_ARMED = 4
FLAG_FAULT = 8
FLAG_LED = 16
FLAG_HEARTBEAT = 32
FLAG_PROX_A = 64
FLAG_PROX_B = 128

# What moves air, keeps the heart beating or changes the time base: while armed, only for the
# session that armed. Anyone may read, vent and stop.
GUARDED = ("hb", "sp", "scheme", "pulse", "capture", "led", "telemetry")

MAX_PAYLOAD = 400
MAX_REQUEST = 96


def _crc_table() -> "array[int]":
    table = array("H", [0] * 256)
    for high in range(256):
        crc = high << 8
        for _ in range(8):
            crc = ((crc << 1) ^ 0x1021) & 0xFFFF if crc & 0x8000 else (crc << 1) & 0xFFFF
        table[high] = crc
    return table


CRC_TABLE = _crc_table()


@micropython.viper
def crc16_part(data: ptr8, first: int, end: int, crc: int) -> int:
    """``crc16`` of ``data[first:end]``, starting at ``crc``."""
    table = ptr16(CRC_TABLE)  # type: ignore[misc,call-arg]
    while first < end:
        crc = ((crc << 8) & 0xFF00) ^ table[(crc >> 8) ^ data[first]]
        first += 1
    return crc


# MicroPython's binascii has no crc_hqx.
_crc_hqx = getattr(binascii, "crc_hqx", None)
crc16_loop = crc16_part
if _crc_hqx is not None:

    def crc16_part(data, first, end, crc):  # type: ignore[no-untyped-def]
        """The loop above, by CPython's library."""
        return crc16(data[first:end], crc)


def crc16(data: bytes, crc: int = 0xFFFF) -> int:
    """CRC-CCITT, polynomial 0x1021, not reflected, starting at ``crc``."""
    if _crc_hqx is not None:
        after: int = _crc_hqx(data, crc)
        return after
    return crc16_part(data, 0, len(data), crc)  # type: ignore[arg-type,no-any-return,unused-ignore]


_CODES = [bytes([code]) for code in range(256)]


def cobs_encode(data: bytes) -> bytes:
    """Consistent overhead byte stuffing (Cheshire and Baker 1999), without the final zero."""
    codes = _CODES
    runs = data.split(b"\x00")
    if len(data) < 254:  # no full block, as in nearly every frame
        return b"".join([codes[len(run) + 1] + run for run in runs])
    out = []
    for run in runs:
        while len(run) >= 254:
            out.append(codes[255])
            out.append(run[:254])
            run = run[254:]
        out.append(codes[len(run) + 1])
        out.append(run)
    return b"".join(out)


def cobs_decode(data: bytes) -> bytes | None:
    """Inverse of ``cobs_encode``; None if ``data`` is not a valid code."""
    size = len(data)
    if not size or b"\x00" in data:
        return None
    if size > 254:
        return _decode_blocks(data)
    out = bytearray(data)
    at = 0
    while at < size:  # each code replaces a zero; the first one precedes the data
        code = data[at]
        out[at] = 0
        at += code
    return bytes(out[1:]) if at == size else None


def _decode_blocks(data: bytes) -> bytes | None:
    """``cobs_decode`` of data with full blocks, which are not followed by a zero."""
    out = []
    size = len(data)
    at = 0
    while at < size:
        code = data[at]
        end = at + code
        if end > size:
            return None
        out.append(data[at + 1 : end])
        at = end
        if code != 255 and at < size:
            out.append(b"\x00")
    return b"".join(out)


def encode_frame(payload: bytes) -> bytes:
    """Encode a payload for the wire, with the final zero."""
    crc = crc16(payload)
    return cobs_encode(payload + bytes((crc >> 8, crc & 0xFF))) + b"\x00"


def decode_frame(frame: bytes) -> bytes | None:
    """Decode the bytes between two zeros; None if the CRC is wrong."""
    data = cobs_decode(frame)
    if data is None or len(data) < 3:
        return None
    payload = data[:-2]
    if crc16(payload) != (data[-2] << 8) | data[-1]:
        return None
    return payload


def lfsr_next(state: int) -> int:
    """Next state of the sync LED's pattern: Galois, x^16 + x^14 + x^13 + x^11 + 1.

    The LED shows the lowest bit; bit k is that of the state after k steps from the seed.
    """
    return (state >> 1) ^ 0xB400 if state & 1 else state >> 1


# Frames in a buffer that is made once: the same format, for payloads that fit into one block.
# The payload stands from byte 1 on, with space for the first code before it and for CRC and
# final zero behind it.
ONE_BLOCK = 254  # longest frame without its final zero
SEALED = 4  # bytes that a frame adds to its payload


@micropython.viper
def seal(frame: ptr8, size: int) -> int:
    """Make a frame of the ``size`` bytes of payload from byte 1 on; returns its length.

    ``size`` is at most ``ONE_BLOCK - 3``.
    """
    crc = int(crc16_part(frame, 1, size + 1, 0xFFFF))
    frame[size + 1] = crc >> 8
    frame[size + 2] = crc & 255
    end = size + 3
    last = 0
    at = 1
    while at < end:
        if frame[at] == 0:
            frame[last] = at - last
            last = at
        at += 1
    frame[last] = end - last
    frame[end] = 0
    return end + 1


seal_loop = seal
if _crc_hqx is not None:

    def seal(frame, size):  # type: ignore[no-untyped-def]
        """The loop above, by CPython's library."""
        done = encode_frame(frame[1 : size + 1])
        frame[: len(done)] = done
        return len(done)


@micropython.viper
def unseal(frame: ptr8, size: int) -> int:
    """Decode a frame of ``size`` bytes (without its final zero) in place.

    Returns the length of the payload, which then stands from byte 1 on; negative if the frame is
    damaged. ``size`` is at most ``ONE_BLOCK``.
    """
    at = 0
    while at < size:
        code = frame[at]
        if code == 0:
            return -1
        frame[at] = 0
        at += code
    if at != size or size < 4:
        return -1
    crc = frame[size - 2] << 8 | frame[size - 1]
    if int(crc16_part(frame, 1, size - 2, 0xFFFF)) != crc:
        return -1
    return size - 3
