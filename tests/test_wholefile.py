"""A file takes its name only when it is whole; whatever interrupts the command."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest

from bench_runs import quick, run_isometric
from daq.store.run import open_run
from daq.wholefile import whole_files, write_whole
from rigs.rigfile.config import load_rig


def test_files_take_their_names_together(tmp_path: Path) -> None:
    first, second = tmp_path / "a.txt", tmp_path / "b.txt"
    with whole_files() as part:
        part(first).write_text("1")
        part(second).write_text("2")
        assert not first.exists()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.txt", "b.txt"]


def test_an_interruption_leaves_what_stood_there(tmp_path: Path) -> None:
    old, new = tmp_path / "old.txt", tmp_path / "new.txt"
    write_whole(old, "before\n")

    def interrupted() -> None:
        with whole_files() as part:
            part(old).write_text("aft")
            part(new).write_text("x")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert [p.name for p in tmp_path.iterdir()] == ["old.txt"]
    assert old.read_bytes() == b"before\n"


def test_what_is_no_file_is_written_directly(tmp_path: Path) -> None:
    write_whole(Path("/dev/null"), "gone")
    assert not Path("/dev/null").is_file()
    with pytest.raises(IsADirectoryError):
        write_whole(tmp_path, "x")


@pytest.mark.parametrize("kind", ["csv", "parquet", "mat"])
def test_ctrl_c_in_an_export_leaves_no_file(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from analysis.formats import export

    config = load_rig("virtual")
    run = open_run(run_isometric(config, quick(config), tmp_path / "runs").folder)
    written = 0

    def interrupted(*args: object, **more: object) -> None:
        nonlocal written
        written += 1
        target = args[0] if kind == "mat" else args[1]
        if hasattr(target, "write"):
            target.write(b"half")
        else:
            Path(str(target)).write_bytes(b"half")
        if kind == "mat" or written == 2:
            raise KeyboardInterrupt

    if kind == "csv":
        monkeypatch.setattr(export, "write_csv", interrupted)
    elif kind == "parquet":
        monkeypatch.setattr(pd.DataFrame, "to_parquet", interrupted)
    else:
        monkeypatch.setattr("scipy.io.savemat", interrupted)
    out = tmp_path / "out"
    with pytest.raises(KeyboardInterrupt):
        export.export_run(run, kind, out)
    assert list(out.iterdir()) == []
    assert written >= 1
