"""No picture is handed out twice: a camera that freezes or repeats is refused, and that is told."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest

from analysis.reduction.pictures import measure_stored
from daq.clock import RealClock, VirtualClock
from daq.errors import DeviceError, DeviceTimeout
from protocol_runs import run_short
from rigs.devices.camera import CallCamera, TriggeredUvc
from rigs.devices.event_loop import EventLoop
from rigs.devices.fresh_camera import AGAIN_S, FreshCamera
from rigs.devices.uvc import UvcCamera, UvcFrame
from rigs.execution.settling import _Length
from rigs.virtual.emulators.pictures.camera import render

SHAPE = (8, 8)


class Sensor:
    """A camera with noise of its own, of which any picture may be taken out of a drawer."""

    def __init__(self, clock: VirtualClock) -> None:
        self.clock = clock
        self.rng = np.random.default_rng(0)
        self.seq = 0
        self.again = 0
        self.keep: tuple[bool, bool] = (True, True)
        self.last: Any = None

    def expose(self) -> Any:
        self.clock.sleep(0.01)
        self.seq += 1
        gray = self.rng.integers(90, 110, SHAPE).astype(np.uint8)
        now = self.seq, self.clock.now_ns(), gray
        if self.again and self.last is not None:
            self.again -= 1
            seq = self.last[0] if self.keep[0] else now[0]
            stamp = self.last[1] if self.keep[1] else now[1]
            return seq, stamp, self.last[2]
        self.last = now
        return now


@pytest.fixture
def sensor() -> Sensor:
    return Sensor(VirtualClock())


@pytest.mark.parametrize("keep", [(True, True), (False, True), (False, False)])
def test_an_old_picture_is_counted_and_asked_for_anew(
    sensor: Sensor, keep: tuple[bool, bool]
) -> None:
    """With the old number and stamp, with the old stamp alone, with all of them new."""
    camera = FreshCamera(CallCamera(sensor.expose, "x"), sensor.clock)
    first = camera.trigger()
    sensor.again, sensor.keep = 3, keep
    second = camera.trigger()
    assert not np.array_equal(first.gray, second.gray)
    assert camera.counters() == {"frames": 2, "repeated": 3}


def test_a_frozen_camera_is_a_fault_before_the_heart_stops(sensor: Sensor) -> None:
    camera = FreshCamera(CallCamera(sensor.expose, "x"), sensor.clock)
    camera.trigger()
    sensor.again = 10**6
    begin_ns = sensor.clock.now_ns()
    with pytest.raises(DeviceError, match="same picture again and again"):
        camera.trigger()
    assert sensor.clock.now_ns() - begin_ns < 1e9 * (AGAIN_S + 0.05)


def test_pictures_without_noise_or_light_may_be_alike(sensor: Sensor) -> None:
    def dark() -> Any:
        seq, stamp, gray = sensor.expose()
        return seq, stamp, gray * 0

    def drawn() -> Any:
        seq, stamp, _ = sensor.expose()
        return seq, stamp, np.arange(64, dtype=np.uint8).reshape(SHAPE)

    for expose, noisy in ((dark, True), (drawn, False)):
        camera = FreshCamera(CallCamera(expose, "x"), sensor.clock, noisy)
        camera.trigger()
        camera.trigger()
        assert camera.counters() == {"frames": 2}


def test_a_driver_that_hands_its_buffer_out_twice_is_waited_for(sensor: Sensor) -> None:
    """The stamp of a UVC frame is that of its arrival: an old buffer has a new one."""

    class Repeating:
        applied: ClassVar[dict[str, float]] = {}

        def __init__(self, ends_after: int) -> None:
            self.asked, self.ends_after = 0, ends_after
            self.old = np.arange(64, dtype=np.uint8).reshape(SHAPE)

        def latest(self) -> UvcFrame:
            self.asked += 1
            old = self.asked <= self.ends_after
            gray = self.old if old else self.old + 1
            return UvcFrame(self.asked, sensor.clock.now_ns() + 1, gray, repeated=old)

    event_loop = EventLoop(sensor.clock, 0.02)
    frame = TriggeredUvc(Repeating(5), "uvc:0", event_loop).trigger()  # type: ignore[arg-type]
    assert frame.gray[0, 0] == 1
    camera = FreshCamera(TriggeredUvc(Repeating(10**6), "uvc:0", event_loop), sensor.clock)  # type: ignore[arg-type]
    beats: list[int] = []
    event_loop.add(lambda: beats.append(sensor.clock.now_ns()))
    with pytest.raises(DeviceTimeout, match="no new frame"):
        camera.trigger()
    assert camera.counters() == {"frames": 0, "no_answer": 1}
    assert max(np.diff(beats)) < 0.1e9  # the bench, and with it the heartbeat, went on


class Grabber:
    """What cv2.VideoCapture offers: 500 noisy pictures a second of two marks."""

    def __init__(self) -> None:
        self.rng = np.random.default_rng(0)
        self.plugged = True
        self.change: Callable[[Any], Any] = lambda gray: gray

    def isOpened(self) -> bool:
        return True

    def read(self) -> tuple[bool, Any]:
        time.sleep(0.002)
        return self.plugged, self.change(render(55.0, self.rng)) if self.plugged else None

    def release(self) -> None:
        self.plugged = False


@pytest.fixture
def grabber() -> Grabber:
    return Grabber()


def usb_camera(grabber: Grabber) -> FreshCamera:
    clock = RealClock()
    uvc = UvcCamera(0, clock, grabber)
    return FreshCamera(TriggeredUvc(uvc, "uvc:0", EventLoop(clock, 0.005)), clock)


def pictures(camera: FreshCamera) -> None:
    """Some pictures; one may be on its way already when something happens."""
    for _ in range(3):
        camera.trigger()


def half(gray: Any, row: int) -> Any:
    """The transfer broke off: the rest of the buffer is grey."""
    out = gray.copy()
    out[row:] = 128
    return out


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda gray: np.clip(gray.astype(int) * 3, 0, 255).astype(np.uint8), "over-exposed"),
        (lambda gray: (gray // 32).astype(np.uint8), "no edge stands out"),
        (lambda gray: half(gray, 60), "no edge stands out"),
    ],
    ids=["overload", "underload", "half"],
)
def test_a_usb_picture_that_shows_no_length_gives_none(
    grabber: Grabber, change: Callable[[Any], Any], said: str
) -> None:
    camera = usb_camera(grabber)
    assert measure_stored(camera.trigger().gray, {}).trusted
    grabber.change = change
    pictures(camera)
    gap = measure_stored(camera.trigger().gray, {})
    assert not gap.trusted
    assert said in gap.reason
    camera.close()


@pytest.mark.parametrize("row", range(20, 480, 40))
def test_a_picture_that_breaks_off_gives_the_right_length_or_none(row: int) -> None:
    gray = render(55.0, np.random.default_rng(0))
    whole, gap = measure_stored(gray, {}), measure_stored(half(gray, row), {})
    assert not gap.trusted or abs(gap.pixels - whole.pixels) < 0.1


def test_a_usb_camera_put_to_another_mode_ends_the_test(grabber: Grabber) -> None:
    """Half the pixels, half the length: a wrong value, were it taken."""
    camera = usb_camera(grabber)
    camera.trigger()
    grabber.change = lambda gray: gray[::2, ::2]
    with pytest.raises(DeviceError, match=r"320 x 240 pixels, 640 x 480 before"):
        pictures(camera)
    assert camera.counters()["size"] == 1
    camera.close()


def test_a_usb_camera_pulled_out_is_told_and_found_again_when_it_is_back(
    grabber: Grabber,
) -> None:
    camera = usb_camera(grabber)
    camera.trigger()
    grabber.plugged = False
    with pytest.raises(DeviceError, match="check its cable"):
        pictures(camera)
    assert camera.counters()["unplugged"] == 1
    camera.close()
    grabber.plugged = True
    again = usb_camera(grabber)
    assert measure_stored(again.trigger().gray, {}).trusted
    again.close()


def test_an_isotonic_test_does_not_take_an_old_picture_for_a_length(tmp_path: Path) -> None:
    """The camera freezes between two points: its last length had passed for that of the second."""

    def freeze(runner: Any) -> None:
        camera = runner.rig.camera
        camera = getattr(camera, "_camera", camera)
        expose, event, kept = camera._expose, runner.record.event, []

        def frozen() -> Any:
            frame = kept[0] if kept else expose()
            newest.append(frame)
            return frame

        def noted(kind: str, **fields: Any) -> Any:
            if kind == "point" and not kept:
                kept.append(newest[-1])
            return event(kind, **fields)

        newest: list[Any] = []
        camera._expose, runner.record.event = frozen, noted

    result, run, _ = run_short("isotonic", tmp_path, begin=freeze)
    assert result.outcome == "faulted"
    assert "same picture" in str(result.error)
    assert [e["order"] for e in run.events if e["kind"] == "point"] == [1]
    assert run.final["counters"]["camera"]["repeated"] > 0
    assert any(e["kind"] == "instrument" and e["device"] == "camera" for e in run.events)
    lowered = [e for e in run.events if e["kind"] == "lowered"]
    assert [e["done"] for e in lowered] == [True]  # the load came down in good order


def test_a_usb_camera_that_hangs_drops_no_load(tmp_path: Path) -> None:
    """No picture for two seconds: without a heartbeat the controller vents after a third of one."""

    class Hung:
        applied: ClassVar[dict[str, float]] = {}

        def latest(self) -> None:
            return None

        def close(self) -> None:
            pass

    def hang(runner: Any) -> None:
        event = runner.record.event
        hung = TriggeredUvc(Hung(), "uvc:0", runner.rig.event_loop)  # type: ignore[arg-type]

        def noted(kind: str, **fields: Any) -> Any:
            if kind == "point":
                runner.rig.camera._camera = hung
            return event(kind, **fields)

        runner.record.event = noted

    result, run, _ = run_short("isotonic", tmp_path, begin=hang)
    assert result.outcome == "faulted"
    assert "no new frame within 2 s" in str(result.error)
    assert run.final["counters"]["camera"]["no_answer"] == 1
    assert [e["done"] for e in run.events if e["kind"] == "lowered"] == [True]


def test_a_picture_looked_at_without_a_length_in_it_is_counted(sensor: Sensor) -> None:
    """Black pictures while a hung load comes to rest: nothing is stored, so the counter says it."""
    camera = FreshCamera(CallCamera(sensor.expose, "x"), sensor.clock)
    scale = SimpleNamespace(calibrations={"length_mm": SimpleNamespace(scale=0.1)})
    rig: Any = SimpleNamespace(camera=camera, clock=sensor.clock, config=scale)
    length = _Length(rig, {}, 0.1, 0.05)
    assert not length.rests()
    assert camera.counters()["unmeasured"] == 1
