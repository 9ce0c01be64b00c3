"""A diagnosis is computed once for the same content and read after that, with the same result."""

from __future__ import annotations

import json
import os
import pickle
import struct
import subprocess
import sys
import zipfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from bench_process import call_pamrig
from daq.progress import heard_by
from gap.data.reader import read_dataset
from gap.decision import store
from gap.decision.diagnose import diagnose
from gap.decision.diagnosis import diagnosis
from gap.decision.fingerprint import fingerprint
from gap.decision.store import Store, user_folder
from gap.simulators.open import open_data_with
from gap_bench import write_set
from gap_sets import settled_set
from simulator_files import STATIC, write

LINER = {"liner_threshold": {"threshold_kpa": 40.0}}


@pytest.fixture(scope="module")
def settled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return settled_set(tmp_path_factory.mktemp("kept") / "settled", LINER)


@pytest.fixture(scope="module")
def timed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_set(tmp_path_factory.mktemp("kept") / "timed", LINER, seed=12, replicates=2)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of kept diagnoses, empty."""
    monkeypatch.setenv("PAMRIG_DIAGNOSES", str(tmp_path / "kept"))
    return tmp_path / "kept"


def printed(*words: str | Path) -> Any:
    done = call_pamrig("gap", *words, "--json")
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def entries(folder: Path) -> list[Path]:
    return sorted(folder.iterdir()) if folder.exists() else []


@pytest.mark.parametrize("without", [(), ("--without", "creep")], ids=["catalogue", "without"])
@pytest.mark.parametrize("data", ["settled", pytest.param("timed", marks=pytest.mark.campaign)])
def test_each_command_prints_the_same_from_the_cache(
    data: str, without: tuple[str, ...], folder: Path, tmp_path: Path,
    request: pytest.FixtureRequest,
) -> None:  # fmt: skip
    given = request.getfixturevalue(data)
    page = ("--out", tmp_path / "page.html")
    more = {"diagnose": (), "where": (), "shrink": (), "next": (), "report": page}
    commands = {name: (*words, *without) for name, words in more.items()}
    anew = {name: printed(name, given, *words, "--no-cache") for name, words in commands.items()}
    assert entries(folder) == []
    assert printed("diagnose", given, *without) == anew["diagnose"]
    (entry,) = entries(folder)
    written = entry.stat().st_ino
    assert {name: printed(name, given, *words) for name, words in commands.items()} == anew
    assert [path.stat().st_ino for path in entries(folder)] == [written]


def test_the_fits_are_those_that_were_computed(timed: Path, folder: Path) -> None:
    data = read_dataset(timed)
    computed, read = diagnosis(data), diagnosis(data)
    assert (computed.kept, read.kept) == (False, True)
    for one, other in ((computed.fit, read.fit), (computed.problem.base, read.problem.base)):  # type: ignore[union-attr]
        assert one is not None
        assert other is not None
        assert one.candidates == other.candidates
        for name in ("shift", "amounts", "residual", "cover"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    problem, fit = read.problem, read.fit
    assert problem is not None
    assert fit is not None
    # The problem that is set up again predicts what the one that was searched predicted.
    np.testing.assert_allclose(
        problem.residual_at(fit.shift, fit.candidates, fit.amounts), fit.residual, atol=1e-9
    )


def _samples(folder: Path) -> None:
    table = pd.read_csv(folder / "samples.csv")
    table.loc[3, "force_n"] += 1e-9
    table.to_csv(folder / "samples.csv", index=False)


def _trials(folder: Path) -> None:
    text = (folder / "trials.csv").read_text()
    (folder / "trials.csv").write_text(text.replace("m2", "m3"))


def _bench(folder: Path) -> None:
    (folder / "bench.toml").write_text("dead_volume_ml = 4.1\n")


def _effects(folder: Path) -> None:
    (folder / "bench.toml").write_text("[effects.liner_threshold]\nthreshold_kpa = 10.0\n")


def _calibration(folder: Path) -> None:
    (folder / "calibration.toml").write_text("force_zero_n = 0.1\n")


@pytest.mark.parametrize("change", [_samples, _trials, _bench, _effects, _calibration])
def test_whatever_decides_the_result_is_in_the_key(
    change: Callable[[Path], None], tmp_path: Path
) -> None:
    made = settled_set(tmp_path / "set", LINER)
    before = fingerprint(read_dataset(made), ())
    assert fingerprint(read_dataset(made), ()) == before
    change(made)
    assert fingerprint(read_dataset(made), ()) != before


def test_struck_effects_are_in_the_key_in_any_order(settled: Path) -> None:
    data = read_dataset(settled)
    found = [fingerprint(data, struck) for struck in ((), ("leak",), ("leak", "end_cap"))]
    assert len(set(found)) == 3
    assert fingerprint(data, ("end_cap", "leak")) == found[-1]


def test_the_source_of_a_function_is_in_the_key(settled: Path, tmp_path: Path) -> None:
    code = "def force(p, length, c):\n    return 0.01 * p\n"
    description = write(tmp_path, simulator_toml=STATIC, muscle_py=code)
    before = fingerprint(open_data_with(settled, description), ())
    assert before is not None
    assert before != fingerprint(read_dataset(settled), ())
    (tmp_path / "muscle.py").write_text(code.replace("0.01", "0.02"))
    assert fingerprint(open_data_with(settled, description), ()) != before


def _cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-200])


def _flipped(path: Path) -> None:
    """In the middle of the largest part: a byte of an archive's headers may mean nothing."""
    with zipfile.ZipFile(path) as file:
        part = max(file.infolist(), key=lambda one: one.compress_size)
    content = bytearray(path.read_bytes())
    name, extra = struct.unpack_from("<HH", content, part.header_offset + 26)
    content[part.header_offset + 30 + name + extra + part.compress_size // 2] ^= 0xFF
    path.write_bytes(content)


def _pickled(path: Path) -> None:
    path.write_bytes(pickle.dumps({"about": "x"}))


def _objects(path: Path) -> None:
    np.savez(path, about=np.array([{"key": path.stem}], dtype=object))


def _foreign(path: Path) -> None:
    about = json.dumps({"key": path.stem, "value": {"verdict": {"status": "NAMED"}}, "arrays": 0})
    np.savez(path, about=np.frombuffer(about.encode(), dtype=np.uint8))


def _of_another(path: Path) -> None:
    store = Store(path.parent)
    store.write("0" * 64, 1, [])
    os.replace(path.parent / f"{'0' * 64}.npz", path)


@pytest.mark.parametrize("harm", [_cut, _flipped, _pickled, _objects, _foreign, _of_another])
def test_a_damaged_or_foreign_entry_is_made_anew(
    harm: Callable[[Path], None], settled: Path, folder: Path
) -> None:
    data = read_dataset(settled)
    first = diagnosis(data)
    (entry,) = entries(folder)
    harm(entry)
    again = diagnosis(data)
    assert not again.kept
    assert again.verdict.as_dict() == first.verdict.as_dict()
    assert diagnosis(data).kept


def test_no_entry_is_made_where_it_is_switched_off(
    settled: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PAMRIG_CACHE", str(tmp_path / "all"))
    monkeypatch.setenv("PAMRIG_DIAGNOSES", "off")
    assert user_folder() is None
    assert not diagnosis(read_dataset(settled)).kept
    assert not (tmp_path / "all").exists()


def test_a_folder_that_cannot_be_written_only_costs_time(
    settled: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("PAMRIG_DIAGNOSES", str(tmp_path / "file" / "below"))
    data = read_dataset(settled)
    assert diagnosis(data).verdict.as_dict() == diagnosis(data).verdict.as_dict()


@pytest.mark.parametrize(
    ("platform", "variable", "expected"),
    [
        ("linux", "XDG_CACHE_HOME", "pamrig/diagnoses"),
        ("win32", "LOCALAPPDATA", "pamrig/Cache/diagnoses"),
    ],
)
def test_the_folder_is_where_the_system_keeps_caches(
    platform: str, variable: str, expected: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("PAMRIG_CACHE", "PAMRIG_DIAGNOSES"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(sys, "platform", platform)
    monkeypatch.setenv(variable, str(tmp_path))
    assert user_folder() == tmp_path / expected


def test_the_folder_stays_within_its_bound_and_the_last_used_stay(tmp_path: Path) -> None:
    kept = Store(tmp_path, most_bytes=20_000)
    array = np.zeros(500)
    for number in range(4):
        kept.write(f"{number}", number, [array])
        os.utime(tmp_path / f"{number}.npz", (1e9 + number, 1e9 + number))
    assert kept.read("0") is not None  # used just now
    kept.write("4", 4, [array])
    assert sum(path.stat().st_size for path in tmp_path.iterdir()) <= 20_000
    assert [kept.read(f"{number}") is not None for number in (0, 1, 4)] == [True, False, True]


def test_an_entry_larger_than_half_the_bound_is_not_kept(tmp_path: Path) -> None:
    kept = Store(tmp_path / "none", most_bytes=8000)
    kept.write("big", 0, [np.zeros(600)])
    assert not (tmp_path / "none").exists()


def test_writers_and_readers_at_once_never_see_half_an_entry(tmp_path: Path) -> None:
    arrays = [np.full(20_000, 7.0)]

    def turn(number: int) -> bool:
        kept = Store(tmp_path)
        kept.write("one", {"of": "all"}, arrays)
        found = kept.read("one")
        return found is not None and bool((found[1][0] == 7.0).all())

    with ThreadPoolExecutor(4) as pool:
        assert all(pool.map(turn, range(40)))
    assert [path.name for path in tmp_path.iterdir()] == ["one.npz"]


def test_what_a_killed_process_left_is_removed_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "left.part").write_bytes(b"half")
    (tmp_path / "now.part").write_bytes(b"half")
    old = (tmp_path / "left.part").stat().st_mtime - store._LEFT_OVER_S - 1.0
    os.utime(tmp_path / "left.part", (old, old))
    Store(tmp_path).write("one", 1, [])
    assert [path.name for path in entries(tmp_path)] == ["now.part", "one.npz"]


@pytest.mark.skipif(sys.platform == "win32", reason="no pseudo-terminals")
def test_stages_are_shown_on_a_terminal_and_nowhere_else(settled: Path) -> None:
    import pty

    words = [sys.executable, "-m", "cli.main", "gap", "diagnose", str(settled), "--json"]
    ours, theirs = pty.openpty()
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=theirs) as process:
        os.close(theirs)
        shown = b""
        while chunk := _read_terminal(ours):
            shown += chunk
        assert process.stdout is not None
        found = json.loads(process.stdout.read())
    os.close(ours)
    assert process.returncode == 0
    lines = [part.strip() for part in shown.split(b"\r")]
    # A stage shorter than a look of the line is passed over; the last one is long enough.
    # On a slow machine its time stands behind it.
    assert lines[-3].split(b"  ")[0] == b"confounders, stages and the next experiment"
    assert lines[-2:] == [b"", b""]  # cleared
    quiet = subprocess.run(words, capture_output=True, check=True)
    assert quiet.stderr == b""
    assert json.loads(quiet.stdout) == found
    told: list[str] = []
    with heard_by(told.append):
        diagnose(read_dataset(settled))
    assert "noise and recalibration of 15 trials" in told
    assert any(text.startswith("effect 1: fit 1 of") for text in told)


def _read_terminal(handle: int) -> bytes:
    try:
        return os.read(handle, 4096)
    except OSError:  # the other end is closed
        return b""
