"""Whether a length that was read moves: a noisy camera before a clamped muscle, slow strokes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gap.data.motion import frame_noise, is_white, moves
from gap.model import force as laws
from test_gap_shapes import C, still


@given(st.integers(0, 10_000), st.sampled_from([0.01, 0.1, 0.3, 0.45]), st.integers(30, 2000))
def test_a_clamped_muscle_before_a_noisy_camera_does_not_move(
    seed: int, noise_mm: float, frames: int
) -> None:
    """Quantised as well: 97 % less 3 % of white noise is 3.8 sd, which is not a motion."""
    rng = np.random.default_rng(seed)
    read = np.round(80.0 + noise_mm * rng.normal(size=frames), 1)
    assert not moves(read)


@pytest.mark.parametrize("noise_mm", [0.0, 0.02, 0.2])
def test_a_slow_stroke_moves_however_noisy_the_camera(noise_mm: float) -> None:
    rng = np.random.default_rng(4)
    stroke = 80.0 - 3.0 * np.linspace(0.0, 1.0, 400)
    assert moves(stroke + noise_mm * rng.normal(size=400))


@pytest.mark.parametrize("noise_mm", [0.02, 0.3])
def test_the_noise_of_a_camera_is_told_from_a_stroke(noise_mm: float) -> None:
    rng = np.random.default_rng(5)
    stroke = 80.0 - 3.0 * np.linspace(0.0, 1.0, 1000)
    assert frame_noise(stroke + noise_mm * rng.normal(size=1000)) == pytest.approx(noise_mm, 0.15)


def test_a_late_camera_does_not_average_the_noise_of_its_frames() -> None:
    """Half a frame late, a shift of what was read would have 0.7 of its noise, and fit better."""
    rng = np.random.default_rng(6)
    stroke = 60.0 + 5.0 * np.arange(400) * 0.01
    read = still(stroke + 0.2 * rng.normal(size=400), rate=np.full(400, 5e-3))
    late = laws.true_length(read, [("camera_delay", "", 5.0, {})], C) * 1e3
    assert np.std(late - stroke) == pytest.approx(0.2, rel=0.1)
    assert np.mean(late - stroke) == pytest.approx(0.025, abs=0.03)


@pytest.mark.parametrize("noise_mm", [0.02, 0.2])
def test_noise_is_alike_all_over_and_a_load_that_bounces_is_not(noise_mm: float) -> None:
    rng = np.random.default_rng(7)
    noise = noise_mm * rng.normal(size=600)
    since = np.arange(600) * 0.02
    step = np.where(since < 5.0, 0.0, 8.0 * (1.0 - np.exp(-np.maximum(since - 5.0, 0.0) / 0.2)))
    bounces = 3.0 * np.exp(-since / 2.0) * np.cos(2.0 * np.pi * 19.0 * since)
    assert is_white(80.0 + noise)
    assert is_white(80.0 - step + noise)
    assert not is_white(80.0 + bounces + noise)
