"""A load-cell indicator in the place of a balance: the same face for a test."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from daq.errors import ConfigError
from rigs.devices.instruments.balance import BALANCE_SCHEMA
from rigs.devices.instruments.channel import ChannelReader
from rigs.devices.instruments.readings import Batch
from rigs.devices.instruments.text import TextInstrument
from rigs.rigfile.form import GRAMS

DEVICE_TIME = {"device_us": "int64", "boot": "uint16"}
"""Columns of a load cell on the controller beside those of a balance."""


class LoadCell:
    """Readings of an indicator as net grams, the way a test takes them from a balance.

    A tare that the indicator has no command for is taken here: the mean of readings at rest is
    subtracted from then on. The stream of the indicator itself keeps what was printed.

    Args:
        indicator: with a port of its own, or an input of the controller.
        factor: grams in its unit; 0 for a unit of force or mass.
    """

    def __init__(self, indicator: TextInstrument | ChannelReader, factor: float = 0.0) -> None:
        if not factor and indicator.unit not in GRAMS:
            raise ConfigError(
                f"{indicator.key}: unit {indicator.unit!r}",
                "is not a unit of force or mass",
                f"known: {', '.join(GRAMS)}",
            )
        self.indicator = indicator
        self.factor = factor or GRAMS[indicator.unit]
        self._tare = 0.0
        timed = isinstance(indicator, ChannelReader)
        self.columns = {**BALANCE_SCHEMA, **(DEVICE_TIME if timed else {})}
        self.on_rows: list[Callable[[Batch], None]] = []
        indicator.on_rows.append(self._forward)

    @property
    def name(self) -> str:
        """Which instrument and where."""
        return self.indicator.name

    @property
    def on_bytes(self) -> Callable[[int, bytes], None] | None:
        """Told every byte as it comes."""
        return self.indicator.on_bytes

    @on_bytes.setter
    def on_bytes(self, listener: Callable[[int, bytes], None] | None) -> None:
        self.indicator.on_bytes = listener

    @property
    def rows(self) -> int:
        """Readings so far."""
        return self.indicator.rows

    @property
    def last_problem(self) -> str:
        """Words of the last fault."""
        return self.indicator.last_problem

    @property
    def identity(self) -> dict[str, str]:
        """The identity it reported."""
        return self.indicator.identity

    def grams(self, reading: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Net grams of readings as printed."""
        return (np.asarray(reading, dtype=np.float64) - self._tare) * self.factor

    def _forward(self, batch: Batch) -> None:
        rows: Batch = {
            "row": batch["row"],
            "host_ns": batch["host_ns"],
            "grams": self.grams(batch["reading"].astype(np.float64)),
            "stable": batch["stable"],
            **{name: batch[name] for name in DEVICE_TIME if name in batch},
        }
        for listener in self.on_rows:
            listener(rows)

    def recent(self, n: int) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.bool_]]:
        """The newest ``n`` readings, oldest first: (net grams (n,), stable (n,))."""
        readings, stable = self.indicator.recent(n)
        return self.grams(readings), stable

    def tare(self, seconds: float = 10.0) -> float:
        """Take the present load for zero; returns it in g.

        Raises:
            DeviceTimeout: the load did not come to rest.
        """
        if isinstance(self.indicator, TextInstrument) and self.indicator.form.tare:
            before = self.indicator.at_rest(seconds)
            self.indicator.tare(seconds)
            self._tare = 0.0
            return before * self.factor
        self._tare = self.indicator.at_rest(seconds)
        return self._tare * self.factor

    def poll(self) -> None:
        """Read what has come and hand new rows on."""
        self.indicator.poll()

    def counters(self) -> dict[str, int]:
        """Rows and faults by kind."""
        return self.indicator.counters()
