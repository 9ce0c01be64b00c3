"""The thesis's measured tables, reduced: what was printed comes out, or is named."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from analysis.findings.findings import Findings, Section
from analysis.findings.flow import Meter, fit_iso, flow_findings, flow_share
from analysis.findings.hysteresis import cycles_of, hysteresis_findings
from analysis.findings.isobaric import isobaric_findings, lines_in_length
from analysis.findings.isotonic import isotonic_findings
from analysis.findings.switching import time_findings, voltage_findings
from analysis.formats.importer import import_thesis
from analysis.reduction.points import Reduction, reduce_points
from analysis.reduction.valve_points import imported_points
from analysis.regression.least_squares import straight_line
from analysis.reporting.report import report_json, write_report
from daq.clock import VirtualClock
from daq.errors import PamrigError
from daq.store.run import open_run
from daq.store.verify import verify

CYCLES = {"mass_kg": "float64", "cycle_max_kpa": "float64"}


def found_in(tmp_path: Path, table: str) -> tuple[Reduction, Findings]:
    run = open_run(import_thesis(table, tmp_path, VirtualClock()))
    assert verify(run) == []
    protocol = run.manifest["protocol"]
    if protocol in ("switching-time", "switching-voltage", "flow"):
        reduction = imported_points(run, protocol)
        makers = {
            "switching-time": time_findings,
            "switching-voltage": voltage_findings,
            "flow": flow_findings,
        }
        return reduction, makers[protocol](run, reduction)
    reduction = reduce_points(run, extra=CYCLES if protocol != "isobaric" else {})
    makers = {
        "isobaric": isobaric_findings,
        "isotonic": isotonic_findings,
        "hysteresis": hysteresis_findings,
    }
    return reduction, makers[protocol](run, reduction)


def printed(findings: Findings) -> Section:
    """The section that sets the thesis's numbers beside the recomputed ones."""
    return next(s for s in findings.sections if "the thesis" in s.title)


def records(section: Section) -> list[dict[str, Any]]:
    assert section.table is not None
    return section.table.to_dict("records")


def test_full_regression_d1_and_equation_5_9_come_out_of_table_d5(tmp_path: Path) -> None:
    """Full-regression D-1: -5.293 + 0.130854 V^2, s 10.74, R2 99.7 %, F 3929.97."""
    _, found = found_in(tmp_path, "d05")
    assert found.data["fanning_constant_kpa"] == pytest.approx(-5.293, abs=5e-4)
    assert found.data["fanning_coefficient"] == pytest.approx(0.130854, abs=5e-7)
    section = next(s for s in found.sections if s.title == "Fanning form")
    assert all(row["same"] for row in records(section))
    assert "3929.97 (3929.97)" in " ".join(section.words)
    assert "shaded" not in " ".join(section.words)


def test_the_std_row_of_table_d3_is_the_spread_of_all_39_readings(tmp_path: Path) -> None:
    reduction, found = found_in(tmp_path, "d03")
    assert len(reduction.table) == 2 * 39
    rows = records(printed(found))
    assert [row["printed"] for row in rows] == [0.773, 0.155, 0.479, 0.128]
    assert all(row["same"] for row in rows)
    within = {row["edge"]: row["within"] for row in rows}
    assert within == {
        "inlet on": pytest.approx(0.25, abs=0.005),
        "inlet off": pytest.approx(0.03, abs=0.005),
        "outlet on": pytest.approx(0.42, abs=0.005),
        "outlet off": pytest.approx(0.07, abs=0.005),
    }


@pytest.mark.parametrize(
    ("table", "name", "at_0", "per_kpa"),
    [
        ("d01", "inlet_on_ms", 8.70, 0.00395),
        ("d01", "inlet_off_ms", 8.94, -0.00080),
        ("d01", "outlet_on_ms", 9.28, 0.00174),
        ("d01", "outlet_off_ms", 8.82, -0.00058),
        ("d04", "inlet_on_v", 3.44, 0.00145),
        ("d04", "outlet_on_v", 2.80, 0.00071),
    ],
)
def test_the_constants_of_the_reference_bench_are_the_lines_through_d1_to_d4(
    tmp_path: Path, table: str, name: str, at_0: float, per_kpa: float
) -> None:
    """Numbers of the reference plant (configs/plant/thesis.toml), least squares of D-1 to D-4."""
    _, found = found_in(tmp_path, table)
    assert found.data[name] == pytest.approx(at_0, abs=0.0051)
    assert found.data[f"{name}_per_kpa"] == pytest.approx(per_kpa, abs=6e-6)
    assert 0 < found.data[f"u_{name}"] < 0.2


def test_means_of_table_c5_and_table_4_4_come_out_by_their_actual_rule(tmp_path: Path) -> None:
    reduction, found = found_in(tmp_path, "c05")
    rows = records(printed(found))
    assert len(rows) == 8
    assert all(row["same"] and row["appendix"] == row["chapter"] for row in rows)
    (cycle,) = [c for c in cycles_of(reduction.table) if c.name == "61.9 mm" and c.top_kpa == 600]
    assert cycle.mean()[0] == pytest.approx(0.79, abs=0.005)
    assert cycle.difference.mean() == pytest.approx(0.52, abs=0.01), "the whole column"
    assert "69 of 88 differences" in " ".join(printed(found).words)


def test_table_4_5_is_named_a_copy_of_table_4_4(tmp_path: Path) -> None:
    _, found = found_in(tmp_path, "c07")
    section = printed(found)
    rows = records(section)
    assert all(row["same"] for row in rows), "the means under Table C-7 do come out"
    assert sum(abs(row["readings"] - row["chapter"]) < 0.02 for row in rows) == 0
    assert "Table 4-5 does not reproduce" in " ".join(section.words)


def test_table_c37_comes_from_c1_and_not_from_c2_and_its_slip_is_named(tmp_path: Path) -> None:
    _, found = found_in(tmp_path, "c02")
    section = printed(found)
    rows = records(section)
    assert [row["pressure_kpa"] for row in rows if not row["same"]] == [300.0]
    (slip,) = [row for row in rows if not row["same"]]
    assert (slip["g_printed"], slip["g_c1"]) == (2.05079, 2.50579)
    assert max(abs(row["i_printed"] - row["i_c2"]) for row in rows) > 2.0
    words = " ".join(section.words)
    assert "0.00878 P − 0.2391" in words
    assert "0.00867 P − 0.1597" in words


def test_lengths_under_load_are_those_of_table_c3_and_its_claims_are_held_against_it(
    tmp_path: Path,
) -> None:
    reduction, found = found_in(tmp_path, "c03")
    assert len(reduction.table) == 161
    assert len(found.data["loads"]) == 7
    shares = [row["contraction"] for row in found.data["loads"]]
    assert min(shares) == pytest.approx(0.26, abs=0.005)
    assert max(shares) == pytest.approx(0.30, abs=0.005)
    claims = {row["claim"][:11]: row for row in records(printed(found))}
    assert not claims["contraction"]["same"]
    assert "400, 425, 450, 475 kPa" in claims["a heavier l"]["found"]


def test_lines_in_length_need_three_lengths(tmp_path: Path) -> None:
    reduction, _ = found_in(tmp_path, "c02")
    few = reduction.table[reduction.table["length_mm"] > 66]
    assert lines_in_length(few) == []


@pytest.mark.parametrize("table", ["d01", "d04", "d05"])
def test_an_imported_valve_table_has_a_report_and_json(tmp_path: Path, table: str) -> None:
    run = open_run(import_thesis(table, tmp_path, VirtualClock()))
    data = report_json(run)
    for part in ("headline", "sections", "results"):
        assert data[part], part
    text = write_report(run).read_text(encoding="utf-8")
    assert "data:image/svg+xml;base64" in text
    assert data["sections"][0]["title"] in text


def test_an_unknown_table_names_those_there_are(tmp_path: Path) -> None:
    with pytest.raises(PamrigError, match=r"c09.*c01, c02, c03, c04, c06, d01, d04, d05, c05"):
        import_thesis("c09", tmp_path, VirtualClock())


def test_iso_6358_comes_back_from_its_own_velocities() -> None:
    """Made with C = 1.25e-9, r = 0.5 and read without error: both come back."""
    import pandas as pd

    meter = Meter(bore_mm=4.0)
    p = np.array([5.0, 10, 20, 40, 60, 80, 100, 200, 300, 400, 500, 600])
    v = 1.25e-9 * meter.velocity_per_conductance * flow_share(p, 0.5, 101.325)
    table = pd.DataFrame({"pressure_kpa": p, "velocity_m_s": v})
    for name in ("pressure_kpa", "velocity_m_s"):
        table[f"u_{name}_noise"] = 0.0
    fit = fit_iso(table, meter)
    assert fit is not None
    assert fit.conductance == pytest.approx(1.25e-9, rel=1e-4)
    assert fit.critical == pytest.approx(0.5, abs=1e-4)
    choked = 1.25e-9 * 1.185 * 701.325e3 / (1.2041 * np.pi * 4e-6)
    assert v[-1] == pytest.approx(choked, rel=1e-3), "by hand: C rho0 P1 / (rho A)"


def test_a_line_is_what_a_statistics_package_prints() -> None:
    """An independent oracle: statsmodels on the same numbers."""
    import statsmodels.api as sm

    rng = np.random.default_rng(3)
    x = rng.uniform(0, 10, 20)
    y = 3 - 2 * x + rng.normal(0, 0.5, 20)
    line = straight_line(x, y)
    assert line is not None
    oracle = sm.OLS(y, sm.add_constant(x)).fit()
    assert [line.intercept, line.slope] == pytest.approx(oracle.params)
    assert [line.u_intercept, line.u_slope] == pytest.approx(oracle.bse)
    assert [line.p_intercept, line.p_slope] == pytest.approx(oracle.pvalues)
    assert line.r2_adjusted == pytest.approx(oracle.rsquared_adj)
    assert line.f == pytest.approx(oracle.fvalue)
