"""Simulators from elsewhere: what a description opens, and what it predicts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gap.data.simulator import FORCE_STAGE, ExternalSimulator, StaticForce
from gap.data.trial import Channel
from gap.simulators.cached import Cached
from gap.simulators.inputs import time_axis, wanted_times
from gap.simulators.law import parameter_name
from gap.simulators.open import describe, open_simulator, stated_effects
from gap.simulators.surface import Surface
from plant.models import catalogue
from simulator_files import (
    CHAMBER_FMU,
    FMU,
    FORCE,
    STATIC,
    built_fmu,
    chamber_kpa,
    chou_hannaford,
    trial,
    valve_trial,
    write,
)

PRESSURE = np.array([0.0, 100.0, 350.0])
LENGTH = np.array([55.0, 60.0, 67.5])
RAMP = trial(
    {
        "pressure_kpa": (np.arange(0.0, 5.0, 0.01), 100.0 * np.arange(0.0, 5.0, 0.01)),
        "force_n": (np.arange(0.004, 4.9, 0.05), np.zeros(98)),
    }
)


def static_force(opened: ExternalSimulator) -> StaticForce:
    assert isinstance(opened, StaticForce)
    return opened


@pytest.fixture(params=["python", "fmi 2", "fmi 3"])
def muscle(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """The same muscle as a Python function and as an FMU of either standard."""
    if request.param == "python":
        return write(tmp_path, simulator_toml=STATIC, muscle_py=FORCE)
    built_fmu(tmp_path, int(request.param[-1]))
    return write(tmp_path, simulator_toml=FMU.replace("stages", "static = true\nstages", 1))


def test_a_static_simulator_gives_force_at_any_point(muscle: Path) -> None:
    opened = open_simulator(muscle)
    force = static_force(opened).force_n(PRESSURE, LENGTH, {})
    assert force == pytest.approx(chou_hannaford(PRESSURE, LENGTH), rel=1e-12)
    assert [s.name for s in opened.stages] == ["force"]
    assert [(p.name, p.nominal, p.tolerance) for p in opened.parameters] == [
        ("braid_length_mm", 85.0, 0.3), ("turns", 1.75, 0.01),
    ]  # fmt: skip
    assert opened.origin == str(muscle)
    assert opened.covariance is None
    assert opened.model_error_n == 0.0


def test_parameters_are_in_the_units_of_their_names(muscle: Path) -> None:
    force = static_force(open_simulator(muscle)).force_n(PRESSURE, LENGTH, {"braid_length_mm": 84})
    assert force == pytest.approx(chou_hannaford(PRESSURE, LENGTH, b_mm=84.0), rel=1e-12)


def test_a_parameter_that_it_does_not_have_is_a_key_error(muscle: Path) -> None:
    opened = open_simulator(muscle)
    with pytest.raises(KeyError, match="dead_volume_ml"):
        opened.simulate(RAMP, {"dead_volume_ml": 1.0})
    with pytest.raises(KeyError, match="dead_volume_ml"):
        static_force(opened).force_n(PRESSURE, LENGTH, {"dead_volume_ml": 1.0})


def test_force_is_predicted_where_it_was_measured(muscle: Path) -> None:
    made = open_simulator(muscle).simulate(RAMP, {})
    assert list(made) == ["force"]
    t = RAMP["force_n"].time_s
    assert made["force"].time_s == pytest.approx(t)
    assert made["force"].value == pytest.approx(chou_hannaford(100.0 * t, np.full(98, 60.0)))


def test_the_same_values_give_the_same_prediction_to_the_bit(muscle: Path) -> None:
    first, second = open_simulator(muscle), open_simulator(muscle)
    moved = first.simulate(RAMP, {"turns": 1.8})["force"].value
    once = first.simulate(RAMP, {})["force"].value
    assert (second.simulate(RAMP, {})["force"].value == once).all()
    assert not np.allclose(moved, once)


def test_the_force_of_a_hung_load_is_predicted_where_the_camera_saw_it(muscle: Path) -> None:
    seen = np.arange(0.0, 4.0, 0.02)
    hung = trial(
        {
            "pressure_kpa": ([0.0, 4.0], [0.0, 400.0]),
            "length_mm": (seen, 70.0 - 2.0 * seen),
        },
        held_mm=float("nan"), load_kg=2.0,
    )  # fmt: skip
    made = open_simulator(muscle).simulate(hung, {})["force"]
    assert made.time_s == pytest.approx(seen)
    assert made.value == pytest.approx(chou_hannaford(100.0 * seen, 70.0 - 2.0 * seen))


def test_a_trial_without_the_inputs_of_a_stage_has_no_prediction(muscle: Path) -> None:
    blind = trial({"force_n": ([0.0, 1.0], [0.0, 0.0])})
    assert open_simulator(muscle).simulate(blind, {}) == {}


def test_settled_points_are_predicted_row_by_row(muscle: Path) -> None:
    rows = trial({"pressure_kpa": ([0, 1, 3], PRESSURE), "force_n": ([0, 1, 3], PRESSURE)},
                 settled=True)  # fmt: skip
    made = open_simulator(muscle).simulate(rows, {})["force"].value
    assert made == pytest.approx(chou_hannaford(PRESSURE, np.full(3, 60.0)))


# With memory


CHAMBER = '''
import numpy as np


def chamber(inputs, parameters):
    """Exact solution of dP/dt = r (inlet (supply - P) - outlet P), step by step."""
    t = inputs["time_s"]
    pressure = np.empty(len(t))
    pressure[0] = 0.0
    for k in range(1, len(t)):
        rate = parameters["rate_per_s"] * (inputs["inlet_cmd"][k-1] + inputs["outlet_cmd"][k-1])
        end = inputs["supply_kpa"][k-1] * inputs["inlet_cmd"][k-1]
        grown = 1.0 - np.exp(-rate * (t[k] - t[k-1]))
        pressure[k] = pressure[k-1] + (end - pressure[k-1]) * grown
    return RETURN
'''
DYNAMIC = """
kind = "python"
function = "chamber.py:chamber"
stages = ["pressure"]

[parameters.rate_per_s]
nominal = 5.0
tolerance = 0.5
"""


@pytest.fixture(params=["array", "dict", "fmi 2", "fmi 3"])
def chamber(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """The same chamber as a function that returns an array or a dict, and as an FMU."""
    if request.param.startswith("fmi"):
        built_fmu(tmp_path, int(request.param[-1]))
        return write(tmp_path, simulator_toml=CHAMBER_FMU)
    returned = {"array": "pressure", "dict": '{"pressure_kpa": pressure, "other": 1}'}
    text = CHAMBER.replace("RETURN", returned[request.param])
    return write(tmp_path, simulator_toml=DYNAMIC, chamber_py=text)


def test_edges_of_commands_stand_where_they_were_recorded(chamber: Path) -> None:
    """The inlet closes at 1.2503 s, between samples and between steps."""
    opened = open_simulator(chamber)
    assert not isinstance(opened, StaticForce)
    made = opened.simulate(valve_trial(), {})
    assert list(made) == ["pressure"]
    t = made["pressure"].time_s
    assert t == pytest.approx(valve_trial()["pressure_kpa"].time_s)
    assert made["pressure"].value == pytest.approx(chamber_kpa(t), rel=1e-3, abs=1e-6)
    held = (t > 2.0) & (t < 4.0)
    assert made["pressure"].value[held] == pytest.approx(chamber_kpa(t)[held], rel=1e-9)


def test_a_simulator_with_memory_takes_its_parameters(chamber: Path) -> None:
    made = open_simulator(chamber).simulate(valve_trial(), {"rate_per_s": 4.0})["pressure"]
    assert made.value[-1] == pytest.approx(chamber_kpa(made.time_s, rate=4.0)[-1], rel=1e-9)


def test_a_supply_that_was_not_measured_may_be_stated(chamber: Path) -> None:
    text = chamber.read_text() + "\n[inputs]\nsupply_kpa = 450.0\n"
    chamber.write_text(text)
    made = open_simulator(chamber).simulate(valve_trial(supply=False), {})["pressure"]
    assert made.value[-1] == pytest.approx(chamber_kpa(made.time_s, supply=450.0)[-1], rel=1e-9)


INPUTS = """
import numpy as np

SEEN = []


def record(inputs, parameters):
    SEEN.append({name: np.shape(value) for name, value in inputs.items()})
    return {"pressure_kpa": inputs["time_s"], "force_n": inputs["time_s"]}
"""


def test_a_stage_is_fed_with_its_own_inputs_and_no_others(tmp_path: Path) -> None:
    text = 'kind = "python"\nfunction = "seen.py:record"\nstages = ["pressure", "force"]\n'
    opened = open_simulator(write(tmp_path, simulator_toml=text, seen_py=INPUTS))
    made = opened.simulate(valve_trial(), {})
    assert list(made) == ["pressure", "force"]
    assert made["force"].value == pytest.approx(made["force"].time_s)
    module = opened._functions["force"]._function.__globals__  # type: ignore[attr-defined]
    chamber, muscle = module["SEEN"]
    assert set(chamber) == {"time_s", "supply_kpa", "inlet_cmd", "outlet_cmd", "length_mm",
                            "temperature_c", "pressure_start_kpa"}  # fmt: skip
    assert set(muscle) == {"time_s", "pressure_kpa", "length_mm", "temperature_c"}
    for seen in (chamber, muscle):
        assert len(set(seen.values())) == 1, "every input has the shape of time_s"


def test_each_stage_may_have_a_function_of_its_own(tmp_path: Path) -> None:
    text = (
        'kind = "python"\nstages = ["force", "pressure"]\n'
        '[function]\npressure = "a.py:one"\nforce = "a.py:two"\n'
    )
    code = (
        "def one(i, p):\n return i['time_s'] * 0 + 1\ndef two(i, p):\n return i['time_s'] * 0 + 2"
    )
    made = open_simulator(write(tmp_path, simulator_toml=text, a_py=code)).simulate(
        valve_trial(), {}
    )
    assert {name: channel.value[0] for name, channel in made.items()} == {
        "pressure": 1.0, "force": 2.0,
    }  # fmt: skip


def test_steps_are_no_longer_than_stated() -> None:
    sources = {"pressure_kpa": Channel(np.array([0.0, 1.0]), np.zeros(2))}
    axis = time_axis(sources, np.array([0.25]), 0.1)
    assert np.diff(axis).max() <= 0.1 + 1e-12
    assert np.isin([0.0, 0.25, 1.0], axis).all()
    assert time_axis(sources, np.array([0.25]), 0.0).tolist() == [0.0, 0.25, 1.0]


def test_a_simulation_with_memory_runs_once_for_each_trial_and_value(chamber: Path) -> None:
    opened, measured = open_simulator(chamber), valve_trial()
    one = opened.simulate(measured, {})["pressure"].value
    assert opened.simulate(measured, {"rate_per_s": 5.0})["pressure"].value is one
    assert opened.simulate(measured, {"rate_per_s": 5.1})["pressure"].value is not one
    assert opened.simulate(valve_trial(), {})["pressure"].value is not one


def test_what_is_kept_has_a_limit() -> None:
    kept, made = Cached(most_bytes=3 * 8 * 100), []

    def make() -> dict[str, Channel]:
        made.append(1)
        return {"force": Channel(np.zeros(100), np.zeros(100))}

    for value in (1.0, 2.0, 3.0, 4.0, 4.0, 1.0):
        kept.get(RAMP, {"x": value}, make)
    assert len(made) == 5, "the fourth drops the first, which is made again"


# Tables


def test_a_table_of_predictions_is_read_at_the_measured_times(tmp_path: Path) -> None:
    pd.DataFrame(
        {"trial": "t1", "time_s": np.arange(0.0, 5.1, 0.5), "force_n": 2.0 * np.arange(11.0)}
    ).to_csv(tmp_path / "predicted.csv", index=False)
    text = 'kind = "predictions"\ntable = "predicted.csv"\nstages = ["force"]\n'
    made = open_simulator(write(tmp_path, simulator_toml=text)).simulate(RAMP, {})["force"]
    assert made.value == pytest.approx(4.0 * RAMP["force_n"].time_s)


def test_tables_one_tolerance_away_make_a_parameter(tmp_path: Path) -> None:
    for name, b in (("mid", 85.0), ("high", 85.4), ("low", 84.6)):
        t = RAMP["force_n"].time_s
        force = chou_hannaford(100.0 * t, np.full(len(t), 60.0), b_mm=b)
        pd.DataFrame({"trial": "t1", "time_s": t, "force_n": force}).to_parquet(
            tmp_path / f"{name}.parquet"
        )
    text = (
        'kind = "predictions"\ntable = "mid.parquet"\nstages = ["force"]\n'
        "[parameters.braid_length_mm]\nnominal = 85.0\ntolerance = 0.4\n"
        'table_high = "high.parquet"\ntable_low = "low.parquet"\n'
    )
    opened = open_simulator(write(tmp_path, simulator_toml=text))
    made = opened.simulate(RAMP, {"braid_length_mm": 85.3})["force"].value
    t = RAMP["force_n"].time_s
    # The force is a parabola in b, and so is what goes through the three tables.
    assert made == pytest.approx(chou_hannaford(100.0 * t, np.full(98, 60.0), b_mm=85.3))


def surface(folder: Path, scattered: bool) -> Path:
    if scattered:
        rng = np.random.default_rng(3)
        corners = np.array([[0, 50], [0, 70], [600, 50], [600, 70]], dtype=float)
        p, length = np.vstack([corners, rng.uniform([0, 50], [600, 70], (400, 2))]).T
    else:
        p, length = (a.ravel() for a in np.meshgrid(np.arange(0.0, 601, 50),
                                                    np.arange(50.0, 70.5, 2.0)))  # fmt: skip
    folder.mkdir(exist_ok=True)
    pd.DataFrame(
        {"pressure_kpa": p, "length_mm": length, "force_n": chou_hannaford(p, length)}
    ).to_csv(folder / "surface.csv", index=False)
    return write(folder, simulator_toml='kind = "surface"\ntable = "surface.csv"\n')


@pytest.mark.parametrize("scattered", [False, True])
def test_a_surface_is_interpolated(scattered: bool, tmp_path: Path) -> None:
    opened = open_simulator(surface(tmp_path, scattered))
    force = static_force(opened).force_n(PRESSURE, LENGTH, {})
    assert force == pytest.approx(chou_hannaford(PRESSURE, LENGTH), abs=0.3)
    assert force.shape == PRESSURE.shape


@pytest.mark.parametrize("scattered", [False, True])
def test_a_surface_goes_on_a_little_beyond_its_table(scattered: bool, tmp_path: Path) -> None:
    """The zero of a sensor moves points over the edge during a fit."""
    opened = static_force(open_simulator(surface(tmp_path, scattered)))
    p, length = np.array([-5.0, 605.0, 300.0]), np.array([60.0, 60.0, 70.3])
    assert opened.force_n(p, length, {}) == pytest.approx(chou_hannaford(p, length), abs=1.5)
    # A zero of 15 kPa and more is tried as well: that ended diagnoses of minutes with an error.
    far = np.array([-40.0, 720.0])
    line = opened.force_n(far, np.full(2, 60.0), {})
    assert line == pytest.approx(chou_hannaford(far, np.full(2, 60.0)), abs=6.0)


# Laws


@pytest.mark.parametrize("name", ["chou-hannaford", "liner-braid", "quasi-static"])
def test_a_fitted_law_is_a_force_stage(name: str, tmp_path: Path) -> None:
    model = catalogue.get(name)
    path = tmp_path / "model.toml"
    path.write_text(catalogue.to_toml(model))
    opened = open_simulator(path)
    force = static_force(opened).force_n(PRESSURE, LENGTH, {})
    assert force == pytest.approx(model.force(PRESSURE * 1e3, LENGTH * 1e-3, outside="ignore"))
    free = [p for p in model.parameters if not p.fixed]
    assert [p.nominal for p in opened.parameters] == [p.value for p in free]
    assert [p.tolerance for p in opened.parameters] == [p.sd or 0.0 for p in free]


def test_names_of_a_law_carry_their_units(tmp_path: Path) -> None:
    path = write(tmp_path, simulator_toml='kind = "law"\nmodel = "liner-braid"\n')
    opened = open_simulator(path)
    assert [p.name for p in opened.parameters] == [
        "braid_length_mm", "turns", "stiffness_n_per_mm", "bladder_rest_length_mm",
        "threshold_kpa", "threshold_slope_kpa_per_mm", "width_kpa",
    ]  # fmt: skip
    longer = static_force(opened).force_n(PRESSURE, LENGTH, {"braid_length_mm": 86.0})
    model = catalogue.get("liner-braid").with_values({"braid_length": 86.0})
    assert longer == pytest.approx(model.force(PRESSURE * 1e3, LENGTH * 1e-3, outside="ignore"))
    assert parameter_name("slope", "N/(kPa mm^3)") == "slope_n_per_kpa_mm3"


def test_a_law_with_memory_is_run_along_a_trial(tmp_path: Path) -> None:
    path = write(tmp_path, simulator_toml='kind = "law"\nmodel = "prandtl-ishlinskii"\n')
    opened = open_simulator(path)
    assert not isinstance(opened, StaticForce)
    t = np.linspace(0.0, 4.0, 41)
    up_down = trial({"pressure_kpa": (t, 300.0 * np.minimum(t, 4.0 - t) / 2.0), "force_n": (t, t)})
    force = opened.simulate(up_down, {})["force"].value
    assert abs(force[10] - force[30]) > 0.1, "up and down differ at one pressure"


# Priors and what is written back


def test_a_covariance_holds_for_the_parameters_that_it_names(tmp_path: Path) -> None:
    text = STATIC.replace("nominal = 1.75\ntolerance = 0.01", "nominal = 1.75")
    text += "[parameters.extra]\nnominal = 0.0\ntolerance = 2.0\n"
    text += '[covariance]\nnames = ["turns", "braid_length_mm"]\n'
    text += "matrix = [[4e-4, 3e-3], [3e-3, 0.09]]\n"
    opened = open_simulator(write(tmp_path, simulator_toml=text, muscle_py=FORCE))
    assert opened.covariance == pytest.approx(
        np.array([[0.09, 3e-3, 0.0], [3e-3, 4e-4, 0.0], [0.0, 0.0, 4.0]])
    )
    assert [p.tolerance for p in opened.parameters] == pytest.approx([0.3, 0.02, 2.0])


def test_an_improved_simulator_is_written_back_and_opened_again(muscle: Path) -> None:
    muscle.write_text(muscle.read_text() + "\n[effects.force_zero]\noffset_n = 1.5\n")
    opened = open_simulator(muscle)
    out = muscle.parent / "elsewhere" / "improved.toml"
    out.parent.mkdir()
    text = describe(
        opened, {"turns": 1.76}, {"pressure_zero": {"offset_kpa": 2.0}}, folder=out.parent
    )
    out.write_text(text)
    again = open_simulator(out)
    assert [(p.name, p.nominal, p.tolerance) for p in again.parameters] == [
        ("braid_length_mm", 85.0, 0.3), ("turns", 1.76, 0.01),
    ]  # fmt: skip
    assert static_force(again).force_n(PRESSURE, LENGTH, {}) == pytest.approx(
        chou_hannaford(PRESSURE, LENGTH, n=1.76)
    )
    assert set(stated_effects(out).values) == {"force_zero", "pressure_zero"}
    assert str(muscle.parent) not in text, "files are named relative to the new place"
    with pytest.raises(KeyError):
        describe(opened, {"turn": 1.0})


@pytest.mark.parametrize("kind", ["law", "predictions", "surface", "chamber"])
def test_every_kind_is_written_back(kind: str, tmp_path: Path) -> None:
    if kind == "law":
        path = tmp_path / "model.toml"
        path.write_text(catalogue.to_toml(catalogue.get("chou-hannaford")))
    elif kind == "surface":
        path = surface(tmp_path, scattered=False)
    elif kind == "chamber":
        code = CHAMBER.replace("RETURN", "pressure")
        path = write(tmp_path, simulator_toml=DYNAMIC, chamber_py=code)
    else:
        pd.DataFrame({"trial": ["t1"], "time_s": [0.0], "force_n": [1.0]}).to_csv(
            tmp_path / "p.csv", index=False
        )
        text = 'kind = "predictions"\ntable = "p.csv"\nstages = ["force"]\nmodel_error_n = 0.5\n'
        path = write(tmp_path, simulator_toml=text)
    opened = open_simulator(path)
    again_at = tmp_path / "again.toml"
    again_at.write_text(describe(opened, {}, folder=tmp_path))
    again = open_simulator(again_at)
    assert again.parameters == opened.parameters
    assert again.stages == opened.stages
    assert again.model_error_n == opened.model_error_n


def test_nothing_is_wanted_where_nothing_was_measured() -> None:
    assert wanted_times(trial({"pressure_kpa": ([0.0], [0.0])}), FORCE_STAGE) is None


@pytest.mark.parametrize("scattered", [False, True])
def test_a_surface_knows_how_far_it_may_be_off_between_its_points(
    scattered: bool, tmp_path: Path
) -> None:
    """A corner between two points, where a muscle goes slack, is what a coarse table misses."""

    def table(step: float) -> Surface:
        rng = np.random.default_rng(3)
        p, x = (
            a.ravel() for a in np.meshgrid(np.arange(0.0, 601.0, step), np.linspace(50.0, 70.0, 7))
        )
        if scattered:
            p = np.clip(p + rng.uniform(-0.2, 0.2, len(p)) * step, 0.0, 600.0)
        folder = tmp_path / f"{step:g}"
        folder.mkdir()
        force = np.maximum(p * (x - 45.0) / 100.0 - 20.0, 0.0)
        pd.DataFrame({"pressure_kpa": p, "length_mm": x, "force_n": force}).to_csv(
            folder / "surface.csv", index=False
        )
        opened = open_simulator(
            write(folder, simulator_toml='kind = "surface"\ntable = "surface.csv"\n')
        )
        assert isinstance(opened, Surface)
        return opened

    def missed(surface: Surface) -> float:
        p, x = (a.ravel() for a in np.meshgrid(np.linspace(10, 590, 117), np.linspace(51, 69, 37)))
        true = np.maximum(p * (x - 45.0) / 100.0 - 20.0, 0.0)
        return float(np.sqrt(np.mean((surface.force_n(p, x, {}) - true) ** 2)))

    coarse, fine = table(100.0), table(20.0)
    assert fine.rough_error_n < 0.3 * coarse.rough_error_n
    assert 0.4 < coarse.rough_error_n / missed(coarse) < 4.0
    assert "states no model_error_n" in coarse.notes[0]
