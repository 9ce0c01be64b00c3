"""What is made from a damaged or exchanged record refuses it, or states what the check found."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

import pamrig
from bench_runs import run_bench
from cli.main import app

INDEX = "samples/valve.index.jsonl"


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Two runs of the same test, of different benches."""
    root = tmp_path_factory.mktemp("readers")
    first, second = (run_bench(root, seed=seed, repeats=1)[0].folder for seed in (1, 2))
    return first, second


COMMANDS = {
    "report": ("report", "{run}", "--json"),
    "runs export": ("runs", "export", "{run}", "--out", "{out}", "--json"),
    "gap export": ("gap", "export", "{run}", "--out", "{out}", "--json"),
    "runs rebuild": ("runs", "rebuild", "{run}", "--json"),
}


def command(name: str, run: Path, out: Path) -> tuple[int, str, str]:
    """Exit status, standard output, and the error or what was printed beside it."""
    words = [word.format(run=run, out=out) for word in COMMANDS[name]]
    done = CliRunner().invoke(app, words)
    return done.exit_code, done.stdout, str(done.exception or done.stderr)


@pytest.mark.parametrize("name", COMMANDS)
def test_a_file_of_another_run_is_refused(
    name: str, runs: tuple[Path, Path], tmp_path: Path
) -> None:
    """Each was sound by its own sums, and was reduced as if it were this run's."""
    for file in ("events.jsonl", INDEX, "run.json", "final.json"):
        own = tmp_path / file.replace("/", "-") / runs[0].name
        shutil.copytree(runs[0], own)
        (own / file).write_bytes((runs[1] / file).read_bytes())
        status, out, said = command(name, own, tmp_path / f"out-{file.replace('/', '-')}")
        if status == 0:  # a stream is left out, and its points have no pressure
            assert file == INDEX
            said = str(json.loads(out)["problems"])
            assert {p["pressure_kpa"] for p in json.loads(out).get("points", ())} <= {None}
        assert file in said


@pytest.mark.parametrize("name", COMMANDS)
def test_damage_is_stated_in_what_is_made(
    name: str, runs: tuple[Path, Path], tmp_path: Path
) -> None:
    """Bytes of one chunk are damaged: its rows are left out, and the output says so."""
    own = tmp_path / runs[0].name
    shutil.copytree(runs[0], own)
    segment = own / "samples/valve/000001.arrows"
    data = bytearray(segment.read_bytes())
    data[3000] ^= 1
    segment.write_bytes(data)
    (own / "balance-notes.txt").write_text("not of the record")
    status, out, _ = command(name, own, tmp_path / "out")
    assert status == 0
    problems = json.loads(out)["problems"]
    assert any("000001.arrows" in text and "CRC" in text for text in problems)
    assert any("balance-notes.txt" in text and "does not list" in text for text in problems)
    if name == "runs export":
        assert json.loads((tmp_path / "out/README.json").read_text())["problems"] == problems
    if name == "gap export":
        assert "findings in its record" in (tmp_path / "out/trials.csv").read_text()


def test_a_sound_record_states_nothing(runs: tuple[Path, Path], tmp_path: Path) -> None:
    for name in COMMANDS:
        status, out, _ = command(name, runs[0], tmp_path / name)
        assert (status, json.loads(out)["problems"]) == (0, [])
    assert pamrig.open_run(runs[0]).problems == ()


def test_a_notebook_is_warned(runs: tuple[Path, Path], tmp_path: Path) -> None:
    own = tmp_path / runs[0].name
    shutil.copytree(runs[0], own)
    (own / "frames/000001.mjpg").unlink()
    with pytest.warns(UserWarning, match=r"frames/000001\.mjpg"):
        opened = pamrig.open_run(own)
    assert opened.problems != ()
