"""A sensor whose scale changes over its range: no plain scale, and still the sensor's.

Found on withheld benches (711, 741) and by a generator that is not ours: such a load cell was
unknown, or was given another effect's name.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from gap.data.dataset import DataSet
from gap.data.reader import read_dataset
from gap.decision.diagnose import diagnose
from gap.effects.terms import Active
from gap.estimation.fit_problem import FitProblem
from gap.model import force as laws
from gap.model.pressure import parameters
from gap.model.residuals import Model
from gap.selection.candidate_fits import _levels
from plant.arrays import Array
from plant.constants import nominal
from plant.effects import pressure_stage as stage
from plant.effects.arguments import Context, Shape
from plant.effects.effects import Effects
from plant.effects.sensors.linearity import CALIBRATION_CURVE, FREE, POWERS, linearity
from plant.simulator.readings import read_force, read_pressure
from tests.gap_bench import write_set

CONTEXT = Context(nominal(), np.zeros(1), full_n=80.0, full_pa=600e3)
AMOUNTS = st.floats(-10.0, 10.0)
BENDS = st.floats(*POWERS)
CURVES = st.fixed_dictionaries({key: st.floats(*FREE[key]) for key in CALIBRATION_CURVE})
SHAPES: st.SearchStrategy[Shape] = st.one_of(st.builds(lambda x: {"power": x}, BENDS), CURVES)


def rises(shown: Array, true: Array) -> bool:
    """Whether a reading still rises with the true value, a quarter as much at least."""
    return bool(np.diff(shown).min() > 0.25 * np.diff(true).max())


@given(AMOUNTS, SHAPES)
def test_at_the_full_value_the_scale_is_off_by_what_is_stated(percent: float, shape: Shape) -> None:
    bent: Active = [("force_gain", "", percent, shape)]
    force = np.array([0.0, 80.0, -80.0])
    assert laws.force_read(force, bent, CONTEXT) == pytest.approx(force * (1.0 + percent / 100.0))


@given(AMOUNTS, SHAPES, st.floats(-3.0, 3.0))
@example(-9.0, {**CALIBRATION_CURVE, "at_3": 4.0, "at_4": 10.0}, 0.0)
def test_a_force_read_and_taken_back_is_the_force(
    percent: float, shape: Shape, zero: float
) -> None:
    """The example is one of which Newton's whole steps went to and fro for ever."""
    bent: Active = [
        ("force_gain", "", percent, shape), ("force_gain", "", -2.0, {}),
        ("force_zero", "", zero, {}),
    ]  # fmt: skip
    force = np.linspace(-5.0, 80.0, 40)
    fine = np.linspace(-10.0, 90.0, 2000)
    assume(rises(laws.force_read(fine, bent, CONTEXT), fine))
    back = laws.force_true(laws.force_read(force, bent, CONTEXT), bent, CONTEXT)
    assert back == pytest.approx(force, abs=0.05)


@given(AMOUNTS, SHAPES)
def test_a_gauge_is_straightened_as_it_bends(percent: float, shape: Shape) -> None:
    bent: Active = [("pressure_gain", "", percent, shape)]
    p = np.linspace(0.0, 600e3, 40)
    fine = np.linspace(0.0, 700e3, 2000)
    assume(rises(laws.gauge_shows(fine, bent, CONTEXT), fine))
    shown = laws.gauge_shows(p, bent, CONTEXT)
    assert laws.gauge_straightened(shown, bent, CONTEXT) == pytest.approx(p, abs=100.0)
    # Very many readings are straightened between nodes.
    many = laws.gauge_straightened(np.tile(shown, 60), bent, CONTEXT)
    assert many == pytest.approx(np.tile(p, 60), abs=100.0)
    assert shown[-1] == pytest.approx(600e3 * (1.0 + percent / 100.0))


def test_no_numbers_are_a_straight_scale() -> None:
    assert np.all(linearity(np.linspace(-1.0, 9.0, 5), 9.0, {}) == 0.0)


def test_a_curve_with_equal_numbers_is_off_by_one_share() -> None:
    value = np.linspace(-9.0, 18.0, 7)
    assert linearity(value, 9.0, CALIBRATION_CURVE) == pytest.approx(value)


@given(AMOUNTS, AMOUNTS, st.floats(-5.0, 5.0), st.floats(-5.0, 5.0))
def test_two_parts_of_one_gauge_add_up(
    first: float, second: float, zero: float, other: float
) -> None:
    """What a calibration, a stated effect and a candidate say of one gauge: the last one counted
    alone where the pressure is predicted, all of them where the force is.
    """
    active: Active = [
        ("pressure_gain", "", first, {}), ("pressure_gain", "", second, {}),
        ("pressure_zero", "", zero, {}), ("pressure_zero", "", other, {}),
        ("pressure_lag", "", 2.0, {}), ("pressure_lag", "", 3.0, {}),
    ]  # fmt: skip
    q = parameters(CONTEXT.constants, active, CONTEXT.constants.supply_pa)
    both = (1.0 + first / 100.0) * (1.0 + second / 100.0)
    assert 1.0 + q[stage.GAIN] == pytest.approx(both)
    assert q[stage.ZERO] == pytest.approx(1e3 * (zero + other), abs=1e-6)
    assert q[stage.LAG] + q[stage.LAG_BEFORE] == pytest.approx(5e-3)


@pytest.mark.parametrize(
    ("numbers", "true", "shown"),
    [
        ({}, 250.0, 275.0),
        ({"power": 1.0}, 250.0, 262.5),
        ({"power": 2.0, "full_kpa": 200.0}, 100.0, 102.5),
        ({"power": 1.0}, 600.0, 672.0),  # what shows too little is loaded beyond its full value
        ({"power": 1.0}, 1000.0, 1150.0),  # beyond half as much again as far off as there
        ({"at_0": 2.0}, 1e-3, 1.2e-3),  # a fifth too much at the foot of the range
        (dict.fromkeys(CALIBRATION_CURVE, 4.0), 250.0, 250.0 * (1.0 + 0.1 * 4.0**0.96875)),
    ],
)
def test_a_plant_file_states_a_scale_that_changes(
    numbers: dict[str, float], true: float, shown: float
) -> None:
    stated = Effects.from_config({"pressure_gain": {"percent": 10.0, **numbers}})
    assert read_pressure(true, stated) == pytest.approx(shown, rel=1e-3)


@given(AMOUNTS, CURVES)
def test_plant_and_diagnosis_read_a_stated_scale_alike(
    percent: float, curve: dict[str, float]
) -> None:
    stated = Effects.from_config({"force_gain": {"percent": percent, "full_n": 70.0, **curve}})
    true = np.linspace(-5.0, 90.0, 30)
    shape = {**curve, "full": 70.0}
    shown = laws.force_read(true, [("force_gain", "", percent, shape)], CONTEXT)
    assert read_force(true, stated) == pytest.approx(shown)


def test_a_curve_needs_readings_in_many_parts_of_the_range(tmp_path: Path) -> None:
    """Through three pressures a curve goes whatever they show."""
    swept = FitProblem.of(cell_that_saturates(tmp_path / "swept", percent=6.0))
    cell = next(s for s in swept.candidates if s.id == "force_gain")
    gauge = next(s for s in swept.candidates if s.id == "pressure_gain")
    assert _levels(swept, cell) >= 6
    assert _levels(swept, gauge) >= 6
    two = np.where(swept.rows.pressure < 2e5, 1e5, 4e5)
    levels = replace(
        swept, model=Model(replace(swept.grid, rows=replace(swept.rows, pressure=two)))
    )
    assert _levels(levels, gauge) == 2


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


def with_a_calibration_table(
    folder: Path, true_kpa: list[float], shown_kpa: list[float]
) -> DataSet:
    """A nominal bench whose gauge shows what a table of calibration points says, straight between.

    The diagnosis has a polynomial.
    """
    write_set(folder, replicates=2)
    samples = pd.read_parquet(folder / "samples.parquet")
    samples["pressure_kpa"] = np.interp(samples["pressure_kpa"], true_kpa, shown_kpa)
    samples.to_parquet(folder / "samples.parquet")
    return read_dataset(folder)


def test_a_gauge_whose_scale_rises_and_falls_is_a_gauge_not_a_valve(tmp_path: Path) -> None:
    """Found on withheld benches (771, 777, 800): `flow_area` was named, or all was open."""
    data = with_a_calibration_table(
        tmp_path / "set", [-100.0, 0.0, 150.0, 300.0, 450.0, 700.0],
        [-112.0, 0.0, 168.0, 342.0, 511.5, 770.0],
    )  # fmt: skip
    verdict = diagnose(data)
    assert [effect.ids for effect in verdict.effects] == [("pressure_gain",)]
    (note,) = [note for note in verdict.notes if note.startswith("pressure_gain changes")]
    told = re.findall(r"([\d.]+) % at (\d+) kPa", note)
    assert len(told) >= 3
    for percent, kpa in told:
        table = np.interp(float(kpa), [150.0, 300.0, 450.0, 700.0], [12.0, 14.0, 13.7, 10.0])
        assert float(percent) == pytest.approx(table, abs=2.0)


def test_a_gauge_that_shows_a_tenth_too_little_has_true_values_beyond_its_largest_reading(
    tmp_path: Path,
) -> None:
    """Withheld bench 1051: the curve stood still at the largest reading, 40 kPa below the largest
    true value; nothing fitted, and a diagnosis took minutes.
    """
    data = with_a_calibration_table(
        tmp_path / "set", [-100.0, 0.0, 100.0, 200.0, 300.0, 400.0, 500.0, 600.0, 700.0],
        [-90.0, 0.0, 87.0, 170.0, 252.0, 336.0, 424.0, 520.0, 626.0],
    )  # fmt: skip
    verdict = diagnose(data)
    assert [effect.ids for effect in verdict.effects] == [("pressure_gain",)]
