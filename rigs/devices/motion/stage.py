"""What all motor stages share: going to a length, and believing only a stage at rest there."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from enum import StrEnum

from daq.errors import DeviceError
from rigs.devices.event_loop import EventLoop
from rigs.devices.faults import Faults

CLOSE_MM = 0.01
TRIES = 3


class Motion(StrEnum):
    """What a stage reports about its motion; the values are GRBL's words."""

    IDLE = "Idle"
    RUN = "Run"
    ALARM = "Alarm"
    HOLD = "Hold"
    JOG = "Jog"
    DOOR = "Door"
    CHECK = "Check"
    HOME = "Home"
    SLEEP = "Sleep"


class MotorStage(ABC):
    """A stage with a motor; its position in mm is the length at which the muscle is held.

    A driver gives :meth:`connect`, :meth:`status` and :meth:`_start`. :meth:`move` is the same for
    all: the stage has arrived when two reports in a row are the same, at rest, and at the target.

    Attributes:
        speed_mm_s: the usual speed.
        close_mm: how far from its target a stage at rest may report to be.
        homing: how to make it find its position again, for messages.
    """

    speed_mm_s: float
    identity: dict[str, str]
    faults: Faults
    on_bytes: Callable[[int, bytes], None] | None
    close_mm: float = CLOSE_MM
    homing: str = "home it"
    _event_loop: EventLoop
    _stopped: str = ""

    @property
    @abstractmethod
    def name(self) -> str:
        """Device and port, for messages."""

    @property
    @abstractmethod
    def midway(self) -> bool:
        """Whether a message has begun to come that is not yet counted."""

    @abstractmethod
    def connect(self, serial: str) -> dict[str, str]:
        """Check who it is and that it knows its position.

        Raises:
            DeviceError: another serial number, or an alarm.
        """

    @abstractmethod
    def poll(self) -> None:
        """Read what came; called in every round of the event loop."""

    @abstractmethod
    def finish(self) -> None:
        """Nothing more is waited for: half a message is counted as such."""

    @abstractmethod
    def counters(self) -> dict[str, int]:
        """Everything that was lost or refused on the link so far."""

    @abstractmethod
    def status(self) -> tuple[Motion, float]:
        """(motion, position in mm).

        Raises:
            DeviceTimeout: no whole report in three tries.
        """

    @abstractmethod
    def _start(self, length_mm: float, speed_mm_s: float) -> None:
        """Send the command of a move and see it taken."""

    def _underway(  # noqa: B027 - most drivers have nothing to do here
        self, seconds: float, meanwhile: Callable[[], object]
    ) -> None:
        """What a driver does between the command and the first report; nothing for most."""

    def _check(self) -> None:
        """A stage that restarted or raised an alarm does not know where it is."""
        if self._stopped:
            raise DeviceError(self.name, self._stopped, f"{self.homing}, and start a new run")

    def _check_serial(self, serial: str, got: str) -> None:
        if serial and got != serial:
            raise DeviceError(
                self.name,
                f"key stage.serial: expected {serial}, got {got}",
                "connect the right stage, or change stage.serial in the rig file",
            )

    def set_value(self, value: float) -> float:
        """Go to a length in mm at the usual speed, as an `Actuator`; returns the position."""
        return self.move(value)

    def move(
        self,
        length_mm: float,
        speed_mm_s: float | None = None,
        meanwhile: Callable[[], object] = lambda: None,
    ) -> float:
        """Go to a length and wait until the stage is at rest there; returns the position.

        `meanwhile` is called in every round of waiting; the speed is the usual one by default.

        Raises:
            DeviceError: it stopped elsewhere or raised an alarm.
        """
        speed = self.speed_mm_s if speed_mm_s is None else speed_mm_s
        _, start = self.status()
        self._start(length_mm, speed)
        seconds = abs(length_mm - start) / speed * 1.5 + 3.0
        end_ns = self._event_loop.clock.now_ns() + round((seconds - 1.0) * 1e9)
        self._underway(seconds, meanwhile)
        state = {"at": (Motion.RUN, start)}

        def at_rest() -> bool:
            meanwhile()
            # Twice the same: a report that was late or came twice is not of now.
            before, state["at"] = state["at"], self.status()
            return state["at"][0] is Motion.ALARM or (
                before == state["at"] and before[0] is Motion.IDLE and now_there(before[1])
            )

        def now_there(position: float) -> bool:
            off_mm = abs(position - length_mm)
            return off_mm <= self.close_mm or self._event_loop.clock.now_ns() > end_ns

        self._event_loop.until(at_rest, seconds)
        self._check()
        motion, position = state["at"]
        if motion is not Motion.IDLE or abs(position - length_mm) > self.close_mm:
            raise DeviceError(
                self.name,
                f"was sent to {length_mm:.3f} mm, is at {position:.3f} mm ({motion})",
                "check for an obstacle, limit switch or lost power",
            )
        return position
