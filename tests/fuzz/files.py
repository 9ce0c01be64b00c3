"""What reads files and folders: TOML, records, data sets, pictures."""

from __future__ import annotations

import contextlib
import json
import random
import tempfile
import zlib
from collections.abc import Callable, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd

from analysis.formats.export import tables_of
from analysis.layouts.layouts import measured_edges
from analysis.reduction.pictures import decode, measure_stored
from analysis.reporting.report import report_json
from analysis.run_table import reduce_run
from daq.calibration import Calibration
from daq.clock import VirtualClock
from daq.errors import PamrigError
from daq.record.sealed import seal_line
from daq.record.writer import RecordWriter
from daq.store.annotations import annotate
from daq.store.derive import derive
from daq.store.info import run_info
from daq.store.run import Run, open_run
from daq.store.store import show
from daq.store.verify import verify
from gap.data.reader import read_dataset
from plant.constants import load_constants
from plant.errors import PlantError
from plant.finger.reader import load_finger, load_valve
from plant.links.reader import load_arm
from plant.models.catalogue import load as load_model
from rigs.calibration.frames import open_frames
from rigs.protocols.names import PROTOCOLS
from rigs.protocols.registry import procedure
from rigs.rigfile.command_form import load_command_form
from rigs.rigfile.config import load_rig
from rigs.rigfile.form import load_form
from rigs.rigfile.plant_file import load_plant
from rigs.rigfile.toml_reader import load_toml
from studies.simulation.scenario import load_scenario

from .loop import Target
from .structure import change_csv, change_json, change_toml
from .sums import map_anew, seal_anew

LINK = (PamrigError,)
KEYS = (b"[", b"]", b"= ", b'"', b"{", b"}", b".", b"\n", b"[[", b"true", b"1e400", b"inf")


def _file(suffix: str, read: Callable[[Path], object]) -> Callable[[bytes], None]:
    path = Path(tempfile.mkdtemp(prefix="fuzz")) / f"strange{suffix}"

    def run(data: bytes) -> None:
        path.write_bytes(data)
        read(path)

    return run


def _shipped(name: str) -> bytes:
    return files("configs").joinpath(f"{name}.toml").read_bytes()


RIGS = ("rigs/virtual", "rigs/virtual-instruments")


def _text(*folder: str) -> list[bytes]:
    """The shipped TOML files of a folder."""
    there = files("configs").joinpath(*folder).iterdir()
    named = sorted((e for e in there if e.name.endswith(".toml")), key=lambda e: e.name)
    return [entry.read_bytes() for entry in named]


def _rig() -> Target:
    run = _file(".toml", lambda p: load_rig(str(p)))
    corpus = [*map(_shipped, RIGS)]
    return Target("rig file", "a bench in TOML", run, corpus, LINK, KEYS, change=change_toml)


def _protocol() -> Target:
    """A protocol file read as each protocol in turn."""
    rigs = [load_rig(name) for name in ("virtual-instruments", "virtual-ram")]
    kinds = [procedure(name) for name in PROTOCOLS]

    def read(path: Path) -> None:
        for rig in rigs:
            for kind in kinds:
                with contextlib.suppress(PamrigError):
                    kind.read(str(path), rig).as_dict()

    run = _file(".toml", read)
    return Target("protocol file", "a test in TOML", run, _text("protocols"), LINK, KEYS,
                  change=change_toml)  # fmt: skip


def _plant_files() -> Target:
    """Arms, fingers, valves, constants, scenarios and instruments, each read as every kind."""
    readers: tuple[Callable[[str], object], ...] = (
        load_arm, load_finger, load_valve, load_constants, load_scenario, load_form,
        load_command_form, lambda p: load_plant(Path(p)),
    )  # fmt: skip

    def read(path: Path) -> None:
        for reader in readers:
            with contextlib.suppress(PamrigError, PlantError):
                reader(str(path))

    folders = (("plant", "links"), ("plant", "fingers"), ("plant", "valves"), ("plant",))
    corpus = [data for folder in (*folders, ("scenarios",), ("instruments",))
              for data in _text(*folder)]  # fmt: skip
    return Target("plant files", "arms, valves, scenarios, instruments", _file(".toml", read),
                  corpus, LINK, KEYS, change=change_toml)  # fmt: skip


def _toml() -> Target:
    corpus = [_shipped(name) for name in (*RIGS, "protocols/isometric-short")]
    run = _file(".toml", lambda p: load_toml(str(p), "rigs"))
    return Target("TOML", "any TOML file", run, corpus, LINK, KEYS, change=change_toml)


def _model() -> Target:
    folder = files("configs").joinpath("plant", "models")
    names = sorted(e.name for e in folder.iterdir() if e.name.endswith(".toml"))[:4]
    corpus = [folder.joinpath(name).read_bytes() for name in names]
    return Target("model file", "a fitted law in TOML", _file(".toml", load_model), corpus,
                  (PlantError,), KEYS, change=change_toml)  # fmt: skip


# ---- records -----------------------------------------------------------------------------


CAMERA = {
    "region": [0, 0, 60, 40],
    "sync": {"patch": [50, 0, 5, 5]},
    "lens": {"centre_x": 30.0, "centre_y": 20.0, "radius": 36.0, "k1": 0.01},
}
CALIBRATIONS = {
    name: Calibration(name, "u", "raw", 0.0, 1.0, 0.1, 0.001, (0.0, 1000.0), "C-1")
    for name in ("pressure_kpa", "length_mm", "force_n")
}


def _record(folder: Path, ended: bool) -> Path:
    manifest = {"protocol": "isometric", "specimen": "m", "camera": CAMERA,
                "calibrations": {k: c.to_dict() for k, c in CALIBRATIONS.items()}}  # fmt: skip
    record = RecordWriter(folder, manifest, VirtualClock(), durable=False, threaded=False)
    record.stream("valve", {"seq": "int64", "counts": "uint16"})

    def rows(first: int) -> dict[str, np.ndarray]:
        numbers = np.arange(first, first + 20)
        return {"seq": numbers, "counts": numbers.astype(np.uint16)}

    for k in range(2):
        record.append("valve", rows(20 * k))
    record.event("state", state="first")
    record.event("point", order=1, trial=1, slot="a", mounting="m", replicate=1, direction="up",
                 settled=True, valve_seq=[0, 40], balance_rows=[0, 0], frames=[0])  # fmt: skip
    record.frame(_pictures()[0], 1)
    record.wire("valve", 1, b"bytes")
    if ended:
        record.finalize("clean")
        derive(open_run(record.folder))
        annotate(record.folder, "exclude", [1], "a leak")
    else:
        record.write_ahead("valve", rows(40))
        record.abandon()
    return record.folder


LINES = ("events.jsonl", "samples/valve.index.jsonl", "frames.jsonl", "wire/valve.index.jsonl")
OWN = ("annotations.jsonl", "annotations.seal", "derived/manifest.json")
ENDED = ("run.json", "final.json", *LINES, *OWN, "samples/valve/000001.arrows")
KILLED = ("run.json", *LINES[:2], "samples/valve/000001.arrows", "samples/valve.ahead",
          "written.map")  # fmt: skip


def _folder(name: str, names: Sequence[str], ended: bool) -> Target:
    """A run folder one of whose files is an input; its first byte says which."""
    folder = _record(Path(tempfile.mkdtemp(prefix="fuzz")), ended)
    sound = {name: (folder / name).read_bytes() for name in names}
    sums = set(json.loads(sound["final.json"])["files"]) if ended else set()
    looks: tuple[Callable[[Run], object], ...] = (
        reduce_run, lambda r: r.samples("valve"), lambda r: measured_edges(r)(r.frame_bytes(0)),
        report_json, tables_of, lambda r: r.table,
    )  # fmt: skip

    def run(data: bytes) -> None:
        name = names[data[0] % len(names) if data else 0]
        path = folder / name
        path.write_bytes(data[1:])
        try:
            if ended and name in sums:
                seal_anew(folder)
            elif not ended and name != "written.map":
                map_anew(folder)
            strange = open_run(folder)
            verify(strange)
            run_info(strange)
            with contextlib.suppress(PamrigError):
                show(strange)
            for look in looks:
                try:
                    look(strange)
                except PamrigError:
                    continue
        finally:
            for changed in {name, "final.json" if ended else "written.map"}:
                (folder / changed).write_bytes(sound[changed])

    def seal(data: bytes) -> bytes:
        if not data:
            return data
        name, body = names[data[0] % len(names)], data[1:]
        if name.endswith(".jsonl"):
            lines = [_line(line) for line in body.split(b"\n") if line]
            return data[:1] + b"".join(lines)
        at = body.rfind(b',\n  "crc"')
        if name.endswith((".json", ".seal")) and at > 0:
            return data[:1] + body[:at] + b',\n  "crc": "%08x"\n}\n' % zlib.crc32(body[:at])
        if name.endswith(".ahead") and len(body) > 8:
            begin, end = 512 + 8, 512 + 20 + 20 * 10  # an entry of 20 rows of ten bytes
            crc = zlib.crc32(body[begin:end]).to_bytes(4, "little")
            return data[:1] + body[:512] + b"PAhd%b" % crc + body[begin:]
        return data

    def change(data: bytes, rng: random.Random) -> bytes:
        """Members of a sealed file or line replaced, and sealed again."""
        if not data:
            return data
        name, body = names[data[0] % len(names)], data[1:]
        try:
            if name.endswith(".jsonl"):
                lines = body.split(b"\n")[:-1]
                at = rng.randrange(len(lines))
                fields = json.loads(lines[at])
                fields.pop("crc", None)
                lines[at] = _sealed_line(change_json(fields, rng))[:-1]
                return data[:1] + b"\n".join(lines) + b"\n"
            if name.endswith((".json", ".seal")):
                fields = json.loads(body)
                fields.pop("crc", None)
                return data[:1] + _sealed_file(change_json(fields, rng))
        except (ValueError, TypeError, RecursionError, AttributeError, IndexError):
            pass  # no JSON object
        return seal(data)

    corpus = [bytes([k]) + sound[name] for k, name in enumerate(names)]
    words = (b"[[[[", b'"n":', b'"file":"../x"', b'"rows":', b"{}", b"null", b'"offset":-1', b"1e9")
    return Target(name, "a record, " + ("ended" if ended else "broken off"), run, corpus, LINK,
                  words, seal, change)  # fmt: skip


def _sealed_line(fields: dict[str, Any]) -> bytes:
    body = json.dumps(fields, separators=(",", ":"), default=str)[:-1].encode()
    return b'%s,"crc":"%08x"}\n' % (body, zlib.crc32(body))


def _sealed_file(fields: dict[str, Any]) -> bytes:
    body = json.dumps(fields, indent=2, default=str).removesuffix("\n}").encode()
    return b'%s,\n  "crc": "%08x"\n}\n' % (body, zlib.crc32(body))


def _line(line: bytes) -> bytes:
    try:
        fields = json.loads(line)
        fields.pop("crc", None)
        return seal_line(fields)
    except (ValueError, TypeError, AttributeError, RecursionError):
        at = line.rfind(b',"crc"')
        body = line[:at] if at > 0 else line
        return b'%s,"crc":"%08x"}\n' % (body, zlib.crc32(body))


# ---- data sets and pictures ----------------------------------------------------------------

DATASET = {
    "trials.csv": b"trial,slot,replicate,protocol,mounting,order,held_length_mm,load_kg,"
    b"temperature_c,start_s\nt1,a,1,isometric,m1,1,60,,21,0\nt2,a,2,isometric,m1,2,60,,21,9\n",
    "bench.toml": b"supply_kpa = 700\n[effects.creep]\nrelaxation_percent = 4.0\n",
    "samples.csv": b"trial,time_s,inlet_cmd,outlet_cmd,pressure_kpa,force_n,length_mm\n"
    + b"".join(b"t%d,%d.5,1,0,%d,%d.25,60\n" % (1 + k // 4, k % 4, k, k) for k in range(8)),
}


def _exchange() -> Target:
    """A data set one of whose files is an input; its first byte says which, and of which form."""
    place = Path(tempfile.mkdtemp(prefix="fuzz"))
    csv, parquet = place / "csv", place / "parquet"
    for folder in (csv, parquet):
        folder.mkdir()
        for name, data in DATASET.items():
            (folder / name).write_bytes(data)
    pd.read_csv(csv / "samples.csv").to_parquet(parquet / "samples.parquet")
    (parquet / "samples.csv").unlink()
    paths = [*(csv / name for name in DATASET), parquet / "samples.parquet"]
    sound = {path: path.read_bytes() for path in paths}

    def run(data: bytes) -> None:
        path = paths[data[0] % len(paths) if data else 0]
        path.write_bytes(data[1:])
        try:
            read_dataset(path.parent)
        finally:
            path.write_bytes(sound[path])

    corpus = [bytes([k]) + sound[path] for k, path in enumerate(paths)]
    words = (b",", b"\n", b'"', b"pressure_bar", b"1e308", b"inf", b"t1", b"up", b"=", b"[",
             b"1e-300", b"\xed\xa0\x80")  # fmt: skip

    def change(data: bytes, rng: random.Random) -> bytes:
        path = paths[data[0] % len(paths)] if data else csv
        if path.suffix == ".toml":
            return data[:1] + change_toml(data[1:], rng)
        return data[:1] + change_csv(data[1:], rng) if path.suffix == ".csv" else data

    return Target("dataset folder", "a data set, CSV and Parquet", run, corpus, LINK, words,
                  change=change)  # fmt: skip


def _pictures() -> list[bytes]:
    gray = np.full((40, 60), 180, np.uint8)
    gray[5:35, 10:20] = 40
    gray[5:35, 50:60] = 40
    kinds = (".jpg", ".png", ".pgm", ".bmp", ".tif")
    return [cv2.imencode(kind, gray)[1].tobytes() for kind in kinds]


def _picture() -> Target:
    def run(data: bytes) -> None:
        gray = decode(data)
        if gray is not None:
            measure_stored(gray, {})

    words = (b"\xff\xd8", b"\xff\xc0", b"IHDR", b"P5")
    return Target("picture", "a stored picture, measured", run, _pictures(), (), words)


def _picture_file() -> Target:
    run = _file(".tif", lambda p: list(open_frames(p)))
    words = (b"II*\0", b"MM\0*")
    return Target("picture file", "a picture or stack of others", run, _pictures(), LINK, words)


TARGETS: dict[str, Callable[[], Target]] = {
    "TOML": _toml,
    "rig file": _rig,
    "model file": _model,
    "protocol file": _protocol,
    "plant files": _plant_files,
    "run folder": lambda: _folder("run folder", ENDED, True),
    "killed run": lambda: _folder("killed run", KILLED, False),
    "dataset folder": _exchange,
    "picture": _picture,
    "picture file": _picture_file,
}
