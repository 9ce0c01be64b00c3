"""Changes of a record as a whole: files removed, exchanged, renamed, cut off or of another run.

Every file is sound by its own checksums afterwards; what shows the change is what the files say of
each other. Each change must be reported, and no byte of another run may be read as this run's.
"""

from __future__ import annotations

import os
import random
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from cli.main import app
from daq.clock import VirtualClock
from daq.errors import RecordError
from daq.record.safe_read import names_inside
from daq.record.sealed import open_file, seal_file
from daq.record.writer import RecordWriter
from daq.store.annotations import annotate
from daq.store.derive import derive
from daq.store.run import Run, open_run
from daq.store.verify import verify

CHANGES = 500 if os.environ.get("PAMRIG_CAMPAIGN") else 60
OWN, FOREIGN = 1000, 40_000
"""Readings of this run's streams, and of the other's, start here."""


def make(root: Path, first: int, ended: bool) -> Path:
    """A record of two streams with two segments, frames, raw bytes and, if ended, all the rest."""
    manifest = {"protocol": "isometric", "specimen": f"m{first}"}
    record = RecordWriter(
        root, manifest, VirtualClock(), durable=False, threaded=False, segment_rows=60,
        frames_file_bytes=300,
    )  # fmt: skip
    columns = {"row": "int64", "reading": "uint16"}
    for stream in ("valve", "balance"):
        record.stream(stream, columns)
        for k in range(4):
            rows = np.arange(25 * k, 25 * k + 25)
            record.append(stream, {"row": rows, "reading": (rows + first).astype(np.uint16)})
    for k in range(6):
        record.event("state", state=f"{first} {k}")
        record.frame(b"picture %d %d " % (first, k) * 8, k)
        record.wire("valve", k, b"wire %d " % first)
    if ended:
        record.finalize("clean")
        annotate(record.folder, "note", [], f"of {first}")
        annotate(record.folder, "exclude", [1], f"of {first}")
        derive(open_run(record.folder))
    else:
        for stream in ("valve", "balance"):
            rows = np.arange(100, 110)
            record.write_ahead(stream, {"row": rows, "reading": (rows + first).astype(np.uint16)})
        record.abandon()
    return record.folder


Change = Callable[[Path, Path, random.Random], str]


def some(folder: Path, rng: random.Random) -> str:
    return rng.choice([name for name, size in names_inside(folder) if size])


def remove(own: Path, other: Path, rng: random.Random) -> str:
    name = some(own, rng)
    (own / name).unlink()
    return f"removed {name}"


def remove_folder(own: Path, other: Path, rng: random.Random) -> str:
    name = rng.choice(["samples", "frames", "wire", "samples/valve", "samples/balance"])
    shutil.rmtree(own / name)
    return f"removed {name}"


def exchange(own: Path, other: Path, rng: random.Random) -> str:
    name = some(other, rng)
    (own / name).write_bytes((other / name).read_bytes())
    return f"exchanged {name}"


def exchange_stream(own: Path, other: Path, rng: random.Random) -> str:
    name = rng.choice(["samples", "frames", "wire"])
    shutil.rmtree(own / name)
    shutil.copytree(other / name, own / name)
    if name == "frames":
        shutil.copy(other / "frames.jsonl", own / "frames.jsonl")
    return f"exchanged all of {name}"


def exchange_within(own: Path, other: Path, rng: random.Random) -> str:
    name = some(own, rng)
    alike = [n for n, _ in names_inside(own) if n != name and Path(n).suffix == Path(name).suffix]
    second = rng.choice(alike or [some(own, rng)])
    first, last = (own / name).read_bytes(), (own / second).read_bytes()
    (own / name).write_bytes(last)
    (own / second).write_bytes(first)
    return f"exchanged {name} and {second}"


def rename(own: Path, other: Path, rng: random.Random) -> str:
    name = some(own, rng)
    new = rng.choice(["x", "000009", "flow", "events", "final"]) + "".join(Path(name).suffixes)
    (own / name).rename((own / name).with_name(new))
    return f"renamed {name} to {new}"


def rename_run(own: Path, other: Path, rng: random.Random) -> str:
    own.rename(own.with_name(own.name[:-6] + "ffffff"))
    return "renamed the folder"


def cut(own: Path, other: Path, rng: random.Random) -> str:
    name = some(own, rng)
    os.truncate(own / name, rng.randrange((own / name).stat().st_size))
    return f"cut {name}"


def of_lines(folder: Path) -> list[str]:
    return [name for name, size in names_inside(folder) if name.endswith(".jsonl") and size]


def cut_lines(own: Path, other: Path, rng: random.Random) -> str:
    name = rng.choice(of_lines(own))
    lines = (own / name).read_bytes().splitlines(keepends=True)
    (own / name).write_bytes(b"".join(lines[: rng.randrange(len(lines))]))
    return f"cut {name} at the end of a line"


def reorder(own: Path, other: Path, rng: random.Random) -> str:
    name = rng.choice(of_lines(own))
    lines = (own / name).read_bytes().splitlines(keepends=True)
    rng.shuffle(lines)
    (own / name).write_bytes(b"".join(lines))
    return f"reordered {name}"


def foreign_lines(own: Path, other: Path, rng: random.Random) -> str:
    name = rng.choice(of_lines(other))
    lines = (own / name).read_bytes().splitlines(keepends=True)
    at = rng.randrange(len(lines))
    strange = (other / name).read_bytes().splitlines(keepends=True)
    (own / name).write_bytes(b"".join(lines[:at] + strange[at:]))
    return f"lines of another run in {name} from {at} on"


def foreign_stream(own: Path, other: Path, rng: random.Random) -> str:
    new = rng.choice(["flow", "other"])
    text = (other / "samples/valve.index.jsonl").read_bytes()
    (own / f"samples/{new}.index.jsonl").write_bytes(text)
    shutil.copytree(other / "samples/valve", own / f"samples/{new}")
    return f"added stream {new}"


def in_place_of(own: Path, other: Path, rng: random.Random) -> str:
    name = some(own, rng)
    kind = rng.choice(["link", "link within", "pipe", "folder", "device"])
    (own / name).unlink()
    if kind == "link":
        (own / name).symlink_to(other / name)
    elif kind == "link within":
        (own / name).symlink_to(own / "run.json")
    elif kind == "device":
        (own / name).symlink_to("/dev/zero")
    elif kind == "pipe":
        os.mkfifo(own / name)
    else:
        (own / name).mkdir()
    return f"a {kind} in place of {name}"


KINDS: tuple[Change, ...] = (
    remove, remove_folder, exchange, exchange_stream, exchange_within, rename, rename_run, cut,
    cut_lines, reorder, foreign_lines, foreign_stream, in_place_of,
)  # fmt: skip


def state(folder: Path) -> dict[str, bytes | None]:
    """Bytes by name; None for what is not a regular file."""
    return {
        name: None if (folder / name).is_symlink() or not (folder / name).is_file()
        else (folder / name).read_bytes()
        for name, _ in names_inside(folder)
    }  # fmt: skip


def readings(run: Run) -> list[int]:
    """Everything that can be read: all readings, with those that stand in events and pictures."""
    out: list[int] = []

    def read(what: Callable[[], list[int]]) -> None:
        try:
            out.extend(what())
        except RecordError:
            return

    for stream in run.streams:
        read(lambda stream=stream: list(run.samples(stream).get("reading", ())))  # type: ignore[misc]
    read(lambda: [int(e["state"].split()[0]) for e in run.events if e["kind"] == "state"])
    read(lambda: [int(str(run.manifest["specimen"])[1:])])
    read(lambda: [int(run.frame_bytes(f["frame"]).split()[1]) for f in run.frames])
    read(lambda: [int(c.data.split()[1]) for c in run.wire("valve")])
    read(lambda: run_table_readings(run))
    return out


def run_table_readings(run: Run) -> list[int]:
    import pyarrow.parquet as pq

    return list(pq.read_table(run.derived("samples.parquet")).column("reading").to_pylist())


@pytest.fixture(scope="module")
def pairs(tmp_path_factory: pytest.TempPathFactory) -> dict[bool, tuple[Path, Path]]:
    """This run and another one of the same shape, finished and interrupted."""
    root = tmp_path_factory.mktemp("changes")
    out = {}
    for ended in (True, False):
        own = make(root / f"own{ended}", OWN, ended)
        assert [str(p) for p in verify(open_run(own))] == []
        assert {r // FOREIGN for r in readings(open_run(own))} == {0}
        out[ended] = own, make(root / f"other{ended}", FOREIGN, ended)
    return out


@pytest.mark.parametrize("number", range(CHANGES))
def test_a_change_of_the_record_is_reported_and_nothing_foreign_is_read(
    number: int, pairs: dict[bool, tuple[Path, Path]], tmp_path: Path
) -> None:
    """Streams could be removed or exchanged in an interrupted record, and `verify` said sound."""
    rng = random.Random(number)
    sound, other = pairs[number // len(KINDS) % 2 == 0]
    own = tmp_path / sound.name
    shutil.copytree(sound, own)
    before = state(own)
    what = ""
    while not what or (own.exists() and state(own) == before):  # some files are alike in both
        what = KINDS[number % len(KINDS)](own, other, rng)
    folder = next(path for path in tmp_path.iterdir())
    assert verify(Run(folder)) != [], what
    assert [r for r in readings(Run(folder)) if r >= FOREIGN] == [], what


@pytest.fixture
def old(tmp_path: Path) -> dict[str, Path]:
    """A finished and an interrupted record of format 1, as they were written until 2026-11."""
    with zipfile.ZipFile(Path(__file__).with_name("records_format_1.zip")) as packed:
        packed.extractall(tmp_path)
    return {name: next((tmp_path / name).iterdir()) for name in ("ended", "killed")}


def test_records_of_format_1_are_read_and_what_they_cannot_prove_is_said(
    old: dict[str, Path],
) -> None:
    for name, rows in (("ended", 100), ("killed", 110)):
        run = open_run(old[name])
        assert [str(p) for p in verify(run)] == []
        assert run.samples("valve")["reading"].tolist() == list(range(OWN, OWN + rows))
        assert [e["state"] for e in run.events] == [f"{OWN} {k}" for k in range(6)]
        assert run.frame_bytes(5).startswith(b"picture 1000 5")
        said = CliRunner().invoke(app, ["runs", "verify", str(old[name])])
        assert said.exit_code == 0
        assert "format 1" in said.output
        assert ("not finished" in said.output) == (name == "killed")
    assert open_run(old["ended"]).outcome == "clean"


def test_a_finished_record_of_format_1_shows_what_was_exchanged(
    old: dict[str, Path], tmp_path: Path
) -> None:
    other = make(tmp_path / "other", FOREIGN, True)
    for name in ("samples/valve.index.jsonl", "events.jsonl", "final.json"):
        own = (old["ended"] / name).read_bytes()
        (old["ended"] / name).write_bytes((other / name).read_bytes())
        assert verify(Run(old["ended"])) != []
        assert [r for r in readings(Run(old["ended"])) if r >= FOREIGN] == []
        (old["ended"] / name).write_bytes(own)
    assert verify(Run(old["ended"])) == []


def test_a_record_of_a_later_format_is_refused(tmp_path: Path) -> None:
    folder = make(tmp_path, OWN, True)
    fields = open_file((folder / "run.json").read_bytes()) | {"schema": "pamrig-run/3"}
    (folder / "run.json").write_bytes(seal_file(fields))
    with pytest.raises(RecordError, match="pamrig-run/3"):
        _ = Run(folder).manifest
    assert "pamrig-run/3" in str(verify(Run(folder)))
