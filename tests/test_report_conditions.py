"""What a report states beside its results: specimen hung, bench tight, simulated or not."""

from __future__ import annotations

import dataclasses
import re
from html.parser import HTMLParser
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest

from analysis.figures.drawing import STYLE
from analysis.figures.wording import fixed, value_cell, with_u
from analysis.findings.isotonic import curves_of, isotonic_findings
from analysis.formats.importer import import_thesis
from analysis.reporting.conditions import force_device, simulated
from analysis.reporting.report import report_json, write_report
from analysis.run_table import reduce_run
from analysis_bench import write_run
from daq.calibration import Calibration
from daq.clock import VirtualClock
from daq.errors import ConfigError
from daq.store.run import Run, open_run
from protocol_runs import run_short
from rigs.protocols.registry import procedure
from rigs.rigfile.config import load_rig
from rigs.rigfile.toml_reader import find_config

WEIGHTS = ((0.714, 7.0), (1.154, 11.3))


class Text(HTMLParser):
    """The text of a page, and apart from it what is folded up."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.parts: dict[bool, list[str]] = {True: [], False: []}
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in ("meta", "img", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        self.open.pop()

    def handle_data(self, data: str) -> None:
        if "style" not in self.open:
            folded = "details" in self.open and "summary" not in self.open
            self.parts[folded].append(f" {data}")

    def text(self, folded: bool = False) -> str:
        return re.sub(r"\s+", " ", "".join(self.parts[folded]))


@pytest.fixture(scope="module")
def hung(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """An isotonic test with two weights that the load cell sees, and two mountings."""
    root = tmp_path_factory.mktemp("runs")
    text = load_rig("virtual-weights").text.replace('[operator]\nport = "terminal"', "", 1)
    path = root / "weights.toml"
    path.write_text(re.sub(r"\[operator\][^\[]*", "", text), "utf-8")
    config = load_rig(str(path))
    kind = procedure("isotonic")
    plan = kind.read("isotonic-weights", config)
    method = dataclasses.replace(plan.method, mountings=("m1", "m2"))
    _, run, _ = run_short(
        "isotonic", root, config=config, masses_kg=plan.masses_kg,
        method={"mountings": method.mountings, "leak": plan.method.leak},
        pressures_kpa=(200.0,),
    )  # fmt: skip
    assert run.outcome == "clean"
    return run


@pytest.fixture(scope="module")
def page(hung: Run, tmp_path_factory: pytest.TempPathFactory) -> Text:
    out = tmp_path_factory.mktemp("page") / "report.html"
    return Text(write_report(hung, out).read_text("utf-8"))


def test_the_report_holds_weights_as_hung_and_as_seen(hung: Run, page: Text) -> None:
    weights = report_json(hung)["steps_by_hand"]["weights"]
    assert [row["mass_kg"] for row in weights if row["mass_kg"]] == [0.714, 1.154] * 2
    for row in (row for row in weights if row["mass_kg"]):
        assert f"{row['checked_kg']:.3f}" in page.text()
    assert "load cell" in page.text()


def test_the_report_holds_the_leak_rate_and_the_mountings(hung: Run, page: Text) -> None:
    (leak,) = report_json(hung)["steps_by_hand"]["leak_checks"]
    assert f"{abs(leak['loss_kpa_s']):.3f} kPa/s" in page.text()
    assert "mounted again: m2 at" in page.text()


def test_all_loads_have_one_unit(hung: Run) -> None:
    loads = [row["load"] for row in isotonic_findings(hung, reduce_run(hung)).data["loads"]]
    assert loads == ["0.714 kg", "1.154 kg"]


@pytest.mark.parametrize(
    ("masses", "names"),
    [((0.5099, 1.0197), ["5 N", "10 N"]), ((0.5099, 1.154), ["0.5099 kg", "1.154 kg"])],
)
def test_newtons_are_told_where_every_load_is_a_whole_number_of_them(
    hung: Run, masses: tuple[float, ...], names: list[str]
) -> None:
    table = reduce_run(hung).table.iloc[:2].assign(mass_kg=masses)
    table["force_n"] = table["mass_kg"] * 9.80665
    assert [curve.name for curve in curves_of(table)] == names


def test_a_clean_run_on_the_virtual_bench_has_no_warning(hung: Run) -> None:
    assert reduce_run(hung).notes == ()


@pytest.mark.parametrize("protocol", ["isometric", "isobaric", "isotonic", "hysteresis"])
def test_a_default_template_stays_within_the_calibrations_of_the_default_rig(protocol: str) -> None:
    """Isotonic: the camera measures wherever the load stretches the muscle to, 73.5 mm."""
    rig = load_rig("virtual")
    plan = procedure(protocol).read(protocol, rig).as_dict()
    lengths = [*(plan.get("lengths_mm") or []), 73.5 if protocol == "isotonic" else 60.0]
    assert not rig.calibrations["length_mm"].outside(lengths).any()
    assert not rig.calibrations["pressure_kpa"].outside(plan.get("pressures_kpa") or [0.0]).any()


def test_a_calibration_just_made_does_not_warn_of_an_unloaded_sensor() -> None:
    made = Calibration("force_n", "N", "g", 0.0, 0.00980665, 0.01, 0.0003, (0.0, 49.0))
    assert not made.outside(-0.0596)
    assert made.outside(-0.5)
    assert made.outside(49.5)


def test_a_simulated_run_is_marked(hung: Run, page: Text, tmp_path: Path) -> None:
    assert "SIMULATED: a test on the virtual bench" in page.text()
    real = write_run(
        tmp_path, np.random.default_rng(1), devices={"valve": {"serial": "V", "board": "pico"}}
    )
    assert simulated(open_run(real.folder)) == ""
    served = write_run(
        tmp_path, np.random.default_rng(1), devices={"valve": {"serial": "V", "board": "sim"}}
    )
    assert simulated(open_run(served.folder)), "the board of `pamrig virtual` tells it"


def test_the_header_names_instruments_that_were_used_and_no_boot_numbers(page: Text) -> None:
    header = page.text().partition("Length against pressure")[0]
    assert "VB-0007" in header
    assert "boot" not in header
    assert "conf " not in header
    assert "Stage" not in header, "the length is measured, not set"
    assert "boot" in page.text(folded=True), "it stands under Provenance"


def test_long_tables_are_folded_up_so_that_a_default_test_prints_on_few_pages(page: Text) -> None:
    assert "All settled points: " in page.text()
    assert page.text(folded=True).count(" m2 ") + page.text(folded=True).count("M1.154") >= 2
    assert "record_sha256" in page.text(folded=True)


def test_figures_of_the_thesis_are_named_only_where_its_table_was_imported(
    page: Text, tmp_path: Path
) -> None:
    assert not re.search(r"(Figure|Equation|Table) [\dCD]+-\d+", page.text())
    imported = open_run(import_thesis("c03", tmp_path, VirtualClock()))
    thesis = Text(write_report(imported, tmp_path / "c03.html").read_text("utf-8"))
    assert "(as in Figure 4-13 of the thesis)" in thesis.text()


def test_contraction_is_relative_to_the_rest_length_where_the_protocol_states_it(
    hung: Run, tmp_path: Path
) -> None:
    reduction = reduce_run(hung)
    plain = isotonic_findings(hung, reduction)
    assert plain.headline.endswith("% of its longest settled length.")
    hung.manifest["parameters"]["rest_length_mm"] = 72.0
    try:
        stated = isotonic_findings(hung, reduction)
    finally:
        del hung.manifest["parameters"]["rest_length_mm"]
    assert stated.headline.endswith("% of L0 = 72 mm.")
    for row in stated.data["loads"]:
        assert row["contraction"] == pytest.approx(1 - row["shortest"] / 72.0)
        u_shortest = row["u_shortest"] / 72.0
        assert row["u_contraction"] == pytest.approx(u_shortest, rel=0.05)


def test_the_rest_length_is_a_key_of_the_isotonic_protocol(tmp_path: Path) -> None:
    text, _ = find_config("isotonic-weights", "protocols")
    path = tmp_path / "test.toml"
    path.write_text("rest_length_mm = 72.0\n" + text, "utf-8")
    plan = procedure("isotonic").read(str(path), load_rig("virtual"))
    assert plan.as_dict()["rest_length_mm"] == 72.0
    path.write_text("rest_length_mm = -1\n" + text, "utf-8")
    with pytest.raises(ConfigError, match="rest_length_mm"):
        procedure("isotonic").read(str(path), load_rig("virtual"))


def test_zero_has_no_sign() -> None:
    assert with_u(-0.0001, 0.1) == "0.00 ± 0.20"
    assert fixed(-0.001, 2) == "0.00"
    assert fixed(-0.01, 2) == "−0.01"
    assert value_cell(-0.0) == "0"


def test_an_axis_states_its_values_in_full() -> None:
    from analysis.figures.drawing import new_figure

    with mpl.rc_context(STYLE):
        figure, axes = new_figure(4, 3)
        axes.plot([0, 1], [100.10, 100.13])
        figure.canvas.draw()
    assert axes.yaxis.get_offset_text().get_text() == ""
    assert any(label.get_text().startswith("100.1") for label in axes.get_yticklabels())


def test_page_one_names_the_instruments_that_gave_results_and_no_others(tmp_path: Path) -> None:
    """The load cell beside a balance, hygrometer and transmitter are recorded and not used."""
    _, run, _ = run_short("isothermal", tmp_path)
    page = write_report(run).read_text("utf-8")
    table = page.partition("<h2>Instruments</h2>")[2].partition("</table>")[0]
    rows = re.findall(r"<tr><td[^>]*>(.*?)</td><td[^>]*>.*?</td><td[^>]*>(.*?)</td>", table)
    assert rows == [
        ("Valve", "pressure"), ("Balance", "force"), ("Thermometer", "temperature"),
        ("Stage", "(sets the length)"), ("Camera", "length"),
    ]  # fmt: skip
    assert "0.2 °C" in table
    facts = page.partition('<table class="facts">')[2].partition("</table>")[0]
    assert "21.0 ±" not in facts, "a test sets its temperatures itself"
    assert "devices.hygrometer" in page, "all are under Provenance"


def test_the_force_is_that_of_the_sensor_that_the_rig_file_names(hung: Run) -> None:
    assert force_device(hung) == "load_cell"
