"""The camera's delay from the sync LED, on frames of the virtual bench at 50 frames/s."""

from __future__ import annotations

import numpy as np
import pytest

from rigs.virtual.emulators.pictures.camera import CameraModel, led_exposure, render
from vision.syncled import (
    SyncError,
    count_dropped,
    find_delay,
    led_level,
    patch_row_shift,
    pattern,
)

START_S = 1.0


def seen(delay_s, seed, model, rng, bit_ms=13.0, frames=100, lost=()):
    """LED levels and stamps of frames whose stamps are ``delay_s`` late."""
    bits = pattern(seed, 400)
    changes = np.flatnonzero(np.diff(np.concatenate([[0], bits])))
    toggles = START_S + changes * bit_ms / 1000
    levels, stamps = [], []
    first = START_S + 0.25 + rng.uniform(0, 0.02)
    for k in range(frames):
        if k in lost:
            continue
        at = first + 0.02 * k
        frame = render(55.0, rng, model, led=led_exposure(toggles, at, model))
        levels.append(led_level(frame, model.led_patch))
        stamps.append(at + delay_s)
    return np.array(levels), np.array(stamps)


def check(shutter, trials, seed):
    readout = {"global": 0.0, "rolling": 0.015}[shutter]
    rng = np.random.default_rng([seed, len(shutter)])
    errors = []
    for k in range(trials):
        model = CameraModel(
            exposure_s=float(rng.uniform(0.002, 0.01)),
            readout_s=readout,
            led=(60.0, float(rng.uniform(30, 440)), 9.0),
        )
        delay = 0.08 * k / max(1, trials - 1)
        lfsr = int(rng.integers(1, 65536))
        levels, stamps = seen(delay, lfsr, model, rng)
        got = find_delay(
            levels,
            stamps,
            START_S,
            lfsr,
            13.0,
            exposure_s=model.exposure_s,
            row_shift_s=patch_row_shift(model.led_patch, model.height, readout),
        )
        errors.append(got.delay_s - delay)
        assert abs(errors[-1]) < max(5 * got.u_delay_s, 2e-4)
        assert got.u_delay_s < 1e-3
    worst = float(np.abs(errors).max())
    print(f"\n{shutter} shutter: worst delay error {1e3 * worst:.3f} ms in {trials}")
    assert worst < 1e-3


@pytest.mark.parametrize("shutter", ["global", "rolling"])
def test_delay_of_0_to_80_ms_within_1_ms(shutter):
    check(shutter, 5, 1)


@pytest.mark.campaign
@pytest.mark.parametrize("shutter", ["global", "rolling"])
def test_delay_full(shutter):
    check(shutter, 81, 2)


def test_dropped_frames_are_counted_and_do_no_harm():
    rng = np.random.default_rng(3)
    model = CameraModel()
    levels, stamps = seen(0.031, 77, model, rng, lost={20, 21, 50})
    got = find_delay(levels, stamps, START_S, 77, 13.0, exposure_s=model.exposure_s)
    assert got.dropped == 3 == count_dropped(stamps, 0.02)
    assert abs(got.delay_s - 0.031) < 1e-3


def test_repeated_frames_are_left_out():
    rng = np.random.default_rng(4)
    model = CameraModel()
    levels, stamps = seen(0.02, 99, model, rng)
    stale = np.zeros(len(levels), dtype=bool)
    stale[30:33] = True
    levels[30:33] = levels[29]
    got = find_delay(levels, stamps, START_S, 99, 13.0, exposure_s=model.exposure_s, repeated=stale)
    assert got.repeated == 3
    assert abs(got.delay_s - 0.02) < 1e-3


def test_dark_led_and_wrong_seed_are_refused():
    rng = np.random.default_rng(5)
    model = CameraModel()
    levels, stamps = seen(0.02, 99, model, rng)
    with pytest.raises(SyncError, match="does not show"):
        find_delay(levels, stamps, START_S, 4242, 13.0, exposure_s=model.exposure_s)
    with pytest.raises(SyncError, match="does not show"):
        find_delay(rng.normal(0, 0.1, 100), stamps, START_S, 99, 13.0, exposure_s=0.004)
    with pytest.raises(SyncError, match="at least 20"):
        find_delay(levels[:10], stamps[:10], START_S, 99, 13.0, exposure_s=0.004)


def test_pattern_that_beats_with_the_frames_says_how_little_it_knows():
    """A 20 ms bit changes at the same phase of every frame: only an interval is known."""
    rng = np.random.default_rng(6)
    model = CameraModel(exposure_s=0.004)
    levels, stamps = seen(0.033, 1234, model, rng, bit_ms=20.0)
    got = find_delay(levels, stamps, START_S, 1234, 20.0, exposure_s=0.004)
    assert got.u_delay_s > 1e-3
    assert abs(got.delay_s - 0.033) < 2.5 * got.u_delay_s


def test_pattern_is_the_firmwares():
    from valvefw.wire import lfsr_next

    for seed in (1, 0xACE1, 65535):
        state, bits = seed, []
        for _ in range(500):
            bits.append(state & 1)
            state = lfsr_next(state)
        assert list(pattern(seed, 500)) == bits
