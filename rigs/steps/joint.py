"""Steps of the tests of a joint: both pressures, the lock, settled points and responses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from daq.clock import NS_PER_S
from rigs.devices.interfaces import Instrument
from rigs.devices.operator import Request, put_request
from rigs.steps.context import RunFault
from rigs.steps.custom_step import CustomStep
from rigs.steps.steps import Vent

if TYPE_CHECKING:
    from rigs.bench.rig import Rig
    from rigs.steps.context import StepContext

VENTED_KPA = 5.0
"""Below this a set-point means "vented", not regulated: no valve holds 0 kPa gauge."""
REACH_S = 1.0
"""About how long a new pair of pressures takes."""
NEAR_KPA = 5.0
NEAR_S = 3.0
"""Muscles vent together when both are so near to one pressure, and after so long in any case."""
LOCK_S = 20.0
"""About how long a person takes with the lock."""
READINGS_BEFORE = 3
"""So many readings of the angle before a step give where it began, with those until it takes
effect."""

Pressures = tuple[float, float]
"""Set-points of muscle a and muscle b in kPa."""


def pressures_of(common_kpa: float, difference_kpa: float) -> Pressures:
    """Both pressures: their mean is the common one; a is above b by the difference."""
    return common_kpa + difference_kpa / 2.0, common_kpa - difference_kpa / 2.0


@dataclass(frozen=True)
class JointCriterion:
    """When a joint counts as settled.

    Over the last ``window_s``: the mean of each pressure lies within ``pressure_kpa`` of its
    set-point, and the means of the two halves differ by no more than ``drift_kpa``, ``drift_deg``
    and ``drift_n_m``. Not settled after ``timeout_s``: the point is measured all the same and
    marked.
    """

    window_s: float
    pressure_kpa: float
    drift_kpa: float
    drift_deg: float
    drift_n_m: float
    timeout_s: float

    def as_dict(self) -> dict[str, float]:
        """Plain values for run.json."""
        return dict(vars(self))


@dataclass(frozen=True)
class SetPressures(CustomStep):
    """Regulate both pressures; a set-point below 5 kPa vents that muscle.

    Where both are regulated already, both set-points leave before either reply is waited for.
    """

    a_kpa: float
    b_kpa: float
    seconds: ClassVar[float] = 0.1

    def perform(self, runner: StepContext) -> None:
        """Record what will be commanded, then command it, muscle a first."""
        asked = []
        at_once = not any(side.source.vented for side in runner.rig.sides)
        for side, pressure in zip(runner.rig.sides, (self.a_kpa, self.b_kpa), strict=True):
            channel = "pressure" if side.name == "valve" else "pressure b"
            if pressure < VENTED_KPA:
                runner.record.event("command", device=side.name, pressure_kpa=0.0)
                runner.watch.set_point(channel, 0.0)
                side.source.vent()
                continue
            command = side.source.command(pressure)
            runner.record.event("command", **{**command.fields(), "device": side.name})
            runner.watch.set_point(channel, pressure)
            if at_once:
                asked.append((side.valve, side.valve.ask_set_point(command.own["counts"])))
            else:
                side.source.set_pressure(pressure)
        for valve, number in asked:
            valve.answer(number)


@dataclass(frozen=True)
class EqualPressures(CustomStep):
    """Bring both muscles of a free joint to one pressure: after they were vented, and before.

    Muscles that fill to or vent from different pressures are filled or empty at different times:
    the fuller one would swing the joint far beyond where the test is to have it.
    """

    kpa: float
    seconds: ClassVar[float] = REACH_S

    def perform(self, runner: StepContext) -> None:
        """Set both, and wait until they are near each other."""
        sides = runner.rig.sides
        runner.do(SetPressures(self.kpa, self.kpa))
        runner.rig.event_loop.until(
            lambda: all(abs(s.source.measured_kpa - self.kpa) < NEAR_KPA for s in sides), NEAR_S
        )


@dataclass(frozen=True)
class LockJoint(CustomStep):
    """Have the joint locked at an angle, both muscles vented."""

    angle_deg: float
    seconds: ClassVar[float] = LOCK_S

    def perform(self, runner: StepContext) -> None:
        """Vent, then ask; the encoder says whether it is there."""
        runner.do(Vent())
        runner.axis("angle", "deg").set(self.angle_deg)
        runner.watch.locked(True)


@dataclass(frozen=True)
class FreeJoint(CustomStep):
    """Have the lock taken off, both muscles vented."""

    seconds: ClassVar[float] = LOCK_S

    def perform(self, runner: StepContext) -> None:
        """Vent, then ask."""
        runner.do(Vent())
        request = Request("lock off", 0.0, "", "take the lock off the joint, then press Enter")
        answer, seconds = put_request(runner.rig.operator, runner.rig.event_loop, request)
        runner.record.event("manual", axis="lock off", waited_s=seconds, remark=answer)
        runner.watch.locked(False)


@dataclass(frozen=True)
class JointZero(CustomStep):
    """Record a reading of both vented muscles."""

    trial: int
    when: str
    window_s: float

    @property
    def seconds(self) -> float:  # type: ignore[override]
        """How long it takes."""
        return self.window_s

    def perform(self, runner: StepContext) -> None:
        """Vent and read."""
        runner.do(Vent())
        ranges = window(runner, self.window_s)
        runner.record.event("zero", trial=self.trial, when=self.when, **ranges)


@dataclass(frozen=True)
class JointPoint(CustomStep):
    """Set both pressures, settle, and record one point over a window.

    It sets its pressures itself, so that it can be made again at any time.

    Attributes:
        state: "free"; "locked"; or "a" or "b", locked with that muscle alone under pressure.
        set_angle_deg: where the joint is locked, None if it is free.
    """

    trial: int
    slot: str
    replicate: int
    order: int
    mounting: str
    direction: str
    state: str
    set_a_kpa: float
    set_b_kpa: float
    set_angle_deg: float | None
    settle: JointCriterion
    measure_s: float
    points: ClassVar[int] = 1

    @property
    def seconds(self) -> float:  # type: ignore[override]
        """About how long it takes."""
        return REACH_S + self.settle.window_s + self.measure_s

    @property
    def common_kpa(self) -> float:
        """Mean of both set-points."""
        return (self.set_a_kpa + self.set_b_kpa) / 2.0

    @property
    def difference_kpa(self) -> float:
        """Set-point of a less that of b."""
        return self.set_a_kpa - self.set_b_kpa

    def fields(self) -> dict[str, Any]:
        """What the event of this point says."""
        own = {k: v for k, v in vars(self).items() if k not in ("settle", "measure_s")}
        return {**own, "common_kpa": self.common_kpa, "difference_kpa": self.difference_kpa}

    def perform(self, runner: StepContext) -> None:
        """Set, settle, measure."""
        rig = runner.rig
        runner.do(SetPressures(self.set_a_kpa, self.set_b_kpa))
        start_ns = rig.clock.now_ns()
        goal = (self.set_a_kpa, self.set_b_kpa)
        first = {side.name: side.valve.seq_end for side in rig.sides}
        samples = round(self.settle.window_s * 1000)
        settled = rig.event_loop.until(
            lambda: (
                runner.steering.skip
                or (
                    all(side.valve.seq_end >= first[side.name] + samples for side in rig.sides)
                    and at_rest(rig, self.settle, goal, self.settle.window_s)
                )
            ),
            self.settle.timeout_s,
        )
        waited_s = (rig.clock.now_ns() - start_ns) / NS_PER_S
        ranges = window(runner, self.measure_s)
        if runner.steering.skip:
            return
        longest = max(self.measure_s, self.settle.window_s)
        if settled and not at_rest(rig, self.settle, goal, longest):
            runner.record.event("moved", order=self.order, slot=self.slot)
            runner.watch.log(f"point {self.order} moved while it was measured")
            settled = False
        take = runner.steering.take
        more = {"take": take} if take > 1 else {}
        runner.record.event(
            "point", **self.fields(), settled=settled, waited_s=waited_s, **more, **ranges
        )
        runner.progress.done += take == 1
        self._show(runner)

    def _show(self, runner: StepContext) -> None:
        """The angle of a free joint, the torque of a locked one, against the difference."""
        joint = runner.rig.config.joint
        assert joint is not None
        if self.state == "free":
            y = runner.rig.instruments[joint.angle].mean(5)
            label, chart = f"free, {self.common_kpa:g} kPa", "points"
        elif joint.torque:
            y = runner.rig.instruments[joint.torque].mean(5)
            label = f"{self.set_angle_deg:g}°, {self.common_kpa:g} kPa"
            chart = "torques"
        else:
            return
        runner.report_result(self.difference_kpa, y, label, chart)


@dataclass(frozen=True)
class JointResponse(CustomStep):
    """One step of the differential pressure, and what the angle does."""

    trial: int
    slot: str
    replicate: int
    order: int
    mounting: str
    common_kpa: float
    from_kpa: float
    difference_kpa: float
    step_s: float
    first: bool
    points: ClassVar[int] = 1

    @property
    def seconds(self) -> float:  # type: ignore[override]
        """About how long it takes."""
        return self.step_s * (2.0 if self.first else 1.0)

    def perform(self, runner: StepContext) -> None:
        """Command it and wait; the first, and a repeated step, begin at the state before them."""
        rig, take = runner.rig, runner.steering.take
        joint = rig.config.joint
        assert joint is not None
        if self.first or take > 1:
            runner.do(SetPressures(*pressures_of(self.common_kpa, self.from_kpa)))
            rig.event_loop.for_seconds(self.step_s)
        encoder = rig.instruments[joint.angle]
        first = {side.name: side.valve.seq_end for side in rig.sides}
        row = max(0, encoder.rows - READINGS_BEFORE)
        runner.do(SetPressures(*pressures_of(self.common_kpa, self.difference_kpa)))
        rig.event_loop.for_seconds(self.step_s)
        more = {"take": take} if take > 1 else {}
        runner.record.event(
            "point",
            trial=self.trial, slot=self.slot, replicate=self.replicate, order=self.order,
            mounting=self.mounting, common_kpa=self.common_kpa, from_kpa=self.from_kpa,
            difference_kpa=self.difference_kpa,
            direction="up" if self.difference_kpa > self.from_kpa else "down", settled=True,
            **{f"{side.name}_seq": [first[side.name], side.valve.seq_end] for side in rig.sides},
            **{f"{joint.angle}_rows": [row, encoder.rows]}, **more,
        )  # fmt: skip
        runner.progress.done += take == 1
        runner.report_result(self.difference_kpa, encoder.mean(5), f"{self.common_kpa:g} kPa")


def window(runner: StepContext, seconds: float) -> dict[str, list[int]]:
    """Let so much time pass; half-open ranges of the samples and readings in it, by stream.

    Raises:
        RunFault: a device sent too little.
    """
    rig = runner.rig
    assert rig.config.joint is not None
    samples = round(seconds * 1000)
    seq = {side.name: side.valve.seq_end for side in rig.sides}
    read = {name: rig.instruments[name] for name in rig.config.joint.instruments}
    rows = {name: instrument.rows for name, instrument in read.items()}
    needed = {name: readings_in(instrument, seconds) for name, instrument in read.items()}
    waiting: list[tuple[str, Callable[[], bool]]] = [
        (s.valve.name, lambda s=s: s.valve.seq_end >= seq[s.name] + samples)  # type: ignore[misc]
        for s in rig.sides
    ]
    waiting += [
        (i.name, lambda n=n, i=i: i.rows >= rows[n] + needed[n])  # type: ignore[misc]
        for n, i in read.items()
    ]
    if not rig.event_loop.until(lambda: all(came() for _, came in waiting), 3 * seconds + 1.0):
        late = next(name for name, came in waiting if not came())
        raise RunFault(
            late, f"sent too little during a window of {seconds:g} s",
            "check rates, cable and baud rate",
        )  # fmt: skip
    return {
        **{f"{name}_seq": [first, first + samples] for name, first in seq.items()},
        **{f"{name}_rows": [first, read[name].rows] for name, first in rows.items()},
    }


def readings_in(instrument: Instrument, seconds: float) -> int:
    """How many readings a window of so many seconds holds at least."""
    return max(4, round(seconds * instrument.rate_hz) - 1)


def at_rest(rig: Rig, c: JointCriterion, goal: Pressures, seconds: float) -> bool:
    """Whether pressures, angle and torque of the last seconds fulfil the criterion."""
    joint = rig.config.joint
    assert joint is not None
    for side, pressure in zip(rig.sides, goal, strict=True):
        calibration = side.config.calibrations["pressure_kpa"]
        kpa = calibration.apply(side.valve.recent_counts(round(seconds * 1000)))
        tolerance = c.pressure_kpa
        if not side.source.closed_on_sensor:
            tolerance += 3 * float(calibration.u(pressure))
        if pressure < VENTED_KPA:  # what is left of the air, and the sensor's zero
            tolerance, pressure = VENTED_KPA + 3 * float(calibration.u(0.0)), 0.0
        if abs(float(kpa.mean()) - pressure) > tolerance or _drift(kpa) > c.drift_kpa:
            return False
    limits = {joint.angle: c.drift_deg}
    if joint.torque:
        limits[joint.torque] = c.drift_n_m * (1e3 / joint.lever_mm if joint.lever_mm else 1.0)
    for name, limit in limits.items():
        instrument = rig.instruments[name]
        values, _ = instrument.recent(readings_in(instrument, seconds))
        if _drift(instrument.apply(values)) > limit:
            return False
    return True


def _drift(values: Any) -> float:
    """Difference of the means of both halves."""
    half = len(values) // 2
    return abs(float(np.mean(values[:half])) - float(np.mean(values[half:])))
