"""Where there is no pseudo-terminal the same bench listens on loopback TCP."""

from __future__ import annotations

from pathlib import Path

import pytest

from bench_process import run_in_real_time
from daq.store.run import open_run
from rigs.rigfile.config import load_rig
from rigs.virtual.server import warm_up


@pytest.mark.realtime
def test_a_run_over_tcp_ports(tmp_path: Path) -> None:
    real = run_in_real_time(
        tmp_path, "virtual", "isometric", "--protocol", "isometric-short", bench=("--tcp",)
    )
    assert "socket://127.0.0.1:" in (real.folder.parent.parent / "bench" / "rig.toml").read_text()
    run = open_run(real.folder)
    assert run.outcome == "clean"
    assert run.final is not None
    assert run.final["counters"]["valve"]["missing"] == 0


def test_a_start_that_takes_long_says_what_it_waits_for() -> None:
    """A fresh installation compiles first; nobody sits before a silent terminal meanwhile."""
    said: list[str] = []
    warm_up(load_rig("virtual"), said.append, patience_s=0.0)
    assert said == ["compiling the simulation; only the first start takes so long"]
    warm_up(load_rig("virtual"), said.append, patience_s=600.0)
    assert len(said) == 1
