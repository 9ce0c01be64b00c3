"""The closing vent is seen to its end, whatever else fails. Found by the fault campaign."""

from __future__ import annotations

import dataclasses
import errno
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from protocol_runs import events, run_short
from rigs.bench.rig import Rig, open_rig
from rigs.rigfile.config import load_rig
from rigs.virtual.emulators.supply import VirtualSupply

STAND = "virtual-valve-stand"


@contextmanager
def filled(kpa: float, dead_ml: float = 250.0) -> Iterator[tuple[Rig, Any]]:
    """The valve stand with air in its vessel, both valves shut: (rig, bench)."""
    config = load_rig(STAND)
    assert config.virtual is not None
    plant = {**config.virtual.plant, "dead_volume_ml": dead_ml}
    virtual = dataclasses.replace(config.virtual, plant=plant)
    with open_rig(dataclasses.replace(config, virtual=virtual)) as rig:
        assert rig.bench is not None
        rig.valve.configure({"rise_ms": 300})
        rig.valve.progress(600.0)
        rig.valve.arm()
        rig.valve.request("scheme pwm")
        rig.valve.set_point(float(config.calibrations["pressure_kpa"].raw(kpa)))
        assert rig.event_loop.until(lambda: abs(rig.pressure_kpa - kpa) < 8.0, 60.0)
        rig.valve.request("scheme open")
        yield rig, rig.bench


def once_below(rig: Rig, bench: Any, kpa: float, do: Callable[[], object]) -> None:
    """Do something when the pressure has fallen so far."""
    left = [do]

    def look(until_ns: int) -> None:
        del until_ns
        if left and bench.plant.pressure_kpa < kpa:
            left.pop()()

    rig.clock.on_advance(look)  # type: ignore[attr-defined]


def test_solenoids_that_lose_their_supply_in_the_vent_get_it_back() -> None:
    """An outlet that is shut at rest kept the air in: the supply had been asked once, before."""
    with filled(120.0) as (rig, bench):
        supply = bench.extras.devices["supply"]
        once_below(rig, bench, 70.0, lambda: setattr(supply, "is_on", False))
        assert rig.vent() < 10.0
        assert supply.is_on
        assert bench.plant.pressure_kpa < 12.0


def test_a_supply_that_cannot_say_its_voltage_is_switched_on_all_the_same() -> None:
    with filled(120.0) as (rig, bench):
        supply = bench.extras.devices["supply"]
        supply.flag, supply.is_on = "overload", False
        assert rig.vent() < 10.0


def test_a_large_vessel_is_watched_until_it_is_empty() -> None:
    """It was given up after 5 s, however the pressure fell."""
    with filled(150.0, 1000.0) as (rig, bench):
        assert rig.vent() < 10.0
        assert bench.plant.pressure_kpa < 12.0


def test_a_vent_that_does_nothing_is_given_up() -> None:
    with filled(120.0) as (rig, bench):
        bench.extras.devices["supply"].is_on = False
        bench.unplug("supply")
        begin_ns = rig.clock.now_ns()
        assert rig.vent() > 100.0
        assert (rig.clock.now_ns() - begin_ns) * 1e-9 < 60.0


def test_a_disk_that_fails_does_not_end_the_vent(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The program left with 111 kPa in the vessel: each batch that came raised the disk's error."""
    real, broken = os.write, [False]

    def write(fd: int, data: Any) -> int:
        if broken[0] and "/samples/" in os.readlink(f"/proc/self/fd/{fd}"):
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        return real(fd, data)

    def begin(runner: Any) -> None:
        bench = runner.rig.bench

        def look(until_ns: int) -> None:
            del until_ns
            broken[0] = broken[0] or bench.plant.pressure_kpa > 110.0

        runner.rig.clock.on_advance(look)

    monkeypatch.setattr(os, "write", write)
    result, run, bench = run_short("flow", tmp_path, begin=begin)
    assert "cannot be written" in str(result.error)
    assert [e["confirmed"] for e in events(run, "vented")] == [True]
    assert bench.plant.pressure_kpa < 12.0


def test_venting_by_hand_gives_the_solenoids_their_supply(monkeypatch: pytest.MonkeyPatch) -> None:
    """`pamrig vent` told the controller alone: an outlet without voltage stayed shut."""
    from rigs.bench.vent import vent_rig

    made: list[VirtualSupply] = []
    init = VirtualSupply.__init__

    def keep(self: VirtualSupply, *args: Any, **more: Any) -> None:
        init(self, *args, **more)
        made.append(self)

    monkeypatch.setattr(VirtualSupply, "__init__", keep)
    assert vent_rig(load_rig(STAND)) < 10.0
    assert made[0].is_on
    assert made[0].set_v == 10.0
