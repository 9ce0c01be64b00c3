"""What was seen on printed pages and is not to come back: words, units, gaps, breaks."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any, cast

import numpy as np
import pandas as pd
import pytest

from analysis.figures.timeline import broken, timeline_figure
from analysis.figures.wording import column_decimals, from_to, ratio_unit
from analysis.findings.findings import Section
from analysis.findings.isothermal import isothermal_headline
from analysis.findings.muscle.held import LENGTH, held_headline
from analysis.reduction.points import Reduction
from analysis.registry import analysis_of
from analysis.reporting.report import render_report, report_json
from analysis.reporting.sections import section_parts
from analysis.run_table import reduce_run
from daq.store.run import Run
from protocol_runs import run_short


class Bare:
    """A run of which nothing is known."""

    manifest: dict[str, Any] = {}  # noqa: RUF012 - never changed


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Run]:
    root = tmp_path_factory.mktemp("pages")
    return {name: run_short(name, root)[1] for name in ("creep", "fatigue", "hysteresis")}


@pytest.mark.parametrize("name", ["creep", "fatigue", "hysteresis"])
def test_normal_steps_of_a_test_are_no_faults(name: str, runs: dict[str, Run]) -> None:
    made: dict[str, Any] = report_json(runs[name])
    assert made["faults"] == []


def test_what_is_held_is_named_with_its_units(runs: dict[str, Run]) -> None:
    found = analysis_of("creep").findings(runs["creep"], reduce_run(runs["creep"]))
    assert "1.154 kg, 300 kPa" in found.headline


def test_the_headline_of_a_held_test_agrees_with_the_law_that_was_chosen() -> None:
    """The slope of a line may be 0.26 ± 0.23 mm per decade where the law is that of no change."""
    row = {"slot": "1.154 kg, 300 kPa", "rate": 0.26, "u_rate": 0.115, "law": "constant"}
    none = held_headline([row], LENGTH)
    assert none.startswith("No change of the length was found: it is below 0.49 mm per decade")
    creeps = held_headline([row, {**row, "rate": -0.31, "law": "logarithmic"}], LENGTH)
    assert "creeps: by −0.31 ± 0.23 mm per decade" in creeps
    assert "found in 1 of 2 trials" in creeps
    assert "creeps" in held_headline([{**row, "law": None}], LENGTH), "by the slope without a law"


def test_a_constant_law_has_no_columns_of_dashes(runs: dict[str, Run]) -> None:
    found = analysis_of("creep").findings(runs["creep"], reduce_run(runs["creep"]))
    law = next(s for s in found.sections if s.title == "Law that was chosen")
    assert law.table is not None
    for name, heading in law.columns:
        assert law.table[name].notna().any(), heading


def test_a_column_of_numbers_has_one_number_of_decimals() -> None:
    table = pd.DataFrame({"a": [37.1, 6.507, math.nan], "r2": [1.0, 0.98761, 0.5], "k": [1, 2, 3]})
    parts = section_parts(Section("", (), table, (("a", "a, N"), ("r2", "R²"), ("k", "k"))))
    cells = [[cell["text"] for cell in row["cells"]] for row in parts["rows"]]
    assert cells == [
        ["37.100", "> 0.9999", "1"], ["6.507", "0.9876", "2"], ["–", "0.5000", "3"]
    ]  # fmt: skip
    assert column_decimals([100.0, 50.0]) == 0
    assert column_decimals([0.0, 0.0002, 0.0052]) == 4
    assert column_decimals([1200.0, 0.004]) is None, "a small number is not rounded away"
    assert column_decimals([]) == 0


def test_numbers_as_text_stand_on_the_right_and_words_on_the_left() -> None:
    table = pd.DataFrame({"p": ["< 0.001", "0.301"], "by": ["–", "operator"]})
    rows = section_parts(Section("", (), table, (("p", "p"), ("by", "by"))))["rows"]
    assert [[cell["left"] for cell in row["cells"]] for row in rows] == [[False, True]] * 2


def test_the_unit_of_a_scale_is_not_written_twice() -> None:
    assert ratio_unit("kPa", "count") == "kPa/count"
    assert ratio_unit("m/s", "V") == "m/s per V"
    assert ratio_unit("m/s", "m/s") == ""


def test_no_number_of_a_flow_test_has_more_digits_than_its_uncertainty(tmp_path: Path) -> None:
    _, run, _ = run_short("flow", tmp_path)
    made = reduce_run(run)
    sections = analysis_of("flow").findings(run, made).sections
    iso = next(section for section in sections if section.title == "ISO 6358")
    shown = re.findall(r"([\d.]+) ± ([\d.]+)", iso.words[0])
    assert len(shown) == 2, "C and the critical ratio have their uncertainties"
    for value, u in shown:
        assert len(value.partition(".")[2]) == len(u.partition(".")[2])
    fanning = next(section for section in sections if section.title == "Fanning form")
    for row in section_parts(fanning)["rows"]:
        coefficient, error = (row["cells"][k]["text"] for k in (1, 2))
        assert len(error.replace(".", "").lstrip("0")) == 2
        assert len(coefficient.partition(".")[2]) == len(error.partition(".")[2])
    page = render_report(run, made)
    assert "m/s/m/s" not in page
    assert "velocity_m_s</td>" not in page, "calibrations name the quantity in words"


def test_no_page_speaks_of_tables_of_the_thesis(runs: dict[str, Run]) -> None:
    assert not re.search(r"Table [A-D]-\d|Figure \d-\d", render_report(runs["hysteresis"]))


def test_what_was_not_recorded_is_a_gap_in_the_time_line(runs: dict[str, Run]) -> None:
    figure = timeline_figure(runs["fatigue"])
    assert figure is not None
    times = figure.axes[0].lines[1].get_xdata()
    assert np.isnan(np.asarray(times, dtype=float)).any()
    x, y = broken(np.r_[0.0:1.0:0.1, 5.0:6.0:0.1], np.arange(20.0))
    assert np.isnan(x[10])
    assert np.isnan(y).sum() == 1
    x, _ = broken(np.arange(0.0, 100.0, 2.0), np.arange(50.0))
    assert not np.isnan(x).any(), "slow readings are no gaps"


def test_a_negative_change_with_temperature_has_a_minus_sign() -> None:
    table = pd.DataFrame({"temperature_c": [21.0, 39.0]})
    growth = pd.DataFrame({"growth": [-0.00099, 0.0013], "u_growth": [0.0001, 0.0001]})
    headline = isothermal_headline(table, growth)
    assert "by −0.00099 to 0.0013 %/K, more than its uncertainty at 2 of 2 lengths" in headline


def test_lines_over_pressure_are_stated_for_the_pressures_that_were_measured() -> None:
    """Not from 0 to 600 kPa; and a probability is never a number such as 2e-21."""
    pressures = np.array([100.0, 200.0, 300.0, 400.0])
    values = {"on_v": 3.0 + 0.002 * pressures, "off_v": 0.8 + 0.0001 * pressures}
    table = pd.DataFrame({"valve": "inlet", "pressure_kpa": pressures, **values})
    table["set_pressure_kpa"] = table["pressure_kpa"]
    for name in values:
        for part in ("", "_noise", "_cal"):
            table[f"u_{name}{part}"] = 0.01
    found = analysis_of("switching-voltage").findings(cast(Run, Bare()), Reduction(table, (), {}))
    assert found.headline.startswith("From 100 to 400 kPa the inlet turns on at 3.20 to 3.80 V")
    lines = next(s for s in found.sections if s.title == "Straight lines in pressure")
    assert lines.table is not None
    assert set(lines.table["p"]) == {"< 0.001"}


@pytest.mark.parametrize(
    ("low", "high", "decimals", "shown"),
    [
        (0.801, 0.804, 2, "0.80"),
        (3.51, 4.31, 2, "3.51 to 4.31"),
        (0.00041, 0.00068, None, "0.00041 to 0.00068"),
        (-0.4712, -0.2, None, "−0.47 to −0.20"),
        (0.0, 0.0, None, "0.00"),
    ],
)
def test_a_range_has_the_digits_that_tell_its_ends_apart(
    low: float, high: float, decimals: int | None, shown: str
) -> None:
    assert from_to(low, high, decimals) == shown
