"""Recorded pictures as the camera of a rig: a folder of them, or those stored in a run."""

from __future__ import annotations

import dataclasses
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from analysis.reporting.report import report_json
from daq.clock import VirtualClock
from daq.errors import ConfigError, DeviceError
from daq.store.run import Run, open_run
from daq.store.verify import verify
from protocol_runs import events, plan_of, run_short
from rigs.devices.camera import ReplayCamera
from rigs.devices.event_loop import EventLoop
from rigs.execution.session import run_protocol
from rigs.protocols.registry import procedure
from rigs.rigfile.config import RigConfig, load_rig
from rigs.virtual.emulators.pictures.camera import render

LENGTHS = {"lengths_mm": (57.0, 63.0), "pressures_kpa": (150.0, 300.0)}


def rig(folder: Path, source: str, more: str = "") -> RigConfig:
    """The virtual rig with another camera."""
    text = load_rig("virtual").text
    assert text.count('source = "virtual"') == 1
    path = folder / "rig.toml"
    path.write_text(text.replace('source = "virtual"', f'source = "{source}"\n{more}'))
    return load_rig(str(path), 3)


def lengths(run: Run) -> list[float]:
    return [e["pixels"] for e in events(run, "length")]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Run:
    _, run, _ = run_short("isometric", tmp_path_factory.mktemp("runs"), seed=3, **LENGTHS)
    return run


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Drawings of the muscle at 57 and 58 mm; 10.png is after 9.png."""
    folder = tmp_path_factory.mktemp("pictures")
    rng = np.random.default_rng(1)
    for k, length_mm in enumerate((57.0, 58.0)):
        cv2.imwrite(str(folder / f"{9 + k}.png"), render(length_mm, rng))
    return folder


def replay(source: Path, again: bool = False) -> ReplayCamera:
    return ReplayCamera(f"replay:{source}", EventLoop(VirtualClock(), 0.01), again)


def test_a_run_is_replayed_into_its_protocol_to_the_bit(recorded: Run, tmp_path: Path) -> None:
    """The pictures go into the new record byte by byte, so their lengths are those of the first."""
    config = rig(tmp_path, f"replay:{recorded.folder}", "repeat = true")
    result, run, _ = run_short("isometric", tmp_path, config=config, **LENGTHS)
    assert result.outcome == "clean", result.error
    kept = [f["frame"] for f in recorded.frames if not f.get("sync")]
    count = min(len(kept), len(run.frames))
    assert count >= 5
    for k in range(count):
        assert run.frame_bytes(k) == recorded.frame_bytes(kept[k])
    assert lengths(run)[:count] == lengths(recorded)[:count]
    assert verify(run) == []


def test_the_report_says_that_pictures_were_replayed(recorded: Run, tmp_path: Path) -> None:
    config = rig(tmp_path, f"replay:{recorded.folder}", "repeat = true")
    _, run, _ = run_short("isometric", tmp_path, config=config, **LENGTHS)
    (stated,) = [f for f in report_json(run)["faults"] if f["kind"] == "replayed_pictures"]
    assert stated["run_id"] == recorded.run_id
    assert run.manifest["devices"]["camera"]["source"] == f"replay:{recorded.folder}"


def test_a_folder_of_pictures_in_natural_order(pictures: Path) -> None:
    camera = replay(pictures, again=True)
    frames = [camera.trigger() for _ in range(3)]
    assert [f.seq for f in frames] == [1, 2, 3]
    assert frames[0].host_ns < frames[1].host_ns < frames[2].host_ns
    assert np.array_equal(frames[0].gray, frames[2].gray)
    assert np.array_equal(frames[1].gray, cv2.imread(str(pictures / "10.png"), 0))
    assert frames[0].jpeg == b""  # a PNG is encoded as the pictures of any camera are


def test_pictures_that_are_used_up_end_the_test_in_good_order(
    pictures: Path, tmp_path: Path
) -> None:
    shutil.copytree(pictures, tmp_path / "two")
    config = rig(tmp_path, "replay:two")  # relative to the rig file
    result, run, bench = run_short("isometric", tmp_path, config=config, **LENGTHS)
    assert result.outcome == "faulted"
    assert "its 2 pictures are used up" in str(result.error)
    assert len(run.frames) == 2
    assert bench.board.pressure_kpa < 5.0
    assert open_run(run.folder).outcome == "faulted"


def test_a_picture_of_no_muscle_is_refused_before_arming(tmp_path: Path) -> None:
    (tmp_path / "dark").mkdir()
    cv2.imwrite(str(tmp_path / "dark" / "1.png"), np.zeros((480, 640), np.uint8))
    config = rig(tmp_path, "replay:dark", "repeat = true")
    result = run_protocol(
        procedure("isometric"), config, plan_of("isometric", config, **LENGTHS), tmp_path
    )
    assert "no length can be measured in its picture" in str(result.error)


def test_what_cannot_be_replayed_is_named(pictures: Path, tmp_path: Path) -> None:
    with pytest.raises(DeviceError, match=r"camera \(replay:.*none\): cannot be read: No such"):
        replay(tmp_path / "none")
    (tmp_path / "empty").mkdir()
    with pytest.raises(DeviceError, match="holds no picture"):
        replay(tmp_path / "empty")
    damaged = tmp_path / "damaged"
    shutil.copytree(pictures, damaged)
    (damaged / "10.png").write_bytes(b"\x89PNG\r\n\x1a\n and nothing more")
    camera = replay(damaged)
    camera.trigger()
    with pytest.raises(DeviceError, match=r"10\.png cannot be read: not a picture"):
        camera.trigger()


@pytest.mark.parametrize(
    ("source", "more", "said"),
    [
        ("replay:", "", "'replay:' is not a camera"),
        ("virtual", "repeat = true", "camera.repeat: is for recorded pictures"),
        ("film:x", "", "'film:x' is not a camera"),
    ],
)
def test_a_source_that_makes_no_sense_is_a_line(
    tmp_path: Path, source: str, more: str, said: str
) -> None:
    with pytest.raises(ConfigError) as error:
        rig(tmp_path, source, more)
    assert said in str(error.value)
    assert "\n" not in str(error.value)


def test_other_cameras_have_no_such_flag() -> None:
    camera = load_rig("virtual").camera
    assert not camera.replayed
    assert dataclasses.replace(camera, source="replay:x").replayed
