"""Identifying a proportional regulator on the bench: the laboratory method, top to bottom.

Large steps up and down give its statics and its course; small steps away from rest give its dead
band; a ramp up and down is not fitted but predicted, as a check. The pressure is read by the
controller's transducer, so that what is identified is regulator, line and muscle as mounted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from analysis.findings.points import points_analysis
from analysis.regression.regulator import respond
from analysis.regression.regulator_fit import Identified, Response, Threshold, identify
from daq.clock import NS_PER_S
from daq.errors import ConfigError, DeviceError
from daq.interrupt import StopFlag
from daq.store.derive import VALVE_STREAM, engineering
from daq.store.run import Run, open_run
from plant.arrays import Array
from rigs.execution.procedure import Procedure
from rigs.execution.runner import Watch
from rigs.execution.session import run_protocol
from rigs.rigfile.config import RigConfig
from rigs.rigfile.pressure_source import PROPORTIONAL
from rigs.steps.context import StepContext
from rigs.steps.custom_step import CustomStep, Steps
from rigs.steps.steps import State, Vent

NAME = "calibrate-regulator"
SHARES = (0.1, 0.3, 0.5, 0.7, 0.9)
"""Levels of the steps, of the rig's limit."""
INCREMENT_KPA = 0.25
"""Of the small steps, where the regulator's own steps are not larger."""
MOST_INCREMENTS = 40
LOOK_S = 0.25
DRIFT_KPA = 0.12
REST_S = 20.0
"""A regulator that does not come to rest in that time is none."""
SMALL_S = 0.5
RAMP_S = 0.1
RAMP_STEPS = 40
BEFORE_S = 0.05


@dataclass(frozen=True)
class RegulatorPlan:
    """What is done: levels in kPa, rising; how often; the small steps in kPa."""

    levels_kpa: tuple[float, ...]
    repeats: int
    increment_kpa: float
    name: str = NAME
    frames: int = 0

    def as_dict(self) -> dict[str, Any]:
        """Plain values for run.json."""
        return {**vars(self), "levels_kpa": list(self.levels_kpa)}

    def steps(self) -> Steps:
        """The method."""
        low, *_, high = self.levels_kpa
        middle = self.levels_kpa[len(self.levels_kpa) // 2]
        yield Move("begin", 0, low)
        for replicate in range(1, self.repeats + 1):
            yield State(f"regulator: steps, {replicate} of {self.repeats}")
            for level in (*self.levels_kpa[1:], *self.levels_kpa[-2::-1], high, low):
                yield Move("step", replicate, level)
            for sign in (1, -1):
                yield State(f"regulator: small steps, {replicate} of {self.repeats}")
                yield Move("approach", replicate, low if sign > 0 else high)
                yield Move("approach", replicate, middle)
                yield Small(replicate, middle, sign, self.increment_kpa, self.repeats)
        yield State("regulator: ramp")
        yield Move("approach", 0, low)
        yield Ramp(self.levels_kpa[1], self.levels_kpa[-2])
        yield Vent()


def _send(runner: StepContext, phase: str, set_kpa: float, **more: Any) -> None:
    """Give a set-point; an event holds what the regulator was given, and when."""
    rig = runner.rig
    source = rig.pressure_source
    own = source.command(set_kpa).own
    before = rig.clock.now_ns()
    source.set_pressure(set_kpa)
    sent_ns = getattr(source, "sent_ns", 0) or before
    runner.watch.set_point("pressure", set_kpa)
    runner.record.event(
        "regulator", phase=phase, set_kpa=own.get("regulator_kpa", set_kpa),
        sent_t_ns=sent_ns - runner.record.start_ns, **more,
    )  # fmt: skip


def _mean_kpa(runner: StepContext, seconds: float) -> float:
    counts = runner.rig.valve.recent_counts(round(seconds * 1000))
    return float(runner.rig.config.calibrations["pressure_kpa"].apply(counts.mean()))


def _rest(runner: StepContext) -> float:
    """Wait until the pressure rests; it in kPa.

    Raises:
        DeviceError: it does not come to rest.
    """
    loop = runner.rig.event_loop
    last = [_mean_kpa(runner, LOOK_S)]
    spent = 0.0
    while spent < REST_S:
        loop.for_seconds(LOOK_S)
        spent += LOOK_S
        last.append(_mean_kpa(runner, LOOK_S))
        if len(last) > 3 and max(last[-3:]) - min(last[-3:]) < DRIFT_KPA:
            loop.for_seconds(2 * LOOK_S)  # what is left of the approach falls away
            return _mean_kpa(runner, 2 * LOOK_S)
    raise DeviceError(
        runner.rig.pressure_source.name,
        f"its pressure does not come to rest in {REST_S:g} s",
        "look for leaks, and for a supply below the set-point",
    )


@dataclass(frozen=True)
class Move(CustomStep):
    """One set-point, until the pressure rests."""

    phase: str
    replicate: int
    set_kpa: float
    seconds: ClassVar[float] = 3.0

    def perform(self, runner: StepContext) -> None:
        """Send it and wait."""
        _send(runner, self.phase, self.set_kpa, replicate=self.replicate)
        rests = _rest(runner)
        runner.record.event("regulator_rest", pressure_kpa=rests)


@dataclass(frozen=True)
class Small(CustomStep):
    """Small steps away from rest at a set-point, until the pressure moves."""

    replicate: int
    from_kpa: float
    sign: int
    increment_kpa: float
    repeats: int
    seconds: ClassVar[float] = 6.0

    def perform(self, runner: StepContext) -> None:
        """Step by step; an event holds the last that moved nothing and the first that did.

        The first step of each replicate is shorter by another share of the increment, so that
        the replicates look between each other's steps.

        Raises:
            DeviceError: nothing moves it.
        """
        source = runner.rig.pressure_source
        start = _mean_kpa(runner, LOOK_S)
        begin = source.command(self.from_kpa).own.get("regulator_kpa", self.from_kpa)
        still = 0.0
        for number in range(1, MOST_INCREMENTS + 1):
            share = number - (self.replicate - 1) / self.repeats
            wanted = self.from_kpa + self.sign * share * self.increment_kpa
            given = source.command(wanted).own.get("regulator_kpa", wanted)
            size = abs(given - begin)
            _send(runner, "small", wanted, replicate=self.replicate)
            runner.rig.event_loop.for_seconds(SMALL_S)
            moved = self.sign * (_mean_kpa(runner, LOOK_S) - start)
            if moved > max(0.4 * size, 0.15):
                runner.record.event(
                    "regulator_threshold", still_kpa=still, moved_kpa=size, rising=self.sign > 0
                )
                _rest(runner)
                return
            still = size
        raise DeviceError(
            source.name,
            f"small steps up to {still:.1f} kPa move nothing",
            "give a larger --increment-kpa",
        )


@dataclass(frozen=True)
class Ramp(CustomStep):
    """A ramp up and down in small steps of the set-point."""

    low_kpa: float
    high_kpa: float
    seconds: ClassVar[float] = 2.0 * RAMP_STEPS * RAMP_S

    def perform(self, runner: StepContext) -> None:
        """Up and down."""
        rising = np.linspace(self.low_kpa, self.high_kpa, RAMP_STEPS)
        for set_kpa in [*rising, *rising[::-1]]:
            _send(runner, "ramp", float(set_kpa))
            runner.rig.event_loop.for_seconds(RAMP_S)
        _rest(runner)


@dataclass(frozen=True)
class RegulatorResult:
    """What was found, how far a ramp is from its prediction (rms, kPa), and the record."""

    found: Identified
    ramp_kpa: float
    folder: Path
    about: dict[str, Any]


def check(config: RigConfig, repeats: int, increment_kpa: float) -> RegulatorPlan:
    """The plan for a rig.

    Raises:
        ConfigError: the rig has no proportional regulator, or an option is out of range.
    """
    kind = config.pressure_source.kind
    if kind not in PROPORTIONAL:
        raise ConfigError(
            f"{config.source}: pressure_source.kind",
            f"{kind!r} is no proportional regulator",
            f"one of {', '.join(PROPORTIONAL)}",
        )
    top = config.limits.pressure_kpa
    return RegulatorPlan(tuple(round(share * top, 1) for share in SHARES), repeats, increment_kpa)


def calibrate_regulator(
    config: RigConfig,
    root: Path,
    *,
    repeats: int = 3,
    increment_kpa: float = INCREMENT_KPA,
    who: str = "",
    stop: StopFlag | None = None,
    watch: Watch | None = None,
) -> RegulatorResult:
    """Run the method on a rig and identify its regulator.

    Args:
        config: the rig.
        root: folder for the record.
        repeats: of every step.
        increment_kpa: of the small steps.
        who: goes into the record.
        stop, watch: as in a test.

    Raises:
        ConfigError: the rig has no proportional regulator.
        PamrigError: what ends a test also ends a calibration; the bench is vented.
    """
    plan = check(config, repeats, increment_kpa)
    procedure = Procedure(points_analysis(NAME), lambda name, rig: plan)
    result = run_protocol(
        procedure, config, plan, root, operator=who, stop=stop, watch=watch, specimen="regulator"
    )
    if result.error is not None:
        raise result.error
    run = open_run(result.folder)
    cal = config.calibrations["pressure_kpa"]
    found = identify(*_responses(run), cal.u_offset, cal.u_gain)
    wall_ns = int(run.manifest["started"]["wall_ns"])
    device = run.manifest["devices"].get("pressure_source", {})
    about = {
        "regulator": device.get("serial", ""),
        "date": datetime.fromtimestamp(wall_ns / NS_PER_S, tz=UTC).date().isoformat(),
        "record": run.run_id,
        "replicates": repeats,
    }
    ramp = _ramp_kpa(run, found)
    about |= {"misfit_kpa": round(found.misfit_kpa, 3), "ramp_kpa": round(ramp, 3)}
    if found.slew_above_kpa_s:
        about["slew_above_kpa_s"] = round(found.slew_above_kpa_s, 1)
    return RegulatorResult(found, ramp, result.folder, about)


def _pressure(run: Run) -> tuple[Array, Array]:
    columns, _ = engineering(run, VALVE_STREAM)
    return np.asarray(columns["time_s"], dtype=np.float64), np.asarray(columns["pressure_kpa"])


def _given(run: Run) -> list[dict[str, Any]]:
    """The set-points in order, each with when it was sent."""
    return [{**e, "sent_s": e["sent_t_ns"] * 1e-9} for e in run.events if e["kind"] == "regulator"]


def _responses(run: Run) -> tuple[list[Response], list[Threshold]]:
    """The large steps, and the small ones."""
    time_s, kpa = _pressure(run)
    given = _given(run)
    responses = []
    for before, this, after in zip(given[:-1], given[1:], [*given[2:], None], strict=True):
        if this["phase"] != "step":
            continue
        end_s = after["sent_s"] if after is not None else this["sent_s"] + 2.0
        first, at, last = np.searchsorted(
            time_s, [this["sent_s"] - LOOK_S, this["sent_s"], end_s - BEFORE_S]
        )
        tail = last - round(2 * LOOK_S * 1000)
        begin = at - round(BEFORE_S * 1000)
        before_kpa, after_kpa = float(kpa[first:at].mean()), float(kpa[tail:last].mean())
        responses.append(
            Response(
                this["sent_s"],
                this["set_kpa"],
                before["set_kpa"],
                before_kpa,
                after_kpa,
                time_s[begin:last],
                kpa[begin:last],
                int(this["replicate"]),
            )
        )
    thresholds = [
        Threshold(e["still_kpa"], e["moved_kpa"], bool(e["rising"]))
        for e in run.events
        if e["kind"] == "regulator_threshold"
    ]
    return responses, thresholds


def _ramp_kpa(run: Run, found: Identified) -> float:
    """How far the pressure of the ramp is from what the dynamics predict of it, rms."""
    time_s, kpa = _pressure(run)
    given = _given(run)
    ramp = [e["sent_s"] for e in given if e["phase"] == "ramp"]
    first, last = np.searchsorted(time_s, [ramp[0], ramp[-1] + RAMP_S])
    sets_s, sets = (np.array([e[key] for e in given]) for key in ("sent_s", "set_kpa"))
    expected = respond(found.regulator, sets_s, sets, time_s[first:last])
    return float(np.sqrt(np.mean((kpa[first:last] - expected) ** 2)))


def summary(found: Identified) -> Sequence[tuple[str, str, float, float]]:
    """(name, unit, value, standard uncertainty) of each; the slew limit only where reached."""
    units = {"dead_time_s": "s", "time_constant_s": "s", "slew_kpa_s": "kPa/s", "gain_error": "1"}
    values = vars(found.regulator)
    return [
        (name, units.get(name, "kPa"), float(values[name]), found.u[name])
        for name in values
        if name in found.u
    ]
