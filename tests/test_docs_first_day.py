"""The technician's first day, run as its page tells it: every command, every prompt answered."""

from __future__ import annotations

import os
import pty
import re
import select
import subprocess
import sys
import time
from pathlib import Path

import pytest

from analysis.run_table import reduce_run
from daq.store.run import Run, open_run
from daq.store.store import list_runs
from daq.store.verify import verify
from rigs.execution.session import run_protocol
from rigs.protocols.registry import procedure
from rigs.rigfile.config import load_rig

HOUSE = Path(__file__).resolve().parent.parent
PAGE = HOUSE / "docs" / "start" / "first-day.md"
ANSWER_S = 300.0
QUESTION = re.compile(r">> (.*?press Enter.*?)\r?\n", re.DOTALL)

pytestmark = pytest.mark.skipif(os.name != "posix", reason="needs a pseudo-terminal")


def blocks(kind: str) -> list[str]:
    """The page's fenced blocks of a kind, in order."""
    return re.findall(rf"^```{kind}\n(.*?)^```", PAGE.read_text("utf-8"), re.MULTILINE | re.DOTALL)


def commands() -> list[str]:
    """Every line of the page's shell blocks, in order."""
    lines = [line for block in blocks("sh") for line in block.splitlines()]
    return [re.sub(r"\s+#.*$", "", line).strip() for line in lines if line.strip()]


class Desk:
    """A terminal in a folder of its own, and somebody who does what the program asks for."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        shim = folder / "bin" / "pamrig"
        shim.parent.mkdir()
        shim.write_text(f'#!/bin/sh\nexec {sys.executable} -m cli.main "$@"\n')
        shim.chmod(0o755)
        self.environment = {
            **os.environ,
            "PATH": f"{shim.parent}{os.pathsep}{os.environ['PATH']}",
            "PYTHONPATH": str(HOUSE),
        }

    def type(self, command: str) -> tuple[str, list[str]]:
        """Run a command on a pseudo-terminal; what it printed, and what it asked for.

        Every question is answered by Enter, once it has been put.
        """
        ours, theirs = pty.openpty()
        program = subprocess.Popen(
            ["sh", "-c", command], cwd=self.folder, env=self.environment,
            stdin=theirs, stdout=theirs, stderr=theirs, start_new_session=True,
        )  # fmt: skip
        os.close(theirs)
        text, asked = "", []
        end = time.monotonic() + ANSWER_S
        try:
            while True:
                assert time.monotonic() < end, f"{command}\n{text}"
                if not select.select([ours], [], [], 1.0)[0]:
                    continue
                try:
                    data = os.read(ours, 65536)
                except OSError:  # Linux: the other side is closed
                    data = b""
                if not data:
                    break
                text += data.decode(errors="replace")
                while len(questions := QUESTION.findall(text)) > len(asked):
                    asked.append(questions[len(asked)])
                    os.write(ours, b"\n")
        finally:
            os.close(ours)
            if program.poll() is None:
                program.kill() if time.monotonic() >= end else None
            status = program.wait(60)
        assert status == 0, f"{command}\n{text}"
        assert "Traceback" not in text, text
        assert "Fatal" not in text, text
        return text, asked


def put_in(folder: Path) -> None:
    """What the page says about the rig file: each of its tables takes the place of the old one."""
    path = folder / "mybench.toml"
    for block in blocks("toml"):
        text = path.read_text("utf-8")
        head = block.splitlines()[0]
        if head == "[load_cell]":  # the cell's own lines, for those that stated its uncertainty
            own = "u_offset = 0.2              # N\nu_gain = 0.003\n"
            begin = text.index("[load_cell]")
            text = text[:begin] + text[begin:].replace(own, block.partition("\n")[2], 1)
            begin = text.index("[calibrations.force_n]")
            text = text[:begin] + text[text.index("\n[", begin) + 1 :]
        else:
            begin = text.index(head)
            text = text[:begin] + block + "\n" + text[text.index("\n[", begin) + 1 :]
        path.write_text(text, "utf-8")


def the_run(folder: Path) -> Run:
    """The one test of the day."""
    (info,) = list_runs(folder / "runs")
    return open_run(info.folder)


def test_the_first_day_goes_as_its_page_tells(tmp_path: Path) -> None:
    desk = Desk(tmp_path)
    said: dict[str, tuple[str, list[str]]] = {}
    for command in commands():
        if command.startswith(("git ", "make ", "cd ", "source ")):
            continue  # unpacking: `test_what_the_page_unpacks_is_there`
        if command.startswith("pamrig doctor") and (tmp_path / "force.toml").exists():
            put_in(tmp_path)
        said[command] = desk.type(command)
    by = {" ".join(command.split()[:3]): result for command, result in said.items()}

    assert "ready to run" in by["pamrig doctor --rig"][0]
    text, asked = by["pamrig calibrate force"]
    assert asked[0].startswith("take the muscle off the load cell")
    assert [a.partition(" on the")[0].partition(", then")[0] for a in asked[1:-1]] == [
        "hang 1 kg", "hang 2 kg in all", "hang 5 kg in all",
        "take weights off: leave 2 kg", "take weights off: leave 1 kg", "take all weights off",
    ], "no weight is to be taken off before one hangs"  # fmt: skip
    assert asked[-1].startswith("mount the muscle again")
    assert "linear within" in text
    rig = load_rig(str(tmp_path / "mybench.toml"))
    assert rig.calibrations["force_n"].id.startswith("F-")
    assert rig.calibrations["pressure_kpa"].id.startswith("P-VB-0007-")
    assert not rig.calibrations["pressure_kpa"].id.startswith("P-2026-01")

    asked = by["pamrig isotonic --rig"][1]
    hangs = [a for a in asked if a.startswith("hang")]
    assert [a.partition(" on the")[0] for a in hangs] == ["hang 0.714 kg", "hang 1.154 kg in all"]
    assert sum("set the catch 3 mm below the load" in a for a in asked) == 2
    assert asked[-1].startswith("take the load off")

    run = the_run(tmp_path)
    assert run.outcome == "clean"
    assert verify(run) == []
    loads = [e for e in run.events if e["kind"] == "load"]
    assert [e["mass_kg"] for e in loads] == [0.714, 1.154, 0.0]
    for event in loads:  # the marked mass counts, the load cell only says that it hangs
        assert event["checked_by"] == "load_cell"
        assert abs(event["checked_kg"] - event["mass_kg"]) < 0.15
    table = reduce_run(run).table
    assert sorted(set(table["mass_kg"])) == [0.714, 1.154]
    heavier = table.groupby("mass_kg")["length_mm"].min()
    assert heavier[0.714] < heavier[1.154], "the heavier load is lifted less far"
    assert run.manifest["specimen"] == "muscle-7"
    page = (tmp_path / "report.html").read_text("utf-8")
    assert "A. Tester" in page
    assert "0.714" in page


def test_what_the_page_unpacks_is_there() -> None:
    made = subprocess.run(
        ["make", "--dry-run", "demo"], cwd=HOUSE, capture_output=True, text=True, check=False
    )
    assert made.returncode == 0, made.stderr
    assert "make demo" in commands()


def test_nobody_at_the_terminal_ends_the_test_instead_of_waiting_for_ever(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = load_rig("virtual-weights")
    kind = procedure("isotonic")
    with Path(os.devnull).open() as nobody:
        monkeypatch.setattr(sys, "stdin", nobody)
        result = run_protocol(kind, config, kind.read("isotonic-short", config), tmp_path)
    assert result.outcome == "faulted"
    assert "nobody answers" in str(result.error)
    assert [e for e in open_run(result.folder).events if e["kind"] == "vented"]
