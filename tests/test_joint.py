"""The tests of a joint, end to end on the virtual joint, against its own statics and motion."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from analysis.registry import analysis_of
from analysis.reporting.derived import derive_all
from analysis.run_table import reduce_run
from cli.protocols.resume import continue_run
from daq.errors import RecordError
from daq.interrupt import StopFlag
from daq.store.derive import engineering
from daq.store.run import Run, open_run
from daq.store.verify import verify
from gap.data.from_runs import export_runs
from gap.data.reader import read_dataset
from gap.decision.diagnose import diagnose
from gap.errors import GapError
from joint_bench import Statics, joint_plan, joint_rig, run_joint
from plant.scene import layout as sc
from protocol_runs import events
from rigs.execution.runner import Runner, Watch
from rigs.rigfile.config import load_rig
from rigs.rigfile.form import load_form
from rigs.steps.joint import pressures_of

QUICK = {"difference_kpa": (-80.0, 80.0), "angles_deg": (-12.0, 0.0, 12.0)}
COVERAGE = 3.0
"""Of a handful of draws every one lies within three standard uncertainties; 30 draws are judged by
how many lie within two."""


def static_run(root: Path, config: Any = None, **changes: Any) -> Run:
    result, run, _ = run_joint("joint-static", root, config, **{**QUICK, **changes})
    assert result.outcome == "clean", result.error
    return run


@pytest.fixture(scope="module")
def static(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A static test with every kind of point."""
    return static_run(tmp_path_factory.mktemp("joint"), alone_kpa=(150.0, 250.0))


def deviations(run: Run, config: Any) -> dict[str, list[float]]:
    """Results less those of the simulated joint, in standard uncertainties."""
    found = analysis_of("joint-static").findings(run, reduce_run(run)).data
    truth = Statics(config)
    out: dict[str, list[float]] = {"torque": [], "stiffness": [], "equilibrium": [], "free": []}
    for cell in found["locked"]:
        a, b = pressures_of(cell["common_kpa"], cell["difference_kpa"])
        at = cell["angle_deg"]
        torque = cell["torque_n_m"] - truth.torque_n_m(a, b, at)
        stiffness = cell["stiffness_n_m_rad"] - truth.stiffness_n_m_rad(a, b, at)
        out["torque"].append(torque / cell["u_torque_n_m"])
        out["stiffness"].append(stiffness / cell["u_stiffness_n_m_rad"])
        if math.isfinite(cell["equilibrium_deg"]):
            rest = cell["equilibrium_deg"] - truth.angle_deg(a, b)
            out["equilibrium"].append(rest / cell["u_equilibrium_deg"])
    for cell in found["free"]:
        angle = cell["angle_deg"] - truth.angle_deg(
            *pressures_of(cell["common_kpa"], cell["difference_kpa"])
        )
        out["free"].append(angle / cell["u_angle_deg"])
    return out


def test_torque_stiffness_and_angle_are_those_of_the_plant(static: Run) -> None:
    found = deviations(static, joint_rig())
    assert [len(found[name]) for name in ("torque", "stiffness", "free")] == [2, 2, 2]
    assert max(abs(z) for values in found.values() for z in values) < COVERAGE


@pytest.mark.parametrize("seed", [2, 3, 4])
def test_a_few_more_draws_at_two_angles(tmp_path: Path, seed: int) -> None:
    config = joint_rig(seed)
    changes = {"difference_kpa": (60.0,), "angles_deg": (-8.0, 8.0), "free": seed == 2}
    found = deviations(static_run(tmp_path, config, **changes), config)
    assert [len(found[name]) for name in ("torque", "stiffness")] == [1, 1]
    assert max(abs(z) for values in found.values() for z in values) < COVERAGE


def test_the_stated_uncertainty_is_no_excuse(static: Run) -> None:
    """Small beside the value: a result far off would be noticed."""
    cells = analysis_of("joint-static").findings(static, reduce_run(static)).data["locked"]
    for cell in cells:
        assert cell["u_stiffness_n_m_rad"] < 0.01 * cell["stiffness_n_m_rad"]
        assert cell["u_torque_n_m"] < 0.002


@pytest.mark.campaign
@pytest.mark.parametrize("friction_n_m", [0.0, 0.002])
def test_thirty_draws_lie_where_they_are_stated_to(tmp_path: Path, friction_n_m: float) -> None:
    changes: dict[str, Any] = {}
    if friction_n_m:  # which shows only where the pressures rise and fall
        method = dataclasses.replace(
            joint_plan("joint-static", joint_rig()).method, order="up-down"
        )
        changes = {"difference_kpa": (-80.0, 0.0, 80.0), "method": method}
    found: dict[str, list[float]] = {}
    for seed in range(1, 31):
        config = joint_rig(seed, friction_n_m=friction_n_m)
        run = static_run(tmp_path / str(seed), config, **changes)
        for name, values in deviations(run, config).items():
            found.setdefault(name, []).extend(values)
    for name, values in found.items():
        z = np.abs(values)
        print(
            f"{name}: {len(z)}, within 2 u {np.mean(z <= 2):.3f}, rms {np.sqrt(np.mean(z**2)):.2f}"
        )
        assert np.mean(z <= 2.0) > 0.85, name
        assert np.sqrt(np.mean(z**2)) < 1.4, name


def test_the_record_of_two_controllers(static: Run) -> None:
    """Both streams with a clock each, and nothing of a bench with one muscle."""
    assert static.outcome == "clean"
    assert verify(static) == []
    assert static.streams == ["encoder", "torque_gauge", "valve", "valve_b"]
    assert static.manifest["joint"]["angle"] == "encoder"
    assert set(static.manifest["devices"]) == {"valve", "valve_b", "encoder", "torque_gauge"}
    assert static.final is not None
    assert all(static.final["clock_fit"][name]["pings"] > 20 for name in ("valve", "valve_b"))
    assert len(events(static, "armed")) == 2
    assert [e["confirmed"] for e in events(static, "vented")] == [True]
    a, b = (engineering(static, name)[0] for name in ("valve", "valve_b"))
    assert np.allclose(a["time_s"][-1], b["time_s"][-1], atol=0.06)
    alone = [p for p in events(static, "point") if p["state"] == "b"]
    assert {(p["set_a_kpa"], p["set_b_kpa"]) for p in alone} == {(0.0, 150.0), (0.0, 250.0)}
    for point in alone:
        in_a, in_b = (
            (side["seq"] >= point[key][0]) & (side["seq"] < point[key][1])
            for side, key in ((a, "valve_seq"), (b, "valve_b_seq"))
        )
        assert b["pressure_b_kpa"][in_b].mean() == pytest.approx(point["set_b_kpa"], abs=2.5)
        assert a["pressure_kpa"][in_a].mean() < 6.0


def test_report_table_and_view_are_made_again_to_the_same_content(static: Run) -> None:
    first = derive_all(static.folder)
    table, report = first.derived("table.csv").read_bytes(), first.derived("report.html")
    text = report.read_text()
    assert "Torque and stiffness at each pair of pressures" in text
    assert text.count("<svg") + text.count("image/svg") >= 3
    assert first.derived("view.rrd").stat().st_size > 10_000
    again = derive_all(static.folder)
    assert again.derived("table.csv").read_bytes() == table
    assert again.derived("report.html").read_text() == text


def test_a_stopped_test_is_continued_without_a_doubled_trial(tmp_path: Path) -> None:
    stop, seen = StopFlag(), [0]

    def result(*_: object) -> None:
        seen[0] += 1
        if seen[0] == 3:
            stop.set("SIGINT")

    config = joint_rig()
    changes = {"how": {"stop": stop, "watch": Watch(result=result)}}
    ended, run, _ = run_joint("joint-static", tmp_path, config, **changes)
    assert ended.outcome == "stopped"
    more = continue_run(run)
    assert more.outcome == "clean"
    table = reduce_run(open_run(more.folder)).table
    assert sorted(table["order"]) == list(range(1, 9))
    assert table["trial"].nunique() == 4


# ---- the diagnosis -------------------------------------------------------------------------


@pytest.mark.parametrize("muscle", ["a", "b"])
def test_a_muscle_alone_is_a_data_set_of_isometric_trials(
    static: Run, tmp_path: Path, muscle: str
) -> None:
    export_runs([static], tmp_path / "set", muscle=muscle)
    data = read_dataset(tmp_path / "set")
    assert len(data.trials) == 3
    plant = Statics(joint_rig())
    for trial in data.trials:
        forces, pressures = (trial[name].value for name in ("force_n", "pressure_kpa"))
        assert len(forces) == 2
        for force, pressure in zip(forces, pressures, strict=True):
            # 0.5 mN m of the gauge's zero, 0.3 kPa and 0.05 degrees of the others, each twice
            expected = plant.pull_n(pressure, trial.held_length_mm)
            assert force == pytest.approx(expected, abs=0.2)
    lengths = sorted(trial.held_length_mm for trial in data.trials)
    turned = 8.0 * math.radians(12.0)  # and what a person's hand and the lock add
    assert lengths == pytest.approx([62.0 - turned, 62.0, 62.0 + turned], abs=0.05)


def test_what_a_data_set_of_a_joint_needs_is_said_in_a_line(static: Run, tmp_path: Path) -> None:
    with pytest.raises(GapError, match="--muscle: 'c' is not one of a, b"):
        export_runs([static], tmp_path / "set", muscle="c")
    known = dict(static.manifest)
    run = open_run(static.folder)
    run.manifest = {**known, "joint": {**known["joint"], "radius_mm": 0.0}}
    with pytest.raises(RecordError, match=r"does not state joint\.radius_mm"):
        export_runs([run], tmp_path / "set")
    run = open_run(static.folder)
    run.events = [e for e in static.events if e.get("state") != "a"]
    with pytest.raises(RecordError, match=r"without points of muscle a alone.*alone_kpa"):
        export_runs([run], tmp_path / "set")


@pytest.mark.campaign
@pytest.mark.parametrize("stretch_percent", [0.0, 4.0])
def test_the_diagnosis_of_a_muscle_in_a_joint(tmp_path: Path, stretch_percent: float) -> None:
    """The same catalogue, on points of muscle a alone: a hidden effect is named, none is not."""
    config = joint_rig(5)
    assert config.virtual is not None
    effects = {"fibre_stretch": {"stretch_percent": stretch_percent}} if stretch_percent else {}
    config = dataclasses.replace(
        config, virtual=dataclasses.replace(config.virtual, effects=effects)
    )
    method = joint_plan("joint-static", config).method
    run = static_run(
        tmp_path / "runs", config, free=False, difference_kpa=(0.0,), measure_s=1.0,
        angles_deg=(-30.0, -15.0, 0.0, 15.0, 30.0), alone_kpa=(100.0, 200.0, 300.0, 400.0, 480.0),
        method=dataclasses.replace(method, order="up-down", repeats=2),
    )  # fmt: skip
    export_runs([run], tmp_path / "set", muscle="a")
    verdict = diagnose(read_dataset(tmp_path / "set"))
    found = {name: e.parameters for e in verdict.effects for name in e.ids}
    assert set(found) == set(effects)
    if stretch_percent:
        estimate = found["fibre_stretch"]["stretch_percent"]
        assert estimate.low <= stretch_percent <= estimate.high
    else:
        assert verdict.status == "no_gap_above_floor"


# ---- steps ------------------------------------------------------------------------------


def test_the_answer_to_a_step_is_that_of_the_plant(tmp_path: Path) -> None:
    """Rise, overshoot and settling against the angle of the simulation at each millisecond."""
    truth: list[tuple[int, float, float]] = []

    def begin(runner: Runner) -> None:
        bench = runner.rig.bench
        assert bench is not None
        plant: Any = bench.plant
        board = bench.boards["valve"]
        advance = plant.scene.advance

        def follow(*words: Any) -> None:
            advance(*words)
            angle = math.degrees(float(plant.scene.world.motion[sc.PLACE, 0]))
            truth.append((board.bench_us, angle, board.controller.setpoint_x16 / 16.0))

        plant.scene.advance = follow

    result, run, _ = run_joint("joint-step", tmp_path, begin=begin)
    assert result.outcome == "clean", result.error
    table = reduce_run(run).table
    assert len(table) == 2
    assert table["settled"].all()
    assert (table["skew_s"] < 0.003).all()
    us, angle, setpoint = (np.array(column) for column in zip(*truth, strict=True))
    changes = us[np.flatnonzero(np.diff(setpoint)) + 1]
    for row, at_us in zip(table.to_dict("records"), changes[-3:-1], strict=True):
        t = (us - at_us) * 1e-6
        use = (t >= 0.0) & (t < 1.5)
        t, q = t[use], angle[use]
        final, start = q[-400:].mean(), q[0]
        share = (q - start) / (final - start)
        rise = t[np.argmax(share >= 0.9)] - t[np.argmax(share >= 0.1)]
        settle = t[np.flatnonzero(np.abs(share - 1.0) > 0.05)[-1]]
        over = abs(final - start) * (share.max() - 1.0)
        assert row["final_deg"] == pytest.approx(final, abs=3 * row["u_final_deg"])
        assert row["rise_s"] == pytest.approx(rise, abs=3 * row["u_rise_s"])
        assert row["settle_s"] == pytest.approx(settle, abs=3 * row["u_settle_s"])
        assert row["overshoot_deg"] == pytest.approx(over, abs=3 * row["u_overshoot_deg"])
        assert over > 1.0


# ---- instruments ------------------------------------------------------------------------


@given(st.floats(-359.0, 359.0), st.integers(0, 17), st.integers(1, 255))
def test_no_damaged_line_of_the_encoder_becomes_an_angle(
    angle: float, place: int, change: int
) -> None:
    form = load_form("angle-encoder")
    line = form.seal(form.template.format(value=angle, unit="deg")).decode().rstrip("\r\n")
    assert form.parse(line).value == pytest.approx(angle, abs=6e-5)
    damaged = bytearray(line.encode())
    place %= len(damaged)
    damaged[place] ^= change
    found = form.parse(damaged.decode("latin-1"))
    same = damaged.decode("latin-1").upper() == line.upper()  # the case of a checksum's digits
    assert found.fault or same


def test_the_torque_gauge_answers_as_its_guide_shows() -> None:
    form = load_form("torque-gauge")
    assert (form.query, form.end) == ("?", b"\r\n")
    assert form.parse("-0.1878 Nm").value == -0.1878
    assert form.parse("0.4285 lbFin").fault == "unit"
    assert form.parse("*10").fault == "damaged"


def test_a_load_cell_on_a_lever_gives_the_same_torque(tmp_path: Path) -> None:
    text = joint_rig().text
    gauge = text[text.index("[instruments.torque_gauge]") : text.index("[manual.angle]")]
    cell = (
        '[load_cell]\nport = "virtual"\nbaud = 9600\nform = "load-cell-stream"\n'
        "u_offset = 0.02\nu_gain = 0.003\n\n"
    )
    path = tmp_path / "rig.toml"
    path.write_text(
        text.replace(gauge, cell).replace(
            'torque = "torque_gauge"', 'torque = "load_cell"\nlever_mm = 40.0\nu_lever_mm = 0.05'
        )
    )
    config = load_rig(str(path))
    changes = {"difference_kpa": (100.0,), "angles_deg": (-10.0, 10.0), "free": False}
    settle = {"drift_n_m": 0.02}
    plan = joint_plan("joint-static", config)
    loose = dataclasses.replace(plan.settle, **settle)
    run = static_run(tmp_path / "runs", config, settle=loose, measure_s=1.0, **changes)
    truth = Statics(config)
    table = reduce_run(run).table
    for row in table.to_dict("records"):
        expected = truth.torque_n_m(row["set_a_kpa"], row["set_b_kpa"], row["angle_deg"])
        assert row["torque_n_m"] == pytest.approx(expected, abs=3 * row["u_torque_n_m"] + 0.002)
        assert row["u_torque_n_m"] < 0.02


def test_a_free_joint_is_not_swung_when_its_muscles_vent_from_different_pressures(
    tmp_path: Path,
) -> None:
    """From 275 and 425 kPa it swung from -15 to -46 degrees and ended the shipped test."""
    changes = {"common_kpa": (350.0,), "difference_kpa": (150.0, -150.0), "angles_deg": (0.0,)}
    result, run, _ = run_joint("joint-static", tmp_path, **changes)
    assert result.outcome == "clean", result.error
    points = [e for e in events(run, "point") if e["state"] == "free"]
    angle = engineering(run, "encoder")[0]["angle_deg"]
    first, last = points[0]["encoder_rows"][0], points[-1]["encoder_rows"][1]
    swing = np.abs(angle[last:]).max()
    assert swing < np.abs(angle[first:last]).max() + 2.0
