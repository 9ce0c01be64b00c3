"""Axes that a person sets: asked, timed, checked by a sensor, recorded as read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bench_runs import quick
from daq.clock import VirtualClock
from daq.errors import DeviceError
from daq.run import open_run
from rigs.config import load_rig
from rigs.doctor import examine
from rigs.operator import ManualAxis, Request, ask_number
from rigs.pump import Pump
from rigs.rig import open_rig
from rigs.session import run_isometric
from rigs.virtual.operator import VirtualOperator


class Desk:
    def __init__(self, spread: float = 0.0) -> None:
        self.clock = VirtualClock()
        self.pump = Pump(self.clock, 0.02)
        self.at = 0.0
        self.person = VirtualOperator(
            self.clock, {"mass": self.put}, {"gauge": lambda: 12.5},
            np.random.default_rng(1), {"mass": spread},
        )  # fmt: skip

    def put(self, value: float) -> None:
        self.at = value


def test_it_asks_waits_checks_and_tells_what_was_read() -> None:
    desk = Desk(spread=0.01)
    axis = ManualAxis("mass", "kg", desk.person, desk.pump, lambda: desk.at, "load_cell", 0.1)
    heard = []
    axis.on_setting.append(heard.append)
    setting = axis.set(2.0)
    assert setting.read == desk.at != 2.0
    assert setting.checked_by == "load_cell"
    assert setting.waited_s == pytest.approx(5.0, abs=0.05)
    assert heard == [setting]
    assert desk.person.asked[0].text == (
        "hang 2 kg on the muscle and let it come to rest, then press Enter"
    )


def test_what_the_sensor_does_not_see_is_asked_again_and_then_refused() -> None:
    desk = Desk()
    axis = ManualAxis("mass", "kg", desk.person, desk.pump, lambda: 1.5, "load_cell", 0.1)
    with pytest.raises(DeviceError, match=r"asked for 2 kg, load_cell reads 1.5 after 3 tries"):
        axis.set(2.0)
    assert len(desk.person.asked) == 3
    assert "load_cell reads 1.5 kg" in desk.person.asked[1].text


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
    pump = Pump(VirtualClock(), 0.02)
    request = Request("gauge", float("nan"), "kPa", "read the gauge")
    assert ask_number(Typist(*words), pump, request) == 12.5


def test_a_decimal_comma_three_times_is_refused() -> None:
    pump = Pump(VirtualClock(), 0.02)
    request = Request("gauge", float("nan"), "kPa", "read the gauge")
    with pytest.raises(DeviceError, match="'12,5' is no number in kPa"):
        ask_number(Typist("12,5", "12,5", "12,5"), pump, request)


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
    result = run_isometric(config, protocol, tmp_path / "runs")
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
    table = run.table
    assert (abs(table["length_mm"] - table["set_length_mm"]) < 0.25).all()
    assert (table["length_mm"] != table["set_length_mm"]).all()
    assert not [f for f in examine(manual_rig(tmp_path), tmp_path) if f.status == "stop"]


def test_a_temperature_set_by_hand_and_looked_after_by_the_thermometer() -> None:
    with open_rig(load_rig("virtual-instruments")) as rig:
        setting = rig.axes["temperature"].set(35.0)
        assert setting.read == pytest.approx(35.0, abs=1.0)
        assert setting.read != 35.0
        assert setting.checked_by == "thermometer"
