"""Camera time against controller time: each run measures it with the sync LED."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from bench_runs import run_bench
from rigs.config import load_rig


def sync_of(folder: Path, delay_ms: float, readout_ms: float, seed: int = 1) -> dict[str, Any]:
    """The event of a short run on a bench whose camera is late by ``delay_ms``."""
    text = load_rig("virtual").text
    text = text.replace("readout_ms = 0.0 ", f"readout_ms = {readout_ms} ", 1)
    text = text.replace("[virtual.sensors]", f"[virtual.sensors]\ncamera_delay_ms = {delay_ms}", 1)
    folder.mkdir(parents=True, exist_ok=True)
    rig = folder / "rig.toml"
    rig.write_text(text)
    _, run, _ = run_bench(folder, str(rig), seed, lengths_mm=(60.0,), pressures_kpa=(100.0,))
    (event,) = [e for e in run.events if e["kind"] == "camera_sync"]
    return event


@pytest.mark.parametrize("readout_ms", [0.0, 15.0], ids=["global", "rolling"])
@pytest.mark.parametrize("delay_ms", [0.0, 3.0, 12.0, 33.3, 80.0])
def test_the_delay_is_found_within_a_millisecond(
    tmp_path: Path, delay_ms: float, readout_ms: float
) -> None:
    event = sync_of(tmp_path, delay_ms, readout_ms)
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
    (event,) = [e for e in run.events if e["kind"] == "camera_sync"]
    assert not event["found"]
    assert "LED" in event["reason"]
