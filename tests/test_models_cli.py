"""`pamrig fit` and `pamrig models`: text, JSON, files, figures, and errors in one line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from cli.main import app
from daq.errors import PamrigError

runner = CliRunner()


def call(*words: str) -> str:
    result = runner.invoke(app, list(words), catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.stdout


def test_fit_prints_values_with_intervals() -> None:
    text = call("fit", "c01", "--model", "chou-hannaford")
    assert "braid_length" in text
    assert "88.37" in text
    assert "rmse 4.111 N" in text


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
    assert "1.571 N" in text
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
