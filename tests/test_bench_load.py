"""Runs in real time on a busy computer: `tests/overload.py` at its full size."""

from __future__ import annotations

from pathlib import Path

import pytest

from overload import campaign


@pytest.mark.campaign
@pytest.mark.realtime
def test_twenty_runs_at_a_load_of_eight_none_silent(tmp_path: Path) -> None:
    done = campaign(20, 2, 5.0, 8, True, tmp_path)
    assert len(done) == 20
    assert [one.reason for one in done if one.silent] == []
    assert all(one.lateness["heartbeat"]["rounds"] > 0 for one in done)
    assert all(one.problems == 0 for one in done)
