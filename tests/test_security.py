"""Files of strangers: they run nothing, write nowhere else, and cannot fill the memory.

The seals of a record are sums, not signatures: whoever makes a record can seal what he likes. So
each of these folders is sealed anew after it was tampered with.
"""

from __future__ import annotations

import ast
import contextlib
import json
import os
import re
import resource
import shutil
import socket
import sqlite3
import struct
import subprocess
import sys
import time
import tomllib
import tracemalloc
import zlib
from collections.abc import Callable, Iterator
from importlib.resources import files
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd
import psutil
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import typer
from typer.testing import CliRunner

import daq.store.tablefile
from analysis.formats.importer import import_points
from analysis.layouts.layouts import measured_edges
from analysis.reduction.pictures import measure_stored
from analysis.reporting.derived import derive_all
from analysis.run_table import reduce_run
from bench_runs import run_bench
from cli.main import app, main
from cli.model.links import links
from cli.output import plain_output
from cli.protocols.plan import load_plan, progress
from conftest import PACKAGES
from daq.clock import VirtualClock
from daq.errors import ConfigError, PamrigError, RecordError
from daq.record.sealed import SealError, open_line, seal_file, seal_line, seal_text
from daq.record.segments import _compressed
from daq.record.writer import RecordWriter
from daq.store.annotations import annotate
from daq.store.derive import derive
from daq.store.index import index_path, rebuild_index
from daq.store.run import Run, open_run
from daq.store.store import list_runs, show
from daq.store.tablefile import read_parquet
from daq.store.verify import verify
from fuzz.structure import replaced, toml
from fuzz.sums import seal_anew
from gap.data.reader import read_dataset
from gap.errors import GapError
from plant.constants import load_constants
from plant.errors import LinkError, PlantError
from plant.finger.reader import load_finger
from plant.links.reader import load_arm
from plant.links.symbolic.generated import GeneratedDynamics, generated
from plant.models.catalogue import load as load_model
from rigs.calibration.frames import open_frames
from rigs.rigfile.camera_calibration import load_camera_calibration
from rigs.rigfile.command_form import load_command_form
from rigs.rigfile.config import load_rig
from rigs.rigfile.toml_reader import load_toml
from rigs.virtual.server import open_server
from rigs.virtual.withheld.bench import ENVELOPE, request_answer
from vision.marker.preview import draw

HOUSE = Path(__file__).parent.parent
SECONDS = 20.0
MORE_MB = 300.0


@pytest.fixture(autouse=True)
def bounded() -> Iterator[None]:
    """Nothing here may take long or much memory."""
    start, before = time.process_time(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    yield
    assert time.process_time() - start < SECONDS
    unit = 1.0 if sys.platform == "darwin" else 1024.0
    assert (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * unit < MORE_MB * 1e6


@pytest.fixture
def run(tmp_path: Path) -> Run:
    """A small sound record."""
    record = RecordWriter(
        tmp_path / "runs", {"protocol": "isometric", "specimen": "m"}, VirtualClock(),
        durable=False, threaded=False,
    )  # fmt: skip
    record.stream("valve", {"seq": "int64", "counts": "uint16"})
    for k in range(3):
        rows = np.arange(50 * k, 50 * k + 50)
        record.append("valve", {"seq": rows, "counts": rows.astype(np.uint16)})
    record.event("state", state="first")
    record.frame(b"no picture", 1)
    record.finalize("clean")
    return open_run(record.folder)


def again(run: Run) -> Run:
    """The run as a newcomer reads it."""
    return open_run(run.folder)


OWN_SUMS = ("annotations.jsonl", "derived/manifest.json")
"""Not listed in final.json, which is older than they are."""


def tamper(run: Run, name: str, change: Callable[[dict[str, Any]], object]) -> Run:
    """Change each line of a file of lines, or a sealed file, and seal it anew."""
    path = run.folder / name
    if name.endswith(".jsonl"):
        out = b""
        for line in path.read_bytes().splitlines():
            fields = {k: v for k, v in json.loads(line).items() if k != "crc"}
            change(fields)
            out += seal_line(fields)
    else:
        fields = {k: v for k, v in json.loads(path.read_bytes()).items() if k != "crc"}
        change(fields)
        out = seal_file(fields)
    path.write_bytes(out)
    if name not in ("final.json", *OWN_SUMS):
        with contextlib.suppress(ValueError, KeyError, RecordError):
            seal_anew(run.folder)
    return again(run)


INDEX = "samples/valve.index.jsonl"


@pytest.mark.parametrize("name", ["/dev/zero", "../../../secret", "a/../../../secret", "link"])
def test_a_record_names_no_file_outside_itself(run: Run, tmp_path: Path, name: str) -> None:
    """`/dev/zero` was read until the memory was full."""
    secret = tmp_path / "secret"
    secret.write_bytes((run.folder / "samples/valve/000001.arrows").read_bytes())
    (run.folder / "link").symlink_to(secret)

    def elsewhere(fields: dict[str, Any]) -> None:
        if "file" in fields:
            fields["file"] = name

    strange = tamper(run, INDEX, elsewhere)
    assert len(strange.samples("valve")["seq"]) == 0
    assert any("outside" in p.what or "link" in p.what for p in verify(strange))
    strange = tamper(strange, "frames.jsonl", elsewhere)
    with pytest.raises(RecordError, match=r"outside|link"):
        strange.frame_bytes(0)


def test_a_small_file_is_read_into_little_memory(run: Run) -> None:
    """Two gigabytes were set aside for each segment, however small: what a reader may take."""
    other = tamper(run, "frames.jsonl", lambda f: f.update(length=2**31) if "length" in f else None)
    picture = run.folder / "strange.png"
    picture.write_bytes(b"no picture")
    tracemalloc.start()
    try:
        verify(other)
        assert len(run.samples("valve")["seq"]) == 150
        with pytest.raises(RecordError, match="CRC"):
            other.frame_bytes(0)
        with pytest.raises(PamrigError):
            list(open_frames(picture))
        assert tracemalloc.get_traced_memory()[1] < 5e7
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("name", ["events.jsonl", "final.json", INDEX, "derived/manifest.json"])
@pytest.mark.parametrize("kind", ["device", "pipe", "sparse"])
def test_a_file_without_end_is_not_read(run: Run, name: str, kind: str) -> None:
    path = run.folder / name
    path.parent.mkdir(exist_ok=True)
    path.unlink(missing_ok=True)
    if kind == "device":
        path.symlink_to("/dev/zero")
    elif kind == "pipe":
        os.mkfifo(path)
    else:
        with open(path, "wb") as file:
            file.truncate(1 << 40)
    said = []
    for look in (show, verify):
        try:
            found = look(again(run))
            said += [str(p) for p in (found["problems"] if isinstance(found, dict) else found)]
        except RecordError as error:
            said.append(str(error))
    words = r"regular file|bytes, the limit|link|no stream|missing|does not match its CRC"
    assert re.search(words, "; ".join(said)), said


def test_rows_that_its_bytes_cannot_hold_are_not_set_aside(run: Run) -> None:
    """A line of a hundred bytes claimed 10^15 rows, and so much memory was asked for."""

    def claim(fields: dict[str, Any]) -> None:
        if fields.get("chunk") == "rows" and fields["first_row"] == 50:
            fields["rows"] = 10**15

    strange = tamper(run, INDEX, claim)
    assert list(strange.samples("valve")["seq"][[0, -1]]) == [0, 149]
    assert len(strange.samples("valve")["seq"]) == 100
    assert any("claims" in p.what for p in verify(strange))
    tamper(run, "final.json", lambda fields: fields["rows"].update(valve=10**18))
    assert len(again(run).samples("valve")["seq"]) == 100


@pytest.mark.parametrize("member", ["first_row", "rows"])
def test_a_chunk_of_rows_that_does_not_say_which_is_not_read(run: Run, member: str) -> None:
    """Found by fuzzing: `runs verify` ended in a KeyError."""
    strange = tamper(run, INDEX, lambda f: f.pop(member, None) if f.get("first_row") else None)
    assert any("claims" in p.what for p in verify(strange))
    assert again(run).samples("valve")["seq"].tolist() == list(range(50))


def test_a_chunk_counts_once(run: Run) -> None:
    """Ten thousand lines upon one chunk stood for ten thousand times its rows."""
    path = run.folder / INDEX
    lines = [json.loads(line) for line in path.read_bytes().splitlines()]
    rows = next(line for line in lines if line.get("chunk") == "rows")
    out = path.read_bytes()
    for n in range(len(lines), len(lines) + 10_000):
        out += seal_line({**{k: v for k, v in rows.items() if k != "crc"}, "n": n})
    path.write_bytes(out)
    seal_anew(run.folder)
    assert len(again(run).samples("valve")["seq"]) == 150
    assert any("overlaps" in p.what for p in verify(again(run)))


@pytest.mark.parametrize(
    "columns", [{"seq": "O"}, {"seq": "(100000000,)i8"}, "seq", {"seq": 1}, None, {"seq": "S9"}]
)
def test_columns_are_numbers_or_nothing(run: Run, columns: object) -> None:
    strange = tamper(run, INDEX, lambda f: f.update(columns=columns) if "stream" in f else None)
    with pytest.raises(RecordError, match="columns"):
        strange.samples("valve")


NONSENSE: tuple[Any, ...] = (7, None, [1], "words", {"deep": {"er": 1}}, True, 10**400, "../..")
if not os.environ.get("PAMRIG_CAMPAIGN"):
    NONSENSE = NONSENSE[:2]


def _first_frame(run: Run) -> bytes:
    return run.frame_bytes(0)


def _all_runs(run: Run) -> list[Any]:
    return list_runs(run.folder.parent)


@pytest.mark.parametrize("value", NONSENSE, ids=range(len(NONSENSE)))
def test_nonsense_under_a_seal_is_an_error_and_no_traceback(run: Run, value: object) -> None:
    """Whatever member of whatever file it stands in."""
    for name in ("run.json", "final.json", "events.jsonl", INDEX, "frames.jsonl"):
        text = (run.folder / name).read_bytes()
        lines = text.splitlines() if name.endswith("l") else [text]
        for key in {k for line in lines for k in json.loads(line)} - {"crc"}:
            strange = tamper(run, name, lambda f, key=key: f.update({key: value}))
            looks = (verify, show, reduce_run, _first_frame, _all_runs)
            for look in looks:
                try:
                    look(again(strange))
                except PamrigError:
                    pass
                except Exception as error:
                    pytest.fail(f"{name}: {key} = {value!r}: {error!r}")
            (run.folder / name).write_bytes(text)


def test_json_nested_without_end_is_damage(run: Run) -> None:
    deep = b'{"a":' + b"[" * 200_000 + b"]" * 200_000
    (run.folder / "events.jsonl").write_bytes(deep + b',"crc":"%08x"}\n' % zlib.crc32(deep))
    assert again(run).events == []
    body = b'{\n  "a": ' + b"[" * 200_000 + b"]" * 200_000
    (run.folder / "run.json").write_bytes(body + b',\n  "crc": "%08x"\n}\n' % zlib.crc32(body))
    with pytest.raises(RecordError):
        _ = again(run).manifest


@pytest.mark.parametrize("target", ["there", "not there"])
def test_a_remark_is_not_written_through_a_link(run: Run, tmp_path: Path, target: str) -> None:
    elsewhere = tmp_path / "elsewhere"
    if target == "there":
        elsewhere.write_bytes(b"")
    (run.folder / "annotations.jsonl").symlink_to(elsewhere)
    with pytest.raises(RecordError, match="link"):
        annotate(run.folder, "note", [], "hello")
    assert not elsewhere.exists() or elsewhere.read_bytes() == b""


@pytest.mark.parametrize("name", ["derived", "derived.partial"])
def test_what_is_derived_is_not_written_through_a_link(run: Run, tmp_path: Path, name: str) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "kept").write_text("mine")
    (run.folder / name).symlink_to(elsewhere)
    with pytest.raises(RecordError):
        derive(run)
    assert [p.name for p in elsewhere.iterdir()] == ["kept"]


@pytest.mark.parametrize("other", ["itself", "/etc", "..", ".", "../runs/x", ""])
def test_a_run_continues_no_stranger_and_not_itself(run: Run, other: str) -> None:
    """One that continued itself ended in a RecursionError."""
    name = run.run_id if other == "itself" else other
    continues = {"run_id": name, "trials": [1], "trial": 2, "joined": True}
    strange = tamper(run, "run.json", lambda fields: fields.update(continues=continues))
    with pytest.raises(RecordError, match=r"itself|not in the same folder"):
        reduce_run(strange)


@pytest.mark.parametrize("how", ["view", "trigger", "link"])
def test_an_index_of_a_stranger_runs_no_query_of_its_own(
    run: Run, tmp_path: Path, how: str
) -> None:
    """A view that counts without end was counted."""
    root = run.folder.parent
    plain = list_runs(root)
    rebuild_index(root)
    path = index_path(root)
    if how == "link":
        path.rename(tmp_path / "elsewhere.sqlite")
        path.symlink_to(tmp_path / "elsewhere.sqlite")
        before = (tmp_path / "elsewhere.sqlite").read_bytes()
        annotate(run.folder, "note", [], "changed since")
    else:
        with sqlite3.connect(path) as db:
            names = [row[1] for row in db.execute("PRAGMA table_info(runs)")]
            if how == "view":
                db.execute("ALTER TABLE runs RENAME TO kept")
                count = "WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x+1 FROM c) "
                columns = ", ".join(f"x AS {name}" for name in names)
                db.execute(f"CREATE VIEW runs AS {count} SELECT {columns} FROM c")
            else:
                db.execute("CREATE TABLE other (x)")
                db.execute("CREATE TRIGGER t AFTER INSERT ON runs BEGIN DELETE FROM other; END")
        db.close()
    assert list_runs(root) == plain
    if how == "link":
        assert (tmp_path / "elsewhere.sqlite").read_bytes() == before


# ---- TOML ------------------------------------------------------------------------------

BOMBS = {
    "deep lists": "a = " + "[" * 100_000 + "]" * 100_000,
    "deep tables": "a = " + "{b = " * 5000 + "1" + "}" * 5000,
    "deep keys": ".".join(["a"] * 100_000) + " = 1",
    "deep heads": "[" + ".".join(["a"] * 100_000) + "]",
    "forty deep": ".".join(["a"] * 40) + " = 1",
    "long number": "a = " + "9" * 5000,
    "large number": "a = " + "9" * 400,
    "strange date": "a = 2026-02-31",
    "zero": "\0" * 1000,
    "huge": "a = 1\n#" + " " * (5 << 20),
}
READERS: dict[str, tuple[Callable[[Path], object], type[Exception]]] = {
    "rig": (lambda p: load_rig(str(p)), PamrigError),
    "protocol": (lambda p: load_toml(str(p), "protocols"), PamrigError),
    "plant": (load_constants, PlantError),
    "model": (load_model, PlantError),
    "arm": (load_arm, Exception),
    "finger": (lambda p: load_finger(str(p)), PlantError),
    "camera": (load_camera_calibration, PamrigError),
}


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("bomb", BOMBS)
def test_a_toml_file_of_a_stranger_is_refused_in_words(
    tmp_path: Path, reader: str, bomb: str
) -> None:
    """Deep ones ended in a RecursionError, long keys and numbers in minutes or a ValueError."""
    read, error = READERS[reader]
    path = tmp_path / "strange.toml"
    path.write_text(BOMBS[bomb])
    with pytest.raises(error) as caught:
        read(path)
    assert not isinstance(caught.value, (RecursionError, MemoryError))
    assert "strange" in str(caught.value)


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("name", ["x" * 300, "x" * 5000, "a\0b"], ids=["long", "endless", "zero"])
def test_a_name_that_no_file_can_have_is_refused_in_words(reader: str, name: str) -> None:
    """Found by fuzzing, in a rig file's `form`: it ended in an OSError."""
    read, error = READERS[reader]
    with pytest.raises(error) as caught:
        read(Path(name))
    assert isinstance(caught.value, PamrigError | PlantError)


@pytest.mark.parametrize("reader", READERS)
def test_a_pipe_is_no_toml_file(tmp_path: Path, reader: str) -> None:
    """It was waited for without end."""
    read, error = READERS[reader]
    os.mkfifo(tmp_path / "strange.toml")
    with pytest.raises(error, match="regular file"):
        read(tmp_path / "strange.toml")


# ---- tables, pictures, notes -------------------------------------------------------------


def exchange(folder: Path) -> Path:
    (folder / "trials.csv").write_text("trial,slot\nt1,a\n")
    return folder


def test_a_csv_with_a_hundred_thousand_columns_is_refused(tmp_path: Path) -> None:
    """Its names were compared each with each."""
    names = ",".join(f"c{k}" for k in range(100_000))
    (exchange(tmp_path) / "samples.csv").write_text(f"trial,{names}\n")
    with pytest.raises(GapError, match="columns"):
        read_dataset(tmp_path)
    with pytest.raises(PamrigError, match="columns"):
        import_points(str(tmp_path / "samples.csv"), tmp_path / "runs", VirtualClock())


@pytest.mark.parametrize("kind", ["cells", "words", "nested", "garbage"])
def test_a_parquet_file_that_stands_for_more_than_it_holds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    path = exchange(tmp_path) / "samples.parquet"
    monkeypatch.setattr(daq.store.tablefile, "MOST_CELLS", 1_000_000)
    monkeypatch.setattr(daq.store.tablefile, "MOST_TEXT", 1_000_000)
    if kind == "cells":
        frame = pd.DataFrame({"trial": "t1", "time_s": np.zeros(1_000_000)})
    elif kind == "words":
        word = pa.DictionaryArray.from_arrays(np.zeros(10_000, np.int32), ["x" * 2_000_000])
        pq.write_table(pa.table({"trial": word}), path, dictionary_pagesize_limit=1 << 30)
    else:
        frame = pd.DataFrame({"trial": ["t1"], "time_s": [[1.0, 2.0]]})
    if kind != "words":
        frame.to_parquet(path)
    if kind == "garbage":
        path.write_bytes(path.read_bytes()[:-8] + b"\xff\xff\xff\x7fPAR1")
    with pytest.raises(GapError, match=r"samples\.parquet"):
        read_dataset(tmp_path)


def test_a_parquet_file_of_a_bench_is_read_as_it_is(tmp_path: Path) -> None:
    frame = pd.DataFrame(
        {"trial": ["t1", "t2", None], "n": [1, 2, 3], "x": [1.5, np.nan, 3.0], "on": [True] * 3}
    )
    frame.to_parquet(tmp_path / "a.parquet")
    back = read_parquet(tmp_path / "a.parquet")
    assert back["trial"].iloc[:2].tolist() == ["t1", "t2"]
    assert back["trial"].isna().tolist() == [False, False, True]
    pd.testing.assert_frame_equal(back.drop(columns="trial"), frame.drop(columns="trial"))


def test_a_record_whose_columns_are_said_by_a_batch_is_told(run: Run) -> None:
    """Sealed, and without the line that says it otherwise: pyarrow's own error came out."""
    path = run.folder / "samples" / "valve.index.jsonl"
    lines = [json.loads(line) for line in path.read_bytes().splitlines()]
    rows = next(line for line in lines if line.get("chunk") == "rows")
    fields = {**{k: v for k, v in rows.items() if k != "crc"}, "chunk": "schema"}
    path.write_bytes(b"{}\n" + seal_line(fields))
    seal_anew(run.folder)
    with pytest.raises(RecordError, match="description of its columns"):
        again(run).schema("valve")


def png(width: int, height: int, depth: int = 8, kind: int = 0, frames: int = 1) -> bytes:
    def part(kind: bytes, data: bytes) -> bytes:
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    head = struct.pack(">IIBBBBB", width, height, depth, kind, 0, 0, 0)
    out = b"\x89PNG\r\n\x1a\n" + part(b"IHDR", head)
    if frames > 1:
        out += part(b"acTL", struct.pack(">II", frames, 0))
        out += part(b"fcTL", struct.pack(">IIIIIHHBB", 0, width, height, 0, 0, 1, 10, 0, 0))
        rows = nothing(height * (1 + width * depth // 8 * (4 if kind else 1)))
        return out + part(b"IDAT", rows) + part(b"IEND", b"")
    return out + part(b"IDAT", nothing(999)) + part(b"IEND", b"")


def nothing(size: int) -> bytes:
    """So many zero bytes, packed, without them ever being there."""
    packer = zlib.compressobj(1)
    packed = [packer.compress(bytes(1 << 20)) for _ in range(size >> 20)]
    return b"".join([*packed, packer.compress(bytes(size % (1 << 20))), packer.flush()])


def tiff(pages: list[tuple[tuple[int, int], bytes]], order: str = "<", big: bool = False) -> bytes:
    """Pages of grey tiles, 8 bits: size of the tile, and its bytes packed with zlib."""
    out = (b"II" if order == "<" else b"MM") + struct.pack(order + "H", 43 if big else 42)
    out += struct.pack(order + "HHQ", 8, 0, 16) if big else struct.pack(order + "I", 8)
    for k, ((width, height), data) in enumerate(pages):
        tags = [(256, 48), (257, 32), (258, 8), (259, 8), (262, 1), (277, 1), (322, width),
                (323, height), (324, 0), (325, len(data))]  # fmt: skip
        head = struct.pack(order + ("Q" if big else "H"), len(tags))
        size = len(head) + len(tags) * (20 if big else 12) + (8 if big else 4)
        for tag, value in tags:
            value = len(out) + size if tag == 324 else value
            form = "HHQIxxxx" if big else "HHII"  # a LONG, at the front of what holds it
            head += struct.pack(order + form, tag, 4, 1, value)
        last = k == len(pages) - 1
        head += struct.pack(
            order + ("Q" if big else "I"), 0 if last else len(out) + size + len(data)
        )
        out += head + data
    return out


PICTURES = """
import resource, sys
from pathlib import Path
from rigs.calibration.frames import open_frames
from analysis.reduction.pictures import decode
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
for path in sorted(Path(sys.argv[1]).iterdir()):
    assert decode(path.read_bytes()) is None, path
for frame in open_frames(sys.argv[1]):
    assert frame.image is None and frame.problem, frame
print((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024)
"""


def strangers_pictures(folder: Path) -> float:
    """Megabytes laid out for pictures that are none. In a process: OpenCV is told before."""
    done = subprocess.run(
        [sys.executable, "-c", PICTURES, str(folder)],
        capture_output=True, text=True, check=False, timeout=900,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return float(done.stdout)


def test_a_picture_that_claims_billions_of_pixels_is_none(tmp_path: Path) -> None:
    """A hundred bytes had gigabytes laid out."""
    side = 32_000  # OpenCV's own bound would let a gigapixel pass
    (tmp_path / "a.png").write_bytes(png(side, side))
    (tmp_path / "b.pgm").write_bytes(b"P5 %d %d 255\n" % (side, side) + b"\0" * 100)
    jpeg = b"\xff\xd8\xff\xc0\x00\x0b\x08" + struct.pack(">HH", side, side) + b"\x01\x01\x11\x00"
    (tmp_path / "c.jpg").write_bytes(
        jpeg + b"\xff\xda\x00\x08\x01\x01\x00\x00\x3f\x00" + b"\0" * 99
    )
    assert strangers_pictures(tmp_path) < MORE_MB


@pytest.mark.parametrize("kind", ["animated", "chunk", "tile", "twenty bytes a pixel"])
def test_a_picture_that_takes_more_than_its_pixels_is_none(tmp_path: Path, kind: str) -> None:
    """Within what may be claimed, several times its pixels were laid out."""
    if kind == "animated":
        (tmp_path / "a.png").write_bytes(png(4_900, 5_000, 16, 6, frames=3))
    elif kind == "chunk":
        data = bytearray(cv2.imencode(".png", np.zeros((40, 60), np.uint8))[1].tobytes())
        struct.pack_into(">I", data, data.index(b"IDAT") - 4, 2_000_000_000)
        (tmp_path / "a.png").write_bytes(data)
    elif kind == "tile":
        (tmp_path / "a.tif").write_bytes(tiff([((16_384, 8_192), nothing(16_384 * 8_192))]))
    else:
        ok, data = cv2.imencode(".jp2", np.zeros((2_000, 2_000, 3), np.uint8))
        assert ok
        (tmp_path / "a.png").write_bytes(data.tobytes())  # OpenCV goes by what is in it
    assert strangers_pictures(tmp_path) < 50.0


@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("big", [False, True])
def test_a_page_of_a_stack_is_read_alone(tmp_path: Path, order: str, big: bool) -> None:
    """Each page was found by counting all of them: ten thousand took hours."""
    pages = [((48, 32), zlib.compress(bytes([k]) * 48 * 32)) for k in range(5)]
    pages[3] = ((16_384, 24_576), b"")
    (tmp_path / "a.tif").write_bytes(tiff(pages, order, big))
    frames = list(open_frames(tmp_path / "a.tif"))
    assert [frame.frame for frame in frames] == [0, 1, 2, 3, 4]
    assert "million pixels" in frames.pop(3).problem
    for frame in frames:
        assert frame.image is not None
        assert frame.image.shape == (32, 48)
        assert (frame.image == frame.frame).all()


def test_a_stack_whose_pages_go_round_ends(tmp_path: Path) -> None:
    stack = bytearray(tiff([((48, 32), nothing(48 * 32))] * 2))
    second = struct.unpack_from("<I", stack, 8 + 2 + 10 * 12)[0]
    struct.pack_into("<I", stack, second + 2 + 10 * 12, 8)
    (tmp_path / "a.tif").write_bytes(stack)
    assert len(list(open_frames(tmp_path / "a.tif"))) == 2


def test_a_stack_whose_pages_lie_beyond_any_file_is_no_picture(tmp_path: Path) -> None:
    stack = bytearray(tiff([((48, 32), nothing(48 * 32))], big=True))
    struct.pack_into("<Q", stack, 8, (1 << 64) - 8)
    (tmp_path / "a.tif").write_bytes(stack)
    with pytest.raises(PamrigError, match="not a picture"):
        list(open_frames(tmp_path / "a.tif"))


def test_thousands_of_pages_take_seconds(tmp_path: Path) -> None:
    (tmp_path / "a.tif").write_bytes(tiff([((48, 32), nothing(48 * 32))] * 2_000))
    start = time.process_time()
    assert sum(frame.image is not None for frame in open_frames(tmp_path / "a.tif")) == 2_000
    assert time.process_time() - start < 10.0


def test_a_picture_too_large_says_so_with_its_name_and_how_it_is_read(tmp_path: Path) -> None:
    (tmp_path / "claim.png").write_bytes(png(8_000, 8_000))
    video = cv2.VideoWriter(
        str(tmp_path / "film.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 9, (5_200, 5_000), False
    )
    video.write(np.zeros((5_000, 5_200), np.uint8))
    video.release()
    for name in ("claim.png", "film.avi"):
        done = subprocess.run(
            [sys.executable, "-m", "cli.main", "length", str(tmp_path / name)],
            capture_output=True, text=True, check=False, timeout=900,
        )  # fmt: skip
        assert done.returncode == 2
        assert name in done.stderr
        assert "OPENCV_IO_MAX_IMAGE_PIXELS" in done.stderr


def test_drawing_a_large_picture_lays_out_what_is_seen(tmp_path: Path) -> None:
    """Forty bytes a pixel were laid out."""
    draw(tmp_path / "small.png", np.zeros((100, 100), np.uint8))
    tracemalloc.start()
    draw(tmp_path / "large.png", np.zeros((5_000, 5_000), np.uint8))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 150e6


def test_a_picture_as_high_as_a_tower_is_not_searched() -> None:
    """The search takes memory with the square of the height: gigabytes for a million rows."""
    gap = measure_stored(np.zeros((100_000, 30), np.uint8), {})
    assert not gap.trusted
    assert "the limit is" in gap.reason


CAMERAS = (
    {"region": "abcd"}, {"region": [1, 2]}, {"region": [0.5, 1, 30, 30]}, {"sync": [1]},
    {"region": [0, 0, 1 << 62, 1 << 62]}, {"sync": {"patch": [1]}}, {"lens": {"k1": 0.1}},
    {"lens": {"centre_x": 1, "centre_y": 1, "radius": 1e-200}},
    {"lens": {"centre_x": "1", "centre_y": 1, "radius": 100.0}},
)  # fmt: skip


@pytest.mark.parametrize("camera", CAMERAS)
def test_a_run_that_says_nonsense_of_its_camera(run: Run, camera: Any) -> None:
    strange = tamper(run, "run.json", lambda f: f.update(camera=camera))
    with pytest.raises(RecordError, match="camera"):
        measured_edges(strange)


def test_the_note_of_a_withheld_bench_unpacks_to_no_more_than_a_note(tmp_path: Path) -> None:
    import base64

    packed = zlib.compress(b" " * (64 << 20))
    (tmp_path / ENVELOPE).write_bytes(base64.b85encode(packed))
    (tmp_path / "withheld.json").write_text(json.dumps({"seal": "0" * 64, "port": 1}))
    with pytest.raises(PamrigError):
        request_answer(tmp_path)


# ---- what is shown, who listens, what is run ---------------------------------------------


def test_a_report_shows_names_and_does_not_run_them(tmp_path: Path) -> None:
    evil = "<script>alert(1)</script>"
    path = tmp_path / "points.csv"
    path.write_text(
        "trial,slot,mounting,order,direction,pressure_kpa,length_mm,force_n\n"
        + "".join(
            f'1,"{evil}","<img src=x onerror=alert(1)>",{k},up,{100 + 50 * k},60,{5 + 3 * k}\n'
            for k in range(1, 5)
        )
    )
    folder = import_points(str(path), tmp_path / "runs", VirtualClock())
    tamper(
        open_run(folder), "run.json", lambda f: f.update(specimen=evil, operator=evil, note=evil)
    )
    html = (derive_all(folder).folder / "derived" / "report.html").read_text()
    assert "&lt;script&gt;alert(1)" in html
    assert evil not in html
    assert "<img src=x" not in html


def port_of(address: str) -> int:
    return int(address.rpartition(":")[2])


STRANGE = (
    b'{"axis": 1}\n',
    b"[]\n",
    b"7\n",
    b"[" * 50_000 + b"\n",
    b'{"value": []}\n',
    b"\xff\n",
    b'{"axis": "mass", "value": 1e999, "unit": null, "text": 3}\n',
    b" " * 100_000,
)


def test_everything_listens_on_loopback_and_bears_what_comes(tmp_path: Path) -> None:
    """A request without its members ended the bench of `pamrig virtual`."""

    def listening() -> set[tuple[str, int]]:
        found = psutil.Process().net_connections()
        return {(c.laddr.ip, c.laddr.port) for c in found if c.status == psutil.CONN_LISTEN}

    before = listening()
    with open_server(load_rig("virtual-instruments"), tmp_path / "bench", True, None) as server:
        mine = listening() - before
        for request in STRANGE:
            address = ("127.0.0.1", port_of(server.person.address))
            with socket.create_connection(address) as client:
                client.sendall(request)
                for _ in range(50):
                    server.person.step()
            assert len(server.person._buffer) < 20_000
    assert len(mine) >= 8
    assert {address for address, _ in mine} == {"127.0.0.1"}


RUNS_CODE = {"eval", "exec", "compile", "__import__"}
RUNS_TEXT = {"lambdify", "sympify", "parse_expr", "run_path", "run_module", "exec_module"}
LOADS_CODE = {"pickle", "marshal", "shelve", "dill", "cloudpickle", "joblib", "yaml", "code"}
PROGRAMS = {("daq/user_program.py", "exec_module")}
"""A simulator or a protocol that a user names on the command line is the user's own program, like a
script given to Python. It is no data: no file of a data set, a rig or a record can name one."""


def test_nothing_that_is_read_can_be_run() -> None:
    found = set()
    plain = (*RUNS_TEXT, *LOADS_CODE, "allow_pickle", "shell", "0.0.0.0")
    words = re.compile(
        rf"(?<![.\w])({'|'.join(RUNS_CODE)})\b|\b({'|'.join(map(re.escape, plain))})\b|[\"']::[\"']"
    )
    for package in PACKAGES:
        for path in (HOUSE / package).rglob("*.py"):
            name, text = path.relative_to(HOUSE).as_posix(), path.read_text()
            if not words.search(text):
                continue  # to parse every file takes seconds
            for node in ast.walk(ast.parse(text)):
                # Also where it is only handed on: map(sympy.sympify, ...).
                if isinstance(node, ast.Name) and node.id in RUNS_CODE:
                    found.add((name, node.id))
                if isinstance(node, ast.Attribute) and node.attr in RUNS_TEXT:
                    found.add((name, node.attr))
                if isinstance(node, ast.Import):
                    found |= {(name, a.name) for a in node.names if a.name in LOADS_CODE}
                if isinstance(node, ast.ImportFrom) and node.module in LOADS_CODE:
                    found.add((name, node.module))
                if isinstance(node, ast.keyword) and node.arg in ("allow_pickle", "shell"):
                    found.add((name, node.arg))
                if isinstance(node, ast.Constant) and node.value in ("0.0.0.0", "::"):
                    found.add((name, str(node.value)))
    assert found == PROGRAMS


ARM = """name = {name}
gravity_m_s2 = [0, 0, 0]
[[link]]
joint = {joint}
a_mm = 50
mass_g = 10
rod_diameter_mm = 5
"""
RUNS = 'q\\"\\"\\"; open(\\"ran\\", \\"w\\"); \\"\\"\\"'
"""A name that ends the text it stands in and begins a statement."""


@pytest.mark.parametrize("key", ["name", "joint"])
@pytest.mark.parametrize("name", [RUNS, "../../evil", "two\\nlines", "\\u001b[2J", "a b", ""])
def test_a_name_in_an_arm_file_is_a_plain_word(
    key: str, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Such a joint ran its own Python when the arm's equations were loaded."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PAMRIG_CACHE", str(tmp_path / "cache"))
    path = tmp_path / "arm.toml"
    path.write_text(ARM.format(**({"name": '"arm"', "joint": '"knee"'} | {key: f'"{name}"'})))
    for form in ("python", "text", "latex"):
        with pytest.raises(ConfigError) as error:
            links(str(path), form)
        assert str(path) in str(error.value)
        assert f"{key} = " in str(error.value)
        assert not set(map(chr, range(32))) & set(str(error.value))
    with pytest.raises(LinkError):
        generated(load_arm(path))
    assert [p.name for p in tmp_path.iterdir()] == ["arm.toml"]


def test_an_error_brings_no_control_characters_to_the_terminal(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Messages quote files and devices; every one that ends a command leaves by one door."""

    def fails(**_: Any) -> None:
        raise ConfigError("a\x1b]0;title\x07.toml", "\x9b2J is no n\u00e4me\nline\u202e", "\r\x7f")

    monkeypatch.setattr("cli.main.command_line", lambda: fails)
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    assert capsys.readouterr().err == (
        "pamrig: a\\x1b]0;title\\x07.toml: \\x9b2J is no n\u00e4me\\nline\\u202e (\\r\\x7f)\n"
    )


STRANGER = (
    "import os\nos.mkdir('ran')\n",
    "P = (1.0,)\nopen('ran', 'w')\ndef gravity(q, p=P):\n    return (open('ran', 'w'),)\n",
    "P = (1.0,)\ndef gravity(q, p=P):\n    import os\n    return (1.0,)\n",
    "P = (1.0,)\ndef gravity(q, p=P):\n    return (q.__class__,)\n",
    "P = (1.0,)\ndef gravity(q, p=P):\n    return (sin(1.0)(2),)\n",
    "P = (1.0,)\ndef gravity(q, p=open('ran', 'w')):\n    return [1.0]\n",
    "P = (open('ran', 'w'),)\n",
    "P = 5\n",
    "",
    "\0",
    "P = (1.0,)\ndef gravity(q, p=P):\n    return (" + "-" * 100_000 + "1,)\n",
)


@pytest.mark.parametrize("source", STRANGER, ids=range(len(STRANGER)))
def test_equations_from_the_cache_are_evaluated_and_never_run(
    source: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whoever can write to the cache can at most spoil the figures."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(LinkError, match="no equations of an arm"):
        GeneratedDynamics(load_arm("planar2"), source)
    assert list(tmp_path.iterdir()) == []


def test_a_chunk_that_is_compressed_or_shorter_than_it_claims_is_not_read(run: Run) -> None:
    """Arrow lays out what a message claims, and does not look whether its bytes are there."""
    schema = pa.schema([pa.field("seq", pa.int64(), False), pa.field("counts", pa.uint16(), False)])
    rows = [pa.array(np.arange(50)), pa.array(np.arange(50, dtype=np.uint16))]
    batch = pa.RecordBatch.from_arrays(rows, schema=schema)
    small = bytes(batch.serialize().to_pybytes())
    sink = pa.BufferOutputStream()
    options = pa.ipc.IpcWriteOptions(compression="zstd")
    with pa.ipc.new_stream(sink, schema, options=options) as stream:
        stream.write(batch)
    reader = pa.ipc.MessageReader.open_stream(sink.getvalue())
    reader.read_next_message()
    packed = bytes(reader.read_next_message().serialize().to_pybytes())
    assert not _compressed(small)
    assert _compressed(packed)
    for message in (packed, small[:-64], b"\xff" * 900, small[:8] + b"\0" * 900):
        path = run.folder / "samples/valve/000001.arrows"
        path.write_bytes(message)
        own = {"n": 1, "file": "samples/valve/000001.arrows", "offset": 0, "length": len(message),
               "crc32": f"{zlib.crc32(message):08x}", "chunk": "rows", "rows": 50,
               "first_row": 0}  # fmt: skip
        index = run.folder / INDEX
        head = index.read_bytes().splitlines(keepends=True)[0]
        index.write_bytes(head + seal_line(own))
        seal_anew(run.folder)
        try:
            assert len(again(run).samples("valve")["seq"]) == 0
        except RecordError:
            continue


# ---- one line, whatever stands where a table was expected ------------------------------------


def substituted(path: Path, folder: str, name: str, at: tuple[str | int, ...], value: Any) -> str:
    """A shipped file with another value at one place."""
    text = files("configs").joinpath(*folder.split("/"), f"{name}.toml").read_text()
    path.write_text(toml(replaced(tomllib.loads(text), at, value)))
    return str(path)


@pytest.mark.parametrize(
    ("folder", "name", "at", "value", "read"),
    [
        ("rigs", "virtual", ("valve",), 5, load_rig),
        ("rigs", "virtual", ("balance",), "word", load_rig),
        ("rigs", "virtual-instruments", ("virtual", "plant"), 5, load_rig),
        ("rigs", "virtual-instruments", ("virtual", "plant"), "word", load_rig),
        ("rigs", "virtual", ("balance", "serial"), "\x1b[2J\u202e", load_rig),
        ("rigs", "virtual", ("stage", "serial"), "x" * 5000, load_rig),
        ("plant/fingers", "finger", ("arm",), 5, load_finger),
        ("instruments", "scpi-supply", ("set", "output", "words"), 5, load_command_form),
    ],
)
def test_another_kind_of_value_is_an_error_of_one_line(
    folder: str, name: str, at: tuple[str | int, ...], value: Any, read: Any, tmp_path: Path
) -> None:
    """400 of 29,133 such files ended in a traceback."""
    path = tmp_path / "strange.toml"
    with pytest.raises((PamrigError, PlantError)) as error:
        read(substituted(path, folder, name, at, value))
    assert str(path) in str(error.value)
    assert str(at[-1]) in str(error.value)


def test_effects_that_are_no_table(tmp_path: Path) -> None:
    folder = exchange(tmp_path)
    (folder / "bench.toml").write_text("effects = 5\n")
    with pytest.raises(GapError, match=r"effects = 5: expected a table"):
        read_dataset(folder)


def test_a_cell_longer_than_a_csv_may_have(tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.write_text("trial,slot,pressure_kpa\n1,a," + "9" * 200_000 + "\n")
    with pytest.raises(PamrigError, match=r"points\.csv: is not CSV"):
        import_points(str(path), tmp_path / "runs", VirtualClock())


def test_a_small_parquet_file_that_decodes_to_gigabytes(tmp_path: Path) -> None:
    """293 kB became 3.5 GB: constant columns take no room in the file."""
    path = tmp_path / "samples.parquet"
    rows = 4_000_000
    column = pa.array(np.zeros(rows))
    pq.write_table(pa.table({f"c{k}": column for k in range(30)}), path, compression="zstd")
    assert path.stat().st_size < 600_000
    tracemalloc.start()
    with pytest.raises(PamrigError, match=r"declares 120000000 cells in \d+ bytes"):
        read_parquet(path)
    assert tracemalloc.get_traced_memory()[1] < 5e6
    tracemalloc.stop()


@pytest.mark.parametrize("value", ["\\ud800", "1e999", "NaN", "-Infinity", "9" * 30])
def test_a_sealed_line_with_a_value_that_no_record_holds(value: str) -> None:
    """Half a surrogate pair could be neither printed nor stored, and ended whatever tried."""
    text = f'"{value}"' if value.startswith("\\") else value
    with pytest.raises(SealError, match="number or text"):
        open_line(seal_text('{"specimen":[' + text + "]"))


def test_nothing_printed_controls_the_terminal(capfd: pytest.CaptureFixture[str]) -> None:
    """Tables, lists and messages all leave by the same door, whatever names they hold."""
    with plain_output():
        print("a\x1b[2J\x9b1m\u202eb\ud800\tc\rd")
        typer.echo("\rprogress", nl=False, err=True)
        print("\x07", file=sys.stderr)
    out, err = capfd.readouterr()
    assert out == "a\\x1b[2J\\x9b1m\\u202eb\\ud800\tc\\rd\n"
    assert err == "\rprogress\\x07\n"


@pytest.mark.parametrize(
    "fields", [{"what": "begun"}, {"what": "done", "test": "x", "run_id": 5, "crc32": ""}]
)
def test_a_journal_of_a_plan_that_says_nonsense(fields: dict[str, Any], tmp_path: Path) -> None:
    path = tmp_path / "plan.toml"
    path.write_text('rig = "virtual"\n[[test]]\nprotocol = "isometric"\nfile = "isometric-short"\n')
    plan = load_plan(path)
    plan.journal.write_bytes(seal_line(fields))
    with pytest.raises(RecordError, match="is not a journal"):
        progress(plan)


@pytest.mark.parametrize("kind", ["device", "pipe", "sparse"])
@pytest.mark.parametrize("name", ["reserve.zero", "written.map", "samples/valve.ahead"])
def test_a_file_of_an_interrupted_record_without_end_is_not_read(
    name: str, kind: str, tmp_path: Path
) -> None:
    """`reserve.zero` as a link to /dev/zero filled the memory, as a pipe it waited forever."""
    record = RecordWriter(tmp_path, {}, VirtualClock(), durable=False, threaded=False)
    record.stream("valve", {"seq": "int64"})
    record.write_ahead("valve", {"seq": np.arange(5)})
    record._disk.written.close(False)  # as a kill leaves it, with the reserve
    path = record.folder / name
    path.unlink()
    if kind == "device":
        path.symlink_to("/dev/zero")
    elif kind == "pipe":
        os.mkfifo(path)
    else:
        with open(path, "wb") as file:
            file.truncate(1 << 40)
    said = [str(p) for p in verify(open_run(record.folder)) if p.file == name]
    assert re.search(r"regular file|bytes, the limit|link", "; ".join(said)), said
    record.abandon()


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("final.json", {"ended": {"t_ns": "x"}}),
        ("final.json", {"ended": None}),
        ("run.json", {"started": {"utc": 5}}),
        ("run.json", {"specimen": {"deep": 1}}),
        ("run.json", {"run_id": 5}),
        ("run.json", {"continues": {"run_id": [1]}}),
    ],
)
def test_one_strange_run_does_not_hide_the_others(
    run: Run, name: str, change: dict[str, Any]
) -> None:
    """One sealed `final.json` ended `runs list` of its whole folder in a traceback."""
    record = RecordWriter(run.folder.parent, {}, VirtualClock(), durable=False, threaded=False)
    record.finalize("clean")
    tamper(run, name, lambda fields: fields.update(change))
    for _ in range(2):
        listed = {info.run_id: info.outcome for info in list_runs(run.folder.parent)}
        assert listed[record.run_id] == "clean"
        assert run.run_id in listed
        rebuild_index(run.folder.parent)


def test_no_file_of_a_record_is_opened_but_through_the_one_door() -> None:
    """Nothing that reads records opens, maps or measures a file by itself."""
    writers = {"disk.py", "sealed.py", "ahead.py", "written.py", "safe_read.py", "writer.py"}
    others = {"tablefile.py", "derive.py"}  # files of other programs; derived files being written
    own = {"open", "read_bytes", "read_text", "stat"}
    found = set()
    for package in ("record", "store"):
        for path in (HOUSE / "daq" / package).glob("*.py"):
            for node in ast.walk(ast.parse(path.read_text())):
                called = node.func if isinstance(node, ast.Call) else None
                name = getattr(called, "attr", getattr(called, "id", ""))
                if name in own and path.name not in writers | others:
                    found.add((path.name, name))
    allowed = {("annotations.py", "open"), ("index.py", "stat")}  # appends; time of a change
    assert found - allowed == set()


@pytest.fixture(scope="module")
def tested(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The record of a short test."""
    return run_bench(tmp_path_factory.mktemp("tested"), repeats=1)[0].folder


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("final.json", {"clock_fit": {"knots": {}}}),
        ("final.json", {"clock_fit": {"fastest_round_trip_ns": [5, "word"]}}),
        ("final.json", {"counters": {"valve": {"x": 1}}}),
        ("events.jsonl", {"pixels": "word"}),
        ("frames.jsonl", {"host_ns": {"": {}}}),
    ],
)
def test_strange_contents_are_one_line_in_every_command(
    name: str, change: dict[str, Any], tmp_path: Path, tested: Path
) -> None:
    """Sums are right everywhere; only a maker of false records writes such a value."""
    folder = tmp_path / "runs" / tested.name
    shutil.copytree(tested, folder)
    tamper(open_run(folder), name, lambda f: f.update(change) if set(change) <= set(f) else None)
    for words in (("report",), ("runs", "show"), ("gap", "export", "--out", str(tmp_path / "d"))):
        done = CliRunner().invoke(app, [*words, str(folder)])
        assert done.exception is None or isinstance(done.exception, PamrigError), words
