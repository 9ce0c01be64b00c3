"""Driver of a GRBL linear stage that sets the muscle's length (axis X, in mm)."""

from __future__ import annotations

import re

from daq.errors import DeviceError, DeviceTimeout
from daq.link.transport import Link
from rigs.devices.event_loop import EventLoop
from rigs.devices.lines import LineDevice
from rigs.devices.motion.stage import TRIES, Motion, MotorStage
from rigs.rigfile.tables.stage import StageDevice

# The whole report, so that half of one or two in one are none.
_STATUS = re.compile(
    r"<(Idle|Run|Hold|Jog|Alarm|Door|Check|Home|Sleep)(?::\d)?"
    r"\|MPos:(-?\d+\.\d{3}),-?\d+\.\d{3},-?\d+\.\d{3}(?:\|[^<>]*)?>"
)
_INCHES = re.compile(_STATUS.pattern.replace(r"\.\d{3}", r"\.\d{4}"))
"""GRBL writes millimetres with three decimals, inches with four."""


class GrblStage(LineDevice, MotorStage):
    """A stage whose X position is the length at which the muscle is held."""

    homing = "home it, unlock it ($X)"

    def __init__(self, link: Link, event_loop: EventLoop, speed_mm_s: float) -> None:
        super().__init__(link, event_loop, "stage", end=b"\n")
        self.speed_mm_s = speed_mm_s
        self.identity: dict[str, str] = {}
        self._ready = False

    def on_line(self, line: str, host_ns: int) -> bool:
        """Claim what the stage says unasked: a restart or an alarm in mid-run."""
        if line.startswith("Grbl ") and self._ready:
            self.faults.add("restarted", line)
            self._stopped = f"it restarted ({line})"
            return True
        if line.startswith("ALARM:") and self._ready:
            self._stopped = f"it raised {line}"
            self.faults.add("refused", line)
            return False  # who waits for an answer shall have it
        if line.startswith("<") and not _STATUS.fullmatch(line):
            if "WPos:" in line:
                self._stopped = "it reports work positions: send $10=1 once, and restart it"
            if _INCHES.fullmatch(line):
                self._stopped = "it reports inches: send $13=0 once, and restart it"
                self.faults.add("unit", repr(line))
                return True
            dotted = re.sub(r"(\d),(\d{3})(?=[,|])", r"\1.\2", line)
            self.faults.add("comma" if _STATUS.fullmatch(dotted) else "damaged", repr(line))
            return True
        return False

    def connect(self, serial: str) -> dict[str, str]:
        """Ask who it is and set millimetres and absolute positions.

        Raises:
            DeviceError: another serial number, or an alarm.
        """
        answer = self.request("$I", lambda line: line.startswith("[VER:"), 3.0)
        got = answer.rstrip("]").split(":")[-1]
        self.identity = {"serial": got, "version": answer.strip("[]")}
        self._check_serial(serial, got)
        self.command("G21 G90")
        state, _ = self.status()
        if state is Motion.ALARM:
            raise DeviceError(self.name, "is in alarm", "home it ($H) or unlock it ($X)")
        self._ready = True
        return self.identity

    def command(self, text: str, seconds: float = 2.0) -> None:
        """Send one line of G-code and wait until it is taken.

        Raises:
            DeviceError: the stage refused it.
        """
        answer = self.request(
            text, lambda line: line == "ok" or line.startswith(("error", "ALARM")), seconds
        )
        if answer != "ok":
            raise DeviceError(self.name, f"refused {text!r}: {answer}", "see the GRBL error list")

    def status(self) -> tuple[Motion, float]:
        """(motion, position in mm).

        Raises:
            DeviceTimeout: no whole report in three tries.
        """
        for attempt in range(TRIES):
            self._check()
            self._lines.clear()
            self.send_raw(b"?")
            try:
                line = self.wait_line(lambda s: _STATUS.fullmatch(s) is not None, "?", 0.5)
            except DeviceTimeout:
                self.faults.add("no_answer", "?")
                if attempt == TRIES - 1:
                    raise
                continue
            match = _STATUS.fullmatch(line)
            assert match is not None
            return Motion(match[1]), float(match[2])
        raise AssertionError("unreachable")

    def _start(self, length_mm: float, speed_mm_s: float) -> None:
        self.command(f"G1 X{length_mm:.3f} F{speed_mm_s * 60:.0f}")


def open_stage(link: Link, event_loop: EventLoop, device: StageDevice) -> MotorStage:
    """The driver for a rig's stage."""
    return GrblStage(link, event_loop, device.speed_mm_s)
