"""The bench supply, and the solenoids that hang on it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from daq.clock import VirtualClock
from daq.errors import DeviceError, LinkLost
from daq.link.transport import memory_pair
from instrument_desk import Desk
from plant.constants import nominal
from plant.simulator.bench import BenchSim
from rigs.devices.event_loop import EventLoop
from rigs.devices.instruments.supply import Supply
from rigs.virtual.board.solenoids import Solenoids
from rigs.virtual.emulators.supply import VirtualSupply


def desk_of(reopen: bool = True, serial: str = "PS-1") -> tuple[Desk, Supply]:
    desk = Desk(lambda read, send: VirtualSupply(send, serial))
    supply = Supply(desk.host, desk.event_loop, 12.0, 24.0, reopen=desk.reopen if reopen else None)
    desk.event_loop.add(supply.poll)
    return desk, supply


def test_the_commands_byte_by_byte() -> None:
    clock = VirtualClock()
    host, end = memory_pair(clock, "line")
    event_loop = EventLoop(clock, 0.005)
    supply = Supply(host, event_loop, 12.0, 24.0)
    event_loop.add(supply.poll)
    answers = {
        b"SYST:ERR?\n": b'0,"No error"\r\n',
        b"VOLT?\n": b"+3.500000E+00\n",
        b"OUTP?\n": b"1\n",
        b"MEAS:VOLT?\n": b"3.4990\n",
        b"MEAS:CURR?\n": b"0.0700\n",
    }
    said: list[bytes] = []

    def device(until_ns: int) -> None:
        clock.set_now_ns(until_ns)
        for chunk in end.read():
            for line in chunk.data.splitlines(keepends=True):
                said.append(line)
                if line in answers:
                    end.write(answers[line])

    clock.on_advance(device)
    assert supply.set_voltage(3.5) == 3.5
    supply.output(True)
    assert supply.measure() == (3.499, 0.07)
    assert said == [
        b"VOLT 3.500\n", b"SYST:ERR?\n", b"VOLT?\n",
        b"OUTP ON\n", b"SYST:ERR?\n", b"OUTP?\n",
        b"MEAS:VOLT?\n", b"MEAS:CURR?\n",
    ]  # fmt: skip
    assert supply.faults.counts == {}


def test_it_sets_confirms_and_measures() -> None:
    desk, supply = desk_of()
    assert supply.connect("PS-1")["model"] == "BENCH SUPPLY"
    rows: list[dict[str, Any]] = []
    supply.on_rows.append(rows.append)
    supply.set_voltage(3.5)
    assert supply.measure()[0] == 0.0
    supply.output(True)
    assert supply.measure() == (3.5, 0.07)
    assert [float(r["voltage_v"][0]) for r in rows] == [0.0, 3.5]
    assert desk.device.volts == 3.5


@pytest.mark.parametrize(
    ("fault", "kind"),
    [("half", "half"), ("double", "stale"), ("late", "late"), ("stale", "stale"),
     ("garbage", "no_answer"), ("drop", "no_answer")],
)  # fmt: skip
def test_a_fault_costs_a_request_more_and_never_a_wrong_value(fault: str, kind: str) -> None:
    desk, supply = desk_of()
    supply.connect("")
    supply.output(True)
    for volts in (2.0, 3.0, 4.0, 5.0):
        supply.set_voltage(volts)
        desk.device.wire.arrange(fault)
        assert supply.measure()[0] == volts
    assert supply.faults.counts[kind] >= 4


def test_a_setting_that_did_not_take_is_noticed_by_reading_it_back() -> None:
    desk, supply = desk_of()
    supply.connect("")
    desk.device._set = lambda word, argument: None
    with pytest.raises(DeviceError, match=r"was commanded 5.000 V, is set to"):
        supply.set_voltage(5.0)
    with pytest.raises(DeviceError, match="is 0"):
        supply.output(True)
    assert supply.faults.counts["unset"] == 2


@pytest.mark.parametrize(
    ("change", "kind"),
    [({"comma": True}, "comma"), ({"suffix": " V"}, "damaged"), ({"flag": "overload"}, "overload"),
     ({"flag": "underload"}, "underload"), ({"mute": True}, "no_answer")],
)  # fmt: skip
def test_what_cannot_be_read_is_an_error_not_a_voltage(
    change: dict[str, object], kind: str
) -> None:
    desk, supply = desk_of()
    supply.connect("")
    for key, value in change.items():
        setattr(desk.device, key, value)
    with pytest.raises(DeviceError):
        supply.measure()
    assert supply.faults.counts[kind] >= 1
    assert supply.rows == 0


def test_unplugged_and_plugged_in_again_in_mid_test() -> None:
    desk, supply = desk_of()
    supply.connect("PS-1")
    supply.output(True)
    desk.unplug()
    desk.event_loop.for_seconds(0.5)
    desk.replug()
    supply.set_voltage(4.0)
    assert supply.measure()[0] == 4.0
    assert (supply.faults.counts["unplugged"], supply.faults.counts["replugged"]) == (1, 1)


def test_unplugged_for_good() -> None:
    desk, supply = desk_of()
    supply.connect("PS-1")
    desk.unplug()
    with pytest.raises((LinkLost, DeviceError), match="supply on"):
        supply.set_voltage(4.0)


def test_another_supply_in_its_place_is_refused() -> None:
    desk, supply = desk_of()
    supply.connect("")
    desk.unplug()
    desk.event_loop.for_seconds(0.1)
    desk.device._serial = "PS-2"
    desk.replug()
    with pytest.raises(DeviceError, match="expected PS-1, got PS-2"):
        supply.set_voltage(4.0)


def test_limits_and_refusals() -> None:
    _, supply = desk_of()
    supply.connect("")
    with pytest.raises(DeviceError, match=r"25 V is outside 0 to 24 V"):
        supply.set_voltage(25.0)
    with pytest.raises(DeviceError, match="Undefined header"):
        supply._command("VOLTS 3")
    assert supply.faults.counts["refused"] == 1


# ---- solenoids (Table D-4) ------------------------------------------------------------


def pulse(volts: list[float], outlet: bool = False, start_kpa: float = 0.0) -> float:
    """Pressure after holding a valve command for 40 ms at each voltage in turn."""
    constants = nominal()
    plant = BenchSim(constants)
    plant.set_pressure(start_kpa)
    now = {"v": 0.0}
    solenoids = Solenoids(constants, lambda: now["v"])
    for v in volts:
        now["v"] = v
        for _ in range(40):
            on = 1e-3
            solenoids.advance(
                plant.state, plant.params, 1e-3, 0.0 if outlet else on, on if outlet else 0.0
            )
    return plant.pressure_kpa


def test_the_inlet_opens_at_its_pull_in_voltage_for_this_supply_and_not_below() -> None:
    edge = 3.44 + 0.00145 * 550
    assert pulse([edge - 0.01]) == 0.0
    assert pulse([edge + 0.01]) > 100.0


def test_once_in_it_stays_in_down_to_the_drop_out_voltage() -> None:
    full = pulse([5.0, 5.0, 5.0])
    assert pulse([5.0, 0.81, 0.81]) == pytest.approx(full, abs=1e-6)
    # Dropped out during the first part, it stays out at a voltage that would have held it.
    fell = pulse([5.0, 0.79, 2.0])
    assert fell < full - 20.0


def test_the_outlet_opens_by_the_muscles_own_pressure() -> None:
    for kpa in (100.0, 500.0):
        edge = 2.80 + 0.00071 * kpa
        assert pulse([edge - 0.01], outlet=True, start_kpa=kpa) == pytest.approx(kpa)
        assert pulse([edge + 0.01], outlet=True, start_kpa=kpa) < 0.6 * kpa


def test_a_normally_open_outlet_without_voltage_vents_whatever_it_is_told() -> None:
    constants = nominal().with_overrides({"outlet_normally": "open"})
    plant = BenchSim(constants)
    plant.set_pressure(300.0)
    solenoids = Solenoids(constants, lambda: 0.0)
    for _ in range(500):
        solenoids.advance(plant.state, plant.params, 1e-3, 0.0, 0.0)
    assert plant.pressure_kpa < 1.0
    assert np.isfinite(plant.force_n)
