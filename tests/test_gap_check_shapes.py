"""How like the diagnosis's own forms the blind bench's forms are."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from blind.physics.forms import FORMS
from gap.check.shapes import SAME, likeness, main

ROOT = Path(__file__).resolve().parent.parent


def form(effect: str, number: int):
    return next(f for f in FORMS if f.effect == effect and f.number == number)


def test_a_form_that_is_the_diagnosis_s_own_is_called_the_same() -> None:
    found = likeness(form("pressure_zero", 0), 1)
    assert found.cosines[0] > 0.9999
    assert found.same


@pytest.mark.parametrize(("effect", "number"), [("leak", 3), ("liner_threshold", 4)])
def test_a_held_out_form_is_another_one(effect: str, number: int) -> None:
    found = likeness(form(effect, number), 1)
    assert 0.5 < found.cosines[0] < SAME
    assert not found.same


def test_the_table_is_written_for_machines_too(tmp_path: Path, capsys) -> None:
    out = tmp_path / "deep" / "shapes.json"
    assert main(["--effects", "leak", "--designs", "1", "--out", str(out)]) == 0
    rows = json.loads(out.read_text(encoding="utf-8"))
    assert [row["form"] for row in rows] == [f.number for f in FORMS if f.effect == "leak"]
    assert capsys.readouterr().out.count("| leak |") == len(rows)


def test_an_effect_that_is_not_there_is_named(capsys) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["--effects", "leek"])
    assert "no such effect: leek" in capsys.readouterr().err


def test_the_page_lists_every_form_with_its_source() -> None:
    text = (ROOT / "docs" / "evidence" / "blind-forms.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (\w+) \| (\d+) \| (yes)? *\| `(.*?)` \| (.*?) \| ", text, re.MULTILINE)
    listed = {(e, int(k), h == "yes", q.replace("\\|", "|"), s) for e, k, h, q, s in rows}
    assert listed == {(f.effect, f.number, f.held_out, f.equation, f.source) for f in FORMS}
