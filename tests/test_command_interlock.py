"""Somebody else commands the valve controller during a test, or a point moves while it is measured.

A second writer set another set-point once: the run took 165.9 kPa for 100 and stayed clean.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from analysis.run_table import reduce_run
from bench_runs import quick, run_isometric
from daq.link.codec import encode_request
from daq.store.run import Run, open_run
from rigs.execution.runner import Runner
from rigs.rigfile.config import load_rig
from rigs.steps.steps import Measure
from valvefw.config import config_crc
from valvefw.deskboard import DeskBoard
from valvefw.wire import decode_frame

PRESSURES = (100.0, 250.0, 450.0, 600.0)


class TwoHosts:
    """A desk board that one host has armed in a session, and requests of anybody."""

    def __init__(self, session: str = "@4711") -> None:
        self.board = DeskBoard()
        self.said: list[str] = []
        c = self.controller = self.board.controller
        self.board.run(5)
        armed = self.ask(f"arm {config_crc(c.values):04x} {c.telemetry.boot_id} {session}".strip())
        assert armed == "ok"

    def ask(self, words: str) -> str:
        """The reply to one request, without its id; events are kept in ``said``."""
        sent = self.board.run(3, encode_request(7, words))
        payloads = [decode_frame(part) for part in sent.split(b"\0") if part]
        texts = [p.decode() for p in payloads if p and p[:1] in (b"R", b"E")]
        self.said += [text[1:] for text in texts if text[0] == "E"]
        (reply,) = (text[3:] for text in texts if text[0] == "R")
        return reply

    @property
    def foreign(self) -> int:
        """Refused commands, as `stat` reports them."""
        return int(dict(w.split("=") for w in self.ask("stat").split()[1:])["foreign"])


GUARDED = ["hb 1", "sp 1600", "scheme burst", "pulse inlet 2000", "capture inlet 2000 0", "led 1"]


@pytest.mark.parametrize("words", [*GUARDED, "telemetry 1"])
@pytest.mark.parametrize("mark", ["", " @4712", " @1"])
def test_the_firmware_refuses_and_counts_commands_of_another_session(words: str, mark: str) -> None:
    hosts = TwoHosts()
    assert hosts.ask(words + mark).startswith("err session another host has armed")
    assert hosts.foreign == 1
    assert hosts.said[-1].startswith(f"foreign verb={words.split()[0]} ")
    assert hosts.controller.setpoint_x16 == 0
    assert hosts.controller.scheme is None


def test_the_host_that_armed_is_obeyed_and_a_crowd_of_others_makes_one_event() -> None:
    hosts = TwoHosts()
    assert hosts.ask("hb 1 @4711").startswith("ok hb=1")
    assert hosts.ask("scheme burst @4711") == "ok"
    assert hosts.ask("sp 1600 @4711") == "ok sp=1600"
    for k in range(20):
        assert hosts.ask(f"sp {k}").startswith("err session")
        assert hosts.ask(f"hb {k + 2} @4711").startswith("ok")
    assert hosts.controller.setpoint_x16 == 1600
    assert hosts.foreign == 20
    assert len([text for text in hosts.said if text.startswith("foreign")]) == 1


@pytest.mark.parametrize("words", ["vent", "stop", "stat", "id", "faults", "get trip"])
def test_anyone_may_read_vent_and_stop(words: str) -> None:
    hosts = TwoHosts()
    assert hosts.ask(words).startswith("ok")
    assert hosts.foreign == 0


def test_armed_without_a_session_every_host_is_obeyed() -> None:
    """A person at a terminal needs no number."""
    hosts = TwoHosts(session="")
    assert hosts.ask("scheme burst") == "ok"
    assert hosts.ask("sp 1600") == "ok sp=1600"
    assert hosts.ask("sp 1584 @99") == "ok sp=1584"


@pytest.mark.parametrize("mark", ["@", "@0", "@65536", "@x", "@-1", "@1@2", "4711"])
def test_a_mark_that_is_no_session_is_a_syntax_error(mark: str) -> None:
    hosts = TwoHosts()
    assert hosts.ask(f"sp 1600 {mark}").split()[1] in ("syntax", "range", "session")
    assert hosts.controller.setpoint_x16 == 0


def run_with(
    root: Path, at_point: int, act: Callable[[Runner], None], said: list[str]
) -> tuple[Run, Any]:
    """A short test in which something happens before the window of one point."""

    def prepare(runner: Runner, record: object) -> None:
        runner.watch.log = said.append
        measure = runner._measure
        made: list[Measure] = []

        def measured(step: Measure) -> None:
            made.append(step)
            if len(made) == at_point:
                act(runner)
            measure(step)

        runner._measure = measured  # type: ignore[method-assign]

    config = load_rig("virtual")
    plan = quick(config, lengths_mm=(57.0,), pressures_kpa=PRESSURES, repeats=1)
    result = run_isometric(config, plan, root, derive=False, on_start=prepare)
    return open_run(result.folder), result


def write(runner: Runner, words: str) -> None:
    """Bytes of another program on the controller's line."""
    runner.rig.valve._link.write(encode_request(60_000, words))


def test_a_second_writer_on_the_line_changes_nothing_and_is_stated(tmp_path: Path) -> None:
    said: list[str] = []
    run, _ = run_with(tmp_path, 2, lambda runner: write(runner, "sp 26000"), said)
    assert run.outcome == "clean"
    table = reduce_run(run).table
    assert (table["pressure_kpa"] - table["set_pressure_kpa"]).abs().max() < 2.0
    (event,) = (e for e in run.events if e["kind"] == "foreign_commands")
    assert event["refused"] == 1
    assert sum("another program sends commands" in line for line in said) == 1


def test_a_set_point_that_nobody_sent_ends_the_run(tmp_path: Path) -> None:
    """A writer who has read the session on the line is obeyed by the firmware."""

    def spy(runner: Runner) -> None:
        write(runner, f"sp 12000 @{runner.rig.valve._session}")

    run, result = run_with(tmp_path, 2, spy, [])
    assert run.outcome == "faulted"
    assert "its set-point reads back as" in str(result.error)
    assert "kPa was sent" in str(result.error)
    assert [e for e in run.events if e["kind"] == "vented" and e["confirmed"]]


def test_a_vent_by_somebody_else_ends_the_run(tmp_path: Path) -> None:
    run, result = run_with(tmp_path, 3, lambda runner: write(runner, "vent"), [])
    assert run.outcome == "faulted"
    assert "reads back as" in str(result.error)


def leak(runner: Runner) -> None:
    """Both valves shut and some air let out: the point moves while it is measured."""
    runner.shut()
    runner.rig.valve.request("pulse vent 20000 20 200000")


def test_a_point_that_moves_while_it_is_measured_is_not_settled(tmp_path: Path) -> None:
    said: list[str] = []
    run, _ = run_with(tmp_path, 3, leak, said)
    points = [e for e in run.events if e["kind"] == "point"]
    moved = [e["order"] for e in run.events if e["kind"] == "moved"]
    assert [e["order"] for e in points if not e["settled"]] == moved
    assert moved[0] == points[2]["order"]
    assert any("moved while it was measured" in line for line in said)


def test_a_reading_whose_uncertainty_is_out_of_all_proportion_is_stated(tmp_path: Path) -> None:
    run, _ = run_with(tmp_path, 3, leak, [])
    order = [e for e in run.events if e["kind"] == "point"][2]["order"]
    (note,) = (n for n in reduce_run(run).notes if "pressure_kpa is out of proportion" in n)
    assert f"point {order} (" in note
    undisturbed, _ = run_with(tmp_path / "quiet", 99, leak, [])
    notes = reduce_run(undisturbed).notes
    assert not [note for note in notes if "proportion" in note or "settling" in note]
