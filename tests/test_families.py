"""Every kind of device end to end against its emulator: clean, in real time, and with faults.

Tests of single drivers are in the files of their devices; here the shipped rigs run the shipped
protocols, and what is stored is compared with the true state of the bench.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench_process import bench_process, check_ended_well, run_pamrig, starved, worst_late_ms
from daq.store.run import open_run
from family_runs import pulls, run_file, sound, told
from rigs.execution.runner import Runner
from rigs.rigfile.config import load_rig
from rigs.virtual.bench import VirtualBench

pytestmark = pytest.mark.campaign
SERIAL = ("virtual-alicat", "virtual-itv", "virtual-vppm", "virtual-laser", "virtual-transducer",
          "virtual-marlin", "virtual-zaber", "virtual-tmcl", "virtual-instruments")  # fmt: skip
CARDS = ("virtual-labjack", "virtual-ni")
RIGS = (*SERIAL, *CARDS)
PROTOCOLS = ("isometric", "hysteresis")
FAR = 4.0
"""Standard uncertainties. Sensors err as their calibrations allow, once for a whole run; a value
from a damaged reading is off by many more."""
FULL = bool(os.environ.get("PAMRIG_FULL_SIZE"))
ATTEMPTS = 3


def check_values(found: dict[str, list[float]]) -> None:
    assert found["pressure_kpa"]
    worst = {name: max(map(abs, values), default=0.0) for name, values in found.items()}
    assert max(worst.values()) < FAR, worst


@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize("rig", RIGS)
def test_on_the_virtual_clock(rig: str, protocol: str, tmp_path: Path) -> None:
    """The short protocol, or with PAMRIG_FULL_SIZE the one that `pamrig PROTOCOL` runs."""
    file = protocol if FULL else f"{protocol}-short"
    result, run, truth = run_file(load_rig(rig), protocol, file, tmp_path)
    assert result.outcome == "clean", result.error
    sound(run)
    assert all(e["settled"] for e in run.events if e["kind"] == "point")
    check_values(pulls(run, truth.between))


@pytest.mark.realtime
@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize("rig", RIGS)
def test_in_real_time_over_ports(rig: str, protocol: str, tmp_path: Path) -> None:
    """`pamrig virtual` and the command of the test, two processes with ports between them."""
    for attempt in range(ATTEMPTS):
        place = tmp_path / str(attempt)
        words = ("--protocol", f"{protocol}-short", "--json", "--out", place / "runs")
        with bench_process(place / "bench", rig) as bench:
            done = run_pamrig(protocol, "--rig", bench.rig, *words)
            late_ms = worst_late_ms(bench.stop())
            truth = bench.truth()
        if not starved(done.returncode, done.stdout + done.stderr, late_ms):
            break
        check_ended_well(place / "runs")
    else:
        pytest.skip("this computer is too busy for a bench in real time")
    assert done.returncode == 0, done.stdout + done.stderr
    (folder,) = (path for path in (place / "runs").iterdir() if path.is_dir())
    run = open_run(folder)
    assert run.outcome == "clean"
    sound(run)
    check_values(pulls(run, told(truth)))


# ---- faults -----------------------------------------------------------------------------


Harm = Callable[[VirtualBench], None]


def wire(device: str, *faults: str) -> Harm:
    """The next messages of a device suffer these."""

    def harm(bench: VirtualBench) -> None:
        emulator: Any = bench.stage if device == "stage" else bench.extras.devices[device]
        emulator.wire.arrange(*faults)

    return harm


def flag(device: str, word: str = "overload") -> Harm:
    def harm(bench: VirtualBench) -> None:
        emulator: Any = bench.extras.devices[device]
        if device == "pressure_source":
            emulator.codes = ["POV"]
        else:
            emulator.flag = word

    return harm


def unplug(device: str) -> Harm:
    return lambda bench: bench.unplug(device)


def card(change: Callable[[Any], None]) -> Harm:
    return lambda bench: change(bench.extras.card)


def _skip(emulator: Any) -> None:
    emulator.skip = 3


def _gone(emulator: Any) -> None:
    emulator.gone = True


def _over(terminal: str) -> Callable[[Any], None]:
    def change(emulator: Any) -> None:
        emulator._read[terminal] = lambda: 12.0

    return change


SOURCES = {"virtual-alicat": "pressure_source", "virtual-itv": "pressure_source",
           "virtual-laser": "laser", "virtual-transducer": "pressure_transmitter",
           "virtual-instruments": "load_cell"}  # fmt: skip
STAGES = ("virtual-marlin", "virtual-zaber", "virtual-tmcl")
Case = tuple[str, str, str, Harm]


def cases() -> list[Case]:
    """(rig, device, fault, how) of every family, and of the stages while they move."""
    out: list[Case] = []
    for rig, device in (*SOURCES.items(), *((rig, "stage") for rig in STAGES)):
        out += [(rig, device, kind, wire(device, kind)) for kind in ("half", "stale")]
        out.append((rig, device, "unplug", unplug(device)))
        if device not in ("stage",) and rig != "virtual-itv":
            out.append((rig, device, "overload", flag(device)))
    for rig, terminal in zip(CARDS, ("AIN1", "ai1"), strict=True):
        if rig == "virtual-labjack":  # the other package raises an error where it loses scans
            out.append((rig, "transducer", "lost scans", card(_skip)))
        out += [(rig, "transducer", "unplug", card(_gone)),
                (rig, "cell", "overload", card(_over(terminal)))]  # fmt: skip
    return out


CASES = cases()


@pytest.mark.parametrize(
    ("rig", "device", "fault", "harm"), CASES, ids=[f"{r}-{f}" for r, _, f, _ in CASES]
)
def test_a_fault_is_counted_and_no_value_is_wrong(
    rig: str, device: str, fault: str, harm: Harm, tmp_path: Path
) -> None:
    """It begins at the second point, or for a stage while it moves to the length of the test."""

    def begin(runner: Runner, bench: VirtualBench) -> None:
        seen: list[Any] = []

        def point(*_: Any) -> None:
            seen.append(0)
            if len(seen) == 2:
                harm(bench)

        def set_point(channel: str, value: float) -> None:
            del value
            if channel == "length" and not seen:
                seen.append(0)
                harm(bench)

        if device == "stage":
            runner.watch.set_point = set_point
        else:
            runner.watch.point = point

    result, run, truth = run_file(load_rig(rig), "isometric", "isometric-short", tmp_path, begin)
    counters = sound(run)[device]
    wrong = {k: n for k, n in counters.items() if k not in ("rows", "lines", "telegrams") and n}
    # A stage's answer that comes twice says the same twice; what counts is where the stage is.
    assert wrong or (device, fault) == ("stage", "stale"), counters
    if fault in ("half", "stale", "lost scans"):  # one message each: asked again
        assert result.outcome == "clean", result.error
    if fault == "unplug" and rig != "virtual-instruments":
        assert result.outcome == "faulted"
        assert truth.bench.plant.pressure_kpa < 10.0
    if [e for e in run.events if e["kind"] == "point"]:
        check_values(pulls(run, truth.between))
    assert np.isfinite(truth.rows[-1]).all()
