"""Pull the plug: every accident of the safety contract, on both simulated benches.

Told by the bench's own truth, not by what the firmware says: when venting was commanded, and when
the muscle was below 20 kPa. Time is virtual, except where a process is killed.
"""

from __future__ import annotations

import os
import random
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from daq.clock import VirtualClock
from daq.errors import LinkLost
from daq.link.transport import MemoryLink
from plant.constants import PlantConstants
from rigs.devices.event_loop import EventLoop
from rigs.devices.valve_controller import ValveController
from rigs.rigfile.config import load_rig
from rigs.virtual.bench import VirtualBench
from rigs.virtual.board.tuning import burst_parameters, safety_parameters
from test_valvefw_safety import Bench, thesis, virtual
from valvefw.config import PARAMETERS
from valvefw.core import CAUSES, COUNTS, DT, INLET_US, Core, begin_run, check_plausible
from valvefw.safety import Safety
from valvefw.wire import encode_frame

COMMANDED_US = 350_000
OVER_PRESSURE_US = 10_000
EMPTY_S = {"virtual": 1.5, "thesis": 0.3}
EMPTY_KPA = 20.0
CONSTANTS: dict[str, Callable[[], PlantConstants]] = {"virtual": virtual, "thesis": thesis}
SOAK_S = 1800.0 if os.environ.get("PAMRIG_CAMPAIGN") else 60.0
RIG = {"virtual": "virtual", "thesis": "virtual-thesis"}


class Plugged(Bench):
    """A bench at pressure, whose plugs can be pulled."""

    def __init__(self, name: str, seed: int = 0, **board: object) -> None:
        constants = CONSTANTS[name]()
        if name == "thesis":
            board.setdefault("outlet_normally_open", False)
        super().__init__(constants, seed, **board)
        self.name = name
        self.supply_kpa = constants.supply_pa * 1e-3
        for key, value in {**burst_parameters(constants), **safety_parameters(constants)}.items():
            assert self.ask(f"set {key} {value}").startswith("ok"), key

    def hold(self, share: float = 0.75) -> None:
        """Armed, at a share of supply, standing."""
        self.arm("burst")
        assert self.ask(f"sp {round(share * self.supply_kpa * 4.095 * 16)}").startswith("ok")
        self.run(2.0)
        assert self.board.pressure_kpa == pytest.approx(share * self.supply_kpa, rel=0.05)

    def fill(self) -> None:
        """Armed and in the middle of a fill."""
        self.arm("burst")
        assert self.ask(f"sp {round(0.85 * self.supply_kpa * 4.095 * 16)}").startswith("ok")
        while self.board.pressure_kpa < 0.3 * self.supply_kpa:
            self.board.run_until_us(self.board.bench_us + 1000)

    def prove(self, event_us: int, limit_us: int = COMMANDED_US, seconds: float = 2.5) -> None:
        """From the event on: venting commanded in time, the muscle empty in time, and so it stays.

        Call with the host in whatever state it is left; it is not heard from any more.
        """
        self.board.run_until_us(event_us + round(seconds * 1e6))
        commanded_us = self.board.vent_commanded_us
        assert event_us <= commanded_us <= event_us + limit_us
        assert self.below_20_after_s(commanded_us) < EMPTY_S[self.name]
        assert self.board.pressure_kpa < EMPTY_KPA

    def latched(self) -> list[str]:
        words = dict(w.split("=") for w in self.ask("faults").split()[1:])
        return [words[f"f{k + 1}"] for k in range(int(words["n"]))]


@pytest.fixture(params=["virtual", "thesis"])
def name(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(params=["hold", "fill"])
def plugged(request: pytest.FixtureRequest, name: str) -> Plugged:
    bench = Plugged(name)
    getattr(bench, request.param)()
    return bench


def test_host_killed(plugged: Plugged) -> None:
    plugged.ask(f"hb {plugged.number + 1}")
    plugged.prove(plugged.board.bench_us)
    assert plugged.latched() == ["host_silent"]


def test_host_killed_across_the_wrap_of_device_time(name: str) -> None:
    bench = Plugged(name, start_ticks_us=2**32 - 2_200_000)
    bench.hold()
    while bench.board.ticks_us() > 1000 and bench.board.ticks_us() < 2**32 - 150_000:
        bench.run(0.05)
    assert bench.board.ticks_us() > 2**31  # the deadline lies beyond the wrap
    bench.ask(f"hb {bench.number + 1}")
    bench.prove(bench.board.bench_us)
    assert bench.board.ticks_us() < 2**31
    assert bench.latched() == ["host_silent"]


@pytest.mark.parametrize("rate", [12, 1000])
def test_garbage_at_full_rate(plugged: Plugged, rate: int) -> None:
    """115200 baud, and what USB can carry; from now on no good frame comes."""
    event_us = plugged.board.bench_us
    rng = random.Random(rate)
    for _ in range(600):
        plugged.board.feed(rng.randbytes(rate))
        plugged.board.run_until_us(plugged.board.bench_us + 1000)
    plugged.prove(event_us)
    plugged.board.feed(b"\x00")
    assert plugged.latched() == ["host_silent"]


def test_firmware_reset_in_mid_run(plugged: Plugged) -> None:
    before = plugged.board.controller.telemetry.boot_id
    event_us = plugged.board.bench_us
    plugged.board.reset("brownout")
    plugged.run(0.5)  # the host goes on as if nothing had been
    plugged.prove(event_us)
    assert plugged.board.controller.telemetry.boot_id != before
    assert not plugged.board.controller.safety.armed
    assert any("cause=brownout" in text for _, text in plugged.events)


def test_firmware_hung(plugged: Plugged) -> None:
    event_us = plugged.board.bench_us
    plugged.board.freeze()
    plugged.prove(event_us)
    plugged.listen()
    assert any("cause=watchdog" in text for _, text in plugged.events)


SENSOR = {
    "high": (lambda board: 4095, {"over_pressure", "sensor_saturated"}),
    "low": (lambda board: 0, {"sensor_jump", "sensor_no_rise"}),
    "frozen": (lambda board: board.adc(), {"sensor_stuck", "sensor_jump", "inlet_bound"}),
    "silent": (lambda board: -1, {"sensor_silent"}),
}


@pytest.mark.parametrize("how", SENSOR)
def test_sensor(plugged: Plugged, how: str) -> None:
    counts, causes = SENSOR[how]
    event_us = plugged.board.bench_us
    plugged.board.sensor_override = counts(plugged.board)
    beaten_us = event_us
    for _ in range(20):  # the host is well and beats on
        plugged.number += 1
        plugged.board.feed(encode_frame(b"Q0 hb %d" % plugged.number))
        beaten_us += 50_000
        plugged.board.run_until_us(beaten_us)
    plugged.prove(event_us)
    assert plugged.latched()[0] in causes


def test_sensor_broken_low_from_the_start(name: str) -> None:
    """Vented it reads 0 and nothing is wrong; the first fill tells."""
    bench = Plugged(name)
    bench.board.sensor_override = 0
    bench.arm("burst")
    assert bench.ask("sp 20000").startswith("ok")
    event_us = bench.board.bench_us
    bench.run(0.35)
    bench.prove(event_us)
    assert bench.latched()[0] == "sensor_no_rise"


def test_an_inlet_that_had_no_time_to_fall_shut_is_open_at_once() -> None:
    """A wire breaks, and the inlet opens again 2 ms after it was let go."""
    core = Core()
    s = core.state
    values = {name: value for name, value, *_ in PARAMETERS}
    values |= {"valve_on_in_us": 10_872, "valve_off_in_us": 8_500, "rise_ms": 8, "slew": 92}
    Safety(core, values)
    s[COUNTS], s[DT] = 100, 1000
    begin_run(s)
    course = [(100, 1000)] * 12 + [(160, 0)] * 2 + [(0, 1000)] * 20
    causes = []
    for s[COUNTS], s[INLET_US] in course:
        causes.append(check_plausible(s))
    first = next(k for k, cause in enumerate(causes) if cause)
    assert CAUSES[causes[first] - 1] == "sensor_no_rise"
    assert first - 14 < 8


@pytest.mark.parametrize("share", [0.04, 0.08, 0.15])
def test_a_wire_that_breaks_at_low_pressure_behind_shut_valves(name: str, share: float) -> None:
    """Too low for a jump: it was filled, up to all of the supply, before nothing rose."""
    bench = Plugged(name)
    bench.hold(share)
    bench.run(0.1)
    before_kpa, event_us = bench.board.pressure_kpa, bench.board.bench_us
    bench.board.sensor_override = 0
    bench.run(0.35)
    bench.prove(event_us)
    t, kpa = np.array(bench.board.truth_us), np.array(bench.board.truth_kpa)
    assert kpa[t > event_us].max() < before_kpa + 5.0
    assert bench.latched()[0] in ("outlet_stuck", "sensor_jump")


def test_supply_surge(name: str) -> None:
    """The regulator fails open while the inlet is open: 10 ms from the limit to the command."""
    bench = Plugged(name)
    trip_kpa = 0.95 * bench.supply_kpa
    sp_max = round(0.9 * bench.supply_kpa * 4.095)
    assert bench.ask(f"set sp_max {sp_max}").startswith("ok")
    assert bench.ask(f"set trip {round(trip_kpa * 4.095)}").startswith("ok")
    assert bench.ask("set slew 200").startswith("ok")  # the surge itself is steeper than the valve
    bench.arm("open")
    assert bench.ask("pulse inlet 900000").startswith("ok")
    while bench.board.pressure_kpa < 0.6 * bench.supply_kpa:
        bench.run(0.001)
    bench.plant.set_supply(1.5 * bench.supply_kpa)
    while bench.board.pressure_kpa < trip_kpa:
        bench.run(0.001)
    event_us = bench.board.bench_us
    bench.run(0.02)
    # The muscle goes on rising for as long as the inlet takes to fall shut.
    bench.prove(event_us, OVER_PRESSURE_US)
    assert bench.latched()[0] == "over_pressure"


@pytest.mark.parametrize("share", [0.25, 0.6])
def test_inlet_stuck_open_is_found_vented_latched_and_told(name: str, share: float) -> None:
    bench = Plugged(name)
    bench.hold(share)
    event_us = bench.board.bench_us
    bench.board.inlet_jammed = True
    bench.run(0.4)
    assert event_us <= bench.board.vent_commanded_us <= event_us + COMMANDED_US
    assert any("cause=inlet_stuck" in text for _, text in bench.events)
    bench.run(3.0)  # it cannot be vented: both orifices are alike
    assert bench.board.pressure_kpa > EMPTY_KPA
    assert bench.latched() == ["inlet_stuck", "vent_failed", "vent_lost"]
    assert bench.ask("clear").startswith("err pressure")


def test_inlet_that_sticks_during_a_fill_is_found_at_its_end(name: str) -> None:
    bench = Plugged(name)
    bench.fill()
    bench.board.inlet_jammed = True
    while bench.plant.constants and bench.board.controller.valves.inlet_us:
        bench.run(0.001)
    event_us = bench.board.bench_us  # told to shut, and does not
    bench.run(0.4)
    assert bench.board.vent_commanded_us <= event_us + COMMANDED_US
    assert bench.latched()[0] in ("inlet_stuck", "over_pressure")


def test_outlet_stuck_open_is_found_and_told(name: str) -> None:
    bench = Plugged(name)
    bench.hold()
    event_us = bench.board.bench_us
    bench.board.outlet_jammed = True
    bench.run(0.4)
    bench.prove(event_us)
    assert bench.latched() == ["outlet_stuck"]


def test_pressure_that_comes_back_after_the_vent_is_told(name: str) -> None:
    bench = Plugged(name)
    bench.run(0.5)
    bench.board.inlet_jammed = True
    bench.run(1.0)
    assert "vent_lost" in bench.latched()


@pytest.mark.parametrize("rate_mm_s", [-10.0, 10.0])
def test_a_stage_at_full_speed_is_no_stuck_valve(name: str, rate_mm_s: float) -> None:
    """Both valves shut, the muscle squeezed or drawn by the stage: no false alarm."""
    bench = Plugged(name)
    bench.plant.set_length(68.0 if rate_mm_s < 0 else 53.0)
    bench.hold(0.6)
    bench.plant.set_length_rate(rate_mm_s)
    bench.run(1.4)
    bench.plant.set_length_rate(0.0)
    bench.run(1.0)
    assert bench.latched() == []


def test_an_hour_of_standing_pressure_raises_no_alarm(name: str) -> None:
    """Two minutes here; the whole hour is the campaign's."""
    bench = Plugged(name)
    bench.hold(0.3)
    bench.run(SOAK_S)
    assert bench.ask(f"sp {round(0.8 * bench.supply_kpa * 4.095 * 16)}").startswith("ok")
    bench.run(SOAK_S)
    assert bench.latched() == []


# With the host's own driver in between.


class Hosted:
    """Driver, event loop and clock of the host on a whole virtual bench."""

    def __init__(self, name: str) -> None:
        rig = load_rig(RIG[name])
        assert rig.virtual is not None
        rig = replace(rig, virtual=replace(rig.virtual, source="valve"))
        self.clock = VirtualClock()
        self.bench = VirtualBench(rig, self.clock)
        link = self.bench.links["valve"]
        assert isinstance(link, MemoryLink)
        self.link = link
        self.event_loop = EventLoop(self.clock, 0.02)
        self.valve = ValveController(self.link, self.clock, self.event_loop)
        self.event_loop.add(self.valve.poll)
        self.valve.connect(rig.valve.serial, rig.valve.firmware)
        constants = self.bench.plant.constants
        supply = constants.supply_pa * 1e-3
        self.valve.configure({**burst_parameters(constants), **safety_parameters(constants)})
        self.valve.progress(10.0)
        self.valve.arm()
        self.valve.request("scheme burst")
        self.valve.set_point(0.8 * supply * 4.095)
        self.event_loop.for_seconds(2.0)
        assert self.bench.board.pressure_kpa == pytest.approx(0.8 * supply, rel=0.05)

    def prove(self, name: str, event_us: int) -> None:
        board = self.bench.board
        self.clock.sleep(2.5)
        assert event_us <= board.vent_commanded_us <= event_us + COMMANDED_US
        t = np.array(board.truth_us)
        high = t[np.array(board.truth_kpa) >= EMPTY_KPA]
        assert (high[-1] - board.vent_commanded_us) / 1e6 < EMPTY_S[name]
        assert board.controller.safety.faults[0][0] == "host_silent"


def test_host_hung_with_the_port_open(name: str) -> None:
    """Stopped as by SIGSTOP: the port stays open and nothing is sent any more."""
    host = Hosted(name)
    host.prove(name, host.bench.board.bench_us)


def test_cable_pulled(name: str) -> None:
    host = Hosted(name)
    event_us = host.bench.board.bench_us
    host.link.unplug()
    with pytest.raises(LinkLost):
        host.event_loop.for_seconds(0.5)
    host.prove(name, event_us)


def test_a_protocol_that_makes_no_progress_stops_the_heartbeat(name: str) -> None:
    """The process lives and its loop turns, but no step reports: 0.2 s were granted."""
    host = Hosted(name)
    host.valve.progress(0.2)
    event_us = host.bench.board.bench_us + 200_000
    host.event_loop.for_seconds(3.0)
    host.prove(name, event_us)
    assert any("host_silent" in text for text in host.valve.faults)
