"""The edge method against frames of known truth, at the figures it promises.

Development used other seeds than these. Small samples always; `pytest -m campaign` runs the
same code at full size. Where a sample is small its statistical spread is allowed for.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom, chi2

from vision.gray import FrameError, RegionError
from vision.marker.edge import measure_gap
from vision_defects import glare, jpeg, missing_rows, specks
from vision_truth import Scene, clean, cramer_rao, digitise, half_plane, picture

CLEAN = {
    "ordinary": {},
    "blur 0.5, noise 1": {"blur": 0.5, "noise": 1.0},
    "blur 0.5, noise 10": {"blur": 0.5, "noise": 10.0},
    "blur 3, noise 1": {"blur": 3.0, "noise": 1.0},
    "blur 3, noise 10": {"blur": 3.0, "noise": 10.0},
    "light gradient 40 %": {"gradient": 0.4, "gradient_deg": (0, 360)},
    "tilt to 5 degrees": {"tilt_deg": (-5, 5)},
    "tilt, blur 3, gradient": {
        "tilt_deg": (-5, 5),
        "blur": 3.0,
        "gradient": 0.4,
        "gradient_deg": (0, 360),
    },
}
PRESSED = {
    "ordinary": {},
    "tilt": {"tilt_deg": (-5, 5)},
    "slight tilt": {"tilt_deg": (-0.5, 0.5)},
    "blur 0.5, noise 1": {"blur": 0.5, "noise": 1.0},
    "blur 3, noise 1": {"blur": 3.0, "noise": 1.0},
    "blur 3, noise 10": {"blur": 3.0, "noise": 10.0},
}


def drawn(rng, base):
    fixed = {k: rng.uniform(*v) if isinstance(v, tuple) else v for k, v in base.items()}
    return Scene(gap=rng.uniform(80, 250), x=rng.uniform(280, 360), **fixed)


def sample(seed, count, base, spoil=None):
    """(errors, stated uncertainties) of the trusted frames, first scenes, count flagged."""
    rng = np.random.default_rng([2024, seed])
    errors, stated, scenes, flagged = [], [], [], 0
    for _ in range(count):
        scene = drawn(rng, base)
        frame = picture(scene, rng)
        got = measure_gap(frame if spoil is None else spoil(frame, rng))
        scenes.append(scene)
        if got.trusted:
            errors.append(got.pixels - scene.gap)
            stated.append(got.u_pixels)
        else:
            flagged += 1
    return np.array(errors), np.array(stated), scenes, flagged


def honest(errors, stated, count):
    """>= 93 % within k = 2 and mean u <= 1.5 rms, with room for the spread of a small sample."""
    inside = int(np.sum(np.abs(errors) < 2 * stated))
    assert inside >= binom.ppf(0.001, len(errors), 0.93), inside / len(errors)
    rms = np.sqrt(np.mean(errors**2))
    assert np.mean(stated) <= 1.5 * rms * np.sqrt(count / chi2.ppf(0.001, count))


def report(name, errors, stated, scenes, flagged, bound=None):
    rms = np.sqrt(np.mean(errors**2))
    print(
        f"\n{name}: n {len(errors)} bias {errors.mean():+.5f} sd {errors.std(ddof=1):.5f}"
        + (f" bound {bound:.5f} ratio {errors.std(ddof=1) / bound:.2f}" if bound else "")
        + f" within 2u {np.mean(np.abs(errors) < 2 * stated):.3f} u/rms {stated.mean() / rms:.2f}"
        f" worst {np.abs(errors).max():.4f} flagged {flagged}"
    )


def check_clean(name, count):
    seed = list(CLEAN).index(name)
    errors, stated, scenes, flagged = sample(seed, count, CLEAN[name])
    bound = float(np.sqrt(np.mean([cramer_rao(s) ** 2 for s in scenes[:3]])))
    report(name, errors, stated, scenes, flagged, bound)
    assert flagged == 0
    assert abs(errors.mean()) < 0.01 + 3 * errors.std() / np.sqrt(count) * (count < 100)
    assert errors.std(ddof=1) < 1.5 * bound * np.sqrt(chi2.ppf(0.999, count) / count)
    if count >= 300:
        assert errors.std(ddof=1) < 1.5 * bound
        assert np.mean(np.abs(errors) < 2 * stated) >= 0.93
        assert stated.mean() <= 1.5 * np.sqrt(np.mean(errors**2))
    honest(errors, stated, count)


@pytest.mark.parametrize("name", CLEAN)
def test_bias_bound_and_stated_uncertainty(name):
    check_clean(name, 25)


@pytest.mark.campaign
@pytest.mark.parametrize("name", CLEAN)
def test_bias_bound_and_stated_uncertainty_full(name):
    check_clean(name, 400)


@pytest.mark.parametrize("step", [0.0, 0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875])
def test_no_bias_at_any_phase_of_the_pixel_grid(step):
    rng = np.random.default_rng([7, int(1000 * step)])
    scene = Scene(gap=150 + step, x=320.0 + step / 2, noise=1.0, blur=0.6)
    frame = clean(scene)
    errors = [measure_gap(digitise(frame, 1.0, rng)).pixels - scene.gap for _ in range(12)]
    assert abs(np.mean(errors)) < 0.001


@pytest.mark.campaign
def test_no_bias_at_any_phase_full():
    worst = 0.0
    for k in range(64):
        rng = np.random.default_rng([8, k])
        for blur in (0.5, 1.0, 3.0):
            scene = Scene(gap=150 + k / 64, x=320.0 + k / 128, noise=2.0, blur=blur)
            frame = clean(scene)
            errors = [measure_gap(digitise(frame, 2.0, rng)).pixels - scene.gap for _ in range(40)]
            worst = max(worst, abs(float(np.mean(errors))))
    print(f"\nlargest bias over 64 phases: {worst:.5f} px")
    assert worst < 0.01


def check_pressed(name, count):
    seed = 100 + list(PRESSED).index(name)
    errors, stated, scenes, flagged = sample(seed, count, PRESSED[name], lambda f, rng: jpeg(f, 75))
    report(f"JPEG 75, {name}", errors, stated, scenes, flagged)
    assert flagged <= 0.05 * count
    assert abs(errors.mean()) < 0.03
    if count >= 300:
        assert np.mean(np.abs(errors) < 2 * stated) >= 0.93
        assert stated.mean() <= 1.5 * np.sqrt(np.mean(errors**2))
    honest(errors, stated, count)


@pytest.mark.parametrize("name", PRESSED)
def test_jpeg_75_is_unbiased_and_says_what_it_knows(name):
    check_pressed(name, 20)


@pytest.mark.campaign
@pytest.mark.parametrize("name", PRESSED)
def test_jpeg_75_full(name):
    check_pressed(name, 400)


def spoiled(frame, rng):
    """One frame of the third criterion: specks, a glare band and missing rows at once or alone."""
    choice = rng.integers(0, 5)
    if choice in (0, 4):
        frame = glare(frame, rng, rng.choice([90.0, rng.uniform(20, 70), rng.uniform(-70, -20)]))
    if choice in (1, 3, 4):
        frame = specks(frame, rng, rng.choice(["black", "white", "any", "blobs"]))
    if choice in (2, 3, 4):
        frame = missing_rows(
            frame, rng, rng.choice(["block black", "block white", "any black", "any white"])
        )
    return frame


def check_spoiled(count, seed):
    base = {
        "tilt_deg": (-5, 5),
        "blur": (0.5, 2.0),
        "noise": (1.0, 5.0),
        "gradient": (0.0, 0.2),
        "gradient_deg": (0, 360),
    }
    errors, stated, scenes, flagged = sample(seed, count, base, spoiled)
    report("spoiled", errors, stated, scenes, flagged)
    wrong = int(np.sum(np.abs(errors) > 0.05))
    print(f"wrong and unflagged {wrong} of {count}; trusted {len(errors) / count:.4f}")
    return wrong, len(errors)


def test_spoiled_frames_are_right_or_flagged():
    wrong, trusted = check_spoiled(150, 500)
    assert wrong == 0
    assert trusted >= binom.ppf(0.001, 150, 0.95)


@pytest.mark.campaign
def test_spoiled_frames_full():
    wrong, trusted = check_spoiled(4000, 501)
    assert wrong < 4
    assert trusted >= 0.95 * 4000


def test_upright_glare_over_an_edge_is_right_or_flagged():
    rng = np.random.default_rng(600)
    for _ in range(30):
        scene = drawn(rng, {})
        got = measure_gap(glare(picture(scene, rng), rng, 0.0))
        assert not got.trusted or abs(got.pixels - scene.gap) < 0.05


def bars(rng):
    """Marks as bars anywhere, of any size, with either one left, parts beyond the frame."""
    gap = rng.uniform(40, 350)

    def mark():
        width = None if rng.random() < 0.3 else rng.uniform(14, 90)
        top = rng.uniform(-40, 250)
        return width, None if rng.random() < 0.3 else (top, top + rng.uniform(120, 300))

    (left_width, left_rows), (right_width, right_rows) = mark(), mark()
    gradient = rng.uniform(0, 0.4)
    return Scene(
        gap=gap,
        x=rng.uniform(60 + gap / 2, 580 - gap / 2),
        tilt_deg=rng.uniform(-5, 5),
        blur=rng.uniform(0.5, 2.5),
        noise=rng.uniform(1, 6),
        dark=rng.uniform(15, 60),
        light=min(rng.uniform(140, 220), 225 / (1 + gradient / 2)),
        gradient=gradient,
        gradient_deg=rng.uniform(0, 360),
        left_width=left_width,
        left_rows=left_rows,
        right_width=right_width,
        right_rows=right_rows,
    )


def check_bars(count, seed):
    rng = np.random.default_rng(seed)
    errors, stated = [], []
    for _ in range(count):
        scene = bars(rng)
        got = measure_gap(picture(scene, rng))
        if got.trusted:
            errors.append(got.pixels - scene.gap)
            stated.append(got.u_pixels)
            assert abs(errors[-1]) < max(0.05, 5 * stated[-1]), scene
    errors, stated = np.array(errors), np.array(stated)
    report("bars anywhere", errors, stated, [], count - len(errors))
    assert len(errors) >= binom.ppf(0.001, count, 0.95)
    assert np.sum(np.abs(errors) < 2 * stated) >= binom.ppf(0.001, len(errors), 0.93)


def test_finds_bars_anywhere_in_the_frame():
    check_bars(20, 700)


@pytest.mark.campaign
def test_finds_bars_anywhere_full():
    check_bars(400, 701)


@pytest.mark.parametrize("gain", [0.35, 0.6, 1.2])
def test_exposure_change(gain):
    rng = np.random.default_rng(800)
    scene = Scene(gap=133.3, light=200 * gain, dark=40 * gain)
    got = measure_gap(picture(scene, rng))
    assert got.trusted
    assert abs(got.pixels - scene.gap) < 4 * got.u_pixels


def test_over_exposed_ground_is_flagged():
    got = measure_gap(picture(Scene(light=320.0, dark=60.0), np.random.default_rng(1)))
    assert not got.trusted
    assert "over-" in got.reason


@pytest.mark.parametrize("smear", [1.0, 3.0, 7.0])
def test_motion_of_one_mark_moves_no_edge(smear):
    rng = np.random.default_rng([801, int(smear)])
    scene = Scene(gap=150.4, smear=smear)
    frame = clean(scene)
    got = [measure_gap(digitise(frame, 3.0, rng)) for _ in range(12)]
    assert all(g.trusted for g in got)
    assert abs(np.mean([g.pixels for g in got]) - 150.4) < 0.01


def test_region_that_cuts_marks_short_and_holds_both():
    scene = Scene(gap=150.4, tilt_deg=3.0)
    frame = picture(scene, np.random.default_rng(3))
    got = measure_gap(frame, (225, 150, 190, 120))
    assert got.trusted
    assert got.left.top >= 150
    assert got.right.bottom < 270
    assert abs(got.pixels - 150.4) < 5 * got.u_pixels


def test_mark_outside_the_region_is_said_so():
    frame = picture(Scene(gap=150.4), np.random.default_rng(3))
    got = measure_gap(frame, (280, 0, 360, 480))
    assert not got.trusted
    assert "two dark marks" in got.reason


def test_empty_and_noise_frames_are_flagged():
    rng = np.random.default_rng(4)
    for frame in (
        np.full((480, 640), 128, np.uint8),
        rng.integers(0, 256, (480, 640), dtype=np.uint8),
        digitise(np.full((480, 640), 190.0), 5.0, rng),
    ):
        assert not measure_gap(frame).trusted


def test_three_marks_need_a_region():
    frame = picture(Scene(gap=120.0, x=200, right_width=60.0), np.random.default_rng(5))
    frame[:, 500:] = frame[:, :140]
    assert "similar light gaps" in measure_gap(frame).reason
    got = measure_gap(frame, (60, 0, 250, 480))
    assert got.trusted
    assert abs(got.pixels - 120.0) < 0.02


def test_mirrored_frame_gives_the_same_gap():
    frame = picture(Scene(gap=141.7, x=300, tilt_deg=2.0), np.random.default_rng(6))
    a, b = measure_gap(frame), measure_gap(np.ascontiguousarray(frame[:, ::-1]))
    assert abs(a.pixels - b.pixels) < 0.2 * a.u_pixels


def test_excluded_patch_does_not_count():
    frame = picture(Scene(gap=150.4), np.random.default_rng(7))
    frame[20:60, 300:340] = 20
    got = measure_gap(frame, exclude=((295, 15, 50, 50),))
    assert got.trusted
    assert abs(got.pixels - 150.4) < 5 * got.u_pixels


def test_sixteen_bits_and_colour_agree_with_eight_bit_grey():
    scene = Scene(gap=150.4)
    gray = picture(scene, np.random.default_rng(8))
    eight = measure_gap(gray)
    sixteen = measure_gap(gray.astype(np.uint16) * 257)
    colour = measure_gap(np.repeat(gray[:, :, None], 3, axis=2))
    assert sixteen.pixels == pytest.approx(eight.pixels, abs=1e-4)
    assert colour.pixels == pytest.approx(eight.pixels, abs=1e-4)


@pytest.mark.parametrize("shape", [(101, 333), (240, 320), (37, 200), (1080, 1920)])
def test_odd_sizes(shape):
    scene = Scene(gap=0.4 * shape[1] + 0.3, x=shape[1] / 2, height=shape[0], width=shape[1])
    got = measure_gap(picture(scene, np.random.default_rng(9)))
    assert got.trusted
    assert abs(got.pixels - scene.gap) < 5 * got.u_pixels


def test_sharp_drawn_frame_without_noise():
    frame = np.full((480, 640), 255, np.uint8)
    frame[:, :200] = frame[:, 350:] = 10
    got = measure_gap(frame)
    assert got.trusted
    assert got.pixels == pytest.approx(150.0, abs=0.001)


@pytest.mark.parametrize(
    ("region", "what"), [((700, 0, 50, 50), "outside"), ((0, 0, 10, 10), "at least")]
)
def test_bad_region_is_an_error_that_says_the_frame_size(region, what):
    with pytest.raises(RegionError, match=what) as error:
        measure_gap(np.zeros((480, 640), np.uint8), region)
    assert "640 x 480" in str(error.value)


@pytest.mark.parametrize(
    "frame",
    [
        np.zeros((0, 5)),
        np.zeros(7),
        np.zeros((4, 4, 9)),
        np.zeros((9, 9), complex),
        np.full((50, 60), np.nan),
    ],
)
def test_arrays_that_are_no_frames(frame):
    with pytest.raises(FrameError):
        measure_gap(frame)


def test_same_frame_same_answer_to_the_bit():
    frame = jpeg(picture(Scene(), np.random.default_rng(10)))
    first = measure_gap(frame)
    for _ in range(3):
        assert measure_gap(frame.copy()) == first


def test_truth_renderer_gives_exact_area_coverage_without_blur():
    # a half-plane through a pixel's corner at 45 degrees covers half, by 0.25 px in: less
    assert half_plane(np.array([0.0]), np.radians(45), 0.0)[0] == pytest.approx(0.5)
    assert half_plane(np.array([0.25]), 0.0, 0.0)[0] == pytest.approx(0.75)
    corner = half_plane(np.array([-np.sqrt(0.5) + 0.1]), np.radians(45), 0.0)[0]
    assert corner == pytest.approx(0.1**2)  # triangle of height 0.1, base 0.2


def test_truth_renderer_blur_agrees_with_brute_force():
    scene = Scene(width=40, height=20, x=20.3, gap=18.0, tilt_deg=4.0, blur=1.3)
    fine = replace(scene, width=40 * 16, height=20 * 16, x=20.3 * 16, gap=18.0 * 16, blur=1.3 * 16)
    mean = clean(fine).reshape(20, 16, 40, 16).mean(axis=(1, 3))
    assert np.abs(mean - clean(scene)).max() < 1e-3
