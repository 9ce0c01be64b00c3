"""What the commands of `pamrig gap` refuse, and that they do so before the work, in one line."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from typer.testing import CliRunner

from bench_runs import run_bench
from cli.main import app
from daq.errors import ConfigError, PamrigError
from daq.store.run import open_run
from gap.data.from_runs import export_runs
from gap.data.reader import read_dataset
from gap.errors import GapError
from gap_sets import settled_set
from rigs.rigfile.config import load_rig


def refused(*words: str) -> str:
    """The line that a command ends with; `pamrig` prints it and exits with status 2."""
    ran = CliRunner().invoke(app, ["gap", *words])
    assert isinstance(ran.exception, PamrigError), ran.output
    line = str(ran.exception)
    assert "\n" not in line
    return line


@pytest.mark.parametrize("ending", ["", "12", "12.3,"])
def test_a_table_that_ends_in_the_middle_of_a_row_is_refused(ending: str, tmp_path: Path) -> None:
    path = settled_set(tmp_path / "data", {}) / "samples.csv"
    whole = path.read_text().splitlines()
    path.write_text("\n".join([*whole[:100], f"t15,{ending}"]))
    with pytest.raises(GapError, match=r"samples.csv, row 101.*cut short"):
        read_dataset(path.parent)


def test_a_number_of_hundreds_of_digits_is_none(tmp_path: Path) -> None:
    """In a column of whole numbers it is read as one of those, and no float holds it."""
    path = settled_set(tmp_path / "data", {}) / "samples.csv"
    rows = [line.split(",") for line in path.read_text().splitlines()]
    at = rows[0].index("pressure_kpa")
    for row in rows[1:]:
        row[at] = "60"
    rows[1][at] = "9" * 400
    path.write_text("\n".join(map(",".join, rows)) + "\n")
    with pytest.raises(GapError, match=r"samples.csv, row 2, .*'9{40}' is not a number"):
        read_dataset(path.parent)


def test_a_last_row_without_an_end_of_line_is_a_row_if_it_has_all_values(tmp_path: Path) -> None:
    path = settled_set(tmp_path / "data", {}) / "samples.csv"
    path.write_text(path.read_text().rstrip("\n"))
    assert len(read_dataset(path.parent).trials) == 15


@pytest.mark.parametrize("command", ["where", "shrink", "next", "report"])
@pytest.mark.parametrize("out", ["folder", "file/made.svg"])
def test_a_file_that_cannot_be_written_is_told_before_the_diagnosis(
    command: str, out: str, tmp_path: Path
) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").write_text("")
    line = refused(command, str(tmp_path), "--out", str(tmp_path / out))
    assert line.startswith(f"{tmp_path / out}: cannot be written")


@pytest.mark.parametrize("name", ["picture", "picture.tiger"])
def test_a_picture_without_a_picture_s_ending_is_refused(name: str, tmp_path: Path) -> None:
    line = refused("where", str(tmp_path), "--out", str(tmp_path / name))
    assert "picture's ending" in line


@pytest.mark.parametrize("text", [None, "supply_kpa = [", "suply_kpa = 600", "[effects.ghost]"])
def test_a_plant_file_that_cannot_be_used_is_refused_before_the_first_test(
    text: str | None, tmp_path: Path
) -> None:
    path = tmp_path / "plant.toml"
    if text is not None:
        path.write_text(text)
    line = refused(
        "investigate", "--rig", "virtual", "--out", str(tmp_path / "runs"), "--plant", str(path)
    )
    assert line.startswith(str(path))
    assert not (tmp_path / "runs").exists()


def test_a_seed_that_no_bench_has_is_refused(tmp_path: Path) -> None:
    line = refused("investigate", "--rig", "virtual", "--out", str(tmp_path), "--seed", "-1")
    assert line.startswith("--seed")
    with pytest.raises(ConfigError, match="--seed"):
        load_rig("virtual", 2**63)
    ran = CliRunner().invoke(app, ["simulate", "held-steps", "--seed", "-1"])
    assert ran.exit_code == 2


def test_effects_that_a_plant_file_states_go_with_the_exported_runs(tmp_path: Path) -> None:
    """An improved plant, as `gap shrink --out` writes it, is known of the bench: it is no gap."""
    result, _, _ = run_bench(tmp_path / "runs", derive=False, repeats=1)
    plant = tmp_path / "plant.toml"
    plant.write_text(
        'supply_kpa = 640.0\noutlet_normally = "open"\n[effects.liner_threshold]\n'
        "threshold_kpa = 40.0\n"
    )
    made = export_runs([open_run(result.folder)], tmp_path / "data", plant=plant).folder
    assert tomllib.loads((made / "bench.toml").read_text()) == tomllib.loads(plant.read_text())
    assert read_dataset(made).effects.values["liner_threshold"]["threshold_kpa"] == 40.0


@pytest.mark.parametrize(
    ("factor", "says"), [("1e-300", "the trial lasts"), ("1e300", "far outside")]
)
def test_times_that_no_clock_has_are_refused(factor: str, says: str, tmp_path: Path) -> None:
    """`gap where` ended in a traceback: singular values did not converge."""
    (tmp_path / "trials.csv").write_text("trial\nt1\n")
    rows = [f"t1,{k}{factor[1:]},{5 * k}" for k in range(1, 40)]
    (tmp_path / "samples.csv").write_text("\n".join(["trial,time_s,pressure_kpa", *rows]) + "\n")
    assert says in refused("where", str(tmp_path))


@pytest.mark.parametrize("command", ["diagnose", "where", "shrink", "next", "report"])
def test_a_wrong_path_is_reported_before_anything_large_is_imported(
    command: str, tmp_path: Path
) -> None:
    for words, expected in (
        ((tmp_path / "nosuch",), "no such folder"),
        ((tmp_path, "--simulator", tmp_path / "nosuch.toml"), "no such file"),
    ):
        program = (
            "import sys\nfrom cli.main import main\ntry:\n    main()\nfinally:\n"
            "    print(*(n for n in ('numpy', 'numba', 'scipy', 'pandas') if n in sys.modules))"
        )
        done = subprocess.run(
            [sys.executable, "-c", program, "gap", command, *map(str, words)],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == 2
        assert expected in done.stderr
        assert done.stdout.strip() == ""
