"""The fatigue test: count kept over parts, bounded record, failure, drift, work and efficiency."""

from __future__ import annotations

import dataclasses
import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from analysis.findings.muscle.fatigue import fatigue_findings
from analysis.reduction.muscle.energy import Air, State, cycle_energy, gas_work, loop_work
from analysis.registry import analysis_of
from analysis.reporting.derived import derive_all
from analysis.reporting.report import render_report
from analysis.run_table import reduce_run
from cli.protocols.resume import continue_run
from daq.errors import ConfigError
from daq.interrupt import StopFlag
from daq.store.run import Run, open_run
from daq.store.verify import verify
from plant.constants import nominal
from plant.effects.effects import Effects
from plant.simulator.bench import BenchSim
from protocol_runs import events, force_n, run_short, with_virtual
from rigs.execution.runner import Runner
from rigs.execution.session import run_protocol
from rigs.protocols.muscle.fatigue import LeakCycles, done
from rigs.protocols.registry import procedure
from rigs.rigfile.config import load_rig
from rigs.rigfile.toml_reader import find_config
from rigs.steps.muscle.cycles import Kept, Limits

HOUSE = Path(__file__).resolve().parent.parent
NONE = Limits(0.0, 0.0, 0.0, 3)
KEEP = Kept(2, 2)
NEVER = (("reach_kpa = 50", "reach_kpa = 0"), ("drop_percent = 50", "drop_percent = 0"))
"""Changes of the file: nothing counts as a failure."""


def file_of(tmp_path: Path, *changes: tuple[str, str]) -> Path:
    text = find_config("fatigue-short", "protocols")[0]
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    path = tmp_path / "own.toml"
    path.write_text(text)
    return path


@pytest.fixture(scope="module")
def parts(tmp_path_factory: pytest.TempPathFactory) -> tuple[Run, Run]:
    """A test of 34 cycles that is stopped within cycle 21 and continued."""
    folder = tmp_path_factory.mktemp("fatigue")
    path = file_of(folder, ("cycles = 8", "cycles = 34"), ("rate_hz = 1", "rate_hz = 2"), *NEVER)
    config, kind = load_rig("virtual"), procedure("fatigue")
    stop = StopFlag()

    def begin(runner: Runner, record: object) -> None:
        del record
        runner.rig.event_loop.add(
            lambda: stop.set("SIGINT") if runner.progress.done == 20 else None
        )

    plan = kind.read(str(path), config)
    ended = run_protocol(kind, config, plan, folder / "runs", stop=stop, on_start=begin)
    assert ended.outcome == "stopped"
    first = open_run(ended.folder)
    more = continue_run(first)
    assert more.outcome == "clean", more.error
    return first, open_run(more.folder)


def test_every_cycle_is_counted_once_over_both_parts(parts: tuple[Run, Run]) -> None:
    first, second = parts
    assert done(first)["cycles"] == 20
    table = reduce_run(second).table
    assert list(table["order"]) == list(range(1, 35))
    assert table["trial"].nunique() == 2
    assert verify(first) == []
    assert verify(second) == []
    found = fatigue_findings(second, reduce_run(second))
    assert found.data["cycles"] == 34
    assert not found.data["failed"]
    page = render_report(second).partition('new-page">Figures<')[0]
    results = page.partition("<h2>Results: first and last cycles</h2>")[2]
    assert "force range" in results.partition("</table>")[0], "page one has a table of results"


def test_only_named_cycles_are_kept_at_full_rate(parts: tuple[Run, Run]) -> None:
    first, _ = parts
    cycles, valve = first.samples("cycles"), first.samples("valve")
    share = {}
    for k, n in enumerate(cycles["cycle"]):
        low, high = cycles["valve_first"][k], cycles["valve_end"][k]
        have = ((valve["seq"] >= low) & (valve["seq"] < high)).sum()
        share[int(n)] = have / (high - low)
    # At the start, from 10 on, and the last two; a batch of 50 ms may belong to its neighbour.
    for n in (1, 2, 10, 11, 20):
        assert share[n] > 0.85, share
    assert all(share[n] < 0.2 for n in (4, 5, 6, 7, 8, 13, 14, 15, 16, 17)), share
    assert [e["whole"] for e in events(first, "kept")][:1] == [False]
    assert len(first.events) < 60


def test_the_record_of_a_cycle_that_is_not_kept_is_small(parts: tuple[Run, Run]) -> None:
    first, _ = parts
    index = (first.folder / "samples" / "cycles.index.jsonl").stat().st_size
    rows = sum(p.stat().st_size for p in (first.folder / "samples" / "cycles").iterdir())
    assert (index + rows) / 20 < 2000
    kept = Kept(20, 20)
    assert kept.count(10**7) < 250
    assert [n for n in range(1, 200) if kept.whole(n, 1)] == [*range(1, 30), *range(100, 120)]


def test_force_at_the_high_pressure_is_that_of_the_plant(tmp_path: Path) -> None:
    result, run, _ = run_short(
        "fatigue", tmp_path, seed=4, cycles=6, rate_hz=0.25, limits=NONE,
        leak=LeakCycles(3, 1.0), kept=KEEP,
    )  # fmt: skip
    assert result.outcome == "clean", result.error
    table = reduce_run(run).table
    for row in table.itertuples():
        expected = force_n(row.pressure_high_kpa, 62.0)
        assert abs(row.force_high_n - expected) < 3.0 * math.hypot(row.u_force_high_n, 0.1)
    known = table["leak_kpa_s"].dropna()
    assert len(known) == 2
    assert (known.abs() < 0.5).all()
    found = analysis_of("fatigue").findings(run, reduce_run(run))
    assert any("no work is done" in w for s in found.sections for w in s.words)


def test_pages_of_a_fatigue_test_in_parts_are_made_again_alike(parts: tuple[Run, Run]) -> None:
    first = derive_all(parts[1].folder)
    text = first.derived("report.html").read_text()
    assert "All 34 cycles were made" in text
    assert derive_all(parts[1].folder).derived("report.html").read_text() == text


@pytest.mark.parametrize(
    ("effects", "plant", "limits", "words"),
    [
        ({}, {"supply_kpa": 250.0}, Limits(0.0, 0.0, 20.0, 3), "high pressure was missed by"),
        ({"leak": {"conductance_m3_s_pa": 4e-12}}, {}, Limits(0.0, 1.0, 0.0, 3), "it leaks"),
    ],
)
def test_a_failure_vents_and_is_a_finding(
    effects: dict[str, Any], plant: dict[str, float], limits: Limits, words: str, tmp_path: Path
) -> None:
    config = load_rig("virtual", 2)
    assert config.virtual is not None
    config = with_virtual(config, effects=effects, plant={**config.virtual.plant, **plant})
    result, run, _ = run_short(
        "fatigue", tmp_path, config=config, cycles=12, limits=limits, leak=LeakCycles(2, 0.5)
    )
    assert result.outcome == "clean", result.error
    (failure,) = events(run, "failure")
    assert words in failure["reason"]
    assert failure["cycle"] < 12
    assert events(run, "vented")[-1]["confirmed"]
    found = fatigue_findings(run, reduce_run(run))
    assert found.data["failed"]
    assert "failed in cycle" in found.headline


def test_a_load_is_lifted_with_stated_work_and_efficiency(tmp_path: Path) -> None:
    air = Air(600.0, 5.0, 101.0, 0.5, (50.0, 60.0, 73.0), (10.0, 8.0, 5.0), 1.0, 0.3)
    how: dict[str, Any] = {
        "length_mm": 0.0, "mass_kg": 1.154, "rate_hz": 0.5, "low_kpa": 100.0, "limits": NONE,
    }  # fmt: skip
    result, run, _ = run_short("fatigue", tmp_path, seed=3, cycles=12, air=air, **how)
    assert result.outcome == "clean", result.error
    reduction = reduce_run(run)
    row = reduction.table.iloc[-1]
    assert row["work_j"] == pytest.approx(1.154 * 9.80665 * row["stroke_mm"] * 1e-3, rel=1e-6)
    last = fatigue_findings(run, reduction).data["energy"][-1]
    assert 0.0 < last["u_efficiency"] < 0.1 * last["efficiency"] < 0.01
    plain, run, _ = run_short("fatigue", tmp_path, seed=3, cycles=4, **how)
    assert plain.outcome == "clean"
    found = fatigue_findings(run, reduce_run(run))
    assert any("is not known" in w for s in found.sections for w in s.words)
    assert math.isnan(found.data["energy"][0]["efficiency"])


def test_work_of_a_loop_and_its_uncertainty() -> None:
    """An ellipse of known area, with noise: the stated uncertainty is the scatter."""
    angle = np.linspace(0.0, 2.0 * math.pi, 200, endpoint=False)
    force, length = 20.0 + 5.0 * np.sin(angle), 60.0 - 2.0 * np.cos(angle)
    rng = np.random.default_rng(1)
    u = np.full(200, 0.1)
    true = -math.pi * 5.0 * 2.0 * 1e-3
    found = [
        loop_work(force + u * rng.normal(size=200), length + 0.1 * u * rng.normal(size=200), u,
                  0.1 * u)
        for _ in range(300)
    ]  # fmt: skip
    work = np.array([w for w, _ in found])
    assert abs(work.mean() - true) < 4.0 * work.std() / math.sqrt(300)
    assert work.std() == pytest.approx(found[0][1], rel=0.15)
    volume = 10.0 + 2.0 * np.cos(angle)
    assert gas_work(300.0 + 50.0 * np.sin(angle), volume) == pytest.approx(
        -math.pi * 100.0 * 1e-3, rel=1e-3
    )


def test_efficiency_by_hand() -> None:
    air = Air(600.0, 0.0, 100.0, 0.0, (50.0, 70.0), (10.0, 6.0), 0.0, 0.5)
    high, low = State(400.0, 1.0, 50.0, 0.1), State(0.0, 1.0, 70.0, 0.1)
    made = cycle_energy(0.2, 0.001, high, low, air)
    exergy = (500.0 * 10.0 - 100.0 * 6.0) * math.log(7.0) * 1e-3
    assert made.exergy_j == pytest.approx(exergy, rel=1e-9)
    assert made.efficiency == pytest.approx(0.2 / exergy, rel=1e-9)
    rng = np.random.default_rng(2)
    drawn = []
    for _ in range(2000):
        p1, p2, l1, l2, v = rng.normal(size=5)
        used = (500 + p1) * (10 - 0.02 * l1 + 0.5 * v) - (100 + p2) * (6 - 0.02 * l2 + 0.5 * v)
        drawn.append(used * math.log(7.0) * 1e-3)
    assert made.u_exergy_j == pytest.approx(float(np.std(drawn)), rel=0.1)
    assert math.isnan(cycle_energy(0.2, 0.001, high, low, None).efficiency)
    beyond = dataclasses.replace(low, length_mm=80.0)
    assert math.isnan(cycle_energy(0.2, 0.001, high, beyond, air).exergy_j)


@pytest.mark.parametrize("friction_n", [0.0, 3.0])
def test_work_lost_over_a_loop_of_length(friction_n: float, tmp_path: Path) -> None:
    """An isobaric test stretches and lets back: friction takes twice itself times the way."""
    effects = {"braid_friction": {"friction_n": friction_n}} if friction_n else {}
    config = with_virtual(load_rig("virtual", 7), effects=effects)
    result, run, _ = run_short(
        "isobaric", tmp_path, config=config, pressures_kpa=(300.0,), lengths_mm=(57.0, 61.0, 65.0)
    )
    assert result.outcome == "clean", result.error
    (loop,) = analysis_of("isobaric").findings(run, reduce_run(run)).data["loops"]
    if friction_n == 0.0:
        assert abs(loop["lost_mj"]) < 3.0 * loop["u_lost_mj"]
        return
    plant = BenchSim(nominal(), Effects.from_config(effects), length_m=0.057)
    plant.set_pressure(300.0)
    forces, lengths = [], [57.0, 61.0, 65.0, 65.0, 61.0, 57.0]
    for length in lengths:
        plant.set_length(length)
        forces.append(plant.force_n)
    true = -1e3 * loop_work(np.array(forces), np.array(lengths), np.zeros(6), np.zeros(6))[0]
    assert true > 10.0
    assert abs(loop["lost_mj"] - true) < 3.0 * loop["u_lost_mj"] + 0.1 * true


def test_cycles_under_a_load_have_work_and_efficiency(tmp_path: Path) -> None:
    air = Air(600.0, 5.0, 101.0, 0.5, (50.0, 60.0, 80.0), (10.0, 8.0, 4.0), 1.0, 0.3)
    result, run, _ = run_short(
        "hysteresis", tmp_path, lengths_mm=(), masses_kg=(1.154,), cycles_kpa=(300.0,),
        step_kpa=150.0, air=air,
    )  # fmt: skip
    assert result.outcome == "clean", result.error
    assert run.manifest["parameters"]["air"]["dead_ml"] == 1.0
    (row,) = analysis_of("hysteresis").findings(run, reduce_run(run)).data["energy"]
    assert row["work_j"] == pytest.approx(1.154 * 9.80665 * row["stroke"] * 1e-3, rel=1e-3)
    assert 0.01 < row["efficiency"] < 0.2
    assert 0.0 < row["u_efficiency"] < 0.1 * row["efficiency"]


def test_a_killed_test_goes_on_with_the_count(tmp_path: Path) -> None:
    path = file_of(tmp_path, ("cycles = 8", "cycles = 300"), ("rate_hz = 1", "rate_hz = 4"), *NEVER)
    words = [sys.executable, "-m", "cli.main", "fatigue", "--protocol", str(path), "--out", "runs"]
    process = subprocess.Popen(
        words, cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        env={**os.environ, "PYTHONPATH": str(HOUSE)},
    )  # fmt: skip
    lines = 0
    until = time.monotonic() + 120.0
    while lines < 40 and time.monotonic() < until:
        time.sleep(0.02)
        found = list((tmp_path / "runs").glob("*/samples/cycles.index.jsonl"))
        lines = found[0].read_bytes().count(b"\n") if found else 0
    process.send_signal(signal.SIGKILL)
    process.wait()
    (folder,) = (p for p in (tmp_path / "runs").iterdir() if (p / "run.json").is_file())
    run = open_run(folder)
    assert run.outcome == "interrupted"
    made = done(run)["cycles"]
    assert 30 <= made < 300
    more = continue_run(run)
    assert more.outcome == "clean", more.error
    assert list(reduce_run(open_run(more.folder)).table["order"]) == list(range(1, 301))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("high_kpa = 300", "high_kpa = 55", "at least 10 kPa above low_kpa = 50"),
        ("low_kpa = 50", "low_kpa = 2", "no valve holds that; 0 vents"),
        ("leak_kpa_s = 0 ", "leak_kpa_s = 2 ", "no leak is measured"),
        ("repeats = 1", "repeats = 2", "a muscle is worn once"),
        ("[keep]", "[keeps]", "keeps: unknown key"),
        ("[keep]", "[air]\nsupply_kpa = 600\natmosphere_kpa = 101\nu_volume_ml = 1\n"
         "lengths_mm = [60, 50]\nvolumes_ml = [5, 6]\n[keep]", "must increase"),
    ],
)  # fmt: skip
def test_a_bad_file_is_refused(old: str, new: str, words: str, tmp_path: Path) -> None:
    path = file_of(tmp_path, (old, new))
    with pytest.raises(ConfigError, match=words):
        procedure("fatigue").read(str(path), load_rig("virtual"))


def test_nothing_withheld_is_left_behind(parts: tuple[Run, Run]) -> None:
    """After the last cycle everything is recorded again: the closing vent is there."""
    _, second = parts
    table = second.samples("valve")
    start = second.manifest["started"]["monotonic_ns"]
    closing = events(second, "zero")[-1]
    assert closing["when"] == "after"
    low, high = closing["valve_seq"]
    assert ((table["seq"] >= low) & (table["seq"] < high)).sum() == high - low
    assert table["host_ns"][-1] > start
