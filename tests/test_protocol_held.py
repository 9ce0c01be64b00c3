"""Blocked force, free contraction, creep and relaxation against the virtual bench's true state."""

from __future__ import annotations

import dataclasses
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from analysis.reduction.muscle.time_laws import best_law, fit_rate, fit_time_laws
from analysis.registry import analysis_of
from analysis.reporting.derived import derive_all
from analysis.reporting.report import report_json
from analysis.run_table import reduce_run
from cli.protocols.resume import continue_run
from daq.errors import ConfigError
from daq.interrupt import StopFlag
from daq.store.run import Run, open_run
from daq.store.verify import verify
from gap.data.from_runs import export_runs
from gap.data.reader import read_dataset
from plant.effects.muscle.creep import gain, times
from protocol_runs import events, force_n, hung_length_mm, run_short, with_virtual
from rigs.execution.runner import Runner, Watch
from rigs.protocols.muscle.times import Times
from rigs.protocols.registry import procedure
from rigs.rigfile.config import load_rig
from rigs.rigfile.toml_reader import find_config
from rigs.steps.muscle.held import log_mean_s

NAMES = ("blocked-force", "free-contraction", "creep", "relaxation")
CREEP = {"creep": {"relaxation_percent": 8.0, "fast_s": 2.0, "slow_s": 40.0}}


def findings(run: Run) -> dict[str, Any]:
    return analysis_of(run.manifest["protocol"]).findings(run, reduce_run(run)).data


def lose(seconds: np.ndarray) -> np.ndarray:
    """Share of the force that is left so long after a step, by the effect's own equation."""
    taus = times(2.0, 40.0)
    return 1.0 - gain(0.08, taus) * np.sum(-np.expm1(-seconds[:, None] / taus), axis=1)


@pytest.fixture(scope="module")
def relaxed(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A muscle that relaxes by 8 % in a minute."""
    config = with_virtual(load_rig("virtual", 5), effects=CREEP)
    result, run, _ = run_short(
        "relaxation", tmp_path_factory.mktemp("relaxation"), config=config,
        times=Times(1.0, 25.0, 10, 0),
    )  # fmt: skip
    assert result.outcome == "clean", result.error
    return run


def test_relaxation_per_decade_is_that_of_the_plant(relaxed: Run) -> None:
    (trial,) = findings(relaxed)["trials"]
    after_s = reduce_run(relaxed).table["after_s"].to_numpy()
    expected = force_n(300.0, 62.0) * np.polyfit(np.log10(after_s), lose(after_s), 1)[0]
    assert abs(trial["rate"] - expected) < 2.0 * trial["u_rate"]
    assert trial["u_rate"] < 0.4 * abs(trial["rate"])  # a line does not fit four exponentials
    (law,) = findings(relaxed)["laws"]
    assert law["law"] in ("two exponentials", "logarithmic")


def test_times_of_the_parts_join_without_a_gap(relaxed: Run) -> None:
    table = reduce_run(relaxed).table
    assert np.allclose(table["from_s"][1:], table["to_s"][:-1], atol=0.03)
    assert table["to_s"].max() == pytest.approx(25.0, abs=0.1)
    assert ((table["from_s"] < table["after_s"]) & (table["after_s"] < table["to_s"])).all()
    seconds = np.linspace(2.0, 5.0, 100_001)
    assert log_mean_s(2.0, 5.0) == pytest.approx(math.exp(np.log(seconds).mean()), rel=1e-6)


def test_report_and_view_of_a_held_muscle_are_made_again_alike(relaxed: Run) -> None:
    first = derive_all(relaxed.folder)
    text = first.derived("report.html").read_text()
    assert "Law that was chosen" in text
    assert derive_all(relaxed.folder).derived("report.html").read_text() == text


def test_creep_follows_the_true_length(tmp_path: Path) -> None:
    seen: list[tuple[int, float]] = []

    def watch_length(runner: Runner) -> None:
        bench = runner.rig.bench
        assert bench is not None
        runner.rig.event_loop.add(
            lambda: seen.append((runner.rig.clock.now_ns(), bench.plant.length_mm))
        )

    config = with_virtual(load_rig("virtual", 5), effects=CREEP, draw_calibration_errors=False)
    result, run, _ = run_short(
        "creep", tmp_path, config=config, begin=watch_length, times=Times(2.0, 20.0, 8, 2)
    )
    assert result.outcome == "clean", result.error
    table = reduce_run(run).table
    (hold,) = events(run, "hold")
    start_ns = run.manifest["started"]["monotonic_ns"] + hold["start_t_ns"]
    at_s = np.array([(ns - start_ns) * 1e-9 for ns, _ in seen])
    length = np.array([mm for _, mm in seen])
    pictures_s = np.array([(frame["host_ns"] - start_ns) * 1e-9 for frame in run.frames])
    for row in table.itertuples():
        # The load still swings in the first seconds: what counts is where it was in the pictures.
        inside = (pictures_s >= row.from_s) & (pictures_s < row.to_s)
        seen_mm = np.interp(pictures_s[inside], at_s, length)
        assert len(seen_mm) == 2
        assert row.length_mm == pytest.approx(seen_mm.mean(), abs=0.01)
    (trial,) = findings(run)["trials"]
    true = np.polyfit(np.log10(table["after_s"]), np.interp(table["after_s"], at_s, length), 1)[0]
    assert true > 0.05
    assert abs(trial["rate"] - true) < 2.5 * trial["u_rate"]


def test_a_muscle_that_does_not_creep_is_not_said_to(tmp_path: Path) -> None:
    result, run, _ = run_short("relaxation", tmp_path, seed=8, times=Times(1.0, 15.0, 8, 0))
    assert result.outcome == "clean", result.error
    (trial,) = findings(run)["trials"]
    assert abs(trial["rate"]) < 3.0 * trial["u_rate"]
    assert trial["u_rate"] < 0.01


def correlated(rng: np.random.Generator, n: int, rho: float) -> np.ndarray:
    out = np.zeros(n)
    out[0] = rng.normal()
    for k in range(1, n):
        out[k] = rho * out[k - 1] + math.sqrt(1 - rho**2) * rng.normal()
    return out


@pytest.mark.parametrize("rho", [0.0, 0.6])
def test_the_slope_is_as_uncertain_as_stated_with_correlated_noise(rho: float) -> None:
    rng = np.random.default_rng(3)
    t, u = np.geomspace(2.0, 2000.0, 31), np.full(31, 0.01)
    inside = plain = 0
    for _ in range(300):
        y = 20.0 - 0.3 * np.log10(t) + 0.01 * correlated(rng, len(t), rho)
        law = fit_rate(t, y, u, None, (0.0, 1.0))
        assert law is not None
        rate, u_rate = law.rate
        inside += abs(rate + 0.3) <= 2.0 * u_rate
        plain += abs(rate + 0.3) <= 2.0 * u_rate / math.sqrt(law.tau)
    assert inside / 300 > 0.88
    if rho:
        assert plain < inside - 15  # without the autocorrelation fewer are covered


@pytest.mark.parametrize(
    ("name", "values"),
    [("constant", (20.0,)), ("logarithmic", (20.0, -0.2)), ("one exponential", (20.0, 0.5, 40.0)),
     ("two exponentials", (20.0, 0.5, 8.0, 0.6, 300.0))],
)  # fmt: skip
def test_the_law_that_made_the_data_is_chosen(name: str, values: tuple[float, ...]) -> None:
    rng = np.random.default_rng(11)
    t = np.geomspace(2.0, 1000.0, 28)
    y = np.full(len(t), values[0])
    if name == "logarithmic":
        y = y + values[1] * np.log10(t)
    else:
        for amplitude, tau in zip(values[1::2], values[2::2], strict=False):
            y = y + amplitude * np.exp(-t / tau)
    chosen = []
    for _ in range(12):
        noisy = y + 0.003 * rng.normal(size=len(t))
        best = best_law(fit_time_laws(t, noisy, np.full(len(t), 0.003)))
        chosen.append(best.name)
        if best.name == name:
            for value, u, true in zip(best.values, best.u, values, strict=True):
                assert abs(value - true) < 4.0 * u
    assert chosen.count(name) >= 9, chosen


def test_a_wandering_pressure_is_not_taken_for_relaxation() -> None:
    t = np.geomspace(2.0, 200.0, 20)
    kpa = 0.4 * np.sin(np.log10(t) * 1.5)
    y = 30.0 + 0.1 * kpa + 1e-4 * np.random.default_rng(1).normal(size=20)
    plain = fit_rate(t, y, np.full(20, 1e-4), None, (0.1, 0.1))
    with_pressure = fit_rate(t, y, np.full(20, 1e-4), kpa, (0.1, 0.1))
    assert plain is not None
    assert with_pressure is not None
    assert abs(plain.rate[0]) > 0.01
    assert abs(with_pressure.rate[0]) < 3.0 * with_pressure.rate[1] < 0.01


def test_blocked_force_is_the_force_of_the_plant_at_l0(tmp_path: Path) -> None:
    result, run, _ = run_short("blocked-force", tmp_path, seed=3)
    assert result.outcome == "clean", result.error
    found = findings(run)
    expected = force_n(found["pressure_kpa"], 64.0)
    assert abs(found["force_n"] - expected) < 3.0 * math.hypot(found["u_force_n"], 0.05)
    slope = force_n(1.0, 64.0)
    assert abs(found["line"]["slope_n_kpa"] - slope) < 3.0 * found["line"]["u_slope_n_kpa"]
    assert abs(found["line"]["threshold_kpa"]) < 3.0 * found["line"]["u_threshold_kpa"]
    (cycle,) = found["cycles"]
    assert abs(cycle["largest"]) < 3.0 * cycle["u_largest"]
    export_runs([run], tmp_path / "set")
    assert len(read_dataset(tmp_path / "set").trials) == 1


def test_free_contraction_is_that_of_the_plant(tmp_path: Path) -> None:
    result, run, _ = run_short("free-contraction", tmp_path, seed=3)
    assert result.outcome == "clean", result.error
    found = findings(run)
    assert not found["rest_length_stated"]
    true = 1.0 - hung_length_mm(found["pressure_kpa"], 0.1 * 9.80665) / 72.5
    assert abs(found["contraction"] - true) < 3.0 * math.hypot(found["u_contraction"], 1e-4)
    assert found["u_contraction"] < 5e-4
    shown = re.search(r"is [\d.]+ ± 0\.0*([1-9]\d) % ", report_json(run)["headline"])
    assert shown, "two significant digits of the uncertainty"
    stated, run, _ = run_short(
        "free-contraction", tmp_path, seed=3, pressures_kpa=(300.0,), rest_length_mm=72.5,
        u_rest_length_mm=0.1,
    )  # fmt: skip
    assert stated.outcome == "clean"
    again = findings(run)
    assert again["rest_length_stated"]
    assert again["u_contraction"] > found["u_contraction"]


def test_a_stopped_creep_test_goes_on_with_the_next_trial(tmp_path: Path) -> None:
    stop, seen = StopFlag(), [0]

    def result(*_: object) -> None:
        seen[0] += 1
        if seen[0] == 6:
            stop.set("SIGINT")

    short = Times(0.6, 1.5, 8, 0)
    text = find_config("relaxation-short", "protocols")[0]
    path = tmp_path / "own.toml"
    path.write_text(
        text.replace("duration_s = 6", "duration_s = 1.5").replace("[300]", "[200, 300]")
    )
    config = load_rig("virtual")
    plan = procedure("relaxation").read(str(path), config)
    assert plan.times == dataclasses.replace(short)  # type: ignore[attr-defined]
    from rigs.execution.session import run_protocol

    kind = procedure("relaxation")
    ended = run_protocol(
        kind, config, plan, tmp_path / "runs", stop=stop, watch=Watch(result=result)
    )
    assert ended.outcome == "stopped"
    more = continue_run(open_run(ended.folder))
    assert more.outcome == "clean", more.error
    run = open_run(more.folder)
    table = reduce_run(run).table
    assert sorted(table["order"]) == list(range(1, len(table) + 1))
    assert table["trial"].nunique() == 2
    assert verify(run) == []


@pytest.mark.parametrize(
    ("name", "old", "new", "words"),
    [
        ("creep", "duration_s = 5", "duration_s = 1", "must be at least twice first_s"),
        ("creep", "[300]", "[2]", "2 kPa is outside 5 to 650"),
        ("relaxation", "from_length_mm = 0.0", "from_length_mm = 20.0", "below the rig's 51 mm"),
        ("relaxation", "per_decade = 8", "per_decad = 8", "per_decad: unknown key"),
        ("free-contraction", "[0, 300]", "[100, 300]", "the length L0 at no pressure is not"),
        ("free-contraction", "mass_kg = 0.1", "mass_kg = 50", "mass_kg: 50 kg is outside"),
        ("blocked-force", "rest_length_mm = 64.0", "", "rest_length_mm"),
    ],
)
def test_a_bad_file_is_refused_with_its_key(
    name: str, old: str, new: str, words: str, tmp_path: Path
) -> None:
    text = find_config(f"{name}-short", "protocols")[0]
    assert old in text
    path = tmp_path / "own.toml"
    path.write_text(text.replace(old, new))
    with pytest.raises(ConfigError, match=words):
        procedure(name).read(str(path), load_rig("virtual"))
