"""Pose of marks: against drawn pictures, whose truth no detector has seen."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from analysis.reduction.pictures import pose_of
from analysis.reduction.poses import point_poses, still_mean
from cli.main import app
from daq.errors import ConfigError
from rigs.rigfile.config import camera_values, load_rig
from rigs.rigfile.tables.marks import load_marks, load_pose_camera, save_pose_camera
from rigs.virtual.emulators.pictures.marks import Drawn, MarkCamera, draw_marks, seen_at
from vision.pose.calibrate import CalibrationError, calibrate
from vision.pose.camera import PoseCamera
from vision.pose.detect import Board, find_board
from vision.pose.measure import Mark, MarkSettings, measure_pose

BOARD = Board(7, 5, 14.0, 10.0)
DRAWN_BOARD = Drawn(side_mm=14.0, mark_mm=10.0, columns=7, rows=5)
LENS = MarkCamera(k1=-0.12, tilt_deg=(4.0, -3.0), distance_mm=260.0)
TILTS = ((25.0, 0.0), (-25.0, 5.0), (0.0, 30.0), (5.0, -28.0), (20.0, 20.0), (-18.0, 22.0))
MARKS = (Mark("base", 0, 20.0), Mark("link", 3, 20.0))
FILE = """
camera = "camera.toml"
reference = "base"

[marks.base]
id = 0
side_mm = 20.0

[marks.link]
id = 3
side_mm = 20.0
"""


@cache
def views() -> list[tuple[str, np.ndarray]]:
    rng = np.random.default_rng(3)
    out = []
    for k, tilt in enumerate(TILTS):
        shift = (310.0 + 10.0 * (k % 3), 235.0 + 5.0 * k)
        lens = replace(LENS, tilt_deg=tilt, roll_deg=17.0 * k, distance_mm=195.0, centre=shift)
        out.append((f"{k}.png", draw_marks([DRAWN_BOARD], rng, lens)))
    return out


@pytest.fixture(scope="module")
def camera() -> PoseCamera:
    flat = draw_marks([DRAWN_BOARD], np.random.default_rng(4), LENS)
    return calibrate(views(), BOARD, flat)


@pytest.fixture(scope="module")
def desk(camera: PoseCamera, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pose")
    save_pose_camera(folder / "camera.toml", camera)
    (folder / "marks.toml").write_text(FILE)
    rng = np.random.default_rng(6)
    (folder / "still").mkdir()
    for k in range(4):
        image = draw_marks([Drawn(0, x_mm=-40.0), Drawn(3, x_mm=30.0, angle_deg=20.0)], rng, LENS)
        cv2.imwrite(str(folder / "still" / f"{k}.png"), image)
    return folder


def scene(rng: np.random.Generator) -> tuple[list[Drawn], tuple[float, float, float]]:
    """Base and link anywhere, and the pose of the link as the base sees it."""
    x, y, angle = rng.uniform(20, 50), rng.uniform(-30, 30), rng.uniform(-180, 180)
    bx, by, turned = rng.uniform(-50, -30), rng.uniform(-10, 10), rng.uniform(-5, 5)
    c, s = math.cos(math.radians(turned)), math.sin(math.radians(turned))
    truth = (c * (x - bx) + s * (y - by), -s * (x - bx) + c * (y - by), angle - turned)
    return [Drawn(0, 20.0, bx, by, turned), Drawn(3, 20.0, x, y, angle)], truth


def errors(settings: MarkSettings, lens: MarkCamera, number: int, seed: int) -> np.ndarray:
    """Errors and their stated uncertainties, (number, 2, 3): mm, mm, degrees."""
    rng = np.random.default_rng(seed)
    out = []
    for _ in range(number):
        drawn, truth = scene(rng)
        pose = measure_pose(draw_marks(drawn, rng, lens), settings).poses["link"]
        assert pose.trusted, pose.reason
        off = (pose.x_mm - truth[0], pose.y_mm - truth[1],
               math.remainder(pose.angle_deg - truth[2], 360.0))  # fmt: skip
        out.append((off, (pose.u_x_mm, pose.u_y_mm, pose.u_angle_deg)))
    return np.array(out)


def test_a_calibration_finds_the_drawn_camera(camera: PoseCamera) -> None:
    assert abs(camera.fx / 900.0 - 1.0) < 2e-3
    assert abs(camera.distortion[0] + 0.12) < 0.01
    assert camera.rms_px < 0.1
    assert camera.plane is not None
    u = math.sqrt(camera.plane.covariance[5][5])
    assert abs(camera.plane.pose[5] - 260.0) < 0.6
    assert u < 0.1


def test_corners_of_a_board_are_where_they_were_drawn() -> None:
    lens = replace(LENS, tilt_deg=(20.0, -15.0), distance_mm=190.0)
    places, pixels = find_board(draw_marks([DRAWN_BOARD], np.random.default_rng(1), lens), BOARD)
    truth = np.array([seen_at(lens, x, y) for x, y in places])
    assert len(pixels) == 24
    assert np.sqrt(np.mean((pixels - truth) ** 2)) < 0.05


@pytest.mark.parametrize("plane", [True, False])
def test_a_pose_is_right_within_its_uncertainty(camera: PoseCamera, plane: bool) -> None:
    """With the plane of the calibration, and with the base mark alone."""
    settings = MarkSettings(MARKS, camera if plane else replace(camera, plane=None), "base")
    found = errors(settings, LENS, 10, seed=11)
    off, u = np.abs(found[:, 0]), found[:, 1]
    assert off[:, 2].max() < 0.15
    assert off[:, :2].max() < 0.12
    assert (off < 3.0 * u).all()
    assert u[:, 2].max() < 0.1


@pytest.mark.campaign
def test_poses_by_the_hundred(camera: PoseCamera) -> None:
    """The figures of docs/use/pose.md."""
    for plane in (True, False):
        settings = MarkSettings(MARKS, camera if plane else replace(camera, plane=None), "base")
        for blur, noise in ((0.8, 2.0), (0.5, 1.0), (1.5, 2.0), (0.8, 6.0)):
            found = errors(settings, replace(LENS, blur_px=blur, noise=noise), 200, seed=21)
            off, u = found[:, 0], found[:, 1]
            rms = np.sqrt(np.mean(off**2, axis=0))
            covered = np.mean(np.abs(off) < 2.0 * u, axis=0)
            print(plane, blur, noise, "rms", rms, "mean u", u.mean(axis=0), "k = 2", covered)
            assert (covered > 0.9).all(), (plane, blur, noise, covered)


def test_the_plane_is_the_origin_without_a_reference(camera: PoseCamera) -> None:
    settings = MarkSettings((Mark("link", 3, 20.0, turned_deg=90.0),), camera)
    image = draw_marks(
        [Drawn(3, 20.0, 12.0, -7.0, angle_deg=100.0)], np.random.default_rng(2), LENS
    )
    measured = measure_pose(image, settings)
    side = np.radians(100.0)  # corners are given as they are seen, for the drawing
    upper_left = seen_at(
        LENS,
        12.0 - 10 * np.cos(side) - 10 * np.sin(side),
        -7.0 - 10 * np.sin(side) + 10 * np.cos(side),
    )
    assert np.abs(measured.corners["link"][0] - upper_left).max() < 0.1
    pose = measured.poses["link"]
    for value, u, truth in (
        (pose.x_mm, pose.u_x_mm, 12.0),
        (pose.y_mm, pose.u_y_mm, -7.0),
        (pose.angle_deg, pose.u_angle_deg, 10.0),
    ):
        assert abs(value - truth) < 3.0 * u < 0.4


def test_a_board_on_the_link_gives_a_finer_angle(camera: PoseCamera) -> None:
    board = Board(4, 3, 8.0, 6.0, first_id=20)
    settings = MarkSettings((Mark("base", 0, 20.0), Mark("link", board=board)), camera, "base")
    drawn = Drawn(20, 8.0, 25.0, 5.0, 33.0, columns=4, rows=3, mark_mm=6.0)
    image = draw_marks([Drawn(0, 20.0, -40.0), drawn], np.random.default_rng(5), LENS)
    pose = measure_pose(image, settings).poses["link"]
    assert abs(pose.angle_deg - 33.0) < 3.0 * pose.u_angle_deg < 0.2
    assert abs(pose.x_mm - 65.0) < 3.0 * pose.u_x_mm


BASE, LINK = Drawn(0, 20.0, -40.0), Drawn(3, 20.0, 30.0)


def covered(image: np.ndarray) -> np.ndarray:
    """A wire over one side of the link."""
    x, y = seen_at(LENS, 30.0, 10.0)
    out = image.copy()
    out[round(y) - 6 : round(y) + 6, round(x) - 16 : round(x) + 16] = 120
    return out


@pytest.mark.parametrize(
    ("drawn", "lens", "reason"),
    [
        ([BASE], LENS, "not found"),
        ([LINK], LENS, "reference base: not found"),
        ([BASE, LINK, replace(LINK, x_mm=0.0, y_mm=30.0)], LENS, "in the picture 2 times"),
        ([BASE, replace(LINK, side_mm=21.0)], LENS, "pixels beside"),
        ([BASE, replace(LINK, height_mm=60.0)], LENS, "pixels beside"),
        ([BASE, LINK], replace(LENS, light=70.0, dark=52.0, noise=0.5), "contrast|not found"),
        ([BASE, replace(LINK, side_mm=5.0)], LENS, "pixels, 20 are needed|not found"),
        ([BASE, replace(LINK, x_mm=82.0)], LENS, "border|not found"),
        ([BASE, LINK], replace(LENS, width=600, centre=(300.0, 240.0)), "600 x 480 pixels"),
    ],
)
def test_bad_marks_have_no_pose(
    camera: PoseCamera, drawn: list[Drawn], lens: MarkCamera, reason: str
) -> None:
    image = draw_marks(drawn, np.random.default_rng(7), lens)
    pose = measure_pose(image, MarkSettings(MARKS, camera, "base")).poses["link"]
    assert not pose.trusted
    assert math.isnan(pose.angle_deg)
    assert any(part in pose.reason for part in reason.split("|")), pose.reason


def test_a_covered_side_is_refused(camera: PoseCamera) -> None:
    image = covered(draw_marks([BASE, LINK], np.random.default_rng(8), LENS))
    pose = measure_pose(image, MarkSettings(MARKS, camera, "base")).poses["link"]
    assert not pose.trusted
    assert pose.reason in ("not found", "a side is covered or not straight")


def test_too_few_or_equal_views_are_no_calibration() -> None:
    with pytest.raises(CalibrationError, match="3 of 3 pictures"):
        calibrate(views()[:3], BOARD)
    flat = draw_marks([DRAWN_BOARD], np.random.default_rng(9), replace(LENS, tilt_deg=(0.0, 0.0)))
    with pytest.raises(CalibrationError, match="tilted by"):
        calibrate([(str(k), flat) for k in range(4)], BOARD)


def invoke(*words: str) -> tuple[int, str]:
    result = CliRunner().invoke(app, [*words])
    if isinstance(result.exception, ConfigError):
        return 2, str(result.exception)
    return result.exit_code, result.output


def test_the_commands_from_board_to_angle(desk: Path, tmp_path: Path) -> None:
    folder = tmp_path / "views"
    folder.mkdir()
    for name, image in views():
        cv2.imwrite(str(folder / name), image)
    out = tmp_path / "camera.toml"
    code, text = invoke("calibrate", "pose", "--pictures", str(folder), "--out", str(out))
    assert code == 0
    assert "without a plane" in text
    (tmp_path / "marks.toml").write_text(FILE)
    code, text = invoke(
        "pose", str(desk / "still"), "--marks", str(tmp_path / "marks.toml"), "--still", "--json",
        "--preview", str(tmp_path / "p.png"),
    )  # fmt: skip
    assert code == 0
    data = json.loads(text)
    assert [row["file"] for row in data["frames"]] == ["0.png", "1.png", "2.png", "3.png"]
    still = data["still"]["link"]
    assert still["frames"] == 4
    assert abs(still["angle_deg"] - 20.0) < 3.0 * still["u_angle_deg"] < 0.3
    assert 0.0 < still["sd_angle_deg"] < 0.05
    assert (tmp_path / "p.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('reference = "base"', 'reference = "bse"', "there is no mark 'bse'"),
        ("id = 3", "id = 0", "both have number 0"),
        ("id = 3", "id = 50", "4x4_50 has no numbers 50 to 50"),
        ("id = 3", "number = 3", "marks.link.id"),
        ('"camera.toml"', '"gone.toml"', "gone.toml"),
        ("side_mm = 20.0\n\n[marks.link]", "side_mm = -1\n\n[marks.link]", "marks.base.side_mm"),
    ],
)
def test_a_wrong_file_of_marks_is_one_clear_line(
    desk: Path, old: str, new: str, words: str
) -> None:
    path = desk / "wrong.toml"
    path.write_text(FILE.replace(old, new))
    with pytest.raises(ConfigError) as caught:
        load_marks(path)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_files_and_run_json_give_the_settings_back(desk: Path, camera: PoseCamera) -> None:
    assert load_pose_camera(desk / "camera.toml") == camera
    settings = load_marks(desk / "marks.toml")
    assert MarkSettings.from_dict(json.loads(json.dumps(settings.to_dict()))) == settings


def test_a_rig_file_names_its_marks(desk: Path) -> None:
    text = load_rig("virtual").text.replace("[camera]\n", '[camera]\nmarks = "marks.toml"\n', 1)
    (desk / "bench.toml").write_text(text)
    camera = camera_values(load_rig(str(desk / "bench.toml")))
    image = np.asarray(cv2.imread(str(desk / "still" / "0.png"), cv2.IMREAD_GRAYSCALE), np.uint8)
    found = pose_of(image, json.loads(json.dumps(camera)))
    assert found is not None
    assert abs(found.poses["link"].angle_deg - 20.0) < 0.1
    assert pose_of(image, camera_values(load_rig("virtual"))) is None


def test_a_run_is_measured_again_with_its_own_marks(desk: Path, tmp_path: Path) -> None:
    from daq.clock import VirtualClock
    from daq.record.writer import RecordWriter
    from daq.store.run import open_run
    from daq_records import MANIFEST

    settings = load_marks(desk / "marks.toml").to_dict()
    known = {**MANIFEST, "camera": {"region": None, "sync": None, "lens": None, "marks": settings}}
    record = RecordWriter(tmp_path, known, VirtualClock(), durable=False, threaded=False)
    numbers = []
    for k in range(4):
        image = np.asarray(cv2.imread(str(desk / "still" / f"{k}.png"), 0), np.uint8)
        data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes()
        numbers.append(record.frame(data, 1000 * k))
    numbers.append(record.frame(b"no picture", 5000))
    record.finalize("clean")
    found, left_out = point_poses(open_run(record.folder), numbers)
    assert abs(found["link_angle_deg"] - 20.0) < 3.0 * found["u_link_angle_deg"] < 0.3
    assert abs(found["link_x_mm"] - 70.0) < 3.0 * found["u_link_x_mm"]
    assert [text for text in left_out if "link" in text] == [
        "frame 4, link: the stored picture cannot be decoded"
    ]
    code, text = invoke("pose", str(record.folder))
    assert code == 0
    assert text.count("frames/") == 5
    assert "no pose" in text


def test_the_mean_of_angles_about_180_degrees() -> None:
    mean, u = still_mean([179.9, -179.9, 179.8], [0.03, 0.03, 0.03], turns=True)
    assert mean == pytest.approx(179.9333, abs=1e-3)
    assert 0.03 < u < 0.1
    assert all(math.isnan(value) for value in still_mean([], []))
