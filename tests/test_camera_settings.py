"""Settings of a webcam: read from the rig file, set, read back, and refused where not taken."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from daq.clock import VirtualClock
from daq.errors import ConfigError, DeviceError
from rigs.devices.camera import TriggeredUvc
from rigs.devices.uvc import AUTOMATIC, PROPERTIES, UvcCamera
from rigs.rigfile.config import load_rig


class Webcam:
    """What a driver offers of cv2.VideoCapture; `fixed` settings stay as they are."""

    def __init__(self, **fixed: float) -> None:
        self.values: dict[int, float] = {PROPERTIES[name]: v for name, v in fixed.items()}
        self.fixed = set(self.values)
        self.set_order: list[int] = []
        self.released = False

    def isOpened(self) -> bool:
        return True

    def set(self, number: int, value: float) -> bool:
        self.set_order.append(number)
        if number in self.fixed:
            return False
        self.values[number] = value
        return True

    def get(self, number: int) -> float:
        return self.values.get(number, 0.0)

    def read(self) -> tuple[bool, Any]:
        return (not self.released, np.zeros((4, 4), np.uint8))

    def release(self) -> None:
        self.released = True


def test_settings_are_set_before_the_first_frame_and_stand_in_the_record() -> None:
    webcam = Webcam()
    settings = {"width": 1280.0, "height": 720.0, "exposure": 100.0, "focus": 40.0, "gain": 0.0}
    camera = UvcCamera(0, VirtualClock(), webcam, settings)
    try:
        assert camera.applied == settings
        for name in ("exposure", "focus"):
            ((automatic, off),) = AUTOMATIC[name]
            assert webcam.values[automatic] == off
            assert webcam.set_order.index(automatic) < webcam.set_order.index(PROPERTIES[name])
        bench: Any = SimpleNamespace(clock=VirtualClock())
        identity = TriggeredUvc(camera, "uvc:0", bench).identity
        assert identity == {"source": "uvc:0", "width": "1280", "height": "720",
                            "exposure": "100", "focus": "40", "gain": "0"}  # fmt: skip
    finally:
        camera.close()


def test_a_setting_that_the_camera_does_not_take_is_refused_with_what_it_reports() -> None:
    webcam = Webcam(width=640.0)
    with pytest.raises(DeviceError, match=r"camera\.settings\.width = 1280: it reports 640"):
        UvcCamera(0, VirtualClock(), webcam, {"width": 1280.0, "height": 720.0})
    assert webcam.released


def rig_with(folder: Path, source: str, table: str) -> str:
    text = load_rig("virtual").text.replace('source = "virtual"', f'source = "{source}"')
    path = folder / "rig.toml"
    path.write_text(text.replace("[camera.sync]", f"{table}\n[camera.sync]", 1), "utf-8")
    return str(path)


def test_the_rig_file_states_them(tmp_path: Path) -> None:
    rig = rig_with(tmp_path, "uvc:0", "[camera.settings]\nexposure = 100\ngain = 0")
    text = Path(rig).read_text("utf-8").partition("[virtual]")[0]
    Path(rig).write_text(text.replace('port = "virtual"', 'port = "/dev/ttyS9"'), "utf-8")
    assert load_rig(rig).camera.settings == {"exposure": 100.0, "gain": 0.0}


@pytest.mark.parametrize(
    ("source", "table", "named"),
    [
        ("uvc:0", "[camera.settings]\nexposre = 100", "exposre"),
        ("uvc:0", "[camera.settings]\nwidth = 640", "width and height belong together"),
        ("virtual", "[camera.settings]\ngain = 1", "only a webcam"),
        ("uvc:0", "[camera.settings]\ngain = -1", "outside 0 to 100000"),
    ],
)
def test_a_wrong_setting_is_named(tmp_path: Path, source: str, table: str, named: str) -> None:
    with pytest.raises(ConfigError, match=named):
        load_rig(rig_with(tmp_path, source, table))


def test_a_camera_table_with_another_name_is_recognised(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(load_rig("virtual").text.replace("[camera", "[kamera"), "utf-8")
    with pytest.raises(ConfigError, match=r"camera: .*is 'kamera' meant for it\?"):
        load_rig(str(path))
