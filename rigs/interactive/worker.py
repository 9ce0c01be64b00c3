"""The process that holds a rig for a notebook: ``python -m rigs.interactive.worker``.

It runs one session of protocol "interactive" with the runner and the record of every other test.
Its heartbeat does not depend on what the notebook does. It ends, vents and closes the record when
the notebook asks for it, when the notebook's process ends in whatever way, and when no request
came for a stated time while the muscle is under pressure.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import sys
import threading
from collections.abc import Callable, Mapping
from multiprocessing.connection import Client, Connection
from pathlib import Path
from typing import Any

import psutil

from analysis.registry import analysis_of
from daq.clock import NS_PER_S
from daq.errors import ConfigError, DeviceError, PamrigError
from daq.interrupt import StopFlag
from rigs.devices.operator import Request
from rigs.execution.procedure import Procedure
from rigs.execution.session import run_protocol
from rigs.interactive import steps as own
from rigs.interactive.inbox import CLOSED, GONE, Inbox, send, send_tables
from rigs.rigfile.config import Limits, RigConfig, load_rig
from rigs.steps.context import StepContext
from rigs.steps.custom_step import CustomStep, Step, Steps
from rigs.steps.steps import Dwell, SetLength, SetPressure, State, Tare, Vent
from rigs.steps.watching import Watch

NAME = "interactive"


class _Next(CustomStep):
    """Wait for the next request; the bench goes on meanwhile."""

    def __init__(self, inbox: Inbox, idle_s: float) -> None:
        self._inbox = inbox
        self._idle_s = idle_s

    def perform(self, runner: StepContext) -> dict[str, Any] | None:
        """The request; None when the user has closed the session.

        Raises:
            Stopped: the session ended in another way.
        """
        request = self._wait(runner)
        if request is None:
            runner.stop.check()
        return request

    def _wait(self, runner: StepContext) -> dict[str, Any] | None:
        clock = runner.rig.clock
        if clock.virtual:  # time stands still between two calls
            while (request := self._inbox.take(0.2)) is None and not self._inbox.closed:
                runner.stop.check()
            return request
        since_ns = clock.now_ns()

        def came_or_idle() -> bool:
            idle = clock.now_ns() - since_ns > self._idle_s * NS_PER_S
            return not self._inbox.empty or (idle and not runner.vented)

        while self._inbox.empty:
            runner.rig.event_loop.until(came_or_idle, 1.0)
            if self._inbox.empty and came_or_idle():
                text = f"no request for {self._idle_s:g} s: vented"
                runner.record.event("idle", text=text)
                runner.watch.log(text)
                runner.do(Vent())
        return self._inbox.take()


class Conversation:
    """Turns requests into steps and sends the answers.

    Args:
        link: to the notebook.
        inbox: the requests.
        config: the rig, for its limits.
        idle_s: longest time under pressure without a request.
    """

    name = NAME
    frames = 0

    def __init__(self, link: Connection, inbox: Inbox, config: RigConfig, idle_s: float) -> None:
        self._link = link
        self._inbox = inbox
        self._limits: Limits = config.limits
        self._source = config.source
        self._idle_s = idle_s
        self._armed = False
        self._pressure_kpa = 0.0
        self._length_mm: float | None = None
        self._orders = 0
        self._requests: dict[str, Callable[[Mapping[str, Any]], list[Step]]] = {
            "read": lambda request: [own.Read(bool(request.get("length", True)))],
            "arm": lambda request: [own.Arm()],
            "disarm": lambda request: [own.Disarm()],
            "mark": lambda request: [own.Marker(str(request.get("text", "")))],
            "wait": lambda request: [Dwell(self._number(request, "seconds", 0.0, 86400.0))],
            "vent": self._vent,
            "set_pressure": self._set_pressure,
            "set_length": self._set_length,
            "tare": self._tare,
            "record": self._stretch,
            "point": self._point,
        }

    def as_dict(self) -> dict[str, Any]:
        """Plain values for run.json."""
        return {"idle_s": self._idle_s}

    def steps(self) -> Steps:
        """One request after another, until the session is closed."""
        yield State("interactive")
        while (request := (yield _Next(self._inbox, self._idle_s))) is not None:
            try:
                todo = self._steps_of(str(request.get("do")), request)
            except PamrigError as error:
                send(self._link, {"refused": described(error)})
                continue
            answer: Any = None
            for step in todo:
                answer = yield step
                self._note(step)
            self._reply(answer)

    def _reply(self, answer: Any) -> None:
        if isinstance(answer, tuple):
            answer = {"settled": bool(answer[0]), "waited_s": float(answer[1])}
        if isinstance(answer, dict) and "valve" in answer:
            send(self._link, {"tables": True})
            send_tables(self._link, answer)
            return
        send(self._link, {"answer": answer})

    def _note(self, step: Step) -> None:
        """Follow what the bench was told."""
        match step:
            case own.Arm():
                self._armed = True
            case own.Disarm():
                self._armed, self._pressure_kpa = False, 0.0
            case SetPressure(pressure_kpa):
                self._pressure_kpa = pressure_kpa
            case Vent():
                self._pressure_kpa = 0.0
            case SetLength(length_mm):
                self._length_mm = length_mm

    def _steps_of(self, what: str, request: Mapping[str, Any]) -> list[Step]:
        """The steps of a request, checked before anything is sent to a device.

        Raises:
            DeviceError: the bench is not in a state for it.
            ConfigError: a value beyond the rig's limits.
        """
        make = self._requests.get(what)
        if make is None:
            raise ConfigError(what, "is not a request of an interactive session")
        return make(request)

    def _vent(self, request: Mapping[str, Any]) -> list[Step]:
        del request
        return [Vent()] if self._armed else []

    def _set_length(self, request: Mapping[str, Any]) -> list[Step]:
        low, high = self._limits.length_min_mm, self._limits.length_max_mm
        return [SetLength(self._number(request, "length_mm", low, high))]

    def _tare(self, request: Mapping[str, Any]) -> list[Step]:
        del request
        if self._pressure_kpa:
            raise DeviceError("balance", "the muscle is under pressure", "vent() first")
        return [Tare()]

    def _set_pressure(self, request: Mapping[str, Any]) -> list[Step]:
        self._need_arming()
        kpa = self._number(request, "pressure_kpa", 0.0, self._limits.pressure_kpa)
        if kpa == 0.0:
            return [Vent()]
        timeout_s = self._number(request, "timeout_s", 0.0, 3600.0)
        return [SetPressure(kpa), *([own.settle(kpa, timeout_s)] if timeout_s else [])]

    def _stretch(self, request: Mapping[str, Any]) -> list[Step]:
        pictures = int(self._number(request, "pictures", 0, 10_000))
        return [own.Stretch(self._number(request, "seconds", 0.05, 3600.0), pictures)]

    def _point(self, request: Mapping[str, Any]) -> list[Step]:
        self._need_arming()
        self._orders += 1
        return [
            own.Point(
                self._orders,
                self._pressure_kpa,
                self._length_mm,
                self._number(request, "seconds", 0.2, 600.0),
                int(self._number(request, "frames", 0, 1000)),
                self._number(request, "timeout_s", 0.5, 3600.0),
            )
        ]

    def _need_arming(self) -> None:
        if not self._armed:
            raise DeviceError("rig", "is not armed", "arm() allows air to be let in")

    def _number(self, request: Mapping[str, Any], key: str, low: float, high: float) -> float:
        value = request.get(key)
        if (
            isinstance(value, bool)
            or not isinstance(value, int | float)
            or not low <= value <= high
        ):
            raise ConfigError(
                key, f"expected a number from {low:g} to {high:g}, got {value!r}", self._source
            )
        return float(value)


class NotebookOperator:
    """The person at the notebook: a request of the rig is put to the user there."""

    def __init__(self, link: Connection, inbox: Inbox) -> None:
        self._link = link
        self._inbox = inbox

    def begin(self, request: Request) -> None:
        """Put the request."""
        send(self._link, {"ask": request.text})

    def answer(self) -> str | None:
        """What was typed, None as long as nothing was."""
        return None if self._inbox.answers.empty() else self._inbox.answers.get()


def described(error: BaseException) -> dict[str, str]:
    """An error as it travels."""
    if isinstance(error, PamrigError):
        told = {"where": error.where, "what": error.what, "remedy": error.remedy}
        return {"kind": type(error).__name__, **told}
    return {"where": "rig", "what": f"{type(error).__name__}: {error}"}


def serve(link: Connection, settings: Mapping[str, Any]) -> int:
    """Hold the rig until the session ends; the process's exit status."""
    stop = StopFlag()

    def close(reason: str) -> None:
        if reason != CLOSED:
            stop.set(reason)

    inbox = Inbox(link, close)
    _watch_parent(int(settings["parent"]), stop)
    says = _Teller(link)
    try:
        config = load_rig(str(settings["rig"]), settings["seed"])
        talk = Conversation(link, inbox, config, float(settings["idle_s"]))
        kind = Procedure(analysis_of(NAME), lambda name, rig: talk, open_ended=True)
        result = run_protocol(
            kind, config, talk, Path(settings["runs"]),
            specimen=str(settings["specimen"]), operator=str(settings["operator"]),
            note=str(settings["note"]), stop=stop, watch=Watch(log=says.log),
            on_start=lambda runner, record: says.ready(str(record.folder), config.is_virtual),
            person=None if config.is_virtual else NotebookOperator(link, inbox),
        )  # fmt: skip
    except PamrigError as error:
        says.ended("refused", "", error)
        return 2
    says.ended(result.outcome, str(result.folder), result.error)
    return 0


class _Teller:
    """Says what happens to the notebook, as long as it is there."""

    def __init__(self, link: Connection) -> None:
        self._link = link

    def _send(self, message: Mapping[str, Any]) -> None:
        with contextlib.suppress(OSError):
            send(self._link, message)

    def log(self, text: str) -> None:
        self._send({"log": text})

    def ready(self, folder: str, virtual: bool) -> None:
        self._send({"ready": folder, "virtual": virtual})

    def ended(self, outcome: str, folder: str, error: BaseException | None) -> None:
        reason = described(error) if error is not None else None
        self._send({"ended": outcome, "folder": folder, "reason": reason})


def _watch_parent(pid: int, stop: StopFlag) -> None:
    """Stop when the notebook's process has ended, also if a child of it keeps the connection."""

    def watch() -> None:
        with contextlib.suppress(psutil.Error):
            psutil.Process(pid).wait()
        stop.set(GONE)

    threading.Thread(target=watch, name="parent", daemon=True).start()


def main() -> int:
    """Read where to connect from standard input, and serve."""
    for name in ("SIGINT", "SIGTSTP"):  # Ctrl-C belongs to the notebook, which then says so
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    settings = json.loads(sys.stdin.readline())
    with Client(settings["address"], authkey=bytes.fromhex(settings["key"])) as link:
        return serve(link, settings)


if __name__ == "__main__":
    status = main()
    sys.stdout.flush()
    os._exit(status)  # the thread that reads the connection would hold the process
