"""What a gap without a name looks like: planted residuals are found, chance and bad tables are not.

The planted forces are written here by themselves, with formulas that the diagnosis does not have.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
from typer.testing import CliRunner

from cli.gap.verdicts import shrink_command
from cli.main import app
from gap.check.empirical import line_of, totals
from gap.check.scoring.inputs import TRUE_INPUTS, inputs_right
from gap.data.dataset import DataSet
from gap.data.reader import read_dataset
from gap.errors import GapError
from gap.estimation.cross_validation import HeldOut, held_out
from gap.estimation.fit_problem import FitProblem
from gap.model.features import BLOCKS
from gap.reason import Cause, Reason
from gap.reporting.empirical import empirical_figure, empirical_lines
from gap.validation.config import VALIDATION
from gap.validation.empirical import _closing, _searches, empirical_term
from gap.validation.improved_plant import improved_plant
from gap.validation.terms.search import search_of
from gap.verdict import EmpiricalTerm, Explanation, Status, Verdict
from gap_bench import write_set
from plant.constants import nominal
from plant.effects.effects import NONE
from plant.effects.empirical import (
    FLOW,
    INPUTS,
    READING,
    Correction,
    Corrections,
    SplineTerm,
    spline_columns,
)
from plant.errors import PlantError
from plant.simulator.force_law import ForceLaw

Array = npt.NDArray[np.float64]
Planted = Callable[[Array, float, float, float], Array]
"""Force in N beyond the plant's, from pressure in kPa, length in mm, temperature in C, order."""

PRESSURES = np.linspace(0.0, 500.0, 21)
LENGTHS = (53.0, 55.0, 57.0, 59.0, 61.0, 63.0, 65.0, 67.0, 69.0)


def nothing(p: Array, length: float, celsius: float, order: float) -> Array:
    return np.zeros_like(p)


def waves(p: Array, length: float, celsius: float, order: float) -> Array:
    """Three half waves over the pressures: no entry of the catalogue bends so often."""
    return np.asarray(2.0 * np.sin(3.0 * math.pi * p / 500.0))


def fold(p: Array, length: float, celsius: float, order: float) -> Array:
    """A dip in the middle of the map of pressures and lengths."""
    return np.asarray(-4.0 * np.exp(-(((length - 61.0) / 6.0) ** 2) - ((p - 250.0) / 90.0) ** 2))


def warm(p: Array, length: float, celsius: float, order: float) -> Array:
    """A force of temperature alone, whatever the pressure."""
    return np.full_like(p, 0.4 * (celsius - 21.0))


def worn(p: Array, length: float, celsius: float, order: float) -> Array:
    """A force that grows with the order of the trials, whatever the pressure."""
    return np.full_like(p, 0.08 * order)


def planted_set(folder: Path, planted: Planted, seed: int = 3) -> Path:
    """Settled isometric tables at nine lengths; three replicates, all of a length as warm."""
    rng = np.random.default_rng(seed)
    celsius_at = dict(zip(LENGTHS, 21.0 + 6.0 * rng.uniform(-1.0, 1.0, len(LENGTHS)), strict=True))
    law = ForceLaw(nominal(), NONE)
    trials, samples, order = [], [], 0
    for replicate in range(1, 4):
        for length in rng.permutation(np.array(LENGTHS)).tolist():
            order += 1
            celsius = celsius_at[length]
            p = PRESSURES
            force = law.lasting(p * 1e3, np.full(len(p), length * 1e-3))
            force = force + planted(p, length, celsius, float(order))
            samples.append(
                pd.DataFrame(
                    {
                        "trial": f"t{order:02d}",
                        "pressure_kpa": p + rng.normal(0.0, 0.2, len(p)),
                        "force_n": force + rng.normal(0.0, 0.05) + rng.normal(0.0, 0.05, len(p)),
                        "direction": "up",
                    }
                )
            )
            trials.append(
                {
                    "trial": f"t{order:02d}", "slot": f"L{length:g}", "replicate": str(replicate),
                    "protocol": "isometric", "mounting": "m1", "order": order,
                    "held_length_mm": length, "temperature_c": celsius,
                }
            )  # fmt: skip
    folder.mkdir(parents=True)
    pd.DataFrame(trials).to_csv(folder / "trials.csv", index=False)
    pd.concat(samples).to_csv(folder / "samples.csv", index=False)
    return folder


def term_of(folder: Path) -> tuple[FitProblem, EmpiricalTerm | None]:
    problem = FitProblem.of(read_dataset(folder))
    return problem, empirical_term(problem, problem.base)


@pytest.mark.parametrize(
    ("planted", "inputs"),
    [
        (waves, {"pressure"}), (fold, {"pressure", "length"}),
        (warm, {"temperature"}), (worn, {"order"}),
    ],
)  # fmt: skip
def test_a_planted_residual_is_found_with_its_inputs(
    tmp_path: Path, planted: Planted, inputs: set[str]
) -> None:
    _, term = term_of(planted_set(tmp_path / "data", planted))
    assert term is not None
    assert {name for name, share in term.shares.items() if share >= 0.1} == inputs
    assert term.closed > 0.7
    assert 0.0 < term.closed_low <= term.closed <= term.closed_high
    assert sum(term.shares.values()) == pytest.approx(1.0)


@pytest.mark.parametrize("seed", [1, 2, 3, 4, 5])
def test_noise_alone_gives_no_term(tmp_path: Path, seed: int) -> None:
    _, term = term_of(planted_set(tmp_path / "data", nothing, seed))
    assert term is None


def test_the_shape_is_the_planted_one_within_its_band(tmp_path: Path) -> None:
    _, term = term_of(planted_set(tmp_path / "data", waves))
    assert term is not None
    (course,) = [c for c in term.courses if c.inputs == ("pressure_kpa",) and not c.scale]
    true = waves(course.at[0], 60.0, 21.0, 0.0)
    # A constant of the plant takes a straight line of the pressure: what bends is the term's.
    rest = course.value - true
    rest = rest - np.polyval(np.polyfit(course.at[0], rest, 1), course.at[0])
    assert np.sqrt(np.mean(rest**2)) < 0.25 * np.sqrt(np.mean(true**2))
    assert np.all(course.half_width > 0.0)


def test_what_happens_in_one_slot_alone_closes_nothing_held_out(tmp_path: Path) -> None:
    """Fitted to itself a spline closes nearly all of it; whoever predicts it closes none."""

    def only_there(p: Array, length: float, celsius: float, order: float) -> Array:
        return waves(p, length, celsius, order) if length == 61.0 else np.zeros_like(p)

    _, term = term_of(planted_set(tmp_path / "data", only_there))
    assert term is None


def test_a_slot_left_out_has_no_part_in_what_predicts_it(tmp_path: Path) -> None:
    """Whatever is written into a slot, the term that predicts it stays the same."""
    problem = FitProblem.of(read_dataset(planted_set(tmp_path / "data", fold)))
    slot = 4
    here = problem.units[problem.rows.trial] == slot
    residual = problem.base.residual.copy()
    residual[here] = np.random.default_rng(0).normal(0.0, 50.0, int(here.sum()))
    found = []
    for fit in (problem.base, replace(problem.base, residual=residual)):
        search = search_of(problem, fit, "force", replace(VALIDATION, term_share=0.0))
        assert search is not None
        columns = search.columns([p for p in search.pieces if p.inputs == ("pressure_kpa",)])
        # The prior is in units of the whole residual; here it must not differ.
        alike = replace(search.terms, penalty=np.eye(len(search.terms.penalty)))
        found.append(alike.coefficients(columns, frozenset({slot})))
    assert found[0] == pytest.approx(found[1])


def test_a_stated_term_closes_the_gap_that_the_held_out_figure_promised(tmp_path: Path) -> None:
    folder = planted_set(tmp_path / "data", waves)
    problem, term = term_of(folder)
    assert term is not None
    (folder / "bench.toml").write_text(improved_plant(problem, problem.base, term))
    again = FitProblem.of(read_dataset(folder))
    rest = held_out(again, again.base)["force"].rms("recalibrated")
    before = held_out(problem, problem.base)["force"].rms("recalibrated")
    assert rest < 0.5 * before
    assert rest == pytest.approx(term.after, rel=0.25)


def test_a_simulation_in_time_refuses_a_plant_with_a_term(tmp_path: Path) -> None:
    folder = planted_set(tmp_path / "data", waves)
    problem, term = term_of(folder)
    path = tmp_path / "plant.toml"
    path.write_text(improved_plant(problem, problem.base, term))
    ran = CliRunner().invoke(app, ["simulate", "held-steps", "--plant", str(path)])
    assert ran.exit_code != 0
    assert "[empirical.force]: a simulation in time cannot take" in str(ran.exception)


GOOD = """
[empirical.force]
unit = "N"
[[empirical.force.terms]]
inputs = ["pressure_kpa"]
knots = [[0.0, 500.0]]
coefficients = [0.0, 1.0]
"""


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (('"N"', '"kPa"'), "unit = 'kPa'; expected 'N'"),
        (("empirical.force", "empirical.torque"), "unknown block 'torque'"),
        (('"pressure_kpa"', '"colour"'), "unknown input 'colour'"),
        (("[0.0, 500.0]", "[500.0, 0.0]"), "two numbers or more that rise"),
        (("[0.0, 1.0]", "[0.0, 1.0, 2.0]"), "3 coefficients; 2 belong to these knots"),
        (("[0.0, 1.0]", "[0.0, nan]"), "nan is not a finite number"),
        (("[0.0, 1.0]", "[0.0, true]"), "True is not a finite number"),
        (("unit =", "units ="), "unknown key 'units'"),
        (("coefficients =", 'scale = "pul"\ncoefficients ='), "scale = 'pul'"),
        (('inputs = ["pressure_kpa"]', "inputs = 3"), "expected a list of up to two inputs"),
        (("coefficients =", "period = -1.0\ncoefficients ="), "period = -1.0"),
        (("coefficients =", "period = 1e-300\ncoefficients ="), "expected 1e-06 or more"),
        (("coefficients =", "period = true\ncoefficients ="), "True is not a finite number"),
        (("coefficients =", "period = 3.0\ncoefficients ="), "4 belong to these knots"),
    ],
)
def test_a_bad_table_is_refused_in_one_line(
    tmp_path: Path, change: tuple[str, str], message: str
) -> None:
    folder = planted_set(tmp_path / "data", nothing)
    (folder / "bench.toml").write_text(GOOD.replace(*change))
    with pytest.raises(GapError) as refused:
        read_dataset(folder)
    assert message in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_term_is_held_at_its_edge_beyond_its_domain() -> None:
    import tomllib

    correction = Corrections.from_config(tomllib.loads(GOOD)["empirical"]).of["force"]
    p = np.array([-100.0, 0.0, 250.0, 500.0, 900.0])
    assert correction.value({"pressure_kpa": p}, 5) == pytest.approx([0.0, 0.0, 0.5, 1.0, 1.0])
    assert correction.domain == {"pressure_kpa": (0.0, 500.0)}


def test_the_splines_add_up_to_one() -> None:
    x = np.linspace(-1.0, 8.0, 50)
    for knots in ((0.0, 7.0), (0.0, 2.0, 7.0), (0.0, 1.0, 3.0, 7.0), (0.0, 1.0, 3.0, 4.0, 7.0)):
        assert spline_columns(x, knots).sum(axis=1) == pytest.approx(np.ones(50))


def test_a_static_law_takes_a_term_of_pressure_and_length_and_no_other(tmp_path: Path) -> None:
    import tomllib

    c = nominal()
    corrections = Corrections.from_config(tomllib.loads(GOOD)["empirical"])
    plain = ForceLaw(c).lasting(250e3, 0.06)
    assert ForceLaw(c, NONE, corrections).lasting(250e3, 0.06) == pytest.approx(plain + 0.5)
    of_speed = GOOD.replace("pressure_kpa", "velocity_mm_s")
    with pytest.raises(PlantError, match="velocity_mm_s"):
        ForceLaw(c, NONE, Corrections.from_config(tomllib.loads(of_speed)["empirical"])).lasting(
            250e3, 0.06
        )


def test_the_verdict_says_it_in_lines_a_figure_and_plain_values(tmp_path: Path) -> None:
    _, term = term_of(planted_set(tmp_path / "data", waves))
    assert term is not None
    verdict = Verdict(Status.UNKNOWN, Reason(Cause.NO_GAP), "muscle", (), 0.1, 0.9, empirical=term)
    lines = "\n".join(empirical_lines(verdict))
    assert "depends on pressure 100 %" in lines
    assert "on slots held out" in lines
    table = verdict.as_dict()["empirical"]
    assert table["channel"] == "force"
    assert table["inputs"] == [{"input": "pressure", "share": 1.0}]
    assert table["domain"]["pressure_kpa"] == pytest.approx([0.0, 500.0], abs=1.5)
    figure = empirical_figure(term)
    assert figure is not None
    assert [axis.get_xlabel() for axis in figure.axes] == ["pressure, kPa"]
    assert "N" in figure.axes[0].get_ylabel()


def test_inputs_are_right_where_needed_ones_are_there_and_no_strange_ones() -> None:
    assert inputs_right(("braid_friction",), {"history": 0.9, "pressure": 0.1})
    assert inputs_right(("end_cap",), {"length": 1.0})
    assert not inputs_right(("wear",), {"pressure": 1.0})
    assert not inputs_right(("creep",), {"history": 0.6, "temperature": 0.4})
    assert inputs_right(("creep",), {"history": 0.96, "temperature": 0.04})
    assert not inputs_right(("local_buckle",), {"pressure": 1.0})
    assert inputs_right(("pressure_zero",), {}, "pressure")  # there it is the same everywhere
    assert not inputs_right(("pressure_zero",), {}, "force")
    # One that is set anew at each mounting changes with the order of the trials.
    assert inputs_right(("force_zero",), {"order": 1.0}, "force", (2,))
    assert not inputs_right(("force_zero",), {"order": 1.0}, "force", (0,))


def test_every_effect_that_can_be_hidden_has_its_inputs_written_down() -> None:
    from blind.physics.entries import ENTRIES

    assert set(TRUE_INPUTS) == set(ENTRIES)
    known = set(INPUTS.values())
    for one in TRUE_INPUTS.values():
        assert one.allowed.union(*one.needed) <= known


def test_a_set_without_a_term_counts_against_both_figures() -> None:
    truth = {
        "kind": "left_out", "effects": [{"id": "creep"}],
        "measured": {"members": [{"gap_over_floor": 2.2}]},
    }  # fmt: skip
    term = {"inputs": [{"input": "history", "share": 1.0}], "closed": 0.7, "channel": "force"}
    inadequate = "named_form_inadequate"
    lines = [
        line_of(1, truth, {"status": "unknown", "empirical": None}),
        line_of(2, truth, {"status": "unknown", "empirical": term}),
        line_of(3, truth, {"status": "named", "empirical": None}),
        # Named, and the effects leave 1 floor: nothing for a term to close.
        line_of(4, truth, {"status": inadequate, "gap": {"after": 0.3, "floor": 0.2}}),
    ]
    assert lines[3]["left"] == pytest.approx(1.118, abs=1e-3)
    # On other trials of the bench: half is closed, not closed, and too small a gap to say.
    lines[1]["closed_anew"] = [0.8, -0.3, None]
    assert totals(lines) == {
        "sets": 2, "terms": 1, "half_closed": 1, "inputs_right": 1,
        "judged_anew": 2, "half_closed_anew": 1,
    }  # fmt: skip


def shifted(p: Array, length: float, celsius: float, order: float) -> Array:
    """The same force everywhere: what `force_zero` of the catalogue says."""
    return np.full_like(p, 3.0)


@pytest.mark.parametrize("struck", [False, True])
def test_what_an_entry_says_that_did_not_explain_the_gap_is_the_last_choice(
    tmp_path: Path, struck: bool
) -> None:
    """Whoever reads it has seen that entry refused; without it in the catalogue an offset is it."""
    data = read_dataset(planted_set(tmp_path / "data", shifted))
    problem = FitProblem.of(data)
    if struck:
        problem = problem.restricted_to(lambda candidate: candidate.id != "force_zero")
    search = search_of(problem, problem.base, "force", VALIDATION)
    assert search is not None
    offset = next(p for p in search.pieces if p.scale == "" and not p.inputs)
    assert search.is_refused(offset) is not struck
    chosen = search.select()
    assert chosen
    assert not any(search.is_refused(piece) for piece in chosen)
    assert (chosen == [offset]) is struck
    assert (search.shares(chosen) == {}) is struck


def test_a_search_also_starts_at_the_constants_of_an_explanation_that_got_no_name(
    tmp_path: Path,
) -> None:
    problem, _ = term_of(planted_set(tmp_path / "data", waves))
    first = search_of(problem, problem.base, "force", VALIDATION)
    assert first is not None
    moved = problem.base.shift + 1.0
    refused = problem.at(moved, (), np.empty(0), problem.base)
    starts = [search.fit.shift for search in _searches(problem, first, refused)]
    assert any(np.array_equal(shift, moved) for shift in starts)
    assert not any(
        np.array_equal(search.fit.shift, moved) for search in _searches(problem, first, None)
    )


def held(before: list[float], after: list[float]) -> HeldOut:
    """Squared errors on slots left out, above a floor of 1 each."""
    base, rest, one = (np.array(x) for x in (before, after, [1.0] * len(before)))
    return HeldOut(base, base, rest, one, one)


def test_a_gap_in_one_slot_is_closed_where_the_term_foretold_it() -> None:
    """Delay of an outlet: one slot of four holds all of the gap, and the jackknife says nothing."""
    one_slot = held([47.0, 96.0, 32.0, 1e6], [42.0, 50.0, 26.0, 2e4])
    found = one_slot.closed()
    assert found is not None
    assert found[1] < 0.0
    assert _closing(one_slot, VALIDATION)
    assert not _closing(held([47.0, 96.0, 32.0, 1e6], [42.0, 50.0, 26.0, 2e5]), VALIDATION)
    two_slots = held([47.0, 1.0, 1e5, 7e5], [42.0, 300.0, 7.5e4, 1e3])
    assert not _closing(two_slots, VALIDATION)  # of one large slot it closes a quarter


def test_a_gap_is_closed_where_half_of_it_was_foretold_in_each_of_three_slots_that_have_one() -> (
    None
):
    """Practice set 44201, an outlet that shuts late: most of the gap is in one slot of five."""
    before = [21.7, 16.1, 35.2, 296.2, 1.8]
    after = [2.9, 3.7, 1.7, 143.0, 0.8]
    found = held(before, after).closed()
    assert found is not None
    assert found[1] < 0.0
    assert _closing(held(before, after), VALIDATION)
    one_missed = [2.9, 10.0, 1.7, 143.0, 0.8]
    assert not _closing(held(before, one_missed), VALIDATION)
    two_with_gap = [1.5, 1.6, 30.0, *before[3:]]
    assert not _closing(held(two_with_gap, [1.2, 1.2, *after[2:]]), VALIDATION)


def test_a_floor_that_a_term_undercuts_is_none() -> None:
    """Practice set 45536: a muscle that wears has replicates that differ by more than scatter."""
    before, after = np.array([122.1, 19.7, 10.5, 19.5]), np.array([26.7, 5.3, 11.0, 2.4])
    floor = np.array([96.1, 6.4, 7.4, 0.4])
    worn = HeldOut(before, before, after, floor, np.ones(4))
    found = worn.closed()
    assert found is not None
    assert found[0] > 2.0
    closing = _closing(worn, VALIDATION)
    assert closing is not None
    assert closing.floor == pytest.approx([26.7, 5.3, 7.4, 0.4])
    found = closing.closed()
    assert found is not None
    assert 0.9 < found[0] < 1.0
    # A term that stays above the floor in all says nothing of it.
    above = replace(worn, after=after + np.array([80.0, 0.0, 0.0, 0.0]))
    assert above.with_floor_shown() is above


def test_a_leak_without_a_name_is_found_by_the_pressure_that_drives_it(tmp_path: Path) -> None:
    """The pressure falls by itself, in every valve test. On tests as short as these an error of the
    gauge carries to slots left out as well as a flow does, but entries say that: it is a flow.
    """
    folder = write_set(tmp_path / "data", {"leak": {"conductance_m3_s_pa": 4e-13}})
    problem = FitProblem.of(read_dataset(folder))
    term = empirical_term(problem, problem.base, block="pressure")
    assert term is not None
    assert set(term.shares) == {"pressure", "history"}
    assert [(t.scale, t.inputs) for t in term.correction.terms] == [(FLOW, ("pressure_kpa",))]
    assert term.closed > 0.5
    (folder / "bench.toml").write_text(improved_plant(problem, problem.base, term))
    again = FitProblem.of(read_dataset(folder))
    one, two = (held_out(p, p.base)["pressure"].rms("recalibrated") for p in (problem, again))
    assert two < 0.7 * one


def test_a_stated_error_of_the_gauge_frees_its_readings_of_it(tmp_path: Path) -> None:
    """A gauge shows a twentieth of its reading too much; the constants stay as stated."""
    folder = write_set(tmp_path / "gauge", {})
    right = read_dataset(folder)
    samples = pd.read_parquet(folder / "samples.parquet")
    samples["pressure_kpa"] /= 0.95
    samples.to_parquet(folder / "samples.parquet")
    wrong = read_dataset(folder)
    error = SplineTerm(("pressure_kpa",), ((-40.0, 800.0),), (-2.0, 40.0), READING)
    stated = Corrections({"pressure": Correction("pressure", (error,))})

    def left(data: DataSet) -> Array:
        problem = FitProblem.of(data)
        return problem.stated_residual[problem.rows.block == BLOCKS.index("pressure")]

    base = left(right)
    off, freed = (
        np.abs(left(data) - base).mean() for data in (wrong, replace(wrong, corrections=stated))
    )
    assert off > 1.0
    assert freed < 0.02 * off


def test_a_line_is_offered_beside_the_splines_of_an_input_and_they_hold_it(tmp_path: Path) -> None:
    problem = FitProblem.of(read_dataset(planted_set(tmp_path / "data", fold)))
    search = search_of(problem, problem.base, "force", VALIDATION)
    assert search is not None
    own = [p for p in search.pieces if p.inputs == ("pressure_kpa",) and not p.scale]
    splines, line = sorted(own, key=lambda piece: -len(piece.at))
    assert len(line.at) == 2
    assert splines.holds(line)
    assert not line.holds(splines)
    alone = search.within([splines, line], frozenset({"pressure"}))
    assert splines in alone


def test_a_term_beside_effects_that_the_verdict_does_not_stand_by_stays_out_of_the_plant(
    tmp_path: Path,
) -> None:
    """It was fitted together with both; of the two the verdict names one."""
    problem, _ = term_of(planted_set(tmp_path / "data", waves))
    fit = problem.fit_effects(["force_zero", "force_gain"])
    term = empirical_term(problem, fit)
    assert term is not None
    values = {"names": "force_zero", "percent": 95.0, "share": 60.0, "rest": "the rest"}
    verdict = Verdict(
        Status.NAMED_FORM_INADEQUATE, Reason(Cause.PARTLY, values), "sensor",
        (Explanation(("force_zero",), "force_sensor", 0.95),), 0.0, 0.05, empirical=term,
    )  # fmt: skip
    answer = SimpleNamespace(verdict=verdict, problem=problem, fit=fit)
    out = tmp_path / "plant.toml"
    shrink_command(cast(Any, SimpleNamespace(answer=lambda: answer)), out, False)
    written = out.read_text(encoding="utf-8")
    assert "[empirical" not in written
    assert "[effects" not in written
