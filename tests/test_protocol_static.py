"""Isobaric, isotonic, isothermal and hysteresis tests against what the virtual bench knows."""

from __future__ import annotations

import dataclasses
import math
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from analysis.findings.hysteresis import cycles_of
from analysis.findings.isothermal import temperature_growth, temperature_lines
from analysis.reduction.setpoint import at_set_pressure
from daq.store.verify import verify
from plant.constants import nominal
from plant.effects.effects import Effects
from plant.simulator.bench import BenchSim
from protocol_runs import (
    events,
    force_n,
    hung_length_mm,
    plan_of,
    run_short,
    with_virtual,
)
from rigs.execution.procedure import Plan
from rigs.execution.runner import Runner
from rigs.execution.session import run_protocol
from rigs.protocols.names import default_rig
from rigs.protocols.registry import procedure
from rigs.rigfile.config import load_rig
from rigs.rigfile.toml_reader import find_config
from rigs.steps.loads import HangLoad
from rigs.steps.muscle.held import HeldPart
from rigs.steps.steps import Measure, Settle, Trial
from rigs.virtual.bench import VirtualBench

STATIC = ("isobaric", "isotonic", "isothermal", "hysteresis")
FULL = bool(os.environ.get("PAMRIG_CAMPAIGN"))
G = 9.80665


def table_of(run: Any) -> Any:
    return procedure(run.manifest["protocol"]).analysis.reduce(run).table


def true_kpa(bench: VirtualBench, run: Any, event: dict[str, Any]) -> float:
    samples = run.between("valve", "seq", *event["valve_seq"])
    return bench.board.mean_kpa(int(samples["device_us"][0]), int(samples["device_us"][-1]))


def share(inside: list[bool]) -> float:
    return sum(inside) / len(inside)


def lowest(n: int, p: float = 0.90) -> float:
    """What a share of ``n`` benches with cover ``p`` each falls short of once in a thousand."""
    return p - 3.1 * math.sqrt(p * (1 - p) / n)


def test_isobaric_points_agree_with_the_plant_as_often_as_they_say(tmp_path: Path) -> None:
    inside: list[bool] = []
    benches = 100 if FULL else 5
    for seed in range(benches):
        result, run, _ = run_short(
            "isobaric", tmp_path, seed=2000 + seed,
            pressures_kpa=(200.0, 500.0), lengths_mm=(57.0, 65.0),
        )  # fmt: skip
        assert result.outcome == "clean", result.error
        for row in table_of(run).itertuples():
            p, length = row.pressure_kpa, row.length_mm
            by_p = force_n(1.0, length)
            by_l = force_n(p, length + 0.5) - force_n(p, length - 0.5)
            u = math.hypot(row.u_force_n, by_p * row.u_pressure_kpa, by_l * row.u_length_mm)
            inside.append(abs(row.force_n - force_n(p, length)) <= 2 * u)
    print(f"\nisobaric: {share(inside):.1%} of {len(inside)} points within k = 2")
    assert share(inside) >= lowest(benches)
    if FULL:
        assert share(inside) <= 0.985


def test_a_vented_muscle_is_not_left_under_vacuum(tmp_path: Path) -> None:
    """Shortening draws one that the pressure sensor cannot show; the force would."""
    config = with_virtual(load_rig("virtual", 6), draw_calibration_errors=False)
    result, run, _ = run_short(
        "isobaric", tmp_path, config=config, pressures_kpa=(0.0,), lengths_mm=(55.0, 61.0, 67.0)
    )
    assert result.outcome == "clean", result.error
    table = table_of(run)
    assert len(table) == 6
    assert (table["force_n"].abs() < 0.1).all(), list(table["force_n"])


def test_isotonic_lengths_lie_where_the_load_is_at_rest(tmp_path: Path) -> None:
    """Regulator bench whose sensors do not err: 0.02 mm from the plant's own equilibrium."""
    config = with_virtual(load_rig("virtual-thesis", 5), draw_calibration_errors=False)
    result, run, bench = run_short(
        "isotonic", tmp_path, config=config, masses_kg=(0.714, 1.734),
        pressures_kpa=(200.0, 400.0, 600.0),
        method={**as_in_full("isotonic", config), "frames": 3},
    )  # fmt: skip
    assert result.outcome == "clean", result.error
    table = table_of(run)
    worst = 0.0
    for row, event in zip(table.itertuples(), events(run, "point"), strict=True):
        assert row.force_n == pytest.approx(row.mass_kg * G, rel=1e-9)
        truth = hung_length_mm(true_kpa(bench, run, event), row.force_n)
        worst = max(worst, abs(row.length_mm - truth))
    print(f"\nisotonic: worst length {worst:.4f} mm from the plant's")
    assert table["settled"].all()
    assert worst < 0.02


def test_isotonic_points_agree_with_the_plant_as_often_as_they_say(tmp_path: Path) -> None:
    inside: list[bool] = []
    benches = 100 if FULL else 5
    for seed in range(benches):
        result, run, _ = run_short("isotonic", tmp_path, seed=3000 + seed)
        assert result.outcome == "clean", result.error
        for row in table_of(run).itertuples():
            p, weight = row.pressure_kpa, row.force_n
            by_p = hung_length_mm(p + 0.5, weight) - hung_length_mm(p - 0.5, weight)
            by_f = hung_length_mm(p, weight + 0.5) - hung_length_mm(p, weight - 0.5)
            u = math.hypot(row.u_length_mm, by_p * row.u_pressure_kpa, by_f * row.u_force_n)
            inside.append(abs(row.length_mm - hung_length_mm(p, weight)) <= 2 * u)
    print(f"\nisotonic: {share(inside):.1%} of {len(inside)} points within k = 2")
    assert share(inside) >= lowest(benches)


def as_in_full(name: str, config: Any) -> dict[str, Any]:
    """Settling and window of the full template: a regulator with a lag of 1 s needs them."""
    plan: Any = procedure(name).read(name, config)
    method = plan.held if name == "hysteresis" else plan.method
    return {"settle": method.settle, "measure_s": method.measure_s}


def friction_rig(friction_n: float, rig: str = "virtual-thesis") -> Any:
    effect = {"braid_friction": {"friction_n": friction_n}}
    return with_virtual(load_rig(rig, 7), effects=effect)


def true_area(friction_n: float, length_mm: float, up: list[float]) -> float:
    """Loop area of the plant alone, led through the same pressures without any valve."""
    effects = Effects.from_config({"braid_friction": {"friction_n": friction_n}})
    sim = BenchSim(nominal(), effects, length_m=length_mm * 1e-3)
    forces = []
    for pressure in [*up, *reversed(up)]:
        sim.set_pressure(pressure)
        forces.append(sim.force_n)
    rising, falling = np.array(forces[: len(up)]), np.array(forces[len(up) :][::-1])
    return float(np.trapezoid(rising - falling, up))


def test_loop_area_of_a_known_braid_friction(tmp_path: Path) -> None:
    config = friction_rig(3.0)
    how = as_in_full("hysteresis", config)
    result, run, _ = run_short(
        "hysteresis", tmp_path, config=config, lengths_mm=(62.0,), cycles_kpa=(600.0,),
        method={**how, "precondition_cycles": 1, "precondition_kpa": 600.0},
    )  # fmt: skip
    assert result.outcome == "clean", result.error
    (cycle,) = cycles_of(at_set_pressure(table_of(run), "force_n"))
    truth = true_area(3.0, 62.0, list(cycle.pressure_kpa))
    print(f"\nloop area {cycle.area:.0f} +/- {2 * cycle.u_area:.0f} N kPa, plant {truth:.0f}")
    assert cycle.area == pytest.approx(truth, rel=0.05)


def test_no_loop_where_there_is_no_friction(tmp_path: Path) -> None:
    """What the approach to a set-point leaves must not pass for hysteresis."""
    config = load_rig("virtual-thesis", 11)
    result, run, _ = run_short(
        "hysteresis", tmp_path, config=config, cycles_kpa=(400.0,), lengths_mm=(62.0,),
        method=as_in_full("hysteresis", config),
    )  # fmt: skip
    assert result.outcome == "clean", result.error
    (cycle,) = cycles_of(at_set_pressure(table_of(run), "force_n"))
    assert abs(cycle.area) < 0.02 * 400.0 * 10.0  # 2 % of a mean force of 10 N over the cycle
    assert np.abs(cycle.difference).max() < 0.06


def test_isotonic_cycles_go_up_and_down_under_each_load(tmp_path: Path) -> None:
    result, run, _ = run_short(
        "hysteresis", tmp_path, lengths_mm=(), masses_kg=(0.751, 1.751), cycles_kpa=(300.0, 150.0),
        step_kpa=150.0,
    )  # fmt: skip
    assert result.outcome == "clean", result.error
    table = table_of(run)
    assert len(table) == 2 * (6 + 4)
    assert sorted(set(table["mass_kg"])) == [0.751, 1.751]
    found = procedure("hysteresis").analysis.findings(
        run, procedure("hysteresis").analysis.reduce(run)
    )  # type: ignore[misc]
    assert found.headline
    assert [e["mass_kg"] for e in events(run, "load")] == [0.751, 1.751, 0.0]


def test_isothermal_trials_wait_for_the_thermometer(tmp_path: Path) -> None:
    """A chamber that warms slowly: the trials begin when it has soaked, not when it was set."""

    def slow(runner: Runner) -> None:
        extras = runner.rig.bench.extras  # type: ignore[union-attr]
        target = [extras.temperature_c]
        clock = runner.rig.clock
        last = [clock.now_ns()]
        person = runner.rig.operator
        person._steps["temperature"] = lambda value: target.__setitem__(0, value)  # type: ignore[attr-defined]

        def lag() -> None:
            step = (clock.now_ns() - last[0]) * 1e-9 / 20.0
            last[0] = clock.now_ns()
            extras.temperature_c += (target[0] - extras.temperature_c) * min(step, 1.0)

        runner.rig.event_loop.add(lag)

    config = load_rig("virtual-instruments", 3)
    plan = plan_of("isothermal", config)
    soak = dataclasses.replace(
        plan.soak, soak_s=10.0, tolerance_c=0.5, drift_c=0.4, timeout_s=600.0
    )
    result, run, _ = run_short(
        "isothermal", tmp_path, config=config, begin=slow, soak=soak, temperatures_c=(21.0, 33.0),
        lengths_mm=(57.0,), pressures_kpa=(200.0, 400.0, 600.0),
        isobaric_pressures_kpa=(300.0,), isobaric_lengths_mm=(57.0, 63.0),
    )  # fmt: skip
    assert result.outcome == "clean", result.error
    soaked = events(run, "soaked")
    assert [e["asked_c"] for e in soaked] == [21.0, 33.0]
    assert soaked[1]["settled"]
    assert soaked[1]["waited_s"] > 60.0  # three time constants of 20 s to come near, and the soak
    assert soaked[1]["read_c"] == pytest.approx(33.0, abs=0.7)
    table = table_of(run)
    warm = table[table["set_temperature_c"] == 33.0]
    assert (abs(warm["temperature_c"] - 33.0) < 0.8).all()
    assert len(table) == 2 * (6 + 4)
    # The nominal plant's force does not depend on temperature: no growth beyond its uncertainty.
    growth = temperature_growth(temperature_lines(table[table["slot"].str.startswith("L")]))
    assert (growth["growth"].abs() < 3 * growth["u_growth"] + 0.05).all()


def test_isothermal_says_what_is_missing(tmp_path: Path) -> None:
    from daq.errors import ConfigError

    with pytest.raises(ConfigError, match="thermometer"):
        procedure("isothermal").read("isothermal", load_rig("virtual"))
    text, _ = find_config("isothermal", "protocols")
    path = tmp_path / "mine.toml"
    path.write_text(text.replace("pressures_kpa = [0,", "presures_kpa = [0,"))
    with pytest.raises(ConfigError, match="presures_kpa: unknown key"):
        procedure("isothermal").read(str(path), load_rig("virtual-instruments"))


@pytest.mark.parametrize("name", STATIC)
def test_every_trial_has_its_zeros_and_its_place(name: str, tmp_path: Path) -> None:
    result, run, _ = run_short(name, tmp_path)
    assert result.outcome == "clean", result.error
    assert result.points == result.planned
    assert not events(run, "fault")
    begins = [e for e in events(run, "trial") if e["phase"] == "begin"]
    ends = [e["trial"] for e in events(run, "trial") if e["phase"] == "end"]
    assert [e["trial"] for e in begins] == ends
    for trial in begins:
        zeros = [z["when"] for z in events(run, "zero") if z["trial"] == trial["trial"]]
        assert zeros == ["before", "after"]
        assert {"slot", "replicate", "order", "mounting", "protocol"} <= set(trial)
    assert verify(run) == []
    table = table_of(run)
    assert list(table["order"]) == list(range(1, result.planned + 1))


def test_the_muscle_is_mounted_anew_between_replicates(tmp_path: Path) -> None:
    result, run, _ = run_short(
        "isobaric", tmp_path, lengths_mm=(60.0,), method={"mountings": ("a", "b"), "repeats": 2}
    )
    assert result.outcome == "clean", result.error
    (mounted,) = events(run, "mounted")
    assert mounted["mounting"] == "b"
    assert mounted["waited_s"] >= 5.0
    begins = [e for e in events(run, "trial") if e["phase"] == "begin"]
    assert [(e["mounting"], e["replicate"]) for e in begins] == [
        ("a", 1), ("a", 2), ("b", 3), ("b", 4)
    ]  # fmt: skip


def trials_of(plan: Plan, hung: Callable[[float], float | None]) -> list[tuple[str, int, float]]:
    """Goes through a method without a bench: (slot, replicate, load) of each trial as measured."""
    steps, answer, found = plan.steps(), None, []
    begun: dict[int, Trial] = {}
    asked = there = 0.0
    while True:
        try:
            step = steps.send(answer)
        except StopIteration:
            return found
        answer = (True, 0.0) if isinstance(step, Settle) else None
        if isinstance(step, HangLoad):
            if step.mass_kg != asked:
                asked, there = step.mass_kg, hung(step.mass_kg) or step.mass_kg
            answer = there
        elif isinstance(step, Trial):
            begun[step.trial] = step
        elif isinstance(step, (Measure, HeldPart)):
            trial = begun[step.trial]
            assert (step.slot, step.replicate) == (trial.slot, trial.replicate)
            assert step.mass_kg == dict(trial.held)["load_kg"]
            if (row := (step.slot, step.replicate, step.mass_kg)) not in found:
                found.append(row)


def test_a_trial_has_the_name_of_what_hangs_and_shares_it_with_no_other() -> None:
    """5 kg hung where 1.154 kg was requested: the trial was a replicate of M1.154."""
    plan = procedure("isotonic").read("isotonic-weights", load_rig("virtual-weights"))
    method = dataclasses.replace(plan.method, repeats=2)
    plan = dataclasses.replace(plan, method=method, masses_kg=(0.5, 1.154, 5.0, 12.5))
    assert trials_of(plan, lambda kg: None) == [
        (f"M{kg}", k, kg) for k in (1, 2) for kg in (0.5, 1.154, 5, 12.5)
    ]
    wrong = iter([5.0])
    found = trials_of(plan, lambda kg: next(wrong, None) if kg == 1.154 else None)
    assert found[:4] == [("M0.5", 1, 0.5), ("M5", 1, 5.0), ("M5", 2, 5.0), ("M12.5", 1, 12.5)]
    assert found[4:] == [("M0.5", 2, 0.5), ("M1.154", 2, 1.154), ("M5", 3, 5.0), ("M12.5", 2, 12.5)]


def test_a_load_that_stays_keeps_its_name_in_the_next_trials() -> None:
    plan = procedure("creep").read("creep", load_rig("virtual"))
    method = dataclasses.replace(plan.method, repeats=1)
    plan = dataclasses.replace(plan, method=method, masses_kg=(1.0,), pressures_kpa=(200.0, 300.0))
    assert trials_of(plan, lambda kg: 2.5) == [
        ("2.5 kg, 200 kPa", 1, 2.5), ("2.5 kg, 300 kPa", 1, 2.5)
    ]  # fmt: skip


@pytest.mark.campaign
@pytest.mark.parametrize("name", STATIC)
def test_an_hour_of_protocol_takes_less_than_a_minute(name: str, tmp_path: Path) -> None:
    config = load_rig(default_rig(name))
    kind = procedure(name)
    plan: Any = kind.read(name, config)
    wanted = {"isobaric": 5, "isotonic": 8, "hysteresis": 3, "isothermal": 3}[name]
    for key in ("method", "held", "hung"):
        if hasattr(plan, key):
            method = dataclasses.replace(getattr(plan, key), repeats=wanted)
            plan = dataclasses.replace(plan, **{key: method})
    cpu = time.process_time()
    result = run_protocol(kind, config, plan, tmp_path)
    cpu = time.process_time() - cpu
    from daq.store.run import open_run

    run = open_run(result.folder)
    assert run.final is not None
    seconds = run.final["duration_s"]
    print(f"\n{name}: {seconds:.0f} s of test, {result.points} points: {cpu:.1f} s of processor")
    assert result.outcome == "clean", result.error
    assert cpu / seconds < 60 / 3600
