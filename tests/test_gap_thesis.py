"""The thesis's tables: what is found on them, where it stops, and what is not claimed."""

from __future__ import annotations

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from cli.main import app
from gap.errors import GapError
from gap.thesis.data import thesis_set
from gap.thesis.static_ladder import Ladder, Table
from gap.thesis.tables import TableVerdict, diagnose_thesis, points_of, smoothness
from plant.constants import nominal
from plant.thesis import array


@pytest.fixture(scope="module")
def verdicts() -> dict[str, TableVerdict]:
    return {verdict.name: verdict for verdict in diagnose_thesis()}


def test_the_tables_are_whole() -> None:
    sizes = {name: len(points_of(thesis_set(name)).force_n) for name in ("c01", "c04", "c06")}
    assert sizes == {"c01": 16 * 14, "c04": 168, "c06": 176}
    c03 = array("c03")
    known = int(np.isfinite(c03["length_mm"]).sum())
    assert len(points_of(thesis_set("c03")).force_n) == known
    with pytest.raises(GapError, match="c02"):
        thesis_set("c02")
    with pytest.raises(GapError, match="no columns above"):
        thesis_set("c04", warm=True)


def test_the_floor_of_c1_is_that_of_a_table_smooth_in_length() -> None:
    # Recomputed from the printed numbers alone: 1.64 N.
    table = array("c01")
    cold = table["temperature_c"] == 21.0
    lengths = np.unique(table["length_mm"][cold])
    order = np.lexsort((table["length_mm"][cold], table["pressure_kpa"][cold]))
    force = table["force_n"][cold][order].reshape(16, 14)
    lengths[0] = 51.45
    errors = []
    for k in range(1, 13):
        share = (lengths[k] - lengths[k - 1]) / (lengths[k + 1] - lengths[k - 1])
        errors.append(force[:, k] - (1 - share) * force[:, k - 1] - share * force[:, k + 1])
    expected = float(np.sqrt(np.mean(np.array(errors) ** 2)))
    assert smoothness(points_of(thesis_set("c01"))) == pytest.approx(expected, rel=1e-12)
    assert expected == pytest.approx(1.64, abs=0.005)


def test_the_ladder_of_c1_rises_by_two_effects_and_ends_above_the_floor(
    verdicts: dict[str, TableVerdict],
) -> None:
    found = verdicts["C-1 at 21 °C"]
    kept = [step for step in found.steps if step.kept]
    assert [list(step.added) for step in kept] == [[], ["liner_threshold"], ["bladder_elasticity"]]
    assert not found.steps[-1].kept
    errors = [step.rms for step in kept]
    assert errors == sorted(errors, reverse=True)
    assert found.floor_n is not None
    assert errors[-1] > found.floor_n
    assert found.published is not None
    assert found.published[0] == pytest.approx(6.156, abs=0.02)  # Table 4-3, deterministic, 21 °C


def test_nothing_is_claimed_of_the_warm_columns_or_of_few_settings(
    verdicts: dict[str, TableVerdict],
) -> None:
    assert "formula" in verdicts["C-1 at 21 to 39 °C"].reason
    for name in ("C-1 at 21 to 39 °C", "C-3", "C-4", "C-6"):
        assert verdicts[name].status == "below_resolution"
    cycles = verdicts["C-4"].up_down
    assert cycles is not None
    assert cycles[0] > 0
    assert "opposite of friction" in verdicts["C-4"].reason


def test_the_ladder_finds_what_was_put_in_and_stops() -> None:
    rng = np.random.default_rng(3)
    length = np.repeat(np.linspace(53, 69, 10), 9)
    pressure = np.tile(np.linspace(0, 560, 9), 10)
    table = Table(
        pressure, length, np.zeros(90), np.full(90, 21.0),
        np.full(90, -1), np.repeat(np.arange(10), 9),
    )  # fmt: skip
    from plant.effects.effects import Effects
    from plant.simulator.force_law import ForceLaw

    on = Effects.from_config({"liner_threshold": {"threshold_kpa": 80.0}})
    force = ForceLaw(nominal(), on).lasting(pressure * 1e3, length * 1e-3)
    table = Table(*(
        force + rng.normal(0, 0.1, 90) if name == "force_n" else getattr(table, name)
        for name in Table.__annotations__
    ))  # fmt: skip
    candidates = ("liner_threshold", "bladder_elasticity", "force_zero")
    steps = Ladder(table, nominal(), True, candidates, 0.1).climb()
    assert list(steps[1].added) == ["liner_threshold"]
    assert steps[1].values["liner_threshold"]["threshold_kpa"] == pytest.approx(80.0, abs=3.0)
    assert [step.kept for step in steps] == [True, True, False]


def test_the_ladder_keeps_nothing_where_there_is_nothing() -> None:
    rng = np.random.default_rng(4)
    length = np.repeat(np.linspace(53, 69, 10), 9)
    pressure = np.tile(np.linspace(0, 560, 9), 10)
    from plant.simulator.force_law import ForceLaw

    force = ForceLaw(nominal()).lasting(pressure * 1e3, length * 1e-3) + rng.normal(0, 0.3, 90)
    table = Table(
        pressure, length, force, np.full(90, 21.0), np.full(90, -1), np.repeat(np.arange(10), 9)
    )
    candidates = ("liner_threshold", "bladder_elasticity", "force_zero")
    steps = Ladder(table, nominal(), True, candidates, 0.0).climb()
    assert [step.kept for step in steps] == [True, False]


@pytest.mark.campaign
def test_the_command_prints_one_json_value() -> None:
    done = CliRunner().invoke(app, ["gap", "thesis", "--json"])
    assert done.exit_code == 0
    assert len(json.loads(done.output)) == 5
