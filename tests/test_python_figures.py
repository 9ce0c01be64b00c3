"""Figures and tables for notebooks: into the user's axis, with labels, and nothing printed."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import pamrig
import pamrig.figures
from bench_runs import quick, run_isometric
from pamrig import figures
from rigs.rigfile.config import load_rig


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("runs")
    config = load_rig("virtual")
    plan = quick(config, lengths_mm=(57.0, 60.0), pressures_kpa=(100.0, 300.0), repeats=1)
    run_isometric(config, plan, root)
    return root


@pytest.fixture
def axis() -> Any:
    from matplotlib.figure import Figure

    return Figure().subplots()


def test_force_is_drawn_into_the_axis_that_was_given(
    folder: Path, axis: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    run = pamrig.open_run("last", folder)
    assert figures.force(run, axis) is axis
    assert (axis.get_xlabel(), axis.get_ylabel()) == ("pressure (kPa gauge)", "force (N)")
    assert [t.get_text() for t in axis.get_legend().get_texts()] == ["57", "60"]
    drawn = np.concatenate([line.get_ydata() for line in axis.lines])
    assert set(run.table["force_n"]) <= set(drawn)
    assert capsys.readouterr() == ("", "")


def test_without_an_axis_a_figure_is_made_and_none_is_kept_open(folder: Path) -> None:
    import matplotlib.pyplot as plt

    before = plt.get_fignums()
    axis = figures.pressure(pamrig.open_run("last", folder))
    assert axis.figure is not None
    assert {line.get_label() for line in axis.lines} == {"set-point", "measured"}
    assert plt.get_fignums() == before


def test_length_under_loads_and_residuals_of_a_model(axis: Any) -> None:
    table = pd.DataFrame(
        {"pressure_kpa": [100.0, 200.0] * 2, "length_mm": [60.0, 55.0, 62.0, 58.0],
         "mass_kg": [1.0, 1.0, 2.0, 2.0], "force_n": [10.0, 20.0, 11.0, 19.0]}
    )  # fmt: skip
    assert len(figures.length(table, axis).get_legend().get_texts()) == 2
    own = figures.residuals(table, lambda p, x: 0.1 * p + 0.0 * x)
    assert own.get_ylabel() == "measured − model (N)"
    points = np.concatenate([c.lines[0].get_ydata() for c in own.containers])
    assert sorted(points) == pytest.approx([-1.0, 0.0, 0.0, 1.0])


def test_a_table_without_forces_is_refused_with_what_it_has() -> None:
    with pytest.raises(ValueError, match="no values of force_n: it has pressure_kpa"):
        figures.force(pd.DataFrame({"pressure_kpa": [1.0]}))


def test_runs_is_a_table_to_filter(folder: Path, tmp_path: Path) -> None:
    table = pamrig.runs(folder)
    (name,) = table.query("protocol == 'isometric' and outcome == 'clean'").index
    assert pamrig.open_run(name, folder).run.run_id == name
    assert table.loc[name, "started"].tzinfo is not None
    empty = pamrig.runs(tmp_path / "nothing")
    assert list(empty.columns) == list(table.columns)
    assert not len(empty.query("outcome == 'clean'"))


def test_a_stream_as_xarray_has_units(folder: Path) -> None:
    pytest.importorskip("xarray")
    run = pamrig.open_run("last", folder)
    data = run.xarray()
    assert data["pressure_kpa"].dims == ("time_s",)
    assert data["pressure_kpa"].attrs["units"] == "kPa"
    assert data.attrs["run_id"] == run.run.run_id
    assert np.array_equal(data["pressure_kpa"].values, run.samples["pressure_kpa"])


def test_figures_need_no_import_of_their_own() -> None:
    """`import pamrig; pamrig.figures.force(...)` was an AttributeError in a fresh notebook."""
    code = "import pamrig; print(pamrig.figures.force.__name__); pamrig.nothing"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stdout == "force\n"
    assert done.stderr.endswith("AttributeError: module 'pamrig' has no attribute 'nothing'\n")


def test_xarray_that_is_not_installed_is_named_with_its_extra(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(ModuleNotFoundError, match=r"pip install 'pamrig\[xarray\]'"):
        pamrig.open_run("last", folder).xarray()
