"""Switching capture: the simulated valve's delays come back within 0.1 ms."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from analysis.reduction.switching import Block, air_delay_ms, switching_times
from daq.clock import VirtualClock
from daq.errors import DeviceError
from plant.constants import PlantConstants
from plant.physics.valve import off_delay_s, on_delay_s
from rigs.devices.event_loop import EventLoop
from rigs.devices.valve_controller import ValveController
from rigs.rigfile.config import load_rig
from rigs.steps.valve import capture_block
from rigs.virtual.bench import VirtualBench
from test_valvefw_safety import thesis, virtual
from valvefw.wire import CAPTURE_LEAD_US, CAPTURE_N, CAPTURE_US

RIG = {"virtual": virtual, "virtual-thesis": thesis}


class Set:
    """A rig armed for captures."""

    def __init__(self, name: str, seed: int = 0) -> None:
        rig = load_rig(name, seed)
        assert rig.virtual is not None
        rig = replace(rig, virtual=replace(rig.virtual, source="valve"))
        self.clock = VirtualClock()
        self.bench = VirtualBench(rig, self.clock)
        self.event_loop = EventLoop(self.clock, 0.02)
        self.valve = ValveController(self.bench.links["valve"], self.clock, self.event_loop)
        self.event_loop.add(self.valve.poll)
        self.valve.connect(rig.valve.serial, rig.valve.firmware)
        # Pressures are put there at once, which no valve could do.
        self.valve.configure({"jump": 4095, "leak_counts": 0})
        self.valve.progress(60.0)

    def block(self, valve: str, kpa: float, width_us: int = 16_000, source: int = 1) -> Block:
        """At ``kpa`` upstream of the valve, and nothing downstream."""
        self.valve.arm()
        self.valve.request("scheme open")
        self.bench.plant.set_supply(kpa)
        self.bench.plant.set_pressure(kpa if valve == "vent" else 0.0)
        self.event_loop.for_seconds(0.002)
        block = capture_block(self.valve, self.event_loop, valve, width_us, source)
        self.valve.stop()
        self.event_loop.for_seconds(0.2)
        return block


@pytest.mark.parametrize("name", RIG)
@pytest.mark.parametrize("valve", ["inlet", "vent"])
def test_delays_are_recovered_within_a_tenth_of_a_millisecond(name: str, valve: str) -> None:
    constants: Callable[[], PlantConstants] = RIG[name]
    c = constants()
    bench = Set(name)
    solenoid = "inlet" if valve == "inlet" else "outlet"
    for kpa in (50, 100, 200, 300, 400, 500, 600):
        block = bench.block(valve, kpa)
        assert 0 <= block.lead_us - CAPTURE_LEAD_US <= 2000  # measured; the loop may be busy
        assert len(block.counts) == CAPTURE_N
        found = switching_times(block)
        assert found.on_ms == pytest.approx(on_delay_s(solenoid, kpa * 1e3, c) * 1e3, abs=0.1)
        assert found.off_ms == pytest.approx(off_delay_s(solenoid, kpa * 1e3, c) * 1e3, abs=0.1)
    assert not bench.valve.faults


def test_at_0_kpa_nothing_flows_and_it_says_so() -> None:
    with pytest.raises(DeviceError, match="no flow"):
        switching_times(Set("virtual-thesis").block("vent", 0.0))


def test_a_command_shorter_than_the_delay_gives_no_flow() -> None:
    with pytest.raises(DeviceError, match="no flow"):
        switching_times(Set("virtual-thesis").block("inlet", 500.0, 9_000))


def test_the_pressure_sensor_is_the_other_source() -> None:
    block = Set("virtual-thesis").block("inlet", 550.0, source=0)
    assert block.counts[:100].mean() < 10
    assert block.counts[-20:].mean() / 4.095 > 100.0


def test_the_line_is_62_mm_at_65_m_s() -> None:
    assert air_delay_ms() == pytest.approx(0.954, abs=5e-4)
    assert CAPTURE_N * CAPTURE_US == 40_000


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("capture inlet 16000 1", "not armed"),
        ("capture outlet 16000 1", "range"),
        ("capture inlet 30005 1", "range"),
        ("capture inlet 16001 1", "range"),
        ("capture inlet 16000 2", "range"),
        ("block 0", "busy"),
        ("block 800", "range"),
    ],
)
def test_refusals(text: str, code: str) -> None:
    bench = Set("virtual")
    with pytest.raises(DeviceError, match=code.replace(" ", "_")):
        bench.valve.request(text)
