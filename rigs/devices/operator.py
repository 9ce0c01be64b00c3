"""Somebody who sets what no motor sets: on request of the program, timed, and checked."""

from __future__ import annotations

import queue
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol

from daq.clock import NS_PER_S
from daq.errors import DeviceError
from rigs.devices.event_loop import EventLoop

TRIES = 3
TRUE_WORDS = ("", "y", "yes", "ok", "done")


@dataclass(frozen=True)
class Request:
    """A request to a person.

    Attributes:
        axis: "length", "pressure", "mass", "temperature", or a reading to be typed in.
        value: what to set; nan when something is to be read.
        unit: its unit.
        text: the sentence for a person.
    """

    axis: str
    value: float
    unit: str
    text: str


class Operator(Protocol):
    """A person, or one simulated on the virtual bench."""

    def begin(self, request: Request) -> None:
        """Put the request; returns at once."""
        ...

    def answer(self) -> str | None:
        """What was answered, or None as long as nothing was."""
        ...


class ConsoleOperator:
    """A person at the terminal: sees the request, presses Enter or types what was read.

    Attributes:
        on_line: takes what is typed while no request is open.
    """

    def __init__(self) -> None:
        self._lines: queue.Queue[str | None] = queue.Queue()
        self._thread: threading.Thread | None = None
        self._asking = False
        self.on_line: Callable[[str], None] | None = None

    def begin(self, request: Request) -> None:
        """Print the request and listen."""
        while not self._lines.empty():  # what was typed before the question answers nothing
            self._lines.get_nowait()
        self._asking = True  # before the question is seen: its answer may be quick
        print(f"\n>> {request.text}", file=sys.stderr, flush=True)
        self.listen()

    def listen(self) -> None:
        """Read the terminal from now on, question or not."""
        if self._thread is None or not self._thread.is_alive():
            self._thread = threading.Thread(target=self._listen, name="operator", daemon=True)
            self._thread.start()

    def _listen(self) -> None:
        for line in _typed_lines():
            if self._asking or self.on_line is None:
                self._lines.put(line.strip())
            elif line.strip():
                self.on_line(line.strip())
        self._lines.put(None)

    def answer(self, wait_s: float = 0.0) -> str | None:
        """The line typed, without its end; waits for it that long of the wall's time.

        Raises:
            DeviceError: nobody can answer, because the input is at its end.
        """
        try:
            text = self._lines.get(timeout=wait_s) if wait_s else self._lines.get_nowait()
        except queue.Empty:
            return None
        if text is None:
            raise DeviceError(
                "operator", "the input is at its end: nobody answers", "run it at a terminal"
            )
        self._asking = False
        return text


def _typed_lines() -> Iterator[str]:
    """Lines of the terminal, read past Python's own buffer.

    Its lock would still be held by this thread when the program ends, which Python does not bear.
    """
    try:
        fd = sys.stdin.fileno()
    except (AttributeError, OSError, ValueError):
        yield from sys.stdin or ()
        return
    with open(fd, "rb", buffering=0, closefd=False) as raw:
        for line in raw:
            yield line.decode(errors="replace")


def put_request(operator: Operator, event_loop: EventLoop, request: Request) -> tuple[str, float]:
    """Ask and wait, however long a person takes: (answer, waited in s)."""
    start_ns = event_loop.clock.now_ns()
    operator.begin(request)
    got: list[str] = []

    def answered() -> bool:
        text = operator.answer()
        if text is not None:
            got.append(text)
        return bool(got)

    while not event_loop.until(answered, 3600.0):
        operator.begin(request)  # an hour later it is still needed
    return got[0], (event_loop.clock.now_ns() - start_ns) / NS_PER_S


def request_number(operator: Operator, event_loop: EventLoop, request: Request) -> float:
    """A number that a person reads and types; a decimal comma or a word is asked again.

    Raises:
        DeviceError: no number in three tries.
    """
    words = ""
    for _ in range(TRIES):
        text, _ = put_request(operator, event_loop, request)
        words = text.removesuffix(request.unit).strip()
        try:
            if "_" not in words:  # Python would take 1_0 for ten
                return float(words)
        except ValueError:
            continue
    raise DeviceError(
        "operator", f"{words!r} is no number in {request.unit}", "type it with a decimal point"
    )


@dataclass(frozen=True)
class ManualSetting:
    """What became of a request: asked, read by whom, how long it took, in how many tries.

    ``taken`` is what the test goes on with: what was read, or a marked mass that was confirmed.
    """

    axis: str
    asked: float
    read: float
    taken: float
    unit: str
    checked_by: str
    waited_s: float
    tries: int

    @property
    def error(self) -> float:
        """Read less asked."""
        return self.read - self.asked


class ManualAxis:
    """An axis moved by hand: prompts, times, checks against a sensor, tells what was read.

    Args:
        name: "length", "pressure", "mass", ...
        unit: of its values.
        operator: who does it.
        event_loop: of the bench.
        check: reads the sensor that looks after it; None believes what was asked for, or
            what the operator types instead.
        checked_by: name of that sensor.
        tolerance: how far the sensor may be from what was asked for.
        verb: how the request begins.
        marked: True where what is set bears its value, as a weight does: the sensor then only
            confirms it, and who sets another one types what it bears.
        before: called before any request.
    """

    def __init__(  # noqa: PLR0913 - an axis has that many named settings
        self,
        name: str,
        unit: str,
        operator: Operator,
        event_loop: EventLoop,
        check: Callable[[], float] | None = None,
        checked_by: str = "",
        tolerance: float = 0.0,
        verb: str = "set",
        marked: bool = False,
        before: Callable[[], None] | None = None,
    ) -> None:
        self.name = name
        self.unit = unit
        self._operator = operator
        self._event_loop = event_loop
        self._check = check
        self._checked_by = checked_by if check is not None else "operator"
        self._tolerance = tolerance
        self._verb = verb
        self._marked = marked
        self._before = before
        self.settings: list[ManualSetting] = []
        self.on_setting: list[Callable[[ManualSetting], None]] = []

    def set(self, value: float) -> ManualSetting:
        """Have it set; returns what the sensor reads then.

        Raises:
            DeviceError: after three tries the sensor still reads something else.
        """
        if self._before is not None:
            self._before()
        waited = 0.0
        read = value
        note = ""
        for attempt in range(1, TRIES + 1):
            text = f"{self._wording(value)}{note}, then press Enter"
            answer, seconds = put_request(
                self._operator, self._event_loop, Request(self.name, value, self.unit, text)
            )
            waited += seconds
            typed = self._typed(answer, value) if self._marked or self._check is None else value
            read = typed if self._check is None else self._check()
            if self._check is None or abs(read - typed) <= self._tolerance:
                setting = ManualSetting(
                    self.name, value, read, typed if self._marked else read,
                    self.unit, self._checked_by, waited, attempt,
                )  # fmt: skip
                self.settings.append(setting)
                for listener in self.on_setting:
                    listener(setting)
                return setting
            note = f" ({self._checked_by} reads {read:.4g} {self.unit})"
        raise DeviceError(
            f"manual axis {self.name}",
            f"asked for {value:g} {self.unit}, {self._checked_by} reads {read:.4g} after "
            f"{TRIES} tries (tolerance {self._tolerance:g})",
            "set it closer, or widen the tolerance in the rig file",
        )

    def set_value(self, value: float) -> float:
        """Have it set, as an `Actuator`; returns what the sensor reads then."""
        return self.set(value).read

    def _wording(self, value: float) -> str:
        if self.name == "mass":
            what = f"hang {value:g} {self.unit} on the muscle and let it come to rest"
            return what if value else "take the load off the muscle"
        return f"{self._verb} {self.name} to {value:g} {self.unit}"

    def _typed(self, answer: str, asked: float) -> float:
        if answer.lower() in TRUE_WORDS:
            return asked
        try:
            return float(answer)
        except ValueError:
            raise DeviceError(
                f"manual axis {self.name}",
                f"{answer!r} is neither Enter nor a number in {self.unit}",
                "press Enter, or type what was read with a decimal point",
            ) from None


class ManualStage:
    """A length that a person sets, with the face of the linear stage."""

    def __init__(self, axis: ManualAxis) -> None:
        self.axis = axis
        self.identity = {"kind": "manual"}
        self.on_bytes: Callable[[int, bytes], None] | None = None

    @property
    def name(self) -> str:
        """What it is, for messages."""
        return "stage (set by hand)"

    def move(self, length_mm: float) -> float:
        """Have the length set; returns what the camera reads, in mm."""
        return self.axis.set(length_mm).read

    def set_value(self, value: float) -> float:
        """The length in mm, as an `Actuator`."""
        return self.move(value)

    def poll(self) -> None:
        """Nothing to read."""

    def counters(self) -> dict[str, int]:
        """How often it was set."""
        return {"settings": len(self.axis.settings)}
