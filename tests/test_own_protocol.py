"""Protocols and drivers of a user: in a file, and in a package outside the repository."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from bench_process import call_pamrig
from cli.protocols.resume import same_test
from daq.errors import ConfigError
from daq.store.run import open_run
from daq.store.verify import verify
from rigs.protocols.registry import procedure
from rigs.rigfile.config import load_rig

HOUSE = Path(__file__).resolve().parent.parent
EXAMPLE = HOUSE / "docs" / "examples" / "protocols"
HEAD = """
from dataclasses import dataclass
from pamrig.protocol import *

@dataclass(frozen=True, kw_only=True)
class Mine(OwnTest):
    length_mm: float = 60.0
"""
STEPS = """
    def steps(self):
        yield State("nothing")
"""


@pytest.fixture(scope="module")
def relaxed(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, object], Path]:
    """The example, run on the virtual bench: its report and its record."""
    runs = tmp_path_factory.mktemp("runs")
    done = call_pamrig(
        "test", EXAMPLE / "holding.py", "--protocol", EXAMPLE / "holding.toml",
        "--out", runs, "--json",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    (folder,) = (path for path in runs.iterdir() if path.is_dir())
    return json.loads(done.stdout), folder


def test_the_example_records_reduces_and_reports(relaxed: tuple[dict[str, object], Path]) -> None:
    report, folder = relaxed
    run = open_run(folder)
    assert (run.outcome, run.manifest["protocol"]) == ("clean", "holding")
    assert run.manifest["parameters"]["waits_s"] == [0.5, 1.0]
    assert verify(run) == []
    assert report["title"] == "Holding test"
    points = report["points"]
    assert isinstance(points, list)
    assert [p["set_pressure_kpa"] for p in points] == [200, 200, 400, 400]
    assert all(p["settled"] for p in points)


def test_the_example_is_as_short_as_the_page_says() -> None:
    text = (EXAMPLE / "holding.py").read_text()
    assert sum(bool(line.strip()) for line in text.splitlines()) <= 30
    page = (HOUSE / "docs" / "use" / "own-protocols.md").read_text()
    assert text.split('"""', 2)[2].strip() in page


def test_a_record_cannot_name_a_file_to_run(relaxed: tuple[dict[str, object], Path]) -> None:
    """It is reduced without the user's file, and not continued."""
    folder = relaxed[1]
    assert call_pamrig("report", folder).returncode == 0
    with pytest.raises(ConfigError, match="not a protocol of this version or of an installed"):
        same_test(open_run(folder))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (HEAD + STEPS + "  oops\n", r"mine\.py \(line 11\): cannot be run: IndentationError"),
        ("import no_such_module\n", r"\(line 1\): cannot be run: ModuleNotFoundError"),
        ("raise SystemExit(3)\n", r"\(line 1\): cannot be run: SystemExit: 3"),
        ("x = 1\n", "expected one class derived from OwnTest, found none"),
        (HEAD + STEPS + HEAD.replace("Mine", "Other") + STEPS, "found Mine, Other"),
        (HEAD + "    what: object = None\n" + STEPS, "what: .*is not read from a file"),
        (HEAD + "    protocol = 'isometric'\n" + STEPS, "'isometric' cannot name a protocol"),
    ],
)
def test_a_file_that_cannot_be_used_says_where(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "mine.py"
    path.write_text(text)
    with pytest.raises(ConfigError, match=words):
        procedure(str(path))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('protocol = "mine"\nlength_mm = 500', "length_mm: 500 mm is outside 51 to 72.5"),
        ('protocol = "mine"\nlenght_mm = 60', "lenght_mm"),
        ('protocol = "holding"', "is 'holding', and this command runs 'mine'"),
        ('protocol = "mine"\nlength_mm = "long"', "expected a number in mm, got 'long'"),
    ],
)
def test_its_protocol_file_is_held_against_the_rig(tmp_path: Path, text: str, words: str) -> None:
    path, values = tmp_path / "mine.py", tmp_path / "mine.toml"
    path.write_text(HEAD + STEPS)
    values.write_text(text)
    with pytest.raises(ConfigError, match=words):
        procedure(str(path)).read(str(values), load_rig("virtual"))


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    done = call_pamrig("test", tmp_path / "none.py")
    assert done.returncode == 2
    assert "none.py: no such file" in done.stderr


# ---- a package outside the repository ----------------------------------------------------

ENTRY_POINTS = """[pamrig.protocols]
holding = lab_bench.holding:Holding
[pamrig.analyses]
holding = lab_bench.analysis:ANALYSIS
[pamrig.pressure_sources]
lab-regulator = lab_bench.regulator
"""
ANALYSIS = """
from dataclasses import replace
from pamrig.protocol import Findings, points_analysis

def findings(run, reduction):
    forces = reduction.table.groupby("slot")["force_n"]
    loss = (forces.first() - forces.last()).max()
    return Findings(f"The force relaxes by up to {loss:.2f} N.", data={"loss_n": float(loss)})

ANALYSIS = replace(points_analysis("holding", "Held muscle"), findings=findings)
"""
REGULATOR = """
from rigs.devices.instruments.commanded import CommandedInstrument
from rigs.devices.pressure.behind_valves import BehindValves
from rigs.devices.pressure.regulator_output import RegulatorOutput
from rigs.rigfile.command_form import load_command_form

class LabRegulator(BehindValves):
    def __init__(self, valves, device):
        super().__init__(valves)
        self._device = self.own_device = device

    @property
    def identity(self):
        return self._device.identity

    def set_pressure(self, pressure_kpa):
        command = super().set_pressure(pressure_kpa)
        self._device.set("pressure_bar", pressure_kpa / 100)
        return command

def open_source(parts):
    table = parts.config.pressure_source.table()
    form = load_command_form(table.text("form"))
    table.finish()
    device = CommandedInstrument(parts.open_link(), parts.event_loop, "pressure_source", form)
    parts.event_loop.add(device.poll)
    device.connect(parts.config.pressure_source.serial)
    return LabRegulator(RegulatorOutput(parts.valve, parts.config), device)

class Emulated:
    next_ns = None

    def __init__(self, send):
        self._send, self._buffer = send, b""

    def feed(self, data):
        *lines, self._buffer = (self._buffer + data).split(b"\\r")
        for line in lines:
            if line.startswith(b"P="):
                self._value = line[2:]
                self._send(b"OK\\r\\n")
            else:
                self._send({b"P?": b"P=" + getattr(self, "_value", b"0.00"), b"ID?": b"ID=LAB-1"}
                           .get(line, b"ERR") + b"\\r\\n")

    def advance(self, to_ns):
        pass

def emulator(settings, plant, send):
    return Emulated(send)
"""
FORM = r"""
name = "lab regulator"
end = "cr"
timeout_s = 0.2
identify = "ID?"
identify_pattern = 'ID=(?P<serial>[\w-]+)'

[set.pressure_bar]
command = "P={value:.2f}"
unit = "bar"
low = 0.0
high = 7.0
reply = 'OK'
read_back = "P?"
pattern = 'P=(?P<value>\d+\.\d\d)'
tolerance = 0.01
"""


def test_a_package_brings_a_protocol_its_report_and_a_pressure_source(tmp_path: Path) -> None:
    site, desk = tmp_path / "site", tmp_path / "desk"
    package = site / "lab_bench"
    package.mkdir(parents=True)
    desk.mkdir()
    (package / "__init__.py").write_text("")
    (package / "holding.py").write_text((EXAMPLE / "holding.py").read_text())
    (package / "analysis.py").write_text(ANALYSIS)
    (package / "regulator.py").write_text(REGULATOR)
    info = site / "lab_bench-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: lab-bench\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(ENTRY_POINTS)
    (desk / "lab.toml").write_text(FORM)
    table = (
        '[pressure_source]\nkind = "lab-regulator"\nport = "virtual"\nserial = "LAB-1"\n'
        'form = "lab.toml"\n\n[balance]'
    )
    (desk / "rig.toml").write_text(load_rig("virtual-thesis").text.replace("[balance]", table, 1))
    (desk / "short.toml").write_text(
        (EXAMPLE / "holding.toml").read_text().replace("[200, 400]", "[200]")
    )
    path = os.pathsep.join([str(site), str(HOUSE), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, "-m", "cli.main", "test", "holding", "--rig", "rig.toml",
         "--protocol", "short.toml", "--json"],
        cwd=desk, env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True,
        check=False, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert report["title"] == "Held muscle"
    assert report["headline"].startswith("The force relaxes by up to")
    assert report["devices"]["pressure_source"]["serial"] == "LAB-1"
    assert report["outcome"] == "clean"
