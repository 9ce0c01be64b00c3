"""How late the computer lets the program be, and what that means for the heartbeat.

Two loops count. The one that beats reads the ports as well; with a process of its own it is late
only where the computer is. The one of the program carries the test out; the heartbeat goes on for
``ALIVE_S`` without it.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from daq.clock import NS_PER_S
from daq.link.lateness import Lateness
from rigs.devices.event_loop import LATE_S, EventLoop
from rigs.devices.valve_controller import ALIVE_S, HEARTBEAT_S
from rigs.rigfile.config import RigConfig
from valvefw.config import PARAMETERS

RECENT_S = 5.0
"""A fault is blamed on a delay that is not older than twice this."""
LATE_SHARE = 0.25
"""Delays below this share of a limit explain nothing."""
REMEDY = "close other programs or take a faster computer; `pamrig doctor` measures how late it is"


def heartbeat_limit_s(config: RigConfig) -> float:
    """How long the controller waits for a heartbeat before it vents: its parameter ``hb_ms``."""
    default = next(row[1] for row in PARAMETERS if row[0] == "hb_ms")
    valves = [config.valve] if config.valve_b is None else [config.valve, config.valve_b]
    return min(int(valve.parameters.get("hb_ms", default)) for valve in valves) * 1e-3


NICE = -10
REAL_TIME = 1
"""Priority of the program among real-time threads: below the process that beats."""
THREADS = Path("/proc/self/task")
"""Linux keeps a priority for each thread."""


def _threads() -> list[int]:
    return sorted(int(entry.name) for entry in THREADS.iterdir())


@contextlib.contextmanager
def raised_priority() -> Iterator[str]:
    """Priority of this program's threads above that of other programs, where the system grants it.

    Children that are there already, such as the viewer, keep theirs. All threads get it, because a
    thread of lower priority may hold the interpreter's lock.

    Yields:
        What was granted: "SCHED_RR", "nice -10" or "normal".
    """
    granted, old = "normal", 0
    with contextlib.suppress(OSError, ValueError, AttributeError):
        old = os.getpriority(os.PRIO_PROCESS, 0)
        granted = _raise(_threads())
    try:
        yield granted
    finally:
        with contextlib.suppress(OSError, ValueError, AttributeError):
            for thread in _threads() if granted != "normal" else []:
                with contextlib.suppress(ProcessLookupError):
                    if granted == "SCHED_RR":
                        os.sched_setscheduler(thread, os.SCHED_OTHER, os.sched_param(0))
                    else:
                        os.setpriority(os.PRIO_PROCESS, thread, old)


def _raise(threads: list[int]) -> str:
    """Real-time priority for these threads, or a higher one."""
    try:
        for thread in threads:
            os.sched_setscheduler(thread, os.SCHED_RR, os.sched_param(REAL_TIME))
        return "SCHED_RR"
    except PermissionError:
        for thread in threads:
            os.setpriority(os.PRIO_PROCESS, thread, NICE)
        return f"nice {NICE}"


class Computer:
    """The lateness of both loops of a bench that runs in real time.

    Args:
        event_loop: of the program, with the acquisition where there is one.
        config: the rig file.

    Attributes:
        limit_s: how long the controller waits for a heartbeat.
        granted: priority of the program itself.
    """

    def __init__(self, event_loop: EventLoop, config: RigConfig) -> None:
        self._event_loop = event_loop
        self.limit_s = heartbeat_limit_s(config)
        self.granted = "normal"
        self._restart_ns = 0

    def begin(self) -> None:
        """Count from now on: what was loaded and compiled before arming vents nothing."""
        for lateness in self._loops():
            lateness.begin()

    def _loops(self) -> list[Lateness]:
        return list({id(x): x for x in (self.program, self.heartbeat, self.reading)}.values())

    @property
    def program(self) -> Lateness:
        """Of the loop that carries the test out."""
        return self._event_loop.lateness

    @property
    def heartbeat(self) -> Lateness:
        """Of the loop that beats."""
        acquisition = self._event_loop.acquisition
        return self.program if acquisition is None else acquisition.lateness

    @property
    def reading(self) -> Lateness:
        """Of the loop that reads the ports."""
        acquisition = self._event_loop.acquisition
        return self.program if acquisition is None else acquisition.reading

    @property
    def blind_s(self) -> float:
        """How long nothing has been read by now, for reasons that are the computer's alone."""
        acquisition = self._event_loop.acquisition
        late_s = self._event_loop.late_s
        if acquisition is not None:
            late_s = max(late_s, acquisition.blocked_s(self._event_loop.clock.now_ns()))
        return late_s if late_s > LATE_S else 0.0

    @property
    def spare_s(self) -> float:
        """How late a heartbeat may be: the limit less the time between two of them."""
        return self.limit_s - HEARTBEAT_S

    def look(self) -> None:
        """Called in every round: what is long ago explains no fault."""
        now_ns = self._event_loop.clock.now_ns()
        if now_ns - self._restart_ns > RECENT_S * NS_PER_S:
            self._restart_ns = now_ns
            for lateness in self._loops():
                lateness.restart()

    def busy(self) -> str:
        """That the computer was too busy lately, and by how much; empty where it was not."""
        late = []
        if self.heartbeat.recent_s > LATE_SHARE * self.spare_s:
            late.append(f"the heartbeat was late by up to {self.heartbeat.recent_s * 1e3:.0f} ms")
        if self.heartbeat is not self.program and self.program.recent_s > LATE_SHARE * ALIVE_S:
            late.append(f"the program was late by up to {self.program.recent_s * 1e3:.0f} ms")
        if self.reading is not self.program and self.reading.recent_s > LATE_SHARE * ALIVE_S:
            late.append(
                f"bytes of the ports came late by up to {self.reading.recent_s * 1e3:.0f} ms"
            )
        if not late:
            return ""
        limits = f"the controller waits {self.limit_s * 1e3:.0f} ms for a heartbeat"
        return f"the computer was too busy: {', '.join(late)}; {limits}"

    def as_dict(self) -> dict[str, Any]:
        """For the record."""
        acquisition = self._event_loop.acquisition
        return {
            "heartbeat_limit_ms": round(self.limit_s * 1e3),
            "heartbeat": self.heartbeat.as_dict(),
            "reading": self.reading.as_dict(),
            "program": self.program.as_dict(),
            "priority": {
                "heartbeat": self.granted if acquisition is None else acquisition.priority,
                "program": self.granted,
            },
        }
