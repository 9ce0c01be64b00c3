"""The wire as any controller must speak it, over nothing but bytes.

``device`` gives a fresh controller with two functions: ``talk(data, ms) -> bytes`` and nothing
else is used, so that the same suite runs against another interpreter or a port.
"""

from __future__ import annotations

import itertools
import os
import re
import struct
import time
from collections.abc import Callable, Iterator

import pytest

import micropython_host
from daq.clock import RealClock
from daq.link.transport import SerialLink
from valvefw.config import PARAMETERS, config_crc, defaults
from valvefw.deskboard import DeskBoard
from valvefw.wire import cobs_encode, decode_frame, encode_frame, lfsr_next

Talk = Callable[[bytes, int], bytes]


def desk_device() -> Talk:
    """The firmware under this interpreter, on the desk board."""
    board = DeskBoard()

    def talk(data: bytes, ms: int) -> bytes:
        return board.run(ms, data)

    return talk


def pty_device() -> Talk:
    """The same with every byte through a pseudo-terminal and the host's own serial link."""
    import tty

    master, slave = os.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    link = SerialLink(os.ttyname(slave), 115200, RealClock())
    board = DeskBoard()
    _open.append(lambda: (link.close(), os.close(master), os.close(slave)))

    def device_reads() -> bytes:
        try:
            return os.read(master, 4096)
        except BlockingIOError:
            return b""

    def carried(data: bytes, write: Callable[[bytes], object], read: Callable[[], bytes]) -> bytes:
        got = b""
        end = time.monotonic() + 60.0
        for at in range(0, len(data), 512):
            write(data[at : at + 512])
            while len(got) < min(at + 512, len(data)):
                part = read()
                got += part
                if not part:
                    assert time.monotonic() < end, "bytes were lost on the way"
                    time.sleep(0.0002)
        return got

    def host_reads() -> bytes:
        return b"".join(chunk.data for chunk in link.read())

    def talk(data: bytes, ms: int) -> bytes:
        arrived = carried(data, link.write, device_reads)
        return carried(board.run(ms, arrived), lambda d: os.write(master, d), host_reads)

    return talk


_open: list[Callable[[], object]] = []

DEVICES = [
    pytest.param(desk_device, id="cpython"),
    pytest.param(pty_device, id="pty", marks=pytest.mark.skipif(os.name == "nt", reason="no pty")),
    pytest.param(micropython_host.desk_device, id="micropython"),
]


@pytest.fixture(scope="session", autouse=True)
def _end_the_interpreter() -> Iterator[None]:
    yield
    micropython_host.close_shared()


class Host:
    """Speaks frames to a device and sorts what comes back."""

    def __init__(self, talk: Talk) -> None:
        self.talk = talk
        self.number = 0
        self.events: list[str] = []
        self.telemetry: list[bytes] = []
        self.beats = 0

    def send(self, data: bytes, ms: int = 1) -> list[str]:
        """Raw bytes out; the replies that came within ``ms``."""
        replies = []
        for frame in self.talk(data, ms).split(b"\x00"):
            if not frame:
                continue
            payload = decode_frame(frame)
            assert payload is not None, "the device sent a damaged frame"
            kind, rest = payload[:1], payload[1:]
            if kind == b"R":
                replies.append(rest.decode("ascii"))
            elif kind == b"E":
                self.events.append(rest.decode("ascii"))
            else:
                assert kind == b"T"
                self.telemetry.append(payload)
        return replies

    def ask(self, text: str, ms: int = 1) -> str:
        """One request; its reply without the id."""
        self.number += 1
        replies = self.send(encode_frame(f"Q{self.number} {text}".encode()), ms)
        assert len(replies) == 1, f"{text!r} got {replies}"
        number, _, reply = replies[0].partition(" ")
        assert int(number) == self.number
        return reply

    def fields(self, text: str) -> dict[str, str]:
        """One request that must succeed; its key=value pairs."""
        reply = self.ask(text)
        assert reply.split()[0] == "ok", f"{text!r} got {reply!r}"
        return dict(word.split("=", 1) for word in reply.split()[1:])

    def arm(self, scheme: str = "idle") -> None:
        ident = self.fields("id")
        assert self.ask(f"arm {ident['conf']} {ident['boot']}") == "ok"
        assert self.ask(f"scheme {scheme}") == "ok"

    def run(self, ms: int) -> None:
        """Let time pass with heartbeats."""
        while ms > 0:
            self.beats += 1
            assert self.ask(f"hb {self.beats}", min(ms, 100)).startswith("ok")
            ms -= 100

    def samples(self) -> list[tuple[int, int, int, int, int, int]]:
        """All samples so far: seq, dt_us, counts, flags, inlet_u5, vent_u5."""
        rows = []
        for payload in self.telemetry:
            _, _, _, seq0, _, n = struct.unpack_from("<BHHIIB", payload)
            assert len(payload) == 14 + 7 * n
            for k in range(n):
                rows.append((seq0 + k, *struct.unpack_from("<HHBBB", payload, 14 + 7 * k)))
        return rows


@pytest.fixture(params=DEVICES)
def host(request: pytest.FixtureRequest) -> Iterator[Host]:
    yield Host(request.param())
    while _open:
        _open.pop()()


def test_identity_names_everything_a_host_checks(host: Host) -> None:
    ident = host.fields("id")
    assert set(ident) == {"name", "fw", "proto", "board", "serial", "boot", "cause", "conf"}
    assert ident["name"] == "valvefw"
    assert ident["proto"] == "1"
    assert ident["conf"] == f"{config_crc(defaults()):04x}"
    assert host.events[0] == f"boot id={ident['boot']} cause={ident['cause']} fw={ident['fw']}"


def test_every_reply_repeats_its_id_in_order(host: Host) -> None:
    data = b"".join(encode_frame(b"Q%d id" % i) for i in (7, 65535, 0))
    assert [r.split()[0] for r in host.send(data, 2)] == ["7", "65535", "0"]


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("", "syntax"),
        ("frobnicate", "verb"),
        ("ID", "verb"),
        ("id now", "syntax"),
        ("hb", "syntax"),
        ("hb -1", "syntax"),
        ("hb +1", "syntax"),
        ("hb 1_0", "syntax"),
        ("hb 0x10", "syntax"),
        ("hb 65536", "range"),
        ("hb 99999999999", "syntax"),
        ("set nonsense 1", "key"),
        ("get nonsense", "key"),
        ("conf 999", "range"),
        ("set trip 0", "range"),
        ("set trip 4096", "range"),
        ("telemetry 0", "range"),
        ("telemetry 33", "range"),
        ("led 2", "range"),
        ("led sync 0 10", "range"),
        ("led sync 5", "syntax"),
        ("scheme fly", "range"),
        ("scheme pwm", "not_armed"),
        ("scheme reg", "scheme"),
        ("sp 100", "not_armed"),
        ("sp 65535", "range"),
        ("pulse inlet 10000", "not_armed"),
        ("pulse outlet 10000", "range"),
        ("pulse inlet 3", "range"),
        ("pulse inlet 12", "range"),
        ("pulse inlet 2000000", "range"),
        ("pulse inlet 10000 3", "syntax"),
        ("pulse inlet 10000 3 15000", "range"),
        ("arm zzzz 1", "syntax"),
        ("blackbox 0", "range"),
    ],
)
def test_refusals_carry_a_code_and_a_remedy(host: Host, text: str, code: str) -> None:
    reply = host.ask(text)
    assert reply.startswith(f"err {code} "), reply
    assert len(reply.split()) >= 4


@pytest.mark.parametrize("payload", [b"Q", b"Qx id", b"Q-1 id", b"Q65536 id", b"Q1 i\x80d", b"Q\t"])
def test_requests_without_a_readable_id_are_answered_under_id_0(host: Host, payload: bytes) -> None:
    (reply,) = host.send(encode_frame(payload), 2)
    assert reply.startswith("0 err syntax ")


def test_an_overlong_request_is_refused(host: Host) -> None:
    (reply,) = host.send(encode_frame(b"Q1 " + b"x" * 200), 2)
    assert reply.startswith("0 err syntax ")


@pytest.mark.parametrize("kind", [b"R", b"T", b"E", b"\x01"])
def test_payloads_that_are_no_requests_get_no_answer(host: Host, kind: bytes) -> None:
    assert host.send(encode_frame(kind + b"1 id"), 2) == []


def test_damaged_frames_are_counted_and_not_answered(host: Host) -> None:
    bad = cobs_encode(b"Q1 id\x00\x00") + b"\x00"
    assert host.send(bad + b"\x00\x00" + bad, 2) == []
    assert host.fields("stat")["bad"] == "2"


def test_parameters_list_set_and_change_the_crc_both_sides_compute(host: Host) -> None:
    listed = {}
    for i in range(int(host.fields("conf")["n"])):
        row = host.fields(f"conf {i}")
        listed[row["key"]] = tuple(int(row[k]) for k in ("default", "low", "high"))
        assert row["value"] == row["default"]
    assert listed == {row[0]: (row[1], row[2], row[3]) for row in PARAMETERS}
    values = defaults()
    values["trip"] = 3000
    assert host.fields("set trip 3000") == {"conf": f"{config_crc(values):04x}"}
    assert host.fields("get trip") == {"trip": "3000"}


def test_arm_wants_this_configuration_and_this_boot(host: Host) -> None:
    ident = host.fields("id")
    conf, boot = ident["conf"], int(ident["boot"])
    assert host.ask(f"arm {int(conf, 16) ^ 1:04x} {boot}").startswith("err conf ")
    assert host.ask(f"arm 1{conf} {boot}").startswith("err conf ")
    assert host.ask(f"arm {conf} {(boot + 1) & 0xFFFF}").startswith("err boot ")
    assert host.ask(f"arm {conf.upper()} {boot}") == "ok"
    assert host.ask(f"arm {conf} {boot}").startswith("err armed ")
    assert host.fields("stat")["state"] == "armed"


def test_nothing_can_be_set_while_armed(host: Host) -> None:
    host.arm()
    assert host.ask("set trip 3000").startswith("err armed ")
    assert host.ask("stop") == "ok"
    assert host.ask("set trip 3000").startswith("ok")


def test_contradicting_parameters_cannot_be_armed(host: Host) -> None:
    conf = host.fields("set trip 2000")["conf"]  # below sp_max
    boot = host.fields("id")["boot"]
    assert host.ask(f"arm {conf} {boot}").startswith("err conf sp_max 2540 is above trip 2000")


def test_heartbeat_tells_the_time_and_must_go_on(host: Host) -> None:
    first = host.fields("hb 5")
    second = host.fields("hb 5")  # disarmed: a mere clock ping
    assert int(second["t"]) - int(first["t"]) == 1000
    host.arm()
    assert host.fields("hb 65535")["hb"] == "65535"
    assert host.ask("hb 65535").startswith("err stale ")
    assert host.ask("hb 0").startswith("ok")  # wraps
    assert host.ask("hb 65535").startswith("err stale ")


def test_set_points_belong_to_schemes_that_regulate(host: Host) -> None:
    host.arm()
    assert host.ask("sp 1000").startswith("err scheme ")
    assert host.ask("scheme open") == "ok"
    assert host.ask("sp 1000").startswith("err scheme ")
    assert host.ask("pulse vent 5000") == "ok"
    assert host.ask("scheme pwm") == "ok"
    assert host.ask("pulse vent 5000").startswith("err scheme ")
    assert host.fields("sp 1000") == {"sp": "1000"}
    assert host.ask("sp 40641").startswith("err range ")
    assert host.fields("stat")["sp"] == "1000"


def test_a_pulse_train_is_in_the_telemetry_to_the_last_5_us(host: Host) -> None:
    host.arm("open")
    host.telemetry.clear()
    assert host.ask("pulse inlet 2345 3 20000") == "ok"
    assert host.ask("pulse inlet 2345").startswith("err busy ")
    host.run(100)
    rows = host.samples()
    assert [r[0] for r in rows] == list(range(rows[0][0], rows[0][0] + len(rows)))
    inlet = [r[4] for r in rows]
    starts = [i for i, u in enumerate(inlet) if u and not inlet[i - 1]]
    assert [b - a for a, b in itertools.pairwise(starts)] == [20, 20]
    assert [u for u in inlet if u] == [200, 200, 69] * 3
    assert all(bool(r[3] & 1) == bool(r[4]) for r in rows)


def test_a_capture_is_read_in_blocks_of_100(host: Host) -> None:
    assert host.ask("block 0").startswith("err busy ")
    host.arm("open")
    assert host.ask("capture inlet 9000 1").startswith("err board ")
    assert host.ask("capture inlet 9000 0") == "ok n=800 period_us=50"
    assert host.ask("pulse inlet 9000").startswith("err busy ")
    assert host.ask("block 0").startswith("err busy ")
    host.telemetry.clear()
    host.run(60)
    samples: list[int] = []
    while len(samples) < 800:
        part = host.fields(f"block {len(samples)}")
        assert part["lead_us"] == "5000"
        data = part["data"]
        samples += [int(data[k : k + 3], 16) for k in range(0, len(data), 3)]
    assert samples == list(range(800))
    assert sum(r[4] for r in host.samples()) == 9000 // 5


def test_frames_hold_as_many_samples_as_asked_and_one_set_point_each(host: Host) -> None:
    host.arm("pwm")
    assert host.ask("telemetry 4") == "ok"
    host.telemetry.clear()
    host.run(18)
    host.fields("sp 1600")
    host.run(10)
    heads = [struct.unpack_from("<BHHIIB", p) for p in host.telemetry]
    assert max(h[5] for h in heads) == 4
    assert {h[2] for h in heads} == {0, 1600}
    rows = host.samples()
    assert [r[0] for r in rows] == list(range(rows[0][0], rows[0][0] + len(rows)))
    assert {r[1] for r in rows} == {1000}


def test_led_pattern_is_the_documented_one(host: Host) -> None:
    host.fields("led 1")
    start_us = int(host.fields("led sync 44257 3")["t"])
    host.send(b"", 120)
    state, bits = 44257, []
    for _ in range(50):
        bits.append(bool(state & 1))
        state = lfsr_next(state)
    checked = 0
    for payload in host.telemetry:
        t_us = struct.unpack_from("<I", payload, 9)[0]
        for k in range(payload[13]):
            _, _, flags, _, _ = struct.unpack_from("<HHBBB", payload, 14 + 7 * k)
            if t_us + 1000 * k >= start_us:
                assert bool(flags & 16) == bits[(t_us + 1000 * k - start_us) // 3000]
                checked += 1
    assert checked > 100
    assert True in bits[:35]
    assert False in bits[:35]


def test_stop_disarms_without_a_fault_and_vent_stays_armed(host: Host) -> None:
    host.arm("pwm")
    host.fields("sp 8000")
    host.run(300)
    assert host.ask("vent") == "ok"
    assert host.fields("stat")["state"] == "armed"
    assert host.fields("stat")["scheme"] == "idle"
    host.run(1900)
    assert re.fullmatch(r"vented t=\d+ ms=\d+", host.events[-1])
    assert host.ask("stop") == "ok"
    assert host.fields("stat")["state"] == "disarmed"
    assert host.ask("faults") == "ok n=0 samples=0"


def test_silence_is_a_latched_fault_with_cause_time_and_last_samples(host: Host) -> None:
    host.arm("pwm")
    host.fields("sp 8000")
    host.send(b"", 400)
    faults = host.fields("faults")
    assert faults["n"] == "1"
    assert faults["f1"] == "host_silent"
    assert faults["samples"] == "64"
    assert any(e.startswith(f"fault cause=host_silent t={faults['t1']} ") for e in host.events)
    box = b""
    while len(box) < 64 * 7:
        part = host.fields(f"blackbox {len(box) // 7}")
        box += bytes.fromhex(part["data"])
    last = struct.unpack_from("<HHBBB", box, 63 * 7)
    assert last[2] & 8
    assert last[4] == 200  # the sample that shows the vent
    assert not struct.unpack_from("<HHBBB", box, 62 * 7)[2] & 8
    for refused in ("arm 0000 1", "scheme pwm", "sp 0"):
        assert host.ask(refused).startswith("err fault ")
    assert host.fields("stat")["state"] == "fault"


def test_clear_waits_for_the_pressure_and_leaves_the_board_disarmed(host: Host) -> None:
    host.arm("pwm")
    host.fields("sp 20000")
    host.run(500)
    host.send(b"", 320)
    assert host.fields("faults")["f1"] == "host_silent"
    assert host.ask("clear").startswith("err pressure ")
    host.send(b"", 1900)
    assert host.ask("clear") == "ok"
    assert host.fields("stat")["state"] == "disarmed"
    host.arm("pwm")


def test_help_names_only_verbs_that_exist(host: Host) -> None:
    for verb in host.fields("help")["verbs"].split(","):
        assert not host.ask(verb).startswith("err verb")
