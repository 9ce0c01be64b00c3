"""One report over several runs: what is compared, from which numbers, and what is refused."""

from __future__ import annotations

import json
import re
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from analysis.figures.comparison import chart_figure
from analysis.reporting.figure_files import comparison_figures
from analysis.reporting.several import compare_runs, comparison_json, render_comparison
from analysis.run_table import reduce_run
from analysis.statistics.control_chart import control_chart
from analysis_bench import write_run
from cli.main import app
from daq.errors import ConfigError
from daq.store.run import Run, open_run
from docs.make.commands import json_fields

AT = {"set_pressure_kpa": 400.0}


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Two specimens, two runs each, two points at each of two pressures."""
    root, rng = tmp_path_factory.mktemp("runs"), np.random.default_rng(7)
    return [
        write_run(root, rng, (60.0,), (200.0, 400.0), ("up", "up"), window=60, specimen=name).folder
        for name in ("one", "one", "two", "two")
    ]


@pytest.fixture(scope="module")
def runs(folders: list[Path]) -> list[Run]:
    return [open_run(folder) for folder in folders]


def pamrig(*given: Any) -> Any:
    return CliRunner().invoke(app, [str(one) for one in given])


def test_standard_deviations_are_those_of_the_points(runs: list[Run]) -> None:
    """Balanced, so by hand: 2 specimens of 2 runs of 2 points."""
    (one,) = compare_runs(runs, at=AT).compared
    x = np.array(
        [(t := reduce_run(run).table)[t["set_pressure_kpa"] == 400.0]["force_n"] for run in runs]
    ).reshape(2, 2, 2)
    ms_repeat = x.var(axis=2, ddof=1).mean()
    ms_mounting = 2 * x.mean(axis=2).var(axis=1, ddof=1).mean()
    ms_specimen = 4 * x.mean(axis=(1, 2)).var(ddof=1)
    found = one.components
    assert found.repeatability.sd == pytest.approx(np.sqrt(ms_repeat))
    assert found.mounting.sd == pytest.approx(np.sqrt(max(0.0, (ms_mounting - ms_repeat) / 2)))
    assert found.specimen.sd == pytest.approx(np.sqrt(max(0.0, (ms_specimen - ms_mounting) / 4)))
    assert [found.repeatability.dof, found.mounting.dof, found.specimen.dof] == [4, 2, 1]
    assert "only 1 degree of freedom" in found.specimen.remark


def test_the_chart_is_of_the_means_in_order_of_time(runs: list[Run]) -> None:
    (one,) = compare_runs(runs[::-1], at=AT, base=3).compared
    assert one.chart is not None
    assert list(one.chart.values) == [r.mean.mean for r in one.results]
    assert one.chart.base == 3
    assert "first 3" in one.chart.remark
    (stated,) = compare_runs(runs, at=AT, stated=(20.0, 0.1)).compared
    assert stated.chart is not None
    assert (stated.chart.lower, stated.chart.upper) == pytest.approx((19.7, 20.3))
    pair = compare_runs(runs[:2], at=AT)
    assert pair.compared[0].chart is None
    assert "needs three runs" in render_comparison(pair)


def test_the_page_says_what_it_rests_on(runs: list[Run]) -> None:
    html = render_comparison(compare_runs(runs))
    text = re.sub(r"\s+", " ", unescape(re.sub(r"<[^>]+>", " ", html)))
    for part in (
        "Isometric test: 4 runs compared", "repeatability", "between mountings",
        "between specimens", "Each run counts as a mounting of its own", "ISO 5725-2", "ISO 7870-2",
        "provisional: fewer than 20", "six values in a row", "Compiled by",
    ):  # fmt: skip
        assert part in text, part
    assert "SIMULATED" not in text
    for run in runs:
        assert str(run.run_id) in text
    assert not re.search(r'(?:src|href)="(?!data:)', html)
    assert "<script" not in html


def test_json_and_files_by_one_command(folders: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "c.html"
    done = pamrig("report", *folders, "--json", "--out", out, "--at", "set_pressure_kpa=400")
    assert done.exit_code == 0, done.output
    data = json.loads(done.stdout)
    assert data == comparison_json(compare_runs([open_run(f) for f in folders], at=AT))
    assert set(data) == set(json_fields()["report of several runs"]) - {"commands"}
    (quantity,) = data["quantities"]
    assert [row["number"] for row in quantity["runs"]] == [1, 2, 3, 4]
    assert quantity["at"] == {"set_length_mm": 60.0, "set_pressure_kpa": 400.0, "direction": "up"}
    assert quantity["chart"]["sd"] > 0.0
    assert out.read_text("utf-8").startswith("<!DOCTYPE html>")


def test_runs_and_charts_are_figures(runs: list[Run]) -> None:
    made = comparison_figures(compare_runs(runs), "single")
    assert made[0][0] == "Runs over each other"
    assert len(made) == 3
    assert {round(25.4 * f.get_size_inches()[0]) for _, f in made} == {88}


def test_other_limits_and_calibrations_are_told(runs: list[Run], tmp_path: Path) -> None:
    other = write_run(
        tmp_path, np.random.default_rng(1), (60.0,), (200.0, 400.0), ("up",), window=60,
        finish="stopped", parameters={"repeats": 5},
    )  # fmt: skip
    notes = compare_runs([*runs[:1], open_run(other.folder)]).notes
    assert any("2 different methods" in note for note in notes)
    assert any("is stopped" in note for note in notes)


def refused(runs: list[Run], **options: Any) -> str:
    with pytest.raises(ConfigError) as error:
        compare_runs(runs, **options)
    return str(error.value)


def test_what_cannot_be_compared_is_refused(runs: list[Run], tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    short = {"window": 60, "directions": ("up",)}
    bars = open_run(
        write_run(tmp_path, rng, (60.0,), (200.0,), protocol="isobaric", **short).folder
    )
    far = open_run(write_run(tmp_path, rng, (65.0,), (500.0,), **short).folder)
    assert "different tests: isobaric, isometric" in refused([runs[0], bars])
    assert f"{runs[0].run_id} is given twice" in refused([runs[0], runs[0]])
    assert "no result at one setting is common" in refused([runs[0], far])
    assert "common to two of these runs and to --at" in refused(runs, at={"set_pressure_kpa": 1.0})
    assert "--base: 9 of 4 runs" in refused(runs, base=9)
    assert "is for one quantity, and 2 are common" in refused(runs, stated=(20.0, 0.1))


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (("--at", "set_pressure_kpa"), "'set_pressure_kpa' is not NAME=VALUE"),
        (("--chart-limits", "20"), "'20' is no centre and standard deviation"),
        (("--chart-limits", "20,-1"), "no centre and standard deviation above 0"),
    ],
)
def test_bad_options_are_one_line(folders: list[Path], options: tuple[str, ...], told: str) -> None:
    done = pamrig("report", *folders[:2], *options)
    assert isinstance(done.exception, ConfigError)
    assert told in str(done.exception)


def test_options_of_several_runs_need_several(folders: list[Path]) -> None:
    done = pamrig("report", folders[0], "--base", "3")
    assert "--base: is for a report over several runs" in str(done.exception)


@pytest.mark.parametrize("values", [[13.85] * 3, [13.85, 13.86, 13.84]])
def test_names_of_limits_do_not_overlap(values: list[float]) -> None:
    u = np.full(3, 0.5)  # bars that are much larger than the distance of the limits
    figure = chart_figure(control_chart(values), ["1", "2", "3"], u, "force (N)")
    figure.canvas.draw()
    for axes in figure.axes:
        boxes = [text.get_window_extent() for text in axes.texts]
        assert boxes
        for k, box in enumerate(boxes):
            assert not any(box.overlaps(other) for other in boxes[k + 1 :])
