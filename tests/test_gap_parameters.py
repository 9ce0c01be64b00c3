"""Headlines and their intervals: what an error of form does, and what a headline means."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import t as student

from gap.check.learn import shared_spread
from gap.estimation.intervals import interval
from gap.model.pressure import laminar_drop


def test_a_form_that_halves_a_headline_is_as_likely_as_one_that_doubles_it() -> None:
    true, form = 3.0, np.log(2.0)
    for stated in (1.5, 6.0):
        low, high = interval(stated, 1e-6, form + 1e-9)
        assert low <= true <= high
    low, high = interval(-1.5, 1e-6, form + 1e-9)
    assert low <= -true <= high < 0.0


def test_noise_alone_reaches_as_far_both_ways() -> None:
    assert interval(0.2, 0.5, 0.0) == pytest.approx((-0.3, 0.7))


def test_a_laminar_leak_grows_as_the_difference_of_the_squares() -> None:
    """And passes at 400 kPa gauge what a choked orifice of the same conductance passes."""
    outside = 101_325.0
    drop = [laminar_drop.py_func(gauge + outside, outside) for gauge in (0.0, 2e5, 4e5)]
    assert drop[0] == 0.0
    assert drop[2] == pytest.approx(4e5 + outside)
    assert drop[1] / drop[2] == pytest.approx(
        (301_325.0**2 - outside**2) / (501_325.0**2 - outside**2)
    )


def test_the_spread_learnt_from_few_errors_each_covers_the_next_one() -> None:
    """Entries of very unlike spread, four errors known of each: 95 % of the fifths lie within."""
    rng = np.random.default_rng(3)
    spreads = 0.08 * np.sqrt(3.0 / rng.chisquare(3.0, 3000))
    errors = spreads[:, None] * rng.standard_normal((3000, 5))
    freedom, scale = shared_spread(errors[:60, :4].tolist())
    assert 0.05 < scale < 0.12
    assert 1.5 < freedom < 8.0
    known = freedom + 4.0
    own = np.sqrt((freedom * scale**2 + np.sum(errors[:, :4] ** 2, axis=1)) / known)
    covered = np.abs(errors[:, 4]) <= own * student.ppf(0.975, known)
    assert np.mean(covered) == pytest.approx(0.95, abs=0.015)
