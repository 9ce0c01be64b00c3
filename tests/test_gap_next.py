"""What to measure next: foreseen separations, files that run, and advice that holds on benches."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from blind.bench import Trial as BlindTrial
from blind.exchange import write
from blind.recording import record
from blind.sets import BlindSet, blind_set
from daq.run import open_run
from gap.advise import ENOUGH, REFERENCES, advise, protocol_text
from gap.dataset import Trial
from gap.foresight import foreseen, products, separation
from gap.inquiry import Inquiry, State
from gap.library import Candidate, candidates
from gap.naming import name_effects
from gap.opening import open_data
from gap.reader import read_dataset
from gap.runtrials import run_trials
from gap.verdict import Experiment
from gap_sets import settled_set
from plant.catalogue import CATALOGUE
from rigs.cli import app
from rigs.config import load_rig
from rigs.protocols.registry import procedure
from rigs.protocols.schedule import outline
from rigs.session import run_protocol


def fitted(q: Inquiry, name: str, amount: float) -> State:
    """The best of an effect's shapes."""
    fits = [q.fit_afresh([s], [amount]) for s in q.suspects if s.id == name]
    return min(fits, key=lambda f: f.cost)


@pytest.fixture(scope="module")
def alike(tmp_path_factory: pytest.TempPathFactory) -> tuple[Inquiry, State, State]:
    """Settled tables in which a liner and a pressure zero look much alike."""
    hidden = {"liner_threshold": {"threshold_kpa": 6.0}}
    q = Inquiry(open_data(settled_set(tmp_path_factory.mktemp("next") / "alike", hidden)))
    return q, fitted(q, "liner_threshold", 6.0), fitted(q, "pressure_zero", 6.0)


@pytest.fixture(scope="module")
def library(alike: tuple[Inquiry, State, State]) -> list[Candidate]:
    return candidates(alike[0], alike[1])


def as_experiment(candidate: Candidate, repeats: int) -> Experiment:
    settings = {**candidate.settings, "repeats": repeats}
    return Experiment(candidate.protocol, settings, 1.0, 4.0, repeats, ("a", "b"), candidate.what)


# ---------------------------------------------------------------------------- foresight


def test_an_explanation_is_not_told_from_itself(alike: tuple[Inquiry, State, State]) -> None:
    q, liner, _ = alike
    assert separation(products(q, liner, liner), liner) == pytest.approx(0.0, abs=1e-6)


def test_more_of_an_experiment_separates_more(
    alike: tuple[Inquiry, State, State], library: list[Candidate]
) -> None:
    q, liner, zero = alike
    present = products(q, liner, zero)
    for candidate in library:
        one = products(foreseen(q, candidate), liner, zero)
        apart = [separation(present + one.times(n), zero) for n in (0, 1, 4)]
        assert apart[0] <= apart[1] + 1e-9 <= apart[2] + 2e-9, candidate.what


def test_kinds_that_the_data_hold_nothing_of_are_foreseen(
    alike: tuple[Inquiry, State, State], library: list[Candidate]
) -> None:
    q = alike[0]
    assert {t.protocol for t in q.data.trials} == {"isometric"}
    assert {c.protocol for c in library} >= {
        "isometric", "isobaric", "isotonic", "hysteresis", "isothermal", "step",
    }  # fmt: skip


def test_what_a_standard_settles_at_once_is_advised_before_hours_of_trials(
    alike: tuple[Inquiry, State, State],
) -> None:
    q, liner, zero = alike
    advised = advise(q, liner, [zero])
    assert advised is not None
    assert advised.protocol == "reference"
    assert advised.settings["standard"] == "vent"
    assert advised.separation_after > max(ENOUGH, advised.separation_now)
    assert set(advised.between) == {"liner_threshold", "pressure_zero"}


def test_two_muscle_effects_get_an_experiment_of_the_library(tmp_path: Path) -> None:
    hidden = {"bladder_elasticity": {"stiffness_n_mm": 0.08}}
    q = Inquiry(open_data(settled_set(tmp_path / "soft", hidden)))
    first, second = fitted(q, "bladder_elasticity", 0.08), fitted(q, "contraction_limit", 0.5)
    advised = advise(q, first, [second])
    assert advised is not None
    assert advised.protocol in {"isometric", "isobaric", "isotonic", "hysteresis", "step"}
    assert advised.trials >= 2
    assert advised.separation_after >= ENOUGH


def test_every_standard_is_for_an_effect_of_the_catalogue() -> None:
    assert set(REFERENCES) <= set(CATALOGUE)
    assert all(error > 0.0 for _, error in REFERENCES.values())


# ---------------------------------------------------------------------------- files that run


def test_every_experiment_of_the_library_makes_a_file_that_a_rig_takes(
    library: list[Candidate], tmp_path: Path
) -> None:
    for number, candidate in enumerate(library):
        rig = "virtual-instruments" if candidate.protocol == "isothermal" else "virtual"
        config = load_rig(rig)
        path = tmp_path / f"{number}.toml"
        counts = []
        for repeats in (2, 4):
            text = protocol_text(as_experiment(candidate, repeats))
            assert text is not None, candidate.protocol
            path.write_text(text)
            kind = procedure(candidate.protocol)
            counts.append(outline(kind.read(str(path), config).steps())[0])
        assert counts[1] == 2 * counts[0] > 0, candidate.what


def test_an_advised_file_runs_on_the_virtual_bench(
    library: list[Candidate], tmp_path: Path
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


def on_the_blind_bench(trial: Trial, at: int, mounting: int) -> BlindTrial:
    """An advised trial as the blind bench runs it: its courses as prescribed, not its answers."""

    def course(name: str) -> Any:
        channel = trial.channels[name]
        return channel.time_s, channel.value

    seconds = float(max(c.time_s[-1] for c in trial.channels.values()))
    valves = "inlet_cmd" in trial.channels
    hung = bool(np.isfinite(trial.load_kg))
    moves = "length_mm" in trial.channels and not hung
    edges = [
        (t, side, value)
        for side, name in enumerate(("inlet_cmd", "outlet_cmd"))
        if valves
        for t, value in zip(*course(name), strict=True)
        if t > 0.0
    ]
    fields: dict[str, Any] = {
        "pressure_hz": 500.0 if valves else 20.0, "force_hz": 80.0 if valves else 10.0,
        "camera_hz": 10.0 if hung or moves else 0.0,
    }  # fmt: skip
    if valves:
        fields["edges"] = np.array(sorted(edges), dtype=float)
    else:
        t, p = course("pressure_kpa")
        fields |= {"regulator": (t, np.maximum(p, 0.0)), "regulator_s": 0.05}
    if hung:
        fields["load_kg"] = trial.load_kg
    elif moves:
        fields["length"] = course("length_mm")
    else:
        fields["held_mm"] = trial.held_length_mm
    return BlindTrial(
        f"advised{at}", f"advised-{trial.slot}", trial.protocol, at, mounting, 1000 + at, seconds,
        **fields,
    )  # fmt: skip


def with_advised(one: BlindSet, candidate: Candidate, repeats: int) -> BlindSet:
    more = [
        on_the_blind_bench(trial, k * len(candidate.trials) + j, 0)
        for k in range(repeats)
        for j, trial in enumerate(candidate.trials)
    ]
    design = replace(one.design, trials=(*one.design.trials, *more))
    return replace(one, design=design)


@pytest.mark.campaign
def test_on_practice_sets_the_advised_experiment_separates_the_pair(tmp_path: Path) -> None:
    """Of pairs that hold the truth and are not told apart yet, at least nine in ten then are."""
    told = []
    for number in range(300, 380):
        one = blind_set("practice", number, small=True)
        if one.kind != "single" or any(t.settled_s is not None for t in one.design.trials):
            continue
        folder = tmp_path / f"{number}"
        write(record(one), folder)
        q = Inquiry(read_dataset(folder))
        naming = name_effects(q)
        pair = [naming.chosen, *naming.rivals[:1]]
        truth = one.hidden[0].id
        at = [k for k, choice in enumerate(pair) if choice.state.ids == (truth,)]
        if len(pair) < 2 or not at:
            continue
        right, wrong = pair[at[0]].state, pair[1 - at[0]].state
        now = separation(products(q, right, wrong), wrong)
        if now > 2.0 * ENOUGH:
            continue
        advised = advise(q, right, [wrong])
        if advised is None or advised.protocol == "reference" or "like_slot" in advised.settings:
            continue
        chosen = next(
            c for c in candidates(q, right) if {**c.settings, "repeats": 0}
            == {**advised.settings, "repeats": 0} and c.protocol == advised.protocol
        )  # fmt: skip
        again = tmp_path / f"{number}-more"
        write(record(with_advised(one, chosen, int(advised.settings["repeats"]))), again)
        more = Inquiry(read_dataset(again))
        keys = [{s.key for s in state.suspects} for state in (right, wrong)]
        fits = [
            min(
                (more.polish(more.fit_afresh([s], [s.step])) for s in more.suspects
                 if s.key in own), key=lambda f: f.cost,
            )
            for own in keys
        ]  # fmt: skip
        gained = fits[1].cost - fits[0].cost
        told.append((number, truth, wrong.ids, now, advised.separation_after, gained))
        print(told[-1], flush=True)
    assert len(told) >= 5
    apart = sum(gained > 0.5 * ENOUGH**2 for *_, gained in told)
    assert apart >= 0.9 * len(told), told
