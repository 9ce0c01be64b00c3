"""One run of a protocol with faults put upon it, and what only the simulation knows about it."""

from __future__ import annotations

import contextlib
import functools
import math
import os
import pickle
import random
import signal
import zlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

import rigs.virtual.bench as bench_module
from daq.clock import VirtualClock
from daq.errors import PamrigError
from plant.constants import GAS_CONSTANT_J_KG_K
from plant.physics.layout import MASS, MASS_OUT
from rigs.execution.runner import Runner
from rigs.execution.session import run_protocol
from rigs.protocols.registry import procedure
from rigs.rigfile.config import load_rig
from rigs.steps.schedule import outline
from rigs.virtual.board.board import SimBoard

from . import kinds
from .disk import FaultyDisk
from .kinds import Bug, Fault
from .places import lay_out
from .wires import Rule, Wires

AFTER_S = 3.0
"""How long the bench goes on without a host."""
LOOK_S = 0.02
SECONDS = {"isometric": 10.5, "isobaric": 7.8, "isotonic": 24.0, "isothermal": 12.5,
           "hysteresis": 11.5, "switching-time": 9.2, "switching-voltage": 16.0, "flow": 9.4,
           "step": 5.6, "ram": 8.0}  # fmt: skip
BENCH_SEEDS = 40


@dataclass
class Truth:
    """What the simulation knows of a run; everything in it is the bench's, not the host's.

    Attributes:
        us, kpa: true pressure, each millisecond (bench time).
        vents: (bench us, whether the outlet is told to stay open and the inlet shut), at changes.
        latched: what the controller vented for by itself, up to the host's end.
        prox: (bench us, proximity bits), at changes.
        beats: (bench us, armed) of every heartbeat that reached the controller whole.
        track: rows of (bench us, length mm, pull N, hung mass kg, way of the air m), each 20 ms.
        frames: (number, CRC-32 of its JPEG, true length in mm when it was exposed) of every
            picture that the record took.
        events: (number, kind) of every event that the record took before its disk failed.
        taken, first_row: rows of each stream that the record took, by column, from this one on.
        start_ns, origin_ns, rate: zero of the record's times, of bench time, and how much
            faster the host's clock is, to turn an event's time into bench time.
        noise_kpa: standard deviation of a pressure reading.
        armed: (bench us, armed), at changes; as it was when the clock was next looked at.
        closed_us, done_us: when the record was closed, and when the host was done.
        end_kpa: true pressure 3 s after that.
    """

    protocol: str
    seed: int
    faults: list[Fault]
    start0_us: int = 0
    trip_kpa: float = 0.0
    us: Any = None
    kpa: Any = None
    vents: list[tuple[int, bool]] = field(default_factory=list)
    armed: list[tuple[int, bool]] = field(default_factory=list)
    prox: list[tuple[int, int]] = field(default_factory=list)
    beats: list[tuple[int, bool]] = field(default_factory=list)
    track: list[tuple[int, float, float, float, float]] = field(default_factory=list)
    frames: list[tuple[int, int, float]] = field(default_factory=list)
    events: list[tuple[int, str]] = field(default_factory=list)
    start_ns: int = 0
    origin_ns: int = 0
    rate: float = 1.0
    noise_kpa: float = 0.0
    taken: dict[str, Any] = field(default_factory=dict)
    first_row: dict[str, int] = field(default_factory=dict)
    end_kpa: float = 0.0
    sealed_in: bool = False
    """The inlet stays open or the outlet shut, so that the air cannot go;"""
    sealed_us: int = 0
    """and when that was last so."""
    latched: list[str] = field(default_factory=list)
    done_us: int = 0
    closed_us: int = 0
    outcome: str = ""
    error: str = ""
    crashed: str = ""
    folder: str = ""
    planned: int = 0
    killed: bool = False

    def bench_us(self, t_ns: int) -> float:
        """Bench time of an event's ``t_ns``."""
        return (self.start_ns + t_ns - self.origin_ns) / self.rate * 1e-3


class Trial:
    """Puts faults upon one run and watches the bench meanwhile."""

    def __init__(self, protocol: str, seed: int, work: Path, faults: list[Fault]) -> None:
        self.truth = Truth(protocol, seed, faults)
        self.rng = random.Random(f"{protocol}/{seed}/places")
        self.files = lay_out(work / "files")[protocol]
        self.root = work / "runs" / f"{protocol}-{seed}"
        self.disk = FaultyDisk(self.rng)
        self.disk.stall, self.disk.die = self._stall, self.die
        self.disk.now_s = lambda: self.bench.board.bench_us * 1e-6
        self.rules: dict[int, Any] = {}
        self.camera_fault: Fault | None = None
        self.hang_s = 0.0
        self.shut: set[str] = set()
        self.delays: Any = None
        self.supply_kpa = 0.0
        self.bench: Any = None
        self.pipe = -1
        self._begun: list[Fault] = []
        self._waiting: list[Fault] = []
        self._last_frame: Any = None
        self._exposed_mm = math.nan
        self._truth_from = 0
        self._taken: dict[str, list[Any]] = {}

    # ---- the run --------------------------------------------------------------------

    def run(self) -> Truth:
        """The whole run and three seconds more."""
        truth = self.truth
        config = load_rig(str(self.files[0]), 1 + truth.seed % BENCH_SEEDS)
        kind = procedure(truth.protocol)
        plan = kind.read(str(self.files[1]), config)
        truth.trip_kpa = config.limits.trip_kpa
        truth.planned = outline(plan.steps(), config.stage.speed_mm_s)[0]
        assert config.virtual is not None
        truth.noise_kpa = config.virtual.pressure_noise_kpa
        with self._clocks(), self.disk.fitted():
            try:
                result = run_protocol(kind, config, plan, self.root, on_start=self._start)
                truth.outcome = result.outcome
                truth.error = str(result.error) if result.error else ""
            except PamrigError as error:  # what the command line prints
                truth.outcome, truth.error = "refused", str(error)
            except Bug as error:
                truth.outcome, truth.error = "aborted", repr(error)
            except Exception as error:  # a bare traceback is a finding of its own
                truth.outcome, truth.crashed = "crashed", f"{type(error).__name__}: {error}"
        self.finish()
        return truth

    @contextlib.contextmanager
    def _clocks(self) -> Any:
        """Faults of clocks are there from the start."""
        with contextlib.ExitStack() as stack:
            for fault in self.truth.faults:
                if fault.layer != "clock":
                    continue
                fault.hits, fault.begun_us = 1, 0
                if fault.kind == "drift":
                    drift = (fault.size - 0.5) * 600e-6
                    stack.enter_context(patch.object(bench_module, "DRIFT", drift))
                elif fault.kind == "device time wraps":
                    at_us = round((0.5 + fault.size * SECONDS[self.truth.protocol]) * 1e6)
                    self.truth.start0_us = 2**32 - at_us
                    board = functools.partial(SimBoard, start_ticks_us=2**32 - at_us)
                    stack.enter_context(patch.object(bench_module, "SimBoard", board))
                else:
                    stack.enter_context(
                        patch.object(
                            VirtualClock, "wall_ns", _jumping(VirtualClock.wall_ns, self.rng)
                        )
                    )
            yield

    def spoken(self) -> set[str]:
        """Devices whose readings this protocol needs, or that speak anyhow."""
        return {"valve", "balance", "stage", "supply", "thermometer", "flow", "load_cell"}

    def _start(self, runner: Runner, record: Any) -> None:
        rig = runner.rig
        assert rig.bench is not None
        self.bench = bench = rig.bench
        self.truth.folder = str(record.folder)
        self._clock = rig.clock
        bench.board._truth_every = bench.board._truth_left = 1
        self._truth_from = len(bench.board.truth_us)
        self.wires = Wires(bench, self.rng)
        self.wires.on_beat = lambda: self.truth.beats.append(
            (bench.board.bench_us, bool(bench.board.controller.safety.armed))
        )
        self.truth.start_ns, self.truth.origin_ns = record.start_ns, bench._origin_ns
        self.truth.rate = 1.0 + bench_module.DRIFT
        self._watch_valves()
        self._watch_record(record)
        self._watch_camera(rig)
        now_s = bench.board.bench_us * 1e-6
        self._waiting = [f for f in self.truth.faults if f.layer not in kinds.FROM_THE_START]
        for fault in self._waiting:
            kinds.place(fault, self.rng, SECONDS[self.truth.protocol])
            fault.start_s += now_s
            fault.end_s += now_s
        rig.event_loop.add(self._poll)
        rig.clock.on_advance(self._tick)  # type: ignore[attr-defined]

    def _watch_valves(self) -> None:
        board, vents = self.bench.board, self.truth.vents
        drive, let_go = board.drive, board._let_go

        def note() -> None:
            if not vents or vents[-1][1] != board._venting:
                vents.append((board.bench_us, board._venting))

        def watched(inlet_us: int, vent_us: int) -> None:
            drive(inlet_us, vent_us)
            note()
            if "inlet" in self.shut:
                board._inlet_us = 0
            if "outlet" in self.shut:
                board._vent_us = 0

        def released() -> None:
            let_go()
            note()

        def fed() -> None:
            if board.prox_bits != (self.truth.prox[-1][1] if self.truth.prox else 0):
                self.truth.prox.append((board.bench_us, board.prox_bits))

        board.drive, board._let_go, board.wdt_feed = watched, released, fed
        note()

    def _watch_record(self, record: Any) -> None:
        """Keep what the record took, as it was handed over."""
        taken, truth = self._taken, self.truth
        append, frame, event = record.append, record.frame, record.event
        finalize = record.finalize

        def watched(stream: str, columns: Any) -> int:
            open_yet = not record._closed  # a device still talks while the bench is being closed
            row: int = append(stream, columns)
            if open_yet:
                truth.first_row.setdefault(stream, row)
                kept = {k: np.array(v) for k, v in columns.items()}
                taken.setdefault(stream, []).append(kept)
            return row

        def pictured(jpeg: bytes, host_ns: int, **meta: Any) -> int:
            number: int = frame(jpeg, host_ns, **meta)
            truth.frames.append((number, zlib.crc32(jpeg), self._exposed_mm))
            return number

        def noted(kind: str, **fields: Any) -> int:
            number: int = event(kind, **fields)
            if record.failed is None and not record._closed:
                truth.events.append((number, kind))
            return number

        def closed(outcome: str, **summary: Any) -> Any:
            self._closed()
            return finalize(outcome, **summary)

        record.append, record.frame, record.event = watched, pictured, noted
        record.finalize = closed

    def _watch_camera(self, rig: Any) -> None:
        camera = rig.camera._camera
        if not hasattr(camera, "_expose"):
            return
        real = camera._expose

        def expose() -> Any:
            self._exposed_mm = self.bench.plant.length_mm
            frame = real()
            if self.camera_fault is not None:
                try:
                    frame = kinds.spoil_frame(self, self.camera_fault, frame, self._last_frame)
                except PamrigError:
                    self._clock.sleep(2.0)
                    raise
            self._last_frame = frame
            return frame

        camera._expose = expose

    # ---- while it runs --------------------------------------------------------------

    def _tick(self, until_ns: int) -> None:
        del until_ns
        bench = self.bench
        now_us = bench.board.bench_us
        plant = bench.plant
        hung_kg = float(plant.params[MASS]) if plant.load == "isotonic" else 0.0
        self.truth.track.append(
            (now_us, plant.length_mm, bench._lift_n(), hung_kg, self._blown_m())
        )
        armed = bool(bench.board.controller.safety.armed)
        if armed != (bool(self.truth.armed) and self.truth.armed[-1][1]):
            self.truth.armed.append((now_us, armed))
        self.wires.advance()
        now_s = now_us * 1e-6
        self._look(now_us)
        for fault in [f for f in self._waiting if now_s >= f.start_s]:
            self._waiting.remove(fault)
            self._begun.append(fault)
            kinds.begin(self, fault)
        for fault in self._begun:
            if fault.first_us < 0 and kinds.acted(self, fault):
                fault.first_us = now_us

    def _look(self, now_us: int) -> None:
        """End the faults whose time is over."""
        if self._sealed:
            self.truth.sealed_us = now_us
        for fault in [f for f in self._begun if now_us * 1e-6 >= f.end_s]:
            self._begun.remove(fault)
            self._count(fault)
            kinds.undo(self, fault)
            fault.ended_us = now_us  # later than it was to be, where the program hung

    @property
    def _sealed(self) -> bool:
        """Whether the air cannot go: it is fed, the outlet is shut, or nobody gives it voltage."""
        supply = self.bench.extras.devices.get("supply")
        return (
            self.bench.board.inlet_jammed
            or "outlet" in self.shut
            or (self.truth.killed and supply is not None and not supply.is_on)
        )

    def _count(self, fault: Fault) -> None:
        """What it did up to now; of what comes after the record's end nobody could tell."""
        if not self.truth.closed_us:
            kinds.count(self, fault)

    def _closed(self) -> None:
        for fault in self._begun:
            self._count(fault)
        self.truth.closed_us = self.truth.closed_us or self.bench.board.bench_us

    def _blown_m(self) -> float:
        """How far the air in the outlet line has come; its velocity is the change of that."""
        meter = self.bench.config.instruments.text.get("flow")
        if meter is None:
            return 0.0
        constants = self.bench.plant.constants
        density = constants.atmosphere_pa / (GAS_CONSTANT_J_KG_K * constants.gas_temperature_k)
        area_m2 = math.pi / 4 * (meter.bore_mm * 1e-3) ** 2
        return float(self.bench.plant.state[MASS_OUT]) / (density * area_m2)

    def _poll(self) -> None:
        if self.hang_s:
            seconds, self.hang_s = self.hang_s, 0.0
            self._stall(seconds)

    def _stall(self, seconds: float) -> None:
        """The program stands still; the bench does not."""
        if self.bench is None:
            return
        end_ns = self._clock.now_ns() + round(seconds * 1e9)
        while (left_ns := end_ns - self._clock.now_ns()) > 0:  # looked at as often as otherwise
            self._clock.sleep(min(LOOK_S, left_ns * 1e-9))

    def die(self) -> None:
        """SIGKILL, now; a copy of the process lets the bench go on by itself and tells of it."""
        if os.fork():
            os.kill(os.getpid(), signal.SIGKILL)
        self.truth.killed = True
        self.truth.outcome = "killed"
        self.finish()
        with os.fdopen(self.pipe, "wb") as out:
            pickle.dump(self.truth, out)
        os._exit(0)

    def finish(self) -> None:
        """Three seconds without a host; then all that is known is put together."""
        truth = self.truth
        if self.bench is None:
            return
        board = self.bench.board
        truth.done_us = board.bench_us
        self._closed()
        truth.latched = [str(cause) for cause in board.controller.safety.faults]
        self._waiting.clear()
        self.hang_s = 0.0
        now_ns = self._clock.now_ns()
        for look in range(1, round(AFTER_S / LOOK_S) + 1):  # faults may end in it
            if truth.killed:  # inside the clock's own round: the bench is turned by hand
                self.bench.advance_to(now_ns + round(look * LOOK_S * 1e9))
                self._look(board.bench_us)
            else:
                self._clock.sleep(LOOK_S)
        truth.sealed_in = self._sealed
        for fault in self._begun:
            kinds.undo(self, fault)
        truth.end_kpa = board.pressure_kpa
        truth.us = np.array(board.truth_us[self._truth_from :])
        truth.kpa = np.array(board.truth_kpa[self._truth_from :])
        for stream, batches in self._taken.items():
            truth.taken[stream] = (
                {k: np.concatenate([b[k] for b in batches]) for k in batches[0]} if batches else {}
            )


def _jumping(real: Any, rng: random.Random) -> Any:
    """A wall clock that somebody sets to and fro, by up to 400 days."""
    span_ns = 400 * 86_400_000_000_000
    return lambda clock: real(clock) + rng.randrange(-span_ns, span_ns)


def run_trial(protocol: str, seed: int, work: Path, faults: list[Fault]) -> Truth:
    """One run with faults; in a process of its own where it is to be killed."""
    trial = Trial(protocol, seed, work, faults)
    if not any(f.kind.startswith("killed") for f in faults):
        return trial.run()
    read, trial.pipe = os.pipe()
    child = os.fork()
    if not child:
        os.close(read)
        try:
            truth = trial.run()
            with os.fdopen(trial.pipe, "wb") as out:
                pickle.dump(truth, out)
        finally:
            os._exit(0)
    os.close(trial.pipe)
    with os.fdopen(read, "rb") as file:
        data = file.read()
    os.waitpid(child, 0)
    truth = pickle.loads(data)
    assert isinstance(truth, Truth)
    return truth


__all__ = ["Rule", "Trial", "Truth", "run_trial"]
