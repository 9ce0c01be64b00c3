"""Inputs and flows of an empirical term follow the physics that they are named after.

Expected values come from the braid's equations and the gas law, written here by themselves.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest

from gap.data.reader import read_dataset
from gap.model.empirical import inputs_of, point_inputs_of, risen, valve_flows
from gap.model.features import BLOCKS
from gap.model.grid import Grid, make_grid
from gap_bench import write_set
from plant.constants import nominal
from plant.effects.empirical import EDGE_S, INLET_EDGE, OUTLET_EDGE

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


def test_a_valve_s_edge_flow_lasts_for_a_moment_after_its_own_commands(tmp_path: Path) -> None:
    grid = valve_grid(tmp_path / "data")
    flows = valve_flows(grid, nominal())
    since = point_inputs_of(grid, "pressure", ("since_edge_s",))["since_edge_s"]
    for scale, sign in ((INLET_EDGE, 1.0), (OUTLET_EDGE, -1.0)):
        assert np.all(flows[scale][since >= EDGE_S] == 0.0)
        assert np.abs(flows[scale]).max() > 0.0
        assert np.all(sign * flows[scale] >= 0.0)
    assert not np.any((flows[INLET_EDGE] != 0.0) & (flows[OUTLET_EDGE] != 0.0))


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
