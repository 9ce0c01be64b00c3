"""Driver of a stage on a Marlin board (axis X is the length in mm).

Commands go with line numbers and checksums, as the firmware documents them (`N12 M400*37`). A
report of M114 holds the position twice: as planned, in mm, and as counted steps; only a report in
which the two agree is a position at rest. Source: documentation of M110, M114, M115, M400 and M503
at marlinfw.org, and ``report_current_position`` of the firmware.
"""

from __future__ import annotations

import re
from collections.abc import Callable

from daq.errors import DeviceError, DeviceTimeout
from daq.link.transport import Link
from rigs.devices.event_loop import EventLoop
from rigs.devices.lines import LineDevice
from rigs.devices.motion.stage import CLOSE_MM, TRIES, Motion, MotorStage
from rigs.rigfile.tables.stage import StageDevice

_REPORT = re.compile(
    r"X:(?P<planned>-?\d+\.\d\d)(?: [A-Z]:-?\d+\.\d\d)+"
    r" Count X: ?(?P<count>-?\d+)(?: [A-Z]: ?-?\d+)+"
)
_STEPS = re.compile(r"(?:echo:)?\s*M92 X(\d+\.\d+)(?: [A-Z]\d+\.\d+)*")
_UUID = re.compile(r"UUID:([\w-]+)")
_NAME = re.compile(r"FIRMWARE_NAME:(.+?) (?:\(|[A-Z_]+:)")
PLANNED_MM = 0.005
"""The planned position is printed with two decimals."""


class MarlinStage(LineDevice, MotorStage):
    """A stage whose X position is the length at which the muscle is held."""

    homing = "home it (G28 X)"

    def __init__(self, link: Link, event_loop: EventLoop, speed_mm_s: float) -> None:
        super().__init__(link, event_loop, "stage", end=b"\n")
        self.speed_mm_s = speed_mm_s
        self.identity: dict[str, str] = {}
        self._ready = False
        self._number = 0
        self._steps_per_mm = 0.0
        self._offset_mm = 0.0

    def on_line(self, line: str, host_ns: int) -> bool:
        """Claim what the board says unasked: a restart, an end stop, that it is busy."""
        if line.startswith("echo:busy:"):
            return True
        if not self._ready:
            return False
        if line == "start":
            self.faults.add("restarted", line)
            self._stopped = "it restarted"
            return True
        if line.startswith("echo:endstops hit:"):
            self.faults.add("refused", line)
            self._stopped = f"it ran into an end stop ({line.removeprefix('echo:')})"
            return True
        if line.startswith("Error:") and "Line" not in line and "checksum" not in line:
            self.faults.add("refused", line)
            self._stopped = f"it reports {line!r}"
            return True
        if line.startswith("echo:Home ") and line.endswith("First"):
            self.faults.add("refused", line)
            self._stopped = "it has no reference position"
            return True
        if line.startswith("X:") and not _REPORT.fullmatch(line):
            self.faults.add("comma" if re.match(r"X:-?\d+,", line) else "damaged", repr(line))
            return True
        return False

    def connect(self, serial: str) -> dict[str, str]:
        """Ask who it is, read its steps a millimetre, and set millimetres and absolute positions.

        The motors stay on from now on: a motor without current may be pushed out of its place.

        Raises:
            DeviceError: another UUID, or planned and counted positions that do not agree.
        """
        self._command("M110 N0", number=0)
        answer = self._ask("M115", lambda line: line.startswith("FIRMWARE_NAME:"))
        uuid, name = _UUID.search(answer), _NAME.search(answer)
        got = uuid[1] if uuid is not None else ""
        self.identity = {"serial": got, "version": name[1] if name is not None else answer}
        self._check_serial(serial, got)
        steps = _STEPS.fullmatch(self._ask("M503", lambda line: _STEPS.fullmatch(line) is not None))
        assert steps is not None
        self._steps_per_mm = float(steps[1])
        if self._steps_per_mm < 50:
            raise DeviceError(
                self.name, f"makes {steps[1]} steps a millimetre", "use a stage with 50 or more"
            )
        self.close_mm = CLOSE_MM + 0.5 / self._steps_per_mm
        for text in ("G21", "G90", "M84 S0", "M17", "M400"):
            self._command(text)
        first, again = self._report(), self._report()
        if first != again:
            raise DeviceError(self.name, "gave two positions at rest", "check cable and supply")
        # A board with a home offset counts from another zero than it plans.
        self._offset_mm = first[0] - first[1] / self._steps_per_mm
        self._ready = True
        return self.identity

    def _command(self, text: str, seconds: float = 2.0, number: int | None = None) -> None:
        """Send a numbered line until the board has taken it once.

        Raises:
            DeviceError: the board asks for another line, or does not know this one.
            DeviceTimeout: no answer in three tries.
        """
        self._number = self._number + 1 if number is None else number
        for attempt in range(TRIES):
            self._check()
            self._lines.clear()
            self._send(text)
            try:
                line = self.wait_line(_answers, text, seconds)
            except DeviceTimeout:
                self.faults.add("no_answer", text)
                if attempt == TRIES - 1:
                    raise
                continue
            if line.startswith("echo:Unknown"):
                raise DeviceError(self.name, f"refused {text!r}: {line}", "update its firmware")
            if line.startswith("ok"):
                return
            wanted = int(line.split(":")[1])
            self.faults.add("damaged", line)
            self._quiet()
            if wanted == self._number + 1:  # it had been taken: only the answer was lost
                return
            if wanted != self._number:
                break
        raise DeviceError(self.name, f"asks for another line than {text!r}", "restart the board")

    def _send(self, text: str) -> None:
        body = f"N{self._number} {text}"
        checksum = 0
        for byte in body.encode("ascii"):
            checksum ^= byte
        self.send(f"{body}*{checksum}")

    def _quiet(self) -> None:
        """Wait for the "ok" that follows a request to send again."""
        self._event_loop.until(lambda: any(line.startswith("ok") for line in self._lines), 0.5)
        self._lines.clear()

    def _ask(self, text: str, accept: Callable[[str], bool], seconds: float = 1.0) -> str:
        """Send a line that is answered by a line of its own, then by "ok".

        Raises:
            DeviceTimeout: no such answer in three tries.
        """
        for attempt in range(TRIES):
            self._check()
            self._lines.clear()
            self._number += 1
            self._send(text)
            try:
                line = self.wait_line(lambda s: accept(s) or s.startswith("Resend:"), text, seconds)
            except DeviceTimeout:
                self.faults.add("no_answer", text)
                if attempt == TRIES - 1:
                    raise
                continue
            if line.startswith("Resend:"):
                self.faults.add("damaged", line)
                self._number = int(line.split(":")[1]) - 1
                self._quiet()
                continue
            self._event_loop.until(lambda: any(s.startswith("ok") for s in self._lines), 0.5)
            return line
        raise DeviceTimeout(self.name, f"no answer to {text!r}", "check port, cable and power")

    def _report(self) -> tuple[float, int]:
        """(planned mm, counted steps) of one M114."""
        match = _REPORT.fullmatch(self._ask("M114", lambda s: _REPORT.fullmatch(s) is not None))
        assert match is not None
        return float(match["planned"]), int(match["count"])

    def status(self) -> tuple[Motion, float]:
        """(motion, counted position in mm).

        Raises:
            DeviceTimeout: no whole report in three tries.
        """
        planned_mm, count = self._report()
        self._check()
        position = self._offset_mm + count / self._steps_per_mm
        agree = abs(position - planned_mm) <= 2 * PLANNED_MM + 0.5 / self._steps_per_mm
        return Motion.IDLE if agree else Motion.RUN, position

    def _start(self, length_mm: float, speed_mm_s: float) -> None:
        self._command(f"G1 X{length_mm:.3f} F{speed_mm_s * 60:.0f}")

    def _underway(self, seconds: float, meanwhile: Callable[[], object]) -> None:
        """M400: the board answers when it has arrived, and nothing else until then."""
        self._lines.clear()
        self._number += 1
        self._send("M400")

        def answered() -> bool:
            meanwhile()
            return bool(self._stopped) or any(s.startswith("ok") for s in self._lines)

        self._event_loop.until(answered, seconds)


def _answers(line: str) -> bool:
    return line == "ok" or line.startswith(("ok ", "Resend:", "echo:Unknown command"))


def open_stage(link: Link, event_loop: EventLoop, device: StageDevice) -> MotorStage:
    """The driver for a rig's stage."""
    return MarlinStage(link, event_loop, device.speed_mm_s)
