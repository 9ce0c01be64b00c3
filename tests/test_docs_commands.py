"""Every command in README and docs is run as it stands there."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from cli.main import command_line
from import_sets import prepare_page
from plant.models import catalogue
from rigs.rigfile.config import load_rig
from rigs.rigfile.toml_reader import find_config

HOUSE = Path(__file__).resolve().parent.parent
PAGES = [
    "README.md",
    *sorted(p.relative_to(HOUSE).as_posix() for p in (HOUSE / "docs").rglob("*.md")),
]
# What a reader puts in for himself.
PLACES = {"RUN": "last", "runs/<run>": "last"}
# These serve until they are stopped.
SERVING = ("pamrig view", "--live")


def commands(page: str) -> list[str]:
    """Indented or fenced lines that begin with `pamrig`, without their comments."""
    text = (HOUSE / page).read_text(encoding="utf-8")
    lines = re.findall(r"^(?: {4}|\$ )(pamrig .*)$", text, flags=re.MULTILINE)
    return [re.sub(r"\s+#.*$", "", line).strip() for line in lines]


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder as a reader has it: own rig and protocol, own points, own pictures, one run."""
    folder = tmp_path_factory.mktemp("desk")
    (folder / "mybench.toml").write_text(load_rig("virtual").text)
    (folder / "mytest.toml").write_text(find_config("isometric-short", "protocols")[0])
    rows = [f"{p},{60 + k},{p * 0.07 + k:.3f}" for k in range(3) for p in (200, 300, 400)]
    (folder / "mine.csv").write_text("pressure_kpa,length_mm,force_n\n" + "\n".join(rows) + "\n")
    prepare_page(folder)
    (folder / "big.csv").write_text(large_muscle())
    for example in ("simulators/first", "protocols"):
        shutil.copytree(HOUSE / "docs" / "examples" / example, folder, dirs_exist_ok=True)
    for words in (("make_bench.py", "bench.csv"), ("convert.py", "bench.csv", "mydata")):
        subprocess.run([sys.executable, *words], cwd=folder, check=True, timeout=900)
    run(folder, "pamrig isometric --protocol isometric-short")
    prepare = HOUSE / "tests" / "docs_pictures.py"
    if prepare.exists():
        subprocess.run([sys.executable, str(prepare), str(folder)], check=True, timeout=900)
    return folder


def large_muscle() -> str:
    """Settled points of a muscle of 10 mm and 250 mm, slack where its force would be negative."""
    p, x = np.meshgrid(np.linspace(50e3, 650e3, 13), np.linspace(0.2, 0.25, 6), indexing="ij")
    law = catalogue.get("fluidic").with_values(
        {"radius": 7.2, "braid_angle": 29.0, "rest_length": 250.0, "elastic_force": 150.0,
         "elastic_strain": 2.5, "offset_force": 188.0}
    )  # fmt: skip
    force = law.force(p, x, outside="ignore") + np.random.default_rng(1).normal(size=p.shape)
    rows = zip(p.ravel() / 1e3, x.ravel() * 1e3, np.maximum(force, 0.0).ravel(), strict=True)
    text = "\n".join(f"{a:.1f},{b:.1f},{c:.2f}" for a, b, c in rows)
    return f"pressure_kpa,length_mm,force_n\n{text}\n"


def argv(command: str) -> list[str]:
    words = [PLACES.get(word, word) for word in shlex.split(command)]
    return [sys.executable, "-m", "cli.main", *words[1:]]


def run(folder: Path, command: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        argv(command), cwd=folder, text=True, capture_output=True, timeout=900, check=False
    )


ONCE = ("pamrig gap check", "pamrig gap effects", "pamrig import thesis")
"""What several pages show and what says the same each time: once at each desk is enough."""


@pytest.fixture(scope="module")
def done_once() -> set[str]:
    """Commands of that kind that have been run."""
    return set()


@pytest.mark.campaign  # minutes of computing; `make test` checks that each command exists
@pytest.mark.parametrize("page", PAGES)
def test_every_command_of_the_page_works(page: str, desk: Path, done_once: set[str]) -> None:
    run(desk, "pamrig isometric --protocol isometric-short")  # `last` is a test with pictures
    for command in commands(page):
        if "[OPTIONS]" in command:
            continue  # the form of a command, on the page that is made from the program
        if command.startswith(ONCE):
            if command in done_once:
                continue
            done_once.add(command)
        if "pamrig view" in command:
            serve(desk, command)
            continue
        if "--live" in command:
            command += " --no-browser"
        done = run(desk, command)
        assert done.returncode == 0, f"{page}: {command}\n{done.stdout}\n{done.stderr}"


def heed_ctrl_c() -> None:
    """Undo what a shell does that runs tests in the background: it has Ctrl-C ignored."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def serve(folder: Path, command: str) -> None:
    """Run a command that goes on until Ctrl-C, and end it so once it has said something."""
    process = subprocess.Popen(
        argv(command),
        cwd=folder,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        preexec_fn=heed_ctrl_c if os.name == "posix" else None,
    )
    assert process.stdout is not None
    try:
        first = process.stdout.readline()
        time.sleep(1.0)
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
        rest, _ = process.communicate(timeout=300)
    finally:
        process.terminate()
        process.wait(timeout=300)
        process.stdout.close()
    assert "127.0.0.1" in first + rest, f"{command}\n{first}{rest}"
    assert "Traceback" not in rest


@pytest.mark.parametrize("page", PAGES)
def test_every_command_of_the_page_exists_with_its_options(page: str) -> None:
    for line in commands(page):
        words = [PLACES.get(word, word) for word in shlex.split(line)][1:]
        command = command_line()
        while hasattr(command, "commands") and words and words[0] in command.commands:
            command = command.commands[words.pop(0)]
        known = {option for parameter in command.params for option in parameter.opts}
        known |= {o for parameter in command.params for o in parameter.secondary_opts} | {"--help"}
        used = {word.partition("=")[0] for word in words if word.startswith("--")}
        assert used <= known, f"{page}: {line}: {used - known}"
        assert not hasattr(command, "commands") or not words or used, f"{page}: {line}"


def test_the_pages_have_commands() -> None:
    """The pattern above still finds what it is for."""
    assert len(commands("README.md")) >= 5
    assert shutil.which("make")


def test_every_link_leads_somewhere() -> None:
    for page in PAGES:
        text = (HOUSE / page).read_text(encoding="utf-8")
        for target in re.findall(r"\]\(([^)#:]+)\)", text):
            assert ((HOUSE / page).parent / target).exists(), f"{page}: {target}"
