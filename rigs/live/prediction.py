"""What the plant predicts while a test runs, drawn beside what is measured.

Pressure is predicted from the valve commands alone, free-running from one vented moment to the
next, or from the set-points where a regulator makes it whose dynamics the rig file names; force
from the measured pressure and the length. Both are curves of their own in the panels of the live
view, which knows nothing of where they come from. Beside them run the shares of the gap in force by
stage (`rigs.live.stage_share`). What is drawn is recorded too, a row for each frame of telemetry,
so that a replay shows it. A prediction that fails says so once and is silent from then on: nothing
on the acquisition path can notice.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import numpy.typing as npt

from analysis.regression.regulator import Regulator, respond
from daq.clock import NS_PER_S
from daq.errors import RecordError
from daq.live.layout import PREDICTION, PREDICTION_COLUMNS, PREDICTION_FEEDS, PREDICTION_UNITS
from daq.record.rows import RowWriter
from daq.record.writer import RecordWriter
from daq.store.derive import VALVE_STREAM, scaled
from plant import tomlfile
from plant.constants import PlantConstants
from plant.effects.effects import NONE, Effects
from plant.physics.layout import PRESSURE
from plant.simulator.bench import BenchSim
from rigs.bench.rig import Rig
from rigs.execution.runner import Runner, Watch
from rigs.live.stage_share import LiveShare
from rigs.rigfile.plant_file import load_plant
from rigs.steps.steps import Measure

if TYPE_CHECKING:
    from rigs.live.feed import LiveFeed

PRESSURE_PATH, FORCE_PATH, *SHARE_PATHS = (feed.path for feed in PREDICTION_FEEDS)
TICK_S = 1e-3
PULSE_S = 5e-6
VENTED_KPA = 10.0
LONGEST_GAP = 2000
Floats = npt.NDArray[np.float64]
Batch = dict[str, npt.NDArray[np.generic]]


class Drawn(Protocol):
    """The part of a live view that takes curves and words."""

    def series(self, path: str, time_s: Any, values: Any) -> None:
        """Samples of a curve."""
        ...

    def text(self, time_s: float, text: str, level: str) -> None:
        """A line of the log."""
        ...


class LivePrediction:
    """Follows a test and draws what the plant says.

    Args:
        view: where it is drawn.
        constants, effects: the plant.
    """

    def __init__(self, view: Drawn, constants: PlantConstants, effects: Effects = NONE) -> None:
        self.view = view
        self._gas = BenchSim(constants, effects)
        # Its own way out is shut: it only ever goes where the measured pressure is.
        shut = constants.with_overrides({"outlet_normally": "closed"})
        self._muscle = BenchSim(shut, effects)
        self._length_mm = self._gas.length_mm
        # The predicted force at the newest tare: measured forces are counted from there too.
        self._zero_n = 0.0
        self._seq: int | None = None
        self._failed = False
        self._share = LiveShare()
        self._compares = False
        self._regulator: Regulator | None = None
        self._sets: list[tuple[float, float]] = []

    def attach(self, rig: Rig, record: RecordWriter, watch: Watch) -> None:
        """Listen to a rig's valve controller and to where the stage is sent, before the run."""
        inner = watch.set_point

        def set_point(channel: str, value: float) -> None:
            inner(channel, value)
            if channel == "length":
                self._length_mm = value
            elif channel == "pressure":
                self._set_to(rig.clock.now_ns(), value)

        state, point = watch.state, watch.point

        # From a trial's first point on the force is tared and the length set.
        def doing(text: str) -> None:
            state(text)
            self._compares = False
            self._kept(self._rows.flush)

        def pointed(step: Measure, pressure_kpa: float, force_n: float, length_mm: float) -> None:
            point(step, pressure_kpa, force_n, length_mm)
            self._compares = True

        tared = watch.tared

        def zeroed() -> None:
            tared()
            self._zero_n = self._muscle.force_n

        watch.set_point, watch.state, watch.point = set_point, doing, pointed
        watch.tared = zeroed
        self._calibrations = rig.config.calibrations
        rig.balance.on_rows.append(self._force)
        self._start_ns = record.start_ns
        self._record = record
        self._rows = RowWriter(record, rig.clock, PREDICTION, PREDICTION_COLUMNS, PREDICTION_UNITS)
        self._pressure = rig.config.calibrations["pressure_kpa"]
        self._regulated = rig.config.valve.static_scheme == "reg"
        dynamics = rig.config.pressure_source.dynamics
        self._regulator = dynamics.regulator if dynamics is not None else None
        rig.valve.on_batch.append(self._batch)

    def _batch(self, batch: Batch) -> None:
        if self._failed:
            return
        try:
            self._follow(batch)
        except Exception as error:
            self._stopped(error)

    def _force(self, batch: Batch) -> None:
        """Measured pulls, for the shares of the gap."""
        if self._failed or self._regulated:
            return
        try:
            columns, _ = scaled("balance", batch, self._calibrations, {})
            time_s = (batch["host_ns"].astype(np.float64) - self._start_ns) / NS_PER_S
            self._share.measured(time_s, np.asarray(columns["force_n"], dtype=np.float64))
        except Exception as error:
            self._stopped(error)

    def _stopped(self, error: Exception) -> None:
        self._failed = True
        with contextlib.suppress(Exception):
            self._record.event("prediction", stopped=str(error))
            self.view.text(0.0, f"prediction stopped: {error}", "WARN")

    def _follow(self, batch: Batch) -> None:
        host_ns = float(batch["host_ns"][-1])
        device_us = batch["device_us"].astype(np.float64)
        time_s = (host_ns - self._start_ns) / NS_PER_S - (device_us[-1] - device_us) * 1e-6
        seen = np.asarray(self._pressure.apply(batch["counts"].astype(np.float64)))
        self._move(self._length_mm)
        pressure: list[float] = []
        if not self._regulated:
            pressure = self._replay(batch, seen)
        elif self._regulator is not None and self._sets:
            pressure = self._respond(self._regulator, time_s)
        self._muscle.set_pressure(max(float(seen.mean()), -50.0))
        self._muscle.advance(len(seen) * TICK_S)
        force_n = self._muscle.force_n - self._zero_n
        at_s = float(time_s.mean())
        shares = None
        if not self._regulated and self._compares:
            shares = self._share.shares
            self._share.predicted(at_s, force_n, float(self._gas.force_n) - self._zero_n)
        self._show(
            at_s,
            float(np.mean(pressure)) if pressure else math.nan,
            force_n,
            *(100.0 * share for share in shares or (math.nan, math.nan)),
        )

    def _show(self, at_s: float, *values: float) -> None:
        """Draw and record one row: pressure, force and the two shares; NaN is no value."""
        for feed, value in zip(PREDICTION_FEEDS, values, strict=True):
            if not math.isnan(value):
                self.view.series(feed.path, [at_s], [value])
        if VALVE_STREAM in self._record.withheld:  # nor is what it is compared with
            return
        at_ns = self._start_ns + round(at_s * NS_PER_S)
        self._kept(lambda: self._rows.add((self._rows.rows, at_ns, *values)))

    def _kept(self, write: Callable[[], object]) -> None:
        """Write into the record; what a failed disk means, the runner says."""
        with contextlib.suppress(RecordError):
            write()

    def _set_to(self, now_ns: int, pressure_kpa: float) -> None:
        """A set-point of the regulator; one of 0 vents, and each filling stands alone."""
        if pressure_kpa <= 0.0:
            self._sets.clear()
        else:
            self._sets.append(((now_ns - self._start_ns) / NS_PER_S, pressure_kpa))

    def _respond(self, regulator: Regulator, time_s: Floats) -> list[float]:
        """Pressures in kPa at some times, from the set-points alone."""
        at_s, kpa = np.array(self._sets).T
        return [float(p) for p in respond(regulator, at_s, kpa, time_s)]

    def _move(self, length_mm: float) -> None:
        for bench in (self._gas, self._muscle):
            if abs(length_mm - bench.length_mm) > 1e-6:
                bench.set_length(length_mm)

    def _replay(self, batch: Batch, seen: npt.NDArray[np.float64]) -> list[float]:
        """Pressures in kPa at the batch's samples, from the commands given between them."""
        gas = self._gas
        inlet = batch["inlet_u5"].astype(np.float64) * PULSE_S
        vent = batch["vent_u5"].astype(np.float64) * PULSE_S
        first = int(batch["seq"][0])
        missing = 0 if self._seq is None else min(max(first - self._seq, 0), LONGEST_GAP)
        for _ in range(missing):
            gas.advance(TICK_S, 0.0, 0.0)
        self._seq = int(batch["seq"][-1]) + 1
        predicted = []
        for k in range(len(seen)):
            if vent[k] >= TICK_S and seen[k] < VENTED_KPA:
                # Vented: what was off until here is forgotten, so that each filling stands alone.
                gas.state[PRESSURE] = max(seen[k], 0.0) * 1e3
            predicted.append(gas.pressure_kpa)
            gas.advance(TICK_S, float(inlet[k]), float(vent[k]))
        return predicted


def predicting(
    path: Path, feeds: Sequence[LiveFeed], begin: Callable[[Runner, RecordWriter], None]
) -> Callable[[Runner, RecordWriter], None]:
    """What to call at the start of a run so that the plant of a file is drawn in its live view.

    Args:
        path: see `rigs.rigfile.plant_file.load_plant`; it is read at once.
        feeds: holds the run's live view by the time the run begins.
        begin: what else is to be called.

    Raises:
        ConfigError: see `rigs.rigfile.plant_file.load_plant`.
    """
    constants, effects = load_plant(path)
    text = tomlfile.read_text(path)

    def start(runner: Runner, record: RecordWriter) -> None:
        begin(runner, record)
        for feed in feeds:
            prediction = LivePrediction(feed.view, constants, effects)
            prediction.attach(runner.rig, record, runner.watch)
            record.event("prediction", file=path.name, text=text)

    return start
