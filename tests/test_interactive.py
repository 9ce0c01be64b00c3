"""A rig held open for a notebook: what it reads and records, and what vents it."""

from __future__ import annotations

import json
import os
import re
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest

import pamrig
from bench_process import BenchProcess, bench_process
from daq.errors import ConfigError, DeviceError
from daq.store.run import Run, open_run
from daq.store.verify import verify
from rigs.interactive.client import InteractiveRig

EMPTY_KPA = 20.0
VENTED_S = 0.35 + 1.5
"""The firmware's deadline and the time in which the muscle empties (docs, safety contract)."""


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], Run]:
    """A session on the virtual bench: what its calls returned, and its record."""
    runs = tmp_path_factory.mktemp("runs")
    got: dict[str, Any] = {"log": []}
    with pamrig.open_rig("virtual", runs, specimen="m7", seed=4, log=got["log"].append) as rig:
        got["before"] = rig.read(length=False)
        with pytest.raises(DeviceError, match=r"not armed \(arm\(\) allows"):
            rig.set_pressure(100)
        rig.tare()
        rig.arm()
        rig.set_length(62.0)
        got["settled"] = rig.set_pressure(200)
        with pytest.raises(ConfigError, match="from 0 to 650, got 2000"):
            rig.set_pressure(2000)
        with pytest.raises(ConfigError, match=r"from 51 to 72\.5, got 'long'"):
            rig.set_length("long")  # type: ignore[arg-type]
        with pytest.raises(DeviceError, match="under pressure"):
            rig.tare()
        got["read"] = rig.read()
        got["stretch"] = rig.record(0.4, pictures=2)
        got["point"] = rig.point(seconds=0.3)
        rig.mark("a remark")
        got["disarmed"] = rig.disarm()
    assert rig.outcome == "clean"
    rig.close()  # twice does nothing
    with pytest.raises(DeviceError, match="the session has ended"):
        rig.read()
    return got, open_run(rig.folder)


def test_it_reads_sets_and_refuses(session: tuple[dict[str, Any], Run]) -> None:
    got, _ = session
    assert got["settled"] is True
    assert not got["before"]["armed"]
    assert got["read"]["armed"]
    assert abs(got["read"]["pressure_kpa"] - 200) < 2
    assert got["read"]["u_pressure_kpa"] > 0
    assert abs(got["read"]["length_mm"] - 62) < 0.3
    assert got["disarmed"] < EMPTY_KPA


def test_a_stretch_is_whole(session: tuple[dict[str, Any], Run]) -> None:
    stretch = session[0]["stretch"]
    assert np.array_equal(np.diff(stretch.samples["seq"]), np.ones(399))
    assert stretch.samples["time_s"].iloc[-1] == pytest.approx(0.399, abs=1e-3)
    assert len(stretch.force) >= 4
    assert stretch.length["length_mm"].notna().all()
    with mpl.rc_context({"backend": "agg"}):
        top, bottom = stretch.plot()
    assert (top.get_ylabel(), bottom.get_xlabel()) == ("pressure (kPa)", "time (s)")


def test_the_session_is_a_sound_run_with_its_points(session: tuple[dict[str, Any], Run]) -> None:
    got, run = session
    assert verify(run) == []
    assert (run.outcome, run.manifest["protocol"]) == ("clean", "interactive")
    assert [e["text"] for e in run.events if e["kind"] == "marker"] == ["a remark"]
    kinds = [e["kind"] for e in run.events]
    assert kinds.index("armed") < kinds.index("disarmed") < kinds.index("vented")
    table = pamrig.RecordedRun(run).table
    assert list(table["order"]) == [got["point"]["order"]]
    assert abs(float(table["force_n"].iloc[0]) - got["point"]["force_n"]) < 0.3
    from analysis.reporting.report import report_json

    report = report_json(open_run(run.folder))
    assert report["title"] == "Interactive session"
    assert report["headline"].startswith("1 points were measured at 200")


def test_an_error_in_the_block_vents_and_stands_in_the_record(tmp_path: Path) -> None:
    def mistaken(rig: InteractiveRig) -> None:
        with rig:
            rig.arm()
            rig.set_pressure(150)
            _ = 1 / 0

    rig = pamrig.open_rig("virtual", tmp_path)
    with pytest.raises(ZeroDivisionError):
        mistaken(rig)
    run = open_run(rig.folder)
    assert run.outcome == "stopped"
    assert "ZeroDivisionError in the notebook" in json.dumps(run.events)
    assert [e for e in run.events if e["kind"] == "vented"][-1]["confirmed"]


def test_a_rig_that_cannot_be_opened_says_why(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"no-such\.toml"):
        pamrig.open_rig("no-such.toml", tmp_path)


def test_the_example_of_the_page_runs_as_it_stands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    page = Path(__file__).resolve().parent.parent / "docs" / "use" / "interactive.md"
    found = re.search(r"```python\n(.*?)```", page.read_text(), re.DOTALL)
    assert found
    monkeypatch.chdir(tmp_path)
    with mpl.rc_context({"backend": "agg"}):
        exec(compile(found[1], str(page), "exec"), {})
    assert "[3 rows x " in capsys.readouterr().out


# ---- a real kernel, a bench in a process of its own, real time ---------------------------

OPEN = """
import pamrig, time
rig = pamrig.open_rig({rig!r}, {runs!r}, idle_s={idle})
rig.arm()
rig.set_pressure(300)
print("ready", rig.folder)
"""


class Notebook:
    """A real Jupyter kernel."""

    def __init__(self) -> None:
        from jupyter_client.manager import start_new_kernel

        self.manager, self.client = start_new_kernel(kernel_name="python3", startup_timeout=120)

    def run(self, code: str, wait: bool = True) -> str:
        """Execute a cell; what it printed."""
        said: list[str] = []

        def hear(message: dict[str, Any]) -> None:
            content = message["content"]
            said.append(str(content.get("text", content.get("evalue", ""))))

        if not wait:
            self.client.execute(code)
            return ""
        for _ in range(3):  # right after a cell that failed, a kernel drops what was waiting
            reply = self.client.execute_interactive(code, timeout=180, output_hook=hear)
            if reply["content"]["status"] != "aborted":
                break
        return "".join(said)

    def close(self) -> None:
        """End the kernel."""
        self.client.stop_channels()
        self.manager.shutdown_kernel(now=True)


@pytest.fixture
def notebook() -> Iterator[Notebook]:
    book = Notebook()
    yield book
    book.close()


def _empty_after(bench: BenchProcess, since_s: float) -> float:
    """Seconds from ``since_s`` (monotonic) until the muscle was empty."""
    while time.monotonic() < since_s + 20:
        now = bench.lately()[-1]
        if now["t_ns"] * 1e-9 > since_s and now["pressure_kpa"] < EMPTY_KPA:
            return float(now["t_ns"] * 1e-9 - since_s)
        time.sleep(0.02)
    return float("inf")


@pytest.mark.realtime
@pytest.mark.skipif(os.name == "nt", reason="pseudo-terminals")
def test_interrupt_error_and_kill_each_vent_the_muscle(tmp_path: Path, notebook: Notebook) -> None:
    with bench_process(tmp_path / "bench") as bench:

        def opened(idle_s: float = 600.0) -> None:
            code = OPEN.format(rig=str(bench.rig), runs=str(tmp_path / "runs"), idle=idle_s)
            said = notebook.run(code)
            assert "ready" in said, said
            assert bench.lately()[-1]["pressure_kpa"] > 250

        def outcome() -> str:
            newest = max((tmp_path / "runs").glob("*/run.json"), key=lambda p: p.stat().st_mtime)
            end = time.monotonic() + 30
            while not (newest.parent / "final.json").exists():
                assert time.monotonic() < end
                time.sleep(0.05)
            run = open_run(newest.parent)
            assert verify(run) == []
            return f"{run.outcome}: {(run.final or {}).get('reason')}"

        opened()
        # The heartbeat does not need the cell: one that computes for longer than its deadline.
        notebook.run(
            "x = 0\nuntil = time.monotonic() + 1.5\nwhile time.monotonic() < until: x += 1"
        )
        assert bench.lately()[-1]["pressure_kpa"] > 250
        notebook.run("raise RuntimeError('a mistake in a cell')")
        assert _empty_after(bench, time.monotonic()) < VENTED_S
        assert outcome() == "stopped: RuntimeError in a cell"

        opened()
        notebook.run("rig.wait(60)", wait=False)
        time.sleep(1.0)
        notebook.manager.interrupt_kernel()
        assert _empty_after(bench, time.monotonic()) < VENTED_S
        assert outcome() == "stopped: KeyboardInterrupt during wait()"

        opened(idle_s=1.0)
        assert _empty_after(bench, time.monotonic() + 1.0) < VENTED_S
        assert notebook.run("print(rig.read()['armed'])").strip().endswith("True")
        notebook.run("rig.set_pressure(300)")
        os.kill(notebook.manager.provisioner.process.pid, signal.SIGKILL)
        assert _empty_after(bench, time.monotonic()) < VENTED_S
        assert outcome() == "stopped: the program that opened the rig has ended"
