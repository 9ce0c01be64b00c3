"""Short templates of the valve tests over pseudo-terminals, in real time, same bytes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from bench_process import bench_process, run_pamrig
from rigs.protocols.names import default_rig

SHORT = {"switching-time": 2, "switching-voltage": 1, "flow": 4, "step": 4, "ram": 2}
"""Points of each short template."""


@pytest.mark.parametrize("name", SHORT)
def test_the_short_template_runs_in_real_time(tmp_path: Path, name: str) -> None:
    with bench_process(tmp_path / "bench", default_rig(name)) as bench:
        done = run_pamrig(
            name, "--rig", bench.rig, "--protocol", f"{name}-short", "--out", tmp_path / "runs",
            "--json", input="\n" * 20,
        )  # fmt: skip
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert report["outcome"] == "clean"
    assert len(report["points"]) == SHORT[name]
    assert report["faults"] == []
