"""Short templates of the valve tests over pseudo-terminals, in real time, same bytes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from bench_process import BUSY, run_in_real_time
from rigs.protocols.names import default_rig

pytestmark = pytest.mark.realtime
SHORT = {"switching-time": 2, "switching-voltage": 1, "flow": 4, "step": 4, "ram": 2}
"""Points of each short template."""


@pytest.mark.parametrize("name", SHORT)
def test_the_short_template_runs_in_real_time(tmp_path: Path, name: str) -> None:
    run = run_in_real_time(
        tmp_path, default_rig(name), name, "--protocol", f"{name}-short", "--json", input="\n" * 20
    )
    report = json.loads(run.done.stdout)
    assert report["outcome"] == "clean"
    assert len(report["points"]) == SHORT[name]
    others = [f for f in report["faults"] if (f["kind"], f["fault"]) not in TOLERATED]
    assert others == []


TOLERATED = {("instrument", kind) for kind in BUSY}
