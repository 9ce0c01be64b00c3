"""One recording of a controller of one's own: its lines, its set-points, and how it ends."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from analysis.findings.own_controller.recording import write_recording
from daq.clock import Clock, RealClock, VirtualClock
from daq.errors import DeviceError, DeviceTimeout, LinkLost, PamrigError
from daq.link.transport import Link, SerialLink, memory_pair
from daq.record.writer import RecordWriter
from daq.store.rowtimes import Times, line_s, recorded_rows
from daq.store.run import open_run
from rigs.devices.event_loop import EventLoop
from rigs.recording.stream import ColumnStream
from rigs.rigfile.columns import TIME_S, ColumnForm
from rigs.rigfile.config import VIRTUAL

NO_CONTRACT = (
    "No safety contract: as far as this program knows, this controller does not vent by itself "
    "when the program, the computer or the cable fails. Stay at the bench. Have a valve within "
    "reach that vents by hand, and a relief valve below what the muscle can bear."
)
STALE_S = 2.0
REPEAT_S = 0.5
"""A set-point is sent again so often: a sketch may let the air out when it hears nothing."""
NEAR_KPA = 0.5
TOLD = 20
"""So many faults of a kind become events of their own; all are counted."""
CONFIRM_S = 1.0
VENT_TRIES = 3
PERIOD_S = 0.005


@dataclass(frozen=True)
class Recorded:
    """What became of a recording.

    Attributes:
        folder: of the run.
        outcome: clean, stopped or faulted.
        reason: of the end, where it was not clean.
        rows: whole lines.
        faults: everything else, by kind.
        times: of the rows.
        vented: whether the set-point 0 was sent at the end (None: it cannot be set).
    """

    folder: Path
    outcome: str
    reason: str
    rows: int
    faults: dict[str, int]
    times: Times
    vented: bool | None


def open_link(form: ColumnForm, clock: Clock, stack: ExitStack) -> Link:
    """The port of the controller; "virtual" makes an emulated one on the virtual clock."""
    if form.port != VIRTUAL:
        link = SerialLink(form.port, form.baud, clock)
        stack.callback(link.close)
        return link
    from rigs.virtual.emulators.columns import join_columns

    assert isinstance(clock, VirtualClock)
    host, end = memory_pair(clock, "recorder")
    join_columns(form, end, clock)
    return host


class Recording:
    """Reads one controller for a while, and sets it where it can be set.

    Args:
        form: the description of the controller.
        link: bytes to and from it.
        clock: time.
        out: folder of runs.
    """

    def __init__(self, form: ColumnForm, link: Link, clock: Clock, out: Path) -> None:
        self._form = form
        self._clock = clock
        self._loop = EventLoop(clock, PERIOD_S)
        self._stream = ColumnStream(link, form)
        self._loop.add(self._stream.poll)
        self._loop.add(self._take)
        self._rows = 0
        self._newest: tuple[float, ...] = ()
        self._last_ns = clock.now_ns()
        self._level_kpa: float | None = None
        self._sent_ns = 0
        manifest = {
            "protocol": "record", "specimen": "muscle", "recorder": form.name,
            "columns": list(form.columns), "description": form.source,
            "calibrations": {k: c.to_dict() for k, c in form.calibrations.items()},
            "safety": NO_CONTRACT, "parameters": {"channels": list(form.channels)},
            "timing": {
                "tick_s": TIME_S[form.time_unit] if form.time_unit != "s" else 1e-3,
                "wire_s": line_s(8.0 * len(form.columns), form.baud),
                "latency_s": form.latency_ms * 1e-3,
            },
        }  # fmt: skip
        self._record = RecordWriter(out, manifest, clock, threaded=not clock.virtual)
        schema = {"host_ns": "int64", "waited_ns": "int64", "own_s": "float64"}
        self._record.stream("columns", {**schema, **dict.fromkeys(form.channels, "float64")})
        self._stream.on_bytes = lambda host_ns, data: self._record.wire("recorder", host_ns, data)
        self._stream.faults.on_fault.append(self._tell)

    def run(
        self,
        seconds: float,
        levels_kpa: tuple[float, ...] = (),
        stopped: Callable[[], bool] = lambda: False,
    ) -> Recorded:
        """Record for so long, or hold each set-point for so long; 0 is set at the end in any case.

        Raises:
            DeviceError: a set-point above the limit, or a controller that cannot be set; nothing
                was sent.
        """
        self._check(levels_kpa)
        outcome, reason, vented = "clean", "", None
        try:
            try:
                self._wait(lambda: self._stream.count > 0, STALE_S, "no whole line")
                for level in levels_kpa or (None,):
                    if level is not None:
                        self._set(level)
                    self._loop.until(lambda: self._ends(stopped), seconds)
                    if stopped():
                        outcome, reason = "stopped", "by the operator"
                        break
            finally:
                if self._form.setpoint is not None and levels_kpa:
                    vented = self._vent()
        except KeyboardInterrupt:
            outcome, reason = "stopped", "by the operator"
        except PamrigError as error:
            outcome, reason = "faulted", str(error)
        return self._finish(outcome, reason, vented)

    def _tell(self, kind: str, words: str) -> None:
        if self._stream.faults.counts[kind] <= TOLD:
            self._record.event("fault", device="recorder", fault=kind, what=words)

    def _check(self, levels_kpa: tuple[float, ...]) -> None:
        setpoint = self._form.setpoint
        if levels_kpa and setpoint is None:
            raise DeviceError(self._form.source, "has no table [setpoint]", "leave --levels out")
        for level in levels_kpa:
            if setpoint is not None and not 0.0 <= level <= setpoint.high_kpa:
                raise DeviceError(
                    f"{self._form.source}: setpoint.high_kpa",
                    f"set-point {level:g} kPa is outside 0 to {setpoint.high_kpa:g} kPa",
                    "correct --levels or the limit",
                )

    def _take(self) -> None:
        rows, self._stream.rows = self._stream.rows, []
        if not rows:
            return
        self._last_ns = rows[-1][0]
        columns: dict[str, Any] = {
            "host_ns": np.array([row[0] for row in rows], dtype=np.int64),
            "waited_ns": np.array([row[1] for row in rows], dtype=np.int64),
            "own_s": np.array([row[2] for row in rows]),
        }
        for k, name in enumerate(self._form.channels):
            columns[name] = np.array([row[3][k] for row in rows])
        self._record.append("columns", columns)
        self._rows += len(rows)
        self._newest = rows[-1][3]

    def _ends(self, stopped: Callable[[], bool]) -> bool:
        """Whether the operator ends it.

        Raises:
            DeviceError: it restarted, fell silent, or the pressure is above the limit.
        """
        name = self._stream.name
        if self._stream.restarted:
            raise DeviceError(name, "restarted: its time began anew", "check its supply")
        if self._clock.now_ns() - self._last_ns > STALE_S * 1e9:
            raise DeviceTimeout(name, f"no whole line for {STALE_S:g} s", "check cable and sketch")
        if self._form.limit_kpa and self._newest and "pressure_kpa" in self._form.channels:
            raw = self._newest[self._form.channels.index("pressure_kpa")]
            kpa = float(self._form.calibrations["pressure_kpa"].apply(raw))
            if kpa > self._form.limit_kpa:
                raise DeviceError(
                    name, f"reads {kpa:.0f} kPa, above limit_kpa = {self._form.limit_kpa:g}", "vent"
                )
        self._repeat()
        return stopped()

    def _repeat(self) -> None:
        """Send the set-point again; a confirmation of another one ends the recording."""
        level, setpoint = self._level_kpa, self._form.setpoint
        if level is None or setpoint is None:
            return
        self._agrees(level, self._stream.confirmed())
        if self._clock.now_ns() - self._sent_ns > REPEAT_S * 1e9:
            self._sent_ns = self._clock.now_ns()
            self._stream.send(setpoint.command.format(value=level))

    def _agrees(self, level_kpa: float, confirmed_kpa: float | None) -> None:
        if confirmed_kpa is not None and abs(confirmed_kpa - level_kpa) > NEAR_KPA:
            raise DeviceError(
                self._stream.name,
                f"was sent {level_kpa:g} kPa and confirms {confirmed_kpa:g} kPa",
                "check the sketch",
            )

    def _wait(self, condition: Callable[[], bool], seconds: float, what: str) -> None:
        if not self._loop.until(condition, seconds):
            raise DeviceTimeout(
                self._stream.name, f"{what} within {seconds:g} s",
                self._stream.faults.last or "check port, baud, columns and delimiter",
            )  # fmt: skip

    def _set(self, level_kpa: float) -> None:
        setpoint = self._form.setpoint
        assert setpoint is not None
        self._stream.confirmed()
        self._stream.send(setpoint.command.format(value=level_kpa))
        self._level_kpa, self._sent_ns = level_kpa, self._clock.now_ns()
        self._record.event("command", device="recorder", pressure_kpa=level_kpa)
        if setpoint.confirm is None:
            return
        seen: list[float] = []

        def came() -> bool:
            value = self._stream.confirmed()
            if value is not None:
                seen.append(value)
            return bool(seen)

        self._wait(came, CONFIRM_S, f"set-point {level_kpa:g} kPa was not confirmed")
        self._agrees(level_kpa, seen[-1])

    def _vent(self) -> bool:
        """Send the set-point 0 until it is confirmed; whether it was sent (and confirmed)."""
        for _ in range(VENT_TRIES):
            try:
                self._set(0.0)
            except LinkLost:
                return False
            except PamrigError:
                continue
            return True
        return False

    def _finish(self, outcome: str, reason: str, vented: bool | None) -> Recorded:
        self._stream.finish()
        faults = dict(self._stream.faults.counts)
        self._record.finalize(
            outcome, reason=reason, counters={"recorder": {"rows": self._rows, **faults}},
            recording={"reason": reason, "vented": vented},
        )  # fmt: skip
        run = open_run(self._record.folder)
        derived = run.folder / "derived"
        derived.mkdir(exist_ok=True)
        write_recording(run, derived)
        return Recorded(
            run.folder, outcome, reason, self._rows, faults, recorded_rows(run).times, vented
        )


def record(
    form: ColumnForm,
    out: Path,
    seconds: float,
    levels_kpa: tuple[float, ...] = (),
    stopped: Callable[[], bool] = lambda: False,
) -> Recorded:
    """Open the controller's port, record, and close it again.

    Raises:
        PortError, DeviceError: before anything was recorded; later faults end the record.
    """
    clock: Clock = VirtualClock() if form.port == VIRTUAL else RealClock()
    with ExitStack() as stack:
        link = open_link(form, clock, stack)
        made = Recording(form, link, clock, out)
        return made.run(seconds, levels_kpa, stopped)
