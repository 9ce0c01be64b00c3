"""Seen and held-out forms side by side; what teaches the reliability, and when it may ship."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from blind.sets import BESIDE, HELD_OUT, kind_and_count
from gap.check import learn
from gap.check.campaign import Plan, run_campaign
from gap.check.learn import Samples, better_by, crossed_by, fit, judges, learnable, main
from gap.check.page import write_forms_page
from gap.check.scoring.forms import side_by_side
from gap.check.scoring.totals import summary
from gap.decision.reliability import FEATURES, shipped_reliability
from gap.errors import CheckError


def row(number: int, form: int | None, **changes: Any) -> dict[str, Any]:
    """A scored single of three floors, its family found."""
    plain = {
        "stream": HELD_OUT, "number": number, "kind": "single", "hidden": ["creep"],
        "forms": [form], "truth": "effects", "size": 3.0, "mimic": 0.1, "alarm": True,
        "crashed": False, "family_right": True, "named_right": True, "wrong_name": False,
        "flagged_unknown": False, "covered": True, "confidence": 0.9, "right": True,
    }  # fmt: skip
    return {**plain, **changes}


def nominal(number: int, alarm: bool) -> dict[str, Any]:
    return row(
        number, None, kind="nominal", hidden=[], forms=[], truth="none", size=0.0, alarm=alarm,
        family_right=False, named_right=False,
    )  # fmt: skip


def figure(found: dict[str, Any], name: str) -> dict[str, Any]:
    return next(line for line in found["figures"] if line["figure"] == name)


class TestSideBySide:
    seen = [row(0, 1), row(1, 2), nominal(2, False), nominal(3, True)]  # noqa: RUF012
    kept = [row(0, 3), row(1, 4, family_right=False, named_right=False, wrong_name=True, size=1.7)]  # noqa: RUF012

    def test_each_side_has_its_own_count_and_interval(self) -> None:
        found = side_by_side(self.seen, self.kept)
        line = figure(found, "right family, gap >= 1.5 floors")
        assert (line["seen"]["hits"], line["seen"]["of"]) == (2, 2)
        assert (line["held_out"]["hits"], line["held_out"]["of"]) == (1, 2)
        assert line["held_out"]["low"] < 0.5 < line["held_out"]["high"]
        assert figure(found, "right family, gap >= 2 floors")["held_out"]["of"] == 1

    def test_sets_without_a_form_count_on_both_sides(self) -> None:
        found = side_by_side(self.seen, self.kept)
        line = figure(found, "false alarm at nominal")
        assert line["seen"] == line["held_out"]
        assert line["seen"]["of"] == 2
        assert found["formless_sets"] == 2

    def test_forms_are_counted_one_by_one(self) -> None:
        found = side_by_side(self.seen, self.kept)["by_form"]
        assert [(line["form"], line["family"], line["wrong"]) for line in found] == [
            (1, 1, 0), (2, 1, 0), (3, 1, 0), (4, 0, 1),
        ]  # fmt: skip

    def test_the_page_shows_both_columns(self, tmp_path: Path) -> None:
        found = {"first": 0, "last": 3, "forms": side_by_side(self.seen, self.kept)}
        write_forms_page(tmp_path / "page.md", found)
        text = (tmp_path / "page.md").read_text(encoding="utf-8")
        assert "| score | seen forms | held-out forms |" in text
        assert "| creep | 4 | 1 | 0 | 0 | 1 |" in text


def test_a_campaign_runs_the_stream_only_with_its_word(tmp_path: Path) -> None:
    number = next(i for i in range(60) if kind_and_count(i)[0] == "single")
    plan = Plan(HELD_OUT, (number,), tmp_path, "gap_check_stub:quiet", False, True, 1, None, True)
    with pytest.raises(ValueError, match="gap check --held-out"):
        run_campaign(plan)
    admitted = Plan(
        HELD_OUT, (number,), tmp_path, "gap_check_stub:quiet", False, True, 1, None, True, True
    )
    (entry,) = run_campaign(admitted)
    effect = entry["envelope"]["answer"]["effects"][0]
    assert effect["held_out"]
    assert entry["score"]["forms"] == [effect["form"]]
    assert effect["form"] >= 3
    assert summary([entry])["sets"] == 1


@pytest.mark.parametrize("stream", [HELD_OUT, BESIDE])
def test_sets_of_the_campaign_of_forms_never_teach(stream: str, tmp_path: Path) -> None:
    line = {"score": {"stream": stream, "number": 4, "changed": False}}
    with pytest.raises(CheckError, match="held-out forms never teach"):
        learnable([line], tmp_path / "ledger.csv")


def test_only_held_out_forms_judge() -> None:
    with pytest.raises(CheckError, match="no set of the stream"):
        judges([{"score": {"stream": "practice", "number": 4, "changed": False}}])


@pytest.fixture
def small_forest(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("sklearn")
    monkeypatch.setattr(learn, "TREES", 20)


def taught(seed: int, forms: list[tuple[tuple[str, int], ...]], y: list[int]) -> Samples:
    """Samples whose features name their form: a forest that has met it knows the outcome."""
    rng = np.random.default_rng(seed)
    x = 0.01 * rng.standard_normal((len(y), len(FEATURES)))
    for i, own in enumerate(forms):
        for effect, form in own:
            x[i, {"creep": 0, "leak": 4}[effect] + form] += 1.0
    return Samples(x, np.array(y), np.ones(len(y)), tuple(forms))


@pytest.mark.usefixtures("small_forest")
class TestWholeFormsAndEffectsAreLeftOut:
    def test_a_form_that_was_left_out_is_not_known(self) -> None:
        """Form 2 of creep alone is unknown: only who has seen it can say so."""
        forms = [(("creep", 1),)] * 12 + [(("creep", 2),)] * 12 + [(("leak", 1),)] * 12
        of = taught(1, forms, [0] * 12 + [3] * 12 + [0] * 12)
        all_of_it = learn.answers(fit(of), of.x)
        assert (all_of_it[12:24].argmax(axis=1) == 3).all()
        assert crossed_by(of, whole_effects=False)[12:24, 3].max() < 0.2

    def test_an_effect_is_left_out_with_all_its_forms(self) -> None:
        forms = [(("creep", 1),)] * 12 + [(("creep", 2),)] * 12 + [(("leak", 1),)] * 12
        of = taught(2, forms, [3] * 24 + [0] * 12)
        assert crossed_by(of, whole_effects=True)[:24, 3].max() < 0.2

    def test_a_pair_is_left_out_with_each_of_its_two(self) -> None:
        forms = [(("creep", 1), ("leak", 1))] * 10 + [(("leak", 2),)] * 10 + [(("creep", 2),)] * 10
        of = taught(3, forms, [1] * 10 + [0] * 20)
        p = crossed_by(of, whole_effects=False)
        assert p[:10, 1].max() < 0.2  # no forest met the pair when it was asked of it
        np.testing.assert_allclose(p.sum(axis=1), 1.0)

    def test_a_forest_that_is_better_is_found_better_and_its_twin_not(self) -> None:
        forms = [(("creep", 1),)] * 20 + [(("leak", 1),)] * 20
        right, wrong = taught(4, forms, [0] * 20 + [3] * 20), taught(4, forms, [3] * 20 + [0] * 20)
        good, bad = fit(right), fit(wrong)
        gain, low, _ = better_by(right, bad, good)
        assert gain > low > 0.0
        assert better_by(right, good, good) == (0.0, 0.0, 0.0)


def lines(stream: str, count: int) -> list[dict[str, Any]]:
    """Result lines with traits that tell nothing."""
    traits = {
        "rows": 3000.0, "excess": 3e4, "left": 10.0, "repeated": 3e4, "repeated_left": 0.0,
        "effects": 1.0, "same_family": 0.0, "margin": 2e4, "more": 10.0, "bent": 1.5,
        "bent_base": 4.0, "closed": 0.98, "next_seen": 0.0, "next_gain": 10.0, "first_gain": 3e4,
        "last_gain": 3e4, "settled": 0.0, "at_an_end": 0.0,
    }  # fmt: skip
    form = 3 if stream == HELD_OUT else 1
    names = ["creep" if i % 2 else "leak" for i in range(count)]
    return [
        {
            "stream": stream, "number": i, "seal": "",
            "score": {"stream": stream, "number": i, "changed": False, "kind": "single",
                      "hidden": [name], "truth": "effects", "named": []},
            "verdict": {"evidence": {"traits": traits, "found": ["creep"]}, "effects": []},
            "envelope": {"answer": {"effects": [{"id": name, "form": form}]}},
        }
        for i, name in enumerate(names)
    ]  # fmt: skip


@pytest.mark.usefixtures("small_forest")
def test_a_forest_that_is_not_better_on_held_out_forms_does_not_ship(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(learn, "store", lambda *_: pytest.fail("replaced what ships"))
    for name, stream in (("teach", "practice"), ("judge", HELD_OUT)):
        text = "\n".join(json.dumps(line) for line in lines(stream, 20))
        (tmp_path / name).write_text(text, encoding="utf-8")
    shipped = shipped_reliability().forest
    monkeypatch.setattr(learn, "fit", lambda _: shipped)  # as good as the shipped one, no better
    assert main([str(tmp_path / "teach")]) == 0
    assert "no held-out forms to judge by" in capsys.readouterr().out
    assert main([str(tmp_path / "teach"), "--judge", str(tmp_path / "judge")]) == 0
    assert "not better than the shipped one" in capsys.readouterr().out


def test_a_file_that_is_not_there_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["nowhere.jsonl"]) == 2
    assert "nowhere.jsonl" in capsys.readouterr().err
