"""Axes that a person sets: asked, timed, checked by a sensor, recorded as read."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest

from analysis.regression.calibration_line import Reference
from analysis.run_table import reduce_run
from bench_runs import quick, run_isometric
from daq.clock import VirtualClock
from daq.errors import ConfigError, DeviceError
from daq.interrupt import StopFlag, Stopped
from daq.store.run import open_run
from daq.store.verify import verify
from protocol_runs import run_short
from rigs.bench.doctor import examine
from rigs.bench.rig import open_rig
from rigs.calibration.force import calibrate_force
from rigs.devices.event_loop import EventLoop
from rigs.devices.operator import (
    ManualAxis,
    Request,
    read_number,
    request_done,
    request_enter,
    request_number,
)
from rigs.execution.runner import Runner
from rigs.execution.session import run_protocol
from rigs.protocols.isometric import load_isometric
from rigs.protocols.registry import procedure
from rigs.rigfile.config import RigConfig, load_rig
from rigs.rigfile.toml_reader import find_config
from rigs.virtual.emulators.operator import VirtualOperator


class Desk:
    def __init__(self, spread: float = 0.0) -> None:
        self.clock = VirtualClock()
        self.event_loop = EventLoop(self.clock, 0.02)
        self.at = 0.0
        self.person = VirtualOperator(
            self.clock, {"mass": self.put}, {"gauge": lambda: 12.5},
            np.random.default_rng(1), {"mass": spread},
        )  # fmt: skip

    def put(self, value: float) -> None:
        self.at = value


def test_it_asks_waits_checks_and_tells_what_was_read() -> None:
    desk = Desk(spread=0.01)
    axis = ManualAxis("mass", "kg", desk.person, desk.event_loop, lambda: desk.at, "load_cell", 0.1)
    heard = []
    axis.on_setting.append(heard.append)
    setting = axis.set(2.0)
    assert setting.read == desk.at != 2.0
    assert setting.checked_by == "load_cell"
    assert setting.waited_s == pytest.approx(5.0, abs=0.05)
    assert heard == [setting]
    assert desk.person.requests[0].text == (
        "hang 2 kg on the muscle and let it come to rest, then press Enter"
    )


def test_what_the_sensor_does_not_see_is_asked_again_and_then_refused() -> None:
    desk = Desk()
    axis = ManualAxis("mass", "kg", desk.person, desk.event_loop, lambda: 1.5, "load_cell", 0.1)
    with pytest.raises(DeviceError, match=r"asked for 2 kg, load_cell reads 1.5 after 3 tries"):
        axis.set(2.0)
    assert len(desk.person.requests) == 3
    assert "load_cell reads 1.5 kg" in desk.person.requests[1].text


class Typist:
    """Answers with the given words, one each."""

    def __init__(self, *words: str) -> None:
        self._words = list(words)

    def begin(self, request: Request) -> None:
        del request

    def answer(self) -> str | None:
        return self._words.pop(0)


@pytest.mark.parametrize("words", [("12.5",), ("twelve", "12.5 kPa"), ("12,5", "1_2", "12.5kPa")])
def test_a_number_that_does_not_read_is_asked_again(words: tuple[str, ...]) -> None:
    event_loop = EventLoop(VirtualClock(), 0.02)
    request = Request("gauge", float("nan"), "kPa", "read the gauge")
    assert request_number(Typist(*words), event_loop, request) == 12.5


@pytest.mark.parametrize(
    ("text", "value"),
    [("0,714", 0.714), ("0.714", 0.714), (" 1,5 kPa", 1.5), ("-3", -3.0), ("1,234.5", None),
     ("1,2,3", None), ("nan", None), ("1_0", None), ("p", None), ("", None)],
)  # fmt: skip
def test_a_decimal_comma_is_a_decimal_point(text: str, value: float | None) -> None:
    assert read_number(text, "kPa") == value


def test_an_answer_that_never_is_a_number_ends_the_request() -> None:
    event_loop = EventLoop(VirtualClock(), 0.02)
    request = Request("gauge", float("nan"), "kPa", "read the gauge")
    with pytest.raises(DeviceError, match="'twelve' is not a number in kPa, after 10 answers"):
        request_number(Typist(*["twelve"] * 20), event_loop, request)


def test_a_marked_mass_is_typed_with_a_comma_and_a_stray_key_is_asked_again() -> None:
    asked: list[str] = []

    class Person(Typist):
        def begin(self, request: Request) -> None:
            asked.append(request.text)

    axis = ManualAxis(
        "mass", "kg", Person("x", "0,714", "0.714"), EventLoop(VirtualClock(), 0.02),
        lambda: 0.71, "load_cell", 0.1, marked=True,
    )  # fmt: skip
    assert axis.set(0.5).taken == 0.714
    assert axis.settings[0].tries == 1, "the sensor was asked once"
    assert asked[1].startswith("'x' is neither Enter nor a number in kg. Again: hang 0.5 kg")


def test_a_mass_far_from_the_requested_one_is_typed_twice_and_never_above_the_limit() -> None:
    """5 typed for 1.154 was taken without a question."""
    asked: list[str] = []

    class Person(Typist):
        def begin(self, request: Request) -> None:
            asked.append(request.text)

    axis = ManualAxis(
        "mass", "kg", Person("60", "5", "1,2"), EventLoop(VirtualClock(), 0.02),
        marked=True, highest=51.0,
    )  # fmt: skip
    assert axis.set(1.154).taken == 1.2
    assert asked[1].startswith("60 kg is above the limit of this rig, 51 kg. Again: ")
    assert asked[2].startswith("1.154 kg was requested, not 5: type 5 again if that is what hangs.")


def test_only_enter_confirms_where_nothing_can_be_typed() -> None:
    """`q` at a prompt of `calibrate force` was taken for Enter, and the weight was measured."""
    asked: list[Request] = []

    class Person(Typist):
        def begin(self, request: Request) -> None:
            asked.append(request)

    request = Request("dead weight", 1.0, "kg", "hang 1 kg on the load cell, then press Enter")
    request_enter(Person("q", "2", ""), EventLoop(VirtualClock(), 0.02), request)
    whys = ["'q' is not Enter; Ctrl-C ends", "'2' is not Enter; Ctrl-C ends"]
    assert [r.again for r in asked] == ["", *whys]
    assert asked[2].text == f"{whys[1]}. Again: {request.text}"
    with pytest.raises(DeviceError, match="'q' is not Enter, after 10 answers"):
        request_enter(Typist(*["q"] * 20), EventLoop(VirtualClock(), 0.02), request)


@pytest.mark.parametrize("words", [("abc", "-1", ""), ("0.7", "3"), ("7", "2,5 mm")])
def test_a_catch_is_confirmed_or_its_distance_is_typed(words: tuple[str, ...]) -> None:
    """Any text was accepted as an answer."""
    request = Request("catch", 3.0, "mm", "set the catch")
    person = Typist(*words)
    done, _ = request_done(person, EventLoop(VirtualClock(), 0.02), request, 0.0, 6.0)
    assert done == {"": 3.0, "3": 0.7, "2,5 mm": 2.5}[words[-1]]


def test_a_mass_in_pounds_is_refused_by_the_rig_file(tmp_path: Path) -> None:
    """`doctor` said `set by hand in lb` and `ready to run`."""
    path = tmp_path / "rig.toml"
    path.write_text(load_rig("virtual-weights").text.replace('unit = "kg"', 'unit = "lb"'))
    with pytest.raises(ConfigError, match=r"manual.mass.unit.*'lb'.*in kg"):
        load_rig(str(path))


def test_a_calibration_stops_while_it_waits_for_a_person(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ctrl-C was seen between two weights only: never at the prompt."""
    config, stop = load_rig("virtual-weights"), StopFlag()

    class Absent:
        def begin(self, request: Request) -> None:
            if "take the muscle off" not in request.text:
                stop.set("stopped by Ctrl-C")

        def answer(self) -> str | None:
            return None if stop.reason else ""

    monkeypatch.setattr("rigs.bench.rig.default_operator", lambda *_: Absent())
    with pytest.raises(Stopped, match="Ctrl-C"):
        calibrate_force(config, [0.0, 1.0, 2.0], tmp_path, weights=Reference("set"), stop=stop)
    (folder,) = tmp_path.iterdir()
    run = open_run(folder)
    assert (run.outcome, verify(run)) == ("stopped", [])


def manual_rig(folder: Path) -> str:
    text = load_rig("virtual").text
    at = text.index("[stage]")
    end = text.index("\n[", at)
    path = folder / "manual.toml"
    path.write_text(text[:at] + '[stage]\nkind = "manual"\ntolerance_mm = 0.2\n' + text[end:])
    return str(path)


def test_an_isometric_test_with_lengths_set_by_hand(tmp_path: Path) -> None:
    config = load_rig(manual_rig(tmp_path))
    protocol = quick(config, lengths_mm=(58.0, 64.0), pressures_kpa=(200.0, 400.0))
    result = run_isometric(config, protocol, tmp_path / "runs", derive=False)
    assert result.outcome == "clean", result.error
    run = open_run(result.folder)
    settings = [e for e in run.events if e["kind"] == "manual"]
    assert len(settings) == sum(
        e["kind"] == "command" and e["device"] == "stage" for e in run.events
    )
    for event in settings:
        assert event["checked_by"] == "camera"
        assert abs(event["read"] - event["asked"]) <= 0.2
        assert event["waited_s"] >= 5.0
    # The table holds what the camera saw, not what was asked for.
    table = reduce_run(run).table
    assert (abs(table["length_mm"] - table["set_length_mm"]) < 0.25).all()
    assert (table["length_mm"] != table["set_length_mm"]).all()
    assert not [f for f in examine(manual_rig(tmp_path), tmp_path) if f.status == "stop"]


def test_a_temperature_set_by_hand_and_looked_after_by_the_thermometer() -> None:
    with open_rig(load_rig("virtual-instruments")) as rig:
        setting = rig.axes["temperature"].set(35.0)
        assert setting.read == pytest.approx(35.0, abs=1.0)
        assert setting.read != 35.0
        assert setting.checked_by == "thermometer"


def hand_regulator(folder: Path, tolerance: float = 3.0) -> str:
    """The bench of 1996, with a regulator that somebody turns."""
    axis = (
        f'[manual.pressure]\nquantity = "pressure_kpa"\nunit = "kPa"\ncheck = "pressure"\n'
        f"tolerance = {tolerance}\n\n"
    )
    text = load_rig("virtual-thesis").text
    path = folder / "hand.toml"
    path.write_text(text.replace("[calibrations.", axis + "[calibrations.", 1))
    return str(path)


def test_an_isometric_test_with_a_regulator_turned_by_hand(tmp_path: Path) -> None:
    config = load_rig(hand_regulator(tmp_path))
    plan = quick(config, lengths_mm=(60.0,), pressures_kpa=(200.0, 400.0))
    result = run_isometric(config, plan, tmp_path / "runs", derive=False)
    assert result.outcome == "clean", result.error
    run = open_run(result.folder)
    turned = [e for e in run.events if e["kind"] == "manual"]
    assert [e["asked"] for e in turned] == [20.0, 200.0, 400.0, 200.0]
    for event in turned:
        assert event["axis"] == "pressure"
        assert event["checked_by"] == "pressure"
        assert abs(event["read"] - event["asked"]) <= 3.0
        assert event["waited_s"] >= 5.0
    table = reduce_run(run).table
    assert (abs(table["pressure_kpa"] - table["set_pressure_kpa"]) < 3.0).all()
    assert (table["pressure_kpa"] != table["set_pressure_kpa"]).all()


def test_a_regulator_turned_the_wrong_way_is_asked_for_again_and_then_ends_the_test(
    tmp_path: Path,
) -> None:
    config = load_rig(hand_regulator(tmp_path))
    plan = quick(config, lengths_mm=(60.0,), pressures_kpa=(200.0,))

    def shut(runner: Runner, record: object) -> None:
        del record
        person, bench = runner.rig.operator, runner.rig.bench
        assert isinstance(person, VirtualOperator)
        assert bench is not None
        person._steps["pressure"] = lambda _: bench.plant.set_regulator(0.0)  # the wrong way

    result = run_isometric(config, plan, tmp_path / "runs", on_start=shut, derive=False)
    assert result.outcome == "faulted"
    assert "asked for 20 kPa, pressure reads" in str(result.error)
    assert "after 3 tries" in str(result.error)


# ---- weights --------------------------------------------------------------------------


def weights_rig() -> RigConfig:
    """The bench with a load cell and hand-hung weights, and its simulated person."""
    config = load_rig("virtual-weights")
    return dataclasses.replace(
        config, instruments=dataclasses.replace(config.instruments, operator="")
    )


class Forgetful(VirtualOperator):
    """Says that it was done, but hangs nothing the first time."""

    def perform(self, request: Request) -> str:
        if request.axis == "mass" and sum(r.axis == "mass" for r in self.requests) == 1:
            return ""
        return super().perform(request)


def test_a_weight_that_the_load_cell_does_not_see_is_asked_for_again() -> None:
    config = weights_rig()
    with open_rig(config) as rig:
        assert rig.bench is not None
        rig.valve.progress(60.0)
        rig.operator.__class__ = Forgetful
        setting = rig.axes["mass"].set(1.154)
        assert setting.tries == 2
        assert setting.taken == 1.154
        assert setting.read == pytest.approx(1.154, abs=0.15)
        assert "load_cell reads" in rig.operator.requests[-1].text  # type: ignore[attr-defined]


def test_another_weight_than_asked_for_is_typed_and_confirmed() -> None:
    event_loop = EventLoop(VirtualClock(), 0.02)
    axis = ManualAxis(
        "mass", "kg", Typist("1.5", "1.5"), event_loop, lambda: 1.46, "load_cell", 0.1, marked=True
    )
    setting = axis.set(1.154)
    assert (setting.asked, setting.taken, setting.read) == (1.154, 1.5, 1.46)


def test_a_load_is_given_a_catch_and_the_record_says_so_when_it_was_needed(tmp_path: Path) -> None:
    kind, config = procedure("isotonic"), weights_rig()

    def fail(runner: Runner, record: object) -> None:
        del record

        def look() -> None:
            if runner.progress.done == 2:
                assert runner.rig.bench is not None
                runner.rig.bench.board.sensor_override = 4000

        runner.rig.event_loop.add(look)

    result = run_protocol(
        kind, config, kind.read("isotonic-short", config), tmp_path, on_start=fail
    )
    assert result.outcome == "faulted"
    events = open_run(result.folder).events
    assert [e["below_mm"] for e in events if e["kind"] == "catch"] == [3.0]
    (lowered,) = (e for e in events if e["kind"] == "lowered")
    assert (lowered["done"], lowered["catch_mm"]) == (False, 3.0)


@pytest.mark.parametrize("rig", ["virtual", "virtual-laser"])
def test_a_load_that_stretches_the_muscle_too_far_ends_the_test_before_it_is_filled(
    rig: str, tmp_path: Path
) -> None:
    """15 kg: the test ended with `vent_lost`, or with a length outside the calibration."""
    config = load_rig(rig)
    assert config.limits.length_max_mm == 72.5
    result, run, _ = run_short(
        "isotonic", tmp_path, config=config, masses_kg=(5.0, 15.0), pressures_kpa=(300.0,)
    )
    assert result.outcome == "faulted"
    words = (
        r"vented muscle is (79|80)\.\d mm long under 15 kg: above limits.length_max_mm = 72.5 by"
    )
    assert re.search(words, str(result.error)), result.error
    assert "load.stretch = 0.05" in str(result.error)
    loads = [e for e in run.events if e["kind"] == "load"]
    assert [e["mass_kg"] for e in loads] == [5.0, 15.0]
    after = [e for e in run.events if e["n"] > loads[1]["n"]]
    assert not [e for e in after if e["kind"] in ("command", "point") and e.get("pressure_kpa")]


# ---- the isometric test has the habits of the others ------------------------------------


def test_an_isometric_test_goes_abba_through_mountings_after_a_leak_check(tmp_path: Path) -> None:
    config = load_rig("virtual")
    text = find_config("isometric-short", "protocols")[0]
    for old, new in (
        ("lengths_mm = [60.0]", "lengths_mm = [58.0, 64.0]"),
        ("pressures_kpa = [100, 200, 300]", "pressures_kpa = [200]"),
        ('order = "up-down"', 'order = "abba"'),
        ("repeats = 1", "repeats = 2"),
        ('mountings = ["m1"]', 'mountings = ["m1", "m2"]'),
        ("[settle] ", "[leak_check]\npressure_kpa = 300\nhold_s = 1.0\n\n[settle] "),
    ):
        assert old in text
        text = text.replace(old, new, 1)
    path = tmp_path / "mine.toml"
    path.write_text(text)
    plan = load_isometric(str(path), config.limits)
    result = run_isometric(config, plan, tmp_path / "runs", derive=False)
    assert result.outcome == "clean", result.error
    run = open_run(result.folder)
    begun = [e for e in run.events if e["kind"] == "trial" and e["phase"] == "begin"]
    assert [(e["slot"], e["replicate"], e["mounting"]) for e in begun] == [
        ("L58", 1, "m1"), ("L64", 1, "m1"), ("L64", 2, "m1"), ("L58", 2, "m1"),
        ("L58", 3, "m2"), ("L64", 3, "m2"), ("L64", 4, "m2"), ("L58", 4, "m2"),
    ]  # fmt: skip
    assert [e["mounting"] for e in run.events if e["kind"] == "mounted"] == ["m2"]
    (leak,) = (e for e in run.events if e["kind"] == "leak")
    assert leak["tight"]
    assert sorted(set(reduce_run(run).table["mounting"])) == ["m1", "m2"]
