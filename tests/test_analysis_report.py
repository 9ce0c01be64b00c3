"""The report stands alone, says how the run ended, and cannot be made to run anything."""

from __future__ import annotations

import base64
import json
import math
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from analysis.figures.drawing import spread
from analysis.figures.timeline import min_max
from analysis.figures.wording import significant, with_u
from analysis.findings.hysteresis import hysteresis_findings
from analysis.findings.isobaric import isobaric_findings
from analysis.findings.isometric import isometric_findings
from analysis.findings.isotonic import isotonic_findings
from analysis.formats.importer import import_points, import_thesis
from analysis.reduction.columns import points_frame
from analysis.reduction.points import Reduction, reduce_isometric
from analysis.reporting.report import report_json, write_report
from analysis.reporting.sections import section_parts
from analysis_bench import CALIBRATIONS, write_run
from daq.clock import VirtualClock
from daq.store.run import open_run

EVIL = '<script>alert("x")</script><img src=x onerror=alert(1)>&{{ 7 * 7 }}'
VOID = {"meta", "img", "br", "link", "input", "hr"}


class Page(HTMLParser):
    """Collects what a browser would fetch, run or show, and checks that tags are closed."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.addresses: list[str] = []
        self.handlers: list[str] = []
        self.shown: list[str] = []
        self.open: list[str] = []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        if tag not in VOID:
            self.open.append(tag)
        for name, value in attrs:
            if name in ("src", "href", "srcset", "data", "action", "poster"):
                self.addresses.append(value or "")
            if name.startswith("on"):
                self.handlers.append(name)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag
        if tag in ("td", "th", "dt", "dd", "tr"):
            self.shown.append(" ")

    def handle_data(self, data: str) -> None:
        if not self.open or self.open[-1] != "style":
            self.shown.append(data)

    @property
    def text(self) -> str:
        return re.sub(r"\s+", " ", "".join(self.shown))


def page_of(folder: Path, **options: Any) -> tuple[Page, str]:
    text = write_report(open_run(folder), **options).read_text(encoding="utf-8")
    return Page(text), text


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_run(
        tmp_path_factory.mktemp("runs"),
        np.random.default_rng(4),
        lengths_mm=(55.0, 58.0, 61.0, 64.0),
        rig={"name": "virtual", "description": "simulated", "crc32": "0badcafe", "text": "x"},
        devices={"valve": {"serial": "VB-0001", "fw": "1.2.3"}},
        software={"pamrig": "0.1.0", "git": {"revision": "abc123", "dirty": True}},
    ).folder


@pytest.fixture(scope="module")
def thesis(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return import_thesis("c01", tmp_path_factory.mktemp("runs"), VirtualClock())


def test_a_report_needs_nothing_from_outside(recorded: Path, thesis: Path) -> None:
    for folder in (recorded, thesis):
        page, text = page_of(folder)
        assert page.addresses, "the figures are in it"
        assert all(address.startswith("data:image/svg+xml;base64,") for address in page.addresses)
        assert not {"script", "link", "iframe", "object", "embed", "base"} & set(page.tags)
        assert "http://" not in text
        assert "https://" not in text
        assert "url(" not in text
        assert "@import" not in text


def test_pictures_inside_the_report_need_nothing_either(recorded: Path) -> None:
    page, _ = page_of(recorded)
    for address in page.addresses:
        svg = base64.b64decode(address.split(",", 1)[1]).decode()
        assert svg.lstrip().startswith("<?xml")
        references = re.findall(r'(?:xlink:)?href="([^"]*)"', svg)
        assert all(ref.startswith(("#", "data:")) for ref in references)
        assert "<script" not in svg


def test_the_report_says_what_was_tested_by_whom_on_what_and_how_it_ended(recorded: Path) -> None:
    text = page_of(recorded)[0].text
    for words in (
        "synthetic",
        "nobody",
        "VB-0001",
        "fw 1.2.3",
        "0badcafe",
        "abc123",
        "P-1",
        "The test ran to its end",
        "No fault was reported",
        "error_ns 1000",
        "k = 2",
        "record_sha256",
    ):
        assert words in text, words


def test_the_thesis_report_explains_the_51_mm_reading_with_its_numbers(thesis: Path) -> None:
    text = page_of(thesis)[0].text
    assert "14 of 14 gradient and intercept pairs of Table C-9" in text
    for words in ("0.0087, -0.426", "0.0086, -0.419", "57.21", "58.71", "Only 51.45 mm gives"):
        assert words in text, words


@pytest.mark.parametrize("outcome", ["stopped", "aborted", "faulted", None])
def test_runs_that_did_not_end_well_say_so_first(tmp_path: Path, outcome: str | None) -> None:
    rng = np.random.default_rng(1)
    truth = write_run(tmp_path, rng, (60.0,), (200.0, 400.0), ("up",), finish=outcome)
    page, _ = page_of(truth.folder)
    assert (outcome or "interrupted") in page.text[:400]
    assert f"the run is {outcome or 'interrupted'}" in page.text


def test_a_run_without_points_still_has_a_report(tmp_path: Path) -> None:
    truth = write_run(tmp_path, np.random.default_rng(1), (), (), finish="stopped")
    page, _ = page_of(truth.folder)
    assert "No settled point was reached" in page.text


def test_a_run_with_fewer_than_three_lengths_has_lines_but_no_law(tmp_path: Path) -> None:
    truth = write_run(tmp_path, np.random.default_rng(1), (60.0,), (200.0, 400.0, 600.0), ("up",))
    data = report_json(open_run(truth.folder))
    assert len(data["lengths"]) == 1
    assert data["laws"] == []
    assert re.search(r" \d\.\d+ ± \d\.\d+ N/kPa at a length of 60\.0", data["headline"])


def test_no_more_is_claimed_than_the_pressures_that_were_measured(tmp_path: Path) -> None:
    """The region goes to 600 kPa, the test did not."""
    truth = write_run(tmp_path, np.random.default_rng(1), (60.0,), (100.0, 200.0, 300.0), ("up",))
    page, _ = page_of(truth.folder)
    assert "Between 200 and 300 kPa the force rises by" in page.text
    assert "Straight lines at each length, 200 to 300 kPa" in page.text


def test_a_calibrations_domain_has_its_unit(recorded: Path) -> None:
    text = page_of(recorded)[0].text
    assert "−5 to 1000 kPa" in text
    assert "50 to 73 mm" in text


def test_one_held_pressure_is_told_as_one(tmp_path: Path) -> None:
    truth = write_run(
        tmp_path, np.random.default_rng(1), pressures_kpa=(200.0,), protocol="isobaric"
    )
    headline = report_json(open_run(truth.folder))["headline"]
    text = r"At a constant pressure of 200 kPa the force rises by \d\.\d+ ± \d\.\d+ N per mm .*"
    assert re.fullmatch(text, headline)
    several = write_run(tmp_path, np.random.default_rng(1), protocol="isobaric").folder
    headline = report_json(open_run(several))["headline"]
    assert headline.startswith("At constant pressures between 200 and 600 kPa the force rises by")
    assert headline.endswith(" N/mm, P in kPa.")


def test_lines_in_length_hold_what_the_calibrations_leave_open(tmp_path: Path) -> None:
    """Zero and gain are common to all points: no scatter about the line tells of them."""
    truth = write_run(tmp_path, np.random.default_rng(1), pressures_kpa=(200.0,))
    run = open_run(truth.folder)
    reduction = reduce_isometric(run)
    camera = replace(CALIBRATIONS["length_mm"], u_gain=0.03, u_offset=0.5)
    doubtful = replace(reduction, calibrations={**reduction.calibrations, "length_mm": camera})
    section = isobaric_findings(run, doubtful).sections[1]
    assert section.table is not None
    (line,) = section.table.to_dict("records")
    assert line["u_gradient"] > 0.03 * line["gradient"]
    assert line["u_intercept"] > 0.5 * line["gradient"]


def hung(lengths_mm: dict[float, tuple[float, float]], **camera: float) -> Reduction:
    """Loads by mass in kg, each with its lengths at 100 and 400 kPa."""
    points = [
        {
            "direction": "up", "repeat": 1, "trial": 1, "slot": f"W{kg:g}", "mounting": "m1",
            "settled": True, "n_samples": 10, "mass_kg": kg, "force_n": 9.80665 * kg, "order": k,
            "pressure_kpa": kpa, "set_pressure_kpa": kpa, "length_mm": mm,
            "u_length_mm_noise": 0.001,
        }
        for k, (kg, kpa, mm) in enumerate(
            (kg, kpa, mm)
            for kg, pair in lengths_mm.items()
            for kpa, mm in zip((100.0, 400.0), pair, strict=True)
        )
    ]  # fmt: skip
    calibration = replace(CALIBRATIONS["length_mm"], **camera)
    return Reduction(points_frame(points, {"mass_kg": "float64"}), (), {"length_mm": calibration})


def test_a_contraction_holds_what_the_camera_leaves_open(recorded: Path) -> None:
    """1 - 50/60 with a zero known to 0.6 mm: both lengths move together, and so does the share."""
    reduction = hung({1.0: (60.0, 50.0)}, u_offset=0.6, u_gain=0.0)
    (load,) = isotonic_findings(open_run(recorded), reduction).data["loads"]
    assert load["contraction"] == pytest.approx(1 / 6)
    assert load["u_contraction"] == pytest.approx(0.6 / 60 / 6, rel=0.03)


@pytest.mark.parametrize(
    ("lengths_mm", "headline", "blind"),
    [
        ({1.0: (60.0, 50.0), 2.0: (math.nan, math.nan)}, "Under 1 kg the muscle", "2 kg"),
        ({1.0: (math.nan, math.nan)}, "No length was measured", "1 kg"),
    ],
)
def test_a_load_under_which_the_camera_saw_nothing_is_named(
    recorded: Path, lengths_mm: dict[float, tuple[float, float]], headline: str, blind: str
) -> None:
    found = isotonic_findings(open_run(recorded), hung(lengths_mm))
    assert found.headline.startswith(headline)
    assert f"No length was measured under {blind}." in found.sections[1].words
    for section in found.sections:
        section_parts(section)


def test_a_curve_without_a_force_has_no_name_at_its_end(recorded: Path) -> None:
    """The balance was beyond its range at the highest pressure of an isobaric test."""
    run = open_run(recorded)
    reduction = reduce_isometric(run)
    table = reduction.table.copy()
    table.loc[table["set_pressure_kpa"] == 600.0, "force_n"] = np.nan
    for section in isobaric_findings(run, replace(reduction, table=table)).sections:
        section_parts(section)


def loop(way_up: tuple[float, ...], way_down: tuple[float, ...]) -> Reduction:
    """A cycle at 60 mm without friction, read to 0.005 N."""
    points = [
        {
            "direction": way, "repeat": 1, "trial": 1, "slot": "L60", "mounting": "m1",
            "settled": True, "n_samples": 10, "set_length_mm": 60.0, "cycle_max_kpa": 600.0,
            "pressure_kpa": kpa, "set_pressure_kpa": kpa, "order": order,
            "force_n": kpa / 10 + (way == "down") * 1e-4, "u_force_n_noise": 0.005,
        }
        for order, (kpa, way) in enumerate(
            [(kpa, "up") for kpa in way_up] + [(kpa, "down") for kpa in way_down]
        )
    ]  # fmt: skip
    return Reduction(points_frame(points, {"cycle_max_kpa": "float64"}), (), {})


def test_a_loop_within_its_uncertainty_is_told_as_none(recorded: Path) -> None:
    up = (0.0, 200.0, 400.0, 600.0)
    found = hysteresis_findings(open_run(recorded), loop(up, up[::-1]))
    assert found.headline == (
        "At rising and at falling pressure the force is the same within its uncertainty: the means"
        " of each cycle differ by less than 0.01 N."
    )
    cells = [c["text"] for row in section_parts(found.sections[1])["rows"] for c in row["cells"]]
    assert "−0" not in cells


@pytest.mark.parametrize(
    "ways", [((), ()), ((0.0,), ()), ((0.0, 200.0, 400.0), ()), ((), (400.0, 200.0))]
)
def test_a_cycle_of_which_one_way_is_missing_has_a_report(
    recorded: Path, ways: tuple[tuple[float, ...], tuple[float, ...]]
) -> None:
    """Stopped on its way up, or every point of the way up excluded."""
    found = hysteresis_findings(open_run(recorded), loop(*ways))
    assert "so there is no result" in found.headline
    assert bool(section_parts(found.sections[0])["image"]) == any(ways)


def test_texts_of_the_operator_are_shown_and_never_run(tmp_path: Path) -> None:
    truth = write_run(
        tmp_path,
        np.random.default_rng(1),
        (60.0,),
        (200.0, 400.0),
        ("up",),
        operator=EVIL,
        note=EVIL,
        rig={"name": EVIL, "description": EVIL},
        devices={EVIL: {EVIL: EVIL}},
    )
    page, text = page_of(truth.folder)
    assert page.handlers == []
    assert page.tags.count("script") == 0
    assert EVIL in page.text, "escaped, so that it is shown as it was typed"
    assert "<script>alert" not in text


def test_texts_of_an_imported_file_are_shown_and_never_run(tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.write_text(
        "pressure_kpa,length_mm,force_n,slot,mounting,<b>odd</b>\n"
        "200,60,5,<script>alert(1)</script>,m,1\n400,60,16,<script>alert(1)</script>,m,1\n"
    )
    page, text = page_of(import_points(path, tmp_path / "runs", VirtualClock()))
    assert page.tags.count("script") == page.tags.count("b") == 0
    assert "<script>" in page.text
    assert "columns not used: <b>odd</b>" in page.text
    assert "<script>" not in text


def test_json_holds_no_nan_and_the_same_points(recorded: Path, thesis: Path) -> None:
    for folder in (recorded, thesis):
        run = open_run(folder)
        data = json.loads(json.dumps(report_json(run), allow_nan=False))
        table = reduce_isometric(run).table
        assert [point["force_n"] for point in data["points"]] == list(table["force_n"])
    assert data["thesis"]["matching"] == 14
    assert data["points"][0]["u_force_n_cal"] is None


def test_a_chosen_region_is_used_and_named(thesis: Path) -> None:
    run = open_run(thesis)
    found = isometric_findings(run, reduce_isometric(run), region_kpa=(0.0, 125.0))
    data = report_json(run, findings=found)
    assert {line["n"] for line in data["lengths"]} == {5}
    assert data["thesis"] is None
    assert "0 and 125 kPa" in data["headline"]


def test_the_same_run_gives_the_same_report_to_the_byte(recorded: Path, tmp_path: Path) -> None:
    first = page_of(recorded, out=tmp_path / "a.html")[1]
    assert first == page_of(recorded, out=tmp_path / "b.html")[1]


def test_a_touched_record_has_another_hash(tmp_path: Path) -> None:
    truth = write_run(tmp_path, np.random.default_rng(1), (60.0,), (200.0, 400.0), ("up",))
    before = report_json(open_run(truth.folder))["provenance"]["record_sha256"]
    write_report(open_run(truth.folder))
    run = open_run(truth.folder)
    assert report_json(run)["provenance"]["record_sha256"] == before, "derived files do not count"
    events = truth.folder / "events.jsonl"
    events.write_bytes(events.read_bytes() + b"\n")
    assert report_json(open_run(truth.folder))["provenance"]["record_sha256"] != before


def test_labels_at_the_curves_ends_never_overlap_and_keep_their_order() -> None:
    wanted = [1.0, 1.1, 1.15, 5.0, 5.05, 9.0]
    places = spread(wanted, gap=0.5)
    assert np.diff(places).min() >= 0.5 - 1e-12
    assert places[-1] == 9.0
    assert np.mean(places[:3]) == pytest.approx(np.mean(wanted[:3]))


def test_decimation_keeps_every_peak() -> None:
    values = np.zeros(100_000)
    values[54_321], values[77_777] = 9.0, -4.0
    x, y = min_max(np.arange(100_000.0), values)
    assert len(x) == len(y) < 3000
    assert (y.max(), y.min()) == (9.0, -4.0)


def test_a_value_is_cut_where_its_uncertainty_says() -> None:
    assert with_u(41.4236, 0.0266) == "41.424 ± 0.053"
    assert with_u(-7.4335, 0.27) == "−7.43 ± 0.54"
    assert with_u(412.3, 6.0) == "412 ± 12"
    assert with_u(None, 1.0) == "–"


def test_uncertainty_and_value_have_two_significant_digits_of_the_uncertainty() -> None:
    assert with_u(41_234.5, 61.7) == "41230 ± 120"
    assert with_u(-41_234.5, 617.0) == "−41200 ± 1200"
    assert with_u(3.14159, 0.0498) == "3.14 ± 0.10", "0.0996 is rounded up to 0.10"
    assert with_u(3.14159, 4.98) == "3 ± 10"


def test_a_value_without_an_uncertainty_has_at_most_four_digits() -> None:
    assert with_u(0.123456, None) == "0.1235"
    assert with_u(-103.2468, None) == "−103.2"
    assert with_u(51.45, math.nan) == "51.45"
    assert with_u(12_345.0, None) == "12345", "a number of cycles stays whole"
    assert with_u(0.0, None) == "0"
    assert significant(123_456.7) == "123500"
    assert significant(math.nan) == "–"
