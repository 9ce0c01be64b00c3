"""A sensor whose scale changes over its range: no plain scale, and still the sensor's.

Found on withheld benches (711, 741) and by a generator that is not ours: such a load cell was
unknown, or was given another effect's name.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gap.data.dataset import DataSet
from gap.data.reader import read_dataset
from gap.decision.diagnose import diagnose
from gap.effects.terms import Active
from gap.model import force as laws
from plant.constants import nominal
from plant.effects.arguments import Context
from plant.effects.sensors.linearity import POWERS, linearity

CONTEXT = Context(nominal(), np.zeros(1), full_n=80.0, full_pa=600e3)
AMOUNTS = st.floats(-10.0, 10.0)
BENDS = st.floats(*POWERS)


@given(AMOUNTS, BENDS)
def test_at_the_full_value_the_scale_is_off_by_what_is_stated(percent: float, power: float) -> None:
    bent: Active = [("force_gain", "", percent, {"power": power})]
    force = np.array([0.0, 80.0, -80.0])
    shown = laws.force_read(force, bent, CONTEXT)
    second_order = 3.0 * (percent / 100.0) ** 2
    assert np.abs(shown - force * (1.0 + percent / 100.0)).max() <= 80.0 * 1.5 * second_order


@given(AMOUNTS, BENDS, st.floats(-3.0, 3.0))
def test_a_force_read_and_taken_back_is_the_force(
    percent: float, power: float, zero: float
) -> None:
    bent: Active = [
        ("force_gain", "", percent, {"power": power}), ("force_gain", "", -2.0, {}),
        ("force_zero", "", zero, {}),
    ]  # fmt: skip
    force = np.linspace(-5.0, 80.0, 40)
    back = laws.force_true(laws.force_read(force, bent, CONTEXT), bent, CONTEXT)
    assert back == pytest.approx(force, abs=0.05)


@given(AMOUNTS, BENDS)
def test_a_gauge_is_straightened_as_it_bends(percent: float, power: float) -> None:
    bent: Active = [("pressure_gain", "", percent, {"power": power})]
    p = np.linspace(0.0, 600e3, 40)
    shown = laws.gauge_shows(p, bent, CONTEXT)
    assert laws.gauge_straightened(shown, bent, CONTEXT) == pytest.approx(p, abs=100.0)
    assert shown[-1] == pytest.approx(600e3)  # the straight part has the whole error there


def test_a_power_of_nothing_is_a_straight_scale() -> None:
    assert np.all(linearity(np.linspace(-1.0, 9.0, 5), 9.0, 0.0) == 0.0)


def cell_that_saturates(folder: Path, percent: float) -> DataSet:
    """A nominal muscle at three lengths; the cell loses ever more of a larger force."""
    c = nominal()
    rng = np.random.default_rng(5)
    trials, samples = [], []
    for mm in (56.0, 60.0, 64.0, 68.0):
        for replicate in (1, 2, 3):
            kpa = np.repeat(np.linspace(50.0, 500.0, 10), 40) + 0.3 * rng.standard_normal()
            t = np.arange(len(kpa)) * 0.05
            pull = kpa * 1e3 * (3e-6 * mm**2 - c.braid_length_m**2) / (4 * np.pi * c.turns**2)
            # Not the diagnosis's power: a parabola on top of a straight scale.
            read = pull * (1.0 - percent / 100.0 * pull / 60.0)
            trials.append({"trial": f"{mm} {replicate}", "slot": f"{mm:g}", "replicate": replicate,
                           "protocol": "isometric", "held_length_mm": mm})  # fmt: skip
            samples.append(pd.DataFrame({
                "trial": f"{mm} {replicate}", "time_s": t,
                "pressure_kpa": kpa + 0.1 * rng.standard_normal(len(t)),
                "force_n": read + 0.1 * rng.standard_normal() + 0.05 * rng.standard_normal(len(t)),
            }))  # fmt: skip
    folder.mkdir()
    pd.DataFrame(trials).to_csv(folder / "trials.csv", index=False)
    pd.concat(samples).to_csv(folder / "samples.csv", index=False)
    return read_dataset(folder)


def test_a_cell_that_loses_ever_more_of_a_force_is_not_taken_for_another_effect(
    tmp_path: Path,
) -> None:
    verdict = diagnose(cell_that_saturates(tmp_path / "set", percent=6.0))
    assert verdict.effects
    assert verdict.effects[0].ids == ("force_gain",)
