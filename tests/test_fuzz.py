"""Fuzzing and soaking at their small sizes; `make fuzz` and `make soak` are the whole of it."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

import pytest

import fuzz.loop
from fuzz.guard import MORE_MB, Job, run
from fuzz.loop import Loop, Target
from fuzz.shares import SHARES
from fuzz.targets import TARGETS
from fuzz_toys_read import deep
from rigs.rigfile.config import load_rig
from soak import soak

INPUTS = 300_000 if os.environ.get("PAMRIG_CAMPAIGN") else 4000


@pytest.mark.parametrize("name", SHARES)
def test_no_input_breaks_hangs_or_fills_it(name: str) -> None:
    loop = Loop(TARGETS[name](), 1)
    loop.warm()
    tally = loop.run(max(15, round(INPUTS * SHARES[name])))
    assert tally.found == []
    assert tally.peak_mb - tally.before_mb < MORE_MB


def test_every_target_has_a_share() -> None:
    assert set(SHARES) == set(TARGETS)
    assert sum(SHARES.values()) == pytest.approx(1.0)


def toy(name: str, folder: Path, inputs: int, **more: Any) -> dict[str, Any]:
    """What becomes of a reader with a known fault, in its own process under guard."""
    return run(Job(name, inputs, folder, targets="tests.fuzz_toys", marked=["tests.fuzz_toys_read"],
                   **more))  # fmt: skip


def test_what_lies_behind_five_bytes_is_found_by_the_branches_on_the_way(tmp_path: Path) -> None:
    """Blind, one in 10^9 inputs would; stopped half-way, it goes on with what it kept."""
    half = toy("deep", tmp_path, 20_000)
    assert half["inputs"] == 20_000
    whole = toy("deep", tmp_path, 60_000)
    assert whole["inputs"] == 60_000
    assert whole["kept"] >= 4
    assert set(whole["found"]) == {"ZeroDivisionError: found"}
    blind = Loop(Target("deep", "", deep, [b"abc"], ()), 1)
    assert blind.run(20_000).found == []


def test_an_input_that_python_does_not_come_back_from_is_a_finding(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def endless(data: bytes) -> None:
        while data is not None:
            pass

    monkeypatch.setattr(fuzz.loop, "HANG_S", 0.2)
    tally = Loop(Target("hang", "", endless, [b"\x7f"], (ValueError,)), 1).run(1)
    assert [what for what, _ in tally.found] == ["Hang: longer than 0.2 s"]


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("crash", "crash: SIGSEGV"),
        ("native hang", "hang: longer than 1.5 s"),
        ("hoard", "MemoryError|memory grew by"),
    ],
)
def test_a_crash_a_hang_and_a_hoard_are_findings(name: str, says: str, tmp_path: Path) -> None:
    """And the input is kept that did it, although the process could say nothing any more."""
    done = toy(name, tmp_path, 400, hang_s=1.5, more_mb=50.0, deaths=1)
    assert re.search(says, done["found"][0]), done
    kept = (tmp_path / name.replace(" ", "-") / "found" / "0").read_bytes()
    assert name == "hoard" or b"\x7f" in kept


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
