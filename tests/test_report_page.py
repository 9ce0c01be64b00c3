"""Page one of a report: results with uncertainty, verdict on limits, sign-off; PDF, figures."""

from __future__ import annotations

import io
import json
import math
import re
import sys
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pypdf import PdfReader
from typer.testing import CliRunner

from analysis.formats.importer import import_thesis
from analysis.registry import analysis_of
from analysis.reporting.figure_files import run_figures, write_figures
from analysis.reporting.page_one import result_table
from analysis.reporting.pdf import page_to_pdf
from analysis.reporting.report import render_report, report_json, write_report
from analysis.reporting.results import Result, chosen, judge, results_of, rounded
from analysis.run_table import reduce_run
from analysis.statistics.repeats import RepeatMean
from analysis_bench import write_run
from cli.main import app
from daq.clock import VirtualClock
from daq.errors import ConfigError, PamrigError
from daq.store.run import open_run
from rigs.protocols.registry import procedure
from rigs.rigfile.config import load_rig
from rigs.rigfile.toml_reader import find_config

LIMITS = {
    "guard": 1.0,
    "limits": [
        {"quantity": "force_n", "at": {"set_length_mm": 60.0, "set_pressure_kpa": 600.0},
         "lower": 30.0, "upper": 60.0},
        {"quantity": "force_n", "at": {"set_length_mm": 55.0, "set_pressure_kpa": 200.0},
         "lower": None, "upper": 1.0},
        {"quantity": "force_n", "at": {"set_length_mm": 90.0}, "lower": 0.0, "upper": None},
    ],
}  # fmt: skip


@pytest.fixture(scope="module")
def tested(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_run(
        tmp_path_factory.mktemp("runs"), np.random.default_rng(4), operator="B. Tester",
        directions=("up", "up"), window=60,
        parameters={"pressures_kpa": [200.0, 400.0, 600.0], "repeats": 2, "order": "up-down",
                    "source": "acceptance.toml", "acceptance": LIMITS},
        devices={"valve": {"serial": "VB-0001"}, "balance": {"serial": "BAL-7"}},
    ).folder  # fmt: skip


@pytest.fixture(scope="module")
def page(tested: Path, tmp_path_factory: pytest.TempPathFactory) -> str:
    out = tmp_path_factory.mktemp("page") / "report.html"
    return write_report(open_run(tested), out).read_text("utf-8")


def words(html: str) -> str:
    html = re.sub(r"<style>.*?</style>", "", html, flags=re.DOTALL)
    return re.sub(r"\s+", " ", unescape(re.sub(r"<[^>]+>", " ", html)))


def first(html: str) -> str:
    return words(html.partition('<h1 class="part new-page">')[0])


def test_page_one_holds_what_a_laboratory_hands_on(page: str) -> None:
    text = first(page)
    for part in (
        "synthetic", "B. Tester", "acceptance.toml", "pressures 200, 400, 600 kPa", "2 repeats",
        "21.0 ± 0.4 °C", "VB-0001", "BAL-7", "P-1", "no date stated", "0.3 kPa, 0.3 % of reading",
        "standard deviation", "expanded uncertainty", "Student's t", "Tested by: B. Tester",
        "Checked by", "Date",
    ):  # fmt: skip
        assert part in text, part


def test_results_are_means_of_repeats_at_one_setting(tested: Path) -> None:
    run = open_run(tested)
    table = reduce_run(run).table
    results = results_of(reduce_run(run), analysis_of("isometric").results)
    assert len(results) == 9
    for result in results:
        at = dict(result.at)
        rows = table[(table["set_length_mm"] == at["set_length_mm"])
                     & (table["set_pressure_kpa"] == at["set_pressure_kpa"])]  # fmt: skip
        assert result.mean.n == len(rows) == 2
        assert result.mean.mean == pytest.approx(rows["force_n"].mean())
        assert result.mean.sd == pytest.approx(rows["force_n"].std())
        assert result.mean.u >= rows["u_force_n_cal"].mean()
        assert result.mean.k >= 2.0
    again = report_json(run)["means"]
    assert [row["mean"] for row in again] == [r.mean.mean for r in results]
    json.dumps(again, allow_nan=False)


def test_verdicts_follow_from_the_limits_of_the_protocol(tested: Path, page: str) -> None:
    found = report_json(open_run(tested))["acceptance"]
    assert [row["verdict"] for row in found["judged"]] == ["pass", "fail", "not measured"]
    assert found["verdict"] == "fail"
    assert "ILAC-G8" in found["rule"]
    text = first(page)
    assert "Acceptance: fail" in text
    assert "1 fail, 1 not measured, 1 pass" in text
    assert "force, 90 mm at least 0 N – not measured" in text


def test_without_limits_nothing_is_judged(tmp_path: Path) -> None:
    run = open_run(write_run(tmp_path, np.random.default_rng(1)).folder)
    assert report_json(run)["acceptance"] is None
    assert "No acceptance limits are stated" in first(write_report(run).read_text("utf-8"))
    assert judge([], None) == []


def test_page_one_shows_the_range_of_many_results(tmp_path: Path) -> None:
    lengths = tuple(np.arange(50.0, 66.0, 2.0))
    truth = write_run(tmp_path, np.random.default_rng(1), lengths, window=60)
    results = results_of(reduce_run(open_run(truth.folder)), analysis_of("isometric").results)
    assert len(results) == 8 * 3 * 2
    shown = chosen(results, 12)
    assert 6 <= len(shown) <= 12
    at = [dict(r.at) for r in shown]
    assert {a["set_length_mm"] for a in at} >= {50.0, 64.0}
    assert {a["set_pressure_kpa"] for a in at} >= {200.0, 600.0}
    text = words(write_report(open_run(truth.folder)).read_text("utf-8"))
    assert "of 48 results; the others are under Details" in text
    assert "All results: 48" in text


ONE = '[[acceptance.limits]]\nquantity = "force_n"\nupper = 3.0\n'


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("[acceptance]\n", "acceptance.limits: expected tables"),
        (ONE.replace("force_n", "stiffness"), "'stiffness' is not one of force_n"),
        (ONE.replace("upper = 3.0\n", ""), "neither lower nor upper"),
        (ONE + "lower = 4.0\n", "3 is not above lower = 4"),
        (ONE + "at = { lenght = 60 }\n", "lenght: is no setting of this test"),
        (ONE + "at = { set_length_mm = [60] }\n", "expected a number or text"),
        (ONE + "guard = 1.0\n", "unknown key"),
    ],
)
def test_bad_limits_are_refused_with_file_and_key(tmp_path: Path, text: str, told: str) -> None:
    path = tmp_path / "test.toml"
    path.write_text(find_config("isometric-short", "protocols")[0] + text, "utf-8")
    with pytest.raises(ConfigError, match=re.escape(told)) as error:
        procedure("isometric").read(str(path), load_rig("virtual"))
    assert str(path) in str(error.value)


@pytest.mark.parametrize("name", ["isometric", "hysteresis", "flow", "joint-static"])
def test_limits_go_into_the_record_with_the_parameters(tmp_path: Path, name: str) -> None:
    kind = procedure(name)
    rig = load_rig(
        {"joint-static": "virtual-joint", "flow": "virtual-valve-stand"}.get(name, "virtual")
    )
    quantity = kind.analysis.results.quantities[0]
    path = tmp_path / "test.toml"
    path.write_text(
        find_config(f"{name}-short", "protocols")[0] + ONE.replace("force_n", quantity), "utf-8"
    )
    found = kind.read(str(path), rig).as_dict()["acceptance"]
    limit = {"quantity": quantity, "at": {}, "lower": None, "upper": 3.0}
    assert found == {"guard": 1.0, "limits": [limit]}
    assert "acceptance" not in kind.read(f"{name}-short", rig).as_dict()


def pdf_or_reason(html: str) -> bytes | str:
    """The PDF; where the library Pango is not installed, what the command says of it."""
    try:
        return page_to_pdf(html)
    except PamrigError as error:
        return str(error)


def test_the_pdf_is_the_page(page: str) -> None:
    _, *others = re.findall(r"<figure>.*?</figure>", page, flags=re.DOTALL)
    assert others
    for figure in others:  # one shows what all would, in less time
        page = page.replace(figure, "")
    made = pdf_or_reason(page)
    if isinstance(made, str):
        assert "Pango" in made or "pamrig[pdf]" in made
        pytest.skip(made)
    pages = [re.sub(r"\s+", " ", p.extract_text()) for p in PdfReader(io.BytesIO(made)).pages]
    for part in ("Isometric test of synthetic", "Tested by: B. Tester", "FAIL", "Student"):
        assert part in pages[0], part
    assert pages[1].startswith("Figures"), "page one is one page"
    assert "folded: in the HTML page" in pages[-1]
    box = PdfReader(io.BytesIO(made)).pages[0].mediabox
    assert (float(box.width), float(box.height)) == pytest.approx((595.3, 841.9), abs=0.1)


def test_a_missing_library_is_one_line(monkeypatch: pytest.MonkeyPatch, page: str) -> None:
    monkeypatch.setitem(sys.modules, "weasyprint", None)
    with pytest.raises(PamrigError, match=r"pamrig\[pdf\]"):
        page_to_pdf(page)


@pytest.mark.parametrize(("column", "width_mm"), [("double", 180.0), ("single", 88.0)])
def test_figures_are_files_in_the_width_of_a_column(
    tested: Path, tmp_path: Path, column: str, width_mm: float
) -> None:
    files = write_figures(run_figures(open_run(tested), column)[:1], tmp_path)
    assert [f.name for f in files] == [f"01-force-against-pressure.{e}" for e in ("pdf", "svg")]
    svg = files[1].read_text("utf-8")
    width = re.search(r'<svg [^>]*width="([\d.]+)pt"', svg)
    assert width is not None
    assert float(width[1]) / 72 * 25.4 == pytest.approx(width_mm, abs=0.1)
    assert ">force (N)</text>" in svg, "letters are text"
    assert b"/FontFile2" in files[0].read_bytes(), "the font is embedded"


def test_one_command_writes_page_and_figures(tested: Path, tmp_path: Path) -> None:
    done = run("report", tested, "--out", tmp_path / "r.html", "--figures", tmp_path / "figures")
    assert done.exit_code == 0, done.output
    assert "Acceptance" in (tmp_path / "r.html").read_text("utf-8")
    written = {f"{f.parent.name}/{f.name}" for f in (tmp_path / "figures").iterdir()}
    assert len(written) == 2 * len(run_figures(open_run(tested)))
    assert all(name in done.output.replace("\n", "") for name in written)


def run(*given: Any) -> Any:
    return CliRunner().invoke(app, [str(one) for one in given])


def test_a_column_that_no_paper_has_is_refused(tested: Path) -> None:
    done = run("report", tested, "--column", "triple")
    assert isinstance(done.exception, ConfigError)
    assert "'triple' is neither double nor single" in str(done.exception)


def test_the_rounding_of_printed_numbers_is_not_shown_as_an_uncertainty(tmp_path: Path) -> None:
    run = open_run(import_thesis("c01", tmp_path, VirtualClock()))
    reduction = reduce_run(run)
    assert reduction.rounding_only == ("force_n",)
    assert reduction.table["u_force_n"].gt(0.0).all(), "the table still states the rounding"
    results = results_of(reduction, analysis_of("isometric").results)
    assert len(results) == 224
    assert not any(math.isfinite(one.mean.expanded) for one in results)
    text = render_report(run, reduction)
    assert "0.00058" not in text
    assert "only the rounding of the printed numbers is stated" in text


def test_repeats_of_printed_numbers_have_the_uncertainty_of_their_scatter(tmp_path: Path) -> None:
    run = open_run(import_thesis("d01", tmp_path, VirtualClock()))
    results = results_of(reduce_run(run), analysis_of("switching-time").results)
    repeated = [one for one in results if one.mean.n > 1]
    assert repeated
    for one in repeated:
        assert one.mean.expanded >= 2.0 * one.mean.sd / math.sqrt(one.mean.n)


@pytest.mark.parametrize(
    ("mean", "sd", "n", "expanded", "shown"),
    [
        (1234.56, 7.89, 4, 12.6, ("1235", "7.9", "13")),
        (1234.56, 45.6, 4, 123.0, ("1230", "46", "120")),
        (1.23456, 0.05, 4, 0.0996, ("1.23", "0.050", "0.10")),
        (-3.202, math.nan, 1, math.nan, ("−3.202", "–", "–")),
        (1234.56, 0.0321, 3, math.nan, ("1235", "0.032", "–")),
        (0.0, 0.0, 3, math.nan, ("0.000", "0.000", "–")),
    ],
)
def test_results_have_two_digits_of_their_uncertainty_and_four_without(
    mean: float, sd: float, n: int, expanded: float, shown: tuple[str, str, str]
) -> None:
    text = rounded(RepeatMean(mean, sd, n, expanded / 2.0, 3.0, 2.0, expanded))
    assert (text["mean"], text["sd"], text["expanded"]) == shown


def test_words_on_page_one_wrap_and_dates_do_not(page: str) -> None:
    assert ".page-one td.text:not(.whole) { white-space: normal; }" in page
    instruments = page.partition("<h2>Instruments</h2>")[2].partition("</table>")[0]
    dates = re.findall(r'<td class="([^"]*)">(?:\d{4}-\d\d-\d\d|no date stated)</td>', instruments)
    assert dates
    assert set(dates) == {"text whole"}


def test_single_values_of_a_source_have_the_decimals_that_it_printed(tmp_path: Path) -> None:
    """37.100 N stands under 6.507 N, and 58.00 mm under 51.45 mm."""
    text = render_report(open_run(import_thesis("c01", tmp_path, VirtualClock())))
    for part in text.split("<tbody>")[2:4]:  # on page one, and all under Details
        rows = re.findall(r"<tr>(.*?)</tr>", part.partition("</tbody>")[0])
        cells = [re.findall(r"<td[^>]*>([^<]*)</td>", row) for row in rows]
        assert len(cells) >= 5
        for column, decimals in ((0, 2), (2, 3)):
            assert {len(row[column].partition(".")[2]) for row in cells} == {decimals}


def test_settings_have_four_digits_unless_they_would_become_equal() -> None:
    mean = RepeatMean(1.0, math.nan, 1, 0.05, 3.0, 2.0, 0.1)
    for masses, shown in (
        ((0.509858, 1.019716), ["0.5099", "1.0197"]),
        ((1.00001, 1.00002), ["1.00001", "1.00002"]),
    ):
        results = [Result("length_mm", (("mass_kg", one),), mean, 1) for one in masses]
        assert [row["settings"][0] for row in result_table(results)["rows"]] == shown


def test_facts_wrap_on_a_narrow_screen(page: str) -> None:
    """A long name of a run or of a rig does not make the page wider than a telephone."""
    facts = page.partition('<table class="facts">')[2].partition("</table>")[0]
    assert set(re.findall(r'<td class="(\w+)', facts)) == {"text"}
    assert "table.facts td.text { overflow-wrap: anywhere; min-width: 0; }" in page


def test_a_long_name_of_a_certificate_wraps_and_a_short_one_does_not(page: str) -> None:
    found = re.findall(r'<td class="text( whole)?">(P-[^<]*|F-[^<]*|L-[^<]*)</td>', page)
    assert found
    for whole, name in found:
        assert bool(whole) == (len(name) < 15)
