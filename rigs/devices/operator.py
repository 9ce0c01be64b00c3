"""Somebody who sets what no motor sets: on request of the program, timed, and checked."""

from __future__ import annotations

import math
import os
import queue
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Protocol

from daq.clock import NS_PER_S
from daq.errors import DeviceError
from rigs.devices.event_loop import EventLoop

TRIES = 3
"""How often a sensor may contradict what was set before the test ends."""
SURPRISE = 0.2
"""A marked value that differs by a larger part from the requested one must be typed twice."""
ANSWERS = 10
"""How often an answer may be unreadable before the test ends: nobody reads the terminal then."""
TRUE_WORDS = ("", "y", "yes", "ok", "done")


@dataclass(frozen=True)
class Request:
    """A request to a person.

    Attributes:
        axis: "length", "pressure", "mass", "temperature", or a reading to be typed in.
        value: what to set; nan when something is to be read.
        unit: its unit.
        text: the sentence for a person.
        again: where the last answer was refused: why, in short. A terminal shows this in the place
            of the sentence, which still stands above.
    """

    axis: str
    value: float
    unit: str
    text: str
    again: str = ""

    def refused(self, why: str) -> Request:
        """The same request again, after an answer that was refused."""
        return replace(self, text=f"{why}. Again: {self.text}", again=why)


class Operator(Protocol):
    """A person, or one simulated on the virtual bench."""

    def begin(self, request: Request) -> None:
        """Put the request; returns at once."""
        ...

    def answer(self) -> str | None:
        """What was answered, or None as long as nothing was."""
        ...


class Terminal:
    """The one thread of the program that reads typed lines; the newest listener gets them.

    Two threads that read the same terminal would take lines from each other, for example in a
    plan, where one test follows another.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None
        self._source: object = None
        self._listener: Callable[[str | None], None] = lambda _: None

    def listen(self, listener: Callable[[str | None], None]) -> None:
        """From now on each line goes to ``listener``, and None at the end of the input."""
        with self._lock:
            self._listener = listener
            alive = self._thread is not None and self._thread.is_alive()
            if not alive or self._source is not sys.stdin:
                self._source = sys.stdin
                self._thread = threading.Thread(
                    target=self._read, args=(sys.stdin,), name="terminal", daemon=True
                )
                self._thread.start()

    def _read(self, source: object) -> None:
        for line in _typed_lines():
            if self._source is not source:
                return
            self._listener(line.strip())
        if self._source is source:
            self._listener(None)


_terminal = Terminal()


def at_a_terminal() -> bool:
    """Whether somebody can type: the input is a terminal that this program may read."""
    if sys.stdin is None or not sys.stdin.isatty():
        return False
    if not hasattr(os, "tcgetpgrp"):
        return True
    try:  # reading in the background would stop the program, and with it the heartbeat
        return os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()
    except OSError:  # not the terminal that the program was started from: nothing stops it
        return True


class ConsoleOperator:
    """A person at the terminal: sees the request, presses Enter or types what was read.

    Attributes:
        on_line: takes what is typed while no request is open.
        is_command: whether a line goes to ``on_line`` even while a request is open.
    """

    def __init__(self) -> None:
        self._lines: queue.Queue[str | None] = queue.Queue()
        self._asking = False
        self.on_line: Callable[[str], None] | None = None
        self.is_command: Callable[[str], bool] = lambda _: False

    def begin(self, request: Request) -> None:
        """Print the request and listen."""
        while not self._lines.empty():  # what was typed before the question answers nothing
            self._lines.get_nowait()
        self._asking = True  # before the question is seen: its answer may be quick
        text = f"{request.again}. Your answer:" if request.again else request.text
        print(f"\n>> {text}", file=sys.stderr, flush=True)
        self.listen()

    def listen(self) -> None:
        """Take what is typed from now on, question or not."""
        _terminal.listen(self._take)

    def _take(self, line: str | None) -> None:
        if line is not None and self.on_line is not None:
            if self._asking and not self.is_command(line):
                self._lines.put(line)
            elif line:
                self.on_line(line)
            return
        self._lines.put(line)

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
    event_loop.asks = True
    for listener in event_loop.on_request:
        listener(request.text)
    got: list[str] = []

    def answered() -> bool:
        text = operator.answer()
        if text is not None:
            got.append(text)
        return bool(got)

    while not event_loop.until(answered, 3600.0):
        operator.begin(replace(request, again=""))  # an hour later it is still needed
    event_loop.asks = False
    for listener in event_loop.on_request:
        listener("")
    return got[0], (event_loop.clock.now_ns() - start_ns) / NS_PER_S


def read_number(text: str, unit: str = "") -> float | None:
    """A number as a person types it, with its unit or without, or None.

    A decimal comma counts as a decimal point. Text with a comma and a point is no number: which
    of the two separates thousands is not known.
    """
    words = text.strip()
    words = words.removesuffix(unit).strip() if unit else words
    if words.count(",") == 1 and "." not in words:
        words = words.replace(",", ".")
    try:
        value = float(words)
    except ValueError:
        return None
    # Python would take 1_0 for ten.
    return value if "_" not in words and math.isfinite(value) else None


def request_number(operator: Operator, event_loop: EventLoop, request: Request) -> float:
    """A number that a person reads and types; anything else is asked again.

    Raises:
        DeviceError: no number in ``ANSWERS`` answers.
    """
    text, asked = "", request
    for _ in range(ANSWERS):
        text, _ = put_request(operator, event_loop, asked)
        value = read_number(text, request.unit)
        if value is not None:
            return value
        asked = request.refused(f"{text!r} is not a number in {request.unit}")
    raise _unreadable("operator", text, f"not a number in {request.unit}")


def request_done(
    operator: Operator, event_loop: EventLoop, request: Request, low: float, high: float
) -> tuple[float, float]:
    """Put a request until Enter, or a number from ``low`` to ``high``, comes: (value, waited in s).

    Raises:
        DeviceError: neither came in ``ANSWERS`` answers.
    """
    waited, answer, what, asked = 0.0, "", "", request
    for _ in range(ANSWERS):
        answer, seconds = put_request(operator, event_loop, asked)
        waited += seconds
        if answer.lower() in TRUE_WORDS:
            return request.value, waited
        number = read_number(answer, request.unit)
        if number is not None and low <= number <= high:
            return number, waited
        what = f"neither Enter nor a number from {low:g} to {high:g} {request.unit}"
        asked = request.refused(f"{answer!r} is {what}")
    raise _unreadable(request.axis, answer, what)


def request_enter(operator: Operator, event_loop: EventLoop, request: Request) -> float:
    """Put a request until Enter confirms it, and nothing else; returns how long it took, in s.

    Raises:
        DeviceError: something else came in ``ANSWERS`` answers.
    """
    waited, answer, asked = 0.0, "", request
    for _ in range(ANSWERS):
        answer, seconds = put_request(operator, event_loop, asked)
        waited += seconds
        if answer.lower() in TRUE_WORDS:
            return waited
        asked = request.refused(f"{answer!r} is not Enter; Ctrl-C ends")
    raise _unreadable(request.axis, answer, "not Enter")


def _unreadable(where: str, text: str, what: str) -> DeviceError:
    return DeviceError(
        where, f"{text!r} is {what}, after {ANSWERS} answers", "answer at a terminal"
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
        highest: no typed value may be above it.
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
        highest: float = math.inf,
    ) -> None:
        self._highest = highest
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
            typed, seconds = self._confirmed(Request(self.name, value, self.unit, text))
            waited += seconds
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
            # A heavier load may be made by adding weights: the mass is that of all of them.
            in_all = " in all" if self.settings and self.settings[-1].taken else ""
            what = f"hang {value:g} {self.unit}{in_all} on the muscle and let it come to rest"
            return what if value else "take the load off the muscle"
        if self.name == "angle":
            return f"lock the joint at {value:g} {self.unit}"
        return f"{self._verb} {self.name} to {value:g} {self.unit}"

    def _confirmed(self, request: Request) -> tuple[float, float]:
        """Put a request until Enter or a number comes: (value, waited in s).

        Raises:
            DeviceError: neither came in ``ANSWERS`` answers.
        """
        waited, answer, asked = 0.0, "", request
        surprise = math.nan
        for _ in range(ANSWERS):
            answer, seconds = put_request(self._operator, self._event_loop, asked)
            waited += seconds
            number = read_number(answer, self.unit)
            if answer.lower() in TRUE_WORDS or (number is not None and not self._types):
                return request.value, waited
            if number is None:
                why = f"{answer!r} is neither Enter nor a number in {self.unit}"
            elif not number <= self._highest:
                limit = f"the limit of this rig, {self._highest:.4g} {self.unit}"
                why = f"{number:g} {self.unit} is above {limit}"
            elif self._surprising(number, request.value) and number != surprise:
                surprise = number
                why = (
                    f"{request.value:g} {self.unit} was requested, not {number:g}: type"
                    f" {number:g} again if that is what hangs"
                )
            else:
                return number, waited
            asked = request.refused(why)
        raise _unreadable(
            f"manual axis {self.name}", answer, f"neither Enter nor a number in {self.unit}"
        )

    def _surprising(self, number: float, requested: float) -> bool:
        """Whether a marked value may well be a typing error."""
        return self._marked and abs(number - requested) > SURPRISE * abs(requested)

    @property
    def _types(self) -> bool:
        """Whether a typed number counts: no sensor reads it, or what is set is marked."""
        return self._marked or self._check is None


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
