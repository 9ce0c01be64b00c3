"""`pamrig length` and `pamrig calibrate camera`: sources, JSON, bad input, calibrations."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from dataclasses import replace

import cv2
import numpy as np
import pytest

from bench_process import call_pamrig
from cli.data.length import length_report, measure_lengths, parse_box, write_lengths
from daq.clock import VirtualClock
from daq.errors import ConfigError, DeviceError, PamrigError
from rigs.calibration.camera import calibrate_from_board, calibrate_from_gauges
from rigs.calibration.frames import FramesError, open_frames
from rigs.devices.uvc import UvcCamera
from rigs.rigfile.camera_calibration import (
    CameraCalibration,
    load_camera_calibration,
    save_camera_calibration,
)
from rigs.virtual.emulators.pictures.camera import CameraModel, render
from vision.marker.edge import measure_gap
from vision.marker.lens import Lens
from vision_truth import Scene, picture

KEYS = ["file", "frame", "pixels", "u_pixels", "length_mm", "u_mm", "trusted", "reason"]


@pytest.fixture
def frames():
    rng = np.random.default_rng(1)
    return [render(48.0 + 2 * k, rng) for k in range(4)]


def rows(source, **options):
    text, failed = length_report(source, as_json=True, **options)
    got = json.loads(text)
    assert all(list(row) == KEYS for row in got)
    return got, failed


def test_folder_in_natural_order(tmp_path, frames):
    for k, frame in enumerate(frames):
        cv2.imwrite(str(tmp_path / f"f{9 + k}.png"), frame)
    (tmp_path / "notes.txt").write_text("not a frame")
    got, failed = rows(tmp_path)
    assert not failed
    assert [row["file"] for row in got] == ["f9.png", "f10.png", "f11.png", "f12.png"]
    assert [row["frame"] for row in got] == [0, 0, 0, 0]
    for k, row in enumerate(got):
        assert row["trusted"]
        assert row["length_mm"] is None
        assert row["u_mm"] is None
        assert abs(row["pixels"] - (8 + 2 * k) / 0.11) < 5 * row["u_pixels"]


def test_tiff_stack_and_macro_agree_with_single_frames(tmp_path, frames):
    path = tmp_path / "stack.tif"
    cv2.imwritemulti(str(path), frames)
    got, _ = rows(path, method="macro")
    assert [row["frame"] for row in got] == [0, 1, 2, 3]
    assert all(type(row["pixels"]) is int for row in got)
    for k, row in enumerate(got):
        assert abs(row["pixels"] - (8 + 2 * k) / 0.11) <= 1


def test_video(tmp_path, frames):
    path = tmp_path / "v.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 50, (640, 480), False)
    for frame in frames:
        writer.write(frame)
    writer.release()
    got, _ = rows(path)
    assert [row["frame"] for row in got] == [0, 1, 2, 3]
    assert all(abs(r["pixels"] - (8 + 2 * k) / 0.11) < 0.05 for k, r in enumerate(got))
    whole = path.read_bytes()
    path.write_bytes(whole[: int(0.6 * len(whole))])  # cut short
    got = list(open_frames(path))
    read = [item for item in got if item.image is not None]
    assert 0 < len(read) < 4
    assert all(item.problem for item in got[len(read) :])
    path.write_bytes(whole[:300])
    with pytest.raises(FramesError):
        rows(path)


def test_run_folder_replays_to_the_bit(tmp_path, frames):
    from daq.record.writer import RecordWriter
    from daq_records import MANIFEST

    clock = VirtualClock()
    record = RecordWriter(tmp_path, MANIFEST, clock, durable=False, threaded=False)
    live = []
    for k, frame in enumerate(frames):
        data = cv2.imencode(".jpg", frame, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes()
        record.frame(data, 1000 * k)
        live.append(measure_gap(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)))
    record.finalize("clean")
    for _ in range(2):
        got, _ = rows(record.folder)
        assert [row["pixels"] for row in got] == [gap.pixels for gap in live]
        assert [row["u_pixels"] for row in got] == [gap.u_pixels for gap in live]


def test_colour_and_16_bit_files(tmp_path):
    gray = picture(Scene(gap=150.4), np.random.default_rng(2))
    cv2.imwrite(str(tmp_path / "a.png"), gray)
    cv2.imwrite(str(tmp_path / "b.png"), gray.astype(np.uint16) * 257)
    cv2.imwrite(str(tmp_path / "c.png"), np.repeat(gray[:, :, None], 3, axis=2))
    alpha = np.dstack([gray, gray, gray, np.full_like(gray, 255)])
    cv2.imwrite(str(tmp_path / "d.png"), alpha)
    got, _ = rows(tmp_path)
    assert np.ptp([row["pixels"] for row in got]) < 1e-4


@pytest.mark.parametrize(
    ("name", "data", "what"),
    [
        ("a.png", b"not an image", "not a picture"),
        ("a.jpg", b"", "not a picture"),
        ("a.avi", b"nothing", "video"),
        ("a.tif", b"II*\0garbage", "not a picture"),
    ],
)
def test_what_is_not_a_picture_is_said_so(tmp_path, name, data, what):
    path = tmp_path / name
    path.write_bytes(data)
    with pytest.raises(FramesError, match=what):
        length_report(path)


def test_missing_and_empty(tmp_path):
    with pytest.raises(FramesError, match="no such file"):
        length_report(tmp_path / "gone.png")
    with pytest.raises(FramesError, match="no picture"):
        length_report(tmp_path)


def test_one_damaged_file_does_not_stop_a_folder(tmp_path, frames):
    cv2.imwrite(str(tmp_path / "a.png"), frames[0])
    (tmp_path / "b.png").write_bytes(b"damaged")
    got, failed = rows(tmp_path)
    assert not failed
    assert got[0]["trusted"]
    assert got[1]["pixels"] is None
    assert "not a picture" in got[1]["reason"]


def test_macro_without_marker_is_an_error_with_the_json(tmp_path):
    cv2.imwrite(str(tmp_path / "empty.png"), np.full((480, 640), 200, np.uint8))
    got, failed = rows(tmp_path, method="macro")
    assert "no marker" in failed
    assert got[0]["pixels"] is None


@pytest.mark.parametrize("roi", ["1,2,3", "a,b,c,d", "0,0,0,5"])
def test_bad_roi(roi):
    with pytest.raises(ConfigError, match="--roi"):
        parse_box(roi)


def test_roi_outside_the_frame_and_unknown_method(tmp_path, frames):
    cv2.imwrite(str(tmp_path / "a.png"), frames[0])
    for method in ("edge", "macro"):
        got, failed = rows(tmp_path / "a.png", method=method, roi="900,900,50,50")
        assert "640 x 480" in failed
        assert got[0]["pixels"] is None
        assert "640 x 480" in got[0]["reason"]
    with pytest.raises(ConfigError, match="edge or macro"):
        length_report(tmp_path / "a.png", method="guess")


def test_no_frame_ends_a_folder(tmp_path, frames):
    """One frame of noise ended 1,680 others with a ValueError and no output at all."""
    cv2.imwrite(str(tmp_path / "a.png"), frames[0])
    noise = np.random.default_rng(47).integers(0, 256, (480, 640), dtype=np.uint8)
    cv2.imwrite(str(tmp_path / "b.png"), noise)
    cv2.imwrite(str(tmp_path / "c.png"), np.full((480, 1), 90, np.uint8))
    cv2.imwrite(str(tmp_path / "d.png"), np.full((480, 640), 90, np.uint8))
    (tmp_path / "e.png").write_bytes(b"damaged")
    cv2.imwrite(str(tmp_path / "f.png"), frames[1])
    for roi in ("", "400,100,240,300"):
        got, failed = rows(tmp_path, roi=roi)
        assert not failed
        assert [row["file"][0] for row in got] == list("abcdef")
        assert [row["trusted"] for row in got] == [True, False, False, False, False, True]
        assert all(row["reason"] for row in got[1:5])


def test_a_defect_of_the_method_is_the_reason_of_its_row(tmp_path, frames, monkeypatch):
    import vision.marker.edge as edge

    def broken(frame, roi=None):
        if frame is not None and frame[0, 0] == 7:
            raise ZeroDivisionError("division by zero")
        return measure_gap(frame, roi)

    frames[1][0, 0] = 7
    for k in range(3):
        cv2.imwrite(str(tmp_path / f"{k}.png"), frames[k])
    monkeypatch.setattr(edge, "measure_gap", broken)
    got, failed = rows(tmp_path)
    assert not failed
    assert [row["trusted"] for row in got] == [True, False, True]
    assert "ZeroDivisionError: division by zero" in got[1]["reason"]
    _, failed = rows(tmp_path / "1.png")
    assert "ZeroDivisionError" in failed


def test_lengths_come_out_one_by_one():
    """Everything was kept until the last frame was measured."""
    parts: list[str] = []
    seen = []

    def source():
        for row in measure_lengths("virtual:50,60,70"):
            seen.append("".join(parts))
            yield row
        raise FramesError("camera", "unplugged")

    with pytest.raises(FramesError, match="unplugged"):
        write_lengths(source(), "camera", "edge", True, parts.append)
    assert ['"virtual:50"' in text for text in seen] == [False, True, True]
    assert len(json.loads("".join(parts))) == 3  # whole, though the source broke off


def test_the_command_prints_while_it_measures():
    many = "virtual:" + ",".join(["55"] * 2000)
    command = [sys.executable, "-m", "cli.main", "length", many]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout.readline().startswith("virtual:55[0]: 136.")
            assert process.poll() is None
        finally:
            process.kill()


def test_virtual_source():
    got = list(measure_lengths("virtual:50,60"))
    assert [round(40 + 0.11 * row.pixels, 2) for row in got] == [50.0, 60.0]


@pytest.mark.parametrize("method", ["edge", "macro"])
def test_preview_is_written(tmp_path, frames, method):
    cv2.imwrite(str(tmp_path / "a.png"), frames[0])
    out = tmp_path / "preview.png"
    length_report(tmp_path / "a.png", method=method, preview=out)
    assert cv2.imread(str(out)).std() > 10
    with pytest.raises(ConfigError, match="--preview"):
        length_report(tmp_path / "a.png", method=method, preview=tmp_path / "x.nonsense")


def gauge_table(folder, lengths, model, rng, u_mm=0.001):
    lines = ["file,length_mm,u_mm"]
    for k, length in enumerate(lengths):
        block = length + rng.normal(0, u_mm)
        cv2.imwrite(str(folder / f"g{k}.png"), render(block, rng, model))
        lines.append(f"g{k}.png,{length},{u_mm}")
    table = folder / "table.csv"
    table.write_text("\n".join(lines))
    return table


def test_gauge_blocks_give_scale_offset_and_their_uncertainty(tmp_path):
    errors = []
    for k in range(6):
        rng = np.random.default_rng(20 + k)
        folder = tmp_path / str(k)
        folder.mkdir()
        table = gauge_table(folder, np.linspace(46, 62, 6), CameraModel(), rng)
        camera = calibrate_from_gauges(
            table, distance_mm=300.0, identity="blocks 7", date="2026-01-02"
        )
        straight = camera.calibration
        assert straight.domain == (46.0, 62.0)
        assert (straight.id, straight.date) == ("blocks 7", "2026-01-02")
        assert camera.off_plane_per_mm == pytest.approx(1 / 300)
        for value in (47.0, 54.0, 61.0):
            got, u, doubt = camera.length_mm((value - 40.0) / 0.11, 0.0)
            assert not doubt
            errors.append((got - value) / u)
    assert np.sqrt(np.mean(np.square(errors))) < 1.6
    assert np.abs(errors).max() < 4


@pytest.mark.parametrize(
    ("row", "said"),
    [
        ("g1.png,nan,0.001", "row 2: .*'length_mm': 'nan'"),
        ("g1.png,54,-1", "row 2: .*'u_mm': '-1'"),
        ("g1.png,-54,0.001", "row 2: .*'length_mm': '-54'"),
        ("torn.png,54,0.001", r"torn\.png: "),
    ],
)
def test_a_gauge_that_makes_no_sense_is_refused_by_its_row(tmp_path, row, said):
    table = gauge_table(tmp_path, [46, 54, 62], CameraModel(), np.random.default_rng(3))
    (tmp_path / "torn.png").write_bytes((tmp_path / "g1.png").read_bytes()[:300])
    lines = table.read_text().splitlines()
    table.write_text("\n".join([*lines[:2], row, *lines[3:]]))
    with pytest.raises(PamrigError, match=said):
        calibrate_from_gauges(table)


@pytest.mark.parametrize("square_mm", [0.0, -5.0, math.nan])
def test_a_board_without_a_size_is_refused(tmp_path, square_mm):
    with pytest.raises(ConfigError, match="not a valid side length"):
        calibrate_from_board(tmp_path / "none.png", (8, 6), square_mm)


def test_calibration_file_round_trip_and_domain(tmp_path, frames):
    table = gauge_table(tmp_path, [46, 54, 62], CameraModel(), np.random.default_rng(3))
    camera = replace(
        calibrate_from_gauges(table, distance_mm=250.0),
        lens=Lens(320.0, 240.0, 400.0, 1e-6, 0.0, 1e-7),
    )
    for name in ("c.toml", "c.json"):
        save_camera_calibration(tmp_path / name, camera)
        assert load_camera_calibration(tmp_path / name) == camera
    cv2.imwrite(str(tmp_path / "x.png"), render(50.0, np.random.default_rng(4)))
    cv2.imwrite(str(tmp_path / "y.png"), render(64.5, np.random.default_rng(5)))
    inside, _ = rows(tmp_path / "x.png", calibration=tmp_path / "c.toml")
    assert abs(inside[0]["length_mm"] - 50.0) < 4 * inside[0]["u_mm"]
    outside, _ = rows(tmp_path / "y.png", calibration=tmp_path / "c.json")
    assert not outside[0]["trusted"]
    assert "outside the calibration's domain 46 to 62 mm" in outside[0]["reason"]


@pytest.mark.parametrize(
    "text",
    ["", "[lens]\nk1 = 0", "[calibration]\nquantity = 'force_n'", "not toml [", "[odd]\na=1"],
)
def test_bad_calibration_files(tmp_path, text):
    path = tmp_path / "c.toml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=r"c\.toml"):
        load_camera_calibration(path)


def test_lens_distortion_is_found_from_gauge_blocks():
    """Positions measured through a known lens: the fitted k1 is the true one, within its u."""
    from rigs.calibration.camera import _fit_lens

    rng = np.random.default_rng(6)
    true = Lens(320.0, 240.0, 400.0, k1=0.01)
    frame = picture(Scene(gap=150.0), rng)
    base = measure_gap(frame)
    gaps, lengths = [], []
    for gap in np.linspace(60, 520, 9):
        left = replace(base.left, x_mid=560.0 - gap, slope=0.0)
        right = replace(base.right, x_mid=560.0, slope=0.0)
        seen = gap + rng.normal(0, 0.003)
        measured = replace(base, pixels=seen, u_pixels=0.003, left=left, right=right)
        gaps.append(measured)
        exact = replace(measured, pixels=gap)
        lengths.append(40.0 + 0.11 * true.gap(exact)[0])
    found = _fit_lens(gaps, np.array(lengths), Lens(320.0, 240.0, 400.0))
    assert found is not None
    assert abs(found.k1 - 0.01) < 4 * found.u_k1
    assert found.u_k1 < 1e-3


def board_picture(path, pixels_a_square, shape=(480, 640)):
    big = 4
    side = int(pixels_a_square * big)
    canvas = np.full((shape[0] * big, shape[1] * big), 230, np.uint8)
    for r in range(7):
        for c in range(9):
            if (r + c) % 2 == 0:
                y, x = 200 + r * side, 300 + c * side
                canvas[y : y + side, x : x + side] = 30
    small = cv2.resize(canvas, shape[::-1], interpolation=cv2.INTER_AREA)
    cv2.imwrite(str(path), cv2.GaussianBlur(small, (0, 0), 0.8))
    return side / big


def test_board_gives_scale_and_off_plane_sensitivity(tmp_path):
    near_px = board_picture(tmp_path / "plane.png", 45.0)
    far_px = board_picture(tmp_path / "nearer.png", 46.5)
    camera = calibrate_from_board(
        tmp_path / "plane.png",
        (8, 6),
        5.0,
        offset_mm=40.0,
        nearer=tmp_path / "nearer.png",
        nearer_mm=10.0,
    )
    straight = camera.calibration
    assert straight.scale == pytest.approx(5.0 / near_px, rel=2e-4)
    assert straight.u_gain < 1e-3
    assert camera.off_plane_per_mm == pytest.approx((far_px / near_px - 1) / 10, rel=0.05)
    cv2.imwrite(str(tmp_path / "none.png"), np.full((480, 640), 128, np.uint8))
    with pytest.raises(ConfigError, match="no chessboard"):
        calibrate_from_board(tmp_path / "none.png", (8, 6), 5.0)


def test_lens_without_distortion_changes_nothing():
    gap = measure_gap(picture(Scene(gap=150.4, tilt_deg=3.0), np.random.default_rng(8)))
    pixels, u = Lens(320.0, 240.0, 400.0).gap(gap)
    assert pixels == pytest.approx(gap.pixels, abs=1e-9)
    assert u == pytest.approx(gap.u_pixels)


class FakeCapture:
    """What cv2.VideoCapture offers; gives its frames, then fails."""

    def __init__(self, frames, opened=True):
        self.frames, self.opened, self.released = list(frames), opened, False

    def isOpened(self):
        return self.opened

    def read(self):
        return (True, self.frames.pop(0)) if self.frames else (False, None)

    def release(self):
        self.released = True


def test_uvc_camera_stamps_counts_and_reports_loss(frames):
    capture = FakeCapture([frames[0], frames[1], frames[1], np.dstack([frames[2]] * 3)])
    camera = UvcCamera(0, VirtualClock(5), capture)
    camera._thread.join(timeout=5)
    got = camera.drain()
    assert [f.seq for f in got] == [0, 1, 2, 3]
    assert camera.repeated == 1
    assert got[3].gray.shape == (480, 640)
    assert got[0].host_ns == 5
    with pytest.raises(DeviceError, match="gave no frame"):
        camera.latest()
    camera.close()
    camera.close()
    assert capture.released


def test_unreadable_camera_names_the_remedy():
    for capture in (FakeCapture([], opened=False), FakeCapture([])):
        with pytest.raises(DeviceError) as error:
            UvcCamera(3, VirtualClock(), capture)
        assert error.value.where == "camera 3"
        assert error.value.remedy
        assert capture.released


def test_source_frames_are_decoded_as_the_run_stored_them(tmp_path, frames):
    data = cv2.imencode(".jpg", frames[0])[1]
    (tmp_path / "a.jpg").write_bytes(data.tobytes())
    (item,) = open_frames(tmp_path / "a.jpg")
    assert np.array_equal(item.image, cv2.imdecode(data, cv2.IMREAD_GRAYSCALE))
    assert math.isfinite(measure_gap(item.image).pixels)


def test_plain_calibration_table_is_taken_too(tmp_path):
    path = tmp_path / "c.json"
    path.write_text(
        json.dumps(
            {
                "quantity": "length_mm",
                "unit": "mm",
                "raw_unit": "pixel",
                "offset": 40.0,
                "scale": 0.11,
            }
        )
    )
    assert isinstance(load_camera_calibration(path), CameraCalibration)


GAUGES = ("calibrate", "camera", "--out", "c.toml", "--gauges", "blocks.csv")
BOARD = ("calibrate", "camera", "--out", "c.toml", "--board", "board.png", "--domain-mm", "50,73")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("length", "virtual:55", "--threshold", "-5"), "--threshold: expected a number from 0 to"),
        (("length", "virtual:55", "--method", "macro", "--threshold", "256"), "--threshold: "),
        (("length", "virtual:55", "--count", "0"), "--count: expected a number from 1 to"),
        (("length", "virtual:55", "--count", "-3"), "--count: "),
        (("length", "virtual:55", "--roi", "-5,300,500,70"), "--roi: expected left,top,width"),
        (("length", "virtual:nan"), "virtual:nan: not a length"),
        ((*GAUGES, "--distance-mm", "0"), "--distance-mm: expected a number above 0"),
        ((*GAUGES, "--distance-mm", "nan"), "--distance-mm: "),
        ((*GAUGES, "--u-off-plane-mm", "-1"), "--u-off-plane-mm: expected a number from 0 to"),
        ((*BOARD, "--square-mm", "-5"), "--square-mm: expected a number above 0 up to 1000 mm"),
        ((*BOARD, "--offset-mm", "inf"), "--offset-mm: "),
        ((*BOARD, "--u-offset-mm", "-0.1"), "--u-offset-mm: "),
        ((*BOARD, "--nearer-mm", "nan"), "--nearer-mm: "),
        ((*BOARD, "--squares", "nanx6"), "--squares: expected a number from 3 to 1000 corners"),
        ((*BOARD, "--squares", "-9x6"), "--squares: "),
    ],
)
def test_a_number_out_of_its_bounds_is_refused_in_one_line(words, said):
    done = call_pamrig(*words)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith(f"pamrig: {said}")
    assert done.stderr.count("\n") == 1
