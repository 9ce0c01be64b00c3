"""Readings of one instrument: kept, calibrated, counted and handed on."""

from __future__ import annotations

from collections.abc import Callable
from math import nan

import numpy as np
import numpy.typing as npt

from daq.calibration import Calibration
from rigs.devices.faults import Faults
from rigs.rigfile.form import Parsed

KEEP_ROWS = 4096

Batch = dict[str, npt.NDArray[np.generic]]
COLUMNS = {"row": "int64", "host_ns": "int64", "reading": "float64", "stable": "uint8"}


class Readings:
    """The newest readings and everything that was not one.

    Args:
        quantity: what is measured, with unit.
        unit: unit of the readings as they come.
        calibration: turns readings into ``quantity``; None takes them as they are.
    """

    columns = COLUMNS
    """Of its stream in a record."""

    def __init__(self, quantity: str, unit: str, calibration: Calibration | None) -> None:
        self.quantity = quantity
        self.unit = unit
        self.calibration = calibration
        self.faults = Faults()
        self.rows = 0
        self.on_rows: list[Callable[[Batch], None]] = []
        self._readings = np.zeros(KEEP_ROWS)
        self._stable = np.zeros(KEEP_ROWS, dtype=bool)
        self._pending: list[tuple[int, int, float, bool]] = []
        self._was_outside = False

    def _take(self, host_ns: int, item: Parsed) -> None:
        """A message that stands: a fault or a row."""
        if item.fault:
            self.faults.add(item.fault, item.detail)
            return
        slot = self.rows % KEEP_ROWS
        self._readings[slot] = item.value
        self._stable[slot] = item.stable
        self._pending.append((self.rows, host_ns, item.value, item.stable))
        self.rows += 1
        if self.calibration is not None:
            value = self.calibration.apply(item.value)
            outside = bool(self.calibration.outside(value))
            if outside and not self._was_outside:
                low, high = self.calibration.domain
                self.faults.add("outside", f"{value:g} is not within {low:g} to {high:g}")
            self._was_outside = outside

    def _hand_on(self) -> None:
        if not self._pending:
            return
        batch: Batch = {
            name: np.array(column, dtype=dtype)
            for (name, dtype), column in zip(
                COLUMNS.items(), zip(*self._pending, strict=True), strict=True
            )
        }
        self._pending.clear()
        batch |= self._columns()
        for listener in self.on_rows:
            listener(batch)

    def _columns(self) -> Batch:
        """Further columns of the rows that are handed on."""
        return {}

    @property
    def last_problem(self) -> str:
        """Words of the last fault."""
        return self.faults.last

    def recent(self, n: int) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.bool_]]:
        """The newest ``n`` readings as they came, oldest first: (readings (n,), stable (n,))."""
        n = min(n, self.rows, KEEP_ROWS)
        index = np.arange(self.rows - n, self.rows) % KEEP_ROWS
        return self._readings[index], self._stable[index]

    def apply(self, reading: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Readings in ``quantity``, by the calibration where there is one."""
        if self.calibration is None:
            return np.asarray(reading, dtype=np.float64)
        return self.calibration.apply(reading)

    def mean(self, n: int) -> float:
        """Mean of the newest ``n`` readings in ``quantity``; nan before the first."""
        readings, _ = self.recent(n)
        return float(self.apply(readings).mean()) if len(readings) else nan

    def counters(self) -> dict[str, int]:
        """Rows and faults by kind."""
        return {"rows": self.rows, **self.faults.counts}
