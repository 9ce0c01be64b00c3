"""Readings at the end of what an instrument can show."""

from __future__ import annotations

import numpy as np
import pytest

from gap.model.clipping import at_lower_end

STEP_KPA = 0.244


def reading(zero_kpa: float, noise_kpa: float, ends: bool, seed: int = 1) -> np.ndarray:
    """A gauge at rest and then at 300 kPa, in steps of a 12-bit converter."""
    rng = np.random.default_rng(seed)
    true = np.repeat([0.0, 300.0], 2000) + zero_kpa
    read = STEP_KPA * np.round((true + rng.normal(0.0, noise_kpa, len(true))) / STEP_KPA)
    return np.maximum(read, 0.0) if ends else read


@pytest.mark.parametrize("zero_kpa", [-1.5, -0.45, -0.1])
def test_noise_that_stops_at_the_lowest_reading_shows_its_end(zero_kpa: float) -> None:
    read = reading(zero_kpa, 0.2, ends=True)
    found = at_lower_end(read)
    assert np.array_equal(found, read == 0.0)


@pytest.mark.parametrize("zero_kpa", [-0.45, 0.0, 2.0])
def test_a_gauge_that_reads_below_its_zero_ends_nowhere(zero_kpa: float) -> None:
    assert not at_lower_end(reading(zero_kpa, 0.2, ends=False)).any()


def test_a_reading_without_noise_ends_nowhere() -> None:
    assert not at_lower_end(reading(0.0, 0.0, ends=True)).any()
    assert not at_lower_end(np.repeat([0.0, 100.0, 200.0, 300.0], 100)).any()
    assert not at_lower_end(np.zeros(0)).any()
