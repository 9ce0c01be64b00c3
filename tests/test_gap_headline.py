"""What `pamrig gap` states first: the channel with the real gap, and only what is still needed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from bench_runs import quick, run_isometric
from cli.gap.verdicts import _gap_text, _next_text, _rig_of
from daq.store.run import open_run
from gap.data.trial import Channel
from gap.decision.classify import _channels
from gap.estimation.cross_validation import HeldOut
from gap.reason import Cause, Reason
from gap.reporting.text import gap_sentences, sentence
from gap.verdict import Experiment, Explanation, Gap, Status, Verdict
from rigs.rigfile.config import load_rig


def held(before: float, recalibrated: float, after: float, floor: float) -> HeldOut:
    squares = [np.full(4, value**2) for value in (before, recalibrated, after, floor)]
    return HeldOut(*squares, np.ones(4))


def trial(**ranges: float) -> dict[str, Channel]:
    return {name: Channel(np.arange(2.0), np.array([0.0, top])) for name, top in ranges.items()}


def case(blocks: dict[str, HeldOut]) -> Any:
    one = trial(force_n=80.0, length_mm=20.0, pressure_kpa=600.0)
    one_trial = SimpleNamespace(get=lambda name: one[name])
    data = SimpleNamespace(slots={"a": [0], "b": [1]}, trials=[one_trial])
    return SimpleNamespace(
        held=blocks, floor_source="replicates", problem=SimpleNamespace(data=data)
    )


def test_the_headline_takes_the_channel_that_is_off_and_not_the_one_with_the_lowest_floor() -> None:
    """Force went from 3.47 to 0.24 N; the camera's floor is so low that 0.02 mm stood first."""
    found = _channels(
        case({"camera": held(0.03, 0.02, 0.001, 0.0002), "force": held(4.0, 3.47, 0.24, 0.2)}),
        named=True,
    )
    assert [gap.unit for gap in found] == ["N", "mm"]
    assert (round(found[0].recalibrated, 2), round(found[0].after or 0, 2)) == (3.47, 0.24)
    verdict = Verdict(
        Status.NAMED, Reason(Cause.NO_GAP), None, (), 0.0, 0.0, gap=found[1], channels=found
    )
    assert "3.47" in _gap_text(verdict)[0]
    assert "3.47 N" in gap_sentences(verdict)[0]
    assert [one["unit"] for one in verdict.as_dict()["channels"]] == ["N", "mm"]


def test_without_a_named_effect_the_channel_farthest_above_its_floor_comes_first() -> None:
    found = _channels(
        case({"camera": held(0.5, 0.01, 0.01, 0.02), "pressure": held(9.0, 6.0, 6.0, 0.1)}),
        named=False,
    )
    assert [gap.unit for gap in found] == ["kPa", "mm"]


def test_a_gap_that_one_slot_alone_shows_is_not_said_to_grow_without_a_reason() -> None:
    """0.149 kPa before a leak was found and 1.05 with it: each slot was left out in turn."""
    gap = Gap("kPa", 0.2, 0.149, 1.05, 0.1, "replicates", held_out="slot")
    verdict = Verdict(
        Status.NAMED, Reason(Cause.NO_GAP), None, (Explanation(("leak",), "leak", 0.95),), 0.0, 0.0,
        gap=gap, channels=(gap,),
    )  # fmt: skip
    text = " ".join(gap_sentences(verdict))
    assert "1.05 kPa remain. Each slot was left out in turn" in text
    smaller = replace(gap, after=0.12)
    verdict = replace(verdict, gap=smaller, channels=(smaller,))
    assert "left out" not in " ".join(gap_sentences(verdict))


EXPERIMENT = Experiment("isometric", {"repeats": 2}, 5.0, 9.0, 6, ("creep", "wear"), "measure more")


def test_what_is_separated_already_is_not_advised_again() -> None:
    named = Verdict(
        Status.NAMED, Reason(Cause.NO_GAP), None, (), 0.0, 0.0, next_experiment=EXPERIMENT
    )
    assert "nothing needed: creep and wear are 5.0 standard deviations apart" in "\n".join(
        _next_text(named, None, "virtual")
    )
    near = replace(named, next_experiment=replace(EXPERIMENT, separation_now=1.0))
    assert "next        6 x isometric" in "\n".join(_next_text(near, None, "virtual"))


def test_the_next_test_is_advised_on_the_rig_of_the_data(tmp_path: Path) -> None:
    config = load_rig("virtual")
    made = run_isometric(
        config, quick(config, lengths_mm=(60.0,), pressures_kpa=(200.0,)), tmp_path, derive=False
    )
    rig = _rig_of(open_run(made.folder).folder)
    assert load_rig(rig).crc32 == config.crc32
    verdict = Verdict(
        Status.INDISTINGUISHABLE, Reason(Cause.NO_GAP), None, (), 0.0, 0.0,
        next_experiment=EXPERIMENT,
    )  # fmt: skip
    assert f"run it with pamrig isometric --rig {rig} --protocol next.toml" in "\n".join(
        _next_text(verdict, "next.toml", rig)
    )
    assert _rig_of(tmp_path) == "", "a data set of others names no rig"


def test_a_sentence_leaves_the_name_of_an_entry_as_it_is_spelt() -> None:
    assert sentence("liner_threshold fits best") == "liner_threshold fits best."
    assert sentence("a gap that no entry explains") == "A gap that no entry explains."
