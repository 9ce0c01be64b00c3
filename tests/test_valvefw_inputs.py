"""Further inputs of the controller: which readings come, with which time, and which never do."""

from __future__ import annotations

import hashlib
import re
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import micropython_host
from daq.link.channels import ChannelReading, ChannelStream, EdgeCount
from daq.link.clockfit import DeviceTime
from daq.link.codec import CodecError, channels_payload
from valvefw import wire
from valvefw.config import config_crc, defaults
from valvefw.deskboard import DeskBoard
from valvefw.inputs import channels as inputs

DOC = Path(__file__).parent.parent / "docs" / "reference" / "wire-format.md"
Row = tuple[int, int, str, str, int]
"""Number since boot, device time in us, input, state, value."""


class Desk(DeskBoard):
    """A desk board whose bridge gives what a test lays down: (time in us, word)."""

    def __init__(self) -> None:
        self.words: list[tuple[int, int]] = []
        super().__init__()

    def bridge(self) -> int:
        if not self.words or self.words[0][0] > self.now_us:
            return -1
        return self.words.pop(0)[1] & 0xFFFFFF

    def ask(self, text: str, ms: int = 1) -> bytes:
        return self.run(ms, wire.encode_frame(f"Q1 {text}".encode()))


def frames(data: bytes, kind: int = wire.CHANNELS) -> list[bytes]:
    payloads = [wire.decode_frame(frame) for frame in data.split(b"\x00") if frame]
    return [p for p in payloads if p is not None and p[0] == kind]


def rows(data: bytes) -> list[Row]:
    found = []
    for payload in frames(data):
        _, seq0, readings = channels_payload(payload)
        for k, (t_us, tag, value) in enumerate(readings.tolist()):
            found.append((seq0 + k, t_us, wire.INPUTS[tag & 15], wire.STATES[tag >> 4], value))
    return found


def bridge(board: Desk, values: list[int], period_us: int = 12_500) -> list[Row]:
    """What the firmware makes of conversions that come evenly, and of the silence after them."""
    start = board.now_us
    board.words = [(start + (k + 1) * period_us, value) for k, value in enumerate(values)]
    return rows(board.run((len(values) + 2) * period_us // 1000 + 80))


def test_the_documented_frame_is_what_the_desk_board_sends() -> None:
    text = DOC.read_text(encoding="utf-8")
    example = text.partition("after `set bridge 5`")[2].split("\n\n")[1]
    board = DeskBoard()
    sent = board.run(1, wire.encode_frame(b"Q1 set bridge 5")) + board.run(400)
    first = wire.encode_frame(frames(sent)[0])
    assert first == bytes.fromhex(re.sub(r"\s", "", example))
    assert f"`{config_crc(defaults()):04x}`" in text


TELEMETRY_0_2_0 = "1b1c8ba5ff630d88cfe8a83d72cd782f431b4d9345847dd20b8306a84d7c796a"
"""SHA-256 of the 65 telemetry frames that firmware 0.2.0, without inputs, sends in this test."""


def test_without_a_parameter_telemetry_is_to_the_byte_that_of_a_firmware_without_inputs() -> None:
    board, sent = Desk(), b""
    conf = board.ask("id").partition(b"conf=")[2][:4].decode()
    board = Desk()
    for text, ms in (
        ("stat", 300), ("id", 1), (f"arm {conf} 4660", 1), ("hb 1", 1), ("scheme two", 1),
        ("sp 9000", 250), ("stop", 100),
    ):  # fmt: skip
        data = board.ask(text, ms)
        sent += data if text != "id" else b""
    got = frames(sent, wire.TELEMETRY)
    assert len(got) == 65
    whole = b"".join(wire.encode_frame(payload)[:-1] for payload in got)
    assert hashlib.sha256(whole).hexdigest() == TELEMETRY_0_2_0
    assert frames(sent) == []


def test_a_parameter_is_refused_while_armed() -> None:
    board = Desk()
    conf = re.search(rb"conf=([0-9a-f]{4})", board.ask("id"))
    assert conf is not None
    board.ask(f"arm {conf[1].decode()} 4660")
    for key in inputs.KEYS:
        assert b"err armed" in board.ask(f"set {key} 8")
    assert frames(board.run(300)) == []


def test_readings_come_once_in_order_with_the_time_base_of_the_pressure() -> None:
    board = Desk()
    board.ask("set bridge 5")
    values = [1000 * (-1) ** k * k for k in range(30)]
    got = bridge(board, values)
    ok = [row for row in got if row[3] == "ok"]
    assert [row[4] for row in ok] == values[inputs.SETTLE_N : -1]
    assert [row[0] for row in got] == list(range(len(got)))
    times = np.array([row[1] for row in ok])
    first = 1000 + 12_500 * (inputs.SETTLE_N + 1)
    assert (times - first == np.arange(len(times)) * 12_500).sum() >= len(times) // 2
    assert np.abs(times - first - np.arange(len(times)) * 12_500).max() <= 1000  # the next tick


def test_the_last_reading_before_a_silence_never_becomes_a_value() -> None:
    """A plug that is pulled in a transfer leaves ones at the end of a word."""
    board = Desk()
    board.ask("set bridge 5")
    whole = [50_000 + k for k in range(20)]
    got = bridge(board, [*whole, 50_000 | 0x7FFF])
    assert [row[4] for row in got if row[3] == "ok"] == whole[inputs.SETTLE_N :]
    assert [row[3] for row in got][-1] == "silent"
    later = rows(board.run(3500))
    assert [row[3] for row in later] == ["silent"] * 3
    assert later[-1][4] - later[-2][4] == pytest.approx(1000, abs=2)


def test_after_a_silence_readings_are_dropped_until_the_filter_has_settled() -> None:
    board = Desk()
    board.ask("set bridge 5")
    bridge(board, list(range(100, 120)))
    board.run(2000)
    values = list(range(7000, 7020))
    got = bridge(board, values)
    assert [row[4] for row in got if row[3] == "ok"] == values[inputs.SETTLE_N : -1]


@pytest.mark.parametrize("end", [0x7FFFFF, -0x800000])
def test_a_saturated_converter_gives_states_and_no_values(end: int) -> None:
    board = Desk()
    board.ask("set bridge 5")
    got = bridge(board, [*range(100, 110), *[end] * 9, *range(200, 210)])
    assert [row[4] for row in got if row[3] == "ok"] == [*range(105, 110), *range(200, 209)]
    assert [row[4] for row in got if row[3] == "overload"] == [end] * 9


def test_a_converter_without_noise_is_stuck_and_goes_on_when_it_moves() -> None:
    board = Desk()
    board.ask("set bridge 5")
    got = bridge(board, [*range(100, 110), *[777] * 20, *range(200, 210)])
    ok = [row[4] for row in got if row[3] == "ok"]
    assert ok == [*range(105, 110), *[777] * (inputs.SAME_N - 1), *range(200, 209)]
    assert sum(row[3] == "stuck" for row in got) == 20 - (inputs.SAME_N - 1)


def test_conversions_before_their_time_are_no_readings() -> None:
    board = Desk()
    board.ask("set bridge 5")
    got = bridge(board, list(range(300)), period_us=1000)
    assert {row[3] for row in got} <= {"early", "silent"}
    assert len([row for row in got if row[3] == "early"]) > 200


def test_a_late_loop_drops_what_it_cannot_time() -> None:
    board = Desk()
    board.ask("set bridge 5")
    bridge(board, list(range(100, 110)))
    now = board.now_us
    board.words = [(now + 5000, 1), (now + 17_500, 2), (now + 30_000, 3), (now + 42_500, 4)]
    board.now_us += 24_000  # collecting garbage, as at arming
    assert {row[3] for row in rows(board.run(60))} <= {"ok"}
    assert all(row[4] not in (1, 2) for row in rows(board.run(60)))


def test_an_encoder_that_jumped_gives_no_value_until_it_is_set_anew() -> None:
    board = Desk()
    board.ask("set encoder_ms 10")
    assert {row[3] for row in rows(board.run(100))} == {"ok"}
    board.edges_lost = 1
    board.run(90)  # readings that wait
    assert {row[3] for row in rows(board.run(1000))} == {"lost_count"}
    board.ask("set second_ms 20")  # another input is nothing to it
    assert {row[3] for row in rows(board.run(500)) if row[2] == "encoder"} == {"lost_count"}
    board.ask("set encoder_ms 0")
    board.ask("set encoder_ms 10", 90)
    assert {row[3] for row in rows(board.run(100)) if row[2] == "encoder"} == {"ok"}


def test_an_ads1115_gives_a_result_of_its_own_for_each_start_and_silence_without_an_answer() -> (
    None
):
    board = Desk()
    board.ask("set adc16 1")
    got = rows(board.run(1000))
    assert {row[2:4] for row in got} == {("adc16", "ok")}
    assert 44 <= len(got) <= 50  # what waits for a frame has not come yet
    board.gone = 2
    board.run(120)
    assert {row[3] for row in rows(board.run(1000))} == {"silent"}
    board.gone = 0
    board.run(100)
    assert {row[3] for row in rows(board.run(200))} == {"ok"}


def test_both_analogue_inputs_are_read_at_their_own_times() -> None:
    board = Desk()
    board.ask("set second_ms 20")
    board.ask("set third_ms 50")
    board.pressure_x16 = 16 * 2000
    got = rows(board.run(1000))
    assert sum(row[2:4] == ("second", "ok") for row in got) == pytest.approx(50, abs=3)
    assert sum(row[2:4] == ("third", "ok") for row in got) == pytest.approx(20, abs=2)


# ---- the codec ------------------------------------------------------------------------

READINGS = st.lists(
    st.tuples(
        st.integers(0, 4), st.integers(0, 5),
        st.integers(-(2**31), 2**31 - 1), st.integers(0, 2**32 - 1),
    ),
    max_size=40,
)  # fmt: skip


@given(READINGS, st.integers(1, 65535), st.integers(0, 2**32 - 1), st.integers(0, 63))
def test_what_the_firmware_writes_the_host_reads(
    readings: list[tuple[int, int, int, int]], boot: int, seq: int, first: int
) -> None:
    words: Any = [0] * inputs.CHANNEL_WORDS
    words[inputs.FIRST] = first
    words[inputs.SEQUENCE_LOW], words[inputs.SEQUENCE_HIGH] = seq & 0xFFFF, seq >> 16
    ring = bytearray(inputs.HELD_READINGS * wire.READING_SIZE)
    for which, state, value, t_us in readings:
        inputs.put(words, ring, which | state << 4, value, t_us & 0xFFFF, t_us >> 16)
    got: list[tuple[int, int, int, int]] = []
    while words[inputs.WAITING]:
        out = bytearray(wire.ONE_BLOCK + 1)
        size = inputs.gather_readings(words, ring, boot, out)
        payload = bytes(out[1 : size + 1])
        assert wire.decode_frame(wire.encode_frame(payload)[:-1]) == payload
        boot_read, seq0, table = channels_payload(payload)
        assert (boot_read, seq0) == (boot, (seq + len(got)) % 2**32)
        got += [(tag & 15, tag >> 4, value, t_us) for t_us, tag, value in table.tolist()]
    assert got == readings


@given(st.binary(max_size=120))
def test_any_other_payload_is_refused(data: bytes) -> None:
    payload = b"X" + data
    whole = len(data) >= 7 and len(data) == 7 + 9 * data[6]
    if whole:
        assert len(channels_payload(payload)[2]) == data[6]
    else:
        with pytest.raises(CodecError):
            channels_payload(payload)


def payload_of(seq0: int, *values: int, boot: int = 1, tag: int = 0) -> bytes:
    head = struct.pack(wire.CHANNELS_HEADER, wire.CHANNELS, boot, seq0 % 2**32, len(values))
    return head + b"".join(struct.pack(wire.READING, 1000 * v, tag, v) for v in values)


def stream() -> tuple[ChannelStream, list[ChannelReading]]:
    made, got = ChannelStream(DeviceTime()), []
    made.listeners["bridge"] = lambda arrived, readings: got.extend(readings)
    return made, got


def test_lost_and_doubled_frames_are_counted_and_no_reading_comes_twice() -> None:
    made, got = stream()
    made.feed(payload_of(2**32 - 2, 1, 2, 3), 0)
    made.feed(payload_of(1, 4, 5), 1)
    made.feed(payload_of(1, 4, 5), 2)
    made.feed(payload_of(2, 5, 6), 3)
    made.feed(payload_of(10, 13), 4)
    assert [r.value for r in got] == [1, 2, 3, 4, 5, 6, 13]
    assert (made.duplicates, made.gaps, made.missing) == (3, 1, 6)
    made.feed(payload_of(0, 7, boot=2), 5)
    assert (got[-1].value, made.missing) == (7, 6)


def test_an_input_or_a_state_of_a_later_firmware_is_counted_and_skipped() -> None:
    made, got = stream()
    made.feed(payload_of(0, 1, tag=9), 0)
    made.feed(payload_of(1, 1, tag=15 << 4), 0)
    assert (got, made.unknown) == ([], 2)


@given(st.lists(st.integers(-(2**22), 2**22), max_size=40))
def test_an_encoder_counts_on_beyond_its_24_bits(steps: list[int]) -> None:
    edges, total = EdgeCount(), 0
    assert edges.unwrap(0) == 0
    for step in steps:
        total += step
        value = (total + 2**23) % 2**24 - 2**23
        assert edges.unwrap(value) == total


def test_between_its_readings_only_a_converter_is_looked_at() -> None:
    """With a look at each input each tick, ``burst`` missed 12 % of the readings on the emulated
    chip instead of 7 %."""
    c = DeskBoard().controller
    c.values.update(bridge=5, adc16=1, adc16_ms=8, encoder_ms=7, second_ms=5, third_ms=3)
    c.channels.load(c.values)
    looked = [inputs.pass_time(c.channels._words, 1000) & 31 for _ in range(7)]
    converters = 1 << inputs.BRIDGE | 1 << inputs.ADC16
    assert [mask & converters for mask in looked] == [converters] * 7
    for which, period_ms in ((inputs.ENCODER, 7), (inputs.SECOND, 5), (inputs.THIRD, 3)):
        due = [ms for ms, mask in enumerate(looked, start=1) if mask & 1 << which]
        assert due == list(range(period_ms, 8, period_ms))


# ---- on the other interpreter ---------------------------------------------------------

ALL_ON = """
import gc
from valvefw.deskboard import DeskBoard
board = DeskBoard()
board.tx = lambda data, n: None
c = board.controller
c.values.update({'bridge': 5, 'adc16': 1, 'adc16_ms': 8, 'encoder_ms': 7, 'second_ms': 5,
                 'third_ms': 3})
c.channels.load(c.values)
s = c.core.state
gc.collect()
gc.disable()
worst = 0
before = 0
after = 0
k = 0
while k < %d:
    k += 1
    board.pressure_x16 = 20000 + k
    board.now_us += 1000
    if k == 300:
        board.gone = 3
    c.step()
    before = gc.mem_alloc()
    %s
    if c.channels.poll():
        c.channels.frame()
    after = gc.mem_alloc()
    if after - before > worst:
        worst = after - before
gc.enable()
print(worst)
"""


def test_inputs_allocate_nothing_on_the_board() -> None:
    interpreter = micropython_host.shared()
    assert int(interpreter.run(ALL_ON % (500, "pass"))) == 0
    assert int(interpreter.run(ALL_ON % (9, "spoil = [k, k]"))) > 0


def test_both_interpreters_send_the_same_bytes() -> None:
    board, talk = DeskBoard(), micropython_host.desk_device()
    asked = [
        "set bridge 1", "set adc16 10", "set encoder_ms 3", "set second_ms 4", "set third_ms 90",
        "stat", "set bridge 0", "id",
    ]  # fmt: skip
    for text in asked:
        data = wire.encode_frame(f"Q1 {text}".encode())
        assert talk(data, 300) == board.run(300, data)
