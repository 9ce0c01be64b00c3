"""Friction of a cylinder that is not the built-in plant: found, with its size and its growth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest

from gap.data.dataset import DataSet
from gap.data.reader import read_dataset
from gap.data.simulator import Parameter
from gap.decision.diagnose import diagnose
from gap_simulators import StaticBraid

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Cylinder(StaticBraid):
    """Piston area times gauge pressure."""

    def force_n(
        self, pressure_kpa: Array, length_mm: Array, parameters: Mapping[str, float]
    ) -> Array:
        return parameters["area_mm2"] * pressure_kpa * 1e-3 + parameters["offset_n"]


def rubbing_cylinder(folder: Path, at_rest_n: float, n_per_kpa: float) -> DataSet:
    """Moved out and back at held pressures, at two speeds, three times each."""
    rng = np.random.default_rng(1)
    trials, samples = [], []
    for kpa in (100.0, 300.0, 500.0):
        for way_s in (2.0, 6.0):
            for replicate in (1, 2, 3):
                name = f"{kpa:g} kPa, {way_s:g} s, {replicate}"
                t = np.arange(0.0, 2.0 * way_s, 0.02)
                x = 100.0 + 20.0 * (1.0 - np.abs(t / way_s - 1.0))
                way = np.sign(np.diff(x, prepend=x[0]))
                noise = 0.2 * rng.standard_normal() + 0.05 * rng.standard_normal(len(t))
                p = kpa + 0.3 * rng.standard_normal() + 0.1 * rng.standard_normal(len(t))
                trials.append({"trial": name, "slot": f"{kpa:g} kPa, {way_s:g} s",
                               "replicate": replicate, "protocol": "triangle"})  # fmt: skip
                samples.append(pd.DataFrame({
                    "trial": name, "time_s": t, "pressure_kpa": p,
                    "length_mm": x + 0.003 * rng.standard_normal(len(t)),
                    "force_n": 0.49 * kpa + (at_rest_n + n_per_kpa * kpa) * way + noise,
                }))  # fmt: skip
    folder.mkdir()
    pd.DataFrame(trials).to_csv(folder / "trials.csv", index=False)
    pd.concat(samples).to_csv(folder / "samples.csv", index=False)
    law = Cylinder((Parameter("area_mm2", 490.0, 10.0), Parameter("offset_n", 0.0, 5.0)))
    return replace(read_dataset(folder), simulator=law)


def test_coulomb_friction_that_grows_with_pressure_is_found_with_its_size(tmp_path: Path) -> None:
    verdict = diagnose(rubbing_cylinder(tmp_path / "set", at_rest_n=4.0, n_per_kpa=0.004))
    assert verdict.status.explained
    assert verdict.effects[0].ids == ("braid_friction",)
    friction = verdict.effects[0].parameters["friction_n"]
    assert friction.value == pytest.approx(5.2, rel=0.03)  # at 300 kPa
    growth = verdict.effects[0].parameters["growth_n_kpa"]
    assert growth.value == pytest.approx(0.004, rel=0.1)
    assert growth.low is not None
    assert growth.high is not None
    assert 0.0 < growth.low < 0.004 < growth.high < 5.2 / 300.0
    assert verdict.gap is not None
    assert verdict.gap.closed is not None
    assert verdict.gap.closed > 0.95
