"""The bench supply of the valve's solenoids: what a run needs of it beyond its description.

The lines that it understands are in its description (`configs/instruments/scpi-supply.toml`, or
another one that the rig file names). Here are the stream of measurements and the safe state.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from daq.link.transport import Link
from rigs.devices.event_loop import EventLoop
from rigs.devices.instruments.commanded import CommandedInstrument
from rigs.rigfile.command_form import CommandForm, load_command_form

FORM = "scpi-supply"
COLUMNS = {
    "row": "int64",
    "host_ns": "int64",
    "set_v": "float64",
    "voltage_v": "float64",
    "current_a": "float64",
    "output": "uint8",
}
UNITS = {"host_ns": "ns", "set_v": "V", "voltage_v": "V", "current_a": "A"}


class Supply(CommandedInstrument):
    """A bench supply whose voltage is set, confirmed and measured.

    Args:
        link, event_loop: of the bench.
        voltage_v: what the solenoids normally get; :meth:`safe` goes back to it.
        max_v: highest voltage that is ever set.
        form: its description: sets ``voltage_v`` and ``output``, gets ``voltage_v`` and
            ``current_a``. SCPI by default.
        settle_v: how far the measured voltage may be from the set one.
        reopen: opens the port anew when it was lost; None makes a loss final.
    """

    def __init__(
        self,
        link: Link,
        event_loop: EventLoop,
        voltage_v: float,
        max_v: float,
        *,
        form: CommandForm | None = None,
        settle_v: float = 0.05,
        reopen: Callable[[], Link] | None = None,
    ) -> None:
        form = form or load_command_form(FORM)
        limited = replace(form.settings["voltage_v"], high=max_v)
        form = replace(form, settings={**form.settings, "voltage_v": limited})
        super().__init__(link, event_loop, "supply", form, reopen=reopen)
        self.voltage_v = voltage_v
        self.max_v = max_v
        self.settle_v = settle_v
        self.rows = 0
        self.set_v = 0.0
        self.is_on = False
        self.on_rows: list[Callable[[dict[str, npt.NDArray[np.generic]]], None]] = []

    def set_voltage(self, voltage_v: float) -> float:
        """Set the voltage; returns the voltage that the supply reports as set.

        Raises:
            DeviceError: beyond ``max_v``, refused, or not what was requested.
        """
        self.set_v = self.set("voltage_v", voltage_v)
        return self.set_v

    def output(self, on: bool) -> None:
        """Switch the output, and read back that it is.

        Raises:
            DeviceError: the output is not as it was set.
        """
        self.is_on = bool(self.set("output", float(on)))

    def measure(self) -> tuple[float, float]:
        """Measured (voltage in V, current in A); also a row for the record.

        Raises:
            DeviceError: no answer that reads, three times over.
        """
        volts, amps = self.get("voltage_v"), self.get("current_a")
        values = (self.rows, self._event_loop.clock.now_ns(), self.set_v, volts, amps, self.is_on)
        batch: dict[str, npt.NDArray[Any]] = {
            name: np.array([value], dtype=dtype)
            for (name, dtype), value in zip(COLUMNS.items(), values, strict=True)
        }
        self.rows += 1
        for listener in self.on_rows:
            listener(batch)
        return volts, amps

    def safe(self) -> None:
        """Back to the solenoids' normal voltage, on: so that they follow their commands.

        It is switched on even where it does not confirm its voltage.
        """
        try:
            self.set_voltage(self.voltage_v)
        finally:
            self.output(True)

    def counters(self) -> dict[str, int]:
        """Rows and faults by kind."""
        return {"rows": self.rows, **self.faults.counts}
