"""A serial regulator's driver on one side of a line and its emulator on the other."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from typing import Any

from daq.clock import VirtualClock
from daq.errors import LinkLost
from daq.link.transport import memory_pair
from plant.constants import nominal
from plant.simulator.bench import BenchSim
from rigs.devices.event_loop import EventLoop
from rigs.devices.pressure.proportional.alicat_pcd import AlicatLine
from rigs.devices.pressure.proportional.line import RegulatorLine
from rigs.devices.pressure.proportional.smc_itv import ItvLine
from rigs.rigfile.tables.regulator import MonitorForm
from rigs.virtual.emulators.proportional.alicat_pcd import VirtualAlicat
from rigs.virtual.emulators.proportional.outlet import OutletDynamics, RegulatorOutlet
from rigs.virtual.emulators.proportional.smc_itv import VirtualItv

PERIOD_NS = 1_000_000
IDEAL = OutletDynamics(0.02, 0.05, 2000.0, 0.0, 0.0, 0.0, 0.0)


@dataclass
class Desk:
    line: RegulatorLine
    device: Any
    outlet: RegulatorOutlet
    loop: EventLoop
    end: Any
    readings: list[float]
    truths: list[float]


def desk(kind: str, **how: Any) -> Desk:
    """Not yet connected."""
    clock = VirtualClock()
    host, end = memory_pair(clock, "line")
    loop = EventLoop(clock, 0.005)
    outlet = RegulatorOutlet(BenchSim(nominal(), source="regulator"), IDEAL)
    form = MonitorForm("regulator_kpa", "kPa", 5.0, 0.2)
    line: RegulatorLine
    device: VirtualAlicat | VirtualItv
    if kind == "alicat-pcd":
        device = VirtualAlicat(outlet, end.write, "400123", **how)
        line = AlicatLine(host, loop, form, "A")
    else:
        device = VirtualItv(outlet, end.write, 900.0, **how)
        line = ItvLine(host, loop, form, 900.0)
    origin = clock.now_ns()
    now = [0]

    def advance(until_ns: int) -> None:
        with contextlib.suppress(LinkLost):
            for chunk in end.read():
                device.feed(chunk.data)
        while now[0] + PERIOD_NS <= until_ns - origin:
            now[0] += PERIOD_NS
            clock.set_now_ns(origin + now[0])
            device.advance(now[0])

    clock.on_advance(advance)
    made = Desk(line, device, outlet, loop, end, [], [])

    def keep(batch: Any) -> None:
        made.readings.extend(batch["reading"].tolist())
        made.truths.append(outlet.pressure_kpa)

    line.on_rows.append(keep)
    return made
