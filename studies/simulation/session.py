"""Simulation of a scenario: build the scene, run it with the firmware, write the record.

The record is like that of any run: telemetry of the controllers, readings of the sensors, events.
In addition it has the stream ``truth``. The clock is the simulated time.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from daq.clock import VirtualClock
from daq.errors import PamrigError, RecordError
from daq.interrupt import StopFlag, Stopped
from daq.link.clockfit import ClockMap
from daq.link.codec import CodecError
from daq.record.disk import check_disk
from daq.record.writer import RecordWriter
from plant.errors import PlantError
from plant.scene.layout import SUBSTEPS
from plant.scene.scene import Scene, Unit
from rigs.virtual.board.pressure_sensor import ADC_TOP, PressureSensor
from rigs.virtual.board.scene_loop import BOOT_TICKS, SceneLoop
from rigs.virtual.board.tuning import burst_parameters, safety_parameters
from studies.simulation.controllers import Controllers
from studies.simulation.manifest import manifest
from studies.simulation.readings import Readings
from studies.simulation.scenario import Command, Scenario, plant_refusal
from valvefw import wire

NS_PER_TICK = wire.TICK_US * 1000
PROGRESS_TICKS = 100
TRIP_ABOVE_KPA = 50.0

Progress = Callable[[float, float], None]


class SimulationFault(PamrigError):
    """The firmware latched a fault; the message states the muscle and the cause."""


@dataclass(frozen=True)
class Outcome:
    """Outcome and duration of a simulation."""

    folder: Path
    outcome: str
    reason: str
    simulated_s: float
    took_s: float


def build_scene(scenario: Scenario) -> Scene:
    """The plant of a scenario.

    Raises:
        ConfigError: its parts are inconsistent, such as a length outside the braid.
    """
    units = [
        Unit(
            m.name,
            m.constants,
            m.effects,
            model=m.model if scenario.mechanism.ram is None else _piston(scenario),
            reach=m.reach,
            rest_m=m.rest_m,
            tendon=m.tendon,
            pressure_pa=m.start_kpa * 1e3,
            temperature_c=scenario.temperature_c,
        )
        for m in scenario.muscles
    ]
    mechanism = scenario.mechanism
    try:
        return Scene(
            units,
            mechanism.coordinates,
            mechanism.arm,
            mechanism.switches,
            step_share=scenario.step_share,
        )
    except PlantError as error:
        raise plant_refusal(error, scenario.source) from None


def _piston(scenario: Scenario) -> Any:
    from plant.scene.scene import Piston

    assert scenario.mechanism.ram is not None
    return Piston(scenario.mechanism.ram.area_m2)


def firmware_values(scenario: Scenario, muscle: int, counts_per_kpa: float) -> dict[str, int]:
    """Firmware parameters of one muscle: those from the plant, then those of the scenario.

    If the load moves, the pressure changes with closed valves, so the leak monitor is off. In the
    large chamber of the ram the pressure rises too slowly for the monitor of the sensor, which is
    off too.
    """
    m = scenario.muscles[muscle]
    c = m.constants
    top_kpa = c.supply_pa * 1e-3 + TRIP_ABOVE_KPA
    values = {**burst_parameters(c), **safety_parameters(c), "inlet_max_ms": 2000}
    values["trip"] = min(ADC_TOP - 1, round(top_kpa * counts_per_kpa))
    values["sp_max"] = min(values["trip"], round(c.supply_pa * 1e-3 * counts_per_kpa))
    if scenario.mechanism.kind != "held":
        values["leak_counts"] = 0
    if scenario.mechanism.kind == "ram":
        values["rise_ms"] = 0
    if scenario.sensors.pressure_noise_kpa == 0.0:
        values["stuck_ms"] = 0
    return {**values, **m.parameters}


def simulate(
    scenario: Scenario,
    root: Path | str = "runs",
    *,
    stop: StopFlag | None = None,
    progress: Progress | None = None,
) -> Outcome:
    """Run a scenario and write a complete record.

    Args:
        scenario: from `load_scenario`.
        root: folder of runs.
        stop: set from outside to end the run.
        progress: called with simulated and total time in s, every 0.1 s of simulated time.

    Raises:
        ConfigError: the scenario is inconsistent; nothing was recorded.
        RecordError: the run cannot be recorded.
    """
    scene = build_scene(scenario)
    check_disk(Path(root), 0)
    clock = VirtualClock()
    record = RecordWriter(root, manifest(scenario), clock, durable=False, threaded=False)
    controllers = Controllers(scenario, record, clock)
    readings = Readings(scenario, scene, record)
    sensor = PressureSensor(
        high_kpa=scenario.sensors.pressure_range_kpa,
        noise_kpa=scenario.sensors.pressure_noise_kpa,
        zero_kpa=scenario.sensors.pressure_zero_kpa,
        gain=scenario.sensors.pressure_gain,
    )
    count = len(scenario.muscles)
    loop = SceneLoop(
        scene,
        scenario.seed,
        [sensor] * count,
        [firmware_values(scenario, k, sensor.counts_per_kpa) for k in range(count)],
        [controllers.sink(k) for k in range(count)],
    )
    error: BaseException | None = None
    readings.flush()
    import pyarrow as _  # noqa: F401  import it before the time is measured

    began = time.perf_counter()
    runner = _Runner(scenario, loop, record, controllers, readings, clock)
    try:
        runner.run(stop or StopFlag(), progress)
    except (PamrigError, Stopped) as caught:
        error = caught
    except BaseException as caught:
        error = caught
        raise
    finally:
        took = time.perf_counter() - began
        outcome = _outcome(error)
        readings.flush()
        _finish(record, controllers, loop, outcome, error, runner.time_s, took)
    reason = str(error) if error is not None else ""
    return Outcome(record.folder, outcome, reason, runner.time_s, took)


@dataclass
class _Runner:
    """The tick loop of one simulation, with its commands and windows."""

    scenario: Scenario
    loop: SceneLoop
    record: RecordWriter
    controllers: Controllers
    readings: Readings
    clock: VirtualClock
    time_s: float = 0.0

    def __post_init__(self) -> None:
        self._counts_x16 = 16.0 * ADC_TOP / self.scenario.sensors.pressure_range_kpa

    def run(self, stop: StopFlag, progress: Progress | None) -> None:  # noqa: C901 - the sequence of one tick
        """Boot and arm, then run the scenario tick by tick."""
        record, loop = self.record, self.loop
        record.event("state", state="boot")
        for tick in range(BOOT_TICKS):
            loop.tick()
            self._after(tick + 1)
        for board in loop.boards:
            board.controller.safety.arm(board.controller.values)
        record.event("armed")
        record.event("state", state="simulate")
        record.event("trial", phase="begin", **self._trial())
        todo = list(self.scenario.commands)
        windows = list(self.scenario.windows)
        opened: list[tuple[Any, dict[str, list[int]]]] = []
        total = round(self.scenario.duration_s * 1000)
        order = 0
        for tick in range(total):
            now_s = tick * 1e-3
            while todo and todo[0].at_s <= now_s + 1e-9:
                self._command(todo.pop(0))
            while windows and windows[0].at_s <= now_s + 1e-9:
                opened.append((windows.pop(0), self.readings.rows()))
            loop.tick()
            self._after(BOOT_TICKS + tick + 1)
            self.time_s = (tick + 1) * 1e-3
            for window, begin in list(opened):
                if window.at_s + window.seconds <= self.time_s + 1e-9:
                    order += 1
                    self._point(window, begin, order)
                    opened.remove((window, begin))
            if (tick + 1) % PROGRESS_TICKS == 0 or tick + 1 == total:
                if progress is not None:
                    progress(self.time_s, self.scenario.duration_s)
                if record.failed is not None:
                    raise record.failed
            stop.check()
            if self.controllers.refused:
                raise SimulationFault(
                    self.scenario.source,
                    f"the firmware refused a command, {self.controllers.refused}",
                    "correct the table [[command]]; see docs/reference/wire-format.md",
                )
            if loop.faults:
                name, cause = loop.faults[0]
                raise SimulationFault(
                    f"{self.scenario.source}: muscle {name!r}",
                    f"the firmware latched {cause} after {self.time_s:.3f} s",
                    "see the trace, and docs/reference/safety-contract.md for the causes of faults",
                )
        record.event("trial", phase="end", trial=1)
        record.event("state", state="done")

    def _trial(self) -> dict[str, Any]:
        """Fields of the trial event; the whole simulation is one trial."""
        mechanism = self.scenario.mechanism
        return {
            "trial": 1,
            "slot": self.scenario.name,
            "replicate": 1,
            "mounting": "simulated",
            "held_length_mm": mechanism.held_mm,
            "load_kg": mechanism.load_kg,
            "temperature_c": self.scenario.temperature_c,
        }

    def _after(self, ticks: int) -> None:
        self.clock.set_now_ns(ticks * NS_PER_TICK)
        self.readings.take(ticks)

    def _command(self, command: Command) -> None:
        names = [m.name for m in self.scenario.muscles]
        fields: dict[str, Any] = {"device": "valve", command.kind: command.value}
        if command.kind == "setpoint_kpa":
            fields["pressure_kpa"] = command.value
        for k, name in enumerate(names):
            if command.muscle in ("", name):
                self.record.event("command", muscle=name, **fields)
                for text in self._requests(command):
                    self.loop.ask(k, text)

    def _requests(self, command: Command) -> list[str]:
        if command.kind == "scheme":
            return ["vent"] if command.value == "idle" else [f"scheme {command.value}"]
        if command.kind == "setpoint_kpa":
            return [f"sp {round(float(command.value) * self._counts_x16)}"]
        width, count, period = command.more
        valve = "inlet" if command.value == "inlet" else "vent"
        return [f"pulse {valve} {width} {count} {period}"]

    def _point(self, window: Any, begin: dict[str, list[int]], order: int) -> None:
        end = self.readings.rows()
        self.record.event(
            "point",
            trial=1,
            slot=f"W{order}",
            replicate=1,
            order=order,
            mounting="simulated",
            direction="single",
            set_pressure_kpa=None,
            set_length_mm=self.scenario.mechanism.held_mm,
            mass_kg=self.scenario.mechanism.load_kg,
            settled=window.settled,
            frames=[],
            valve_seq=[begin["valve"][0], end["valve"][0]],
            balance_rows=[begin["balance"][0], end["balance"][0]],
            place_rows=[begin["place"][0], end["place"][0]],
        )


def _outcome(error: BaseException | None) -> str:
    if error is None:
        return "clean"
    if isinstance(error, Stopped):
        return "stopped"
    return "faulted" if isinstance(error, PamrigError) else "aborted"


def _finish(
    record: RecordWriter,
    controllers: Controllers,
    loop: SceneLoop,
    outcome: str,
    error: BaseException | None,
    simulated_s: float,
    took_s: float,
) -> None:
    """Write buffered data and the last events, and close the record."""
    try:
        controllers.flush()
        top = max(loop.boards[0].bench_us, 1)
        fit = ClockMap((0, top), (0, top * 1000), 0.0, 0.0, 0, 2).as_dict()
        record.event("clockfit", **fit)
        if error is not None:
            record.event("end", outcome=outcome, reason=str(error) or type(error).__name__)
        record.finalize(
            outcome,
            reason=str(error) if error is not None else "",
            clock_fit=fit,
            counters={
                name: stream.counters()
                for name, stream in zip(controllers.streams, controllers.telemetry, strict=True)
            },
            duration_s=simulated_s,
            substeps=int(loop.scene.world.clock[SUBSTEPS]),
            times_real_time=round(simulated_s / max(took_s, 1e-9), 1),
        )
    except (RecordError, CodecError):
        if error is None:
            raise
