"""`pamrig init`: rig files and protocol files from questions, and the search for devices."""

from __future__ import annotations

import io
import itertools
import json
import re
import sys
import threading
import time
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from bench_process import call_pamrig
from daq.errors import ConfigError
from daq.link.ports import PortInfo
from protocol_runs import run_short
from rigs.bench.doctor import examine
from rigs.protocols.names import PROTOCOLS, default_rig
from rigs.protocols.registry import procedure
from rigs.rigfile.config import load_rig
from rigs.setup.protocol_file import ask_protocol, entries
from rigs.setup.questions import Interview
from rigs.setup.rig_file import FORCE, LENGTH, PRESSURE, SENSOR, STAGE, Surroundings, ask_rig
from rigs.setup.search import cameras, search
from rigs.virtual.server import open_server

HOUSE = Path(__file__).resolve().parent.parent
NOTHING = Surroundings(ports=list, search=lambda *_: pytest.fail("nobody allowed this"))


def combinations() -> Iterator[dict[str, str]]:
    """Every word of every choice at least once, and each pressure with each sensor."""
    for pressure, sensor in itertools.product(PRESSURE, SENSOR):
        if sensor != "card" or pressure == "card":
            yield {"pressure": pressure, "sensor": sensor}
    yield {"pressure": "card", "card": "nidaqmx"}
    for key, words in (("force", FORCE), ("stage", STAGE), ("length", LENGTH)):
        yield from ({key: word} for word in words)


ALL = list(combinations())


def made(folder: Path, **given: Any) -> str:
    path = folder / "rig.toml"
    path.write_text(ask_rig(Interview(given), NOTHING))
    return str(path)


@pytest.mark.parametrize("given", ALL, ids=lambda given: "-".join(given.values()))
def test_every_bench_that_can_be_answered_is_a_rig_file(
    given: dict[str, str], tmp_path: Path
) -> None:
    """On ports that are not there the reader accepts it; simulated, the doctor finds no fault."""
    real = load_rig(made(tmp_path, **given))
    assert not real.is_virtual
    assert "not calibrated" in real.text
    for line in real.text.splitlines():  # what is left open says what to enter
        assert not line.rstrip().endswith('""')
        assert not line.startswith("serial")
    rig = made(tmp_path, **given, bench="virtual")
    stops = [f for f in examine(rig, tmp_path) if f.status == "stop"]
    assert not stops


@pytest.mark.parametrize(
    "given",
    [{}, {"pressure": "alicat"}, {"pressure": "analogue"}, {"pressure": "card"},
     {"length": "laser", "sensor": "modbus"}, {"force": "load-cell-stream", "stage": "zaber"}],
    ids=lambda given: "-".join(given.values()) or "defaults",
)  # fmt: skip
def test_a_test_runs_on_it(given: dict[str, str], tmp_path: Path) -> None:
    config = load_rig(made(tmp_path, **given, bench="virtual"))
    result, _, _ = run_short("isometric", tmp_path / "runs", config=config)
    assert result.outcome == "clean", result.error


# ---- the search -------------------------------------------------------------------------


@contextmanager
def served(rig: str, folder: Path) -> Iterator[dict[str, str]]:
    """A bench on pseudo-terminals: device to port."""
    stop = threading.Event()
    with open_server(load_rig(rig), folder) as server:

        def serve() -> None:
            while not stop.is_set():
                server.step()
                time.sleep(0.0008)

        thread = threading.Thread(target=serve)
        thread.start()
        try:
            ports = {name: port.address for name, port in server.ports.items()}
            yield {**ports, "camera": server.camera.address}
        finally:
            stop.set()
            thread.join()


FOUND: dict[str, tuple[dict[str, str], dict[str, str]]] = {
    "virtual": ({}, {"valve": "VB-0001", "balance": "BAL-0001", "stage": "STAGE-0001"}),
    "virtual-alicat": ({"pressure": "alicat"}, {"pressure_source": "400123", "valve": "VB-0006"}),
    "virtual-itv": ({"pressure": "itv"}, {"pressure_source": "", "valve": "VB-0006"}),
    "virtual-marlin": ({"stage": "marlin"}, {"stage": "cede2a2f-41a2-4748-9b12-c55c62f367ff"}),
    "virtual-zaber": ({"stage": "zaber"}, {"stage": "50081"}),
    "virtual-tmcl": ({"stage": "tmcl"}, {"stage": "TMCM-1140"}),
    "virtual-laser": (
        {"length": "laser", "laser_function": "input", "laser_kind": "int32"},
        {"laser": "", "valve": "VB-0007"},
    ),
    "virtual-weights": ({"force": "load-cell-stream", "stage": "manual"}, {"load_cell": ""}),
}
"""Answers, and the identities that must be found by device."""


@pytest.mark.realtime
@pytest.mark.parametrize("rig", FOUND)
def test_each_device_is_found_by_who_it_says_it_is(rig: str, tmp_path: Path) -> None:
    """Ports in an order that says nothing, each asked with the requests of this bench alone."""
    given, expected = FOUND[rig]
    with served(rig, tmp_path / "bench") as there:
        camera = there.pop("camera")
        names = ", ".join(sorted(there.values(), reverse=True))
        ask = Interview(
            {**given, "ports": names, "ask_devices": True,
             **({"camera": camera} if "length" not in given else {})}
        )  # fmt: skip
        text = ask_rig(ask, Surroundings(ports=list))
        (tmp_path / "rig.toml").write_text(text)
        config = load_rig(str(tmp_path / "rig.toml"))
        tables = tomllib.loads(text)
        for device, serial in expected.items():
            table = tables.get(device) or tables["instruments"][device]
            assert table["port"] == there[device], device
            assert table.get("serial", "") == serial
        findings = examine(config.source, tmp_path)
        # What is not known of a sensor is its calibration: its range may be another.
        allowed = ("pressure", "camera")
        stops = [f for f in findings if f.status == "stop" and f.what not in allowed]
        assert not stops


@pytest.mark.realtime
def test_nothing_is_sent_without_permission(tmp_path: Path) -> None:
    with served("virtual", tmp_path / "bench") as there:
        said: list[str] = []
        ask = Interview({"ports": there["stage"]}, say=said.append)
        text = ask_rig(ask, NOTHING)
        assert ask.answers["ask_devices"] is False
    told = "\n".join(said)
    for request in ('"$I"', '"I4"', 'frame "id"'):
        assert request in told
    assert '"M115"' not in told  # the bench has no such stage
    assert f'port = "{there["stage"]}"' in text


def test_a_port_that_cannot_be_opened_is_named_and_left(tmp_path: Path) -> None:
    from rigs.setup.search import PROBES

    said: list[str] = []
    assert search(PROBES, [str(tmp_path / "none")], said.append) == []
    assert "no such port" in "\n".join(said)


def test_ports_are_guesses_in_their_order_where_nobody_was_asked() -> None:
    ports = [PortInfo("/dev/ttyACM0", "Pico", "E66"), PortInfo("/dev/ttyUSB0", "FT232")]
    said: list[str] = []
    text = ask_rig(Interview(say=said.append), Surroundings(ports=lambda: ports))
    assert tomllib.loads(text)["valve"]["port"] == "/dev/ttyACM0"
    assert tomllib.loads(text)["balance"]["port"] == "/dev/ttyUSB0"
    assert any("FT232" in line for line in said)


def test_where_no_port_was_found_each_device_has_another_one() -> None:
    text = tomllib.loads(ask_rig(Interview(), NOTHING))
    assert [text[name]["port"][-1] for name in ("valve", "balance", "stage")] == ["0", "1", "2"]


def test_genicam_cameras_are_listed_by_serial_number() -> None:
    class Info:
        serial_number, model = "4711", "Eye 5"

    class Package:
        class Harvester:
            device_info_list = (Info,)

            def __getattr__(self, name: str) -> Any:
                return lambda *words, **more: None

    assert ("genicam:4711", "Eye 5") in list(cameras("maker.cti", Package))
    assert not [c for c in cameras("maker.cti") if c[0].startswith("genicam")]


# ---- the command ------------------------------------------------------------------------


def test_answers_are_typed_and_a_wrong_one_is_asked_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    typed = ["bench 7", "virtual", "9", "3", *[""] * 60]
    monkeypatch.setattr(sys, "stdin", io.StringIO("\n".join(typed) + "\n"))
    done = call_pamrig("init", "mine.toml")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "'9' is not one of" in done.stdout
    config = load_rig("mine.toml")
    assert (config.name, config.pressure_source.kind) == ("bench 7", "alicat-pcd")
    assert "ready to run" in done.stdout


def test_input_that_ends_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "stdin", io.StringIO("bench 7\n"))
    done = call_pamrig("init")
    assert done.returncode == 2
    assert "the input ended before its answer" in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


def test_ctrl_c_leaves_nothing_half_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At any question, over a file that was there before."""
    monkeypatch.chdir(tmp_path)
    for after in (0, 5, 12):
        (tmp_path / "rig.toml").write_text("before\n")
        lines = iter(["virtual\n"] + ["\n"] * after)

        class Keyboard(io.StringIO):
            def readline(self, size: int = -1, /) -> str:
                del size
                line = next(lines, None)  # noqa: B023
                if line is None:
                    raise KeyboardInterrupt
                return line

        monkeypatch.setattr(sys, "stdin", Keyboard())
        done = call_pamrig("init", "--replace")
        assert done.returncode == 130
        assert "nothing was written" in done.stderr
        assert [p.name for p in tmp_path.iterdir()] == ["rig.toml"]
        assert (tmp_path / "rig.toml").read_text() == "before\n"


def test_a_file_is_replaced_only_when_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    words = ("init", "rig.toml", "--yes", "--no-doctor", "--answer", "bench=virtual")
    assert call_pamrig(*words).returncode == 0
    first = (tmp_path / "rig.toml").read_text()
    done = call_pamrig(*words, "--answer", "name=other")
    assert done.returncode == 2
    assert "exists already" in done.stderr
    assert (tmp_path / "rig.toml").read_text() == first
    monkeypatch.setattr(sys, "stdin", io.StringIO("\n"))  # the default is no
    assert call_pamrig("init", "rig.toml").returncode == 2
    assert (tmp_path / "rig.toml").read_text() == first
    assert call_pamrig(*words, "--answer", "name=other", "--replace").returncode == 0
    assert load_rig("rig.toml").name == "other"


def test_answers_of_a_file_and_of_options(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "answers.toml").write_text('bench = "virtual"\nstage = "tmcl"\nlimit_kpa = 400\n')
    words = ("init", "--json", "--answers", "answers.toml")
    done = call_pamrig(*words, "--answer", "length=gauge")
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    assert said["answers"]["stage"] == "tmcl"
    assert {f["status"] for f in said["doctor"]} <= {"ok", "warn"}
    config = load_rig("rig.toml")
    assert (config.stage.kind, config.length_source, config.limits.pressure_kpa) == (
        "tmcl", "gauge", 400.0,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--answer", "stage=grble"), "did you mean 'grbl'"),
        (("--answer", "stag=grbl"), "did you mean 'stage'"),
        (("--answer", "limit_kpa=1e9"), "expected a number from 1 to 2000 kPa"),
        (("--answer", "stage"), "is not KEY=VALUE"),
        (("--answers", "none.toml"), "cannot be read"),
        (("none/rig.toml",), "its folder does not exist"),
        (("--answer", "transducer_high_kpa=100"), "above the pressure sensor's range"),
        (("protocol", "isometic"), "is no test"),
        (("protocol", "isometric", "--answer", "pressures_kpa=50,900"), "outside"),
        (("protocol", "isometric", "--answer", "settle.window=1"), "settle.window_s"),
    ],
)
def test_a_wrong_answer_is_one_line(
    words: tuple[str, ...], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    done = call_pamrig("init", *words, "--yes")
    assert done.returncode == 2
    assert said in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert ".toml-" not in done.stderr
    assert not list(tmp_path.glob("**/*.toml"))


# ---- protocol files ---------------------------------------------------------------------


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_the_defaults_are_the_shipped_test(protocol: str, tmp_path: Path) -> None:
    config = load_rig(default_rig(protocol))
    path = tmp_path / "mine.toml"
    path.write_text(ask_protocol(Interview({"all": True}), protocol))
    mine, shipped = (procedure(protocol).read(name, config) for name in (str(path), protocol))
    a, b = mine.as_dict(), shipped.as_dict()
    assert {**a, "source": ""} == {**b, "source": ""}
    assert len(list(entries(path.read_text()))) >= 4


def test_other_values_stand_in_the_file_with_its_comments(tmp_path: Path) -> None:
    given = {"lengths_mm": "56, 60.5", "repeats": 3, "settle.timeout_s": 30, "name": "mine"}
    text = ask_protocol(Interview(given), "isometric")
    path = tmp_path / "mine.toml"
    path.write_text(text)
    plan: Any = procedure("isometric").read(str(path), load_rig("virtual"))
    assert plan.lengths_mm == (56.0, 60.5)
    assert (plan.repeats, plan.settle.timeout_s, plan.name) == (3, 30.0, "mine")
    assert "# of each length, back to back" in text


def test_every_answer_of_the_page_is_asked_and_every_one_asked_is_on_the_page() -> None:
    page = (HOUSE / "docs" / "start" / "init.md").read_text(encoding="utf-8")
    listed = set(re.findall(r"^\| `(\w+)`", page, flags=re.MULTILINE))
    asked: set[str] = set()
    ports = Surroundings(ports=lambda: [PortInfo("/dev/ttyACM0")], search=lambda *_: [])
    for given, bench in itertools.product(ALL, ("real", "virtual")):
        ask = Interview({**given, "bench": bench})
        ask_rig(ask, ports)
        asked |= set(ask.answers)
    plain = {re.sub(r"^(port|baud)_\w+", r"\1_DEVICE", key) for key in asked}
    plain = {re.sub(r"^(laser|pressure_transmitter)_", "DEVICE_", key) for key in plain}
    assert plain == listed


def test_an_interview_refuses_what_it_did_not_ask() -> None:
    ask = Interview({"x": 1}, "answers.toml")
    ask.number("y", "y", 1.0, 0, 2)
    with pytest.raises(ConfigError, match=r"answers\.toml: x"):
        ask.finish()


@pytest.mark.parametrize(
    ("name", "source"),
    [
        ("virtual-weights", "rigs/virtual-weights"),
        ("isotonic", "protocols/isotonic"),
        ("configs/rigs/virtual.toml", "rigs/virtual"),
        ("plant/links/finger", "plant/links/finger"),
    ],
)
def test_a_shipped_file_is_copied_as_it_is(
    name: str, source: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    done = call_pamrig("init", "copy", name, "mine.toml")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == f"written: mine.toml, a copy of configs/{source}.toml\n"
    shipped = (HOUSE / "configs" / f"{source}.toml").read_bytes()
    assert (tmp_path / "mine.toml").read_bytes() == shipped
    again = call_pamrig("init", "copy", "virtual", "mine.toml")
    assert again.returncode == 2
    assert "exists already" in again.stderr
    assert (tmp_path / "mine.toml").read_bytes() == shipped
    assert call_pamrig("init", "copy", "creep", "mine.toml", "--replace").returncode == 0
    assert (tmp_path / "mine.toml").read_bytes() != shipped


@pytest.mark.parametrize("name", ["finger", "virtual-wieghts", "../pyproject", "/etc/hosts", ""])
def test_what_is_not_shipped_is_not_copied(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    done = call_pamrig("init", "copy", name, "mine.toml")
    assert done.returncode == 2
    assert done.stderr.startswith("pamrig: ")
    assert "is shipped (" in done.stderr
    assert done.stderr.count("\n") == 1
    assert not list(tmp_path.iterdir())
