"""Reading plant files, and the thesis tables that come with the package."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from plant import thesis
from plant.constants import KEYS, load_constants, nominal, shipped
from plant.errors import PlantError

C = nominal()


def test_the_reference_bench_is_what_the_specification_says() -> None:
    assert C.supply_pa == 550e3
    assert C.braid_length_m == pytest.approx(0.0884)
    assert C.turns == 1.855
    assert C.inlet_conductance_m3_s_pa == 1.25e-9
    assert C.dead_volume_m3 == pytest.approx(0.5e-6)
    assert C.inlet_on_s == pytest.approx(8.70e-3)
    assert C.inlet_on_s_per_pa == pytest.approx(3.95e-9)
    assert C.stop_stiffness_n_m == pytest.approx(20e3)
    assert (C.delay_mode, C.outlet_normally) == ("inertial", "closed")


def test_tolerances_are_absolute_or_a_share_of_the_value() -> None:
    assert C.tolerance_si("supply_kpa") == pytest.approx(2e3)
    assert C.tolerance_si("braid_length_mm") == pytest.approx(0.003 * 0.0884)
    assert C.tolerance_si("stop_stiffness_n_mm") == 0.0
    modern = C.with_overrides({"inlet_conductance_m3_s_pa": 1.1e-10})
    assert modern.tolerance_si("inlet_conductance_m3_s_pa") == pytest.approx(5.5e-12)
    assert modern.with_overrides({"tolerance": {"turns": 0.5}}).tolerance_si("turns") == 0.5


def test_overrides_are_in_the_file_s_units_and_leave_the_original_alone() -> None:
    other = C.with_overrides({"supply_kpa": 700, "inlet_on_ms": 2.0, "outlet_normally": "open"})
    assert other.supply_pa == 700e3
    assert other.value("inlet_on_ms") == pytest.approx(2.0)
    assert C.supply_pa == 550e3
    assert [C.value(name) for name in KEYS] == pytest.approx(
        [load_constants(table()).value(name) for name in KEYS], rel=1e-12
    )


def table() -> dict[str, object]:
    read: dict[str, object] = {name: C.value(name) for name in C.keys}
    return read | {"delay_mode": "inertial", "outlet_normally": "closed"}


@pytest.mark.parametrize(
    ("key", "value", "told"),
    [
        ("suply_kpa", 1, "did you mean supply_kpa"),
        ("zzz", 1, "known keys"),
        ("supply_kpa", "550", "is a str; expected a number from 0 to 1200"),
        ("supply_kpa", True, "is a bool"),
        ("supply_kpa", -1, "out of range; allowed 0 to 1200"),
        ("supply_kpa", math.nan, "out of range"),
        ("critical_ratio", 1.0, "allowed 0 to 0.95"),
        ("delay_mode", "sluggish", "allowed 'inertial' or 'transport'"),
        ("outlet_normally", 1, "allowed 'closed' or 'open'"),
        ("length_min_mm", 80.0, "lengths must increase"),
        ("braid_length_mm", 60.0, "lengths must increase"),
        ("tolerance", {"turns": "much"}, "percentage from 0 to 100 % such as"),
        ("tolerance", {"turns": -1}, "expected a number"),
        ("tolerance", {"trns": 1}, "did you mean turns"),
        ("tolerance", 3, "expected a table"),
    ],
)
def test_bad_constants_name_file_key_value_and_what_is_allowed(
    key: str, value: object, told: str
) -> None:
    with pytest.raises(PlantError, match=told) as caught:
        C.with_overrides({key: value}, origin="bench.toml")
    assert "bench.toml" in str(caught.value)


def test_bad_plant_files_are_told_apart(tmp_path: Path) -> None:
    with pytest.raises(PlantError, match="cannot be read"):
        load_constants(tmp_path / "none.toml")
    broken = tmp_path / "broken.toml"
    broken.write_text("supply_kpa = = 5")
    with pytest.raises(PlantError, match="not valid TOML"):
        load_constants(broken)
    short = tmp_path / "short.toml"
    short.write_text("supply_kpa = 550")
    with pytest.raises(PlantError, match="missing atmosphere_kpa"):
        load_constants(short)
    with pytest.raises(PlantError, match=r"not shipped; choose one of .*thesis"):
        shipped("theses")


ROWS = {
    "c01": 1568,
    "c02": 1568,
    "c03": 161,
    "c04": 168,
    "c05": 88,
    "c05_isometric_hysteresis_difference_mean": 8,
    "c06": 176,
    "c07": 88,
    "c07_isotonic_hysteresis_difference_mean": 8,
    "c09": 98,
    "c26": 98,
    "c35": 7,
    "c37": 11,
    "c38": 1,
    "c39": 30,
    "d01": 39,
    "d03": 1,
    "d04": 13,
    "d05": 13,
    "t4_1": 7,
    "t4_2": 7,
    "t4_3": 30,
    "t4_4": 8,
    "t4_5": 8,
    "full_regressions": 20,
    "full_regressions_anova": 27,
    "best_fit_ranks": 734,
    "best_subsets": 61,
    "equations_as_printed": 66,
    "text_constants": 39,
}


@pytest.mark.parametrize(("name", "rows"), ROWS.items())
def test_every_thesis_table_has_its_rows(name: str, rows: int) -> None:
    assert len(thesis.load(name)) == rows
    assert all(len(column) == rows for column in thesis.array(name).values())


def test_no_thesis_table_is_left_out() -> None:
    assert len(thesis.tables()) == len(ROWS)


def test_numbers_are_numbers_and_words_stay_words() -> None:
    assert thesis.load("c01")[0] == {
        "pressure_kpa": 0, "length_mm": 51, "temperature_c": 21, "force_n": -0.046
    }  # fmt: skip
    columns = thesis.array("c04")
    assert columns["force_n"].dtype == np.float64
    assert set(columns["direction"]) == {"up", "down"}
    assert np.isnan(thesis.array("full_regressions")["s"]).any()


def test_the_reference_braid_is_the_least_squares_fit_of_table_c_1() -> None:
    # b and n come from Table C-1 at 21 degC: no nearby braid may fit it better.
    columns = thesis.array("c01")
    cold = columns["temperature_c"] == 21
    p, force = columns["pressure_kpa"][cold] * 1e3, columns["force_n"][cold]
    length = np.where(columns["length_mm"] == 51, 51.45, columns["length_mm"])[cold] * 1e-3

    def rms(b: float, n: float) -> float:
        model = p * (3 * length**2 - b * b) / (4 * np.pi * n * n)
        return float(np.sqrt(np.mean((model - force) ** 2)))

    here = rms(C.braid_length_m, C.turns)
    for b, n in [(0.995, 1), (1.005, 1), (1, 0.99), (1, 1.01)]:
        assert rms(C.braid_length_m * b, C.turns * n) > here


def test_changing_a_row_does_not_change_the_table() -> None:
    thesis.load("c01")[0]["force_n"] = 99.0
    assert thesis.load("c01")[0]["force_n"] == -0.046


@pytest.mark.parametrize("name", ["c99", "", "c0", "nope"])
def test_an_unknown_table_is_refused_with_the_known_ones(name: str) -> None:
    with pytest.raises(PlantError, match="c01_isometric"):
        thesis.load(name)


def test_the_doubts_about_the_tables_ship_with_them() -> None:
    assert "51.45" in thesis.anomalies()
