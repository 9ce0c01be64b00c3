"""A cylinder as the nominal plant: SciPy integrates one, and the diagnosis is asked what it lacks.

The chamber is the piston's area times the length of the chamber, and a dead volume; the cylinder
pushes with area times pressure. Nothing of the package's braid is in it.
"""

from __future__ import annotations

from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

from gap.data.reader import read_dataset
from gap.decision.diagnose import diagnose, diagnose_with_fit
from gap.design.library import library_experiments
from gap.errors import GapError
from gap.estimation.fit_problem import FitProblem
from gap.simulators.open import with_simulator
from gap.validation.improved_plant import improved_plant
from gap.verdict import Status
from iso_6358 import mass_flow
from plant.constants import nominal
from plant.effects.effects import Effects
from plant.effects.muscle.braid_friction import after_a_stroke
from plant.errors import PlantError
from plant.finger import FingerSim, load_finger
from plant.simulator.bench import BenchSim
from plant.simulator.simulate import commands, run_commands

Array = npt.NDArray[np.float64]

AREA = 201.06e-6
"""16 mm bore, m2."""
DEAD = 1.5e-6
CONDUCTANCE = 2.5e-10
ATMOSPHERE, SUPPLY = 101325.0, 651325.0
CYLINDER: dict[str, object] = {
    "actuator": "cylinder", "piston_area_mm2": 201.06, "length_min_mm": 5.0, "length_max_mm": 70.0,
    "dead_volume_ml": 1.5, "inlet_conductance_m3_s_pa": CONDUCTANCE,
    "outlet_conductance_m3_s_pa": CONDUCTANCE, "inlet_on_ms": 4.0, "inlet_off_ms": 4.0,
    "outlet_on_ms": 4.0, "outlet_off_ms": 4.0, "inlet_on_ms_per_kpa": 0.0,
    "inlet_off_ms_per_kpa": 0.0, "outlet_on_ms_per_kpa": 0.0, "outlet_off_ms_per_kpa": 0.0,
}  # fmt: skip
DELAY_S = 0.004
PULSES = (
    (0.2, 0.5, 1),
    (0.9, 1.3, 1),
    (1.8, 2.2, 1),
    (2.8, 3.0, -1),
    (3.5, 3.8, -1),
    (4.4, 5.2, -1),
)
TIME = np.arange(0.0, 6.0, 0.005)


def stage(middle_mm: float, swing_mm: float) -> Array:
    """Length of the chamber in mm: held, or a triangle of 2 s."""
    return middle_mm + swing_mm * (2.0 * np.abs(2.0 * np.mod(TIME / 2.0 + 0.25, 1.0) - 1.0) - 1.0)


@cache
def pressure(middle_mm: float, swing_mm: float, area: float = AREA, leak: float = 0.0) -> Array:
    """Gauge pressure in kPa of isothermal gas in a chamber whose piston is held or moved."""
    length_mm = stage(middle_mm, swing_mm)
    times = np.unique([0.0, TIME[-1], *(e + DELAY_S for a, b, _ in PULSES for e in (a, b))])

    def rate(t: float, y: Array, valve: int) -> list[float]:
        length = float(np.interp(t, TIME, length_mm)) * 1e-3
        speed = float(np.interp(t + 1e-4, TIME, length_mm) - np.interp(t, TIME, length_mm)) * 10.0
        volume = area * length + DEAD
        gained = mass_flow(CONDUCTANCE, SUPPLY, y[0]) if valve > 0 else 0.0
        way_out = (CONDUCTANCE if valve < 0 else 0.0) + leak
        # A chamber that is drawn below the atmosphere takes air in.
        lost = mass_flow(way_out, y[0], ATMOSPHERE) - mass_flow(way_out, ATMOSPHERE, y[0])
        return [(287.05 * 293.15 * (gained - lost) - y[0] * area * speed) / volume]

    found, at = np.empty(len(TIME)), ATMOSPHERE
    for begin, end in pairwise(times):
        middle = 0.5 * (begin + end) - DELAY_S
        valve = next((s for a, b, s in PULSES if a < middle < b), 0)
        here = (begin <= TIME) & (end >= TIME)
        solved = solve_ivp(rate, (begin, end), [at], args=(valve,), max_step=2e-3, rtol=1e-7,
                           dense_output=True)  # fmt: skip
        found[here] = solved.sol(TIME[here])[0]
        at = float(solved.y[0, -1])
    return np.asarray((found - ATMOSPHERE) * 1e-3)


def seals(length_mm: Array) -> Array:
    """Friction of the seals, -1 to 1: they bend by 0.1 mm either way, then slide (Dahl 1968)."""
    bent = np.zeros(len(length_mm))
    for k, step in enumerate(np.diff(length_mm), 1):
        bent[k] = np.clip(bent[k - 1] + step / 0.1, -1.0, 1.0)
    return bent


def written(folder: Path, trials: list[dict[str, object]], samples: list[pd.DataFrame]) -> Path:
    """A data set of a bench as stated."""
    folder.mkdir(parents=True)
    pd.DataFrame(trials).to_csv(folder / "trials.csv", index=False)
    pd.concat(samples).to_csv(folder / "samples.csv", index=False)
    write_bench(folder, CYLINDER)
    return folder


def cut_strokes(folder: Path) -> Path:
    """Strokes at four pressures that a regulator holds, cut out of one recording each.

    As measured on the cylinder of E. Zillen: friction of the seals 3 N and 0.008 N/kPa more, out at
    8 to 11 mm/s and back at 13, a laser that jumps in one reading of fifty, part of a stroke first.
    """
    rng = np.random.default_rng(5)
    trials: list[dict[str, object]] = []
    samples = []
    for bar in (1, 3, 5, 7):
        out_s = 40.0 / (11.5 - 0.5 * bar)
        period_s = out_s + 40.0 / 13.0
        t = np.arange(0.0, 5.0 * period_s, 0.01)
        length = 10.0 + np.interp(
            np.mod(t + out_s + 1.0, period_s), [0, out_s, period_s], [0, 40, 0]
        )
        kpa = 100.0 * bar + rng.standard_normal(len(t))
        pull = -AREA * 1e3 * kpa + (3.0 + 0.008 * kpa) * seals(length)
        laser = length + 0.015 * rng.standard_normal(len(t))
        laser[rng.integers(5, 80) :: 50] += 0.35
        begins = [0.0, *(np.arange(1, 5) * period_s + period_s - out_s - 1.0 - period_s)]
        for replicate, (a, b) in enumerate(pairwise([*begins, t[-1]]), 1):
            name, here = f"{bar} bar {replicate}", (t >= a) & (t < b)
            trials.append({"trial": name, "slot": f"{bar} bar", "replicate": replicate,
                           "protocol": "triangle"})  # fmt: skip
            columns = {
                "trial": name, "time_s": t[here] - a, "pressure_kpa": kpa[here],
                "force_n": pull[here] + 0.15 * rng.standard_normal(int(here.sum())),
                "length_mm": laser[here],
            }  # fmt: skip
            samples.append(pd.DataFrame(columns))
    return written(folder, trials, samples)


def write_bench(folder: Path, stated: dict[str, object]) -> None:
    """State the constants of a bench."""
    lines = [f'{k} = "{v}"' if isinstance(v, str) else f"{k} = {v}" for k, v in stated.items()]
    (folder / "bench.toml").write_text("\n".join(lines) + "\n")


def recorded(folder: Path, area: float = AREA, leak: float = 0.0, friction_n: float = 0.0) -> Path:
    """Three held lengths and two moved ones, three replicates each, in the dataset format."""
    rng = np.random.default_rng(3)
    trials: list[dict[str, object]] = []
    samples = []
    for slot, (middle, swing) in enumerate([(15, 0), (35, 0), (60, 0), (35, 1), (40, 25)]):
        length = stage(middle, swing)
        kpa = pressure(middle, swing, area, leak)
        pull = -area * 1e3 * kpa + friction_n * seals(length)
        told = [[float(any(a <= t < b and s == sign for a, b, s in PULSES)) for t in TIME]
                for sign in (1, -1)]  # fmt: skip
        for replicate in range(3):
            name = f"{slot} {replicate}"
            trials.append({"trial": name, "slot": str(slot), "replicate": replicate,
                           "protocol": "triangle" if swing else "isometric",
                           "held_length_mm": None if swing else middle,
                           "order": len(trials) + 1})  # fmt: skip
            zeros = 0.2 * rng.standard_normal(2)
            columns = {
                "trial": name, "time_s": TIME, "inlet_cmd": told[0], "outlet_cmd": told[1],
                "pressure_kpa": kpa + zeros[0] + 0.3 * rng.standard_normal(len(TIME)),
                "force_n": pull + 0.3 * zeros[1] + 0.1 * rng.standard_normal(len(TIME)),
                "length_mm": length + 0.01 * rng.standard_normal(len(TIME)),
            }  # fmt: skip
            samples.append(pd.DataFrame(columns))
    return written(folder, trials, samples)


def test_the_bench_fills_a_cylinder_as_scipy_does() -> None:
    c = nominal().with_overrides(CYLINDER)
    edges = [(t, "inlet" if sign > 0 else "outlet", float(on)) for a, b, sign in PULSES
             for t, on in ((a, 1.0), (b, 0.0))]  # fmt: skip
    traces = run_commands(c, commands(edges), float(TIME[-1]), length_m=0.035, rate_hz=200.0)
    expected = pressure(35, 0)
    assert np.ptp(expected) > 300.0
    assert traces.pressure_kpa == pytest.approx(expected, abs=0.05)
    assert traces.force_n == pytest.approx(-AREA * 1e3 * traces.pressure_kpa, abs=0.001)


def test_a_sealed_cylinder_is_a_gas_spring() -> None:
    sim = BenchSim(nominal().with_overrides(CYLINDER), length_m=0.030)
    sim.set_pressure(200.0)
    sim.set_length_rate(-10.0)
    sim.advance(1.0)
    gas = (ATMOSPHERE + 2e5) * (AREA * 0.030 + DEAD)
    assert sim.length_mm == pytest.approx(20.0)
    expected = (gas / (AREA * 0.020 + DEAD) - ATMOSPHERE) * 1e-3
    assert sim.pressure_kpa == pytest.approx(expected, rel=1e-5)


def test_a_cylinder_as_stated_has_no_gap(tmp_path: Path) -> None:
    data = read_dataset(recorded(tmp_path / "set"))
    assert not data.notes
    assert diagnose(data).status is Status.NO_GAP_ABOVE_FLOOR


def test_friction_of_the_seals_is_named_and_gone_from_the_improved_cylinder(
    tmp_path: Path,
) -> None:
    folder = recorded(tmp_path / "set", friction_n=3.0)
    verdict, problem, fit = diagnose_with_fit(read_dataset(folder))
    assert verdict.sure == ("braid_friction",)
    found = verdict.effects[0].parameters["friction_n"]
    assert found.value == pytest.approx(3.0, rel=0.1)
    assert problem is not None
    assert fit is not None
    assert {one.protocol for one in library_experiments(problem, fit)} >= {"isobaric", "step"}
    assert "isotonic" not in {one.protocol for one in library_experiments(problem, fit)}
    (folder / "bench.toml").write_text(improved_plant(problem, fit))
    improved = read_dataset(folder)
    assert improved.constants.actuator == "cylinder"
    again = diagnose(improved)
    assert "braid_friction" not in again.sure
    assert verdict.headline_gap is not None
    assert again.headline_gap is not None
    assert again.headline_gap.recalibrated < 0.1 * verdict.headline_gap.recalibrated


PUSH = """def pull(pressure_kpa, length_mm, parameters):
    return -parameters["area_mm2"] * pressure_kpa * 1e-3
"""
SIMULATOR = f"""kind = "python"
function = "push.py:pull"
stages = ["force"]
static = true

[parameters.area_mm2]
nominal = {AREA * 1e6}
tolerance = 2.0
"""


def test_the_same_strokes_against_a_function_of_area_and_pressure(tmp_path: Path) -> None:
    """That it is a cylinder nobody says; what its seals held before is what leaves less."""
    folder = cut_strokes(tmp_path / "set")
    (folder / "bench.toml").unlink()
    (tmp_path / "push.py").write_text(PUSH)
    (tmp_path / "push.toml").write_text(SIMULATOR)
    data = with_simulator(read_dataset(folder), tmp_path / "push.toml")
    verdict, problem, fit = diagnose_with_fit(data)
    assert verdict.effects[0].ids == ("braid_friction",)
    found = verdict.effects[0].parameters
    assert found["friction_n"].value == pytest.approx(5.4, rel=0.1)
    assert found["growth_n_kpa"].value == pytest.approx(0.008, rel=0.1)
    assert problem is not None
    assert fit is not None
    assert fit.candidates[0].shape["held"] == 1.0


def test_seals_hold_from_the_stroke_before_where_a_trial_is_a_stroke_and_nowhere_else() -> None:
    whole = np.r_[np.linspace(0.0, 4.0, 50), np.linspace(4.0, 0.0, 50)]
    middle = np.r_[np.linspace(2.0, 4.0, 50), np.linspace(4.0, 0.0, 50)]
    still = 1e-3 * np.random.default_rng(0).standard_normal(100)
    still[0] = still.min() - 1e-4
    paths = (whole, 4.0 - whole, middle, still, np.empty(0))
    first = np.r_[0, np.cumsum([len(path) for path in paths])].astype(np.int64)
    made, travel = after_a_stroke(first, np.concatenate(paths), np.ones(len(paths), dtype=bool))
    assert np.delete(travel, made[:-1]) == pytest.approx(np.concatenate(paths))
    came = [travel[made[k] + 1] - travel[made[k]] for k in range(4)]
    assert came == pytest.approx([-2.0, 2.0, 0.0, 0.0])


def test_what_has_no_replicates_is_as_noisy_as_the_rest(tmp_path: Path) -> None:
    """A stroke and a half: the noise of a textbook would be four times too small here."""
    problem = FitProblem.of(read_dataset(cut_strokes(tmp_path / "set")))
    rows = problem.rows
    each = np.sqrt(problem.noise.white * rows.samples)
    apart = np.array(["(" in problem.data.trials[k].slot for k in rows.trial.tolist()])
    longer = apart & (rows.samples > 1.1 * rows.samples[~apart].max())
    assert longer.sum() > 100
    assert np.median(each[longer]) == pytest.approx(np.median(each[~apart]), rel=0.2)


def test_what_replicates_do_not_differ_by_is_no_scatter_of_gains(tmp_path: Path) -> None:
    """Gains of cell and gauge that cancel in all else may be of any size, and none is seen."""
    problem = FitProblem.of(read_dataset(cut_strokes(tmp_path / "set")))
    assert float(np.sqrt(problem.floor_variance).max()) < 0.3


def test_friction_that_grows_with_pressure_is_named_in_strokes_cut_from_a_recording(
    tmp_path: Path,
) -> None:
    folder = cut_strokes(tmp_path / "set")
    verdict, problem, fit = diagnose_with_fit(read_dataset(folder))
    assert verdict.sure == ("braid_friction",)
    found = verdict.effects[0].parameters
    assert found["friction_n"].value == pytest.approx(3.0 + 0.008 * 300.0, rel=0.05)
    assert found["growth_n_kpa"].low < 0.008 < found["growth_n_kpa"].high
    assert verdict.notes[-2].endswith("repeats: 1 bar 1, 3 bar 1, 5 bar 1, 7 bar 1")
    assert verdict.notes[-1].endswith("repeats: 1 bar 5, 3 bar 5, 5 bar 5, 7 bar 5")
    assert problem is not None
    assert fit is not None
    (folder / "bench.toml").write_text(improved_plant(problem, fit))
    stated = read_dataset(folder).effects.values["braid_friction"]
    assert stated["pressure_share"] == pytest.approx(0.008 * 300.0 / 5.4, abs=0.03)
    again = diagnose(read_dataset(folder))
    assert "braid_friction" not in again.sure
    assert verdict.headline_gap is not None
    assert again.headline_gap is not None
    assert again.headline_gap.before < 0.05 * verdict.headline_gap.before


@pytest.mark.parametrize("share", [0.0, 0.4, 1.0, 2.0])
def test_seals_hold_what_they_are_pushed_with_and_what_goes_with_the_pressure(
    share: float,
) -> None:
    effects = Effects.from_config(
        {"braid_friction": {"friction_n": 4.0, "travel_mm": 0.1, "pressure_share": share}}
    )
    for kpa in (50.0, 300.0, 450.0):
        sim = BenchSim(nominal().with_overrides(CYLINDER), effects)
        sim.set_pressure(kpa)
        for rate, way in ((5.0, 1.0), (-5.0, -1.0), (0.0, -1.0)):
            sim.set_length_rate(rate)
            sim.advance(0.5)
            holds = 4.0 * max(1.0 - share + share * sim.pressure_kpa / 300.0, 0.0)
            held = sim.force_n + AREA * 1e3 * sim.pressure_kpa
            assert held == pytest.approx(way * holds, abs=0.01)


def test_a_leak_of_a_cylinder_is_named(tmp_path: Path) -> None:
    verdict = diagnose(read_dataset(recorded(tmp_path / "set", leak=2e-12)))
    assert verdict.sure == ("leak",)
    found = verdict.effects[0].parameters["conductance_m3_s_pa"]
    assert found.value == pytest.approx(2e-12, rel=0.1)


def test_another_bore_is_no_effect_of_a_muscle(tmp_path: Path) -> None:
    verdict = diagnose(read_dataset(recorded(tmp_path / "set", area=1.3 * AREA)))
    assert verdict.status is Status.NOMINAL_UNFIT
    assert "piston_area_mm2" in str(verdict.reason)


def test_a_push_read_as_a_pull_is_remarked(tmp_path: Path) -> None:
    folder = recorded(tmp_path / "set")
    rows = pd.read_csv(folder / "samples.csv")
    rows.assign(force_n=-rows["force_n"]).to_csv(folder / "samples.csv", index=False)
    assert any("a cylinder pushes" in note for note in read_dataset(folder).notes)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"piston_area_mm2": None}, "needs piston_area_mm2"),
        ({"length_max_mm": None}, "needs length_max_mm"),
        ({"braid_length_mm": 80.0}, "braid_length_mm is of a braid"),
        ({"actuator": None}, "piston_area_mm2 is of a cylinder alone"),
        ({"actuator": "bellows"}, "actuator = 'bellows'"),
        ({"piston_area_mm2": 0.0}, "piston_area_mm2"),
    ],
)
def test_half_a_cylinder_is_refused(tmp_path: Path, changed: dict[str, object], said: str) -> None:
    write_bench(tmp_path, {k: v for k, v in {**CYLINDER, **changed}.items() if v is not None})
    with pytest.raises(GapError, match=said):
        read_dataset(tmp_path)


def test_what_is_of_a_braid_is_refused() -> None:
    c = nominal().with_overrides(CYLINDER)
    with pytest.raises(PlantError, match="in place of a cylinder needs braid_length_mm"):
        c.with_overrides({"actuator": "muscle"})
    effects = Effects.from_config({"fibre_stretch": {"stretch_percent": 1.0}})
    with pytest.raises(PlantError, match=r"fibre_stretch: an effect of a braid"):
        BenchSim(c, effects)
    with pytest.raises(PlantError, match="a finger has muscles"):
        FingerSim(load_finger(), c)
