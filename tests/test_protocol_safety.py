"""A hung load is lowered, a leak is found, and no interruption loses or doubles a trial."""

from __future__ import annotations

import contextlib
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from analysis.figures.wording import fixed
from analysis.reduction.pictures import measure_stored
from analysis.reporting.page_one import conditions_text
from bench_process import LIMIT_S, STARVED_MS, run_in_real_time
from daq.interrupt import StopFlag
from daq.store.run import open_run
from daq.store.verify import verify
from plant.physics.layout import PRESSURE
from protocol_runs import events, run_short
from rigs.execution.control import RunControl
from rigs.execution.runner import Runner, Watch
from rigs.protocols.names import PROTOCOLS
from rigs.protocols.registry import procedure
from rigs.steps.leak_check import LeakCheck
from vision.marker.coarse import _bands

STATIC = ("isometric", "isobaric", "isotonic", "isothermal", "hysteresis")
SHORT_S = 15.0
FULL = bool(os.environ.get("PAMRIG_CAMPAIGN"))


class Fall:
    """Fastest descent of the load, in mm/s, by the plant itself."""

    def __init__(self, runner: Runner) -> None:
        self._plant = runner.rig.bench.plant  # type: ignore[union-attr]
        self._clock = runner.rig.clock
        self._last = (self._clock.now_ns(), self._plant.length_mm)
        self.fastest_mm_s = 0.0
        runner.rig.event_loop.add(self._look)

    def _look(self) -> None:
        now = (self._clock.now_ns(), self._plant.length_mm)
        if now[0] - self._last[0] >= 20_000_000:
            speed = (now[1] - self._last[1]) / ((now[0] - self._last[0]) * 1e-9)
            self.fastest_mm_s = max(self.fastest_mm_s, speed)
            self._last = now


def isotonic_ended_by(root: Path, end: Any) -> tuple[Any, Fall]:
    falls: list[Fall] = []
    runners: list[Runner] = []
    stop = StopFlag()
    seen = [0]

    def point(*_: Any) -> None:
        seen[0] += 1
        if seen[0] == 2:
            falls.append(Fall(runners[0]))
            end(stop, runners[0])

    result, run, bench = run_short(
        "isotonic", root, rig="virtual-thesis", masses_kg=(1.5,), pressures_kpa=(300.0, 600.0),
        begin=runners.append, how={"stop": stop, "watch": Watch(point=point)},
    )  # fmt: skip
    assert bench.plant.pressure_kpa < 10.0
    assert verify(run) == []
    del result
    return run, falls[0]


def test_a_stopped_isotonic_test_lowers_its_load(tmp_path: Path) -> None:
    run, fall = isotonic_ended_by(tmp_path / "a", lambda stop, _: stop.set("SIGINT"))
    assert run.outcome == "stopped"
    (lowered,) = events(run, "lowered")
    assert lowered["done"]
    assert lowered["load_kg"] == 1.5
    assert lowered["from_kpa"] == pytest.approx(600.0, abs=5.0)
    # Where nothing lowers it, a load goes down as fast as the outlet lets it.
    _, dropped = isotonic_ended_by(
        tmp_path / "b", lambda _, runner: setattr(runner.rig.bench.board, "sensor_override", 4000)
    )
    print(f"\nlowered at {fall.fastest_mm_s:.0f} mm/s, vented at {dropped.fastest_mm_s:.0f} mm/s")
    assert fall.fastest_mm_s < 0.5 * dropped.fastest_mm_s


def test_after_a_fault_the_record_says_that_the_load_was_not_lowered(tmp_path: Path) -> None:
    run, _ = isotonic_ended_by(
        tmp_path, lambda _, runner: setattr(runner.rig.bench.board, "sensor_override", 4000)
    )
    assert run.outcome == "faulted"
    assert [e["done"] for e in events(run, "lowered")] == [False]


def leaky(kpa_s: float) -> Any:
    """A hole: the muscle loses air all the time."""

    def begin(runner: Runner) -> None:
        clock, state = runner.rig.clock, runner.rig.bench.plant.state  # type: ignore[union-attr]
        last = [clock.now_ns()]

        def lose() -> None:
            step_s = (clock.now_ns() - last[0]) * 1e-9
            last[0] = clock.now_ns()
            state[PRESSURE] = max(0.0, state[PRESSURE] - kpa_s * 1e3 * step_s)

        runner.rig.event_loop.add(lose)

    return begin


@pytest.mark.parametrize(
    ("kpa_s", "outcome"), [(0.0, "clean"), (0.3, "clean"), (3.0, "faulted"), (-3.0, "faulted")]
)
def test_a_leak_is_found_before_the_test(tmp_path: Path, kpa_s: float, outcome: str) -> None:
    check = {"leak": LeakCheck(300.0, 3.0, 1.0)}
    result, run, _ = run_short(
        "isobaric", tmp_path, method=check, begin=leaky(kpa_s), lengths_mm=(60.0,)
    )
    assert result.outcome == outcome, result.error
    (leak,) = events(run, "leak")
    assert leak["loss_kpa_s"] == pytest.approx(kpa_s, abs=0.1)
    assert leak["tight"] == (outcome == "clean")
    shown = f"loss in the leak check {fixed(leak['loss_kpa_s'], 3)} kPa/s"
    assert shown in conditions_text(run), "a rise is a negative loss"
    if outcome == "faulted":
        way, where = ("fell", "fittings") if kpa_s > 0 else ("rose", "inlet")
        assert f"{way} by {abs(leak['loss_kpa_s']):.3f} kPa/s" in str(result.error)
        assert where in str(result.error)
        assert not events(run, "point")


class Broken(Exception):
    """The program broke off."""


class Meddler:
    """Asks for things at random moments of a test, and may end it."""

    def __init__(self, seed: int, horizon_s: float) -> None:
        rng = random.Random(seed)
        self.control, self.stop = RunControl(), StopFlag()
        moments = sorted(rng.uniform(0.0, horizon_s) for _ in range(rng.randint(1, 5)))
        words = ["pause", "skip", "repeat", "mark x", "p"]
        self._plan = [(t, rng.choice(words)) for t in moments]
        end_s = rng.uniform(0.0, 1.3 * horizon_s)
        self._end = (end_s, rng.choice(["stop", "signal", "crash", "fault"]))
        self.ended = ""

    def begin(self, runner: Runner) -> None:
        clock = runner.rig.clock
        start_ns = clock.now_ns()
        resume: list[float] = []

        def meddle() -> None:
            now_s = (clock.now_ns() - start_ns) * 1e-9
            while self._plan and now_s >= self._plan[0][0]:
                self.control.request(self._plan.pop(0)[1])
                resume.append(now_s + 2.0)
            if resume and now_s >= resume[0]:
                resume.clear()
                self.control.request("resume")
            if not self.ended and now_s >= self._end[0]:
                self.ended = self._end[1]
                if self.ended == "stop":
                    self.control.request("stop")
                elif self.ended == "signal":
                    self.stop.set("SIGTERM")
                elif self.ended == "crash":
                    raise Broken
                else:
                    runner.rig.bench.board.sensor_override = 4000  # type: ignore[union-attr]

        runner.rig.event_loop.add(meddle)


@pytest.mark.parametrize("seed", range(75 if FULL else 5))
def test_no_interruption_loses_or_doubles_a_trial(tmp_path: Path, seed: int) -> None:
    name = STATIC[seed % len(STATIC)]
    meddler = Meddler(seed, horizon_s=14.0)
    how = {"control": meddler.control, "stop": meddler.stop}
    with contextlib.suppress(Broken):
        run_short(name, tmp_path, begin=meddler.begin, how=how, seed=seed)
    (folder,) = (p for p in tmp_path.iterdir() if p.is_dir())
    run = open_run(folder)
    expected = {"": {"clean"}, "stop": {"stopped"}, "signal": {"stopped"},
                "crash": {"aborted"}, "fault": {"faulted", "clean"}}  # fmt: skip
    assert run.outcome in expected[meddler.ended] | {"clean"}
    check_whole(run, name)
    assert events(run, "vented") or events(run, "vent_unconfirmed")


def check_whole(run: Any, name: str) -> None:
    """Sound to the byte; every point of the table once, in a trial that began, none invented."""
    assert all(problem.tail for problem in verify(run)), verify(run)
    table = procedure(name).analysis.reduce(run).table
    assert table["order"].is_unique
    begun = [e["trial"] for e in events(run, "trial") if e["phase"] == "begin"]
    ended = [e["trial"] for e in events(run, "trial") if e["phase"] == "end"]
    assert len(begun) == len(set(begun))
    assert len(ended) == len(set(ended))
    assert set(ended) <= set(begun)
    assert set(table["trial"]) <= set(begun)
    skipped = {e.get("order") for e in events(run, "skipped")}
    made = {e["order"] for e in events(run, "point")}
    assert set(table["order"]) == made
    if run.outcome == "clean":
        assert sorted(made | skipped) == list(range(1, len(made | skipped) + 1))


@pytest.mark.campaign
@pytest.mark.parametrize("seed", range(25))
def test_a_killed_program_leaves_a_readable_record(tmp_path: Path, seed: int) -> None:
    name = STATIC[seed % len(STATIC)]
    client = subprocess.Popen(
        [sys.executable, "-m", "cli.main", name, "--out", str(tmp_path / "runs")],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    end = time.monotonic() + 60
    while not any(
        b'"kind"' in path.read_bytes() for path in (tmp_path / "runs").glob("*/events.jsonl")
    ):
        assert time.monotonic() < end
        time.sleep(0.05)
    time.sleep(float(np.random.default_rng(seed).uniform(0.0, 8.0)))
    client.send_signal(signal.SIGKILL)
    client.wait()
    (folder,) = (p for p in (tmp_path / "runs").iterdir() if p.is_dir())
    run = open_run(folder)
    assert run.outcome in ("interrupted", "clean")
    check_whole(run, name)


def in_real_time(root: Path, name: str, protocol: str, longest_s: float) -> None:
    """A template over pseudo-terminals: the same drivers, bytes and record."""
    from rigs.protocols.names import default_rig

    start = time.monotonic()
    real = run_in_real_time(
        root, default_rig(name), name, "--protocol", protocol, limit_s=LIMIT_S + longest_s
    )
    wall_s = time.monotonic() - start
    run = open_run(real.folder)
    assert run.final is not None
    assert not events(run, "fault")
    (armed,), (vented,) = events(run, "armed"), events(run, "vented")
    test_s = (vented["t_ns"] - armed["t_ns"]) * 1e-9
    print(
        f"\n{name}: {test_s:.1f} s armed to vented, {run.final['duration_s']:.1f} s of record"
        f" (camera looked at first), {wall_s:.1f} s with start and report"
    )
    assert run.outcome == "clean"
    if real.worst_late_ms < STARVED_MS:  # else it says nothing about the program
        assert test_s <= longest_s
    check_whole(run, name)


def test_a_frame_off_a_socket_compiles_nothing_anew() -> None:
    """It may not be written to, and is measured in mid-test: there is no time to compile."""
    gray = np.full((120, 640), 128, dtype=np.uint8)
    measure_stored(gray, {})
    compiled = len(_bands.signatures)
    gray.flags.writeable = False
    measure_stored(gray, {})
    assert len(_bands.signatures) == compiled


@pytest.mark.realtime
def test_a_load_is_hung_and_lifted_in_real_time(tmp_path: Path) -> None:
    """The person of `pamrig virtual` hangs it, through a socket."""
    in_real_time(tmp_path, "isotonic", "isotonic-short", SHORT_S)


@pytest.mark.realtime
@pytest.mark.parametrize("name", ["isobaric", "isothermal", "hysteresis"])
def test_every_short_template_runs_in_real_time(tmp_path: Path, name: str) -> None:
    in_real_time(tmp_path, name, f"{name}-short", SHORT_S)


HOURS = ("creep", "relaxation", "fatigue")
"""Their full templates take hours to days."""


@pytest.mark.campaign
@pytest.mark.parametrize("name", [name for name in PROTOCOLS if name not in HOURS])
def test_every_full_template_runs_in_real_time(tmp_path: Path, name: str) -> None:
    """About an hour and three quarters for all ten: 34 s (ram) to 21 min (hysteresis) each."""
    in_real_time(tmp_path, name, name, 3600.0)
