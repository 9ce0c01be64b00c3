"""Every part of the benchmark page runs at its tiny size, and the page says what was not run.

No time is asserted: on a busy machine a figure is a figure of the machine.
"""

from __future__ import annotations

import importlib
import json
import math
import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks import recording
from benchmarks.__main__ import main
from benchmarks.page import PARTS, page
from benchmarks.paired import Growth, Spread, ratios, short

QUICK = [p for p in PARTS if p not in ("recording", "diagnosis", "growth_cores", "startup")]


# Two decades of run length take a quarter of a minute however small: with the campaigns.
@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=pytest.mark.campaign) if n == "growth_length" else n for n in QUICK],
)
def test_a_part_runs_at_its_tiny_size_and_renders(name: str) -> None:
    if name == "dynamics":
        pytest.importorskip("pinocchio")
    if name in ("dynamics", "simulation"):
        pytest.importorskip("mujoco")
    if name == "marker":
        pytest.importorskip("skimage")
    module = importlib.import_module(f"benchmarks.{PARTS[name]}")
    figures = json.loads(json.dumps(module.measure(True)))  # as it is kept
    text = "\n".join(module.lines(figures))
    assert "| " in text
    assert "nan" not in text


def test_imagej_finds_the_gap_too() -> None:
    pytest.importorskip("cv2")
    from benchmarks import marker

    if not marker.imagej_jar():
        pytest.skip("Java or ImageJ is not installed")
    (frame, gap), *_ = marker.cases(1)["ordinary"]
    found, took, version = marker.by_imagej([frame])
    assert found == [pytest.approx(gap, abs=1.0)]
    assert took[0] > 0.0
    assert version.startswith("ImageJ")


def test_recording_reads_back_every_row_also_after_a_kill(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """`measure` raises if a row is missing or differs; the peers here are told to be absent."""
    absent = {"pamrig": "", "pymeasure": "not installed", "qcodes": "x", "bluesky": "x"}
    monkeypatch.setattr(recording, "available", lambda: absent)
    found = json.loads(json.dumps(recording.measure(True)))
    assert list(found["ways"]) == ["pamrig", "pamrig-blocks", "pamrig-frames"]
    assert [w["lost_s"] for w in found["ways"].values()] == [[0.0]] * 3
    assert all(math.isfinite(s) for w in found["ways"].values() for s in w["missing_s"])
    text = "\n".join(recording.lines(found))
    assert "| pymeasure |  |  | not installed |" in text


@pytest.mark.parametrize("key", ["pymeasure-fsync", "qcodes-50ms", "bluesky-pages"])
def test_a_peer_gets_every_row_and_gives_it_back(key: str, tmp_path: Path) -> None:
    way = recording.WAYS[key]
    if recording.available()[way.tool]:
        pytest.skip(f"{way.tool} is not installed")
    recorder = recording.Recorder(way.tool)
    try:
        job = {**way.setting, "folder": str(tmp_path), "seconds": 0.1}
        gave = recorder.ask({**job, "mode": "flat"})
        assert gave["rows"] > 0
        assert recorder.ask({**job, "mode": "read"}) == {"rows": gave["rows"], "wrong": 0}
    finally:
        recorder.process.terminate()
        recorder.close()


def test_parts_are_kept_taken_up_again_and_the_page_says_what_is_missing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    where = ["--results", str(tmp_path / "kept"), "--page", str(tmp_path / "page.md"), "--tiny"]
    main([*where, "--only", "growth_samples"])
    text = (tmp_path / "page.md").read_text()
    assert "no figure here means anything" in text
    assert text.count("Not measured yet") == len(PARTS) - 1
    before = (tmp_path / "kept/growth_samples.json").read_bytes()
    main([*where, "--only", "growth_samples", "--resume"])
    assert (tmp_path / "kept/growth_samples.json").read_bytes() == before
    assert (tmp_path / "page.md").read_text() == text
    capsys.readouterr()


def test_a_page_without_any_figure_still_says_how_to_make_it() -> None:
    text = page(dict.fromkeys(PARTS))
    for name in PARTS:
        assert f"python -m benchmarks --only {name}" in text


def test_the_exponent_of_a_power_law_is_found_and_its_interval_holds_it() -> None:
    sizes = [10.0, 30.0, 100.0, 300.0, 1000.0]
    assert Growth.of(sizes, [3.0 * s**1.3 for s in sizes]).exponent == pytest.approx(1.3)
    rng = random.Random(4)
    held = 0
    for _ in range(200):
        grown = Growth.of(sizes, [s * math.exp(rng.gauss(0, 0.1)) for s in sizes])
        held += grown.low <= 1.0 <= grown.high
    assert 180 <= held <= 199  # 95 % of 200 is 190, sd 3.1


def test_ratios_are_taken_round_by_round() -> None:
    """A round in which the machine was busy is busy for both."""
    found = ratios([2.0, 20.0, 4.0], [1.0, 10.0, 1.0])
    assert found == Spread(2.0, 2.0, 4.0)


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (1234.5, "1,230"), (0.01234, "0.0123"), (12.34, "12.3"), (np.nan, "none"),
     (2e-7, "2.0e-07"), (999_999.0, "1,000,000")],
)  # fmt: skip
def test_figures_have_three_digits(value: float, text: str) -> None:
    assert short(value) == text


def test_the_best_peer_is_sought_among_equals_only() -> None:
    def way(rate: float) -> dict[str, Any]:
        return {"flat_hz": [rate]}

    ways = {"pamrig": way(1e6), "pymeasure": way(9e9), "qcodes-50ms": way(5.0),
            "bluesky-pages": way(7.0)}  # fmt: skip
    assert recording.best_peer({"ways": ways}) == "bluesky-pages"
    assert recording.best_peer({"ways": {"pamrig": way(1.0)}}) is None
