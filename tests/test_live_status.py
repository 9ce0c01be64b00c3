"""State, progress, faults and zero of the live view: the definitions that its screen is made of."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from analysis.registry import analysis_of
from daq.clock import VirtualClock
from daq.link.causes import CAUSES, cause_of, event_words
from daq.live.chart import Chart
from daq.live.layout import Axis, Panel, channel_of
from daq.live.status import (
    FAULT,
    FOLLOWING,
    ForceZero,
    Phases,
    Status,
    from_zero,
    joined,
    left_words,
    phase_of,
    problem_and_remedy,
    with_target,
)
from daq.live.viewfile import _fill
from daq.store.derive import engineering
from daq.store.run import Run
from protocol_runs import run_short
from rigs.devices.event_loop import EventLoop
from rigs.devices.operator import Request, put_request
from rigs.live.feed import LiveFeed
from rigs.live.status import LiveStatus
from rigs.protocols.names import PROTOCOLS
from rigs.steps.watching import Progress
from valvefw.core import CAUSES as FIRMWARE_CAUSES
from valvefw.wire import FLAG_ARMED, FLAG_FAULT

NONE = math.nan


@pytest.mark.parametrize(
    ("flags", "target", "pressure", "inlet", "vent", "words"),
    [
        (0, 0.0, 0.3, 0.0, 1.0, "NOT ARMED, VENTED"),
        (FLAG_ARMED, 0.0, 0.3, 0.0, 1.0, "ARMED, VENTED"),
        (FLAG_ARMED, 0.0, 240.0, 0.0, 1.0, "VENTING"),
        (FLAG_ARMED, 300.0, 120.0, 0.5, 0.0, "GOING TO 300 kPa"),
        (FLAG_ARMED, 300.0, 304.0, 0.0, 0.1, "HOLDING 300 kPa"),
        (FLAG_ARMED, 40.0, 29.0, 0.0, 0.0, "AIR SHUT IN, SET-POINT 40 kPa"),
        (FLAG_ARMED, NONE, 400.0, 0.0, 0.0, "AIR SHUT IN"),
        (FLAG_ARMED, NONE, 2.0, 0.0, 0.0, "ARMED, VALVES SHUT"),
        (FLAG_ARMED, NONE, 2.0, 0.3, 0.0, "TEST COMMANDS THE VALVES"),
        (FLAG_FAULT, 300.0, 300.0, 0.0, 1.0, "FAULT"),
    ],
)
def test_the_state_says_what_the_controller_does(
    flags: int, target: float, pressure: float, inlet: float, vent: float, words: str
) -> None:
    assert phase_of(flags, target, pressure, inlet, vent) == words


def telemetry(n: int, **columns: float) -> dict[str, Any]:
    """Equal samples of an armed controller that holds 300 kPa."""
    full = {"flags": FLAG_ARMED, "setpoint_kpa": 300.0, "pressure_kpa": 300.0,
            "inlet_cmd": 0.0, "outlet_cmd": 0.0, **columns}  # fmt: skip
    return {name: np.full(n, value) for name, value in full.items()}


def test_a_state_is_shown_when_it_lasts_and_a_fault_at_once() -> None:
    phases = Phases()
    time_s = np.arange(50) * 1e-3

    def fed(times: int, **columns: float) -> list[str]:
        made = [list(phases.feed(time_s, telemetry(50, **columns))) for _ in range(times)]
        return [phase for changes in made for _, phase in changes]

    assert fed(1) == ["HOLDING 300 kPa"]
    assert fed(2, pressure_kpa=280.0, inlet_cmd=0.5) == []  # 0.1 s: not worth a change
    assert fed(1) == []
    assert fed(9, pressure_kpa=280.0, inlet_cmd=0.5) == ["GOING TO 300 kPa"]
    assert fed(1, flags=FLAG_FAULT) == [FAULT]


def test_two_controllers_are_one_state_where_they_agree() -> None:
    assert joined({"valve": "VENTING", "valve_b": "VENTING"}) == "VENTING"
    assert joined({"valve": "HOLDING 200 kPa", "valve_b": "VENTING"}) == (
        "a: HOLDING 200 kPa · b: VENTING"
    )
    assert joined({"valve": "VENTING", "valve_b": FAULT}) == FAULT


def test_the_set_point_is_that_which_the_controller_regulates_to() -> None:
    columns = telemetry(3)
    columns["setpoint_kpa"] = np.array([300.0, 0.0, 0.0])
    columns["outlet_cmd"] = np.array([0.0, 1.0, 0.0])
    target = with_target(columns)["target_kpa"]
    assert target[:2].tolist() == [300.0, 0.0]
    assert np.isnan(target[2])  # the air is shut in: nothing is regulated


def test_before_the_first_tare_the_weight_on_the_balance_is_no_force() -> None:
    live = ForceZero()
    raw = np.array([-49.2, -48.2, -30.0])
    assert live.apply(raw).tolist() == pytest.approx([0.0, 1.0, 19.2])
    live.taring()
    assert np.isnan(live.apply(np.array([0.0]))).all()
    live.tared()
    assert live.apply(np.array([0.1, 12.0])).tolist() == [0.1, 12.0]
    time_s = np.array([0.0, 1.0, 2.0, 4.5, 5.0, 6.0])
    stored = from_zero(time_s, np.array([*raw, 0.0, 0.1, 12.0]), 5.0)
    assert stored[[0, 1, 2, 4, 5]].tolist() == pytest.approx([0.0, 1.0, 19.2, 0.1, 12.0])
    assert np.isnan(stored[3])


def test_every_fault_of_the_firmware_has_words_and_a_remedy() -> None:
    assert set(CAUSES) == set(FIRMWARE_CAUSES)
    for cause in FIRMWARE_CAUSES:
        event = f"fault cause={cause} t=1000 counts=17"
        assert cause_of(event) == cause
        assert "What to do: " in event_words(event)
    assert event_words("vented t=154583000 ms=156") == "vented within 0.16 s"
    assert event_words("boot id=1") == "boot id=1"


def test_progress_and_remedy_stand_below_the_state() -> None:
    text = Status("HOLDING 300 kPa", "trial 2", 12, 48, 130.0).markdown()
    assert text.splitlines()[0] == "# HOLDING 300 kPa"
    assert "12 of 48 points, about 2 min left" in text
    fault = Status(FAULT, "trial 2", 12, 48, 130.0, "no air", "open the supply").markdown()
    assert "**What to do: open the supply**" in fault
    assert " left" not in fault
    turn = Status("ARMED, VENTED", "trial 2", request="Hang 2 kg").markdown()
    assert turn.splitlines()[:3] == ["# YOUR TURN", "", "**Hang 2 kg**"]
    words = ["about 5 s", "about 40 s", "about 10 min", "about 2 h 00 min"]
    assert [left_words(s) for s in (1.0, 41.0, 600.0, 7200.0)] == words


def test_a_reason_is_parted_from_its_remedy() -> None:
    assert problem_and_remedy("valve: silent (see `x` (twice))") == (
        "valve: silent", "see `x` (twice)",
    )  # fmt: skip
    assert problem_and_remedy("stop requested") == ("stop requested", "")
    assert problem_and_remedy("") == ("", "")


@pytest.mark.parametrize(
    ("path", "legend"),
    [
        ("force/predicted_n", "force, predicted (N)"),
        ("pressure/predicted_kpa", "pressure, predicted (kPa)"),
        ("share of the gap/muscle_percent", "share of the gap, muscle (%)"),
        ("own/n", "own, n"),
    ],
)
def test_a_series_nobody_described_has_a_name_with_its_unit(path: str, legend: str) -> None:
    assert channel_of(path).legend == legend


@pytest.mark.parametrize("name", PROTOCOLS)
def test_every_screen_has_its_state_its_results_and_units(name: str) -> None:
    from rigs.protocols.names import default_rig
    from rigs.protocols.registry import procedure
    from rigs.rigfile.config import load_rig

    plan = procedure(name).read(f"{name}-short", load_rig(default_rig(name)))
    layout = analysis_of(name).layout(plan.as_dict())
    kinds = [panel.kind for panel in layout.panels]
    for kind in ("status", "points", "table", "readout", "log", "states"):
        assert kind in kinds, kind
    for panel in layout.panels:
        if panel.kind == "series":
            assert re.search(r"\(.+\)$", panel.title), panel.title
            assert all(channel.legend.endswith(")") for channel in panel.channels)
    assert {feed.path for feed in layout.feeds} <= set(layout.channels)


# ------------------------------------------------------------- a running test and its record


class Sink:
    """Keeps what a live view, or the drawing of a view file, is handed."""

    error = None
    newest_s = 0.0

    def __init__(self) -> None:
        self.status_texts: list[str] = []
        self.curves: dict[str, list[tuple[float, float]]] = {}

    def status(self, *args: Any) -> None:
        self.status_texts.append(next(a for a in args if isinstance(a, str) and "#" in a))

    def series(self, path: str, time_s: Any, values: Any) -> None:
        self.curves.setdefault(path, []).extend(zip(time_s, values, strict=True))

    def __getattr__(self, name: str) -> Any:
        return lambda *args, **more: None


@pytest.fixture(scope="module")
def screens(tmp_path_factory: pytest.TempPathFactory) -> tuple[Sink, Sink, Run]:
    """The same short test: as it ran, and from its record."""
    from rigs.protocols.names import default_rig
    from rigs.protocols.registry import procedure
    from rigs.rigfile.config import load_rig

    kind = procedure("isometric")
    plan = kind.read("isometric-short", load_rig(default_rig("isometric")))
    layout = kind.analysis.layout(plan.as_dict())
    live, stored = Sink(), Sink()
    feed = LiveFeed(live, layout)  # type: ignore[arg-type]
    _, run, _ = run_short(
        "isometric", tmp_path_factory.mktemp("runs"), how={"make_live": lambda _: feed}
    )
    _fill(stored, run, layout, None, 10_000_000)  # type: ignore[arg-type]
    return live, stored, run


def headings(sink: Sink) -> list[str]:
    """The states in their order, each once."""
    found = [text.splitlines()[0][2:] for text in sink.status_texts]
    return [a for a, b in zip(found, [*found[1:], ""], strict=True) if a != b]


def test_the_record_gives_the_states_that_the_test_showed(
    screens: tuple[Sink, Sink, Run],
) -> None:
    live, stored, run = screens
    shown = headings(live)
    assert shown[-1] == "DONE"
    assert any(state.startswith("HOLDING") for state in shown)
    assert [s for s in headings(stored) if "ARMED" not in s] == [
        s for s in shown if "ARMED" not in s
    ]
    made = sum(event["kind"] == "point" for event in run.events)
    for sink in (live, stored):
        assert f"{made} of {made} points" in sink.status_texts[-1]


def test_force_and_target_are_drawn_alike_live_and_from_the_record(
    screens: tuple[Sink, Sink, Run],
) -> None:
    live, stored, run = screens
    for sink in (live, stored):
        force = np.array(sink.curves["force/measured_n"])[:, 1]
        assert np.nanmin(force) > -1.0  # no weight of the balance
    measured = engineering(run, "balance")[0]["force_n"]
    assert np.nanmin(measured) < -20.0  # which the record has as it came
    target = np.array(live.curves["pressure/set_point_kpa"])[:, 1]
    assert np.isnan(target).any()
    assert set(np.round(target[np.isfinite(target)])) == {
        round(v) for _, v in stored.curves["pressure/set_point_kpa"] if np.isfinite(v)
    }


def test_a_panel_of_an_unknown_kind_is_refused() -> None:
    with pytest.raises(ValueError, match="kind 'screen'"):
        Panel("x", "screen", "x")  # type: ignore[arg-type]


def test_the_folder_of_the_view_needs_no_more_than_a_record(tmp_path: Path) -> None:
    """A run without balance, tare or camera has a screen too."""
    _, run, _ = run_short("switching-time", tmp_path, pressures_kpa=(200.0,), repeats=1)
    layout = analysis_of("switching-time").layout(run.manifest["parameters"])
    sink = Sink()
    _fill(sink, run, layout, None, 1000)  # type: ignore[arg-type]
    assert headings(sink)[-1] == "DONE"


def test_what_a_person_is_asked_for_stands_on_the_screen_until_it_is_done() -> None:
    class Person:
        """Answers at the third look."""

        looks = 0

        def begin(self, request: Request) -> None:
            assert request.text == "Hang 2 kg"

        def answer(self) -> str | None:
            self.looks += 1
            return "" if self.looks > 2 else None

    live, loop = Sink(), EventLoop(VirtualClock(), 0.02)
    status = LiveStatus(live, Progress(4), lambda: 0.0, ["valve"])  # type: ignore[arg-type]
    loop.on_request.append(status.request)
    put_request(Person(), loop, Request("mass", 2.0, "kg", "Hang 2 kg"))
    assert [text.splitlines()[0] for text in live.status_texts] == ["# YOUR TURN", "# STARTING"]
    assert "**Hang 2 kg**" in live.status_texts[0]


def test_a_sine_or_a_ramp_of_the_set_point_is_not_said_to_be_held() -> None:
    phases = Phases()
    time_s = np.arange(2000) * 1e-3
    columns = telemetry(2000)
    columns["setpoint_kpa"] = 300.0 + 20.0 * np.sin(2 * np.pi * np.floor(time_s * 50) / 50)
    columns["pressure_kpa"] = columns["setpoint_kpa"]
    assert [text for _, text in phases.feed(time_s, columns)][-1] == FOLLOWING
    held = [text for _, text in phases.feed(time_s + 2.0, telemetry(2000))]
    assert held == ["HOLDING 300 kPa"]  # one second after the last step
    one_step = telemetry(2000)
    one_step["setpoint_kpa"][:1000] = 200.0
    stepped = [text for _, text in phases.feed(time_s + 4.0, one_step)]
    assert FOLLOWING not in stepped


def test_logarithmic_axes_show_the_quantity_and_units_keep_their_letters() -> None:
    chart = Chart(
        Axis("time held (s)", math.log10(0.6), math.log10(6.0), log10=True), Axis("y", 0, 1)
    )
    assert chart.drawing().tick_text[:5] == ["0.5", "1", "2", "5", "10"]
    for name, parameters in (("relaxation", {"times": {"frames": 0}}), ("dynamic", {})):
        panels = analysis_of(name).layout(parameters).panels
        assert all(panel.kind != "camera" for panel in panels)  # no pictures, no empty panel
        points = next(panel for panel in panels if panel.kind == "points")
        assert points.x_axis is not None
        assert points.x_axis.log10
        assert "log10" not in points.title
        assert "(n)" not in points.title
