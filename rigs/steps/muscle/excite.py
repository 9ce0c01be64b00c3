"""A set-point of the pressure that moves: a sine or a chirp, and the pressure that follows."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import numpy.typing as npt

from daq.clock import NS_PER_S
from rigs.steps.custom_step import CustomStep

if TYPE_CHECKING:
    from rigs.steps.context import StepContext

SETPOINT = "setpoint"
COLUMNS = {"row": "int64", "host_ns": "int64", "kpa": "float64"}
UNITS = {"host_ns": "ns", "kpa": "kPa"}
BATCH = 50
ENDS = (0, 4095)
"""Counts at the ends of the transducer's range."""
FEWEST_SETPOINTS = 4.0
"""Fewer set-points in a period than this are no sine."""
AT_END_SHARE = 0.01
"""With more than this share of the samples at an end of the range, the pressure was cut off."""


@dataclass(frozen=True)
class Excitation(CustomStep):
    """Lead the set-point through whole periods of a sine or a chirp, and record one point.

    Answers whether the pressure still follows: False where its amplitude is below ``stop_below``
    times that of the set-point, the transducer was at an end of its range, or the source took
    fewer than four set-points a period.

    Attributes:
        shape: "sine" or "chirp".
        low_hz, high_hz: frequency of a sine (twice), or the range of a chirp.
        period_s: one period of a sine, or one sweep of a chirp.
        lead: periods before those that count, while the transient dies away.
        periods: that count.
        update_hz: set-points a second at most.
    """

    trial: int
    slot: str
    replicate: int
    order: int
    mounting: str
    shape: str
    low_hz: float
    high_hz: float
    period_s: float
    lead: int
    periods: int
    mean_kpa: float
    amplitude_kpa: float
    update_hz: float
    stop_below: float
    held: tuple[tuple[str, float], ...]
    points: ClassVar[int] = 1

    @property
    def seconds(self) -> float:  # type: ignore[override]
        """About how long it takes."""
        return (self.lead + self.periods) * self.period_s

    def phase(self, t_s: float) -> float:
        """Phase in rad so long after the start; a whole number of turns in each period."""
        if self.shape == "sine":
            return 2.0 * math.pi * self.low_hz * t_s
        return chirp_phase(t_s % self.period_s, self.low_hz, self.high_hz, self.period_s)

    def perform(self, runner: StepContext) -> bool:
        """Send the set-points, record the point, and look at what the pressure did."""
        rig, record = runner.rig, runner.record
        clock, loop, source = rig.clock, rig.event_loop, rig.pressure_source
        record.stream(SETPOINT, COLUMNS, UNITS)
        first_row, rows = record.rows(SETPOINT), _Rows(runner)
        period_ns = self.period_s * NS_PER_S
        update_ns = max(round(NS_PER_S / self.update_hz), 1)
        heard: list[dict[str, npt.NDArray[Any]]] = []
        listen: Callable[[dict[str, npt.NDArray[Any]]], None] = heard.append
        readers: dict[str, Any] = {"balance_rows": rig.balance}
        if rig.length_reader is not None:
            readers["length_rows"] = rig.length_reader
        begin: dict[str, int] = {}
        first_seq = 0
        start_ns = clock.now_ns()
        counted_ns = start_ns + round(self.lead * period_ns)
        end_ns = start_ns + round((self.lead + self.periods) * period_ns)
        due_ns = start_ns
        rig.valve.on_batch.append(listen)
        try:
            while (now_ns := clock.now_ns()) < end_ns:
                if not begin and now_ns >= counted_ns:
                    begin = {key: device.rows for key, device in readers.items()}
                    first_seq = rig.valve.seq_end
                kpa = self.mean_kpa + self.amplitude_kpa * math.sin(
                    self.phase((now_ns - start_ns) / NS_PER_S)
                )
                source.set_pressure(kpa)
                rows.add(now_ns, kpa)
                runner.watch.set_point("pressure", kpa)
                due_ns += update_ns * max(1, math.ceil((clock.now_ns() - due_ns) / update_ns))
                wait_s = (min(due_ns, end_ns) - clock.now_ns()) / NS_PER_S
                if wait_s > 0.0:
                    loop.for_seconds(wait_s)
                if runner.steering.skip:
                    return True
        finally:
            rig.valve.on_batch.remove(listen)
            rows.flush()
        source.set_pressure(self.mean_kpa)
        gain, at_end = self._followed(runner, heard, counted_ns, start_ns)
        sent = record.rows(SETPOINT) - first_row
        turns = (self.lead + self.periods) * self.period_s * self.high_hz
        follows = (
            gain >= self.stop_below
            and at_end <= AT_END_SHARE
            and (sent >= FEWEST_SETPOINTS * turns or self.shape == "chirp")
        )
        take = runner.steering.take
        record.event(
            "point",
            trial=self.trial, slot=self.slot, replicate=self.replicate, order=self.order,
            mounting=self.mounting, direction="single", settled=True, shape=self.shape,
            low_hz=self.low_hz, high_hz=self.high_hz, period_s=self.period_s,
            periods=self.periods, mean_kpa=self.mean_kpa, amplitude_kpa=self.amplitude_kpa,
            start_t_ns=start_ns - record.start_ns, counted_t_ns=counted_ns - record.start_ns,
            follows=follows, at_end=at_end, device=source.command(self.mean_kpa).device,
            **dict(self.held),
            **({"take": take} if take > 1 else {}),
            valve_seq=[first_seq, rig.valve.seq_end],
            **{key: [row, readers[key].rows] for key, row in begin.items()},
            setpoint_rows=[first_row, record.rows(SETPOINT)],
        )  # fmt: skip
        runner.progress.done += take == 1
        if self.shape == "sine" and gain > 0.0:
            runner.report_result(math.log10(self.low_hz), 20.0 * math.log10(gain), self.slot)
        if not follows:
            why = f"its amplitude is {100 * gain:.0f} % of the set-point's"
            if sent < FEWEST_SETPOINTS * turns:
                why = f"the source takes {sent / turns:.1f} set-points a period"
            if at_end > AT_END_SHARE:
                why = "the transducer was at an end of its range"
            record.event(
                "saturated", order=self.order, low_hz=self.low_hz, gain=gain, at_end=at_end,
                reason=why,
            )  # fmt: skip
            runner.watch.log(f"{self.low_hz:g} Hz: the pressure does not follow ({why})")
        return follows

    def _followed(
        self,
        runner: StepContext,
        heard: list[dict[str, npt.NDArray[Any]]],
        counted_ns: int,
        start_ns: int,
    ) -> tuple[float, float]:
        """Amplitude of the pressure over that of the set-point, and share of samples at an end.

        Of a chirp: by the standard deviations.
        """
        if not heard:
            return 0.0, 0.0
        counts = np.concatenate([batch["counts"] for batch in heard])
        host_ns = np.concatenate([batch["host_ns"] for batch in heard])
        use = host_ns >= counted_ns
        if use.sum() < 8:
            return 0.0, 0.0
        kpa = runner.rig.config.calibrations["pressure_kpa"].apply(counts[use].astype(np.float64))
        at_end = float(np.mean((counts[use] == ENDS[0]) | (counts[use] >= ENDS[1])))
        if self.shape == "chirp":
            return float(np.std(kpa)) * math.sqrt(2.0) / self.amplitude_kpa, at_end
        angle = 2.0 * math.pi * self.low_hz * (host_ns[use] - start_ns) * 1e-9
        columns = np.column_stack([np.ones(len(angle)), np.cos(angle), np.sin(angle)])
        found = np.linalg.lstsq(columns, kpa, rcond=None)[0]
        return math.hypot(found[1], found[2]) / self.amplitude_kpa, at_end


class _Rows:
    """Set-points on their way to the record, in batches."""

    def __init__(self, runner: StepContext) -> None:
        self._record = runner.record
        self._row = runner.record.rows(SETPOINT)
        self._held: list[tuple[int, float]] = []

    def add(self, host_ns: int, kpa: float) -> None:
        """One set-point."""
        self._held.append((host_ns, kpa))
        if len(self._held) >= BATCH:
            self.flush()

    def flush(self) -> None:
        """Hand over what is held."""
        if not self._held:
            return
        host_ns, kpa = zip(*self._held, strict=True)
        rows = np.arange(self._row, self._row + len(kpa), dtype=np.int64)
        self._record.append(
            SETPOINT,
            {"row": rows, "host_ns": np.array(host_ns, np.int64), "kpa": np.array(kpa)},
        )
        self._row += len(kpa)
        self._held.clear()


def chirp_phase(t_s: float, low_hz: float, high_hz: float, period_s: float) -> float:
    """Phase in rad of a sweep that spends equal times in equal ratios of frequency.

    The whole sweep is rounded to whole turns, so that sweep joins sweep.
    """
    ratio = math.log(high_hz / low_hz)
    turns = low_hz * period_s * math.expm1(ratio) / ratio
    whole = max(round(turns), 1)
    return 2.0 * math.pi * whole * math.expm1(ratio * t_s / period_s) / math.expm1(ratio)
