"""`pamrig fit` and `pamrig models`: text, JSON, files, figures, and errors in one line."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from analysis.models.points import load_points
from analysis.models.text import fit_text, to_interval
from cli.main import app
from daq.errors import PamrigError
from plant.fitting.fit import fit
from plant.models import catalogue

runner = CliRunner()


def call(*words: str) -> str:
    result = runner.invoke(app, list(words), catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.stdout


def test_fit_prints_values_with_intervals() -> None:
    text = call("fit", "c01", "--model", "chou-hannaford")
    assert "braid_length" in text
    assert "88.37" in text
    assert "rms 4.11 N" in text


def test_values_of_a_fit_have_the_digits_of_their_interval() -> None:
    """84.3459 mm stood beside an interval of 81.9422 to 86.7496 mm."""
    assert to_interval((84.3459, 81.9422, 86.7496)) == ("84.3", "81.9", "86.7")
    assert to_interval((1.85557, 1.8539, 1.85723)) == ("1.8556", "1.8539", "1.8572")
    assert to_interval((65.78, -1305.49, 1437.05)) == ("100", "-1300", "1400")
    assert to_interval((9.92819e-07, 3.18605e-07, 1.66703e-06)) == (
        "0.99e-06", "0.32e-06", "1.67e-06"
    )  # fmt: skip
    assert to_interval((2.0, 2.0, 2.0)) == ("2", "2", "2")


@pytest.mark.parametrize(
    ("scale", "said"),
    [(1.0, "are not larger than the stated noise"), (2.5, "was multiplied by 2.5")],
)
def test_a_fit_within_the_stated_noise_is_not_compared_by_a_factor(scale: float, said: str) -> None:
    """The factor has 1 as its lower limit, so "1.00 times" was printed for smaller residuals."""
    points = load_points("c01", Path("runs"), False)
    found = fit(catalogue.get("quasi-static"), points)
    assert said in fit_text(dataclasses.replace(found, noise_scale=scale), points)


def test_fit_as_json_is_one_value_without_infinities() -> None:
    words = ("fit", "C-1", "--model", "hasselroth", "--free", "diameter,gain,offset", "--json")
    value = json.loads(call(*words))
    states = {e["name"]: e["state"] for e in value["estimates"]}
    assert states == {
        "diameter": "flat", "gain": "flat", "offset": "free", "rest_length": "fixed"
    }  # fmt: skip
    assert value["condition"] is None
    assert value["identifiability"]


def test_fit_writes_a_model_file_that_can_be_fitted_again(tmp_path: Path) -> None:
    out = tmp_path / "mine.toml"
    call("fit", "c01", "--model", "liner-braid", "--out", str(out))
    text = call("fit", "c01", "--model", str(out))
    assert "1.57 N" in text
    assert "data_sha256" in out.read_text(encoding="utf-8")


def test_fit_prints_the_thesis_s_tables() -> None:
    text = call("fit", "c01", "--model", "quasi-static-low", "--region", "0-125", "--tables")
    for part in ("Predictor", "Analysis of Variance", "Best subsets", "C-p", "-26.09", "57.21"):
        assert part in text


def test_figures_are_written(tmp_path: Path) -> None:
    fit, chart = tmp_path / "fit.png", tmp_path / "chart.svg"
    call("fit", "c01", "--model", "quasi-static", "--figure", str(fit))
    call("models", "compare", "c01", "--models", "quasi-static,chou-hannaford",
         "--figure", str(chart))  # fmt: skip
    assert fit.read_bytes()[:4] == b"\x89PNG"
    assert b"<svg" in chart.read_bytes()


def test_models_list_names_all_with_their_equations() -> None:
    value = json.loads(call("models", "list", "--json"))
    assert len(value) == 22
    caldwell = next(m for m in value if m["name"] == "caldwell")
    assert caldwell["equations"][0] == "4-9"
    assert all(p["unit"] for m in value for p in m["parameters"])
    assert "liner-braid" in call("models", "list")


def test_compare_ranks(tmp_path: Path) -> None:
    words = ("models", "compare", "c01", "--models", "quasi-static,chou-hannaford")
    text = call(*words)
    assert text.index("quasi-static") < text.index("chou-hannaford")
    assert "worse" in text
    value = json.loads(call(*words, "--json"))
    assert value["scores"][0]["model"] == "quasi-static"
    assert value["floors"]["repeat_n"] is None


def test_table_4_3_preset_shows_published_by_semean_and_recomputed() -> None:
    text = call("models", "compare", "--preset", "table-4-3")
    assert "78.3 mm" in text
    line = next(x for x in text.splitlines() if x.startswith("quasi-static") and "0-125" in x)
    assert line.split()[3:7] == ["2.891", "2.891", "0.912", "0.911"]
    value = json.loads(call("models", "compare", "--preset", "table-4-3", "--json"))
    assert len(value) == 30


def test_audit_prints_the_whole_table() -> None:
    value = json.loads(call("models", "audit-thesis", "--json"))
    assert len(value) == 49
    text = call("models", "audit-thesis")
    for row in value:
        assert row["item"] in text
        assert row["reason"][:40] in text


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("fit", "c01", "--model", "tondu"), "did you mean tondu-lopez"),
        (("fit", "c05", "--model", "caldwell"), "no settled points"),
        (("fit", "nowhere", "--model", "caldwell"), "nowhere"),
        (("fit", "c01", "--model", "caldwell", "--start", "efficiency"), "NAME=NUMBER"),
        (("fit", "c01", "--model", "caldwell", "--region", "high"), "LOW-HIGH"),
        (("fit", "c01", "--model", "caldwell", "--region", "700-800"), "no points there"),
        (("fit", "c01", "--model", "caldwell", "--tables"), "not a sum of terms"),
        (("models", "compare"), "no data"),
        (("models", "compare", "c01", "--holdout", "mounting"), "at least three"),
        (("models", "compare", "--preset", "table-9"), "known: table-4-3"),
    ],
)
def test_what_a_user_did_wrong_is_one_line_with_a_remedy(words, said: str) -> None:
    result = runner.invoke(app, list(words))
    assert isinstance(result.exception, PamrigError)
    assert said in str(result.exception)
