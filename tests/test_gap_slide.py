"""A load on a slide that rubs about as hard as the load weighs.

Vented, such a load stays where it was: the slide holds it with as much friction as it takes. Drawn
up, it creeps by tenths of a millimetre a second, which the noise of two frames hides. Practice sets
with such slides had been refused as the data of another muscle.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest

from gap.data.dataset import DataSet
from gap.data.reader import read_dataset
from gap.effects.candidates import CANDIDATES
from gap.estimation.fit_problem import FitProblem, FitResult
from gap.model.signals import Signal
from plant.constants import STANDARD_GRAVITY_M_S2, nominal
from plant.physics.muscle import braid_force

Array = npt.NDArray[np.float64]

FRAMES_HZ, FRICTION_N, NOISE_MM = 30.0, 12.0, 0.02
LOADS_KG = (0.5, 0.8, 1.1)


def drawn_up_and_vented(load_kg: float) -> tuple[Array, Array, Array]:
    """Time in s, length in mm and force in N: drawn up at 0.6 mm/s, vented, drawn up again."""
    t = np.arange(0.0, 30.0, 1.0 / FRAMES_HZ)
    up = load_kg * STANDARD_GRAVITY_M_S2 + FRICTION_N
    force = np.interp(t, [0.0, 10.0, 10.5, 18.0, 20.0, 30.0], [up, up, 0.0, 0.0, up, up])
    rises = (t < 10.0) | (t > 20.0)
    length = 68.0 - np.cumsum(np.where(rises, 0.6, 0.0)) / FRAMES_HZ
    return t, length, force


def stuck(folder: Path) -> DataSet:
    """Three loads on that slide and an isometric test, each three times; the nominal muscle."""
    rng = np.random.default_rng(3)
    c = nominal()
    trials, samples = [], []
    for load_kg in LOADS_KG:
        t, length, force = drawn_up_and_vented(load_kg)
        per_pa = np.array([braid_force(1.0, x * 1e-3, c.braid_length_m, c.turns) for x in length])
        for replicate in (1, 2, 3):
            name = f"{load_kg} kg, {replicate}"
            trials.append({"trial": name, "slot": f"{load_kg} kg", "replicate": replicate,
                           "protocol": "isotonic", "load_kg": load_kg})  # fmt: skip
            samples.append(pd.DataFrame({
                "trial": name, "time_s": t,
                "pressure_kpa": force / per_pa * 1e-3 + 0.3 * rng.standard_normal(len(t)),
                "length_mm": length + NOISE_MM * rng.standard_normal(len(t)),
                "force_n": force + 0.05 * rng.standard_normal(len(t)),
            }))  # fmt: skip
    for replicate in (1, 2, 3):
        name = f"isometric, {replicate}"
        trials.append({"trial": name, "slot": "isometric", "replicate": replicate,
                       "protocol": "isometric", "held_length_mm": 62.0})  # fmt: skip
        kpa = np.linspace(0.0, 300.0, 300)
        force = braid_force(kpa * 1e3, 62e-3, c.braid_length_m, c.turns)
        samples.append(pd.DataFrame({
            "trial": name, "time_s": np.arange(300) / 30.0,
            "pressure_kpa": kpa + 0.3 * rng.standard_normal(300),
            "force_n": force + 0.05 * rng.standard_normal(300),
        }))  # fmt: skip
    folder.mkdir()
    pd.DataFrame(trials).to_csv(folder / "trials.csv", index=False)
    pd.concat(samples).to_csv(folder / "samples.csv", index=False)
    return read_dataset(folder)


def friction(problem: FitProblem, *shapes: Mapping[str, float]) -> FitResult:
    """The fit with friction of the slide in some of its forms, together."""
    one = next(c for c in problem.candidates if c.id == "link_friction")
    return problem.polish(
        problem.fit([replace(one, shape=shape) for shape in shapes], [1.0] * len(shapes))
    )


def test_a_slide_that_holds_its_load_explains_it_with_its_friction(tmp_path: Path) -> None:
    problem = FitProblem.of(stuck(tmp_path / "set"), list(CANDIDATES))
    gap = problem.base.cost - len(problem.rows)
    found = friction(problem, {"rest_knee_mm_s": 0.07})
    assert found.amounts[0] == pytest.approx(FRICTION_N, rel=0.02)
    assert found.cost - len(problem.rows) < 0.001 * gap
    # A slip that hangs on the motion alone has full friction, or none, where the load sticks.
    slips = friction(problem, {"travel_mm": 0.1}, {"knee_mm_s": 0.3})
    assert slips.cost - len(problem.rows) > 0.1 * gap


def speed(folder: Path, time_s: Array, length_mm: Array) -> tuple[Array, Array]:
    """Speed and its sd in mm/s as a diagnosis takes them from the frames of a camera."""
    folder.mkdir()
    trial = {"trial": "a", "slot": "a", "replicate": 1, "protocol": "isotonic", "load_kg": 1.0}
    pd.DataFrame([trial]).to_csv(folder / "trials.csv", index=False)
    rows = {"trial": "a", "time_s": time_s, "pressure_kpa": 300.0, "length_mm": length_mm}
    pd.DataFrame(rows).to_csv(folder / "samples.csv", index=False)
    data = read_dataset(folder)
    signal = Signal.of(data.trials[0], data.constants)
    return signal.rate_at(time_s) * 1e3, signal.rate_sd_at(time_s) * 1e3


def test_the_speed_of_a_creeping_load_shows_beside_the_noise_of_the_camera(tmp_path: Path) -> None:
    t = np.arange(0.0, 20.0, 1.0 / FRAMES_HZ)
    noise = NOISE_MM * np.random.default_rng(5).standard_normal(len(t))
    way = np.where(t < 10.0, -0.2, 0.2)
    found, sd = speed(tmp_path / "set", t, 65.0 + np.cumsum(way) / FRAMES_HZ + noise)
    turns = np.abs(t - 10.0) < 1.0
    off = (found - way)[~turns] / sd[~turns]
    assert np.abs(found - way)[~turns].max() < 0.15  # two frames: 0.02 mm * 30 Hz = 0.6 mm/s
    assert np.median(sd) < 0.03
    assert np.sqrt(np.mean(off**2)) == pytest.approx(1.0, abs=0.5)


def test_a_quick_motion_keeps_the_speed_that_its_frames_show(tmp_path: Path) -> None:
    t = np.arange(0.0, 4.0, 0.01)
    noise = 0.01 * np.random.default_rng(6).standard_normal(len(t))
    found, sd = speed(tmp_path / "set", t, 65.0 + np.sin(2.0 * np.pi * 2.0 * t) + noise)
    true = 4.0 * np.pi * np.cos(4.0 * np.pi * t)
    inside = slice(10, -10)
    assert np.sqrt(np.mean((found - true)[inside] ** 2)) < 0.1 * true.max()
    assert np.mean(np.abs(found - true)[inside] < 3.0 * sd[inside]) > 0.8
