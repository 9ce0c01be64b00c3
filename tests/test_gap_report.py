"""The letter: true to its verdict, whole in one file, and safe to show whatever the data hold."""

from __future__ import annotations

import dataclasses
import io
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pypdf import PdfReader
from typer.testing import CliRunner

from analysis.reporting.pdf import page_to_pdf
from cli.main import app
from daq.errors import PamrigError
from gap.data.from_runs import open_data
from gap.reason import Cause, reason
from gap.reporting.examination import Examination, examine
from gap.reporting.figures import course, maps, stages
from gap.reporting.report import render_report, report_figures
from gap.reporting.text import experiment_sentence, headline, parameter_text, rivals
from gap.verdict import (
    Contrast,
    Estimate,
    Experiment,
    Explanation,
    Gap,
    Rejection,
    Share,
    Status,
    Verdict,
    WhyNot,
)
from gap_sets import settled_set

PLAIN = Verdict(
    status=Status.NAMED,
    reason=reason(Cause.EXPLAINED, names="liner_threshold"),
    stage="muscle",
    effects=(
        Explanation(
            ("liner_threshold",),
            "dead_space",
            0.93,
            {"threshold_kpa": Estimate(104.1, 98.0, 110.3)},
        ),
    ),
    probability_none=0.01,
    probability_unknown=0.06,
    gap=Gap("N", 4.1, 4.0, 0.7, 0.6, "replicates", 0.98, 0.9, 1.05, "slot"),
    stages=(Share("muscle", 0.9, 0.8, 0.95), Share("valve", 0.1, 0.02, 0.2)),
    contrasts=(Contrast("low-high pressure", 12.3, True), Contrast("up-down", 0.4)),
    limits={"creep": 1.2},
    next_experiment=None,
    why_not={"creep": WhyNot(Rejection.SMALL_SHARE, 0.03),
             "wear": WhyNot(Rejection.WORSE_FIT, 40.0), "payload": WhyNot(Rejection.NO_CHANNEL)},
)  # fmt: skip


@pytest.fixture(scope="module")
def liner(tmp_path_factory: pytest.TempPathFactory) -> Examination:
    folder = tmp_path_factory.mktemp("sets") / "liner"
    settled_set(folder, {"liner_threshold": {"threshold_kpa": 60.0}})
    return examine(open_data(folder))


def with_verdict(examined: Examination, **changes: Any) -> Examination:
    return dataclasses.replace(examined, verdict=dataclasses.replace(PLAIN, **changes))


def test_the_letter_of_a_real_data_set_tells_the_verdict_and_its_reasons(
    liner: Examination,
) -> None:
    page = render_report(liner)
    assert "liner_threshold" in headline(liner.verdict)
    assert headline(liner.verdict).split(" (")[0] in page
    for part in ("What it could be", "Why not others", "What to do next", liner.digest):
        assert part in page
    # Stages, two maps, courses and ladder are drawn.
    assert liner.verdict.stages
    assert page.count("data:image/svg+xml;base64,") == 6
    labels = [rung.label for rung in liner.ladder]
    assert labels[:2] == ["as stated", "recalibrated"]
    assert liner.ladder[-1].rms < 0.5 * liner.ladder[1].rms


def test_it_stands_alone(liner: Examination) -> None:
    page = render_report(liner)
    assert not re.search(r'(?:src|href)="(?!data:)', page)
    assert "<script" not in page
    assert "@import" not in page


def test_what_came_from_data_is_escaped(liner: Examination) -> None:
    evil = '<script>alert("x")</script>'
    data = dataclasses.replace(liner.data, origin=evil, notes=(evil,))
    examined = dataclasses.replace(
        liner,
        data=data,
        verdict=dataclasses.replace(
            PLAIN, status="unknown", reason=reason(Cause.DEFECT, meaning=evil), effects=()
        ),
    )
    page = render_report(examined)
    assert evil not in page
    assert "&lt;script&gt;" in page


def test_the_verb_agrees_with_the_names() -> None:
    one, two = (reason(Cause.NO_REPLICATES, names=names) for names in ("leak", "leak and creep"))
    assert str(one).startswith("leak fits best")
    assert str(two).startswith("leak and creep together fit best")


@pytest.mark.parametrize(
    ("status", "told"),
    [
        ("data_unfit", "Mend the recording"),
        ("below_resolution", "at least three trials"),
        ("no_gap_above_floor", "Nothing that these data ask for"),
        ("unknown", "A gap whose cause is not known"),
    ],
)
def test_every_kind_of_verdict_has_its_letter(liner: Examination, status: str, told: str) -> None:
    examined = with_verdict(
        liner,
        status=status,
        effects=(),
        gap=None,
        reason=reason(Cause.DEFECT, meaning="because of this"),
    )
    page = render_report(dataclasses.replace(examined, field=None, ladder=()))
    assert told in page
    assert "Because of this." in page
    said = re.search(r'<p class="verdict">(.*?)</p>', page)
    assert said is not None
    assert "It is " not in said[1], "nothing was named"


def test_stages_contrasts_and_the_next_experiment_are_shown(liner: Examination) -> None:
    following = Experiment("triangle", {"rates_mm_s": [1, 10]}, 1.1, 4.9, 6, ("creep", "wear"))
    page = render_report(with_verdict(liner, next_experiment=following))
    assert "Where it lies" in page
    assert "beyond chance" in page
    assert "6 trials of triangle" in page
    assert "from 1.1 to 4.9" in page
    assert page.count("data:image/svg+xml;base64,") == 6


def test_the_sentence_has_value_unit_interval_and_what_it_closes() -> None:
    told = headline(PLAIN)
    assert "threshold 104 kPa (98 to 110)" in told
    assert "closes 98 % (90 to 100 %)" in told
    assert parameter_text("edge", Estimate("inlet_on")) == "edge inlet_on"
    assert parameter_text("percent", Estimate(2.0, 1.0, 3.0)) == "2 % (1 to 3)"
    assert parameter_text("percent_per_k", Estimate(0.5)) == "0.5 %/K"
    assert parameter_text("stiffness_n_mm", Estimate(0.5)) == "stiffness 0.5 N/mm"
    leaks = parameter_text("conductance_m3_s_pa", Estimate(2e-12))
    assert leaks == "conductance 2e-12 m3/(s Pa)"


def test_settings_are_said_with_their_units_and_what_is_told_apart_already_is_said_so() -> None:
    settings = {"schemes": ["burst"], "length_mm": 60.4, "pressures_kpa": [80.0, 150.0],
                "measure": {"seconds": 60.0}, "isobaric": None}  # fmt: skip
    told = experiment_sentence(Experiment("step", settings, 1.1, 4.9, 2, ("creep", "wear")))
    assert told.startswith(
        "2 trials of step (schemes burst, length 60.4 mm, pressures 80, 150 kPa, "
        "measure (seconds 60), without isobaric): the separation"
    )
    already = experiment_sentence(Experiment("step", {}, 9.0, 12.0, 2, ("creep", "wear")))
    assert already.startswith("These data tell them apart already")
    assert told.endswith("repeats do not help against that.")
    assert already.endswith("as far as the forms of the catalogue go).")
    nothing = experiment_sentence(Experiment("step", {}, 222.5, 222.5, 2, ("creep", "wear")))
    assert nothing.startswith(
        "No test of the library adds to the separation between creep and wear"
    )


def test_comparisons_of_which_none_stands_out_are_not_said_to_show_it(liner: Examination) -> None:
    quiet = with_verdict(liner, contrasts=(Contrast("up-down", 0.4),))
    assert "Comparisons that show it" not in render_report(quiet)
    assert "Comparisons that show it" in render_report(with_verdict(liner))


def test_a_share_that_is_certain_has_no_interval_of_no_width() -> None:
    whole = dataclasses.replace(PLAIN.gap, closed=1.0, closed_low=1.0)
    assert "closes 100 % of the gap" in headline(dataclasses.replace(PLAIN, gap=whole))


def test_rivals_come_nearest_first() -> None:
    assert [rival.id for rival in rivals(PLAIN)] == ["wear", "creep", "payload"]


def test_the_command_writes_the_page_and_says_the_sentence(tmp_path: Path) -> None:
    folder = settled_set(tmp_path / "set", {"pressure_zero": {"offset_kpa": 0.0}})
    out, figures = tmp_path / "letters" / "gap.html", tmp_path / "figures"
    given = ["gap", "report", str(folder), "--out", str(out), "--figures", str(figures)]
    done = CliRunner().invoke(app, given)
    assert done.exit_code == 0, done.output
    assert out.read_text().startswith("<!DOCTYPE html>")
    names = sorted(path.name for path in figures.iterdir())
    assert names[:2] == ["01-measured-and-predicted.pdf", "01-measured-and-predicted.svg"]
    assert len(done.output.splitlines()[0]) > 20


def test_where_nothing_was_found_there_is_no_after(liner: Examination) -> None:
    """The same map twice, once as "with what was found", would claim that something was."""
    field = liner.field
    assert field is not None
    both, one = maps(field), maps(dataclasses.replace(field, after=field.before))
    assert both is not None
    assert one is not None
    assert [len([a for a in f.axes if a.get_title()]) for f in (both, one)] == [2, 1]
    unnamed = with_verdict(liner, status=Status.UNKNOWN, effects=())
    page = render_report(
        dataclasses.replace(unnamed, field=dataclasses.replace(field, after=field.before))
    )
    assert "so there is one map" in page
    assert "The residual before and after" not in page


def test_no_figure_is_wider_than_two_columns(liner: Examination) -> None:
    widths = [25.4 * figure.get_size_inches()[0] for _, figure in report_figures(liner)]
    assert len(widths) == 6
    assert max(widths) <= 180.01


def test_the_pdf_begins_with_the_sentence(liner: Examination) -> None:
    try:
        made = page_to_pdf(render_report(liner))
    except PamrigError as error:
        pytest.skip(str(error))
    first = re.sub(r"\s+", " ", PdfReader(io.BytesIO(made)).pages[0].extract_text())
    assert headline(liner.verdict).split(" (")[0] in first
    assert "What to do next" in first, "sentence, traces and advice are on page one"


def test_a_trial_of_which_nothing_is_compared_has_no_place_in_the_course(
    liner: Examination,
) -> None:
    """An investigation's own data ended the report with a division by zero."""
    field = liner.field
    assert field is not None
    silent = dataclasses.replace(field, weight=np.where(field.order == 2.0, 0.0, field.weight))
    figure = course(silent)
    assert figure is not None
    shown = figure.axes[0].containers[0].lines[0].get_xdata()
    assert len(shown) == len(np.unique(field.order)) - 1


def test_no_legend_covers_a_bar_and_one_stage_does_not_fill_its_figure(liner: Examination) -> None:
    assert liner.field is not None
    figure = course(liner.field)
    assert figure is not None
    figure.canvas.draw()
    (axes,) = figure.axes
    legend = axes.get_legend()
    assert legend is not None
    assert legend.get_window_extent().y0 >= axes.get_window_extent().y1
    one = stages(PLAIN.stages[:1])
    assert one is not None
    assert one.axes[0].patches[0].get_height() < 0.6 * abs(np.diff(one.axes[0].get_ylim())[0])
