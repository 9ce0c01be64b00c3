"""A table made again with other settings for the pictures: a version beside it, never over it."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from analysis.reporting.report import record_hash
from bench_runs import run_bench
from daq.store.annotations import annotate
from daq.store.run import Run, open_run
from daq.store.verify import verify


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short isometric run with its derived files."""
    root = tmp_path_factory.mktemp("runs")
    result, _, _ = run_bench(root, derive=True)
    return result.folder


@pytest.fixture
def folder(recorded: Path, tmp_path: Path) -> Path:
    """A copy of it, to change."""
    return Path(shutil.copytree(recorded, tmp_path / "runs" / recorded.name))


def pamrig(
    words: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> tuple[Any, str, str]:
    """Exit status, standard output and error."""
    from cli.main import main

    monkeypatch.setattr("sys.argv", ["pamrig", *words])
    with pytest.raises(SystemExit) as ended:
        main()
    return ended.value.code, *capsys.readouterr()


@pytest.fixture
def rebuild(folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    def call(*settings: str) -> Any:
        words = [w for setting in settings for w in ("--vision", setting)]
        command = ["runs", "rebuild", str(folder), *words, "--json"]
        status, out, error = pamrig(command, monkeypatch, capsys)
        assert status == 0, error
        return json.loads(out)

    return call


@pytest.fixture(scope="module")
def twice(recorded: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the run with two derived versions, which verify as sound."""
    from cli.main import command_line

    folder = Path(shutil.copytree(recorded, tmp_path_factory.mktemp("two") / recorded.name))
    for _ in range(2):
        words = ["runs", "rebuild", str(folder), "--vision", "region=whole", "--json"]
        command_line()(words, standalone_mode=False)
    assert verify(open_run(folder)) == []
    return folder


def contents(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*.*")}


def table(folder: Path, name: str = "derived") -> pd.DataFrame:
    return pd.read_parquet(open_run(folder).derived("table.parquet", name))


def test_a_version_stands_beside_everything_that_was_there(folder: Path, rebuild: Any) -> None:
    before, digest = contents(folder), record_hash(folder)
    first = rebuild("region=20,60,600,360")
    assert first["version"] == "derived-0001"
    assert first["derived"] == ["manifest.json", "report.html", "table.csv", "table.parquet"]
    one = contents(folder)
    assert {k: one[k] for k in before} == before
    assert rebuild("method=macro", "region=0,200,640,60")["version"] == "derived-0002"
    two = contents(folder)
    assert {k: two[k] for k in one} == one
    assert record_hash(folder) == digest
    assert verify(open_run(folder)) == []
    manifest = json.loads((folder / "derived-0002" / "manifest.json").read_text())
    assert manifest["pictures"]["camera"] == {"method": "macro", "region": [0, 200, 640, 60]}


def test_the_table_is_that_of_the_other_settings(
    folder: Path, rebuild: Any, tmp_path: Path
) -> None:
    run = open_run(folder)
    own = run.calibration("length_mm")
    other = tmp_path / "camera.toml"
    other.write_text(
        f'[calibration]\nquantity = "length_mm"\nunit = "mm"\nraw_unit = "pixel"\nid = "L-new"\n'
        f"offset = {own.offset + 1.0}\nscale = {own.scale * 1.01}\nu_offset = 0.03\n"
    )
    rebuild(f"calibration={other}")
    plain, changed = table(folder), table(folder, "derived-0001")
    pixels = (plain["length_mm"] - own.offset) / own.scale
    assert np.allclose(changed["length_mm"], own.offset + 1.0 + own.scale * 1.01 * pixels)
    assert (changed["u_length_mm_cal"] == 0.03).all()
    same = ["force_n", "pressure_kpa", "order", "set_length_mm"]
    pd.testing.assert_frame_equal(plain[same], changed[same])
    page = (folder / "derived-0001" / "report.html").read_text()
    assert "made with other settings for the pictures: calibration L-new" in page
    rebuild("method=macro", "flip=no", "threshold=100", "region=0,200,640,60")
    counted = (table(folder, "derived-0002")["length_mm"] - own.offset) / own.scale
    frames = 1e-9 + np.abs(counted - counted.round()).max()
    assert frames < 1e-6 or len(run.frames) > len(counted)


def test_later_annotations_leave_a_version_as_it_is(folder: Path, rebuild: Any) -> None:
    rebuild("region=whole")
    annotate(folder, "exclude", [1], "kinked", "A. Tester")
    assert [p for p in verify(open_run(folder)) if p.file.startswith("derived-")] == []
    rebuild("region=whole")
    assert (
        len(table(folder, "derived-0002"))
        == len(pd.read_csv(folder / "derived-0001/table.csv")) - 1
    )


def flip(folder: Path) -> None:
    path = folder / "derived-0001" / "table.csv"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


def exchange(folder: Path) -> None:
    shutil.rmtree(folder / "derived-0001")
    shutil.copytree(folder / "derived-0002", folder / "derived-0001")


def of_another_run(folder: Path) -> None:
    path = folder / "derived-0001" / "manifest.json"
    other = Run(folder).sealed("derived-0001/manifest.json")
    assert other is not None
    from daq.record.sealed import write_sealed

    write_sealed(path, {**other, "run_id": "20260101T000000Z_x_y_abcdef"}, durable=False)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (flip, "does not match the CRC"),
        (exchange, "is that of derived-0002"),
        (of_another_run, "belongs to run 20260101T000000Z_x_y_abcdef"),
        (lambda f: (f / "derived-0001" / "report.html").unlink(), "missing"),
        (lambda f: (f / "derived-0001" / "manifest.json").unlink(), "does not list this file"),
        (lambda f: (f / "derived-0001" / "more.csv").write_text("1"), "does not list this file"),
        (lambda f: shutil.rmtree(f / "derived-0001"), "a later derived version is there"),
    ],
)
def test_verify_covers_each_version(twice: Path, tmp_path: Path, change: Any, said: str) -> None:
    folder = Path(shutil.copytree(twice, tmp_path / twice.name))
    change(folder)
    found = verify(open_run(folder))
    assert found
    assert all(p.file.startswith("derived-0001") for p in found)
    assert any(said in p.what for p in found)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (["zoom=2"], "'zoom=2' is no setting"),
        (["region"], "'region' is no setting"),
        (["region=1,2"], "--vision region: expected left,top,width,height"),
        (["region=whole", "region=whole"], "is given twice"),
        (["method=guess"], "--vision method: 'guess' is not one of edge, macro"),
        (["method=macro", "threshold=-5"], "--vision threshold: expected a number from 0 to 255"),
        (["threshold=100"], "threshold is one of the macro"),
        (["calibration=none.toml"], "none.toml: not a calibration file"),
    ],
)
def test_a_setting_that_makes_no_sense_is_one_line(
    folder: Path, settings: list[str], said: str, monkeypatch: Any, capsys: Any
) -> None:
    words = [w for setting in settings for w in ("--vision", setting)]
    status, out, error = pamrig(["runs", "rebuild", str(folder), *words], monkeypatch, capsys)
    assert (status, out) == (2, "")
    assert error.startswith("pamrig: ")
    assert said in error
    assert error.count("\n") == 1
    assert not (folder / "derived-0001").exists()


def test_length_of_a_run_uses_its_own_frozen_calibration(
    folder: Path, monkeypatch: Any, capsys: Any
) -> None:
    """By folder, by part of its id, and as 'last'; the same lengths as the test had live."""
    run = open_run(folder)
    own = run.calibration("length_mm")
    live = {e["frame"]: e["pixels"] for e in run.events if e["kind"] == "length"}
    rows = []
    for name in (str(folder), folder.name[-6:], "last"):
        words = ["length", name, "--runs", str(folder.parent), "--json"]
        status, out, error = pamrig(words, monkeypatch, capsys)
        assert status == 0, error
        rows.append(json.loads(out))
    assert rows[0] == rows[1] == rows[2]
    measured = [row for row in rows[0] if row["frame"] in live]
    assert len(measured) > 2
    for row in measured:
        assert row["pixels"] == live[row["frame"]]
        assert row["length_mm"] == pytest.approx(own.offset + own.scale * row["pixels"], rel=1e-12)
        assert row["u_mm"] >= own.u_offset
