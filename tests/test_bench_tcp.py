"""Where there is no pseudo-terminal the same bench listens on loopback TCP."""

from __future__ import annotations

from pathlib import Path

from bench_process import bench_process, run_pamrig
from daq.run import open_run
from rigs.config import load_rig
from rigs.virtual.warmup import warm_up


def test_a_run_over_tcp_ports(tmp_path: Path) -> None:
    with bench_process(tmp_path / "bench", "virtual", "--tcp") as bench:
        assert "socket://127.0.0.1:" in bench.rig.read_text()
        done = run_pamrig(
            "isometric", "--rig", bench.rig, "--protocol", "isometric-short",
            "--out", tmp_path / "runs",
        )  # fmt: skip
    assert done.returncode == 0, done.stderr
    (folder,) = (tmp_path / "runs").iterdir()
    run = open_run(folder)
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
