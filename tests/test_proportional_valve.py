"""Valves that open part of the way: SciPy integrates the same chamber, and writes the data.

A data set with a command of 0.35 used to be refused, and a spool with a dead band and a lag was no
part of the plant.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

from gap.data.reader import read_dataset
from gap.decision.diagnose import diagnose
from gap.errors import GapError
from gap.estimation.fit_problem import FitProblem
from gap.model.features import BLOCKS
from iso_6358 import mass_flow
from plant.constants import PlantConstants, nominal
from plant.effects.effects import Effects
from plant.errors import PlantError
from plant.finger import FingerSim, load_finger
from plant.simulator.simulate import Commands, commands, run_commands

Array = npt.NDArray[np.float64]
Command = Callable[[float], float]

FULL = 1.25e-10
"""Conductance of the open valves, m3/(s Pa)."""
ATMOSPHERE, SUPPLY = 101325.0, 651325.0
PER_STEP_S = 0.005
SPOOL = {
    "valve": "proportional", "inlet_conductance_m3_s_pa": FULL, "outlet_conductance_m3_s_pa": FULL,
    "inlet_dead_band": 0.05, "outlet_dead_band": 0.04, "valve_lag_ms": 8.0,
    "inlet_on_ms": 3.0, "inlet_off_ms": 3.0, "outlet_on_ms": 3.0, "outlet_off_ms": 3.0,
    "inlet_on_ms_per_kpa": 0.0, "inlet_off_ms_per_kpa": 0.0, "outlet_on_ms_per_kpa": 0.0,
    "outlet_off_ms_per_kpa": 0.0,
}  # fmt: skip


def volume(length_m: float, c: PlantConstants) -> float:
    """Equation 4-8 of the thesis and the dead volume, m3."""
    braid = c.braid_length_m**2 * length_m - length_m**3
    return braid / (4.0 * np.pi * c.turns**2) + c.dead_volume_m3


def spools(
    inlet: Command, outlet: Command, time_s: Array, length_m: float = 0.06,
    bands: tuple[float, float] = (0.05, 0.04), leak: float = 0.0,
) -> Array:  # fmt: skip
    """Gauge pressure in kPa: dead time 3 ms, dead bands, a lag of 8 ms, isothermal gas."""
    heat = 287.05 * 293.15 / volume(length_m, nominal())

    def rate(_: float, y: Array, aims: Sequence[float]) -> list[float]:
        absolute, into, out = y[0] + ATMOSPHERE, y[1], y[2]
        gained = mass_flow(FULL * into, SUPPLY, absolute)
        lost = mass_flow(FULL * out + leak, absolute, ATMOSPHERE)
        return [heat * (gained - lost), *((aims - y[1:]) / 0.008)]

    # From one change of what the valves are told to the next, so that nothing jumps within a step.
    turns = np.unique(np.round([*time_s, *(time_s[:-1] + 0.003)], 9))
    states = np.zeros((len(turns), 3))
    for k, (begin, end) in enumerate(pairwise(turns)):
        told = 0.5 * (begin + end) - 0.003
        aims = np.maximum([inlet(told) - bands[0], outlet(told) - bands[1]], 0.0)
        aims /= 1.0 - np.array(bands)
        found = solve_ivp(rate, (begin, end), states[k], args=(aims,), rtol=1e-6, atol=1e-3)
        states[k + 1] = found.y[:, -1]
    return np.asarray(states[np.isin(turns, np.round(time_s, 9)), 0] * 1e-3)


def swing(frequency_hz: float, level: float, sign: float) -> Command:
    """A sine about a level while a test runs, held over each step of the controller."""

    def told(t: float) -> float:
        at = np.floor(t / PER_STEP_S + 1e-9) * PER_STEP_S
        if not 0.2 < at < 2.4:
            return 0.3 if sign < 0.0 and at > 2.7 else 0.0
        return round(float(level * (1.0 + sign * np.sin(2.0 * np.pi * frequency_hz * at))), 4)

    return told


def recorded(
    folder: Path, bands: tuple[float, float] = (0.05, 0.04), leak: float = 0.0,
    bench: dict[str, object] | None = None,
) -> Path:  # fmt: skip
    """Four settings, three replicates each, in the dataset format."""
    rng = np.random.default_rng(5)
    time_s = np.arange(0.0, 3.0, PER_STEP_S)
    trials, samples = [], []
    for k in range(4):
        length_mm = 58.0 + 3.0 * k
        into, out = swing(0.5 + 0.4 * k, 0.14 + 0.05 * k, 1.0), swing(0.5 + 0.4 * k, 0.16, -1.0)
        kpa = spools(into, out, time_s, length_mm * 1e-3, bands, leak)
        told = [[f(t) for t in time_s] for f in (into, out)]
        for replicate in range(3):
            name = f"{k} {replicate}"
            trials.append({"trial": name, "slot": str(k), "replicate": replicate,
                           "protocol": "isometric", "held_length_mm": length_mm,
                           "order": len(trials) + 1})  # fmt: skip
            noise = 0.2 * rng.standard_normal() + 0.3 * rng.standard_normal(len(time_s))
            samples.append(pd.DataFrame({
                "trial": name, "time_s": time_s, "inlet_cmd": told[0], "outlet_cmd": told[1],
                "pressure_kpa": kpa + noise,
            }))  # fmt: skip
    folder.mkdir(parents=True)
    pd.DataFrame(trials).to_csv(folder / "trials.csv", index=False)
    pd.concat(samples).to_csv(folder / "samples.csv", index=False)
    stated = SPOOL if bench is None else bench
    (folder / "bench.toml").write_text(
        "".join(
            f'{k} = "{v}"\n' if isinstance(v, str) else f"{k} = {v}\n" for k, v in stated.items()
        )
    )
    return folder


def test_the_bench_follows_a_spool_as_scipy_does() -> None:
    time_s = np.arange(0.0, 3.0, PER_STEP_S)
    into, out = swing(1.3, 0.24, 1.0), swing(1.3, 0.16, -1.0)
    told = [(t, "inlet", into(t)) for t in time_s] + [(t, "outlet", out(t)) for t in time_s]
    c = nominal().with_overrides(SPOOL)
    traces = run_commands(c, commands(told), float(time_s[-1]), rate_hz=1.0 / PER_STEP_S)
    expected = spools(into, out, time_s)
    assert np.ptp(expected) > 200.0
    assert traces.pressure_kpa == pytest.approx(expected, abs=0.002)


def test_a_valve_that_needs_pressure_to_stay_open_falls_shut_there() -> None:
    c = nominal().with_overrides({"inlet_closing_kpa": 50.0, "outlet_closing_kpa": 30.0})
    told = commands([(0.0, "inlet", 1.0), (0.9, "inlet", 0.0), (1.0, "outlet", 1.0)])
    held, free = (run_commands(one, told, 2.0) for one in (c, nominal()))
    at = held.time_s.searchsorted(0.95)
    assert held.pressure_kpa[at] == pytest.approx(500.0, abs=0.02)
    assert held.pressure_kpa[-1] == pytest.approx(30.0, abs=0.05)
    # As long as the pressure holds it open it is a valve like any other.
    open_now = (held.time_s < 0.9) & (free.pressure_kpa < 480.0)
    assert open_now.sum() > 20
    assert held.pressure_kpa[open_now] == pytest.approx(free.pressure_kpa[open_now], abs=1e-3)


def test_the_diagnosis_predicts_both_kinds_of_valve_as_the_bench_does(tmp_path: Path) -> None:
    c = nominal().with_overrides(
        {"inlet_closing_kpa": 60.0, "outlet_closing_kpa": 20.0, "inlet_conductance_m3_s_pa": FULL,
         "outlet_conductance_m3_s_pa": FULL}
    )  # fmt: skip
    told = commands([(0.1, "inlet", 1.0), (1.2, "inlet", 0.0), (1.4, "outlet", 1.0)])
    # Where the outlet has fallen shut, a leak goes on.
    leak = {"leak": {"conductance_m3_s_pa": 2e-12}}
    kpa = run_commands(c, told, 3.0, rate_hz=200.0, effects=Effects(leak)).pressure_kpa
    assert kpa[-1] < 18.0
    folder = recorded(tmp_path / "set", bench={
        "inlet_closing_kpa": 60.0, "outlet_closing_kpa": 20.0, "inlet_conductance_m3_s_pa": FULL,
        "outlet_conductance_m3_s_pa": FULL,
    })  # fmt: skip
    time_s = np.arange(len(kpa)) / 200.0
    rows = {"time_s": time_s, "inlet_cmd": (time_s >= 0.1) & (time_s < 1.2),
            "outlet_cmd": time_s >= 1.4, "pressure_kpa": kpa}  # fmt: skip
    names = [f"{k} {r}" for k in range(4) for r in range(3)]
    table = pd.concat([pd.DataFrame({"trial": name, **rows}) for name in names])
    table.astype({"inlet_cmd": int, "outlet_cmd": int}).to_csv(folder / "samples.csv", index=False)
    pd.DataFrame({"trial": names, "slot": names, "protocol": "isometric", "held_length_mm": 60.0}
                 ).to_csv(folder / "trials.csv", index=False)  # fmt: skip
    with (folder / "bench.toml").open("a") as file:
        file.write("[effects.leak]\nconductance_m3_s_pa = 2e-12\n")
    problem = FitProblem.of(read_dataset(folder))
    assert np.abs(problem.stated_residual).max() < 0.5
    assert kpa.max() == pytest.approx(490.0, abs=0.05)


@pytest.fixture(scope="module")
def swung(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded(tmp_path_factory.mktemp("swung") / "set")


def test_a_spool_as_stated_is_no_gap(swung: Path) -> None:
    verdict = diagnose(read_dataset(swung))
    assert verdict.status == "no_gap_above_floor"


def test_a_dead_band_that_nobody_stated_is_found_with_its_wide_prior(tmp_path: Path) -> None:
    folder = recorded(tmp_path / "set", bands=(0.09, 0.04))
    problem = FitProblem.of(read_dataset(folder))
    here = problem.rows.block == BLOCKS.index("pressure")
    stated, left = (
        float(np.sqrt(np.mean(x[here] ** 2)))
        for x in (problem.stated_residual, problem.base.residual)
    )
    assert stated > 5.0
    assert left < 0.5
    c = problem.constants(problem.base.shift)
    assert c.inlet_dead_band == pytest.approx(0.09, abs=0.005)
    assert c.valve_lag_s == pytest.approx(0.008, abs=0.002)


def test_a_leak_behind_proportional_valves_is_named(tmp_path: Path) -> None:
    verdict = diagnose(read_dataset(recorded(tmp_path / "set", leak=2.4e-12)))
    assert verdict.status == "named"
    assert verdict.sure == ("leak",)


def test_half_a_command_needs_a_proportional_valve(swung: Path, tmp_path: Path) -> None:
    folder = tmp_path / "set"
    folder.mkdir()
    for name in ("trials.csv", "samples.csv"):
        (folder / name).write_bytes((swung / name).read_bytes())
    with pytest.raises(GapError, match=r"samples.csv, row \d+, column inlet_cmd.*proportional"):
        read_dataset(folder)
    with pytest.raises(PlantError, match=r"row 0 sets inlet to 0\.5; allowed 0 or 1, with valve"):
        run_commands(nominal(), commands([(0.0, "inlet", 0.5)]), 0.1)
    spool = nominal().with_overrides(SPOOL)
    with pytest.raises(PlantError, match=r"sets outlet to 1\.2; allowed 0 to 1"):
        run_commands(spool, Commands(np.zeros(1), ("outlet",), np.array([1.2])), 0.1)


@pytest.mark.parametrize(
    ("stated", "told"),
    [
        (
            {"valve_lag_ms": 5.0},
            'valve_lag_ms is of a proportional valve alone; state valve = "pro',
        ),
        ({"valve": "spool"}, "valve = 'spool'; allowed 'on_off' or 'proportional'"),
        ({"inlet_dead_band": 1.0}, "out of range; allowed 0 to 0.9"),
    ],
)
def test_bad_valves_are_refused_by_key(stated: dict[str, object], told: str) -> None:
    with pytest.raises(PlantError, match=told):
        nominal().with_overrides(stated, "bench.toml")


def test_a_finger_says_that_its_valves_are_on_or_off() -> None:
    with pytest.raises(PlantError, match="a finger has on/off valves"):
        FingerSim(load_finger(), nominal().with_overrides(SPOOL))
