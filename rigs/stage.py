"""Driver of a GRBL linear stage that sets the muscle's length (axis X, in mm)."""

from __future__ import annotations

import re

from daq.errors import DeviceError
from daq.transport import Link
from rigs.lines import LineDevice
from rigs.pump import Pump

_STATUS = re.compile(r"^<(\w+)(?::\d)?\|MPos:(-?\d+\.\d+),")


class Stage(LineDevice):
    """A stage whose X position is the length at which the muscle is held."""

    def __init__(self, link: Link, pump: Pump, speed_mm_s: float) -> None:
        super().__init__(link, pump, "stage", end=b"\n")
        self.speed_mm_s = speed_mm_s
        self.identity: dict[str, str] = {}

    def connect(self, serial: str) -> dict[str, str]:
        """Ask who it is and set millimetres and absolute positions.

        Raises:
            DeviceError: another serial number, or an alarm.
        """
        answer = self.ask("$I", lambda line: line.startswith("[VER:"), 3.0)
        got = answer.rstrip("]").split(":")[-1]
        self.identity = {"serial": got, "version": answer.strip("[]")}
        if serial and got != serial:
            raise DeviceError(
                self.name,
                f"key stage.serial: expected {serial}, got {got}",
                "connect the right stage, or change stage.serial in the rig file",
            )
        self.command("G21 G90")
        return self.identity

    def command(self, text: str, seconds: float = 2.0) -> None:
        """Send one line of G-code and wait until it is taken.

        Raises:
            DeviceError: the stage refused it.
        """
        answer = self.ask(
            text, lambda line: line == "ok" or line.startswith(("error", "ALARM")), seconds
        )
        if answer != "ok":
            raise DeviceError(self.name, f"refused {text!r}: {answer}", "see the GRBL error list")

    def status(self) -> tuple[str, float]:
        """(state, position in mm)."""
        self._lines.clear()
        self.send_raw(b"?")
        line = self.wait_line(lambda s: _STATUS.match(s) is not None, "?", 1.0)
        match = _STATUS.match(line)
        assert match is not None
        return match[1], float(match[2])

    def move(self, length_mm: float) -> float:
        """Go to a length and wait until the stage is at rest there; returns the position.

        Raises:
            DeviceError: it stopped elsewhere or raised an alarm.
        """
        _, start = self.status()
        self.command(f"G1 X{length_mm:.3f} F{self.speed_mm_s * 60:.0f}")
        seconds = abs(length_mm - start) / self.speed_mm_s * 1.5 + 3.0
        state = {"at": ("Run", start)}

        def at_rest() -> bool:
            state["at"] = self.status()
            return state["at"][0] in ("Idle", "Alarm")

        self._pump.until(at_rest, seconds)
        name, position = state["at"]
        if name != "Idle" or abs(position - length_mm) > 0.01:
            raise DeviceError(
                self.name,
                f"was sent to {length_mm:.3f} mm, is at {position:.3f} mm ({name})",
                "check for an obstacle, limit switch or lost power",
            )
        return position
