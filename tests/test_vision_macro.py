"""The macro against a second implementation written from the description alone."""

from __future__ import annotations

import numpy as np
import pytest

from vision.gray import RegionError
from vision.macro import NoMarker, measure_macro


def by_the_book(gray, threshold, roi, flip):
    """NIH Image step by step on plain lists: flip, threshold, binary, plot, scan."""
    width = gray.shape[1]
    left, top, roi_width, roi_height = roi
    for column in range(roi_width):
        total = 0
        for row in range(roi_height):
            x = left + column
            if flip:
                x = width - 1 - x
            nih = 255 - int(gray[top + row, x])
            binary = 255 if nih >= threshold else 0
            total += binary
        if total / roi_height != 0:
            return column
    return None


def random_case(rng):
    """Noise, specks, nothing at all, or a marker, also at the region's borders."""
    height, width = int(rng.integers(20, 60)), int(rng.integers(30, 90))
    roi_width, roi_height = int(rng.integers(1, width + 1)), int(rng.integers(1, height + 1))
    roi = (
        int(rng.integers(0, width - roi_width + 1)),
        int(rng.integers(0, height - roi_height + 1)),
        roi_width,
        roi_height,
    )
    threshold = int(rng.choice([130, 130, 1, 255, rng.integers(2, 255)]))
    kind = rng.integers(0, 5)
    if kind == 0:
        gray = rng.integers(0, 256, (height, width))
    elif kind == 1:
        gray = np.full((height, width), rng.integers(126, 256))
    else:
        gray = rng.integers(126, 256, (height, width))
        if kind == 2:
            for _ in range(int(rng.integers(1, 4))):
                gray[rng.integers(0, height), rng.integers(0, width)] = rng.integers(0, 130)
        elif kind == 3:
            first = int(rng.integers(0, width))
            gray[:, first : first + int(rng.integers(1, 20))] = rng.integers(0, 126)
        else:  # on the first or last column of the region
            column = roi[0] if rng.random() < 0.5 else roi[0] + roi_width - 1
            gray[:, column] = 125
            gray[:, width - 1 - column] = 125
    return gray.astype(np.uint8), threshold, roi, bool(rng.random() < 0.7)


def check(seed, count):
    rng = np.random.default_rng(seed)
    none = 0
    for _ in range(count):
        gray, threshold, roi, flip = random_case(rng)
        expected = by_the_book(gray, threshold, roi, flip)
        if expected is None:
            none += 1
            with pytest.raises(NoMarker):
                measure_macro(gray, threshold, roi, flip)
        else:
            assert measure_macro(gray, threshold, roi, flip) == expected
    assert 0.05 * count < none < 0.6 * count  # both outcomes were tried


def test_equals_the_description_on_2000_random_frames():
    check(11, 2000)


def test_defaults_are_the_thesis_ones_on_full_frames():
    rng = np.random.default_rng(12)
    for _ in range(10):
        gray = rng.integers(126, 256, (480, 640)).astype(np.uint8)
        first = int(rng.integers(130, 629))
        gray[:, :first] = 30
        assert by_the_book(gray, 130, (10, 300, 500, 70), True) == 630 - first
        assert measure_macro(gray) == 630 - first


def test_grey_125_is_marked_and_126_is_not():
    gray = np.full((480, 640), 255, np.uint8)
    gray[:, 400] = 126
    with pytest.raises(NoMarker, match="no marker"):
        measure_macro(gray)
    gray[:, 400] = 125
    assert measure_macro(gray) == 639 - 400 - 10


def test_one_speck_ends_the_count_as_in_the_original():
    gray = np.full((480, 640), 255, np.uint8)
    gray[:, :300] = 0
    gray[333, 600] = 0
    assert measure_macro(gray) == 29


def test_region_outside_the_frame_is_said_so():
    with pytest.raises(RegionError, match="320 x 240"):
        measure_macro(np.zeros((240, 320), np.uint8))
