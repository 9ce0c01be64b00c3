"""Controllers of the finger through the firmware: what they reach, and that nothing goes around."""

from __future__ import annotations

import dataclasses
import json
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from cli.main import main
from plant.finger import FingerSim, load_finger
from plant.finger.reader import load_valve
from plant.links.dynamics import forward_dynamics, inverse_dynamics
from plant.physics.friction import slip_history
from studies.comparison.figures import PathFigures, StepFigures, path_figures, step_figures
from studies.comparison.report import as_markdown, as_text, plants_markdown
from studies.comparison.spread import over_draws, spread
from studies.comparison.study import BARE, LADEN, PERTURBED, Case, Row, run_case, run_trial, table
from studies.controllers.adaptive import Adaptive, payload_regressor
from studies.controllers.bench import FingerBench, Sensing
from studies.controllers.feedforward import FeedForward
from studies.controllers.fibres import Fibres
from studies.controllers.laws import LAWS, build_law, tuning
from studies.controllers.loop import run_law
from studies.controllers.muscles import Pairs
from studies.controllers.reference import GRID_S, Reference, circle, step, tips

FINGER = load_finger()
CURED = load_valve("cured")


class TestReferences:
    def test_the_circle_is_one(self) -> None:
        """15 mm about its centre in the flexion plane, one turn in 4 s, within the range."""
        turn = circle(FINGER)
        tip = tips(FINGER.arm, turn.q)
        assert turn.tip is not None
        np.testing.assert_allclose(tip, turn.tip, atol=1e-9)
        last = tip[-4001:]
        centre = (last.max(axis=0) + last.min(axis=0)) / 2
        radius = np.linalg.norm(last - centre, axis=1)
        np.testing.assert_allclose(radius, 0.015, atol=1e-6)
        np.testing.assert_allclose(last[0], last[-1], atol=1e-9)
        stops = FINGER.stops
        assert np.all((turn.q > stops[:, 0]) & (turn.q < stops[:, 1]))

    def test_rates_are_those_of_the_angles(self) -> None:
        for reference in (circle(FINGER), step(FINGER).smooth):
            rate = np.gradient(reference.q, GRID_S, axis=0)
            push = np.gradient(reference.qd, GRID_S, axis=0)
            np.testing.assert_allclose(rate[2:-2], reference.qd[2:-2], atol=2e-3)
            np.testing.assert_allclose(push[2:-2], reference.qdd[2:-2], atol=0.3)

    def test_a_softened_step_arrives(self) -> None:
        reference = step(FINGER)
        np.testing.assert_allclose(reference.smooth.q[-1], reference.q[-1])
        assert np.degrees(np.ptp(reference.q[:, 1])) == pytest.approx(20.0)


class TestLawsOnIdealMuscles:
    """Pressures arrive at once and exactly: what is left of a law is its equations."""

    def follow(self, law: Any, reference: Reference, payload_kg: float) -> Any:
        pairs = Pairs(FINGER, CURED)
        arm = FINGER.arm.with_payload(payload_kg)
        q, qd = reference.q[0].copy(), np.zeros(4)
        law.start(reference, q)
        rows = []
        small = GRID_S / 3
        for k in range(-1500, len(reference.q)):  # the approach first, as through the firmware
            if k % 10 == 0:
                delta = law.delta(k * GRID_S, q)
            for _ in range(3):
                push = forward_dynamics(arm, q, qd, pairs.torque(q, delta))
                middle = qd + 0.5 * small * push
                push = forward_dynamics(arm, q + 0.5 * small * qd, middle, pairs.torque(q, delta))
                q, qd = q + small * middle, qd + small * push
            if k >= 0:
                rows.append(q.copy())
        return np.array(rows)

    def test_feed_forward_is_exact_on_the_nominal_finger(self) -> None:
        """Its torques are the inverse dynamics', so forward dynamics give back the wanted push."""
        t = tuning(FINGER, CURED)
        law = FeedForward(Pairs(FINGER, CURED), t.model, lead_s=0.0, rate=0.0, late_s=0.0)
        reference = circle(FINGER, turns=1)
        law.start(reference, reference.q[0])
        pairs = law.pairs
        for time in (0.0, 2.5, 3.1, 4.7):
            q, qd, qdd = reference.at(time)
            torque = pairs.torque(q, law.delta(time, q))
            push = forward_dynamics(FINGER.arm, q, qd, torque)
            np.testing.assert_allclose(push, qdd, atol=1e-9)

    def test_feed_forward_alone_follows_the_circle(self) -> None:
        t = tuning(FINGER, CURED)
        # Held for 10 ms, a value is 5 ms old on average.
        law = FeedForward(Pairs(FINGER, CURED), t.model, lead_s=0.005, rate=0.0)
        reference = circle(FINGER, turns=1, lead_s=0.2)
        got = self.follow(law, reference, 0.0)
        assert reference.tip is not None
        missed = np.linalg.norm(tips(FINGER.arm, got) - reference.tip, axis=1)
        assert np.sqrt(np.mean(missed**2)) < 1e-4

    @pytest.mark.parametrize("payload", [0.0, 0.020])
    def test_the_adaptive_law_learns_the_payload(self, payload: float) -> None:
        t = tuning(FINGER, CURED)
        law = Adaptive(Pairs(FINGER, CURED), t.model, 0.005, t.critical_rate / 3.0)
        self.follow(law, circle(FINGER, turns=1, lead_s=0.2), payload)
        assert law.mass_kg == pytest.approx(payload, abs=0.002)

    def test_the_payloads_torque_is_linear_in_it(self) -> None:
        r = np.random.default_rng(7)
        for _ in range(10):
            state = [r.uniform(-size, size, 4) for size in (1.0, 5.0, 50.0)]
            laden = inverse_dynamics(FINGER.arm.with_payload(0.037), *state)
            bare = inverse_dynamics(FINGER.arm, *state)
            np.testing.assert_allclose(
                bare + 0.037 * payload_regressor(FINGER.arm, *state), laden, rtol=1e-9, atol=1e-12
            )


class TestFibres:
    def test_they_slide_as_those_of_the_plant(self) -> None:
        """Mean slip of one muscle along a path, by the plant's own history."""
        pairs = Pairs(FINGER, CURED)
        angles = np.radians(np.concatenate([np.linspace(0, 30, 40), np.linspace(30, 12, 30)]))
        deltas = np.concatenate([np.linspace(0, 40, 40), np.linspace(40, -10, 30)])
        fibres, rows = Fibres(pairs), []
        for q, delta in zip(angles, deltas, strict=True):
            rows.append(fibres.torque(np.full(4, q), pairs.pressures(np.full(4, delta))))
        # From vented: both muscles are filled along their length at rest first, far enough.
        torque = np.zeros(len(angles))
        for side in (1.0, -1.0):
            kpa = np.concatenate([[0.0, 250.0], 250.0 + side * deltas])
            length = 0.062 - side * 0.008 * np.concatenate([[0.0, 0.0], angles])
            slip = slip_history(kpa * 1e3, length, 40e3, 0.4e-3)[2:]
            torque += side * 0.008 * kpa[2:] / 300.0 * slip
        np.testing.assert_allclose(np.array(rows)[:, 1], torque, atol=1e-12)

    def test_friction_takes_torque_the_way_it_moves(self) -> None:
        pairs = Pairs(FINGER, CURED)
        fibres = Fibres(pairs)
        for q in np.radians(np.linspace(0.0, 30.0, 60)):
            up = fibres.torque(np.full(4, q), np.full(8, 250.0))
        for q in np.radians(np.linspace(30.0, 10.0, 60)):
            down = fibres.torque(np.full(4, q), np.full(8, 250.0))
        full = 2 * 0.008 * 250.0 / 300.0
        np.testing.assert_allclose(up, full)
        np.testing.assert_allclose(down, -full)


class TestThroughTheFirmware:
    def bench(self, **more: Any) -> FingerBench:
        sim = FingerSim(FINGER, CURED)
        bench = FingerBench(sim, "burst", np.random.default_rng(1), **more)
        bench.begin()
        return bench

    def test_what_the_valves_are_told_is_the_firmwares(self) -> None:
        """Whole 5 us, never both sides of a pair of valves without the scheme, at most a tick."""
        bench = self.bench()
        bench.set_pressures(np.full(8, 200.0))
        seen = []
        advance = bench.sim.advance
        bench.sim.advance = lambda dt, on: (seen.append(on.copy()), advance(dt, on))[1]  # type: ignore[method-assign, assignment, func-returns-value]
        bench.run(400)
        on_us = np.array(seen) * 1e6
        assert np.abs(on_us / 5.0 - np.round(on_us / 5.0)).max() < 1e-9
        assert on_us.max() <= 1000.0
        assert np.any((on_us > 0.0) & (on_us < 1000.0))
        np.testing.assert_allclose(bench.sim.pressure_kpa, 200.0, atol=4.0)
        assert not bench.faults

    def test_a_silent_host_means_vented(self) -> None:
        bench = self.bench()
        bench.set_pressures(np.full(8, 200.0))
        bench.run(500)
        bench._send = lambda i, text: None  # type: ignore[method-assign]
        bench.run(1500)
        assert len(bench.faults) == 8
        assert all("host_silent" in fault for fault in bench.faults)
        assert np.all(bench.sim.pressure_kpa < 20.0)

    def test_words_and_angles_are_late(self) -> None:
        slow = self.bench(sensing=Sensing(line_delay_ms=30, angle_delay_ms=20))
        quick = self.bench()
        for bench in (slow, quick):
            bench.set_pressures(np.tile([300.0, 200.0], 4))
            bench.run(25)
        assert quick.sim.pressure_kpa.max() > 5.0
        assert slow.sim.pressure_kpa.max() < 3.0  # what falling makes
        before = slow.angles()
        slow.run(15)
        assert np.abs(slow.sim.q_rad - before).max() > np.abs(slow.angles() - before).max()

    def test_angles_come_in_steps_of_the_encoder(self) -> None:
        read = self.bench().angles() / (2 * np.pi / 4096)
        np.testing.assert_allclose(read, np.round(read), atol=1e-9)

    def test_equal_seeds_are_equal_runs(self) -> None:
        ends = []
        for seed in (1, 1, 2):
            law, scheme = build_law("feedforward", FINGER, CURED)
            trial = run_law(FINGER, CURED, law, step(FINGER, hold_s=0.2), scheme=scheme, seed=seed)
            ends.append(trial.q[-1])
        assert np.array_equal(ends[0], ends[1])
        assert not np.array_equal(ends[0], ends[2])


BEYOND_ADAPTIVE = (
    "liner takes 30 kPa",
    "braid threads 5 % longer",
    "braid threads 5 % shorter",
    "braid friction 4 N, fibres slide twice as far",
)
"""Cases that put the adaptive law off the circle by more than 1 mm; docs/use/control.md says so."""


def halving(law: str, valve: str, case: Case) -> float:
    """Largest relative change of any figure of step and circle when the finger's step is halved."""
    rows = [run_case(FINGER, law, valve, case, step_max_s=s) for s in (5e-5, 2.5e-5)]
    figures = [{**dataclasses.asdict(row.step), **dataclasses.asdict(row.path)} for row in rows]
    changes = []
    for key, value in figures[0].items():
        other = figures[1][key]
        if isinstance(value, float) and isinstance(other, float):
            changes.append(abs(value - other) / max(abs(other), 1e-3))
        else:
            assert value == other, key
    return max(changes)


def a_row(law: str = "pid", case: str = "no payload", seed: int = 1, **changes: Any) -> Row:
    step = StepFigures(0.1, 0.2, 5.0, 0.5, 0.1, 0.2, 0.3, 100.0, ())
    path = PathFigures(0.8, 2.0, 1.0, 200.0, ())
    return Row(
        law, "cured", case, seed,
        dataclasses.replace(step, **{k: v for k, v in changes.items() if hasattr(step, k)}),
        dataclasses.replace(path, **{k: v for k, v in changes.items() if hasattr(path, k)}),
    )  # fmt: skip


class TestOverDraws:
    def test_median_and_range(self) -> None:
        found = spread([3.0, 1.0, 2.0])
        assert (found.median, found.low, found.high) == (2.0, 1.0, 3.0)

    def test_never_is_above_every_number(self) -> None:
        assert spread([None, 1.0, 2.0]).as_list() == [2.0, 1.0, None]
        assert spread([None, None, 2.0]).median is None

    def test_a_case_is_all_its_draws_and_counts_those_that_hold(self) -> None:
        rows = [
            a_row(seed=1),
            a_row(seed=2, rms_mm=1.2, settling_s=None),
            a_row("adaptive", rms_mm=0.3),
            a_row(seed=3, rms_mm=0.9),
        ]
        pid, adaptive = over_draws(rows)
        assert (pid.draws, pid.held, adaptive.draws, adaptive.held) == (3, 2, 1, 1)
        assert pid.figures["rms_mm"].as_list() == [0.9, 0.8, 1.2]
        assert pid.figures["switchings_per_s"].as_list() == [150.0] * 3

    def test_the_tables_say_so(self) -> None:
        rows = [a_row(seed=k, rms_mm=mm) for k, mm in ((1, 0.8), (2, 1.2), (3, 0.9))]
        outcomes = over_draws([*rows, a_row(case="20 g", faults=("3: host_silent",))])
        page = as_markdown(outcomes).splitlines()
        assert "| 0.90 (0.80 to 1.20) |" in page[2]
        assert page[2].endswith("| 2 of 3 |")
        assert page[3].endswith("| 0 of 1, host_silent |")
        text = as_text(outcomes)
        assert "0.80..1.20" in text
        assert max(map(len, text.splitlines())) <= 160
        across = plants_markdown(over_draws([*rows, a_row("adaptive")])).splitlines()
        assert across[2] == ("| no payload | 0.90 (0.80 to 1.20) / 0.50 | 0.80 / 0.50 |")


class TestAcceptance:
    @pytest.mark.parametrize("case", [BARE, LADEN], ids=["bare", "laden"])
    @pytest.mark.parametrize("law", ["feedforward", "adaptive"])
    def test_the_circle_within_1_mm_and_the_step_within_1_degree(self, law: str, case: Any) -> None:
        row = run_case(FINGER, law, "cured", case)
        assert row.step.faults == row.path.faults == ()
        assert row.path.rms_mm <= 1.0
        assert row.step.steady_error_deg <= 1.0
        assert row.step.others_error_deg <= 1.0
        if law == "adaptive":
            assert row.learned_g == pytest.approx(case.payload_kg * 1e3, abs=4.0)

    def test_halving_the_step_changes_no_figure(self) -> None:
        """Through firmware, converters and encoders; the campaign does it for every controller."""
        assert halving("feedforward", "cured", BARE) < 1e-3

    @pytest.mark.campaign
    @pytest.mark.parametrize("case", [BARE, LADEN], ids=["bare", "laden"])
    @pytest.mark.parametrize("valve", ["thesis", "cured"])
    @pytest.mark.parametrize("law", LAWS)
    def test_halving_the_step_changes_no_figure_of_any(
        self, law: str, valve: str, case: Case
    ) -> None:
        assert halving(law, valve, case) < 1e-3

    def test_friction_of_the_braid_is_learnt(self) -> None:
        """2 N, of which no law is told, breaks the circle for all but the one that learns it."""
        case = next(c for c in PERTURBED if c.title == "braid friction 2 N")
        trial = run_trial(FINGER, "adaptive", "cured", case, circle(FINGER))
        assert path_figures(trial).rms_mm < 1.0
        # Abduction does not move on the circle, so nothing is known of its friction.
        learnt = trial.estimates[-1, 1:]
        np.testing.assert_allclose(learnt, [0.0, 2.0, 2.0, 2.0], atol=0.2)

    def test_the_thesis_schemes_swing_on_the_thesis_valve_only(self) -> None:
        ripple = {}
        for valve in ("thesis", "cured"):
            c = load_valve(valve)
            law, scheme = build_law("two", FINGER, c)
            trial = run_law(FINGER, c, law, step(FINGER, hold_s=1.5), scheme=scheme)
            ripple[valve] = step_figures(trial, 1).ripple_deg
        assert ripple["thesis"] > 5.0
        assert ripple["cured"] < 1.0

    @pytest.mark.campaign
    @pytest.mark.parametrize("seed", range(2, 8))
    @pytest.mark.parametrize("law", ["placement", "feedforward", "adaptive"])
    def test_other_noise_and_other_sensors(self, law: str, seed: int) -> None:
        for case in (BARE, LADEN):
            assert run_case(FINGER, law, "cured", case, seed).accepted

    @pytest.mark.campaign
    def test_plants_it_was_not_told_of(self) -> None:
        rows = table(FINGER, ["feedforward", "adaptive"], ["cured"], PERTURBED, range(1, 4))
        assert all(row.step.steady_error_deg <= 1.0 for row in rows)

    @pytest.mark.campaign
    @pytest.mark.parametrize("seed", range(1, 4))
    @pytest.mark.parametrize(
        "case",
        [case for case in PERTURBED if case.title not in BEYOND_ADAPTIVE],
        ids=lambda case: case.title,
    )
    def test_the_circle_holds_on_plants_it_was_not_told_of(self, case: Case, seed: int) -> None:
        assert run_case(FINGER, "adaptive", "cured", case, seed).accepted

    @pytest.mark.campaign
    def test_every_controller_runs_on_both_valves(self) -> None:
        rows = list(table(FINGER))
        assert len(rows) == 2 * len(LAWS) * 2


class TestCommand:
    @pytest.fixture
    def run(self, monkeypatch: pytest.MonkeyPatch) -> Callable[..., int]:
        """The command line's own entry point; returns its exit status."""

        def run(*words: str) -> int:
            monkeypatch.setattr(sys, "argv", ["pamrig", "study", *words])
            with pytest.raises(SystemExit) as ended:
                main()
            return int(ended.value.code or 0)

        return run

    def test_json_is_one_value(
        self, run: Callable[..., int], capsys: pytest.CaptureFixture[str]
    ) -> None:
        assert run("finger", "--laws", "feedforward", "--json") == 0
        value = json.loads(capsys.readouterr().out)
        assert value["whole"]
        assert [row["case"] for row in value["outcomes"]] == ["no payload", "20 g"]
        assert all(row["accepted"] == row["draws"] == 1 for row in value["outcomes"])
        assert [row["seed"] for row in value["draws"]] == [1, 1]

    @pytest.mark.parametrize(
        ("words", "said"),
        [
            (("finger", "--laws", "magic"), "controller 'magic': choose one of two"),
            (("finger", "--valve", "curd"), "did you mean cured"),
            (("finger", "--finger", "nowhere.toml"), "nowhere.toml: cannot be read"),
            (("controllers", "--laws", "magic"), "controller 'magic'"),
        ],
    )
    def test_what_cannot_be_is_one_line(
        self,
        run: Callable[..., int],
        capsys: pytest.CaptureFixture[str],
        words: tuple[str, ...],
        said: str,
    ) -> None:
        assert run(*words) == 2
        printed = capsys.readouterr()
        assert said in printed.err
        assert printed.out == ""
