"""Two muscles are safe together: whatever becomes of one, both are vented in time."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from daq.errors import ConfigError, PamrigError
from daq.store.run import Run
from joint_bench import joint_rig, run_joint
from plant.physics.layout import PRESSURE
from plant.scene import layout as sc
from protocol_runs import events
from rigs.bench.rig import open_rig
from rigs.bench.vent import vent_rig
from rigs.execution.runner import Runner
from rigs.protocols.registry import procedure
from rigs.rigfile.config import load_rig
from rigs.virtual.bench import VirtualBench

HEARTBEAT_S = 0.3
LEFT_S = 0.05
"""After its last beat a controller waits its deadline out; the loop and the link take some more."""
TOLD_S = 0.1
"""A host that lives tells the other controller within some rounds of its loop."""
EMPTY_KPA = 20.0
EMPTY_S = 1.5
"""As the safety contract states for this valve."""

Harm = Callable[[VirtualBench], object]


def harmed(root: Path, harm: Harm, after_s: float = 1.0) -> tuple[Any, Run, VirtualBench, int]:
    """A test of a joint that is harmed with both muscles under pressure: also the moment, in us."""
    at_us: list[int] = []

    def begin(runner: Runner) -> None:
        rig = runner.rig
        bench = rig.bench
        assert bench is not None
        since: list[int] = []

        def look() -> None:
            if at_us or not runner.armed or bench.plant.pressures_kpa.min() < 150.0:
                return
            since[:] = since or [rig.clock.now_ns()]
            if rig.clock.now_ns() - since[0] >= after_s * 1e9:
                at_us.append(bench.board.bench_us)
                harm(bench)

        rig.event_loop.add(look)

    changes = {"difference_kpa": (60.0,), "angles_deg": (), "measure_s": 3.0}
    result, run, bench = run_joint("joint-static", root, begin=begin, **changes)
    assert bench.clock is not None
    bench.clock.sleep(EMPTY_S)  # what the host does no more, the firmware does
    return result, run, bench, at_us[0]


def check_vented(bench: VirtualBench, at_us: int, within_s: dict[str, float]) -> None:
    for name, limit_s in within_s.items():
        board = bench.boards[name]
        assert board.vent_commanded_us > at_us, name
        assert (board.vent_commanded_us - at_us) * 1e-6 <= limit_s, name
        assert board.pressure_kpa < EMPTY_KPA, name
        assert not board.controller.safety.armed, name


@pytest.mark.parametrize("lost", ["valve", "valve_b"])
def test_the_link_of_either_lost_vents_both(tmp_path: Path, lost: str) -> None:
    result, run, bench, at_us = harmed(tmp_path, lambda bench: bench.unplug(lost))
    assert result.outcome == "faulted"
    other = "valve_b" if lost == "valve" else "valve"
    check_vented(bench, at_us, {lost: HEARTBEAT_S + 0.1 + LEFT_S, other: TOLD_S})
    (unconfirmed,) = events(run, "vent_unconfirmed")
    assert f"{other} vented to" in unconfirmed["reason"]


@pytest.mark.parametrize(("unit", "name"), [(0, "valve"), (1, "valve_b")])
def test_over_pressure_of_one_muscle_vents_both(tmp_path: Path, unit: int, name: str) -> None:
    def burst(bench: VirtualBench) -> None:
        plant: Any = bench.plant
        plant.scene.world.units[unit, PRESSURE] = 600e3

    result, run, bench, at_us = harmed(tmp_path, burst)
    assert result.outcome == "faulted"
    assert "over_pressure" in str(result.error)
    other = "valve_b" if name == "valve" else "valve"
    check_vented(bench, at_us, {name: 0.01, other: TOLD_S})
    assert [e["device"] for e in events(run, "fault")] == [name]
    assert events(run, "vented")[0]["confirmed"]


def _mute(bench: VirtualBench) -> None:
    encoder: Any = bench.extras.devices["encoder"]
    encoder.mute = True


def _push(bench: VirtualBench) -> None:
    """Somebody turns the joint against both muscles; it takes some 0.2 s to get there."""
    plant: Any = bench.plant
    plant.scene.world.coords[0, sc.PULL] = 0.6


@pytest.mark.parametrize(
    ("harm", "words", "limit_s"),
    [
        (lambda bench: bench.unplug("encoder"), "unplugged", TOLD_S),
        (_mute, "no reading for 0.5 s", 0.5 + TOLD_S),
        (_push, "outside -45 to 45 deg", 0.3 + TOLD_S),
    ],
    ids=["unplugged", "silent", "beyond its range"],
)
def test_an_angle_that_is_lost_or_too_large_vents_both(
    tmp_path: Path, harm: Harm, words: str, limit_s: float
) -> None:
    result, run, bench, at_us = harmed(tmp_path, harm)
    assert result.outcome == "faulted"
    assert words in str(result.error)
    check_vented(bench, at_us, {"valve": limit_s, "valve_b": limit_s})
    assert events(run, "vented")[0]["confirmed"]


def test_a_host_that_hangs_is_left_by_both_controllers() -> None:
    with open_rig(joint_rig()) as rig:
        bench = rig.bench
        assert bench is not None
        assert bench.clock is not None
        for side in rig.sides:
            side.source.keep_alive(60.0)
            side.source.arm()
            side.source.set_pressure(200.0)
        rig.event_loop.for_seconds(1.0)
        assert bench.plant.pressures_kpa.min() > 150.0
        at_us = bench.board.bench_us
        bench.clock.sleep(HEARTBEAT_S + LEFT_S + EMPTY_S)  # nobody polls, so nobody beats
        check_vented(bench, at_us, dict.fromkeys(bench.boards, HEARTBEAT_S + LEFT_S))


def test_both_are_armed_or_none(tmp_path: Path) -> None:
    """The second one refuses: the first one is disarmed, and nothing was let in."""

    def begin(runner: Runner) -> None:
        assert runner.rig.bench is not None
        runner.rig.bench.boards["valve_b"].sensor_override = 4095

    result, run, bench = run_joint("joint-static", tmp_path, begin=begin, angles_deg=())
    assert result.outcome == "faulted"
    assert not events(run, "armed")
    assert not events(run, "point")
    assert not any(board.controller.safety.armed for board in bench.boards.values())
    assert bench.plant.pressures_kpa.max() < 5.0


def test_venting_by_hand_reaches_both(monkeypatch: pytest.MonkeyPatch) -> None:
    assert vent_rig(joint_rig()) < 5.0
    made = VirtualBench.__init__

    def without_a(self: VirtualBench, *words: Any, **named: Any) -> None:
        made(self, *words, **named)
        assert self.clock is not None
        self.boards["valve"].serial = "another"

    monkeypatch.setattr(VirtualBench, "__init__", without_a)
    with pytest.raises(PamrigError, match=r"valve\.serial: expected VB-000A, got another"):
        vent_rig(joint_rig())


# ---- files --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("[valve_b", "[valve_c", "valve_b: .joint. needs it as well"),
        ("[joint]", "[joints]", "joint: .valve_b. needs it as well"),
        ('angle = "encoder"', 'angle = "marks"', "marks. is no instrument of this rig"),
        ('angle = "encoder"', 'angle = "torque_gauge"', "reads torque_n_m .*: encoder"),
        ('torque = "torque_gauge"', 'torque = "gauge"', "is no instrument of this rig"),
        ("range_deg = [-45.0, 45.0]", "range_deg = [45.0, -45.0]", "expected .lowest, highest"),
        ("stale_s = 0.5", "stale_s = 0.01", "outside 0.1 to 60"),
        ("[manual.angle]", "[balance]\n[manual.angle]", "balance: does not belong"),
        ("[calibrations.pressure_b_kpa]", "[calibrations.pressure_c_kpa]", "pressure_b_kpa"),
        ('form = "torque-gauge"', 'form = "thermometer"', "torque_n_m: none"),
        ('arm = "forearm"', 'arm = "finger"', "needs exactly one link"),
        ("lock_n_m_rad = 200.0", "lock_n_m_rad = 200.0\nfriction = 1", "unknown key"),
        ('kind = "x"', "", ""),
    ],
)  # fmt: skip
def test_a_bad_rig_file_is_refused_in_one_line(
    tmp_path: Path, old: str, new: str, words: str
) -> None:
    if not words:
        old, new = "[valve_b]", '[pressure_source]\nkind = "hand-regulator"\n\n[valve_b]'
        words = "manual.pressure"
    text = load_rig("virtual-joint").text
    assert old in text
    path = tmp_path / "rig.toml"
    path.write_text(text.replace(old, new))
    with pytest.raises(ConfigError, match=words) as caught, open_rig(load_rig(str(path))):
        pass
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "old", "new", "words"),
    [
        ("joint-static", "common_kpa = [250]", "common_kpa = [40]", "makes 0 and 80 kPa|makes"),
        ("joint-static", "[-80, 80]", "[-600, 80]", "difference_kpa: -600 kPa at a common"),
        ("joint-static", "[-12, 0, 12]", "[-60, 0, 12]", r"angles_deg\[0\]"),
        ("joint-static", "free = true", "free = 1", "expected true or false"),
        ("joint-static", "angles_deg = [-12, 0, 12]", "alone_kpa = [100]", "needs a locked joint"),
        ("joint-step", "[-80, 80, 0]", "[-80, 80, 80]", "twice in a row is no step"),
        ("joint-step", "[-80, 80, 0]", "[-80]", "2 or more numbers"),
    ],
)
def test_a_bad_protocol_file_is_refused_in_one_line(
    tmp_path: Path, name: str, old: str, new: str, words: str
) -> None:
    from rigs.rigfile.toml_reader import find_config

    text = find_config(f"{name}-short", "protocols")[0]
    assert old in text
    path = tmp_path / "test.toml"
    changed = text.replace(old, new, 1)
    if name == "joint-static" and "common_kpa = [40]" in changed:
        changed = changed.replace("[-80, 80]", "[-90, 90]")
    path.write_text(changed)
    with pytest.raises(ConfigError, match=words) as caught:
        procedure(name).read(str(path), joint_rig())
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "rig", "words"),
    [
        ("isometric", "virtual-joint", "holds two muscles on a joint; isometric tests one"),
        ("joint-static", "virtual", r"has no \[joint\]"),
        ("joint-step", "virtual", r"has no \[joint\]"),
    ],
)
def test_a_test_on_the_wrong_kind_of_rig_is_refused(
    tmp_path: Path, name: str, rig: str, words: str
) -> None:
    from rigs.execution.session import run_protocol

    config = load_rig(rig)
    with pytest.raises(ConfigError, match=words):
        procedure(name).check(config)
    with pytest.raises(ConfigError):
        run_protocol(procedure(name), config, procedure(name).read(name, config), tmp_path)
    assert not list(tmp_path.iterdir())
