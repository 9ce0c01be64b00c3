"""A video as camera, and a GenICam camera against a stand-in of the package `harvesters`."""

from __future__ import annotations

import inspect
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from daq.clock import VirtualClock
from daq.errors import ConfigError, DeviceError, DeviceTimeout
from protocol_runs import events, run_short
from rigs.devices.camera import ReplayVideo, TriggeredGenicam
from rigs.devices.cameras.genicam import GenicamCamera
from rigs.devices.event_loop import EventLoop
from rigs.rigfile.config import load_rig
from rigs.virtual.emulators.pictures.camera import render
from vision.marker.edge import measure_gap

LENGTHS = (57.0, 58.0, 59.0)


@pytest.fixture(scope="module")
def video(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Without loss: the record compresses each frame once."""
    path = tmp_path_factory.mktemp("video") / "muscle.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"FFV1"), 50, (640, 480), False)
    rng = np.random.default_rng(1)
    for length_mm in LENGTHS:
        writer.write(render(length_mm, rng))
    writer.release()
    return path


def replay(path: Path, again: bool = False) -> ReplayVideo:
    return ReplayVideo(f"replay:{path}", EventLoop(VirtualClock(), 0.01), again)


def test_a_video_gives_its_frames_in_order_and_then_ends(video: Path) -> None:
    camera = replay(video)
    frames = [camera.trigger() for _ in LENGTHS]
    assert [frame.seq for frame in frames] == [1, 2, 3]
    assert frames[0].gray.shape == (480, 640)
    # The gap between the marks grows by 1 mm = 9.09 pixels a frame.
    gaps = [measure_gap(frame.gray).pixels for frame in frames]
    assert np.diff(gaps) == pytest.approx([1 / 0.11] * 2, abs=0.1)
    with pytest.raises(DeviceError, match="its 3 frames are used up"):
        camera.trigger()
    camera.close()
    camera.close()


def test_a_repeated_video_begins_anew(video: Path) -> None:
    camera = replay(video, again=True)
    frames = [camera.trigger().gray for _ in range(4)]
    assert np.array_equal(frames[0], frames[3])
    assert not np.array_equal(frames[0], frames[1])


@pytest.mark.parametrize(("data", "words"), [(b"", "no video"), (b"RIFF" * 50, "no video")])
def test_a_damaged_video_is_one_line(tmp_path: Path, data: bytes, words: str) -> None:
    path = tmp_path / "broken.avi"
    path.write_bytes(data)
    with pytest.raises(DeviceError, match=words) as caught:
        replay(path)
    assert "\n" not in str(caught.value)


def test_a_video_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(DeviceError, match="no such file"):
        replay(tmp_path / "gone.mp4")


def test_a_test_runs_with_a_video(video: Path, tmp_path: Path) -> None:
    text = load_rig("virtual").text.replace(
        'source = "virtual"', f'source = "replay:{video}"\nrepeat = true'
    )
    (tmp_path / "rig.toml").write_text(text)
    config = load_rig(str(tmp_path / "rig.toml"), 3)
    result, run, _ = run_short(
        "isometric", tmp_path, config=config, lengths_mm=(57.0,), pressures_kpa=(150.0, 300.0)
    )
    assert result.outcome == "clean", result.error
    assert events(run, "replayed_pictures")
    assert all(event["trusted"] for event in events(run, "length"))


# ---- GenICam ----------------------------------------------------------------------------


class Node:
    """A feature of the camera; ``fixed`` ones stay as they are."""

    def __init__(self, value: Any, fixed: bool = False) -> None:
        self.held, self.fixed = value, fixed

    @property
    def value(self) -> Any:
        return self.held

    @value.setter
    def value(self, value: Any) -> None:
        if not self.fixed:
            self.held = value


class Acquirer:
    """What `harvesters.core.ImageAcquirer` offers of the interface that is used."""

    def __init__(self, **nodes: Any) -> None:
        known = {"PixelFormat": "BayerRG8", "TriggerSelector": "", "TriggerMode": "Off",
                 "TriggerSource": "Line0", "ExposureTime": 10_000.0, "Gain": 0.0,
                 "Width": 1280, "Height": 1024}  # fmt: skip
        self.nodes = SimpleNamespace(**{name: Node(value) for name, value in known.items()})
        for name, node in nodes.items():
            setattr(self.nodes, name, node)
        self.nodes.TriggerSoftware = SimpleNamespace(execute=self.expose)
        self.remote_device = SimpleNamespace(node_map=self.nodes)
        self.waiting: list[np.ndarray] = []
        self.out = 0
        self.log: list[str] = []
        self.format = "Mono8"
        self.dead = self.deaf = False

    def expose(self) -> None:
        if not self.deaf:
            self.waiting.append(np.full((4, 6), len(self.log), np.uint8).ravel())

    def start(self, *, run_as_thread: bool = False) -> None:
        assert not run_as_thread
        self.log.append("start")

    def try_fetch(self, *, timeout: float, is_raw: bool = False) -> Any:
        assert not is_raw
        assert timeout >= 0.0
        if self.dead:
            raise RuntimeError("device\nlost")
        if not self.waiting:
            return None
        self.out += 1
        data = self.waiting.pop(0)
        part = SimpleNamespace(data_format=self.format, data=data, width=6, height=4)
        return SimpleNamespace(payload=SimpleNamespace(components=[part]), queue=self.queue)

    def queue(self) -> None:
        self.out -= 1

    def stop(self) -> None:
        self.log.append("stop")

    def destroy(self) -> None:
        self.log.append("destroy")


class Package:
    """Stands in for `harvesters.core`."""

    def __init__(self, acquirer: Acquirer) -> None:
        self.acquirer = acquirer
        self.log = acquirer.log

    def Harvester(self) -> Package:
        return self

    def add_file(
        self, file_path: str, check_existence: bool = False, check_validity: bool = False
    ) -> None:
        del check_validity
        if check_existence and file_path != "maker.cti":
            raise FileNotFoundError(f"Not found: {file_path}")

    def update(self) -> None:
        self.log.append("update")

    @property
    def device_info_list(self) -> list[Any]:
        return [SimpleNamespace(serial_number="CAM-1"), SimpleNamespace(serial_number="CAM-2")]

    def create(self, search_key: Any = None, *, config: Any = None) -> Acquirer:
        assert config is None
        assert search_key == {"serial_number": "CAM-2"}
        return self.acquirer

    def reset(self) -> None:
        self.log.append("reset")


def opened(acquirer: Acquirer, **settings: float) -> TriggeredGenicam:
    camera = GenicamCamera("CAM-2", "maker.cti", settings, Package(acquirer))
    return TriggeredGenicam(camera, "CAM-2", EventLoop(VirtualClock(), 0.01))


def test_each_trigger_is_one_new_picture() -> None:
    acquirer = Acquirer()
    camera = opened(acquirer, exposure=5000.0, width=640.0)
    assert camera.identity == {"source": "genicam:CAM-2", "serial": "CAM-2",
                               "exposure": "5000", "width": "640"}  # fmt: skip
    nodes = acquirer.nodes
    assert (nodes.PixelFormat.value, nodes.TriggerMode.value) == ("Mono8", "On")
    assert (nodes.TriggerSource.value, nodes.Width.value) == ("Software", 640)
    acquirer.expose()  # an old picture that nobody fetched
    acquirer.log.append("later")
    frame = camera.trigger()
    assert frame.gray.shape == (4, 6)
    assert frame.gray[0, 0] == len(acquirer.log)
    assert camera.trigger().seq == 2
    assert acquirer.out == 0
    camera.close()
    camera.close()
    assert acquirer.log[-3:] == ["stop", "destroy", "reset"] or acquirer.log.count("stop") == 1


def test_a_camera_that_gives_nothing_is_a_timeout() -> None:
    acquirer = Acquirer()
    camera = opened(acquirer)
    acquirer.deaf = True
    with pytest.raises(DeviceTimeout, match="no picture within 2 s"):
        camera.trigger()


def test_a_lost_camera_and_another_format_are_one_line() -> None:
    acquirer = Acquirer()
    camera = opened(acquirer)
    acquirer.format = "Mono12Packed"
    with pytest.raises(DeviceError, match="sends Mono12Packed"):
        camera.trigger()
    assert acquirer.out == 0
    acquirer.dead = True
    with pytest.raises(DeviceError, match="device lost") as caught:
        camera.trigger()
    assert "\n" not in str(caught.value)


def test_what_is_not_there_is_said_and_everything_is_released() -> None:
    acquirer = Acquirer(Gain=Node(0.0, fixed=True))
    package = Package(acquirer)
    with pytest.raises(DeviceError, match=r"camera\.settings\.gain = 12: it reports 0"):
        GenicamCamera("CAM-2", "maker.cti", {"gain": 12.0}, package)
    assert acquirer.log[-3:] == ["stop", "destroy", "reset"]
    with pytest.raises(DeviceError, match="no such camera; found: CAM-1, CAM-2"):
        GenicamCamera("CAM-9", "maker.cti", {}, package)
    with pytest.raises(DeviceError, match=r"producer other\.cti cannot be loaded"):
        GenicamCamera("CAM-2", "other.cti", {}, package)


def test_the_stand_in_has_the_interface_of_the_package() -> None:
    core = pytest.importorskip("harvesters.core")
    for ours, theirs, names in (
        (Package, core.Harvester, ("add_file", "update", "create", "reset")),
        (Acquirer, core.ImageAcquirer, ("start", "try_fetch", "stop", "destroy")),
    ):
        for name in names:
            mine = inspect.signature(getattr(ours, name)).parameters
            real = inspect.signature(getattr(theirs, name)).parameters
            assert [(p.name, p.kind) for p in mine.values()] == [
                (p.name, p.kind) for p in real.values()
            ]


def test_without_the_package_the_error_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "harvesters", None)
    with pytest.raises(DeviceError, match=r"pip install 'pamrig\[genicam\]'"):
        GenicamCamera("CAM-2", "maker.cti")


@pytest.mark.parametrize(
    ("camera", "words"),
    [
        ('source = "genicam:"\ngentl = "maker.cti"', "is not a camera source"),
        ('source = "genicam:CAM-2"', "gentl"),
        ('source = "uvc:0"\ngentl = "maker.cti"', "gentl"),
        ('source = "genicam:CAM-2"\ngentl = "m.cti"\n[camera.settings]\nfocus = 1', "webcam only"),
    ],
)
def test_a_wrong_table_is_one_line(tmp_path: Path, camera: str, words: str) -> None:
    text = load_rig("virtual").text
    head, _, rest = text.partition("[camera]\n")
    rest = rest[rest.index("[calibrations") :]
    (tmp_path / "rig.toml").write_text(f"{head}[camera]\n{camera}\n\n{rest}")
    with pytest.raises(ConfigError, match=words):
        load_rig(str(tmp_path / "rig.toml"))
