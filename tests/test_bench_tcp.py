"""Where there is no pseudo-terminal the same bench listens on loopback TCP."""

from __future__ import annotations

from pathlib import Path

from bench_process import bench_process, run_pamrig
from daq.run import open_run


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
