"""What a noisy pressure brings into a predicted force is no fault of the recording, and no effect.

Smoothing takes that noise away. Benches of another generator without any effect had been `unknown`
for it ("a fault of the recording would explain better"), or had a creep of half the force.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gap.data.dataset import DataSet
from gap.data.reader import read_dataset
from gap.decision.diagnose import diagnose
from gap.verdict import Status
from plant.constants import nominal
from plant.physics.muscle import braid_force


def isometric(folder: Path, noise_kpa: float) -> DataSet:
    """The nominal muscle at four lengths, three times each, in triangles at 10 samples a second.

    Its force cell is saturated at the top of the longest one: those cells are empty.
    """
    rng = np.random.default_rng(21)
    c = nominal()
    t = np.arange(0.0, 30.0, 0.1)
    kpa = 300.0 * (1.0 - np.abs(t / 15.0 - 1.0))
    trials, samples = [], []
    for length_mm in (58.0, 62.0, 66.0, 70.0):
        force = braid_force(kpa * 1e3, length_mm * 1e-3, c.braid_length_m, c.turns)
        for replicate in (1, 2, 3):
            name = f"{length_mm:g} mm, {replicate}"
            trials.append({"trial": name, "slot": f"{length_mm:g} mm", "replicate": replicate,
                           "protocol": "isometric", "held_length_mm": length_mm})  # fmt: skip
            read = force + 0.03 * rng.standard_normal(len(t))
            samples.append(pd.DataFrame({
                "trial": name, "time_s": t,
                "pressure_kpa": kpa + noise_kpa * rng.standard_normal(len(t)),
                "force_n": np.where(read > 0.8 * TOP_N, np.nan, read),
            }))  # fmt: skip
    folder.mkdir()
    pd.DataFrame(trials).to_csv(folder / "trials.csv", index=False)
    pd.concat(samples).to_csv(folder / "samples.csv", index=False)
    return read_dataset(folder)


TOP_N = float(braid_force(3e5, 70e-3, nominal().braid_length_m, nominal().turns))


@pytest.mark.parametrize("noise_kpa", [0.3, 0.6, 1.0])
def test_a_noisy_pressure_is_no_fault_of_the_recording(tmp_path: Path, noise_kpa: float) -> None:
    verdict = diagnose(isometric(tmp_path / "set", noise_kpa))
    assert verdict.status is Status.NO_GAP_ABOVE_FLOOR, verdict.reason
