"""The loop of tests and diagnosis on virtual benches, plain and withheld."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import cli.investigate.investigate as loop
from blind.live import Secret
from cli.investigate.config import INVESTIGATION
from cli.investigate.investigate import Investigation, investigate
from cli.investigate.survey import Test, battery, protocol_text
from daq.clock import VirtualClock
from daq.errors import PamrigError
from daq.interrupt import StopFlag
from daq.store.run import open_run
from gap.data.dataset import DataSet
from gap.data.run_trials import run_trials
from gap.decision.diagnose import diagnose_without_term
from gap.reason import Cause, Reason
from gap.verdict import Experiment, Status, Verdict
from plant.effects.catalogue import CATALOGUE
from rigs.bench.rig import open_rig
from rigs.execution.session import run_protocol
from rigs.protocols.registry import procedure
from rigs.rigfile.config import RigConfig, load_rig
from rigs.steps.schedule import outline
from rigs.virtual.bench import VirtualBench
from rigs.virtual.withheld.bench import WithheldBench, draw
from withheld_campaign import MIMICKED, RIG, entropy_of, judged, read_journal, seeds_of, totals


def rig_with(folder: Path, effects: str) -> RigConfig:
    path = folder / "rig.toml"
    path.write_text(load_rig("virtual").text + "\n" + effects)
    return load_rig(str(path))


# ---------------------------------------------------------------------------- what is run


@pytest.mark.parametrize("again", [False, True])
@pytest.mark.parametrize("rig", ["virtual", "virtual-instruments", "virtual-thesis-loop"])
def test_every_test_of_a_survey_is_one_that_the_rig_can_run(
    rig: str, again: bool, tmp_path: Path
) -> None:
    config = load_rig(rig)
    for test in battery(config, again):
        path = tmp_path / "test.toml"
        path.write_text(protocol_text(test, config))
        plan = procedure(test.protocol).read(str(path), config)
        points, seconds = outline(plan.steps(), config.stage.speed_mm_s or 10.0)
        assert points >= 2 * INVESTIGATION.repeats, test.what
        assert 0.0 < seconds < 1500.0, test.what


def test_a_rig_with_a_thermometer_is_also_warmed_and_one_with_a_regulator_tries_no_valve() -> None:
    def names(rig: str) -> set[str]:
        return {test.protocol for test in battery(load_rig(rig))}

    assert "isothermal" in names("virtual-instruments")
    assert "isothermal" not in names("virtual")
    assert "step" in names("virtual")
    assert "step" not in names("virtual-thesis")


def test_made_again_every_test_of_a_survey_is_at_settings_of_its_own() -> None:
    config = load_rig("virtual-instruments")
    first = {test.what: test.settings for test in battery(config)}
    again = battery(config, again=True)
    assert {test.what for test in again} == set(first)
    assert all(test.settings != first[test.what] for test in again)


def test_valves_are_tried_again_with_a_short_and_with_a_long_muscle() -> None:
    """What stores gas beside the muscle counts for less where the muscle holds more."""
    config = load_rig("virtual-instruments")
    (usual,) = (t.settings["length_mm"] for t in battery(config) if t.kind == ("step", False))
    short, long = (
        t.settings["length_mm"] for t in battery(config, True) if t.kind == ("step", False)
    )
    assert short < usual - 5.0
    assert long > usual + 5.0


@pytest.mark.parametrize(
    ("protocol", "why", "expected"),
    [
        ("isotonic", "pressures up and down under two loads", "pressures under two loads"),
        ("isometric", "a minute at each of two pressures: ...", "a minute at each"),
        ("step", "the chamber shut for half a minute at two pressures", "a chamber that is shut"),
        ("hysteresis", "cycles up and down at two lengths", "pressures at three lengths"),
        ("reference", "", "pressures at three lengths"),
    ],
)
def test_what_is_advised_is_run_next_and_otherwise_the_next_of_the_list(
    protocol: str, why: str, expected: str, tmp_path: Path
) -> None:
    left, again = battery(load_rig("virtual")), battery(load_rig("virtual"), again=True)
    settings: dict[str, Any] = {}
    if why.startswith("a minute"):
        settings = {"measure": {"seconds": 60.0}}
    elif "shut" in why:
        settings = {"schemes": ["two"], "step_s": 30.0}
    experiment = Experiment(protocol, settings, 1.0, 4.0, 2, ("a", "b"), why)
    running = loop._Running(load_rig("virtual"), tmp_path, None)
    running.verdict = Verdict(
        "unknown", Reason(Cause.NO_GAP), None, (), 0.0, 1.0, None, (), (), {}, experiment, {}
    )
    for tests in (left, again) if protocol != "reference" else (left,):
        count = len(tests)
        chosen = running.next(left, again)
        assert chosen is not None
        assert chosen[0].what.startswith(expected)
        assert chosen[1].startswith("advised") == (protocol != "reference")
        assert len(tests) == count - 1


# ---------------------------------------------------------------------------- the loop


def few(config: RigConfig, again: bool = False) -> list[Test]:
    del config, again
    held = {"lengths_mm": [54.0, 60.0, 66.0], "pressures_kpa": [60, 150, 350, 550], "repeats": 3}
    steps = {"schemes": ["two"], "pressures_kpa": [300, 100], "step_s": 0.6, "supply_kpa": 600,
             "length_mm": 60.0, "repeats": 3}  # fmt: skip
    return [Test("isometric", "short", held), Test("step", "short", steps)]


def test_an_effect_of_the_plant_is_named_after_the_first_two_tests(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(loop, "battery", few)
    config = rig_with(tmp_path, "[effects.liner_threshold]\nthreshold_kpa = 80\n")
    told: list[str] = []
    found = investigate(config, tmp_path / "runs", report=told.append, derive=False)
    assert found.conclusion == "named"
    assert len(found.rounds) == INVESTIGATION.first_diagnosis_after
    assert found.rounds[0].status == ""
    assert found.rounds[-1].effects[0] == "liner_threshold"
    value = found.verdict.effects[0].parameters["threshold_kpa"].value
    assert float(value) == pytest.approx(80.0, rel=0.2)
    written = json.loads((tmp_path / "runs" / "investigation" / "investigation.json").read_text())
    assert written["conclusion"] == "named"
    assert len(told) == 4


def found_on(
    tests: Callable[..., list[Test]], effects: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Investigation:
    """What an investigation with some tests finds on a virtual bench with some effects."""
    monkeypatch.setattr(loop, "battery", tests)
    return investigate(rig_with(tmp_path, effects), tmp_path / "runs", derive=False)


def elsewhere(config: RigConfig, again: bool = False) -> list[Test]:
    """Steps alone can be made again, at other pressures and another length."""
    held, steps = few(config)
    if not again:
        return [held, steps]
    other = {"pressures_kpa": [400, 200], "length_mm": 57.0}
    return [dataclasses.replace(steps, settings={**steps.settings, **other})]


def test_a_limit_that_pushes_where_the_force_is_tared_needs_no_force_zero_beside_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Tares are made at 54 mm, vented: what pushes there is missing from every reading."""
    limit = "[effects.contraction_limit]\nforce_n = 6\n"
    found = found_on(few, limit, tmp_path, monkeypatch)
    assert (found.conclusion, found.family) == ("named", CATALOGUE["contraction_limit"].family)
    assert found.verdict.effects[0].ids == ("contraction_limit",)
    trials = pd.read_csv(found.folder / "data-02" / "trials.csv")
    assert set(trials["tare_length_mm"]) == {54.0}  # the balance keeps it for the step test


def shut_too(config: RigConfig, again: bool = False) -> list[Test]:
    """The short tests, and after them the chamber that is shut."""
    made = few(config)
    return made if again else [*made, *(t for t in battery(config) if t.kind == ("step", True))]


def test_a_small_leak_shows_where_the_chamber_is_shut_for_half_a_minute(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """0.02 kPa/s at 400 kPa: hidden by a loop that holds the pressure, and by steps of a second."""
    leak = "[effects.leak]\nconductance_m3_s_pa = 4e-15\n"
    found = found_on(shut_too, leak, tmp_path, monkeypatch)
    assert [r.status for r in found.rounds[1:]] == ["no_gap_above_floor", "named"]
    assert found.verdict.effects[0].ids == ("leak",)
    assert found.verdict.headline_gap is not None
    assert found.verdict.headline_gap.unit == "kPa"  # no force, that a leak leaves as it is
    amount = found.verdict.effects[0].parameters["conductance_m3_s_pa"]
    assert float(amount.low) < 4e-15 < float(amount.high)
    assert float(amount.value) == pytest.approx(4e-15, rel=0.2)


@pytest.mark.parametrize("stopped", [False, True])
def test_what_has_no_name_is_described_once_at_the_end_and_a_stop_does_not_wait_for_it(
    stopped: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All names but one are struck from the catalogue, so that the gap has none."""

    def knowing_leaks(data: DataSet) -> Any:
        return diagnose_without_term(data, set(CATALOGUE) - {"leak"})

    def once(config: RigConfig, again: bool = False) -> list[Test]:
        return [] if again else few(config)

    monkeypatch.setattr(loop, "battery", once)
    monkeypatch.setattr(loop, "diagnose_without_term", knowing_leaks)
    config = rig_with(tmp_path, "[effects.liner_threshold]\nthreshold_kpa = 80\n")
    stop = StopFlag()
    told: list[str] = []

    def report(text: str) -> None:
        told.append(text)
        if stopped and len(told) == 4:  # the second of two tests is diagnosed
            stop.set("Ctrl-C")

    found = investigate(config, tmp_path / "runs", report=report, derive=False, stop=stop)
    assert len(found.rounds) == 2
    assert found.verdict.status == Status.UNKNOWN
    stored = json.loads((found.folder / "investigation.json").read_text())["verdict"]
    assert (stored.get("empirical") is None) == stopped
    if not stopped:
        assert stored["empirical"]["channel"] == "force"
        assert stored["empirical"]["closed"] > 0.5


def test_a_fault_in_a_later_test_ends_it_with_what_the_tests_before_allow_to_say(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing goes on by itself after a fault, and nothing measured before it is lost."""
    monkeypatch.setattr(loop, "battery", few)
    config = rig_with(tmp_path, "")
    bench = VirtualBench(config, VirtualClock())

    def report(text: str) -> None:
        if text.startswith("round 2"):
            bench.board.sensor_override = 0  # the wire comes off between two tests

    found = investigate(config, tmp_path / "runs", bench=bench, report=report, derive=False)
    assert [r.protocol for r in found.rounds] == ["isometric"]
    assert found.conclusion == "no gap"
    assert "sensor_no_rise" in str(found.ended)
    stored = json.loads((found.folder / "investigation.json").read_text())
    assert stored["ended"] == found.ended
    assert stored["verdict"]["status"] == "no_gap_above_floor"


@pytest.mark.campaign  # some 20 s: two tests of a bench, two diagnoses and a prediction
def test_delays_that_look_alike_are_named_by_their_family_once_steps_elsewhere_are_foretold(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At one supply a delay and its slope are one thing, so no diagnosis names either alone."""
    late = '[effects.valve_delay]\ndelay_ms = 6\nedge = "inlet_on"\n'
    found = found_on(elsewhere, late, tmp_path, monkeypatch)
    assert [r.protocol for r in found.rounds] == ["isometric", "step", "step"]
    first, again = found.rounds[1:]
    assert first.status == again.status == "indistinguishable"
    assert {"valve_delay", "valve_delay_pressure"} <= set(again.effects)
    assert again.why == "at other settings, to see whether valve_delay predicts it"
    assert first.predicted is None
    assert again.predicted is not None
    assert again.predicted["confirmed"]
    assert again.predicted["share"] > 0.9
    assert found.conclusion == "named"
    assert "confirmed by the step test" in found.why
    assert found.family == "valve_timing"
    assert {"valve_delay", "valve_delay_pressure"} <= set(found.references)


@pytest.mark.campaign  # some 40 s: three tests of a bench and two diagnoses
def test_a_bench_without_an_effect_whose_gauge_ends_at_zero_has_no_gap(tmp_path: Path) -> None:
    """Its zero is 0.4 kPa below: vented, it reads exactly 0, and looked like another valve."""
    config = load_rig(RIG, 623)
    constants = draw(config, entropy=entropy_of(623)).constants
    bench = WithheldBench(config, Secret((), constants, {}), VirtualClock())
    found = investigate(config, tmp_path, budget_min=8.5, bench=bench, derive=False)
    assert len(found.rounds) >= 3
    assert (found.verdict.status, found.verdict.effects) == (Status.NO_GAP_ABOVE_FLOOR, ())


def test_a_second_investigation_has_a_folder_of_its_own(tmp_path: Path) -> None:
    names = [loop._own_folder(tmp_path).name for _ in range(3)]
    assert names == ["investigation", "investigation-2", "investigation-3"]


def test_nothing_is_begun_where_it_is_to_stop_or_has_no_time(tmp_path: Path) -> None:
    stop = StopFlag()
    stop.set("Ctrl-C")
    with pytest.raises(PamrigError, match="no test was run to its end"):
        investigate(load_rig("virtual"), tmp_path, stop=stop)
    with pytest.raises(PamrigError, match="--budget"):
        investigate(load_rig("virtual"), tmp_path, budget_min=0.0)


def test_a_bench_goes_on_from_one_test_to_the_next(tmp_path: Path) -> None:
    config = rig_with(tmp_path, "[effects.wear]\npercent_per_100_trials = -20\n")
    bench = VirtualBench(config, VirtualClock())
    times = []
    for _ in range(2):
        with open_rig(config, bench=bench) as rig:
            assert rig.bench is bench
            rig.event_loop.for_seconds(0.2)
            assert rig.valve.seq_end > 0
            assert rig.balance.rows > 0
            times.append(bench.time_s)
    assert times[1] > times[0] > 0.2


# ---------------------------------------------------------------------------- sweeps


SWEPT = (
    'protocol = "isobaric"\npressures_kpa = [200]\nlengths_mm = [58.0, 62.0]\nrepeats = 1\n'
    "slack_length_mm = 54.0\n[precondition]\ncycles = 0\n[settle]\ntimeout_s = 2.0\n"
    "[sweeps]\nfrom_mm = 58.0\nto_mm = 62.0\nspeeds_mm_s = [{speeds}]\n"
)


def test_a_sweep_is_a_trial_of_its_own_seen_by_the_camera_all_the_way(
    tmp_path: Path,
) -> None:
    path = tmp_path / "swept.toml"
    path.write_text(SWEPT.format(speeds="4.0"))
    config = load_rig("virtual")
    kind = procedure("isobaric")
    result = run_protocol(kind, config, kind.read(str(path), config), tmp_path / "runs")
    assert result.outcome == "clean"
    stepped, swept = run_trials(open_run(result.folder))
    assert swept.row["slot"] == f"{stepped.row['slot']} swept"
    assert "time_s" not in stepped.samples  # nobody saw the lengths between the points
    assert list(stepped.samples["length_mm"].round()) == [58.0, 62.0, 62.0, 58.0]
    assert stepped.samples["force_n"].diff().iloc[1] > 1.0
    seen = swept.samples[["time_s", "length_mm"]].dropna()
    assert len(seen) > 25
    middle = seen[(seen.length_mm > 58.3) & (seen.length_mm < 61.7)]
    rate = abs(middle.length_mm.diff() / middle.time_s.diff())
    assert rate.median() == pytest.approx(4.0, rel=0.05)


def test_a_bench_that_hides_nothing_has_no_camera_out_of_time(tmp_path: Path) -> None:
    """A camera's own delay would pass for an effect of its own beside the one that is hidden."""
    path = tmp_path / "swept.toml"
    path.write_text(SWEPT.format(speeds="8.0"))
    config = load_rig(RIG)
    kind = procedure("isobaric")
    result = run_protocol(kind, config, kind.read(str(path), config), tmp_path / "runs")
    (swept,) = (t for t in run_trials(open_run(result.folder)) if "swept" in t.row["slot"])
    seen = swept.samples[["time_s", "length_mm"]].dropna()
    pull = swept.samples[["time_s", "force_n"]].dropna()
    pull = pull[(pull.time_s > seen.time_s.iloc[0]) & (pull.time_s < seen.time_s.iloc[-1])]
    lags_s = np.linspace(-0.04, 0.04, 41)
    left = [
        np.polyfit(
            np.interp(pull.time_s + lag, seen.time_s, seen.length_mm), pull.force_n, 2, full=True
        )[1][0]
        for lag in lags_s
    ]
    assert abs(lags_s[int(np.argmin(left))]) < 0.006


def test_sweeps_beyond_the_stage_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "swept.toml"
    config = load_rig("virtual")
    path.write_text(SWEPT.format(speeds="40.0"))
    with pytest.raises(PamrigError, match=r"swept.toml.*speeds_mm_s"):
        procedure("isobaric").read(str(path), config)
    path.write_text(SWEPT.format(speeds="4.0"))
    by_hand = dataclasses.replace(config, stage=dataclasses.replace(config.stage, kind="manual"))
    with pytest.raises(PamrigError, match="moved by hand"):
        procedure("isobaric").read(str(path), by_hand)


# ---------------------------------------------------------------------------- the campaign


def row(
    hidden: str, conclusion: str, families: list[str], confounder: float = 0.0, asked: str = ""
) -> dict[str, object]:
    measured = {"mimic_index": confounder}
    one = {
        "answer": {"effects": [{"id": hidden, "family": hidden}], "measured": measured},
        "set": [{"ids": [f], "family": f} for f in families], "conclusion": conclusion,
        "named": families[0] if conclusion == "named" else None,
        "references": {asked: "a standard"} if asked else {},
    }  # fmt: skip
    return one | judged(one)


def test_the_campaign_judges_right_alike_and_wrong() -> None:
    rows = [
        row("friction", "named", ["friction"]),
        row("friction", "named", ["friction+rate"]),
        row("friction", "needs reference", ["rate", "friction"], MIMICKED),
        row("friction", "needs reference", ["rate", "friction"]),
        row("friction", "needs reference", ["rate"], MIMICKED),
        row("friction", "open", []),
        row("friction", "needs reference", [], MIMICKED, asked="friction"),
    ]
    assert [r["right"] for r in rows] == [True, False, False, False, False, False, False]
    assert [r["wrong"] for r in rows] == [False, True, False, False, False, False, False]
    assert [r["confirmed"] for r in rows] == [False, False, True, False, False, False, True]
    assert totals(rows)["right family named"].of == 7


def test_the_campaign_goes_on_after_a_line_that_was_cut_short(tmp_path: Path) -> None:
    journal = tmp_path / "journal.jsonl"
    journal.write_text('{"seed": 3}\n{"seed": 4}\n{"se')
    assert sorted(read_journal(journal)) == [3, 4]
    assert seeds_of("0-2,7") == [0, 1, 2, 7]
    assert len({entropy_of(seed) for seed in range(50)}) == 50
