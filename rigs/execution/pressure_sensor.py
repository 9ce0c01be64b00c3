"""A transducer with a port of its own whose reading is the pressure of a test.

The controller's transducer stays: the controller regulates and protects by it. The two must
agree. Their readings are compared in two ways. Means of the same settled window may differ by the
band. A single reading, which comes late by an unknown part of ``sensor_lag_s``, is compared with
the range of the controller's readings within that time, so that no delay looks like an error while
the pressure moves. Beyond the range of the controller's converter, such as below the atmosphere,
the controller contradicts nothing.
"""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np

from daq.clock import NS_PER_S
from rigs.bench.rig import Rig
from rigs.devices.interfaces import Rows
from rigs.execution.source_instrument import SourceInstrument
from rigs.rigfile.config import TOP_COUNT
from rigs.steps.context import RunFault

CONFIRMED = 3
CONFIRMED_S = 0.5
"""A disagreement is a fault after so many readings in a row that span so long."""


class PressureSensor(SourceInstrument):
    """The pressure of a test: by the controller, or by the instrument that the rig file names.

    Args:
        rig: open instruments.

    Attributes:
        instrument: the transducer; None where the controller's reading is the pressure.
    """

    def __init__(self, rig: Rig) -> None:
        self._settings = rig.config.pressure_source
        super().__init__(rig, rig.instruments.get(self._settings.sensor))
        self._calibration = rig.config.calibrations["pressure_kpa"]
        if self.instrument is None:
            return
        self._controller: deque[tuple[int, float]] = deque()
        self._waiting: deque[tuple[int, float]] = deque()
        self._apart_ns: list[int] = []
        self._last_ns = 0
        rig.valve.on_batch.append(self._samples)
        self.instrument.on_rows.append(self._readings)

    def recent_kpa(self, samples: int, readings: int) -> Any:
        """The newest readings of the pressure, oldest first: of the controller so many samples,
        of a transducer so many readings.
        """
        if self.instrument is None:
            return self._calibration.apply(self._rig.valve.recent_counts(samples))
        return self.instrument.apply(self.instrument.recent(readings)[0])

    # ---- agreement ------------------------------------------------------------------

    def look(self, blind: bool) -> None:
        """Called in every round; ``blind`` where the computer, not the device, is late.

        Raises:
            RunFault: the transducer is silent, or disagrees with the controller.
        """
        if self.instrument is None:
            return
        now_ns = self._rig.clock.now_ns()
        if blind or not self._last_ns:
            self._last_ns = max(self._last_ns, now_ns)
        elif now_ns - self._last_ns > self._settings.sensor_stale_s * NS_PER_S:
            raise self.silent(
                "pressure", self._settings.sensor_stale_s, "check its cable and power"
            )
        # A batch that began later is needed: the mean of one stands for its middle, not its end.
        while (
            self._waiting
            and len(self._controller) > 1
            and self._waiting[0][0] <= self._controller[-2][0]
        ):
            self._compare(*self._waiting.popleft())

    def settled(self, seq: list[int], rows: list[int]) -> None:
        """Compare the means of a settled window.

        Args:
            seq, rows: half-open ranges of samples and readings that end now.

        Raises:
            RunFault: they differ by more than the band.
        """
        if self.instrument is None:
            return
        counts = self._rig.valve.recent_counts(seq[1] - seq[0])
        controller = float(self._calibration.apply(counts.mean()))
        own = self._in_range(self.instrument.mean(rows[1] - rows[0]))
        if not abs(own - controller) <= self.band_kpa(controller):
            raise self._apart(own, controller, controller, "in a settled window")

    def band_kpa(self, pressure_kpa: float) -> float:
        """How far the two may differ at a pressure."""
        assert self.instrument is not None
        return self._rig.config.sensor_band_kpa(pressure_kpa)

    def _samples(self, batch: Rows) -> None:
        kpa = float(self._calibration.apply(np.mean(batch["counts"].astype(np.float64))))
        self._controller.append((int(batch["host_ns"][-1]), kpa))

    def _readings(self, batch: Rows) -> None:
        assert self.instrument is not None
        self._last_ns = int(batch["host_ns"][-1])
        values = self.instrument.apply(np.asarray(batch["reading"], dtype=np.float64))
        self._waiting.extend(zip(batch["host_ns"].tolist(), values.tolist(), strict=True))

    def _compare(self, host_ns: int, own: float) -> None:
        """One reading with the range of the controller's while it may have been made."""
        oldest_ns = host_ns - round(self._settings.sensor_lag_s * NS_PER_S)
        while len(self._controller) > 2 and self._controller[1][0] < oldest_ns:
            self._controller.popleft()  # one before the time is kept
        known = [kpa for _, kpa in self._controller]
        low, high = min(known), max(known)
        own = self._in_range(own)
        if low - self.band_kpa(low) <= own <= high + self.band_kpa(high):
            self._apart_ns.clear()
            return
        self._apart_ns.append(host_ns)
        long_ns = self._apart_ns[-1] - self._apart_ns[0]
        if len(self._apart_ns) >= CONFIRMED and long_ns >= CONFIRMED_S * NS_PER_S:
            raise self._apart(own, low, high, f"for {long_ns / NS_PER_S:.1f} s")

    def _in_range(self, kpa: float) -> float:
        """The nearest pressure that the controller can read."""
        ends = self._calibration.apply([0, TOP_COUNT])
        return float(np.clip(kpa, ends.min(), ends.max()))

    def _apart(self, own: float, low: float, high: float, when: str) -> RunFault:
        assert self.instrument is not None
        controller = f"{low:.1f}" if high - low < 0.05 else f"{low:.1f} to {high:.1f}"
        return RunFault(
            self.instrument.name,
            f"reads {own:.1f} kPa where the controller reads {controller} kPa {when}, and they may"
            f" differ by {self.band_kpa(high):.2f} kPa",
            "find out which of the two is wrong: compare both with a gauge, calibrate again",
        )
