"""Fuzzing and soaking at their small sizes; `make fuzz` and `make soak` are the whole of it."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from audit import LOCK, loose
from fuzz.loop import Target, fuzz
from fuzz.targets import targets
from rigs.config import load_rig
from soak import soak

TARGETS = {target.name: (target, share) for target, share in targets()}
INPUTS = 300_000 if os.environ.get("PAMRIG_CAMPAIGN") else 4000


@pytest.mark.parametrize("name", TARGETS)
def test_no_input_breaks_hangs_or_fills_it(name: str) -> None:
    target, share = TARGETS[name]
    tally = fuzz(target, max(15, round(INPUTS * share)), seed=1)
    assert tally.found == []


def test_the_loop_finds_what_there_is_to_be_found() -> None:
    """Three bytes in a row, of which coverage keeps the first, then the second."""

    def deep(data: bytes) -> None:
        if data[:1] != b"7":
            return
        if data[1:2] != b"\x7f":
            return
        if data[2:3] == b"0":
            raise ZeroDivisionError("found")

    words = (b"7", b"\x7f", b"0")
    target = Target("deep", deep, [b"abcdef"], (ValueError,), ("test_fuzz",), words, traced=2)
    tally = fuzz(target, 6000, seed=1)
    assert {what for what, _ in tally.found} == {"ZeroDivisionError: found"}
    assert tally.kept >= 1


def test_a_minute_of_soaking_loses_nothing(tmp_path: Path) -> None:
    result = soak(1 / 60, tmp_path, load_rig("virtual"), tell=False)
    assert result["gaps_in_seq"] == result["missing_told"] == 0
    assert result["rows"] >= 60_000
    assert result["faults"] == []


@pytest.mark.campaign
def test_a_virtual_day_at_1_khz(tmp_path: Path) -> None:
    result = soak(24.0, tmp_path, load_rig("virtual"))
    print(result)
    assert result["gaps_in_seq"] == result["missing_told"] == 0
    assert result["rss_mb_per_hour"] < 1.0


def test_every_dependency_is_pinned_to_one_version() -> None:
    assert loose(LOCK.read_text()) == []
    assert loose("numpy>=2\n# a remark\nscipy==1.13.0 ; python_version < '3.12'\n") == ["numpy>=2"]
    assert loose("evil @ git+https://example.org/evil\n") != []
