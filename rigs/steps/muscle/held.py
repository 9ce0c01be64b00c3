"""A pressure reached once and then held: points over times that grow by a factor."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from daq.clock import NS_PER_S
from rigs.steps.custom_step import CustomStep
from rigs.steps.steps import SetLength, SetPressure, Settle, SettleCriterion

if TYPE_CHECKING:
    from rigs.steps.context import StepContext

NEAR_SAMPLES = 100
"""The mean of so many samples at 1 kHz shows that the pressure is there."""
SHORTEST_S = 0.1
"""A part of which less than this is left is not measured."""


@dataclass(frozen=True)
class Hold(CustomStep):
    """Begin to hold: command the pressure and wait for it, then move to the length, if stated.

    Answers the host time in ns from which times count: the command of the pressure, or the
    arrival at the length.
    """

    trial: int
    pressure_kpa: float
    settle: SettleCriterion
    length_mm: float | None = None

    @property
    def seconds(self) -> float:  # type: ignore[override]
        """About how long it takes."""
        return 1.0 if self.length_mm is None else 2.0 + self.settle.window_s

    def perform(self, runner: StepContext) -> int:
        """Command, wait, record."""
        rig = runner.rig
        clock = rig.clock
        start_ns = clock.now_ns()
        runner.do(SetPressure(self.pressure_kpa))
        if self.length_mm is None:
            apply = rig.config.calibrations["pressure_kpa"].apply

            tolerance = self.settle.pressure_kpa
            if not rig.pressure_source.closed_on_sensor:  # as for a point that settles
                tolerance += 3 * float(rig.config.calibrations["pressure_kpa"].u(self.pressure_kpa))
                tolerance += rig.pressure_source.accuracy_kpa

            def near() -> bool:
                kpa = float(apply(rig.valve.recent_counts(NEAR_SAMPLES).mean()))
                return abs(kpa - self.pressure_kpa) <= tolerance

            reached = rig.event_loop.until(near, self.settle.timeout_s)
        else:
            reached, _ = runner.do(Settle(self.settle, self.pressure_kpa))
            runner.do(SetLength(self.length_mm))
            start_ns = clock.now_ns()
        runner.record.event(
            "hold", trial=self.trial, pressure_kpa=self.pressure_kpa, reached=bool(reached),
            start_t_ns=start_ns - runner.record.start_ns,
            waited_s=(clock.now_ns() - start_ns) / NS_PER_S,
        )  # fmt: skip
        if not reached:
            runner.watch.log(f"{self.pressure_kpa:g} kPa not reached before the hold began")
        return start_ns


@dataclass(frozen=True)
class HeldPart(CustomStep):
    """One part of the time for which a muscle is held: all readings in it are one point.

    Attributes:
        start_ns: answer of `Hold`; None when the steps are walked through without a bench.
        from_s, to_s: the part, counted from there.
        frames: pictures, evenly spread.
    """

    trial: int
    slot: str
    replicate: int
    order: int
    mounting: str
    set_pressure_kpa: float
    start_ns: int | None
    from_s: float
    to_s: float
    frames: int
    set_length_mm: float | None = None
    mass_kg: float | None = None
    points = 1

    @property
    def seconds(self) -> float:  # type: ignore[override]
        """About how long it takes."""
        return self.to_s - self.from_s

    def perform(self, runner: StepContext) -> None:
        """Wait for the part to begin, take its pictures, record its readings."""
        from rigs.steps.pictures import take_picture

        rig = runner.rig
        assert self.start_ns is not None
        clock, start_ns = rig.clock, self.start_ns

        def elapsed_s() -> float:
            return (clock.now_ns() - start_ns) / NS_PER_S

        rig.event_loop.until(lambda: elapsed_s() >= self.from_s, self.from_s + 1.0)
        begin_s = elapsed_s()
        if self.to_s - begin_s < SHORTEST_S:
            runner.watch.log(f"point {self.order}: its time has passed, it was left out")
            runner.record.event("passed", order=self.order, slot=self.slot)
            return
        frames: list[int] = []
        pixels: list[float] = []

        def look() -> None:
            picture = take_picture(rig, runner.record, runner.camera)
            frames.append(picture.number)
            runner.watch.picture(picture.host_ns, picture.jpeg, picture.gap)
            if picture.gap.trusted:
                pixels.append(picture.gap.pixels)

        pictures = self.frames if rig.config.camera.source else 0
        readers = self._readers(runner)
        seq, rows = runner.window(self.to_s - begin_s, pictures, look)
        more: dict[str, Any] = {key: [first, instrument.rows] for key, first, instrument in readers}
        take = runner.steering.take
        if take > 1:
            more["take"] = take
        end_s = max(elapsed_s(), begin_s + 1e-3)
        optional = {"set_length_mm": self.set_length_mm, "mass_kg": self.mass_kg}
        runner.record.event(
            "point",
            trial=self.trial, slot=self.slot, replicate=self.replicate, order=self.order,
            mounting=self.mounting, direction="single", set_pressure_kpa=self.set_pressure_kpa,
            settled=True, waited_s=0.0, from_s=begin_s, to_s=end_s,
            after_s=log_mean_s(begin_s, end_s),
            **{k: v for k, v in optional.items() if v is not None},
            **more, valve_seq=seq, balance_rows=rows, frames=frames,
        )  # fmt: skip
        runner.progress.done += take == 1
        self._show(runner, rows, pixels, more)

    def _readers(self, runner: StepContext) -> list[tuple[str, int, Any]]:
        """The instruments whose reading is the pressure or the length, and their next row."""
        rig = runner.rig
        out = []
        sensor = rig.instruments.get(rig.config.pressure_source.sensor)
        if sensor is not None:
            out.append(("pressure_rows", sensor.rows, sensor))
        if rig.length_reader is not None:
            out.append(("length_rows", rig.length_reader.rows, rig.length_reader))
        return out

    def _show(
        self, runner: StepContext, rows: list[int], pixels: list[float], more: dict[str, Any]
    ) -> None:
        """The force at a held length, the length under a load, over the logarithm of time."""
        rig, cal = runner.rig, runner.rig.config.calibrations
        if self.mass_kg is None:
            grams, _ = rig.balance.recent(max(1, rows[1] - rows[0]))
            y = float(cal["force_n"].apply(np.mean(grams)))
        elif "length_rows" in more and rig.length_reader is not None:
            first, end = more["length_rows"]
            y = rig.length_reader.mean(max(1, end - first))
        elif pixels:
            y = float(cal["length_mm"].apply(np.mean(pixels)))
        else:
            return
        after_s = log_mean_s(self.from_s, self.to_s)
        runner.report_result(math.log10(after_s), y, f"{self.slot}, rep. {self.replicate}")


def log_mean_s(begin_s: float, end_s: float) -> float:
    """The time whose logarithm is the mean logarithm of all times between two, in s."""
    if end_s - begin_s < 1e-9 * end_s:
        return end_s
    upper, lower = end_s * math.log(end_s), begin_s * math.log(begin_s) if begin_s > 0 else 0.0
    return math.exp((upper - lower) / (end_s - begin_s) - 1.0)
