"""What reads bytes off a wire: frames, replies, lines, registers."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

from daq.clock import VirtualClock
from daq.errors import PamrigError
from daq.link.codec import CodecError, decode_event, decode_reply, encode_request
from daq.link.framer import CobsFramer
from daq.link.telemetry import TelemetryStream
from daq.link.transport import memory_pair
from rigs.devices.event_loop import EventLoop
from rigs.devices.instruments.balance import Balance
from rigs.devices.instruments.modbus import ModbusInstrument
from rigs.devices.instruments.supply import Supply
from rigs.devices.instruments.text import TextInstrument
from rigs.devices.motion.grbl import GrblStage
from rigs.devices.valve_controller import ValveController
from rigs.rigfile.config import load_rig
from rigs.rigfile.form import load_form
from rigs.rigfile.modbus_form import ModbusForm
from rigs.rigfile.tables.stage import stage_module
from rigs.virtual.emulators.modbus import crc16
from rigs.virtual.emulators.supply import VirtualSupply
from valvefw import wire

from .loop import Target

LINK = (PamrigError,)


def _through(make: Callable[[Any, EventLoop], Any]) -> Callable[[bytes], None]:
    """A driver behind a link: each input is what its device sends, whole and then in two."""
    clock = VirtualClock()
    event_loop = EventLoop(clock, 0.02)
    link, end = memory_pair(clock, "fuzz")
    driver = make(link, event_loop)
    count = 0

    def run(data: bytes) -> None:
        nonlocal count
        count += 1
        at = count % (len(data) + 1)
        end.write(data[:at])
        driver.poll()
        end.write(data[at:])
        driver.poll()
        end.read()
        clock.sleep(0.03)

    return run


def _frame(data: bytes) -> bytes:
    return bytes(wire.encode_frame(data[:200]))


def _telemetry(seq: int, n: int) -> bytes:
    head = struct.pack(wire.TELEMETRY_HEADER, wire.TELEMETRY, 7, 160, seq, seq * 1000, n)
    return head + struct.pack(wire.SAMPLE, 1000, 400, 4, 0, 200) * n


def _payloads() -> list[bytes]:
    replies = [b"\x52\x01\x00ok t=1234 armed=1", b"\x52\x02\x00err bounds 5"]
    return [_telemetry(5, 10), _telemetry(15, 1), b"\x45fault cause=x", *replies]


def _frames() -> list[bytes]:
    return [*map(_frame, _payloads()), encode_request(1, "hb 1")]


def _framer() -> Target:
    framer = CobsFramer()
    return Target("framer", "COBS frames with a CRC", framer.feed, _frames(), (), (b"\0",))


def _codec() -> Target:
    def run(data: bytes) -> None:
        for read in (decode_reply, decode_event):
            try:
                read(data)
            except CodecError:
                continue
        TelemetryStream(lambda batch: None).feed(data, 0)

    words = (b"=", b" ", b"ok ", b"err ", b"t=")
    return Target("codec", "replies, events, telemetry", run, _payloads(), (CodecError,), words)


def _valve() -> Target:
    run = _through(lambda link, event_loop: ValveController(link, event_loop.clock, event_loop))
    return Target("valve driver", "the controller's byte stream", run, _frames(), LINK, (b"\0",),
                  lambda data: _frame(data[:60]))  # fmt: skip


def _balance() -> Target:
    corpus = [
        b"S S     12.345 g\r\n",
        b"S D     -0.500 g\r\n",
        b"S +\r\n",
        b'I4 A "B"\r\n',
        b"ES\r\n",
    ]
    run = _through(lambda link, event_loop: Balance(link, event_loop))
    words = (b"\r\n", b"S ", b"S S", b" g")
    return Target("MT-SICS", "a balance's lines", run, corpus, LINK, words)


def _stage() -> Target:
    corpus = [b"<Idle|MPos:60.000,0,0>\r\n", b"ok\r\n", b"error:9\r\n", b"ALARM:1\r\n"]
    run = _through(lambda link, event_loop: GrblStage(link, event_loop, 10.0))
    words = (b"<", b"|", b"MPos:", b"\r\n")
    return Target("stage", "a motion controller's lines", run, corpus, LINK, words)


def _other_stage(kind: str, corpus: list[bytes], words: tuple[bytes, ...]) -> Target:
    device = load_rig(f"virtual-{kind}").stage

    def make(link: Any, event_loop: EventLoop) -> Any:
        stage = stage_module(kind, "rigs.devices.motion").open_stage(link, event_loop, device)
        stage._ready = True
        return stage

    return Target(kind, "a stage's messages", _through(make), corpus, LINK, words)


def _marlin() -> Target:
    corpus = [b"X:60.00 Y:0.00 Z:0.00 E:0.00 Count X:4800 Y:0 Z:0\n", b"ok\n", b"Resend: 4\n",
              b"echo:endstops hit:  X:12.00\n"]  # fmt: skip
    return _other_stage("marlin", corpus, (b"X:", b"Count ", b"\n", b"ok"))


def _zaber() -> Target:
    corpus = [b"@01 0 OK IDLE -- 0:8D\r\n", b"@01 1 07 OK BUSY WR 419948\r\n", b"!01 1 IDLE --\r\n"]
    return _other_stage("zaber", corpus, (b"@01 1 ", b" OK IDLE -- ", b":", b"\r\n"))


def _tmcl() -> Target:
    corpus = [bytes.fromhex("02 01 64 06 00 00 02 c7 36"), bytes.fromhex("02 01 01 09") + bytes(5)]
    return _other_stage("tmcl", corpus, (b"\x02\x01\x64",))


def _modbus() -> Target:
    def make(link: Any, event_loop: EventLoop) -> ModbusInstrument:
        form = ModbusForm("pressure_kpa", "kPa", 1, 0)
        device = ModbusInstrument(link, event_loop, "p", form, baud=19200)
        device._begin(0)
        return device

    answer = bytes([1, 3, 4, 0x41, 0x20, 0, 0])
    corpus = [answer + crc16(answer), bytes([1, 0x83, 2]) + crc16(bytes([1, 0x83, 2]))]
    return Target("Modbus", "a transmitter's registers", _through(make), corpus, LINK, (),
                  lambda data: data[:60] + crc16(data[:60]))  # fmt: skip


def _text(name: str, form: str, corpus: list[bytes]) -> Target:
    def make(link: Any, event_loop: EventLoop) -> TextInstrument:
        device = TextInstrument(link, event_loop, form, load_form(form))
        device._begin(0)
        return device

    words = (b"\r\n", b"N", b"C", b"+")
    return Target(name, "an indicator's lines", _through(make), corpus, LINK, words)


def _supply() -> Target:
    """Each input is what comes after a question for a measurement; all else is answered well."""
    clock = VirtualClock()
    event_loop = EventLoop(clock, 0.05)
    link, end = memory_pair(clock, "fuzz")
    driver = Supply(link, event_loop, 24.0, 30.0)
    sound = VirtualSupply(lambda data: end.write(data), "7")
    waiting: list[bytes] = []

    def answer() -> None:
        for line in b"".join(c.data for c in end.read()).splitlines(keepends=True):
            if b"MEAS" in line and waiting:
                end.write(waiting.pop())
            else:
                sound.feed(line)
        sound.advance(clock.now_ns())
        driver.poll()

    event_loop.add(answer)

    def run(data: bytes) -> None:
        waiting[:] = [data]
        driver.measure()

    corpus = [b"24.000\n", b"+2.400000E+01\n", b'0,"No error"\n24.0\n', b"-9.9E37\n"]
    return Target("supply", "a SCPI supply's answers", run, corpus, LINK, (b"\n", b",", b"9.9E37"))


TARGETS: dict[str, Callable[[], Target]] = {
    "framer": _framer,
    "codec": _codec,
    "valve driver": _valve,
    "MT-SICS": _balance,
    "stage": _stage,
    "Marlin": _marlin,
    "Zaber": _zaber,
    "TMCL": _tmcl,
    "Modbus": _modbus,
    "load cell": lambda: _text("load cell", "load-cell-stream", [b"+00012.34 N\r\n"]),
    "thermometer": lambda: _text("thermometer", "thermometer", [b"21.05 C\r\n", b"21.05\r\n"]),
    "supply": _supply,
}
