"""Cycles between two pressures, many of them: each is one row of a stream, some are kept whole.

A test of days cannot keep every reading. The stream ``cycles`` holds one row for every cycle,
computed from all readings as they came. The streams of the devices are recorded at full rate in the
cycles that `Kept` names, and in the last ones before an end of any kind: the readings of these wait
in memory, and are lost where the program is killed.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from daq.clock import NS_PER_S
from daq.record.rows import RowWriter
from rigs.devices.instruments.balance import NoBalance
from rigs.steps.custom_step import CustomStep
from rigs.steps.loads import LOWER_STEP_S, LOWEST_KPA
from rigs.steps.steps import Vent

if TYPE_CHECKING:
    from rigs.steps.context import StepContext

CYCLES = "cycles"
SCHEMA: dict[str, str] = {
    "cycle": "int64", "host_ns": "int64", "trial": "int64", "valve_first": "int64",
    "valve_end": "int64", "counts_high": "float64", "counts_low": "float64",
    "counts_max": "float64", "counts_min": "float64", "force_high": "float64",
    "force_low": "float64", "force_max": "float64", "force_min": "float64",
    "length_high": "float64", "length_low": "float64", "leak_counts_s": "float64",
    "temperature": "float64",
}  # fmt: skip
"""Raw units, as in the streams of the devices: counts, grams, pixels or readings."""
UNITS = {"host_ns": "ns", "counts_high": "counts", "force_high": "g", "leak_counts_s": "counts/s"}
HIGH_SHARE = 0.25
"""The last quarter of each half of a cycle is averaged."""
LEAK_REST_S = 0.2
NEAR_SAMPLES = 50
REFERENCE = 5
"""The mean of cycles 6 to 10 of a test is what a drop is relative to."""
SETTLING = 5
"""Cycles before those: the first ones of a muscle that rested are different."""
RESULTS_PER_DECADE = 20


@dataclass(frozen=True)
class Kept:
    """Which cycles are recorded at full rate.

    Attributes:
        first: so many at the start of each part of a test, and from 10, 100, 1000, ... on.
        last: so many at the end of each part.
    """

    first: int
    last: int

    def whole(self, cycle: int, part_first: int) -> bool:
        """Whether a cycle is kept for its number."""
        decade = 10 ** int(math.log10(max(cycle, 1)))
        return cycle < part_first + self.first or cycle < decade + self.first

    def count(self, cycles: int) -> int:
        """So many of a test in one part at most."""
        decades = int(math.log10(max(cycles, 1))) + 1
        return min(cycles, self.first * (decades + 1) + self.last)


@dataclass(frozen=True)
class Limits:
    """What ends a test: each 0 is not watched.

    Attributes:
        drop_percent: fall of the force range (of the stroke under a load) below its reference.
        leak_kpa_s: largest loss with both valves shut; a rise is a negative loss.
        reach_kpa: the high pressure is missed by more than this.
        confirm: in so many cycles in a row.
    """

    drop_percent: float
    leak_kpa_s: float
    reach_kpa: float
    confirm: int


@dataclass
class CycleLog:
    """State of a fatigue test between its cycles; one for each part of a test.

    Attributes:
        kept, limits: as above.
        first: number of the first cycle of this part.
        trial: of this part.
    """

    kept: Kept
    limits: Limits
    first: int
    trial: int
    reference: float = math.nan
    _ranges: list[float] = field(default_factory=list)
    _bad: dict[str, int] = field(default_factory=dict)
    _rows: RowWriter | None = None
    _runner: Any = None
    _heard: dict[str, list[dict[str, npt.NDArray[Any]]]] = field(default_factory=dict)
    _listening: list[tuple[list[Any], Callable[..., None]]] = field(default_factory=list)
    _waiting: deque[tuple[int, str, Any]] = field(default_factory=deque)
    _cycle: int = 0

    def open(self, runner: StepContext) -> None:
        """Listen to the devices; done with the first cycle."""
        if self._rows is not None:
            return
        rig = runner.rig
        self._runner = runner
        self._rows = RowWriter(runner.record, rig.clock, CYCLES, SCHEMA, UNITS)
        sources: list[tuple[str, Any]] = [("valve", rig.valve.on_batch)]
        if not isinstance(rig.balance, NoBalance):
            sources.append(("force", rig.balance.on_rows))
        if rig.length_reader is not None:
            sources.append(("length", rig.length_reader.on_rows))
        for name, hooks in sources:
            self._heard[name] = []
            hook = self._heard[name].append
            hooks.append(hook)
            self._listening.append((hooks, hook))
        runner.record.on_withheld = self._wait

    def begin(self, cycle: int) -> None:
        """A cycle begins: keep its readings, or only hold the newest."""
        self._cycle = cycle
        for heard in self._heard.values():
            heard.clear()
        record = self._runner.record
        whole = self.kept.whole(cycle, self.first)
        streams = frozenset(("valve", "balance", *self._runner.rig.instruments))
        if whole == bool(record.withheld):
            record.withheld = frozenset() if whole else streams
            self._tell(whole, cycle)

    def _tell(self, whole: bool, cycle: int) -> None:
        self._runner.record.event("kept", whole=whole, from_cycle=cycle)

    def _wait(self, stream: str, columns: Any) -> None:
        """A batch that is not recorded waits until it is older than the last cycles."""
        self._waiting.append((self._cycle, stream, columns))
        while self._waiting and self._waiting[0][0] <= self._cycle - self.kept.last:
            self._waiting.popleft()

    def close(self) -> None:
        """Record the last cycles at full rate and listen no more."""
        for hooks, hook in self._listening:
            hooks.remove(hook)
        self._listening.clear()
        if self._runner is None:
            return
        record = self._runner.record
        if record.withheld:
            record.withheld = frozenset()
            if self._waiting:
                self._tell(True, self._waiting[0][0])
            for _, stream, columns in self._waiting:
                record.append(stream, columns)
            self._waiting.clear()
        if self._rows is not None:
            self._rows.flush()

    def heard(self, name: str, column: str) -> tuple[npt.NDArray[np.int64], npt.NDArray[Any]]:
        """Host times and values of a device in the present cycle."""
        batches = self._heard.get(name, [])
        if not batches:
            return np.zeros(0, np.int64), np.zeros(0)
        return (
            np.concatenate([batch["host_ns"] for batch in batches]).astype(np.int64),
            np.concatenate([batch[column] for batch in batches]).astype(np.float64),
        )

    def put(self, values: dict[str, float]) -> None:
        """One row."""
        assert self._rows is not None
        self._rows.add([values[name] for name in SCHEMA])

    def judge(self, range_: float, missed_kpa: float, leak_kpa_s: float) -> str:
        """Why the test ends with this cycle, or ""."""
        limits = self.limits
        if len(self._ranges) < SETTLING + REFERENCE:
            self._ranges.append(range_)
            if len(self._ranges) == SETTLING + REFERENCE:
                self.reference = float(np.mean(self._ranges[SETTLING:]))
        drop = 100.0 * (1.0 - range_ / self.reference) if self.reference > 0.0 else 0.0
        found = {
            f"the range fell by {drop:.1f} % (limit {limits.drop_percent:g} %)": (
                0.0 < limits.drop_percent < drop, "drop"),
            f"the high pressure was missed by {missed_kpa:.1f} kPa (limit {limits.reach_kpa:g}"
            " kPa): a burst, a blocked line, or cycles too fast for the source": (
                0.0 < limits.reach_kpa < missed_kpa, "reach"),
        }  # fmt: skip
        if 0.0 < limits.leak_kpa_s < leak_kpa_s:
            return f"it leaks {leak_kpa_s:.2f} kPa/s (limit {limits.leak_kpa_s:g} kPa/s)"
        for words, (bad, name) in found.items():
            self._bad[name] = self._bad.get(name, 0) + 1 if bad else 0
            if self._bad[name] >= limits.confirm:
                return words
        return ""


@dataclass(frozen=True)
class Cycle(CustomStep):
    """One cycle: up to the high pressure, down to the low one. Answers why the test ends, or "".

    Attributes:
        number: of the cycle, from 1 over all parts of a test.
        leak: the leak is measured at the high pressure of this cycle, for ``leak_s``.
    """

    log: CycleLog
    number: int
    low_kpa: float
    high_kpa: float
    period_s: float
    mass_kg: float
    leak_s: float
    points = 1

    @property
    def seconds(self) -> float:  # type: ignore[override]
        """About how long it takes."""
        return self.period_s + (self.leak_s + LEAK_REST_S if self.leak_s else 0.0)

    def perform(self, runner: StepContext) -> str:
        """Fill, wait, empty, wait, write the row."""
        if runner.steering.take > 1:
            runner.watch.log(f"cycle {self.number} was made; a cycle is not repeated")
            return ""
        rig, log = runner.rig, self.log
        log.open(runner)
        log.begin(self.number)
        clock, loop = rig.clock, rig.event_loop
        first_seq, start_ns = rig.valve.seq_end, clock.now_ns()
        half_ns = round(self.period_s / 2 * NS_PER_S)

        def until(end_ns: int) -> None:
            left_s = (end_ns - clock.now_ns()) / NS_PER_S
            if left_s > 0.0:
                loop.for_seconds(left_s)

        rig.pressure_source.set_pressure(self.high_kpa)
        runner.watch.set_point("pressure", self.high_kpa)
        until(start_ns + half_ns)
        length_high = self._look(runner)
        turn_ns = clock.now_ns()
        leak = self._leak(runner)
        down_ns = clock.now_ns()
        self._down(runner)
        until(down_ns + half_ns)
        length_low = self._look(runner)
        end_ns = clock.now_ns()
        row = self._row(runner, start_ns, turn_ns, down_ns, end_ns)
        for name, seen in (("length_high", length_high), ("length_low", length_low)):
            if not math.isfinite(row[name]):
                row[name] = seen
        row |= {
            "cycle": self.number, "host_ns": start_ns, "trial": log.trial,
            "valve_first": first_seq, "valve_end": rig.valve.seq_end, "leak_counts_s": leak,
        }  # fmt: skip
        log.put(row)
        runner.progress.done += 1
        return self._judged(runner, row)

    def _down(self, runner: StepContext) -> None:
        """To the low pressure: at once at a held length, at the rig's rate under a load."""
        rig = runner.rig
        source, rate = rig.pressure_source, rig.config.instruments.load.lower_kpa_s
        runner.watch.set_point("pressure", self.low_kpa)
        kpa = self.high_kpa
        while self.mass_kg and (kpa := kpa - rate * LOWER_STEP_S) > max(self.low_kpa, LOWEST_KPA):
            source.set_pressure(kpa)
            rig.event_loop.for_seconds(LOWER_STEP_S)
        if self.low_kpa < LOWEST_KPA:
            source.vent()
        else:
            source.set_pressure(self.low_kpa)

    def _look(self, runner: StepContext) -> float:
        """The length by a picture, in pixels; NaN without a camera or under no load."""
        from analysis.reduction.pictures import measure_stored
        from rigs.steps.pictures import take_picture

        rig = runner.rig
        if not self.mass_kg or rig.length_reader is not None or not rig.config.camera.source:
            return math.nan
        if not runner.record.withheld:
            picture = take_picture(rig, runner.record, runner.camera)
            runner.watch.picture(picture.host_ns, picture.jpeg, picture.gap)
            return picture.gap.pixels if picture.gap.trusted else math.nan
        gap = measure_stored(rig.camera.trigger().gray, runner.camera)
        return gap.pixels if gap.trusted else math.nan

    def _leak(self, runner: StepContext) -> float:
        """Counts with both valves shut, their fall in counts/s; NaN in cycles without the check."""
        if not self.leak_s:
            return math.nan
        rig = runner.rig
        runner.shut()
        rig.event_loop.for_seconds(LEAK_REST_S)
        first, begin_ns = rig.valve.recent_counts(NEAR_SAMPLES).mean(), rig.clock.now_ns()
        rig.event_loop.for_seconds(self.leak_s)
        last = rig.valve.recent_counts(NEAR_SAMPLES).mean()
        return float((first - last) * NS_PER_S / (rig.clock.now_ns() - begin_ns))

    def _row(
        self, runner: StepContext, start_ns: int, turn_ns: int, down_ns: int, end_ns: int
    ) -> dict[str, float]:
        """Means of the last part of each half, and extremes, in raw units."""
        window_ns = round(HIGH_SHARE * self.period_s / 2 * NS_PER_S)
        row: dict[str, float] = {"temperature": math.nan}
        for prefix, name, column in (
            ("counts", "valve", "counts"), ("force", "force", "grams"),
            ("length", "length", "reading"),
        ):  # fmt: skip
            at, values = self.log.heard(name, column)
            high = values[(at > turn_ns - window_ns) & (at <= turn_ns)]
            low = values[(at > end_ns - window_ns) & (at <= end_ns)]
            # A slow balance may have no reading in a short window: its nearest one serves.
            if not len(high) and len(values):
                high = values[[int(np.argmin(np.abs(at - turn_ns)))]]
            if not len(low) and len(values):
                low = values[[-1]]
            row[f"{prefix}_high"] = float(high.mean()) if len(high) else math.nan
            row[f"{prefix}_low"] = float(low.mean()) if len(low) else math.nan
            if prefix != "length":
                row[f"{prefix}_max"] = float(values.max()) if len(values) else math.nan
                row[f"{prefix}_min"] = float(values.min()) if len(values) else math.nan
        del start_ns, down_ns
        thermometer = runner.rig.instruments.get("thermometer")
        if thermometer is not None and thermometer.rows:
            row["temperature"] = float(thermometer.recent(1)[0].mean())
        return row

    def _judged(self, runner: StepContext, row: dict[str, float]) -> str:
        cal = runner.rig.config.calibrations
        scale = cal["pressure_kpa"].scale
        if self.mass_kg:
            reader = runner.rig.length_reader
            factor = (
                abs(cal["length_mm"].scale)
                if reader is None or reader.calibration is None
                else abs(reader.calibration.scale)
            )
            range_ = factor * abs(row["length_high"] - row["length_low"])
        else:
            range_ = abs(cal["force_n"].scale) * abs(row["force_high"] - row["force_low"])
        high = float(cal["pressure_kpa"].apply(row["counts_high"]))
        leak = row["leak_counts_s"] * scale
        if _shown(self.number):
            label = "stroke (mm)" if self.mass_kg else "force range (N)"
            runner.report_result(math.log10(self.number), range_, label)
        reason = self.log.judge(range_, self.high_kpa - high, leak)
        if reason:
            runner.record.event("failure", cycle=self.number, reason=reason)
            runner.watch.log(f"cycle {self.number}: {reason}; the test ends, the muscle is vented")
            runner.do(Vent())
        return reason


def _shown(number: int) -> bool:
    """About twenty cycles of each decade go to the live view."""
    here = math.floor(RESULTS_PER_DECADE * math.log10(number))
    return number == 1 or here > math.floor(RESULTS_PER_DECADE * math.log10(number - 1))
