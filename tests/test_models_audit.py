"""The thesis's figures, recomputed: which reproduce, which do not, and Table 4-3."""

from __future__ import annotations

import numpy as np
import pytest

from plant.audit import audit as audit_module
from plant.audit.printed import same, truncated, unit_in_last_place
from plant.audit.ranks import r_squared
from plant.audit.rest import full_regression_c8, full_regression_c9, full_regression_d1
from plant.fitting.table43 import STATISTICS, describe, recover_braid, table
from plant.fitting.tables import best_subsets, full_regression, subsets_text
from plant.fitting.thesis_points import thesis_points
from plant.thesis import anomalies, array

REPRODUCES = {
    "Table C-9 (21 °C)", "Equation 4-34", "Equation 4-40", "Equation 4-45", "Table 4-1",
    "Equation 4-47", "Equations 4-48, 4-50", "Equation 4-51", "Table 4-2 = Table C-35",
    "Full-regression C-8", "Full-regression C-9", "Full-regression D-1, Equation 5-9",
    "Means of Table C-5, Table 4-4", "Means of Table C-7", 'Table D-3, row "std"',
    "Best-fit C-5", "Best-fit C-6", "Best-fit C-7", "Best-fit C-8", "Best-fit C-9",
    "Best-fit C-10", "Table 4-3, C-39 to C-44: deterministic", "Ranks of Table C-33",
}  # fmt: skip
MENDED = {
    "Table C-26 (21 °C)", "Equation 4-35", "Equation 4-36", "Equation 4-39", "Table C-37",
    "Equation 4-44, Table C-38", "Ranks of Table C-8",
    "Equations 4-53 to 4-57, Full-regressions C-2 to C-7",
}  # fmt: skip
DOES_NOT = {
    "Tables C-10 to C-15", "Tables C-27 to C-32", "Equation 4-41", "Equation 4-49",
    "Equation 4-58", "Table 4-5", "Ranks of Tables C-19 to C-25", "Best-fit C-2", "Best-fit C-3",
    "Best-fit C-11", "Table 4-3, C-39 to C-44: Caldwell",
    "Table 4-3, C-39 to C-44: quasi-static", "Table 4-3, C-39 to C-44: black box 21",
    "Table 4-3, C-39 to C-44: black box T", "Ranks of Table C-16", "Ranks of Table C-17",
    "Ranks of Table C-34", "Ranks of Table C-36",
}  # fmt: skip


@pytest.fixture(scope="module")
def rows():
    return {row.item: row for row in audit_module.audit()}


@pytest.fixture(scope="module")
def cells():
    return table()


def test_the_audit_covers_every_item_and_no_other(rows) -> None:
    assert set(rows) == REPRODUCES | MENDED | DOES_NOT


@pytest.mark.parametrize("item", sorted(REPRODUCES))
def test_reproduces_from_the_shipped_tables_to_printed_digits(rows, item: str) -> None:
    assert rows[item].verdict == "reproduces", rows[item]


@pytest.mark.parametrize("item", sorted(MENDED))
def test_reproduces_once_the_named_slip_is_mended(rows, item: str) -> None:
    assert rows[item].verdict == "reproduces if mended", rows[item]


@pytest.mark.parametrize("item", sorted(DOES_NOT))
def test_does_not_reproduce_and_says_why(rows, item: str) -> None:
    assert rows[item].verdict == "does not reproduce", rows[item]
    assert len(rows[item].reason) > 20


def test_every_anomaly_that_the_audit_cites_is_shipped(rows) -> None:
    text = anomalies()
    for row in rows.values():
        for number in row.anomalies:
            assert f"- {number} " in text


@pytest.mark.parametrize(
    ("item", "said"),
    [
        ("Table C-26 (21 °C)", "0.261 for 0.026"),
        ("Table C-37", "2.05079 at 300 kPa for 2.50579"),
        ("Equation 4-36", "-7.5 N"),
        ("Tables C-10 to C-15", "1.038, 1.078"),
        ("Tables C-10 to C-15", "C-12 at 62 mm = C-13 at 63 mm"),
        ("Equation 4-41", "rmse 6.2 N"),
        ("Ranks of Tables C-19 to C-25", "42 rows"),
        ("Table 4-5", "copied"),
    ],
)
def test_reasons_are_derived_from_the_data(rows, item: str, said: str) -> None:
    assert said in rows[item].reason


def test_table_c9_by_an_independent_polynomial_fit() -> None:
    c1 = thesis_points("c01")
    for length, gradient, intercept in ((51.45, 0.0230, -7.43), (57.4, 0.0793, -11.8)):
        use = np.isclose(c1.length_m * 1e3, length) & (c1.pressure_pa >= 150e3)
        slope, constant = np.polyfit(c1.pressure_pa[use] / 1e3, c1.force_n[use], 1)
        assert abs(slope - gradient) < 5e-4
        assert abs(constant - intercept) < 0.05


# ---- Table 4-3 ------------------------------------------------------------------------


def of(cells, model: str):
    return [c for c in cells if c.model == model]


def test_deterministic_statistics_all_24_within_2_mN_rms(cells) -> None:
    assert recover_braid() == (78.3, 2.34)
    differences = [
        getattr(c.recomputed, s) - getattr(c.published, s)
        for c in of(cells, "deterministic")
        for s in STATISTICS
    ]
    assert len(differences) == 24
    assert np.sqrt(np.mean(np.square(differences))) < 0.002


@pytest.mark.parametrize(
    ("model", "region"), [("black box 21", "150-600"), ("black box T", "0-125")]
)
def test_rows_7_and_9_within_2_mN(cells, model: str, region: str) -> None:
    mine = [c for c in of(cells, model) if c.region == region]
    assert len(mine) == 2
    for cell in mine:
        for name in STATISTICS:
            assert abs(getattr(cell.recomputed, name) - getattr(cell.published, name)) <= 0.002


def test_quasi_static_recomputed(cells) -> None:
    found = [c.recomputed.stdev for c in of(cells, "quasi-static")]
    expected = [0.911, 1.660, 1.465, 2.137, 4.521, 4.126]
    assert [round(x, 3) for x in found] == expected


def test_nine_of_thirty_rows_contradict_their_own_semean(cells) -> None:
    bad = [(c.model, c.table) for c in cells if audit_module.contradicts(c)]
    assert len(bad) == 9
    assert {m for m, _ in bad} == {"quasi-static", "Caldwell"}


def test_the_comparison_was_run_on_c1_not_c2(cells) -> None:
    mine = of(cells, "deterministic")
    on_c1 = max(abs(c.recomputed.stdev - c.published.stdev) for c in mine)
    on_c2 = max(abs(c.on_c2.stdev - c.published.stdev) for c in mine)
    assert on_c1 < 0.002 < 0.05 < on_c2


def test_trimmed_mean_leaves_out_25_of_490_at_each_end() -> None:
    x = np.concatenate([np.full(25, -1e6), np.ones(440), np.full(25, 1e6)])
    assert describe(x).trmean == 1.0
    assert describe(x[:-1]).n == 489


# ---- regression tables ----------------------------------------------------------------


def test_full_regression_c8_prints_as_the_thesis_does() -> None:
    text = full_regression_c8().text()
    for printed in ("-26.09", "0.4953", "-0.00259", "-17.82", "20.58", "0.316", "86.4%", "57.21"):
        assert printed in text


def test_full_regressions_agree_with_numpy() -> None:
    c1 = thesis_points("c01")
    use = c1.pressure_pa >= 150e3
    p, d = c1.pressure_pa[use] / 1e3, c1.length_m[use] * 1e3
    design = np.column_stack([np.ones(p.size), p * d, p - 125.0])
    coefficients, sse = np.linalg.lstsq(design, c1.force_n[use], rcond=None)[:2]
    found = full_regression_c9()
    assert np.allclose([x.coef for x in found.predictors], coefficients, rtol=1e-8)
    assert found.anova[1].ss == pytest.approx(float(sse[0]))
    assert full_regression_d1().s == pytest.approx(10.74, abs=0.005)


def test_best_subsets_are_ordered_and_cp_of_all_is_their_number_plus_one() -> None:
    rng = np.random.default_rng(1)
    x = {name: rng.normal(size=40) for name in "abcd"}
    y = 3 * x["a"] - x["c"] + 0.1 * rng.normal(size=40)
    rows = best_subsets(y, x)
    assert rows[0].names == ("a",)
    two = next(r for r in rows if r.vars == 2)
    assert two.names == ("a", "c")
    assert rows[-1].cp == pytest.approx(5.0)
    assert "X" in subsets_text(rows, list(x))


def test_best_fit_c8_line_by_line() -> None:
    columns = array("t4_2_coefs_0_125")
    t = columns["temperature_c"]
    x = {"T": t, "T^2": t**2, "sin": np.sin(t), "cos": np.cos(t)}
    found = best_subsets(columns["K4_length"], x)
    assert [round(r.s, 6) for r in found] == [
        0.014564, 0.01694, 0.013712, 0.014735, 0.014448, 0.015526, 0.016582
    ]  # fmt: skip
    assert [round(r.cp, 1) for r in found] == [0.9, 2.2, 1.7, 2.2, 3.3, 3.6, 5.0]


def test_predictors_that_are_not_independent_are_refused() -> None:
    x = np.arange(10.0)
    with pytest.raises(ValueError, match="not independent"):
        full_regression("y", x**2, {"a": x, "b": 2 * x})


@pytest.mark.parametrize(
    ("printed", "value", "is_same"),
    [("0.0087", 0.00869, True), ("0.0087", 0.00876, False), ("1.79200E-13", 1.792004e-13, True),
     ("421", 421.42, True), ("-0.43", -0.425, True)],
)  # fmt: skip
def test_a_figure_is_the_same_if_it_rounds_to_the_printed_digits(printed, value, is_same) -> None:
    assert same(printed, value) == is_same


def test_truncation_is_told_from_rounding() -> None:
    assert truncated("0.0086", 0.00869)
    assert not truncated("0.0087", 0.00869)
    assert unit_in_last_place("5.31428E-14") == pytest.approx(1e-19)


def test_the_ranks_of_sine_and_cosine_are_what_does_not_follow(rows) -> None:
    """Length and its cube lead in every row of C-16, C-17 and C-34, as printed."""
    for name in ("C-16", "C-17", "C-34"):
        assert "the first 2 places are right in every row" in rows[f"Ranks of Table {name}"].reason
    assert "at 30, 33, 36, 39 °C the printed ranks are not 1 to 4" in (
        rows["Ranks of Table C-17"].reason
    )
    assert rows["Ranks of Table C-16"].recomputed == "3 of 7 the same"
    assert rows["Ranks of Table C-36"].recomputed == "5 of 11 the same from C-1"


def test_r_squared_of_a_predictor_is_that_of_numpy() -> None:
    rng = np.random.default_rng(2)
    x = np.linspace(51.0, 67.0, 14)
    y = 0.3 * x + np.sin(x) + rng.normal(size=14)
    for name, column in (("L^3", x**3), ("cos(L)", np.cos(x)), ("log(d)", np.log(x)), ("d", x)):
        expected = 100 * np.corrcoef(column, y)[0, 1] ** 2
        assert r_squared(name, x, y) == pytest.approx(expected, rel=1e-9)
    design = np.column_stack([np.ones(14), x, x**3])
    rest = y - design @ np.linalg.lstsq(design, y, rcond=None)[0]
    both = 100 * (1 - rest @ rest / np.sum((y - y.mean()) ** 2))
    assert r_squared("L and L^3", x, y) == pytest.approx(both, rel=1e-6)
