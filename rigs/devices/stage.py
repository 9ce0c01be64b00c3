"""Driver of a GRBL linear stage that sets the muscle's length (axis X, in mm)."""

from __future__ import annotations

import re
from collections.abc import Callable

from daq.errors import DeviceError, DeviceTimeout
from daq.link.transport import Link
from rigs.devices.event_loop import EventLoop
from rigs.devices.lines import LineDevice

# The whole report, so that half of one or two in one are none.
_STATUS = re.compile(
    r"<(Idle|Run|Hold|Jog|Alarm|Door|Check|Home|Sleep)(?::\d)?"
    r"\|MPos:(-?\d+\.\d{3}),-?\d+\.\d{3},-?\d+\.\d{3}(?:\|[^<>]*)?>"
)
_INCHES = re.compile(_STATUS.pattern.replace(r"\.\d{3}", r"\.\d{4}"))
"""GRBL writes millimetres with three decimals, inches with four."""
CLOSE_MM = 0.01
TRIES = 3


class Stage(LineDevice):
    """A stage whose X position is the length at which the muscle is held."""

    def __init__(self, link: Link, event_loop: EventLoop, speed_mm_s: float) -> None:
        super().__init__(link, event_loop, "stage", end=b"\n")
        self.speed_mm_s = speed_mm_s
        self.identity: dict[str, str] = {}
        self._ready = False
        self._stopped = ""

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

    def _check(self) -> None:
        """A stage that restarted or raised an alarm does not know where it is."""
        if self._stopped:
            raise DeviceError(
                self.name, self._stopped, "home it, unlock it ($X), and start a new run"
            )

    def connect(self, serial: str) -> dict[str, str]:
        """Ask who it is and set millimetres and absolute positions.

        Raises:
            DeviceError: another serial number, or an alarm.
        """
        answer = self.request("$I", lambda line: line.startswith("[VER:"), 3.0)
        got = answer.rstrip("]").split(":")[-1]
        self.identity = {"serial": got, "version": answer.strip("[]")}
        if serial and got != serial:
            raise DeviceError(
                self.name,
                f"key stage.serial: expected {serial}, got {got}",
                "connect the right stage, or change stage.serial in the rig file",
            )
        self.command("G21 G90")
        state, _ = self.status()
        if state == "Alarm":
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

    def status(self) -> tuple[str, float]:
        """(state, position in mm).

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
            return match[1], float(match[2])
        raise AssertionError("unreachable")

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
        self.command(f"G1 X{length_mm:.3f} F{speed * 60:.0f}")
        seconds = abs(length_mm - start) / speed * 1.5 + 3.0
        state = {"at": ("Run", start)}

        def at_rest() -> bool:
            meanwhile()
            # Twice the same: a report that was late or came twice is not of now.
            before, state["at"] = state["at"], self.status()
            return state["at"][0] == "Alarm" or (
                before == state["at"] and before[0] == "Idle" and now_there(before[1])
            )

        def now_there(position: float) -> bool:
            return abs(position - length_mm) <= CLOSE_MM or self._event_loop.clock.now_ns() > end_ns

        end_ns = self._event_loop.clock.now_ns() + round((seconds - 1.0) * 1e9)
        self._event_loop.until(at_rest, seconds)
        self._check()
        name, position = state["at"]
        if name != "Idle" or abs(position - length_mm) > CLOSE_MM:
            raise DeviceError(
                self.name,
                f"was sent to {length_mm:.3f} mm, is at {position:.3f} mm ({name})",
                "check for an obstacle, limit switch or lost power",
            )
        return position
