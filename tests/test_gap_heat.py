"""Gas that is warmed by filling and cooled by the wall: the energy balance, integrated by SciPy.

A generator that is not ours hid it at 0.15 to 0.6 W/K, as a muscle of 6 ml has: the diagnosis,
which knew one time for all pressures, left a tenth of a gap of twenty floors and gave no name.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

from gap.data.dataset import DataSet
from gap.data.reader import read_dataset
from gap.decision.diagnose import diagnose
from gap.effects.terms import Active
from gap.model.grid import make_grid
from gap.model.residuals import Model
from plant.constants import nominal

Array = npt.NDArray[np.float64]
GAMMA, GAS, COLD_K = 1.4, 287.05, 293.15
HEAT_V = GAS / (GAMMA - 1.0)
ATMOSPHERE, SUPPLY = 101325.0, 651325.0
"""Absolute, Pa."""
C = nominal()
VOLUME = (C.braid_length_m**2 * 0.06 - 0.06**3) / (4.0 * np.pi * C.turns**2) + C.dead_volume_m3


def iso_6358(conductance: float, up: float, down: float, kelvin: float) -> float:
    """Mass flow in kg/s, critical ratio 0.5."""
    if down >= up:
        return 0.0
    ratio = down / up
    full = 1.185 * conductance * up * np.sqrt(293.15 / kelvin)
    return float(full if ratio <= 0.5 else full * np.sqrt(1.0 - ((ratio - 0.5) / 0.5) ** 2))


def filled_and_vented(
    pulses: Sequence[tuple[str, float, float]], seconds: float, wall_w_k: float
) -> tuple[Array, Array]:
    """Time (s) and gauge pressure (kPa) of a muscle held at 60 mm; pulses are what flows, really.

    States are mass and energy: d(m c_v T)/dt = c_p (T_0 m_in - T m_out) + hA (T_0 - T).
    """
    heat_p = GAMMA * HEAT_V

    def rate(t: float, y: Array) -> list[float]:
        mass, energy = y
        kelvin = energy / (mass * HEAT_V)
        pressure = mass * GAS * kelvin / VOLUME
        open_now = {name for name, begin, end in pulses if begin <= t < end}
        into = iso_6358(1.25e-9, SUPPLY, pressure, COLD_K) if "inlet" in open_now else 0.0
        out = iso_6358(1.25e-9, pressure, ATMOSPHERE, kelvin) if "outlet" in open_now else 0.0
        warming = heat_p * (COLD_K * into - kelvin * out) + wall_w_k * (COLD_K - kelvin)
        return [into - out, warming]

    t = np.arange(0.0, seconds, 1e-3)
    mass = ATMOSPHERE * VOLUME / (GAS * COLD_K)
    y, now, shown = np.array([mass, mass * HEAT_V * COLD_K]), 0.0, []
    ends = sorted({0.0, seconds, *(x for _, a, b in pulses for x in (a, b))})
    for begin, end in pairwise(ends):
        at = t[(t >= begin) & (t < end)]
        found = solve_ivp(rate, (begin, end), y, t_eval=[*at, end], rtol=1e-8, max_step=2e-3)
        shown.append(found.y[1, :-1] * (GAMMA - 1.0) / VOLUME)
        y, now = found.y[:, -1], end
    assert now == seconds
    return t, (np.concatenate(shown) - ATMOSPHERE) * 1e-3


def bench(folder: Path, wall_w_k: float, noise_kpa: float) -> DataSet:
    """Steps up and down, long and short; three replicates."""
    rng = np.random.default_rng(6)
    made = {
        "steps": [("inlet", 0.1, 0.2), ("inlet", 0.7, 0.8), ("outlet", 1.3, 1.45)],
        "long": [("inlet", 0.1, 0.9), ("outlet", 1.2, 1.9)],
        "short": [("inlet", 0.1 + 0.2 * k, 0.12 + 0.2 * k) for k in range(5)]
        + [("outlet", 1.2 + 0.2 * k, 1.23 + 0.2 * k) for k in range(3)],
    }
    trials, samples = [], []
    for slot, pulses in made.items():
        t, p = filled_and_vented(pulses, 2.2, wall_w_k)
        # A command comes before what flows, by the delay at the pressure upstream.
        edges: list[tuple[float, str, float]] = []
        for name, begin, end in pulses:
            up = 550e3 if name == "inlet" else float(np.interp(begin, t, p)) * 1e3
            last = 550e3 if name == "inlet" else float(np.interp(end, t, p)) * 1e3
            on = C.inlet_on_s + C.inlet_on_s_per_pa * up
            off = C.inlet_off_s + C.inlet_off_s_per_pa * last
            if name == "outlet":
                on = C.outlet_on_s + C.outlet_on_s_per_pa * up
                off = C.outlet_off_s + C.outlet_off_s_per_pa * last
            edges += [(begin - on, name, 1.0), (end - off, name, 0.0)]
        for replicate in (1, 2, 3):
            trial = f"{slot} {replicate}"
            trials.append({"trial": trial, "slot": slot, "replicate": replicate,
                           "protocol": "step", "held_length_mm": 60.0})  # fmt: skip
            read = p * (1.0 + 3e-3 * noise_kpa * rng.standard_normal())
            table = pd.DataFrame({
                "time_s": t, "pressure_kpa": read + noise_kpa * rng.standard_normal(len(t))
            })  # fmt: skip
            for name in ("inlet", "outlet"):
                own = pd.DataFrame(
                    [(0.0, 0.0), *((x, to) for x, which, to in edges if which == name)],
                    columns=["time_s", f"{name}_cmd"],
                )
                table = table.merge(own, on="time_s", how="outer")
            samples.append(table.sort_values("time_s").assign(trial=trial))
    folder.mkdir()
    pd.DataFrame(trials).to_csv(folder / "trials.csv", index=False)
    pd.concat(samples).to_csv(folder / "samples.csv", index=False)
    return read_dataset(folder)


def rms_kpa(data: DataSet, active: Active) -> float:
    rows = Model(make_grid(data)).residual(data.constants, active)["pressure"]
    return float(np.sqrt(np.mean(np.square(rows))))


def test_the_stage_predicts_the_energy_balance(tmp_path: Path) -> None:
    """At 0.3 W/K the gas takes the wall's temperature in m c_v / hA: 0.07 s at 4 bar."""
    data = bench(tmp_path / "set", wall_w_k=0.3, noise_kpa=0.0)
    time_s = 4e5 * VOLUME / (GAS * COLD_K) * HEAT_V / 0.3
    balance = rms_kpa(data, [("polytropic", "", 0.4, {"heat_s": time_s, "mass": 1.0})])
    one_time = rms_kpa(data, [("polytropic", "", 0.4, {"heat_s": time_s})])
    assert rms_kpa(data, []) > 20.0
    assert balance < 0.6  # what is left is when a valve that shuts sees which pressure
    assert one_time > 10.0 * balance
    for other in (0.8, 1.25):
        there: Active = [("polytropic", "", 0.4, {"heat_s": other * time_s, "mass": 1.0})]
        assert rms_kpa(data, there) > 4.0 * balance


@pytest.mark.parametrize("wall_w_k", [0.15, 0.4])
def test_gas_that_the_wall_cools_is_named(tmp_path: Path, wall_w_k: float) -> None:
    verdict = diagnose(bench(tmp_path / "set", wall_w_k, noise_kpa=0.5))
    assert verdict.status.explained
    assert verdict.effects[0].ids == ("polytropic",)
    exponent = verdict.effects[0].parameters["exponent"]
    assert exponent.value == pytest.approx(GAMMA, abs=0.06)


@pytest.mark.parametrize("step_s", [0.001, 0.02])
def test_a_leak_alone_falls_as_the_closed_form_says(tmp_path: Path, step_s: float) -> None:
    """Choked, m' = -rho0 C p sqrt(T0 / T) (ISO 6358): pressure falls as an exponential.

    With both valves shut the stage takes steps of 20 ms.
    """
    conductance = 3e-12
    rate = GAS * COLD_K / VOLUME * 1.185 * np.sqrt(293.15 / COLD_K) * conductance
    t = np.arange(0.0, 10.0, step_s)
    read = ((400e3 + ATMOSPHERE) * np.exp(-rate * t) - ATMOSPHERE) * 1e-3
    assert read[-1] * 1e3 + ATMOSPHERE > ATMOSPHERE / C.critical_ratio  # choked to the end
    assert read[0] - read[-1] > 100.0
    folder = tmp_path / "set"
    folder.mkdir()
    row = {"trial": "a", "slot": "a", "replicate": 1, "protocol": "decay", "held_length_mm": 60.0}
    pd.DataFrame([row]).to_csv(folder / "trials.csv", index=False)
    pd.DataFrame(
        {"trial": "a", "time_s": t, "pressure_kpa": read, "inlet_cmd": 0.0, "outlet_cmd": 0.0}
    ).to_csv(folder / "samples.csv", index=False)
    data = read_dataset(folder)
    assert rms_kpa(data, [("leak", "", conductance, {})]) < 0.01
    assert rms_kpa(data, []) > 10.0
