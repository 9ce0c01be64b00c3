"""Camera time against controller time: each run measures it with the sync LED."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from analysis.figures.timeline import timeline_figure
from analysis.reporting.report import report_json, write_report
from bench_runs import run_bench
from daq.store.run import Run
from rigs.rigfile.config import load_rig


def synced(folder: Path, delay_ms: float, readout_ms: float, seed: int = 1) -> Run:
    """A short run on a bench whose camera is late by ``delay_ms``."""
    text = load_rig("virtual").text
    text = text.replace("readout_ms = 0.0 ", f"readout_ms = {readout_ms} ", 1)
    text = text.replace("[virtual.sensors]", f"[virtual.sensors]\ncamera_delay_ms = {delay_ms}", 1)
    folder.mkdir(parents=True, exist_ok=True)
    rig = folder / "rig.toml"
    rig.write_text(text)
    _, run, _ = run_bench(folder, str(rig), seed, lengths_mm=(60.0,), pressures_kpa=(100.0,))
    return run


def sync_of(run: Run) -> dict[str, Any]:
    """Its event."""
    (event,) = [e for e in run.events if e["kind"] == "camera_sync"]
    return event


@pytest.mark.parametrize("readout_ms", [0.0, 15.0], ids=["global", "rolling"])
@pytest.mark.parametrize("delay_ms", [0.0, 3.0, 12.0, 33.3, 80.0])
def test_the_delay_is_found_within_a_millisecond(
    tmp_path: Path, delay_ms: float, readout_ms: float
) -> None:
    event = sync_of(synced(tmp_path, delay_ms, readout_ms))
    assert event["found"], event
    error = event["delay_ms"] - delay_ms
    print(f"\ndelay {delay_ms} ms, read-out {readout_ms} ms: error {error:+.3f} ms, "
          f"stated u {event['u_delay_ms']:.3f} ms")  # fmt: skip
    assert abs(error) < 1.0
    assert event["u_delay_ms"] < 0.5
    assert event["dropped"] == event["repeated"] == 0


def test_a_covered_led_is_told_and_stops_nothing(tmp_path: Path) -> None:
    text = load_rig("virtual").text.replace(
        "patch = [46, 16, 29, 29]", "patch = [300, 440, 29, 29]"
    )
    rig = tmp_path / "rig.toml"
    rig.write_text(text)
    result, run, _ = run_bench(tmp_path, str(rig), lengths_mm=(60.0,), pressures_kpa=(100.0,))
    assert result.outcome == "clean"
    event = sync_of(run)
    assert not event["found"]
    assert "LED" in event["reason"]
    assert [fault["kind"] for fault in report_json(run)["faults"]] == ["camera_sync"]


def test_a_report_takes_neither_the_cameras_clock_nor_an_untared_balance_for_a_fault(
    tmp_path: Path,
) -> None:
    """A delay that was found is a clock's; before its tare a balance shows no force."""
    run = synced(tmp_path, 12.0, 0.0)
    page = write_report(run).read_text(encoding="utf-8")
    assert "No fault was reported." in page
    assert "time stamps, from the LED in its view: 12.0" in page
    figure = timeline_figure(run)
    assert figure is not None
    (force,) = [line for axes in figure.axes for line in axes.lines if line.get_label() == "force"]
    assert min(force.get_ydata()) > -1.0
