"""Pause, resume, skip, repeat, mark and stop, on a running test on the virtual bench."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from analysis.reduction.points import reduce_isometric
from bench_runs import quick, run_isometric
from cli.protocols.request import tell_run
from daq.clock import NS_PER_S
from daq.errors import ConfigError, RecordError
from daq.store.run import Run, open_run
from daq.store.verify import verify
from protocol_runs import run_short
from rigs.execution.control import RunControl, control_file
from rigs.execution.runner import Runner, Watch
from rigs.protocols.isometric import Isometric
from rigs.protocols.parts.trials import in_words
from rigs.protocols.registry import procedure
from rigs.rigfile.config import load_rig
from rigs.steps.schedule import arrange, outline, path


def steered(
    root: Path, plan: Isometric, at: dict[int, Callable[[RunControl, Runner], None]]
) -> Run:
    """Run a test; after its nth point, ``at[n]`` asks for something."""
    config = load_rig("virtual")
    control = RunControl()
    kept: list[Runner] = []
    seen = [0]

    def point(*_: Any) -> None:
        seen[0] += 1
        if seen[0] in at:
            at[seen[0]](control, kept[0])

    result = run_isometric(
        config, plan, root, control=control, watch=Watch(point=point), derive=False,
        on_start=lambda runner, _: kept.append(runner),
    )  # fmt: skip
    assert result.outcome in ("clean", "stopped"), result.error
    assert not control_file(result.folder).exists()
    return open_run(result.folder)


def small(**changes: Any) -> Isometric:
    values = {"lengths_mm": (60.0,), "pressures_kpa": (100.0, 250.0, 400.0)}
    return quick(load_rig("virtual"), **{**values, **changes})


def events(run: Run, kind: str) -> list[dict[str, Any]]:
    return [event for event in run.events if event["kind"] == kind]


def test_a_paused_test_holds_its_pressure_and_goes_on(tmp_path: Path) -> None:
    def pause(control: RunControl, runner: Runner) -> None:
        control.request("pause")
        clock = runner.rig.clock
        until_ns = clock.now_ns() + 20 * NS_PER_S

        def wake() -> None:
            if clock.now_ns() >= until_ns:
                control.request("resume")
                runner.rig.event_loop.remove(wake)

        runner.rig.event_loop.add(wake)

    run = steered(tmp_path, small(), {3: pause})
    (held,) = events(run, "paused")
    assert held["seconds"] == pytest.approx(20.0, abs=0.5)
    assert len(events(run, "point")) == 6
    assert not events(run, "fault")
    asked = events(run, "control")
    assert [e["asked"] for e in asked] == ["pause", "resume"]
    # The last set-point held through the pause: no vent lies inside.
    valve = run.samples("valve")
    start_ns = run.manifest["started"]["monotonic_ns"]
    t_s = (valve["host_ns"].astype(np.int64) - start_ns) / 1e9
    inside = (t_s > asked[0]["t_ns"] / 1e9 + 1.0) & (t_s < asked[1]["t_ns"] / 1e9)
    assert np.ptp(valve["counts"][inside].astype(float)) < 30


def test_a_skipped_point_leaves_an_event_and_no_row(tmp_path: Path) -> None:
    run = steered(tmp_path, small(), {2: lambda control, _: control.request("s")})
    (skipped,) = events(run, "skipped")
    assert skipped["set_pressure_kpa"] == 400.0
    table = reduce_isometric(run).table
    assert len(table) == 5
    assert list(table["set_pressure_kpa"]) == [100.0, 250.0, 400.0, 250.0, 100.0]
    assert skipped["order"] not in list(table["order"])


def test_a_repeated_point_is_made_again_and_the_last_take_counts(tmp_path: Path) -> None:
    run = steered(tmp_path, small(), {2: lambda control, _: control.request("repeat")})
    points = events(run, "point")
    assert [(p["order"], p.get("take", 1)) for p in points] == [
        (1, 1), (2, 1), (2, 2), (3, 1), (4, 1), (5, 1), (6, 1)
    ]  # fmt: skip
    table = reduce_isometric(run).table
    assert list(table["order"]) == [1, 2, 3, 4, 5, 6]
    assert table["pressure_kpa"][1] == pytest.approx(250.0, abs=2.5)
    assert table["pressure_kpa"][2] == pytest.approx(400.0, abs=2.5)
    assert table["settled"].all()


def test_a_marker_goes_into_the_record_with_what_was_going_on(tmp_path: Path) -> None:
    run = steered(tmp_path, small(), {4: lambda control, _: control.request("m knocked the table")})
    (mark,) = events(run, "marker")
    assert mark["text"] == "knocked the table"
    assert mark["state"].startswith("trial 1")


def test_stop_by_the_control_ends_in_good_order(tmp_path: Path) -> None:
    run = steered(tmp_path, small(), {3: lambda control, _: control.request("stop")})
    assert run.outcome == "stopped"
    assert events(run, "vented")[-1]["confirmed"]
    assert len(reduce_isometric(run).table) == 3


def test_another_program_asks_through_the_control_file(tmp_path: Path) -> None:
    def tell(_: RunControl, runner: Runner) -> None:
        assert "sent to" in tell_run("last", tmp_path, "mark from outside")
        with pytest.raises(ConfigError, match="'jump'"):
            tell_run("last", tmp_path, "jump")
        del runner

    run = steered(tmp_path, small(), {1: tell})
    assert [e["text"] for e in events(run, "marker")] == ["from outside"]
    assert not verify(open_run(run.folder))
    with pytest.raises(RecordError, match="not running"):
        tell_run("last", tmp_path, "pause")


def test_every_trial_begins_and_ends_once(tmp_path: Path) -> None:
    run = steered(tmp_path, small(lengths_mm=(58.0, 64.0), repeats=2), {})
    trials = events(run, "trial")
    assert [(e["trial"], e["phase"]) for e in trials] == [
        (n, phase) for n in (1, 2, 3, 4) for phase in ("begin", "end")
    ]
    begins = [e for e in trials if e["phase"] == "begin"]
    assert [e["slot"] for e in begins] == ["L58", "L64", "L58", "L64"]
    assert [e["replicate"] for e in begins] == [1, 1, 2, 2]
    assert [e["held_length_mm"] for e in begins] == [58.0, 64.0, 58.0, 64.0]


def test_orders_of_trials() -> None:
    def settings(order: str, repeats: int = 2, mountings: tuple[str, ...] = ("m1",)) -> list[Any]:
        return [(p.mounting, p.replicate, s) for p, s in
                arrange("ABC", order, repeats, mountings, seed=4)]  # fmt: skip

    assert "".join(s for _, _, s in settings("up-down")) == "ABCABC"
    assert "".join(s for _, _, s in settings("abba")) == "ABCCBA"
    shuffled = settings("random", 50)
    assert shuffled == settings("random", 50)
    for k in range(50):
        assert sorted(s for _, r, s in shuffled if r == k + 1) == ["A", "B", "C"]
    again = settings("up-down", 2, ("m1", "m2"))
    assert [(m, r) for m, r, s in again if s == "A"] == [("m1", 1), ("m1", 2), ("m2", 3), ("m2", 4)]
    up_down = path((2.0, 1.0), "abba", np.random.default_rng(1))
    assert up_down == [("up", 1.0), ("up", 2.0), ("down", 2.0), ("down", 1.0)]


def test_the_estimate_of_duration_is_near(tmp_path: Path) -> None:
    plan = small(lengths_mm=(57.0, 61.0, 65.0))
    points, seconds = outline(plan.steps())
    assert points == plan.points
    run = steered(tmp_path, plan, {})
    assert run.final is not None
    assert seconds == pytest.approx(run.final["duration_s"], rel=0.35)


@pytest.mark.parametrize(("name", "points", "most"), [("step", 4, 100.0), ("ram", 2, 10.0)])
def test_every_point_is_put_into_the_live_view(
    tmp_path: Path, name: str, points: int, most: float
) -> None:
    shown: list[tuple[float, float, str]] = []
    watch = Watch(result=lambda x, y, label: shown.append((x, y, label)))
    _, run, _ = run_short(name, tmp_path, how={"watch": watch})
    made = events(run, "point")
    assert len(shown) == len(made) == points
    layout = procedure(name).analysis.layout(run.manifest["parameters"])
    panels = [p for column in layout.columns for p in column if getattr(p, "kind", "") == "points"]
    assert panels, "the view has a panel for them"
    for (x, y, label), event in zip(shown, made, strict=True):
        assert label in (event.get("scheme"), event["slot"])
        assert 0.0 < y < most
        assert 0.0 <= x <= 700.0


@pytest.mark.parametrize(
    ("slot", "words"),
    [
        ("M1.154 to 400 kPa", "1.154 kg to 400 kPa"), ("P300 swept", "300 kPa swept"),
        ("L64", "64 mm"), ("M5", "5 kg"), ("M12.5", "12.5 kg"),
        ("300 ± 40 kPa", "300 ± 40 kPa"), ("Lower", "Lower"),
    ],
)  # fmt: skip
def test_a_trial_is_shown_with_its_unit(slot: str, words: str) -> None:
    assert in_words(slot) == words
