"""The steps of an interactive session, beside those that every protocol knows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from daq.store.derive import scaled
from rigs.devices.instruments.balance import BALANCE_UNITS
from rigs.steps.context import StepContext
from rigs.steps.custom_step import CustomStep
from rigs.steps.pictures import take_picture
from rigs.steps.steps import Measure, Settle, SettleCriterion

Columns = dict[str, npt.NDArray[Any]]

NEWEST_SAMPLES = 50
NEWEST_ROWS = 5


@dataclass(frozen=True)
class Read(CustomStep):
    """Read every channel once.

    Attributes:
        length: also take a picture and measure the length in it.
    """

    length: bool = True

    def perform(self, runner: StepContext) -> dict[str, Any]:
        """Means of the newest readings with standard uncertainties (keys ``u_...``)."""
        rig = runner.rig
        calibrations = rig.config.calibrations
        rig.event_loop.until(lambda: rig.valve.seq_end > 0 and rig.balance.rows > 0, 3.0)
        raw = {
            "pressure_kpa": _mean(rig.valve.recent_counts(NEWEST_SAMPLES)),
            "force_n": _mean(rig.balance.recent(NEWEST_ROWS)[0]),
        }
        reason = ""
        if self.length and rig.length_reader is None:
            gap = take_picture(rig, runner.record, runner.camera).gap
            raw["length_mm"] = gap.pixels if gap.trusted else float("nan")
            reason = gap.reason
        out: dict[str, Any] = {}
        for name, mean in raw.items():
            out[name] = float(calibrations[name].apply(mean))
            out[f"u_{name}"] = float(calibrations[name].u(out[name]))
        if reason:
            out["length_refused"] = reason
        for instrument in rig.instruments.values():
            calibration = instrument.calibration
            if calibration is not None and instrument.rows:
                value = instrument.mean(NEWEST_ROWS)
                out[calibration.quantity] = value
                out[f"u_{calibration.quantity}"] = float(calibration.u(value))
        out["armed"] = rig.pressure_source.armed
        return out


class Arm(CustomStep):
    """Allow air to be let in."""

    def perform(self, runner: StepContext) -> None:
        """Arm; nothing if it is armed already."""
        if not runner.armed:
            runner.arm()


class Disarm(CustomStep):
    """Vent, disarm and confirm it."""

    def perform(self, runner: StepContext) -> float:
        """The pressure afterwards, in kPa."""
        return runner.disarm()


@dataclass(frozen=True)
class Marker(CustomStep):
    """A text in the record."""

    text: str

    def perform(self, runner: StepContext) -> None:
        """Write the event."""
        runner.record.event("marker", text=self.text, state=runner.progress.state)


@dataclass(frozen=True)
class Stretch(CustomStep):
    """Collect all samples of the next seconds.

    Attributes:
        duration_s: how long.
        pictures: how many pictures are taken, evenly spread.
    """

    duration_s: float
    pictures: int = 0

    def perform(self, runner: StepContext) -> dict[str, Columns]:
        """Columns in engineering units of ``valve`` (1 kHz), ``balance`` and ``length``.

        ``time_s`` counts from the first sample of the stretch.
        """
        rig = runner.rig
        held: dict[str, list[Mapping[str, npt.NDArray[Any]]]] = {"valve": [], "balance": []}
        lengths: list[tuple[int, float]] = []

        def look() -> None:
            picture = take_picture(rig, runner.record, runner.camera)
            pixels = picture.gap.pixels if picture.gap.trusted else float("nan")
            lengths.append((picture.host_ns, pixels))

        take_valve, take_balance = held["valve"].append, held["balance"].append
        rig.valve.on_batch.append(take_valve)
        rig.balance.on_rows.append(take_balance)
        runner.record.event("stretch", phase="begin", seconds=self.duration_s)
        try:
            (begin, end), (first, last) = runner.window(self.duration_s, self.pictures, look)
            rig.event_loop.for_seconds(0.06)  # the batch with the last sample
        finally:
            rig.valve.on_batch.remove(take_valve)
            rig.balance.on_rows.remove(take_balance)
        runner.record.event("stretch", phase="end", valve_seq=[begin, end])
        valve = _joined(held["valve"], "seq", begin, end)
        balance = _joined(held["balance"], "row", first, last)
        start_us = int(valve["device_us"][0])
        start_ns = int(rig.valve.clock_fit.to_host_ns(start_us))
        calibrations = rig.config.calibrations
        tables: dict[str, Columns] = {}
        times = {
            "valve": (valve["device_us"] - start_us) * 1e-6,
            "balance": (
                (balance["device_us"] - start_us) * 1e-6
                if "device_us" in balance  # a load cell on the controller
                else (balance["host_ns"] - start_ns) * 1e-9
            ),
        }
        units: dict[str, Mapping[str, str]] = {"valve": {}, "balance": BALANCE_UNITS}
        for stream, raw in (("valve", valve), ("balance", balance)):
            columns, _ = scaled(stream, raw, calibrations, units[stream])
            tables[stream] = {"time_s": times[stream], **columns}
        if lengths:
            at_ns, pixels = (np.array(values) for values in zip(*lengths, strict=True))
            tables["length"] = {
                "time_s": (at_ns - start_ns) * 1e-9,
                "length_mm": calibrations["length_mm"].apply(pixels),
            }
        return tables


@dataclass(frozen=True)
class Point(CustomStep):
    """Settle, then measure a point that goes into the run's table.

    Attributes:
        order: number of the point in this session.
        set_pressure_kpa: the set-point; 0 while vented.
        set_length_mm: the held length, or None.
        seconds_each: the measuring window.
        frames: pictures.
        timeout_s: how long to wait for the pressure to settle.
    """

    order: int
    set_pressure_kpa: float
    set_length_mm: float | None
    seconds_each: float
    frames: int
    timeout_s: float

    def perform(self, runner: StepContext) -> dict[str, Any]:
        """Set-point, whether it settled, and the reading right after."""
        settled, waited = True, 0.0
        if self.set_pressure_kpa:
            settled, waited = runner.do(settle(self.set_pressure_kpa, self.timeout_s))
        slot = "session" if self.set_length_mm is None else f"L{self.set_length_mm:g}"
        runner.make(
            Measure(
                trial=1, slot=slot, replicate=1, order=self.order, mounting="m1",
                direction="up", set_pressure_kpa=self.set_pressure_kpa,
                set_length_mm=self.set_length_mm, seconds=self.seconds_each,
                frames=self.frames, settled=settled, waited_s=waited,
            )
        )  # fmt: skip
        now = Read(length=False).perform(runner)
        return {"order": self.order, "settled": settled, "waited_s": waited, **now}


def settle(pressure_kpa: float, timeout_s: float) -> Settle:
    """Wait until the pressure rests at its set-point."""
    return Settle(SettleCriterion(0.5, 1.5, 0.5, None, timeout_s), pressure_kpa)


def _mean(values: npt.NDArray[np.float64]) -> float:
    return float(values.mean()) if len(values) else float("nan")


def _joined(
    batches: list[Mapping[str, npt.NDArray[Any]]], number: str, begin: int, end: int
) -> Columns:
    """The rows numbered from ``begin`` to before ``end``."""
    joined = {name: np.concatenate([b[name] for b in batches]) for name in batches[0]}
    inside = (joined[number] >= begin) & (joined[number] < end)
    return {name: values[inside] for name, values in joined.items()}
