"""What the live view makes of telemetry: state, progress and faults in words; target and zero.

The running test and the view file of a recorded run both call these functions, so that both
screens show the same. The state is read from telemetry alone: flags, set-point, pressure and valve
commands.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from valvefw.wire import FLAG_ARMED, FLAG_FAULT

Floats = npt.NDArray[np.float64]
SMALL_KPA = 2.0
"""A set-point below this is that of a controller that was given none."""
FULL = 0.99
"""Share of a sample's time from which a valve counts as open throughout."""
BLOCK = 50
"""Samples of one look: 50 ms."""
STEADY_BLOCKS = 4
"""So many looks in a row must agree; a fault is shown at once."""
VENTED_KPA = 10.0
NEAR_KPA = 5.0
NEAR_SHARE = 0.02
"""The pressure is held where it is this near its set-point: 5 kPa and 2 % of it."""
FOLLOW_S = 1.0
FOLLOW_LOOKS = 4
"""In so many looks of the last second the set-point differed from the look before: it moves."""
FOLLOWING = "FOLLOWING A MOVING SET-POINT"
BAR = 24
FAULT, STOPPED, DONE = "FAULT", "STOPPED", "DONE"


def with_target(columns: Mapping[str, Any]) -> dict[str, Any]:
    """Columns of a valve controller with ``target_kpa``: the set-point that it regulates to.

    0 while it vents. NaN while it regulates to nothing: the air is shut in, or a test commands the
    valves itself. The controller then reports a set-point of 0, which would look like venting.

    Args:
        columns: with ``setpoint_kpa`` and ``outlet_cmd`` (share of each sample's time), (n,) each.
    """
    set_point = np.asarray(columns["setpoint_kpa"], dtype=np.float64)
    given = set_point > SMALL_KPA
    venting = np.asarray(columns["outlet_cmd"], dtype=np.float64) >= FULL
    target = np.where(given, set_point, np.where(venting, 0.0, np.nan))
    return {**columns, "target_kpa": target}


TARING_S = 1.0
"""So long before the end of a tare its readings may be from either zero; they are left out."""


class ForceZero:
    """Zero of the force: the vented, slack muscle at the newest tare.

    Before the first tare, the first reading of the run stands for it: the muscle is vented then.
    The weight on the balance would otherwise be drawn as a force.
    """

    def __init__(self) -> None:
        self._offset: float | None = None
        self._tared = self._taring = False

    def taring(self) -> None:
        """The balance is about to be tared: until it is, no reading has a known zero."""
        self._taring = True

    def tared(self) -> None:
        """The balance was tared: from here on its readings are counted from this zero."""
        self._tared, self._taring = True, False

    def apply(self, force_n: Any) -> Floats:
        """Forces of consecutive readings, in N from the zero, (n,); NaN while it is tared."""
        force = np.asarray(force_n, dtype=np.float64)
        if self._taring:
            return np.full(len(force), np.nan)
        if self._tared or not len(force):
            return force
        if self._offset is None:
            self._offset = float(force[0])
        return force - self._offset


def from_zero(time_s: Floats, force_n: Floats, tare_s: float | None) -> Floats:
    """The same for a recorded run.

    Args:
        time_s, force_n: readings, (n,) each.
        tare_s: time of the first tare; None without one.
    """
    if tare_s is None or not len(force_n):
        return force_n
    before = np.where(time_s < tare_s - TARING_S, force_n - force_n[0], np.nan)
    return np.where(time_s < tare_s, before, force_n)


def phase_of(flags: int, target_kpa: float, pressure_kpa: float, inlet: float, vent: float) -> str:
    """The state in capital letters.

    Args:
        flags: of the newest sample.
        target_kpa: see :func:`daq.live.signals.with_target`; nan for none.
        pressure_kpa: mean of the samples.
        inlet, vent: mean share of time for which the valves are commanded open.
    """
    if flags & FLAG_FAULT:
        return FAULT
    vented = "VENTED" if pressure_kpa < VENTED_KPA else "VENTING"
    if not flags & FLAG_ARMED:
        return f"NOT ARMED, {vented}"
    if target_kpa <= 0.0 or (vent >= FULL and not target_kpa > 0.0):
        return f"ARMED, {vented}" if vented == "VENTED" else vented
    shut = inlet <= 0.0 and vent <= 0.0
    if target_kpa > 0.0:
        if abs(pressure_kpa - target_kpa) <= NEAR_KPA + NEAR_SHARE * target_kpa:
            return f"HOLDING {target_kpa:.0f} kPa"
        way = "AIR SHUT IN, SET-POINT" if shut else "GOING TO"
        return f"{way} {target_kpa:.0f} kPa"
    if not shut:
        return "TEST COMMANDS THE VALVES"
    return "AIR SHUT IN" if pressure_kpa >= VENTED_KPA else "ARMED, VALVES SHUT"


class Phases:
    """States of consecutive samples of one controller; each change comes out once."""

    def __init__(self) -> None:
        self.phase = ""
        self._next = ""
        self._agree = 0
        self._target = math.nan
        self._moved: deque[float] = deque(maxlen=FOLLOW_LOOKS)

    def feed(self, time_s: Any, columns: Mapping[str, Any]) -> Iterator[tuple[float, str]]:
        """Changes of the state in a batch: time in s, state.

        Args:
            time_s: of the samples, (n,).
            columns: engineering columns of a controller, with ``flags``, (n,) each; the column
                of the pressure is the one whose name begins with ``pressure``.
        """
        pressure = next((v for k, v in columns.items() if k.startswith("pressure")), None)
        wanted = {"flags", "setpoint_kpa", "inlet_cmd", "outlet_cmd"}
        if pressure is None or not wanted <= columns.keys() or not len(time_s):
            return
        target = with_target(columns)["target_kpa"]
        starts = np.arange(0, len(time_s), BLOCK)
        size = np.diff(np.append(starts, len(time_s)))
        ends = starts + size - 1
        means = [
            np.add.reduceat(np.asarray(v, dtype=np.float64), starts) / size
            for v in (pressure, columns["inlet_cmd"], columns["outlet_cmd"])
        ]
        flags = np.asarray(columns["flags"])
        for k, end in enumerate(ends):
            phase = phase_of(
                int(flags[end]), float(target[end]), *(float(mean[k]) for mean in means)
            )
            if self._follows(float(time_s[end]), float(target[end])) and phase != FAULT:
                phase = FOLLOWING
            if self._steady(phase):
                yield float(time_s[end]), phase

    def _follows(self, time_s: float, target_kpa: float) -> bool:
        """Whether a sine, a sweep or a ramp leads the set-point: it is another in most looks."""
        if not target_kpa > 0.0:  # vented, or nothing is regulated
            self._moved.clear()
        elif target_kpa != self._target and self._target > 0.0:
            self._moved.append(time_s)
        self._target = target_kpa
        return len(self._moved) == FOLLOW_LOOKS and time_s - self._moved[0] < FOLLOW_S

    def _steady(self, phase: str) -> bool:
        self._agree = self._agree + 1 if phase == self._next else 1
        self._next = phase
        new = phase != self.phase
        if new and (self._agree >= STEADY_BLOCKS or phase == FAULT or not self.phase):
            self.phase = phase
            return True
        return False


def joined(phases: Mapping[str, str]) -> str:
    """The states of all controllers as one: a fault of one is that of the bench."""
    names = list(phases)
    if any(phase == FAULT for phase in phases.values()):
        return FAULT
    if len(set(phases.values())) <= 1:
        return next(iter(phases.values()), "")
    return " · ".join(f"{chr(97 + k)}: {phases[name]}" for k, name in enumerate(names))


@dataclass(frozen=True)
class Status:
    """What the panel "Status" says.

    Attributes:
        phase: state of the bench.
        step: step of the test.
        done, planned: points made, and of how many; 0 planned where nobody knows.
        left_s: time left in s; None if it is not known.
        problem: what went wrong; empty for nothing.
        remedy: what to do about it.
        request: what a person at the bench is asked for; empty for nothing.
    """

    phase: str
    step: str = ""
    done: int = 0
    planned: int = 0
    left_s: float | None = None
    problem: str = ""
    remedy: str = ""
    request: str = ""

    def markdown(self) -> str:
        """The text of the panel; the state is its heading."""
        lines = [f"# {self.phase or 'STARTING'}"]
        if self.request and self.phase not in (FAULT, DONE, STOPPED):
            lines = ["# YOUR TURN", f"**{self.request}**", f"### {self.phase}"]
        if self.problem:
            lines.append(self.problem)
        if self.remedy:
            lines.append(f"**What to do: {self.remedy}**")
        if self.step and self.phase not in (DONE, STOPPED):
            lines.append(f"### {self.step}")
        lines.append(self._progress())
        return "\n\n".join(line for line in lines if line)

    def _progress(self) -> str:
        if not self.planned:
            return f"{self.done} points" if self.done else ""
        full = round(BAR * min(1.0, self.done / self.planned))
        text = f"{self.done} of {self.planned} points"
        if self.left_s is not None and self.phase not in (FAULT, STOPPED, DONE):
            text += f", {left_words(self.left_s)} left"
        return f"`{'█' * full}{'░' * (BAR - full)}` {text}"


def left_words(seconds: float) -> str:
    """A time left in words, as coarse as it is known."""
    if seconds < 55.0:
        return f"about {max(5, 5 * round(seconds / 5)):.0f} s"
    if seconds < 3570.0:
        return f"about {round(seconds / 60):.0f} min"
    minutes = round(seconds / 600) * 10
    return f"about {minutes // 60} h {minutes % 60:02d} min"


def problem_and_remedy(reason: str) -> tuple[str, str]:
    """The two parts of a sentence that ends with its remedy in parentheses."""
    depth = 0
    for k in range(len(reason) - 1, -1, -1):
        depth += {")": 1, "(": -1}.get(reason[k], 0)
        if depth == 0:
            break
    if not reason.endswith(")") or reason[k - 1 : k + 1] != " (":
        return reason, ""
    return reason[: k - 1], reason[k + 1 : -1]
