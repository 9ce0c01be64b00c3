"""A sensor on an input of the valve controller: its readings come with the telemetry."""

from __future__ import annotations

import numpy as np

from daq.clock import NS_PER_S
from daq.errors import DeviceError
from daq.link.channels import OK, OVERLOAD, Arrived, ChannelReading, EdgeCount
from rigs.devices.event_loop import EventLoop
from rigs.devices.instruments.carried import CarriedReadings
from rigs.devices.instruments.readings import Batch
from rigs.devices.valve_controller import ValveController
from rigs.rigfile.form import Parsed
from rigs.rigfile.tables.channel import ControllerChannel
from valvefw.wire import STATES

CONNECT_S = 3.0
SILENT_S = 1.0
"""Without any message of the input for so long, or three readings, the controller itself is
silent."""
ZERO_MM = 1.0
"""An encoder may read so much else than the stage says: play, and the muscle's ends."""
COLUMNS = {
    "row": "int64",
    "device_us": "int64",
    "host_ns": "int64",
    "boot": "uint16",
    "reading": "float64",
    "stable": "uint8",
}


class ChannelReader(CarriedReadings):
    """One input as an `Instrument` (`rigs.devices.interfaces`); its readings are counts.

    A row has the device time of the pressure beside the time at which its frame came, so that the
    clock fit of the controller gives the time at which it was measured.
    """

    columns = COLUMNS

    def __init__(
        self, valve: ValveController, event_loop: EventLoop, name: str, channel: ControllerChannel
    ) -> None:
        super().__init__(
            channel.form.quantity, channel.form.unit, channel.calibration,
            event_loop=event_loop, rate_hz=channel.form.rate_hz,
            advice=f"check its wires, its power and channels.{name} in the rig file",
        )  # fmt: skip
        self._valve = valve
        self._channel = channel
        self._edges = EdgeCount() if channel.chip == "encoder" else None
        self._stamps: list[tuple[int, int]] = []
        self._heard_ns = event_loop.clock.now_ns()
        self._told = False
        self.key = name
        valve.channels.listeners[channel.input] = self._frame

    @property
    def name(self) -> str:
        """Which chip on which controller."""
        return f"{self.key} ({self._channel.chip} at the {self._valve.name})"

    def connect(self, serial: str) -> dict[str, str]:
        """Check that readings come; which sensor it is nothing can tell.

        Raises:
            DeviceTimeout: none came.
        """
        channel = self._channel
        self.identity = {
            **({"serial": serial, "identity": "not verifiable"} if serial else {}),
            "chip": channel.chip,
            "input": channel.input,
        }
        self._first(CONNECT_S + 10.0 / self.rate_hz)
        return self.identity

    def _frame(self, arrived: Arrived, readings: list[ChannelReading]) -> None:
        """What a frame holds of this input."""
        self._heard_ns, self._told = arrived.host_ns, False
        for device_us, state, value in readings:
            if state != OK:
                self._state(state, value)
                continue
            whole = value if self._edges is None else self._edges.unwrap(value)
            before = self.rows
            self._take(arrived.host_ns, Parsed("", float(whole)))
            if self.rows > before:
                self._stamps.append((device_us, arrived.boot))
        self._hand_on()

    def _state(self, state: int, value: int) -> None:
        """What is no value; the words are for messages."""
        kind = STATES[state]
        if state == OVERLOAD:
            low = value < 0 or (self._channel.chip == "analogue" and value == 0)
            self.faults.add("underload" if low else "overload", f"{value} counts")
        elif kind in ("silent", "early"):
            unit = "ms" if kind == "silent" else "us"
            self.faults.add(kind, f"for {value} {unit}" if kind == "silent" else f"{value} {unit}")
        else:
            self.faults.add(kind, f"at {value} counts")

    def _columns(self) -> Batch:
        device_us, boot = zip(*self._stamps, strict=True)
        self._stamps.clear()
        return {
            "device_us": np.array(device_us, dtype=np.int64),
            "boot": np.array(boot, dtype=np.uint16),
        }

    def poll(self) -> None:
        """The controller reads the line; here only a silence of all of it is seen."""
        silent_s = (self._event_loop.clock.now_ns() - self._heard_ns) / NS_PER_S
        if not self._told and silent_s > SILENT_S + 3.0 / self.rate_hz:
            self._told = True
            self.faults.add("silent", f"for {silent_s:.1f} s, not even a message of its input")

    def check_place(self, stage_mm: float) -> None:
        """An encoder counts from where the controller was switched on; the stage knows better.

        Raises:
            DeviceError: it reads another length than that at which the stage stands.
        """
        if self._edges is None:
            return
        read_mm = self.next_mean(3)
        if abs(read_mm - stage_mm) > ZERO_MM:
            assert self.calibration is not None
            raise DeviceError(
                self.name, f"reads {read_mm:.2f} mm, and the stage stands at {stage_mm:.2f} mm",
                "it counts from where the controller was switched on: switch it off and on at"
                f" {self.calibration.offset:g} mm (channels.{self.key}.offset)",
            )  # fmt: skip

    def at_rest(self, seconds: float = 10.0) -> float:
        """Mean of the next half second of readings, in counts.

        Raises:
            DeviceTimeout: they did not come.
        """
        n = max(3, round(self.rate_hz * 0.5))
        self._await(n, seconds)
        return float(self.recent(n)[0].mean())
