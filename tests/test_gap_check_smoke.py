"""Sixty small blind sets through the real diagnosis: the campaign's first minutes.

Bounds are those of a run that has gone wrong, not of the targets: sixty sets cannot show two
percent. The campaign itself is in docs/evidence/gap-check.md.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest

from blind.sets import BLOCK
from gap.check.campaign import Plan, run_campaign
from gap.check.scoring.totals import summary

pytestmark = pytest.mark.campaign  # minutes of two processors: a whole campaign in small


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    out: Path = tmp_path_factory.mktemp("smoke")
    plan = Plan(
        "smoke", tuple(range(len(BLOCK))), out, jobs=min(os.cpu_count() or 1, 4),
        baselines=False, quiet=True,
    )  # fmt: skip
    return summary(run_campaign(plan))


def line(found: dict[str, Any], figure: str) -> dict[str, Any]:
    return next(row for row in found["headline"] if row["figure"] == figure)


def test_every_set_gets_a_verdict(found: dict[str, Any]) -> None:
    assert found["sets"] == len(BLOCK)
    assert line(found, "crashed")["hits"] == 0


def test_clear_single_effects_are_found(found: dict[str, Any]) -> None:
    family = line(found, "right family, gap >= 2 floors")
    assert family["of"] >= 10
    assert family["value"] >= 0.7


def test_names_given_are_seldom_wrong(found: dict[str, Any]) -> None:
    assert line(found, "wrong name given, any size")["value"] <= 0.15


def test_no_set_takes_longer_than_the_minute_it_may(found: dict[str, Any]) -> None:
    assert found["seconds_most"] < 60.0
