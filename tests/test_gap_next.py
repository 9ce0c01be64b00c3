"""What to measure next: foreseen separations, files that run, and advice that holds on benches."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import minimize
from typer.testing import CliRunner

import advice_campaign
from cli.main import app
from daq.store.run import open_run
from gap.data.from_runs import open_data
from gap.data.run_trials import run_trials
from gap.design.advise import REFERENCES, advise, protocol_text
from gap.design.config import DESIGN
from gap.design.foresight import Products, on_experiment, products, separation
from gap.design.library import LibraryExperiment, library_experiments
from gap.effects.candidates import CANDIDATES
from gap.estimation.fit_problem import FitProblem, FitResult
from gap.estimation.information import tolerance
from gap.reporting.text import barely_enough
from gap.verdict import Experiment
from gap_sets import settled_set
from plant.effects.catalogue import CATALOGUE
from rigs.execution.session import run_protocol
from rigs.protocols.registry import procedure
from rigs.rigfile.config import load_rig
from rigs.steps.schedule import outline


def fitted(problem: FitProblem, name: str, amount: float) -> FitResult:
    """The best of an effect's shapes."""
    fits = [problem.fit_afresh([s], [amount]) for s in problem.candidates if s.id == name]
    return min(fits, key=lambda f: f.cost)


@pytest.fixture(scope="module")
def alike(tmp_path_factory: pytest.TempPathFactory) -> tuple[FitProblem, FitResult, FitResult]:
    """Settled tables in which a liner and a pressure zero look much alike."""
    hidden = {"liner_threshold": {"threshold_kpa": 6.0}}
    problem = FitProblem.of(
        open_data(settled_set(tmp_path_factory.mktemp("next") / "alike", hidden))
    )
    return problem, fitted(problem, "liner_threshold", 6.0), fitted(problem, "pressure_zero", 6.0)


@pytest.fixture(scope="module")
def library(alike: tuple[FitProblem, FitResult, FitResult]) -> list[LibraryExperiment]:
    return library_experiments(alike[0], alike[1])


def as_experiment(option: LibraryExperiment, repeats: int) -> Experiment:
    settings = {**option.settings, "repeats": repeats}
    return Experiment(option.protocol, settings, 1.0, 4.0, repeats, ("a", "b"), option.what)


# ---------------------------------------------------------------------------- foresight


def test_an_explanation_is_not_told_from_itself(
    alike: tuple[FitProblem, FitResult, FitResult],
) -> None:
    problem, liner, _ = alike
    assert separation(products(problem, liner, liner), liner, liner) == pytest.approx(0.0, abs=1e-6)


def test_a_rival_bends_as_far_as_the_tolerances_of_its_constants_let_it() -> None:
    """Where a constant is at its wall already, it cannot take what a normal prior would let it."""
    rng = np.random.default_rng(3)
    columns, gap = rng.normal(size=(40, 3)), rng.normal(size=40)
    gap += 4.0 * columns[:, 0]
    one = next(s for s in CANDIDATES if s.id == "payload")

    def fit(shift: list[float]) -> FitResult:
        nothing = np.zeros(0)
        return FitResult(np.array(shift), (one,), np.zeros(1), nothing, 0.0, nothing)

    rival, best = fit([2.9, -0.5]), fit([0.4, 0.0])
    prior = 4.0 / (one.bounds[1] - one.bounds[0]) ** 2

    def cost(bend: np.ndarray) -> float:
        left = gap - columns @ bend
        return float(left @ left + tolerance(rival.shift + bend[:2])[0] + prior * bend[2] ** 2)

    least = minimize(cost, np.zeros(3), method="Nelder-Mead", options={"xatol": 1e-9}).fun
    found = Products(float(gap @ gap), columns.T @ gap, columns.T @ columns)
    expected = np.sqrt(least - tolerance(best.shift)[0])
    assert separation(found, best, rival) == pytest.approx(expected, rel=1e-3)
    assert expected > 8.0


def test_more_of_an_experiment_separates_more(
    alike: tuple[FitProblem, FitResult, FitResult], library: list[LibraryExperiment]
) -> None:
    problem, liner, zero = alike
    present = products(problem, liner, zero)
    for option in library:
        one = products(on_experiment(problem, option), liner, zero)
        apart = [separation(present + one.times(n), liner, zero) for n in (0, 1, 4)]
        assert apart[0] <= apart[1] + 1e-9 <= apart[2] + 2e-9, option.what


def test_kinds_that_the_data_hold_nothing_of_are_foreseen(
    alike: tuple[FitProblem, FitResult, FitResult], library: list[LibraryExperiment]
) -> None:
    problem = alike[0]
    assert {t.protocol for t in problem.data.trials} == {"isometric"}
    assert {c.protocol for c in library} >= {
        "isometric", "isobaric", "isotonic", "hysteresis", "isothermal", "step",
    }  # fmt: skip


def test_what_a_standard_settles_at_once_is_advised_before_hours_of_trials(
    alike: tuple[FitProblem, FitResult, FitResult],
) -> None:
    problem, liner, zero = alike
    advised = advise(problem, liner, [zero])
    assert advised is not None
    assert advised.protocol == "reference"
    assert advised.settings["standard"] == "vent"
    assert advised.separation_after > max(DESIGN.enough_sd, advised.separation_now)
    assert set(advised.between) == {"liner_threshold", "pressure_zero"}


def test_two_muscle_effects_get_an_experiment_of_the_library(tmp_path: Path) -> None:
    hidden = {"bladder_elasticity": {"stiffness_n_mm": 0.08}}
    problem = FitProblem.of(open_data(settled_set(tmp_path / "soft", hidden)))
    first, second = (
        fitted(problem, "bladder_elasticity", 0.08),
        fitted(problem, "contraction_limit", 0.5),
    )
    advised = advise(problem, first, [second])
    assert advised is not None
    assert advised.protocol in {"isometric", "isobaric", "isotonic", "hysteresis", "step"}
    assert advised.trials >= 2
    assert advised.separation_after >= DESIGN.enough_sd


def test_every_standard_is_for_an_effect_of_the_catalogue() -> None:
    assert set(REFERENCES) <= set(CATALOGUE)
    assert all(error > 0.0 for _, error in REFERENCES.values())


# ---------------------------------------------------------------------------- files that run


def test_every_experiment_of_the_library_makes_a_file_that_a_rig_takes(
    library: list[LibraryExperiment], tmp_path: Path
) -> None:
    for number, option in enumerate(library):
        rig = "virtual-instruments" if option.protocol == "isothermal" else "virtual"
        config = load_rig(rig)
        path = tmp_path / f"{number}.toml"
        counts = []
        for repeats in (2, 4):
            text = protocol_text(as_experiment(option, repeats))
            assert text is not None, option.protocol
            path.write_text(text)
            kind = procedure(option.protocol)
            counts.append(outline(kind.read(str(path), config).steps())[0])
        assert counts[1] == 2 * counts[0] > 0, option.what


def test_an_advised_file_runs_on_the_virtual_bench(
    library: list[LibraryExperiment], tmp_path: Path
) -> None:
    bursts = next(c for c in library if c.what == "small steps in short bursts")
    config = load_rig("virtual")
    path = tmp_path / "advised.toml"
    path.write_text(protocol_text(as_experiment(bursts, 2)) or "")
    kind = procedure("step")
    result = run_protocol(kind, config, kind.read(str(path), config), tmp_path / "runs")
    assert result.outcome == "clean"
    trials = list(run_trials(open_run(result.folder)))
    assert len(trials) == 2
    assert {"pressure_kpa", "inlet_cmd", "outlet_cmd"} <= set(trials[0].samples.columns)


def test_the_command_writes_the_file_or_names_the_standard(tmp_path: Path) -> None:
    folder = settled_set(tmp_path / "data", {"liner_threshold": {"threshold_kpa": 40.0}})
    out = tmp_path / "next.toml"
    ran = CliRunner().invoke(app, ["gap", "next", str(folder), "--out", str(out), "--json"])
    assert ran.exit_code == 0, ran.output
    told = json.loads(ran.stdout)
    advised = told["next_experiment"]
    assert advised is None or (told["protocol_file"] is None) == (
        advised["protocol"] == "reference"
    )
    assert out.exists() == (told["protocol_file"] is not None)


# ---------------------------------------------------------------------------- advice that holds


@pytest.mark.parametrize(
    ("protocol", "after", "barely"),
    [("step", 3.4, True), ("step", 5.1, False), ("reference", 3.4, False), ("step", np.nan, False)],
)
def test_a_promise_that_an_inexact_form_may_break_is_said_to_be_barely_enough(
    protocol: str, after: float, barely: bool
) -> None:
    """A standard measures one effect by itself: its promise does not rest on the others' forms."""
    told = barely_enough(Experiment(protocol, {}, 1.0, after, 2, ("creep", "wear")))
    assert (told is not None) == barely


@pytest.mark.campaign
def test_on_practice_sets_the_advised_experiment_separates_the_pair(tmp_path: Path) -> None:
    """Of pairs that hold the truth and are not told apart yet, at least nine in ten then are.

    Of those whose experiment promises enough for forms that are not exact: of the others `next`
    says that it is barely enough.
    """
    rows = [advice_campaign.one(number, tmp_path / f"{number}") for number in range(300, 601)]
    advised = [row for row in rows if row is not None and row.get("achieved") is not None]
    print("\n".join(advice_campaign.told(advised)))
    tried = [row for row in advised if row["predicted"] >= DESIGN.kept_sd]
    assert len(tried) >= 5
    apart = sum(row["achieved"] > 0.7 * DESIGN.enough_sd for row in tried)
    assert apart >= 0.9 * len(tried), tried
