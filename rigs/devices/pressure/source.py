"""The interface of everything that sets the muscle's pressure.

A bench has one pressure source. A test arms it, gives it set-points, holds or vents the pressure,
and leaves it in its safe state. Only the source knows which device does that and in which unit the
device takes a set-point.

Every source on this bench stands behind the valve controller: the controller's two valves lie
between source and muscle, its transducer measures the muscle's pressure, and its firmware vents
when the host falls silent. A source therefore never has to be safe by itself.

`rigs.rigfile.pressure_source` lists the kinds. `docs/extending.md` shows how to add one.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from daq.errors import DeviceError
from daq.link.transport import Link
from rigs.devices.event_loop import EventLoop
from rigs.devices.instruments.instrument import PortInstrument
from rigs.devices.lines import LineDevice
from rigs.devices.operator import ManualAxis
from rigs.devices.valve_controller import ValveController
from rigs.rigfile.config import RigConfig


@dataclass(frozen=True)
class PressureLimits:
    """The highest set-point ``pressure_kpa``, and the rig file that states it (``source``)."""

    pressure_kpa: float
    source: str

    def check(self, pressure_kpa: float) -> None:
        """Refuse a set-point above the limit.

        Raises:
            DeviceError: names the rig file and its key.
        """
        if pressure_kpa > self.pressure_kpa:
            raise DeviceError(
                self.source,
                f"set-point {pressure_kpa:g} kPa is above limits.pressure_kpa ="
                f" {self.pressure_kpa:g} kPa",
                "correct the protocol or the limit",
            )


@dataclass(frozen=True)
class PressureCommand:
    """A set-point as it goes to the device, for the event ``command`` of the record.

    Attributes:
        device: which device is commanded, as the record calls it.
        pressure_kpa: the set-point.
        own: the set-point in the device's own unit; the name holds the unit (``counts``).
    """

    device: str
    pressure_kpa: float
    own: Mapping[str, float] = field(default_factory=dict)

    def fields(self) -> dict[str, Any]:
        """The fields of the event ``command``."""
        return {"device": self.device, "pressure_kpa": self.pressure_kpa, **self.own}


@dataclass(frozen=True)
class SourceParts:
    """What a pressure source may be built from.

    Attributes:
        config: the rig file.
        valve: the controller of the two valves.
        event_loop: of the bench.
        axes: the rig's manual axes, by name.
        open_link: opens the port of ``[pressure_source]``; only a source with a port calls it.
        card: the rig's data acquisition card (`rigs.devices.cards.card.Card`), or None.
    """

    config: RigConfig
    valve: ValveController
    event_loop: EventLoop
    axes: Mapping[str, ManualAxis]
    open_link: Callable[[], Link]
    card: object = None


class PressureSource(ABC):
    """Sets, holds and vents the muscle's pressure.

    The order of calls in a test: :meth:`arm`, then any of :meth:`set_pressure`, :meth:`ramp_to`,
    :meth:`hold` and :meth:`vent`, then :meth:`stop`. :meth:`stop` may come at any time.

    Attributes:
        limits: the highest set-point.
        closed_on_sensor: True where the source regulates the reading of the controller's
            transducer itself. False where it has a sensor of its own, so that set-point and
            reading may differ by what the transducer's calibration allows.
        accuracy_kpa: how far the pressure may rest from the set-point where the source has a
            sensor of its own.
        own_device: the device that the source talks to over a port of its own, or None. The
            record then counts its faults and holds its bytes.
    """

    limits: PressureLimits
    closed_on_sensor: bool = True
    accuracy_kpa: float = 0.0
    own_device: LineDevice | PortInstrument | None = None

    # ---- what it is -----------------------------------------------------------------

    @property
    @abstractmethod
    def name(self) -> str:
        """Device and port, for messages."""

    @property
    @abstractmethod
    def identity(self) -> dict[str, str]:
        """What the device reports about itself: serial number, firmware."""

    # ---- reading --------------------------------------------------------------------

    @property
    @abstractmethod
    def measured_kpa(self) -> float:
        """Pressure in the muscle, mean of the last 50 ms; nan before the first reading."""

    @property
    @abstractmethod
    def armed(self) -> bool:
        """Whether the source may let air in, as the device reports it."""

    @property
    @abstractmethod
    def vented(self) -> bool:
        """Whether the last command was to vent. `measured_kpa` shows whether the air is out."""

    # ---- setting --------------------------------------------------------------------

    @abstractmethod
    def arm(self) -> None:
        """Allow air to be let in.

        Raises:
            DeviceError: the device refuses.
        """

    @abstractmethod
    def command(self, pressure_kpa: float) -> PressureCommand:
        """The set-point as it would be commanded; nothing is sent.

        Raises:
            DeviceError: the set-point is above the limit.
        """

    @abstractmethod
    def set_pressure(self, pressure_kpa: float) -> PressureCommand:
        """Command a set-point; returns what was commanded. Does not wait for the pressure.

        Raises:
            DeviceError: above the limit, or refused by the device.
        """

    def prepare(self, pressure_kpa: float) -> None:  # noqa: B027  most sources are always ready
        """What has to be waited for before a set-point counts as commanded; nothing for most.

        Raises:
            DeviceError, LinkLost: the source cannot be prepared.
        """

    @abstractmethod
    def ramp_to(self, pressure_kpa: float) -> None:
        """The next set-point of a ramp, below the limit. A person is not asked for each of them."""

    @abstractmethod
    def hold(self) -> None:
        """Shut the air in. The next set-point or :meth:`vent` ends the hold."""

    @abstractmethod
    def vent(self) -> None:
        """Let the air out and stay armed. Does not wait until the air is out."""

    # ---- safety ---------------------------------------------------------------------

    @abstractmethod
    def keep_alive(self, seconds: float) -> None:
        """The test makes progress. Without this call for ``seconds`` the bench vents by itself."""

    @abstractmethod
    def release(self) -> None:
        """The test makes no progress any more: stop every heartbeat at once."""

    @abstractmethod
    def stop(self) -> None:
        """The safe state: vent and disarm.

        Raises:
            LinkLost, DeviceError: the device could not be reached; the firmware vents then.
        """

    def close(self) -> None:  # noqa: B027  most sources have nothing to close
        """Called once when the rig is closed, before the ports are."""
