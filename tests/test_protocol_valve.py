"""The tests of the valve alone, on the virtual stand: the plant's truths come back."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from analysis.reduction.switching import Block, air_delay_ms, switching_times
from analysis.reporting.report import report_json
from daq.errors import ConfigError
from daq.store.run import Run, open_run
from plant.constants import nominal
from plant.physics.valve import drop_out_v, off_delay_s, on_delay_s, pull_in_v
from rigs.execution.control import RunControl
from rigs.execution.session import run_protocol
from rigs.protocols.registry import procedure
from rigs.rigfile.config import load_rig

STAND = "virtual-valve-stand"


def measured(root: Path, name: str, seed: int = 1, **changes: Any) -> Run:
    """A run of the shipped short template with some of its parameters changed."""
    config = load_rig(STAND, seed)
    kind = procedure(name)
    plan = dataclasses.replace(kind.read(f"{name}-short", config), **changes)  # type: ignore[type-var]
    result = run_protocol(kind, config, plan, root)
    assert result.error is None
    assert result.points == result.planned
    return open_run(result.folder)


def test_switching_times_of_both_valves_come_back(tmp_path: Path) -> None:
    """Within 0.1 ms and within the stated uncertainty (Tables D-1 to D-3)."""
    c = nominal()
    run = measured(
        tmp_path, "switching-time", valves=("inlet", "outlet"), pressures_kpa=(100.0, 350.0, 600.0)
    )
    table = procedure("switching-time").analysis.reduce(run).table
    assert len(table) == 6
    assert table["settled"].all()
    for row in table.itertuples():
        on = on_delay_s(row.valve, row.pressure_kpa * 1e3, c) * 1e3
        off = off_delay_s(row.valve, row.off_pressure_kpa * 1e3, c) * 1e3
        for got, truth, u in ((row.on_ms, on, row.u_on_ms), (row.off_ms, off, row.u_off_ms)):
            assert got == pytest.approx(truth, abs=0.1)
            assert abs(got - truth) < 2 * u
    assert not [e for e in run.events if e["kind"] == "fault"]


def block_of(on_ms: float, off_ms: float, rng: np.random.Generator, fall: float = 0.0) -> Block:
    """A sharp pulse of flow as a sensor 62 mm down the line shows it, one sample every 50 us."""
    delay = air_delay_ms()
    t_ms = np.arange(800) * 0.05
    begin, end = 2.0 + delay + on_ms, 2.0 + delay + 20.0 + off_ms
    flow = np.where((t_ms >= begin) & (t_ms < end), 1.0 - fall * (t_ms - begin) / 20.0, 0.0)
    counts = np.rint(200.0 + 3000.0 * flow + rng.normal(0.0, 8.0, len(t_ms)))
    return Block("outlet", 20_000, 2_000, 50, counts)


@pytest.mark.parametrize("fall", [0.0, 0.7])
def test_neither_edge_of_a_sharp_pulse_is_early_or_late(fall: float) -> None:
    """Also where the flow falls to less than half during the pulse. It was 12 us at each edge."""
    rng = np.random.default_rng(3)
    off = []
    for _ in range(400):
        on_ms, off_ms = rng.uniform(8.0, 10.0, 2)
        found = switching_times(block_of(on_ms, off_ms, rng, fall))
        off.append((found.on_ms - on_ms, found.off_ms - off_ms))
    bias, worst = np.mean(off, axis=0), np.abs(off).max()
    assert np.abs(bias).max() < 0.003
    assert worst < 0.03


def test_off_times_of_the_stand_have_no_bias(tmp_path: Path) -> None:
    """It was +0.038 ms: 0.013 from the level of the edge, 0.025 from the simulated sensor."""
    c = nominal()
    pressures = tuple(np.arange(60.0, 600.0, 45.0))
    many = {"pressures_kpa": pressures, "valves": ("inlet", "outlet"), "repeats": 1}
    table = procedure("switching-time").analysis.reduce(
        measured(tmp_path, "switching-time", **many)
    ).table  # fmt: skip
    off = [
        (row.on_ms - on_delay_s(row.valve, row.pressure_kpa * 1e3, c) * 1e3,
         row.off_ms - off_delay_s(row.valve, row.off_pressure_kpa * 1e3, c) * 1e3)
        for row in table.itertuples()
    ]  # fmt: skip
    print(f"\n{len(off)} draws: on {np.mean(off, axis=0)[0]:+.4f} ms, off"
          f" {np.mean(off, axis=0)[1]:+.4f} ms")  # fmt: skip
    assert len(off) == 24
    assert np.abs(np.mean(off, axis=0)).max() < 0.010


def test_switching_voltages_of_both_valves_come_back(tmp_path: Path) -> None:
    """Within 0.1 V and within the stated uncertainty (Table D-4)."""
    c = nominal()
    run = measured(
        tmp_path, "switching-voltage", valves=("inlet", "outlet"),
        pressures_kpa=(100.0, 500.0), step_v=0.06, tolerance_kpa=8.0,
    )  # fmt: skip
    table = procedure("switching-voltage").analysis.reduce(run).table
    assert len(table) == 4
    for row in table.itertuples():
        on = pull_in_v(row.valve, row.pressure_kpa * 1e3, c)
        assert row.on_v == pytest.approx(on, abs=0.1)
        assert row.off_v == pytest.approx(drop_out_v(row.valve, c), abs=0.1)
        assert abs(row.on_v - on) < 2 * row.u_on_v
        assert abs(row.off_v - drop_out_v(row.valve, c)) < 2 * row.u_off_v


def test_conductance_and_critical_ratio_come_back_from_the_flow_test(tmp_path: Path) -> None:
    """C to 2 %, critical ratio to 0.02, both within the stated uncertainty."""
    pressures = (8.0, 15.0, 25.0, 40.0, 60.0, 80.0, 100.0, 200.0, 350.0, 500.0, 600.0)
    run = measured(tmp_path, "flow", pressures_kpa=pressures, open_ms=500, tolerance_kpa=4.0)
    results = report_json(run)["results"]
    c, u_c = results["conductance_m3_s_pa"], results["u_conductance_m3_s_pa"]
    r, u_r = results["critical_ratio"], results["u_critical_ratio"]
    assert c == pytest.approx(1.25e-9, rel=0.02)
    assert r == pytest.approx(0.5, abs=0.02)
    assert abs(c - 1.25e-9) < 2 * u_c
    assert abs(r - 0.5) < 2 * u_r


@pytest.mark.campaign
@pytest.mark.parametrize("seed", range(20))
def test_flow_holds_over_many_benches(tmp_path: Path, seed: int) -> None:
    config = load_rig(STAND, seed)
    kind = procedure("flow")
    result = run_protocol(kind, config, kind.read("flow", config), tmp_path)
    results = report_json(open_run(result.folder))["results"]
    assert results["conductance_m3_s_pa"] == pytest.approx(1.25e-9, rel=0.02)
    assert results["critical_ratio"] == pytest.approx(0.5, abs=0.02)


def test_a_pulse_too_short_to_open_is_a_point_that_says_so(tmp_path: Path) -> None:
    run = measured(tmp_path, "switching-time", width_us=5000, pressures_kpa=(80.0,))
    reduction = procedure("switching-time").analysis.reduce(run)
    (row,) = reduction.table.itertuples()
    assert not row.settled
    assert np.isnan(row.on_ms)
    assert any("no flow" in note for note in reduction.notes)


def test_a_repeated_point_counts_once_by_its_last_take(tmp_path: Path) -> None:
    config = load_rig(STAND, 1)
    kind = procedure("switching-time")
    control = RunControl()

    def again(runner: Any, record: Any) -> None:
        point = runner.progress

        class Once:
            asked = False

        inner = runner.record.event

        def event(what: str, **fields: Any) -> int:
            n = inner(what, **fields)
            if what == "point" and not Once.asked:
                Once.asked = True
                control.request("repeat")
            return int(n)

        assert point is not None
        runner.record.event = event

    plan = kind.read("switching-time-short", config)
    result = run_protocol(kind, config, plan, tmp_path, control=control, on_start=again)
    run = open_run(result.folder)
    assert sum(e["kind"] == "point" for e in run.events) == 3
    assert len(kind.analysis.reduce(run).table) == 2


@pytest.mark.parametrize(
    ("name", "rig", "said"),
    [
        ("flow", "virtual", "virtual.toml has no [flow]"),
        ("switching-voltage", "virtual", "virtual.toml has no [supply]"),
        ("switching-time", "virtual", "virtual.toml has no [manual.supply]"),
    ],
)
def test_a_rig_that_lacks_an_instrument_is_refused_with_its_table(
    name: str, rig: str, said: str
) -> None:
    with pytest.raises(ConfigError) as error:
        procedure(name).read(name, load_rig(rig))
    assert said in str(error.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('protocol = "flow"\npressures_kpa = [900]\n', "pressures_kpa[0]: 900 kPa is outside"),
        ('protocol = "flow"\npressures_kpa = [90]\nopen_ms = 900\n', "open_ms: 900 is outside"),
        ('protocol = "flow"\npressures_kpa = [90]\nrepeat = 2\n', "did you mean 'repeats'"),
        ('protocol = "isometric"\n', "is 'isometric', and this command runs 'flow'"),
    ],
)
def test_a_bad_protocol_file_is_refused_with_its_key(tmp_path: Path, text: str, said: str) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(text)
    with pytest.raises(ConfigError) as error:
        procedure("flow").read(str(file), load_rig(STAND))
    assert said in str(error.value)
    assert "mine.toml" in str(error.value)
