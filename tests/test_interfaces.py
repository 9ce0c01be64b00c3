"""The interfaces that devices, emulators and simulators share."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from daq.clock import VirtualClock
from daq.errors import ConfigError, DeviceError
from daq.link.transport import memory_pair
from gap.data.reader import read_dataset
from gap.data.simulator import Simulator
from gap.model.simulator import BuiltIn
from gap_sets import settled_set
from rigs.devices.event_loop import EventLoop
from rigs.devices.instruments.commanded import CommandedInstrument, Setting
from rigs.devices.interfaces import Actuator
from rigs.devices.pressure.solenoids import SolenoidPressure
from rigs.devices.valve_controller import ValveController
from rigs.rigfile.command_form import load_command_form
from rigs.rigfile.config import load_rig
from rigs.rigfile.pressure_source import MODULES, WITHOUT_PORT

REGULATOR = r"""
name = "pressure regulator"
end = "cr"
timeout_s = 0.1

[set.pressure_bar]
command = "P={value:.2f}"
unit = "bar"
low = 0.0
high = 7.0
reply = 'OK'
read_back = "P?"
pattern = 'P=(?P<value>\d+\.\d\d)'
tolerance = 0.01
remedy = "see its keypad"
"""


def test_every_kind_of_pressure_source_has_its_modules() -> None:
    for kind, module in MODULES.items():
        assert callable(import_module(f"rigs.devices.pressure.{module}").open_source)
        if kind not in WITHOUT_PORT:
            assert callable(import_module(f"rigs.virtual.emulators.{module}").emulator)


@pytest.mark.parametrize(
    ("table", "words"),
    [('kind = "solenoid"', "not one of"), ('kind = "regulator-output"', "static_scheme"),
     ('kind = "hand-regulator"', "manual.pressure"), ('kind = "solenoids"\nport = "x"', "unknown")],
)  # fmt: skip
def test_a_pressure_source_that_does_not_fit_the_rig_is_refused(
    table: str, words: str, tmp_path: Path
) -> None:
    path = tmp_path / "rig.toml"
    text = load_rig("virtual").text
    path.write_text(text.replace("[balance]", f"[pressure_source]\n{table}\n\n[balance]", 1))
    with pytest.raises(ConfigError, match=words):
        load_rig(str(path))


def test_a_set_point_above_the_limit_is_refused_before_anything_is_sent() -> None:
    config = load_rig("virtual")
    clock = VirtualClock()
    host, end = memory_pair(clock, "valve")
    source = SolenoidPressure(ValveController(host, clock, EventLoop(clock, 0.005)), config)
    with pytest.raises(DeviceError, match=r"above limits\.pressure_kpa"):
        source.set_pressure(config.limits.pressure_kpa + 1.0)
    assert end.read() == []
    assert source.vented
    assert np.isnan(source.measured_kpa)
    command = source.command(100.0).fields()
    assert (command["device"], command["pressure_kpa"]) == ("valve", 100.0)
    assert command["counts"] == pytest.approx(409.5)


def described(tmp_path: Path, stuck: bool = False) -> tuple[CommandedInstrument, list[bytes]]:
    """A regulator of the description above, and the lines that it was sent."""
    path = tmp_path / "regulator.toml"
    path.write_text(REGULATOR)
    clock = VirtualClock()
    host, end = memory_pair(clock, "line")
    event_loop = EventLoop(clock, 0.005)
    device = CommandedInstrument(host, event_loop, "regulator", load_command_form(str(path)))
    event_loop.add(device.poll)
    said: list[bytes] = []
    held = [0.0]

    def answer(until_ns: int) -> None:
        clock.set_now_ns(until_ns)
        for chunk in end.read():
            for line in chunk.data.split(b"\r")[:-1]:
                said.append(line)
                if line.startswith(b"P="):
                    held[0] = held[0] if stuck else float(line[2:])
                end.write(b"OK\r\n" if b"=" in line else b"P=%.2f\r\n" % held[0])

    clock.on_advance(answer)
    return device, said


def test_a_setting_by_description_is_sent_and_read_back(tmp_path: Path) -> None:
    device, said = described(tmp_path)
    actuator: Actuator = Setting(device, "pressure_bar")
    assert actuator.set_value(2.5) == 2.5
    assert said == [b"P=2.50", b"P?"]
    with pytest.raises(DeviceError, match="8 bar is outside 0 to 7 bar"):
        actuator.set_value(8.0)


def test_a_setting_by_description_that_did_not_take_is_an_error(tmp_path: Path) -> None:
    device, _ = described(tmp_path, stuck=True)
    with pytest.raises(DeviceError, match=r"was commanded 2\.50 bar, is set to 0\.00 bar"):
        device.set("pressure_bar", 2.5)
    assert device.faults.counts == {"unset": 1}


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [("{value:.2f}", "{value.real}", "not a line with"),
     ("{value:.2f}", "{value:d}", "not a line with"),
     ("(?P<value>", "(", "no group"),
     ('unit = "bar"', "", "unit"), ("remedy", "remedie", "unknown")],
)  # fmt: skip
def test_a_description_that_cannot_work_is_refused(
    old: str, new: str, words: str, tmp_path: Path
) -> None:
    path = tmp_path / "bad.toml"
    path.write_text(REGULATOR.replace(old, new))
    with pytest.raises(ConfigError, match=words):
        load_command_form(str(path))


def test_the_built_in_simulator_behind_its_interface(tmp_path: Path) -> None:
    data = read_dataset(settled_set(tmp_path / "set", {}))
    simulator: Simulator = BuiltIn(data)
    names = {p.name: p for p in simulator.parameters}
    assert names["braid_length_mm"].nominal == pytest.approx(88.4, abs=1.0)
    assert names["braid_length_mm"].tolerance > 0.0
    assert [stage.name for stage in simulator.stages] == ["pressure", "force", "camera"]
    trial = data.trials[0]
    made = simulator.simulate(trial, {})["force"]
    assert len(made) == len(trial["force_n"])
    more = simulator.simulate(trial, {"braid_length_mm": names["braid_length_mm"].nominal + 1.0})
    pull = np.abs(made.value - trial["force_n"].value)
    assert float(pull.max()) < 0.2 * float(np.abs(trial["force_n"].value).max())
    assert (more["force"].value[made.value > 5.0] < made.value[made.value > 5.0]).all()
