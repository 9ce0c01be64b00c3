"""Everyday use of the command line: help, version, lists, `last`, and names of runs as data."""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pandas as pd
import pytest
from typer.testing import CliRunner

import pamrig
from analysis.formats.export import export_run
from analysis.formats.importer import import_points
from analysis.reporting.derived import derive_all
from bench_process import call_pamrig
from bench_runs import quick, run_isometric
from cli.main import app
from cli.protocols.resume import continue_run
from daq.clock import RealClock
from daq.errors import ConfigError
from daq.interrupt import StopFlag
from daq.store.run import Run, open_run
from daq.store.store import find_run, list_runs
from daq.version import version
from rigs.execution.runner import Watch
from rigs.protocols.isometric import load_isometric
from rigs.rigfile.config import load_rig

HOUSE = Path(__file__).resolve().parent.parent
POINTS = "length_mm,pressure_kpa,force_n\n60,100,4\n60,200,9\n60,300,14\n"


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A short test on the virtual bench, and after it an import."""
    root = tmp_path_factory.mktemp("runs")
    config = load_rig("virtual")
    plan = quick(config, lengths_mm=(60.0,), pressures_kpa=(100.0, 300.0))
    made = open_run(run_isometric(config, plan, root).folder)
    (root / "points.csv").write_text(POINTS, "utf-8")
    import_points(str(root / "points.csv"), root, RealClock())
    return made


def call(*words: str) -> str:
    done = CliRunner().invoke(app, list(words))
    assert done.exit_code == 0, f"{done.output}\n{done.exception!r}"
    return done.output


def test_the_version_stands_in_one_place() -> None:
    stated = tomllib.loads((HOUSE / "pyproject.toml").read_text("utf-8"))["project"]["version"]
    assert version() == stated
    assert call("--version") == f"pamrig {stated}\n"


@pytest.mark.parametrize("words", [(), ("isometric",), ("runs",), ("runs", "list"), ("gap",)])
def test_the_short_option_for_help_is_known_everywhere(words: tuple[str, ...]) -> None:
    assert call(*words, "-h") == call(*words, "--help")


def test_last_is_the_newest_test_and_not_an_import_after_it(run: Run) -> None:
    root = run.folder.parent
    assert [info.origin for info in list_runs(root)] == ["virtual", "import"]
    assert find_run(root, "last").run_id == run.run_id
    call("runs", "index", "--runs", str(root))
    assert [info.origin for info in list_runs(root)] == ["virtual", "import"]
    assert find_run(root, "last").run_id == run.run_id


def test_last_is_an_import_where_there_is_nothing_else(tmp_path: Path) -> None:
    (tmp_path / "points.csv").write_text(POINTS, "utf-8")
    folder = import_points(str(tmp_path / "points.csv"), tmp_path, RealClock())
    assert find_run(tmp_path, "last").run_id == folder.name


def test_a_list_of_runs_has_a_header_over_its_columns(run: Run) -> None:
    head, first, _ = call("runs", "list", "--runs", str(run.folder.parent)).splitlines()
    assert head.split() == ["outcome", "duration", "origin", "protocol", "specimen", "run"]
    assert first[head.index("protocol") :].startswith("isometric")
    assert first[head.rindex("run") :] == run.run_id


def test_the_folder_of_runs_has_one_option_in_every_command() -> None:
    for words in ("isometric", "report", "doctor", "simulate", "import thesis", "runs list"):
        assert "--runs" in call(*words.split(), "--help"), words


def test_a_diagnosis_takes_a_run_by_its_name(run: Run) -> None:
    told = call("gap", "where", "last", "--runs", str(run.folder.parent))
    assert told == call("gap", "where", str(run.folder))


def test_a_folder_that_is_missing_is_reported_before_anything_large_is_loaded(
    tmp_path: Path,
) -> None:
    look = "import sys; from cli.gap.paths import data_folder; from pathlib import Path\n"
    look += "try: data_folder('nowhere', Path('runs'), None)\n"
    look += "except Exception as e: print(e, *{'numba', 'scipy', 'pandas'} & set(sys.modules))"
    done = subprocess.run(
        [sys.executable, "-c", look], cwd=tmp_path, capture_output=True, text=True, check=True,
        env={**os.environ, "PYTHONPATH": str(HOUSE)},
    )  # fmt: skip
    assert done.stdout == (
        "nowhere: no such folder, and no runs match in runs (pamrig runs list shows all runs)\n"
    )


def test_an_exclusion_makes_table_and_report_again_and_leaves_samples_and_view(run: Run) -> None:
    derived = derive_all(run.folder).folder / "derived"
    before = {p.name: p.read_bytes() for p in derived.iterdir() if p.is_file()}
    call("runs", "exclude", str(run.folder), "--points", "1", "--reason", "touched")
    after = {p.name: p.read_bytes() for p in derived.iterdir() if p.is_file()}
    assert after.keys() == before.keys()
    changed = {name for name in after if after[name] != before[name]}
    assert changed == {"table.csv", "table.parquet", "report.html", "manifest.json"}
    call("runs", "verify", str(run.folder))
    call("runs", "include", str(run.folder), "--points", "1", "--reason", "it was not")


def test_a_damaged_file_of_samples_is_not_taken_over(run: Run) -> None:
    derived = derive_all(run.folder).folder / "derived"
    whole = (derived / "samples.parquet").read_bytes()
    (derived / "samples.parquet").write_bytes(whole[:-1] + b"x")
    derive_all(run.folder, only_results=True)
    assert (derived / "samples.parquet").read_bytes() == whole


def test_samples_written_as_csv_are_read_again_to_the_last_digit(run: Run, tmp_path: Path) -> None:
    export_run(run, "csv", tmp_path, "samples")
    read = pd.read_csv(tmp_path / "samples.csv")
    samples = pamrig.RecordedRun(run).samples
    assert list(read) == list(samples), "one name for a column, here and there"
    assert {"inlet_cmd", "outlet_cmd"} <= set(read)
    pd.testing.assert_frame_equal(read, samples, check_exact=True, check_dtype=False)


def test_force_and_pressure_stand_in_one_table(run: Run) -> None:
    recorded = pamrig.RecordedRun(run)
    joined = recorded.joined
    assert len(joined) == len(recorded.samples)
    balance = recorded.stream("balance")
    row = joined.iloc[len(joined) // 2]
    newest = balance[balance["time_s"] <= row["time_s"]].iloc[-1]
    assert row["force_n"] == newest["force_n"]
    assert 0 <= row["time_s"] - newest["time_s"] < 0.2


def test_a_continued_test_is_shown_live(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    config = load_rig("virtual")
    stop = StopFlag()
    begun = run_isometric(
        config, load_isometric("isometric-short", config.limits), tmp_path, derive=False,
        stop=stop, watch=Watch(point=lambda *_: stop.set("stop requested")),
    )  # fmt: skip
    assert begun.outcome == "stopped"
    ended = continue_run(open_run(begun.folder), live=True, browser=False)
    assert ended.outcome == "clean", ended.error
    assert "live view: " in capfd.readouterr().err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("frobnicate", "no such command 'frobnicate' (pamrig --help shows how it is used)"),
        ("isometric --sed 3", "isometric: no such option: --sed"),
        ("isometric --seed x", "isometric: invalid value for '--seed'"),
        ("init protocol", "init protocol: missing argument 'test'"),
        ("isometric extra", "isometric: got unexpected extra argument"),
    ],
)
def test_a_wrong_command_line_is_one_line_and_status_2(words: str, said: str) -> None:
    done = call_pamrig(*words.split())
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith(f"pamrig: {said}")
    assert done.stderr.count("\n") == 1
    assert "--help shows how it is used)" in done.stderr


def test_a_group_without_a_command_prints_its_help() -> None:
    done = call_pamrig("runs")
    assert done.returncode == 2
    assert "List all runs" in done.stdout + done.stderr


@pytest.mark.parametrize("command", ["list", "find", "index"])
def test_a_folder_of_runs_that_is_not_there_is_no_empty_list(command: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="nowhere: there is no such folder"):
        CliRunner().invoke(
            app, ["runs", command, "--runs", str(tmp_path / "nowhere")], catch_exceptions=False
        )
    assert not list(tmp_path.iterdir())
