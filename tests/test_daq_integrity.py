"""A thousand flipped bits, anywhere in a record: each reported, none read as good data."""

from __future__ import annotations

import random
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from daq.errors import RecordError
from daq.record.sealed import open_file, seal_file
from daq.record.segments import BatchEncoder
from daq.store.derive import derive
from daq.store.run import Run, open_run
from daq.store.store import list_runs, show
from daq.store.verify import verify
from daq_records import begin, content, fill, valve_batch


def table_maker(run: Run, folder: Path) -> None:
    (folder / "table.csv").write_text("pressure_kpa,force_n\n100.0,5.5\n200.0,7.25\n")


def finished(root: Path) -> Path:
    writer, clock = begin(root, segment_rows=150)
    fill(writer, clock, 5)
    writer.finalize("clean", gaps={"valve": {"missing": 0}})
    derive(open_run(writer.folder), [table_maker])
    return writer.folder


def interrupted(root: Path) -> Path:
    """As a kill leaves it: no end marks, no final.json, half a chunk, half a line."""
    writer, clock = begin(root, segment_rows=150)
    fill(writer, clock, 5)
    for k in range(250, 270, 10):
        writer.write_ahead("valve", valve_batch(k, 10))
    writer.abandon()
    derive(open_run(writer.folder), [table_maker])
    message, _ = BatchEncoder(open_run(writer.folder).schema("valve")).encode(valve_batch(250))
    with open(writer.folder / "samples/valve/000002.arrows", "ab") as segment:
        segment.write(message[:300])
    with open(writer.folder / "events.jsonl", "ab") as events:
        events.write(b'{"n":5,"t_ns":2500000')
    return writer.folder


MAKERS = {"finished": finished, "interrupted": interrupted}


def flips(folder: Path, count: int, seed: int) -> Iterator[tuple[Path, int]]:
    """Bits to flip: every second one falls on any byte, the others on any file first."""
    rng = random.Random(seed)
    files = sorted(p for p in folder.rglob("*") if p.is_file())
    sizes = [p.stat().st_size for p in files]
    for k in range(count):
        (path,) = rng.choices(files, weights=sizes) if k % 2 else [rng.choice(files)]
        yield path, rng.randrange(8 * path.stat().st_size)


def part_of(found: dict[str, Any], original: dict[str, Any]) -> None:
    """Everything given out is as it was written; things may be missing, nothing may differ."""
    for name in ("manifest", "final"):
        assert found[name] in (None, original[name]), name
    for name in ("events", "valve", "balance", "wire"):
        left = iter(original[name])
        assert all(item in left for item in found[name]), name  # same things, same order
    for number, frame in found["frames"].items():
        assert original["frames"][number] == frame


def check_flips(folder: Path, count: int, seed: int) -> None:
    original = content(open_run(folder))
    before = set(verify(open_run(folder)))
    for path, bit in flips(folder, count, seed):
        sound = path.read_bytes()
        data = bytearray(sound)
        data[bit // 8] ^= 1 << bit % 8
        path.write_bytes(data)
        name = path.relative_to(folder).as_posix()
        problems = verify(open_run(folder))
        where = f"{name}, bit {bit}"
        in_tail = any(p.file == name and p.offset <= bit // 8 < p.offset + p.length for p in before)
        assert in_tail or name in {p.file for p in set(problems) - before}, where
        run = open_run(folder)
        part_of(content(run), original)
        if name.startswith("derived/"):
            with pytest.raises(RecordError):
                run.derived("table.csv" if "manifest" in name else path.name)
        path.write_bytes(sound)
    assert set(verify(open_run(folder))) == before


@pytest.mark.parametrize("state", ["finished", "interrupted"])
def test_flipped_bits_are_each_reported_and_never_read_as_good(tmp_path: Path, state: str) -> None:
    check_flips(MAKERS[state](tmp_path), 150, seed=2024)


@pytest.mark.campaign
@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("state", ["finished", "interrupted"])
def test_many_more_flipped_bits(tmp_path: Path, state: str, seed: int) -> None:
    check_flips(MAKERS[state](tmp_path), 2000, seed=seed)


def test_the_records_that_are_flipped_hold_something_and_are_sound(tmp_path: Path) -> None:
    whole = open_run(finished(tmp_path))
    found = content(whole)
    assert [len(found[n]) for n in ("valve", "balance", "events", "frames", "wire")] == [
        250,
        5,
        5,
        5,
        5,
    ]
    assert verify(whole) == []
    torn = open_run(interrupted(tmp_path))
    assert {p.file for p in verify(torn)} == {"samples/valve/000002.arrows", "events.jsonl"}
    assert all(p.tail for p in verify(torn))
    assert len(content(torn)["valve"]) == 270


def test_lists_and_summaries_live_with_damage_in_any_file(tmp_path: Path) -> None:
    folder = finished(tmp_path)
    for path in sorted(p for p in folder.rglob("*") if p.is_file()):
        sound = path.read_bytes()
        data = bytearray(sound)
        data[len(data) // 2] ^= 16
        path.write_bytes(data)
        (info,) = list_runs(tmp_path)
        assert info.outcome == ("damaged" if path.name == "final.json" else "clean")
        assert (info.protocol == "damaged") == (path.name == "run.json")
        assert show(open_run(folder))["run_id"] == folder.name
        path.write_bytes(sound)


def test_a_damaged_run_json_keeps_calibrations_back_and_nothing_else(tmp_path: Path) -> None:
    folder = finished(tmp_path)
    path = folder / "run.json"
    path.write_bytes(path.read_bytes().replace(b'"scale": 0.25', b'"scale": 0.35'))
    run = open_run(folder)
    with pytest.raises(RecordError, match=r"run\.json"):
        run.calibration("pressure_kpa")
    assert len(run.samples("valve")["seq"]) == 250


def test_a_run_json_from_another_run_is_noticed(tmp_path: Path) -> None:
    first, second = finished(tmp_path / "a"), finished(tmp_path / "b")
    (second / "run.json").write_bytes((first / "run.json").read_bytes())
    assert any("belongs to run" in p.what for p in verify(open_run(second)))


def test_what_was_reserved_must_be_zero(tmp_path: Path) -> None:
    writer, clock = begin(tmp_path)
    fill(writer, clock, 1)
    reserve = writer.folder / "reserve.zero"
    assert verify(open_run(writer.folder)) == []
    data = bytearray(reserve.read_bytes())
    data[5000] = 1
    reserve.write_bytes(data)
    assert [p.file for p in verify(open_run(writer.folder))] == ["reserve.zero"]
    writer.abandon()


def test_a_sealed_manifest_that_names_no_run_is_told(tmp_path: Path) -> None:
    writer, clock = begin(tmp_path)
    fill(writer, clock, 1)
    writer.finalize("clean")
    path = writer.folder / "run.json"
    fields = open_file(path.read_bytes())
    fields.pop("run_id")
    path.write_bytes(seal_file(fields))
    assert any("run.json, byte 0: names no run" in str(p) for p in verify(open_run(writer.folder)))
