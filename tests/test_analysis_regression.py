"""The thesis's printed coefficients are the oracle of the regressions."""

from __future__ import annotations

import csv
from importlib import resources
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from analysis.findings.thesis_check import compare_c9
from analysis.formats.importer import import_thesis
from analysis.reduction.columns import COLUMNS
from analysis.reduction.points import reduce_isometric
from analysis.regression.force_lines import against_length, fit_line, per_length
from daq.clock import VirtualClock
from daq.store.run import open_run


def printed_pairs() -> dict[str, tuple[str, str]]:
    """Table C-9 straight from the shipped text, not through the code under test."""
    text = (
        resources.files("plant.data").joinpath("c09_c15_per_length_coefs_150_600.csv").read_text()
    )
    return {
        row["length_mm"]: (row["pressure_gradient_coef"], row["intercept_coef"])
        for row in csv.DictReader(text.splitlines())
        if row["table"] == "C-9"
    }


@pytest.fixture(scope="module")
def c01(tmp_path_factory: pytest.TempPathFactory) -> pd.DataFrame:
    folder = import_thesis("c01", tmp_path_factory.mktemp("runs"), VirtualClock())
    return reduce_isometric(open_run(folder)).table


def test_all_14_pairs_of_table_c9_to_their_printed_digits(c01: pd.DataFrame) -> None:
    pairs = printed_pairs()
    assert len(pairs) == 14
    lines = {f"{line.length_mm:g}": line for line in per_length(c01)}
    assert set(lines) == set(pairs)
    for length, (gradient, intercept) in pairs.items():
        line = lines[length]
        decimals = len(gradient.split(".")[1]), len(intercept.split(".")[1])
        assert f"{line.gradient_n_per_kpa:.{decimals[0]}f}" == gradient
        assert f"{line.intercept_n:.{decimals[1]}f}" == intercept


def test_equation_4_34_from_the_coefficients_as_tabulated(c01: pd.DataFrame) -> None:
    law = against_length(per_length(c01), digits=3)
    assert law is not None
    assert f"{law.gradient.slope:.4f} L {law.gradient.intercept:.3f}" == "0.0087 L -0.426"
    assert f"{law.intercept.slope:.3f} L {law.intercept.intercept:.2f}" == "-0.159 L -0.43"


def test_equation_4_34_needs_the_tabulated_digits_and_51_45_mm(c01: pd.DataFrame) -> None:
    exact = against_length(per_length(c01))
    assert exact is not None
    assert f"{exact.gradient.intercept:.3f}" == "-0.425"
    as_headed = c01.copy()
    as_headed.loc[as_headed.length_mm == 51.45, ["length_mm", "set_length_mm"]] = 51.0
    law = against_length(per_length(as_headed), digits=3)
    assert law is not None
    assert f"{law.gradient.slope:.4f} L {law.gradient.intercept:.3f}" == "0.0086 L -0.419"


def test_the_report_of_the_51_mm_reading_gives_both_sums_of_squares(c01: pd.DataFrame) -> None:
    check = compare_c9(per_length(c01), c01)
    assert check["matching"] == check["pairs"] == 14
    imported, headed = check["readings"]
    assert (imported["shortest_mm"], headed["shortest_mm"]) == (51.45, 51.0)
    assert f"{imported['sse_c8']:.2f}" == "57.21"
    assert f"{headed['sse_c8']:.2f}" == "58.71"
    assert f"{imported['sse_c9']:.0f}" == "421"
    assert [e["same"] for e in imported["equations"]] == [True, True]
    assert not any(e["same"] for e in headed["equations"])


def test_one_wrong_reading_is_caught_by_the_comparison(c01: pd.DataFrame) -> None:
    bent = c01.copy()
    bent.loc[bent.index[-1], "force_n"] += 3.0
    assert compare_c9(per_length(bent), bent)["matching"] == 13


def test_standard_errors_agree_with_numpys_covariance() -> None:
    rng = np.random.default_rng(2)
    x = np.linspace(150, 600, 11)
    y = 0.1 * x - 5 + rng.normal(0, 0.4, 11)
    fit = fit_line(x, y)
    coefficients, covariance = np.polyfit(x, y, 1, cov=True)
    assert fit is not None
    assert (fit.slope, fit.intercept) == pytest.approx(tuple(coefficients))
    assert (fit.u_slope, fit.u_intercept) == pytest.approx(tuple(np.sqrt(np.diag(covariance))))


def points(rows: list[dict[str, object]]) -> pd.DataFrame:
    base = dict.fromkeys(COLUMNS, np.nan)
    return pd.DataFrame([{**base, "direction": "up", **row} for row in rows])


def test_a_point_belongs_to_the_region_by_its_set_pressure() -> None:
    table = points(
        [
            {"set_pressure_kpa": p, "pressure_kpa": p - 0.2, "force_n": 0.1 * p,
             "set_length_mm": 60.0, "length_mm": 60.01}
            for p in (100.0, 150.0, 300.0, 600.0)
        ]
    )  # fmt: skip
    (line,) = per_length(table)
    assert line.n == 3
    assert line.length_mm == pytest.approx(60.01)


def test_a_length_with_one_pressure_gives_no_line_instead_of_a_wrong_one() -> None:
    table = points(
        [{"set_pressure_kpa": 200.0, "pressure_kpa": 200.0, "length_mm": 60.0, "force_n": f}
         for f in (1.0, 2.0)]
    )  # fmt: skip
    assert per_length(table) == []
    assert against_length([]) is None


def test_temperatures_are_not_mixed_into_one_line(tmp_path: Path) -> None:
    folder = import_thesis("c01", tmp_path, VirtualClock(), include_formula=True)
    lines = per_length(reduce_isometric(open_run(folder)).table)
    assert len(lines) == 14 * 7
    assert {line.n for line in lines} == {11}
