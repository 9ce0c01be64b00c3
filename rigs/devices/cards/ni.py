"""National Instruments cards by the package ``nidaqmx``."""

from __future__ import annotations

import contextlib
from typing import Any

import numpy as np

from daq.errors import DeviceError, LinkLost
from rigs.devices.cards.card import Block
from rigs.rigfile.instruments import CardChannel

BUFFER_S = 10.0
OUTPUT_V = 10.0


class NationalInstruments:
    """One device, as NI MAX names it ("Dev1").

    Args:
        nidaqmx: the module, or a stand-in with the same classes.
        port: name of the device.
    """

    lost = float("nan")

    def __init__(self, nidaqmx: Any, port: str) -> None:
        self._ni = nidaqmx
        self._port = port
        self._task: Any = None
        self._outputs: dict[str, Any] = {}
        self._columns = 1

    def open(self) -> dict[str, str]:
        """See `Backend`."""
        try:
            device = self._ni.system.Device(self._port)
            return {"serial": f"{device.serial_num:08X}", "type": f"NI {device.product_type}"}
        except self._ni.errors.Error as error:
            raise DeviceError(f"NI {self._port}", _line(error), "see NI MAX for its name") from None

    def start(self, channels: list[CardChannel], rate_hz: float) -> float:
        """See `Backend`."""
        self._columns = len(channels)
        try:
            self._task = self._ni.Task()
            for channel in channels:
                self._task.ai_channels.add_ai_voltage_chan(
                    f"{self._port}/{channel.terminal}",
                    min_val=-channel.range_v, max_val=channel.range_v,
                )  # fmt: skip
            self._task.timing.cfg_samp_clk_timing(
                rate_hz,
                sample_mode=self._ni.constants.AcquisitionType.CONTINUOUS,
                samps_per_chan=round(BUFFER_S * rate_hz),
            )
            actual = float(self._task.timing.samp_clk_rate)
            self._task.start()
        except self._ni.errors.Error as error:
            raise DeviceError(f"NI {self._port}", _line(error), "check card.channels") from None
        return actual

    def read(self) -> Block:
        """See `Backend`."""
        try:
            n = int(self._task.in_stream.avail_samp_per_chan)
            if not n:
                return np.zeros((0, self._columns))
            data = self._task.read(number_of_samples_per_channel=n)
        except self._ni.errors.Error as error:
            raise LinkLost(f"NI {self._port}", _line(error), "check cable") from None
        return np.array(data, dtype=np.float64).reshape(self._columns, n).T

    def write(self, terminal: str, volts: float) -> None:
        """See `Backend`."""
        try:
            if terminal not in self._outputs:
                task = self._outputs[terminal] = self._ni.Task()
                task.ao_channels.add_ao_voltage_chan(
                    f"{self._port}/{terminal}", min_val=0.0, max_val=OUTPUT_V
                )
            self._outputs[terminal].write(volts)
        except self._ni.errors.Error as error:
            raise LinkLost(f"NI {self._port}", _line(error), "check cable") from None

    def close(self) -> None:
        """See `Backend`."""
        for task in (self._task, *self._outputs.values()):
            if task is not None:
                with contextlib.suppress(self._ni.errors.Error):
                    task.close()


def _line(error: Exception) -> str:
    """The message of NI in one line."""
    return " ".join(str(error).split())
