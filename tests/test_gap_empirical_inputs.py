"""Inputs and flows of an empirical term follow the physics that they are named after.

Expected values come from the braid's equations and the gas law, written here by themselves.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest

from gap.data.reader import read_dataset
from gap.decision.diagnose import candidates_without
from gap.estimation.fit_problem import FitProblem
from gap.model.empirical import (
    Flow,
    _share_open,
    inputs_of,
    point_inputs_of,
    risen,
    short_pulses,
    shown_too_much,
    valve_flows,
)
from gap.model.features import BLOCKS
from gap.model.grid import Grid, make_grid
from gap.reason import Cause, Reason
from gap.reporting.empirical import empirical_figure, empirical_lines, empirical_sentences
from gap.validation.config import VALIDATION
from gap.validation.empirical import empirical_term
from gap.validation.terms.search import TermSearch, search_of
from gap.verdict import Status, Verdict
from gap_bench import write_set
from plant.constants import PlantConstants, nominal
from plant.effects.empirical import (
    CELL,
    CELL_GAIN,
    FLOW,
    INLET_FLOW,
    LATE,
    OUTLET_FLOW,
    READING,
    SEEN,
    SHORT_PULSES,
    SUPPLY,
    Correction,
    Corrections,
    SplineTerm,
)

Array = npt.NDArray[np.float64]
NOISE_KPA = 0.4


def slow_cycles(folder: Path) -> Grid:
    """One trial whose pressure rises, rests with noise and falls; one whose length does so."""
    rng = np.random.default_rng(4)
    t = np.arange(0.0, 60.0, 0.02)
    course = np.interp(t, [0.0, 15.0, 45.0, 60.0], [0.0, 1.0, 1.0, 0.0])
    tables = []
    for name, pressure, length in (
        ("held", 300.0 * course, np.full(len(t), 62.0)),
        ("moved", np.full(len(t), 300.0), 70.0 - 12.0 * course),
    ):
        tables.append(
            pd.DataFrame(
                {
                    "trial": name, "time_s": t,
                    "pressure_kpa": pressure + rng.normal(0.0, NOISE_KPA, len(t)),
                    "length_mm": length, "force_n": 20.0,
                }
            )
        )  # fmt: skip
    trials = [
        {"trial": "held", "slot": "s1", "protocol": "hysteresis", "held_length_mm": 62.0},
        {"trial": "moved", "slot": "s2", "protocol": "isobaric", "held_length_mm": np.nan},
    ]
    folder.mkdir(parents=True)
    pd.DataFrame(trials).to_csv(folder / "trials.csv", index=False)
    pd.concat(tables).to_csv(folder / "samples.csv", index=False)
    return make_grid(read_dataset(folder))


def of_trial(grid: Grid, trial: int, name: str) -> tuple[Array, Array]:
    """Time and an input of the force rows of one trial."""
    rows = grid.rows
    here = rows.block == BLOCKS.index("force")
    own = rows.trial[here] == trial
    return rows.time_s[here][own], inputs_of(grid, "force", (name,))[name][own]


def test_a_rising_pressure_slips_the_way_that_a_shortening_does(tmp_path: Path) -> None:
    """Both turn the fibres towards the axis' normal, and friction holds both back."""
    grid = slow_cycles(tmp_path / "data")
    for trial in (0, 1):
        time, slip = of_trial(grid, trial, "slip")
        assert slip[(time > 8.0) & (time < 14.0)].max() < -0.9
        assert slip[time > 55.0].min() > 0.9


def test_a_loop_stays_where_it_is_while_a_reading_only_jitters(tmp_path: Path) -> None:
    time, slip = of_trial(slow_cycles(tmp_path / "data"), 0, "slip")
    resting = slip[(time > 17.0) & (time < 44.0)]
    assert np.all(resting < -0.85)


def test_the_pull_s_change_is_that_of_the_braid_whatever_moves_it(tmp_path: Path) -> None:
    """At constant pressure a shorter muscle pulls less: the change is negative, and fades."""
    grid = slow_cycles(tmp_path / "data")
    time, change = of_trial(grid, 1, "pull_change_1s_n")
    assert change[(time > 8.0) & (time < 14.0)].max() < -0.5
    assert np.abs(change[(time > 25.0) & (time < 44.0)]).max() < 0.2
    c = nominal()
    lengths = np.array([70e-3, 58e-3])
    pulls = 300e3 * (3.0 * lengths**2 - c.braid_length_m**2) / (4.0 * np.pi * c.turns**2)
    time, slow = of_trial(grid, 1, "pull_change_100s_n")
    # From one length to the other in 15 s, a mean over 100 s has gone next to nowhere.
    assert slow[(time > 14.0) & (time < 16.0)].mean() == pytest.approx(np.diff(pulls)[0], rel=0.12)


def valve_grid(folder: Path) -> Grid:
    return make_grid(read_dataset(write_set(folder, {})))


def residual_of(problem: FitProblem, changed: PlantConstants) -> Array:
    """What the stated effects leave of the pressure with other constants."""
    found = problem.model.residual(changed, problem.base.active, ("pressure",))
    return np.asarray(found["pressure"])


@pytest.fixture(scope="module")
def valve_problem(tmp_path_factory: pytest.TempPathFactory) -> FitProblem:
    folder = tmp_path_factory.mktemp("valve") / "data"
    return FitProblem.of(read_dataset(write_set(folder, {})))


def test_a_share_of_the_inlet_s_flow_is_what_a_wider_inlet_passes(
    valve_problem: FitProblem,
) -> None:
    """The simulated gas takes it in: far from where it would be in proportion, too."""
    c = valve_problem.data.constants
    count = len(valve_problem.grid.points["pressure"].time_s)
    for share in (-0.3, 0.3):
        flow = Flow({INLET_FLOW: np.full(count, share)})
        active = valve_problem.base.active
        with_flow = valve_problem.model.pressure_with_flow(flow, c, active)
        wider = c.inlet_conductance_m3_s_pa * (1.0 + share)
        expected = residual_of(valve_problem, replace(c, inlet_conductance_m3_s_pa=wider))
        plain = residual_of(valve_problem, c)
        assert np.abs(expected - plain).max() > 5.0
        assert with_flow == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("scale", LATE)
def test_a_late_valve_is_one_with_a_longer_delay(valve_problem: FitProblem, scale: str) -> None:
    c = valve_problem.data.constants
    count = len(valve_problem.grid.points["pressure"].time_s)
    flow = Flow({scale: np.full(count, 3.0)})
    shown = valve_problem.model.pressure_with_flow(flow, c, valve_problem.base.active)
    field = f"{scale.removesuffix('_ms')}_s"
    later = replace(c, **{field: getattr(c, field) + 3e-3})
    expected = residual_of(valve_problem, later)
    assert np.abs(expected - residual_of(valve_problem, c)).max() > 1.0
    assert shown == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize(
    ("scale", "delays"),
    [
        ("opens_ms", ("inlet_on_s", "outlet_on_s")),
        ("shuts_ms", ("inlet_off_s", "outlet_off_s")),
        ("edges_ms", ("inlet_on_s", "inlet_off_s", "outlet_on_s", "outlet_off_s")),
    ],
)
def test_valves_that_both_act_late_have_two_or_four_longer_delays(
    valve_problem: FitProblem, scale: str, delays: tuple[str, ...]
) -> None:
    c = valve_problem.data.constants
    count = len(valve_problem.grid.points["pressure"].time_s)
    flow = Flow({scale: np.full(count, 3.0)})
    shown = valve_problem.model.pressure_with_flow(flow, c, valve_problem.base.active)
    later = replace(c, **{field: getattr(c, field) + 3e-3 for field in delays})
    assert np.abs(residual_of(valve_problem, later) - residual_of(valve_problem, c)).max() > 1.0
    assert shown == pytest.approx(residual_of(valve_problem, later), abs=1e-6)


def search_of_flow(problem: FitProblem, flow: Flow) -> TermSearch:
    """The search of a bench whose gas takes in a flow that the plant does not have."""
    c = problem.data.constants
    shown = problem.model.pressure_with_flow(flow, c, problem.base.active)
    residual = problem.base.residual.copy()
    here = problem.rows.block == BLOCKS.index("pressure")
    residual[here] -= shown - residual_of(problem, c)
    search = search_of(problem, replace(problem.base, residual=residual), "pressure", VALIDATION)
    assert search is not None
    return search


def test_a_higher_supply_is_one_with_more_pressure(valve_problem: FitProblem) -> None:
    c = valve_problem.data.constants
    count = len(valve_problem.grid.points["pressure"].time_s)
    flow = Flow({SUPPLY: np.full(count, 20.0)})
    shown = valve_problem.model.pressure_with_flow(flow, c, valve_problem.base.active)
    expected = residual_of(valve_problem, replace(c, supply_pa=c.supply_pa + 20e3))
    assert np.abs(expected - residual_of(valve_problem, c)).max() > 2.0
    assert shown == pytest.approx(expected, abs=1e-6)


def test_what_a_supply_that_was_fitted_feeds_is_what_a_higher_one_does(
    valve_problem: FitProblem,
) -> None:
    c, grid = valve_problem.data.constants, valve_problem.grid
    higher = replace(c, supply_pa=c.supply_pa + 2e3)
    inlet, more = (valve_flows(grid, c)[scale] for scale in (INLET_FLOW, SUPPLY))
    fed = valve_flows(grid, higher)[INLET_FLOW] - inlet
    # Near the supply the flow rises as a root: no slope tells it. Elsewhere it bends a little, and
    # a valve whose delay depends on its supply moves by a part of a point: 3 % over 2 kPa.
    filling = grid.points["pressure"].pressure < c.supply_pa - 50e3
    assert fed[filling].max() > 0.2
    assert np.abs(fed - 2.0 * more)[filling].mean() < 0.03 * np.abs(fed[filling]).mean()


def test_a_supply_that_is_high_as_a_trial_begins_is_told_from_a_flow(
    valve_problem: FitProblem,
) -> None:
    time = valve_problem.grid.points["pressure"].time_s
    surge = Flow({SUPPLY: 60.0 * np.exp(-time / 0.4)})
    first = search_of_flow(valve_problem, surge).select()[0]
    assert (first.scale, first.inputs) == (SUPPLY, ("time_s",))


def test_a_flow_over_time_says_nothing_of_slots_that_last_longer(
    valve_problem: FitProblem,
) -> None:
    """A leak of 0.1 mg/s: as a sum over time it grows without end."""
    leak = Flow({FLOW: np.full(len(valve_problem.grid.points["pressure"].time_s), -0.1)})
    search = search_of_flow(valve_problem, leak)
    over_time = [p for p in search.pieces if p.scale == FLOW and "time_s" in p.inputs]
    alone = replace(search, pieces=over_time)
    longest = int(np.argmax(search.lasts))
    # The longest trial of the others lasts 18 s, this one 28 s.
    assert search.lasts[longest] > 1.5 * np.delete(search.lasts, longest).max()
    left_out = frozenset({search.terms.slots[longest]})
    assert not alone.select(left_out)
    assert replace(alone, lasts=np.ones(len(search.lasts))).select(left_out)
    assert alone.select(frozenset({search.terms.slots[0]}))


def test_a_flow_in_proportion_is_near_what_the_simulated_gas_does(
    valve_problem: FitProblem,
) -> None:
    """The sums that a search is made from agree with the simulation where a flow is small.

    Within a fifth: they leave out how fast the gas warms up.
    """
    c = valve_problem.data.constants
    grid = valve_problem.grid
    small = ((INLET_FLOW, 0.03), (OUTLET_FLOW, 0.03), ("inlet_on_ms", 0.3), (SUPPLY, 3.0))
    for scale, amount in small:
        through = valve_flows(grid, c)[scale]
        raised = risen(grid, amount * through[:, None], c)[:, 0]
        flow = Flow({scale: np.full(len(through), amount)})
        shown = valve_problem.model.pressure_with_flow(flow, c, valve_problem.base.active)
        does = residual_of(valve_problem, c) - shown
        assert np.abs(does - raised).mean() < 0.2 * np.abs(does).mean()


def pressure_of(problem: FitProblem, *active: tuple[str, float]) -> Array:
    """What effects leave of the pressure beside the stated ones, at the stated constants."""
    acting = [(name, "", amount, {}) for name, amount in active]
    found = problem.model.residual(
        problem.data.constants, [*problem.base.active, *acting], ("pressure",)
    )
    return np.asarray(found["pressure"])


def test_an_error_of_the_gauge_that_is_the_same_everywhere_is_its_zero(
    valve_problem: FitProblem,
) -> None:
    problem, c = valve_problem, valve_problem.data.constants
    flow = Flow({READING: np.full(len(problem.grid.points["pressure"].time_s), 5.0)})
    shown = problem.model.pressure_with_flow(flow, c, problem.base.active)
    expected = pressure_of(problem, ("pressure_zero", 5.0))
    assert np.abs(expected - residual_of(problem, c)).max() > 1.0
    assert shown == pytest.approx(expected, abs=1e-6)


def test_an_error_of_the_gauge_in_proportion_to_its_reading_is_its_gain(
    valve_problem: FitProblem,
) -> None:
    """What is 4 % too much of the pressure is 4/104 of the reading, noise and all."""
    problem, c = valve_problem, valve_problem.data.constants
    reading = problem.grid.points["pressure"].path * 1e-3
    flow = Flow({READING: reading * 0.04 / 1.04})
    plain = residual_of(problem, c)
    shown = problem.model.pressure_with_flow(flow, c, problem.base.active) - plain
    expected = pressure_of(problem, ("pressure_gain", 4.0)) - plain
    assert np.abs(expected).max() > 5.0
    assert np.sqrt(np.mean((shown - expected) ** 2)) < 0.1 * np.sqrt(np.mean(expected**2))


def test_a_small_error_of_the_gauge_is_in_proportion_to_what_it_does(
    valve_problem: FitProblem,
) -> None:
    problem, c = valve_problem, valve_problem.data.constants
    error = problem.grid.points["pressure"].path * 1e-3 * 0.01
    added = shown_too_much(problem.grid, error[:, None], c, followed=True)[:, 0]
    flow = Flow({READING: error})
    does = residual_of(problem, c) - problem.model.pressure_with_flow(flow, c, problem.base.active)
    assert np.abs(does - added).mean() < 0.2 * np.abs(does).mean()


def test_a_prediction_that_follows_no_reading_keeps_all_of_the_gauge_s_error(
    valve_problem: FitProblem,
) -> None:
    """As of gas that someone else has simulated."""
    grid, c = valve_problem.grid, valve_problem.data.constants
    error = np.full(len(grid.points["pressure"].time_s), 5.0)
    rows = int((valve_problem.rows.block == BLOCKS.index("pressure")).sum())
    assert Flow({READING: error}).raised(grid, c) == pytest.approx(np.full(rows, 5.0))
    followed = shown_too_much(grid, error[:, None], c, followed=True)[:, 0]
    assert np.all(followed <= 5.0)
    assert followed.min() < 0.1


@pytest.mark.parametrize(("share", "is_one"), [(0.04, True), (0.97, False)])
def test_a_gauge_whose_reading_is_all_error_is_none(
    share: float, is_one: bool, valve_problem: FitProblem
) -> None:
    """Pulses that the plant takes for too short fill the muscle: no pressure was predicted."""
    open_gap = replace(valve_problem.base, residual=np.full(len(valve_problem.rows), 50.0))
    first = search_of(valve_problem, open_gap, "pressure", VALIDATION)
    assert first is not None
    gauge = next(p for p in first.pieces if p.scale == READING and p.inputs == ("pressure_kpa",))
    residual = np.zeros(len(valve_problem.rows))
    here = valve_problem.rows.block == BLOCKS.index("pressure")
    residual[here] = first.basis[:, gauge.at] @ (share * np.array(gauge.knots[0]))
    fit = replace(valve_problem.base, residual=residual)
    search = search_of(valve_problem, fit, "pressure", VALIDATION, first)
    assert search is not None
    assert search._leaves_a_plant([gauge], frozenset()) is is_one
    assert is_one or all(piece is not gauge for piece in search.select())


@pytest.mark.parametrize(("share", "carries"), [(0.2, True), (0.9, False)])
def test_a_muscle_that_pulls_the_same_whatever_it_does_carries_no_load(
    share: float, carries: bool, valve_problem: FitProblem
) -> None:
    """A term that takes what a pull changes leaves its mean, which is the load: any gap is closed.

    Creep takes a fifth of it.
    """
    few = replace(VALIDATION, least_slots=2)  # two loads
    open_gap = replace(valve_problem.base, residual=np.full(len(valve_problem.rows), 50.0))
    first = search_of(valve_problem, open_gap, "load", few)
    assert first is not None
    changes = (p for p in first.pieces if p.inputs == ("pull_change_10s_n",) and not p.scale)
    line = next(p for p in changes if len(p.at) == 2)
    residual = np.zeros(len(valve_problem.rows))
    here = valve_problem.rows.block == BLOCKS.index("load")
    residual[here] = first.basis[:, line.at] @ (-share * np.array(line.knots[0]))
    search = search_of(
        valve_problem, replace(valve_problem.base, residual=residual), "load", few, first
    )
    assert search is not None
    assert search._leaves_a_plant([line], frozenset()) is carries


def test_nothing_passes_a_valve_that_is_commanded_shut_before_it_has_opened(
    valve_problem: FitProblem,
) -> None:
    """An inlet that takes 10 s to open: no command of these tests lasts as long."""
    c, grid = valve_problem.data.constants, valve_problem.grid
    assert valve_flows(grid, c)[INLET_FLOW].max() > 0.0
    assert not np.any(valve_flows(grid, replace(c, inlet_on_s=10.0))[INLET_FLOW])


def test_short_commands_that_pass_are_those_of_a_valve_whose_edges_all_act(
    valve_problem: FitProblem,
) -> None:
    """Bursts of 12 ms at an inlet that takes 2 ms longer to open than that of the bench."""
    c = valve_problem.data.constants
    grid = valve_problem.grid
    slow = replace(c, inlet_on_s=c.inlet_on_s + 2e-3)
    assert not short_pulses(grid, c).any()
    passing = short_pulses(grid, slow)
    assert passing.max() > 100.0
    whole = Flow({SHORT_PULSES: np.ones(len(passing))})
    active = valve_problem.base.active
    shown = valve_problem.model.pressure_with_flow(whole, slow, active)
    all_act = [*active, ("transport_delay", "", 1.0, {})]
    expected = valve_problem.model.residual(slow, all_act, ("pressure",))["pressure"]
    does = np.abs(residual_of(valve_problem, slow) - expected).mean()
    assert does > 20.0
    assert np.abs(shown - expected).mean() < 0.2 * does
    raised = risen(grid, passing[:, None], slow)[:, 0]
    assert np.abs(residual_of(valve_problem, slow) - raised - expected).mean() < 0.2 * does


def test_what_a_force_cell_shows_too_much_is_missing_in_the_load_that_it_weighs(
    tmp_path: Path,
) -> None:
    data = read_dataset(write_set(tmp_path / "data", {}, weighed=True))
    plain = FitProblem.of(data)
    shown = Correction("force", (SplineTerm((), (), (2.0,), CELL),))
    stated = FitProblem.of(replace(data, corrections=Corrections({"force": shown})))
    c = data.constants
    blocks = ("force", "load")
    with_term = stated.model.residual(c, plain.base.active, blocks)
    zero = [*plain.base.active, ("force_zero", "", 2.0, {})]
    with_zero = plain.model.residual(c, zero, blocks)
    without = plain.model.residual(c, plain.base.active, blocks)
    for block, added in (("force", -2.0), ("load", 2.0)):
        assert with_term[block] - without[block] == pytest.approx(added)
        assert with_term[block] == pytest.approx(with_zero[block])


def test_a_cell_that_shows_a_share_too_much_weighs_its_load_as_much_too_heavy(
    tmp_path: Path,
) -> None:
    """4 % of what the braid pulls, and 4 % of what the cell reads of the load."""
    data = read_dataset(write_set(tmp_path / "data", {}, weighed=True))
    plain = FitProblem.of(data)
    shown = Correction("force", (SplineTerm((), (), (0.04,), CELL_GAIN),))
    stated = FitProblem.of(replace(data, corrections=Corrections({"force": shown})))
    c, active = data.constants, plain.base.active
    with_term, without = (
        one.model.residual(c, active, ("force", "load")) for one in (stated, plain)
    )
    rows = plain.rows
    here = rows.block == BLOCKS.index("force")
    length, pressure = rows.length[here], rows.pressure[here]
    pull = pressure * (3.0 * length**2 - c.braid_length_m**2) / (4.0 * np.pi * c.turns**2)
    assert with_term["force"] - without["force"] == pytest.approx(-0.04 * pull)
    points = plain.grid.points["load"]
    total = np.bincount(points.row, weights=points.reading * points.weight)
    read = total / np.bincount(points.row, weights=points.weight)
    assert read.min() > 5.0
    assert with_term["load"] - without["load"] == pytest.approx(0.04 * read)


def test_a_scale_of_a_force_cell_is_found_as_such(tmp_path: Path) -> None:
    """10 % too much, in the force and in what weighs the load."""
    folder = write_set(tmp_path / "data", {}, weighed=True)
    samples = pd.read_parquet(folder / "samples.parquet")
    samples["force_n"] *= 1.1
    samples.to_parquet(folder / "samples.parquet", index=False)
    struck = candidates_without(["force_gain"])
    problem = FitProblem.of(read_dataset(folder), struck)
    term = empirical_term(problem, problem.base, block="force")
    assert term is not None
    (only,) = term.correction.terms
    assert (only.scale, only.inputs) == (CELL_GAIN, ())
    assert only.coefficients[0] == pytest.approx(0.1, abs=0.02)
    assert term.closed > 0.9
    assert term.expression is None
    told = Verdict(Status.UNKNOWN, Reason(Cause.NO_GAP), "sensor", (), 0.1, 0.9, empirical=term)
    assert "an error of the force cell in proportion" in " ".join(empirical_lines(told))


def test_an_error_of_a_force_cell_is_told_from_one_of_the_muscle_by_the_load(
    tmp_path: Path,
) -> None:
    """3 N too much at the end of each test, in the force and in what weighs the load."""
    folder = write_set(tmp_path / "data", {}, weighed=True)
    samples = pd.read_parquet(folder / "samples.parquet")
    samples["force_n"] += 3.0 * np.minimum(samples["time_s"] / 20.0, 1.0)
    samples.to_parquet(folder / "samples.parquet", index=False)
    problem = FitProblem.of(read_dataset(folder))
    term = empirical_term(problem, problem.base, block="force")
    assert term is not None
    assert [t.scale for t in term.correction.terms] == [CELL]
    assert term.correction.inputs == ("time_s",)
    assert term.closed > 0.8
    assert list(term.shares) == ["history"]
    told = Verdict(Status.UNKNOWN, Reason(Cause.NO_GAP), "sensor", (), 0.1, 0.9, empirical=term)
    assert "error of the force cell's reading" in " ".join(empirical_lines(told))


def test_what_a_camera_shows_too_much_is_missing_only_where_it_was_read(tmp_path: Path) -> None:
    """0.5 mm too much: as if all that was read, and nothing that was held, were shorter by it."""
    folder = write_set(tmp_path / "data", {}, weighed=True)
    data = read_dataset(folder)
    shown = Correction("force", (SplineTerm((), (), (0.5,), SEEN),))
    stated = FitProblem.of(replace(data, corrections=Corrections({"force": shown})))
    plain = FitProblem.of(data)
    samples = pd.read_parquet(folder / "samples.parquet")
    samples["length_mm"] -= 0.5
    samples.to_parquet(folder / "samples.parquet", index=False)
    shorter = FitProblem.of(read_dataset(folder))
    added, expected = (
        one.model.residual(data.constants, plain.base.active, ("force",))["force"]
        - plain.model.residual(data.constants, plain.base.active, ("force",))["force"]
        for one in (stated, shorter)
    )
    assert np.abs(expected).max() > 1.0
    assert added == pytest.approx(expected, abs=0.01)
    rows = plain.rows.trial[plain.rows.block == BLOCKS.index("force")]
    held = [k for k, trial in enumerate(data.trials) if trial.protocol != "isotonic"]
    assert np.abs(added[np.isin(rows, held)]).max() == 0.0


def test_a_scale_of_the_camera_is_found_as_an_error_of_what_it_reads(tmp_path: Path) -> None:
    """8 % of the distance from 62 mm, under loads that a cell weighs; held lengths are right."""
    folder = write_set(tmp_path / "data", {}, weighed=True)
    samples = pd.read_parquet(folder / "samples.parquet")
    samples["length_mm"] += 0.08 * (samples["length_mm"] - 62.0)
    samples.to_parquet(folder / "samples.parquet", index=False)
    problem = FitProblem.of(read_dataset(folder))
    term = empirical_term(problem, problem.base)
    assert term is not None
    assert [(t.scale, t.inputs) for t in term.correction.terms] == [(SEEN, ("length_mm",))]
    assert term.closed > 0.9
    told = Verdict(Status.UNKNOWN, Reason(Cause.NO_GAP), "sensor", (), 0.1, 0.9, empirical=term)
    assert "error of the length that the camera reads" in " ".join(empirical_lines(told))


def test_a_camera_that_is_late_shows_the_length_of_an_instant_before(tmp_path: Path) -> None:
    """The length falls at 0.8 mm/s, rests, and rises again."""
    grid = slow_cycles(tmp_path / "data")
    for name, falls in (("moves_100ms_mm", -0.08), ("moved_150ms_mm", -0.12)):
        time, moved = of_trial(grid, 1, name)
        assert moved[(time > 1.0) & (time < 14.0)] == pytest.approx(falls, abs=1e-6)
        assert moved[(time > 16.0) & (time < 44.0)] == pytest.approx(0.0, abs=1e-6)
        assert moved[(time > 46.0) & (time < 59.0)] == pytest.approx(-falls, abs=1e-6)
        assert np.all(of_trial(grid, 0, name)[1] == 0.0)


def test_a_camera_whose_clock_is_ahead_is_found_as_a_shift_in_time(tmp_path: Path) -> None:
    """By 100 ms, of muscles that swing at 0.7 to 1.6 Hz; the catalogue's entry is struck."""
    rng = np.random.default_rng(7)
    c = nominal()
    time = np.arange(0.0, 12.0, 0.01)
    trials, tables = [], []
    for slot, (pressure, hertz) in enumerate(((150.0, 0.7), (250.0, 1.0), (350.0, 1.6))):
        for again in range(3):
            name = f"t{slot}{again}"
            length, seen = (
                62.0 + 4.0 * np.sin(2.0 * np.pi * hertz * t) for t in (time, time + 0.1)
            )
            braid = 3.0 * (length * 1e-3) ** 2 - c.braid_length_m**2
            force = pressure * 1e3 * braid / (4.0 * np.pi * c.turns**2)
            noise = rng.normal(0.0, 1.0, (3, len(time)))
            trials.append(
                {"trial": name, "slot": f"s{slot}", "protocol": "isobaric",
                 "held_length_mm": np.nan}
            )  # fmt: skip
            tables.append(
                pd.DataFrame(
                    {"trial": name, "time_s": time, "pressure_kpa": pressure + 0.1 * noise[0],
                     "length_mm": seen + 0.01 * noise[1], "force_n": force + 0.1 * noise[2]}
                )
            )  # fmt: skip
    folder = tmp_path / "data"
    folder.mkdir()
    pd.DataFrame(trials).to_csv(folder / "trials.csv", index=False)
    pd.concat(tables).to_csv(folder / "samples.csv", index=False)
    problem = FitProblem.of(read_dataset(folder), candidates_without(["camera_delay"]))
    term = empirical_term(problem, problem.base, block="force")
    assert term is not None
    (only,) = term.correction.terms
    assert (only.scale, only.inputs) == ("pull_per_mm", ("moved_100ms_mm",))
    # The muscle is where the camera has shown it 100 ms before.
    assert np.diff(only.coefficients)[0] < -0.5 * np.diff(only.knots[0])[0]
    assert term.closed > 0.99
    assert "velocity" in term.shares


def test_a_valve_s_share_of_the_time_is_that_between_its_turns() -> None:
    """Open from 1 s to 3 s, and again from 5 s on."""
    ends = np.array([0.0, 0.5, 1.5, 2.0, 4.0, 6.0])
    shares = _share_open([(1.0, True), (3.0, False), (5.0, True)], ends)
    assert shares == pytest.approx([0.0, 0.5, 1.0, 0.5, 0.5])
    assert _share_open([], ends) == pytest.approx(np.zeros(5))


def test_a_valve_that_opens_late_is_told_by_the_time_that_it_takes(tmp_path: Path) -> None:
    """An inlet opens 6 ms late, and its constants have moved far to make up for it."""
    effect = {"valve_delay": {"edge": "inlet_on", "delay_ms": 6.0}}
    problem = FitProblem.of(read_dataset(write_set(tmp_path / "data", effect)))
    term = empirical_term(problem, problem.base, block="pressure")
    assert term is not None
    assert term.closed > 0.5
    assert [t.scale for t in term.correction.terms] == ["inlet_on_ms"]
    assert list(term.shares) == ["history"]
    # The constants bring back what they cannot hold: the rest is the valve's.
    late_ms = term.correction.terms[0].coefficients[0]
    assert 0.0 < late_ms < 6.0
    verdict = Verdict(Status.UNKNOWN, Reason(Cause.NO_GAP), "valve", (), 0.1, 0.9, empirical=term)
    told = f"inlet opens late {late_ms:.3g} ms"
    assert f"  amount    {told}" in empirical_lines(verdict)
    assert told in " ".join(empirical_sentences(verdict))
    assert verdict.as_dict()["empirical"]["terms"][0]["amount"] == pytest.approx(late_ms, rel=1e-5)
    assert empirical_figure(term) is None


def test_a_surplus_of_gas_is_gone_once_the_chamber_is_vented(tmp_path: Path) -> None:
    """What came in too much goes out again: at 0 kPa behind an open outlet nothing is left of it.

    A closed chamber keeps it but for what the prediction forgets.
    """
    grid = valve_grid(tmp_path / "data")
    points = grid.points["pressure"]
    at = point_inputs_of(grid, "pressure", ("valve", "since_edge_s"))
    flow = np.where(at["valve"] > 0.0, 1.0, 0.0)[:, None]
    raised = risen(grid, flow, nominal())[points.row, 0]
    vented = (at["valve"] < 0.0) & (points.pressure < 2e3) & (at["since_edge_s"] > 0.1)
    kept = (at["valve"] == 0.0) & (at["since_edge_s"] < 0.1) & (points.pressure > 100e3)
    assert vented.any()
    assert kept.any()
    assert np.abs(raised[vented]).mean() < 0.05 * raised[kept].mean()


def test_openings_count_the_commands_to_open_a_valve_in_the_trial(tmp_path: Path) -> None:
    grid = valve_grid(tmp_path / "data")
    count = point_inputs_of(grid, "pressure", ("openings",))["openings"]
    points = grid.points["pressure"]
    for trial in np.unique(points.trial):
        own = points.trial == trial
        span = slice(int(grid.first_edge[trial]), int(grid.first_edge[trial + 1]))
        opened = np.sum(grid.edge_to[span] > 0.5)
        assert np.all(np.diff(count[own]) >= 0.0)
        assert count[own].max() == opened
