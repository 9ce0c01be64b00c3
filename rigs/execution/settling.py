"""When a point counts as settled: pressure, and with it force or length, at rest."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from daq.clock import NS_PER_S
from rigs.bench.rig import Rig
from rigs.execution.length_sensor import LengthSensor
from rigs.execution.pressure_sensor import PressureSensor
from rigs.steps.steps import Settle

SAMPLE_S = 1e-3


def has_settled(
    rig: Rig,
    sensor: PressureSensor,
    lengths: LengthSensor,
    camera: Mapping[str, Any],
    step: Settle,
) -> Callable[[], bool]:
    """Asked from now on, in every round: does the last window fulfil the criterion?

    Args:
        rig: open instruments.
        sensor: whose reading is the pressure.
        lengths: whose reading is the length.
        camera: how pictures are measured, as run.json says it.
        step: criterion and set-point.
    """
    c = step.criterion
    samples, readings = _sizes(c.window_s)
    first_seq = rig.valve.seq_end
    first_row = rig.balance.rows
    first_reading = sensor.rows
    pressures = sensor.needed(c.window_s)
    length: _Length | _ReadLength | None = None
    if c.drift_mm is not None and lengths.instrument is not None:
        length = _ReadLength(lengths, c.window_s, c.drift_mm)
    elif c.drift_mm is not None:
        length = _Length(rig, camera, c.window_s, c.drift_mm)

    def settled() -> bool:
        if rig.valve.seq_end < first_seq + samples:
            return False
        if c.drift_n is not None and rig.balance.rows < first_row + readings:
            return False
        if sensor.rows < first_reading + pressures:
            return False
        if not _rests(rig, sensor, step, c.window_s):
            return False
        return length is None or length.rests()

    return settled


def still_settled(rig: Rig, sensor: PressureSensor, step: Settle, seconds: float) -> bool:
    """Whether pressure and force of the last ``seconds`` still fulfil the criterion.

    Asked at the end of a measuring window: what settled before it may have moved in it. A window
    shorter than the criterion's is judged over the criterion's.
    """
    return _rests(rig, sensor, step, max(seconds, step.criterion.window_s))


def _sizes(seconds: float) -> tuple[int, int]:
    """Samples of the controller and balance readings in a time."""
    return round(seconds / SAMPLE_S), max(4, round(seconds * 10))


def _rests(rig: Rig, sensor: PressureSensor, step: Settle, seconds: float) -> bool:
    """Whether the readings of the last seconds fulfil the criterion."""
    c, cal = step.criterion, rig.config.calibrations
    samples, readings = _sizes(seconds)
    tolerance = c.pressure_kpa
    if not rig.pressure_source.closed_on_sensor:
        # The source is not closed on this sensor, so the two may differ by what the
        # sensor's calibration allows.
        tolerance += 3 * float(cal["pressure_kpa"].u(step.pressure_kpa))
        tolerance += rig.pressure_source.accuracy_kpa
    if sensor.instrument is not None:
        # Neither is this sensor: the set-point is that of the controller.
        tolerance += sensor.band_kpa(step.pressure_kpa)
    kpa = sensor.recent_kpa(samples, sensor.needed(seconds))
    half = len(kpa) // 2
    early, late = float(kpa[:half].mean()), float(kpa[half:].mean())
    if abs((early + late) / 2 - step.pressure_kpa) > tolerance or abs(late - early) > c.drift_kpa:
        return False
    if c.drift_n is None:
        return True
    grams, stable = rig.balance.recent(readings)
    half = len(grams) // 2
    drift = abs(float(np.mean(grams[:half]) - np.mean(grams[half:])))
    return bool(stable.all()) and drift * abs(cal["force_n"].scale) <= c.drift_n


class _ReadLength:
    """The length by the readings of an instrument in the last window."""

    def __init__(self, lengths: LengthSensor, window_s: float, drift_mm: float) -> None:
        self._lengths = lengths
        self._readings = lengths.needed(window_s)
        self._first = lengths.rows
        self._drift_mm = drift_mm

    def rests(self) -> bool:
        """Whether both halves of the window give the same length."""
        if self._lengths.rows < self._first + self._readings:
            return False
        mm = self._lengths.recent_mm(self._readings)
        half = len(mm) // 2
        return abs(float(mm[:half].mean() - mm[half:].mean())) <= self._drift_mm


class _Length:
    """The length by pictures that are looked at and thrown away, one each window."""

    def __init__(
        self, rig: Rig, camera: Mapping[str, Any], window_s: float, drift_mm: float
    ) -> None:
        self._rig = rig
        self._camera = camera
        self._window_ns = round(window_s * NS_PER_S)
        self._pixels = drift_mm / abs(rig.config.calibrations["length_mm"].scale)
        self._last: float | None = None
        self._next_ns = 0

    def rests(self) -> bool:
        """Whether this picture and the one a window ago give the same length."""
        from analysis.reduction.pictures import measure_stored

        if self._rig.clock.now_ns() < self._next_ns:
            return False
        gap = measure_stored(self._rig.camera.trigger().gray, self._camera)
        self._rig.camera.unmeasured += not gap.trusted
        self._next_ns = self._rig.clock.now_ns() + self._window_ns
        last, self._last = self._last, gap.pixels if gap.trusted else None
        return last is not None and gap.trusted and abs(gap.pixels - last) <= self._pixels
