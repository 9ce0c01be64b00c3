"""What is fuzzed: everything that reads bytes of an instrument, a file or a folder of others."""

from __future__ import annotations

import json
import shutil
import struct
import tempfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from daq.clock import VirtualClock
from daq.codec import CodecError, decode_event, decode_reply, encode_request
from daq.errors import PamrigError
from daq.framer import CobsFramer
from daq.record import RecordWriter
from daq.run import open_run
from daq.sealed import seal_line
from daq.store import show
from daq.telemetry import TelemetryStream
from daq.transport import memory_pair
from daq.verify import verify
from gap.reader import read_dataset
from plant.errors import PlantError
from plant.models.catalogue import load as load_model
from rigs.balance import Balance
from rigs.config import load_rig
from rigs.frames import open_frames
from rigs.instruments.form import load_form
from rigs.instruments.modbus import ModbusForm, ModbusInstrument
from rigs.instruments.text import TextInstrument
from rigs.pictures import decode, measure_stored
from rigs.pump import Pump
from rigs.stage import Stage
from rigs.toml_reader import load_toml
from rigs.valve import ValveController
from rigs.virtual.modbus import crc16
from valvefw import wire

from .loop import Target

LINK = (PamrigError,)


def _through(make: Callable[[Any, Pump], Any]) -> Callable[[bytes], None]:
    """A driver behind a link: each input is what its device sends, whole and then in two."""
    clock = VirtualClock()
    pump = Pump(clock, 0.02)
    link, end = memory_pair(clock, "fuzz")
    driver = make(link, pump)
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


def _codec(data: bytes) -> None:
    for read in (decode_reply, decode_event):
        try:
            read(data)
        except CodecError:
            continue
    TelemetryStream(lambda batch: None).feed(data, 0)


def _modbus(link: Any, pump: Pump) -> ModbusInstrument:
    device = ModbusInstrument(link, pump, "p", ModbusForm("pressure_kpa", "kPa", 1, 0), baud=19200)
    device._begin(0)
    return device


def _text(name: str) -> Callable[[Any, Pump], TextInstrument]:
    def make(link: Any, pump: Pump) -> TextInstrument:
        device = TextInstrument(link, pump, name, load_form(name))
        device._begin(0)
        return device

    return make


def _file(suffix: str, read: Callable[[Path], object]) -> Callable[[bytes], None]:
    path = Path(tempfile.mkdtemp(prefix="fuzz")) / f"strange{suffix}"

    def run(data: bytes) -> None:
        path.write_bytes(data)
        read(path)

    return run


def _record(folder: Path) -> Path:
    record = RecordWriter(
        folder, {"protocol": "isometric", "specimen": "m"}, VirtualClock(), durable=False,
        threaded=False,
    )  # fmt: skip
    record.stream("valve", {"seq": "int64", "counts": "uint16"})
    for k in range(2):
        rows = np.arange(20 * k, 20 * k + 20)
        record.append("valve", {"seq": rows, "counts": rows.astype(np.uint16)})
    record.event("state", state="first")
    record.event("point", order=1, trial=1, slot="a", mounting="m", replicate=1, direction="up",
                 settled=True, valve_seq=[0, 40], balance_rows=[0, 0], frames=[0])  # fmt: skip
    record.frame(b"no picture", 1)
    record.wire("valve", 1, b"bytes")
    record.finalize("clean")
    return record.folder


FILES = ("run.json", "final.json", "events.jsonl", "samples/valve.index.jsonl", "frames.jsonl",
         "samples/valve/000001.arrows", "wire/valve.index.jsonl")  # fmt: skip


def _folder() -> Target:
    """A run folder one of whose files is an input; its first byte says which."""
    from rigs.segments import reduce_run

    folder = _record(Path(tempfile.mkdtemp(prefix="fuzz")))
    sound = {name: (folder / name).read_bytes() for name in FILES}

    def run(data: bytes) -> None:
        name = FILES[data[0] % len(FILES) if data else 0]
        path = folder / name
        path.write_bytes(data[1:])
        try:
            strange = open_run(folder)
            verify(strange)
            show(strange)
            for look in (reduce_run, lambda r: r.samples("valve"), lambda r: r.frame_bytes(0)):
                try:
                    look(strange)
                except PamrigError:
                    continue
        finally:
            path.write_bytes(sound[name])

    def seal(data: bytes) -> bytes:
        if not data:
            return data
        name, body = FILES[data[0] % len(FILES)], data[1:]
        if name.endswith(".jsonl"):
            lines = [_line(line) for line in body.split(b"\n") if line]
            return data[:1] + b"".join(lines)
        at = body.rfind(b',\n  "crc"')
        if name.endswith(".json") and at > 0:
            return data[:1] + body[:at] + b',\n  "crc": "%08x"\n}\n' % zlib.crc32(body[:at])
        return data

    corpus = [bytes([k]) + sound[name] for k, name in enumerate(FILES)]
    words = (b"[[[[", b'"n":', b'"file":"../x"', b'"rows":', b"{}", b"null", b'"offset":-1', b"1e9")
    return Target("run folder", run, corpus, LINK, ("daq/", "rigs/reduction"), words, seal)


def _line(line: bytes) -> bytes:
    try:
        fields = json.loads(line)
        fields.pop("crc", None)
        return seal_line(fields)
    except (ValueError, AttributeError, RecursionError):
        at = line.rfind(b',"crc"')
        body = line[:at] if at > 0 else line
        return b'%s,"crc":"%08x"}\n' % (body, zlib.crc32(body))


def _exchange() -> Target:
    folder = Path(tempfile.mkdtemp(prefix="fuzz"))
    files = {
        "trials.csv": b"trial,slot,replicate,protocol,mounting,order,held_length_mm,load_kg,"
        b"temperature_c,start_s\nt1,a,1,isometric,m1,1,60,,21,0\nt2,a,2,isometric,m1,2,60,,21,9\n",
        "samples.csv": b"trial,time_s,inlet_cmd,outlet_cmd,pressure_kpa,force_n,length_mm\n"
        + b"".join(b"t%d,%d.5,1,0,%d,%d.25,60\n" % (1 + k // 4, k % 4, k, k) for k in range(8)),
        "bench.toml": b"supply_kpa = 700\n[effects.creep]\n",
    }
    for name, data in files.items():
        (folder / name).write_bytes(data)
    names = tuple(files)

    def run(data: bytes) -> None:
        name = names[data[0] % 3 if data else 0]
        (folder / name).write_bytes(data[1:])
        try:
            read_dataset(folder)
        finally:
            (folder / name).write_bytes(files[name])

    corpus = [bytes([k]) + files[name] for k, name in enumerate(names)]
    words = (b",", b"\n", b'"', b"pressure_bar", b"1e308", b"inf", b"t1", b"up", b"=", b"[")
    return Target("EXCHANGE folder", run, corpus, LINK, ("gap/reader", "gap/tables"), words)


def _pictures() -> list[bytes]:
    gray = np.full((40, 60), 180, np.uint8)
    gray[5:35, 10:20] = 40
    gray[5:35, 50:60] = 40
    return [cv2.imencode(suffix, gray)[1].tobytes() for suffix in (".jpg", ".png", ".pgm", ".bmp")]


def _picture(data: bytes) -> None:
    gray = decode(data)
    if gray is not None and gray.size:
        measure_stored(gray, {})


def targets() -> list[tuple[Target, float]]:
    """Every target with its share of the inputs."""
    for sound in _pictures():  # what is compiled is loaded before anything is traced
        _picture(sound)
    replies = [b"\x52\x01\x00ok t=1234 armed=1", b"\x52\x02\x00err bounds 5"]
    payloads = [_telemetry(5, 10), _telemetry(15, 1), b"\x45fault cause=x", *replies]
    frames = [_frame(p) for p in payloads] + [encode_request(1, "hb 1")]
    valve = _through(lambda link, pump: ValveController(link, pump.clock, pump))
    framer = CobsFramer()
    balance = [
        b"S S     12.345 g\r\n",
        b"S D     -0.500 g\r\n",
        b"S +\r\n",
        b'I4 A "B"\r\n',
        b"ES\r\n",
    ]
    answer = bytes([1, 3, 4, 0x41, 0x20, 0, 0])
    modbus = [answer + crc16(answer), bytes([1, 0x83, 2]) + crc16(bytes([1, 0x83, 2]))]
    toml = [_shipped("rigs/virtual"), _shipped("rigs/virtual-instruments"),
            _shipped("protocols/isometric-short")]  # fmt: skip
    model = [_shipped(f"plant/models/{p}") for p in _models()]
    keys = (b"[", b"]", b"= ", b'"', b"{", b"}", b".", b"\n", b"[[", b"true", b"1e400", b"inf")
    return [
        (Target("framer", framer.feed, frames, (), ("daq/framer", "valvefw/wire"), (b"\0",)), 0.40),
        (Target("codec", _codec, payloads, (CodecError,), ("daq/codec", "daq/telemetry"),
                (b"=", b" ", b"ok ", b"err ", b"t=")), 0.20),
        (Target("valve driver", valve, frames, LINK, ("rigs/valve", "daq/"), (b"\0",),
                lambda data: _frame(data[:60])), 0.06),
        (Target("MT-SICS", _through(lambda link, pump: Balance(link, pump)), balance, LINK,
                ("rigs/balance", "rigs/lines"), (b"\r\n", b"S ", b"S S", b" g")), 0.14),
        (Target("stage", _through(lambda link, pump: Stage(link, pump, 10.0)),
                [b"<Idle|MPos:60.000,0,0>\r\n", b"ok\r\n", b"error:9\r\n", b"ALARM:1\r\n"], LINK,
                ("rigs/stage", "rigs/lines"), (b"<", b"|", b"MPos:", b"\r\n")), 0.05),
        (Target("Modbus", _through(_modbus), modbus, LINK, ("rigs/instruments",), (),
                lambda data: data[:60] + crc16(data[:60])), 0.05),
        (Target("load cell", _through(_text("load-cell-stream")), [b"+00012.34 N\r\n"], LINK,
                ("rigs/instruments",), (b"\r\n", b"N", b"+")), 0.05),
        (Target("thermometer", _through(_text("thermometer")), [b"21.05 C\r\n", b"21.05\r\n"], LINK,
                ("rigs/instruments",), (b"\r\n", b"C")), 0.04),
        (Target("TOML rig", _file(".toml", lambda p: load_rig(str(p))), toml, LINK,
                ("rigs/config", "rigs/toml_reader", "plant/"), keys), 0.0005),
        (Target("TOML", _file(".toml", lambda p: load_toml(str(p), "rigs")), toml, LINK,
                ("plant/tomlfile",), keys), 0.002),
        (Target("model file", _file(".toml", load_model), model, (PlantError,),
                ("plant/models",), keys), 0.0005),
        (_folder(), 0.0015),
        (_exchange(), 0.001),
        (Target("picture", _picture, _pictures(), (), ("vision/", "rigs/pictures"),
                (b"\xff\xd8", b"\xff\xc0", b"IHDR", b"P5")), 0.003),
        (Target("picture file", _file(".tif", lambda p: list(open_frames(p))), _pictures(), LINK,
                ("rigs/frames",), (b"II*\0", b"MM\0*")), 0.001),
    ]  # fmt: skip


def _shipped(name: str) -> bytes:
    from importlib.resources import files

    return files("configs").joinpath(f"{name}.toml").read_bytes()


def _models() -> list[str]:
    from importlib.resources import files

    folder = files("configs").joinpath("plant", "models")
    return sorted(e.name.removesuffix(".toml") for e in folder.iterdir() if e.name[-5:] == ".toml")[
        :4
    ]


def tidy() -> None:
    """Remove the folders that targets wrote to."""
    for folder in Path(tempfile.gettempdir()).glob("fuzz*"):
        shutil.rmtree(folder, ignore_errors=True)
