"""Statistics of repeated tests against worked examples of others and against other programs."""

from __future__ import annotations

import math
import warnings

import numpy as np
import pytest
from scipy import stats

from analysis.statistics.components import variance_components
from analysis.statistics.conformity import FAIL, NOT_MEASURED, PASS, UNDECIDED, decide, overall
from analysis.statistics.control_chart import control_chart
from analysis.statistics.repeats import repeat_mean

NAN = math.nan

SULFUR = {
    1: (0.71, 0.71, 0.70, 0.71), 2: (0.69, 0.67, 0.68), 3: (0.66, 0.65, 0.69),
    4: (0.67, 0.65, 0.66), 5: (0.70, 0.69, 0.66, 0.71, 0.69), 6: (0.73, 0.74, 0.73),
    7: (0.71, 0.71, 0.69), 8: (0.70, 0.65, 0.68),
}  # fmt: skip
"""ISO 5725-2:1994, annex B.1, level 1: sulfur content of coal in %, by laboratory."""
FLOWRATE = (49.6, 47.6, 49.9, 51.3, 47.8, 51.2, 52.6, 52.4, 53.6, 52.1)
"""NIST/SEMATECH e-Handbook of Statistical Methods, section 6.3.2.2: flow rate of ten batches."""


def flat(groups: dict[int, tuple[float, ...]]) -> tuple[list[float], list[int]]:
    return [v for each in groups.values() for v in each], [k for k, v in groups.items() for _ in v]


def test_the_worked_example_of_iso_5725_gives_its_printed_figures() -> None:
    values, laboratories = flat(SULFUR)
    found = variance_components(values, [0] * len(values), laboratories)
    assert round(found.mean, 3) == 0.690
    assert round(found.repeatability.sd, 3) == 0.015
    assert round(found.total, 3) == 0.026
    assert (found.repeatability.dof, found.mounting.dof) == (19, 7)
    f = stats.f_oneway(*SULFUR.values())
    assert found.mounting.p == pytest.approx(f.pvalue)


def test_nested_components_by_hand() -> None:
    """Two specimens, two mountings each, two tests each; mean squares 2, 16 and 200."""
    values = [10, 12, 14, 16, 20, 22, 24, 26]
    found = variance_components(values, list("aaaabbbb"), [1, 1, 2, 2, 1, 1, 2, 2])
    assert found.repeatability.sd**2 == pytest.approx(2.0)
    assert found.mounting.sd**2 == pytest.approx(7.0)
    assert found.specimen.sd**2 == pytest.approx(46.0)
    assert [c.dof for c in (found.repeatability, found.mounting, found.specimen)] == [4, 2, 1]
    assert found.total == pytest.approx(math.sqrt(55.0))
    assert found.specimen.p == pytest.approx(stats.f.sf(200 / 16, 1, 2))


def test_unequal_numbers_are_weighted_so_that_no_component_is_biased() -> None:
    """Means of 400 draws of an unbalanced layout against the variances they were drawn with."""
    rng = np.random.default_rng(5)
    layout = [(s, m) for s, counts in enumerate([(3, 1), (2, 2, 4), (1, 2), (5,), (2, 3)])
              for m, n in enumerate(counts) for _ in range(n)]  # fmt: skip
    specimens, mountings = zip(*layout, strict=True)
    pairs = sorted(set(layout))
    got = []
    for _ in range(400):
        s, m = rng.normal(0, 6, 5), dict(zip(pairs, rng.normal(0, 4, len(pairs)), strict=True))
        x = [s[a] + m[a, b] + rng.normal(0, 1) for a, b in layout]
        found = variance_components(x, specimens, mountings)
        got.append([found.repeatability.sd**2, found.mounting.sd**2, found.specimen.sd**2])
    mean, error = np.mean(got, axis=0), np.std(got, axis=0) / math.sqrt(len(got))
    assert np.all(np.abs(mean - [1.0, 16.0, 36.0]) < 4 * error + [0, 0, 1.5])  # cut off at 0


def test_what_cannot_be_estimated_is_said() -> None:
    once = variance_components([1.0, 1.2, 0.9], ["a", "b", "c"], [1, 1, 1])
    assert math.isnan(once.repeatability.sd)
    assert "no test was repeated" in once.repeatability.remark
    assert "mounted more than once" in once.mounting.remark
    assert "contains the mountings" in once.specimen.remark
    assert "only 2 degrees of freedom" in once.specimen.remark
    one = variance_components([1.0, 1.1], ["a", "a"], [1, 1])
    assert "only one specimen" in one.specimen.remark
    assert one.repeatability.dof == 1
    level = variance_components([1.0, 2.0, 1.0, 2.0], ["a"] * 4, [1, 1, 2, 2])
    assert level.mounting.sd == 0.0
    assert "not distinguishable" in level.mounting.remark
    with pytest.raises(ValueError, match="no finite value"):
        variance_components([NAN], ["a"], [1])


def test_expanded_uncertainty_of_four_tests_by_hand() -> None:
    """u_A^2 = 0.02 / 3 / 4, u_B = 0.1: u^2 = 1/60, 18.75 effective degrees of freedom."""
    found = repeat_mean([10.0, 10.2, 9.8, 10.0], [0.0] * 4, [0.1] * 4)
    assert found.mean == pytest.approx(10.0)
    assert found.sd == pytest.approx(math.sqrt(0.08 / 3))
    assert found.u == pytest.approx(math.sqrt(1 / 60))
    assert found.dof == pytest.approx(18.75)
    assert found.k == pytest.approx(stats.t.ppf(0.977249868, 18.75))
    assert found.expanded == pytest.approx(found.k * found.u)


def test_a_common_error_does_not_average_and_noise_is_the_least() -> None:
    many = repeat_mean([5.0] * 100, [0.3] * 100, [0.2] * 100)
    assert many.u == pytest.approx(math.hypot(0.2, 0.03))
    assert many.k == 2.0
    single = repeat_mean([5.0], [0.03], [0.04])
    assert (single.n, single.u, single.expanded) == (1, pytest.approx(0.05), pytest.approx(0.1))
    assert math.isnan(single.sd)
    assert math.isnan(repeat_mean([5.0], [NAN], [NAN]).expanded)
    assert repeat_mean([5.0, NAN, 7.0], [0.0] * 3, [0.0] * 3).n == 2


def test_tests_within_a_mounting_are_not_independent() -> None:
    values = [10.0, 10.1, 9.9, 12.0, 12.1, 11.9]
    found = repeat_mean(values, [0.0] * 6, [0.0] * 6, [1, 1, 1, 2, 2, 2])
    assert found.u == pytest.approx(math.sqrt(2.0) / math.sqrt(2))  # of the means 10 and 12
    assert found.dof == pytest.approx(1.0)
    assert found.n == 6


def test_the_control_chart_of_the_nist_handbook() -> None:
    """Printed with d2 = 1.128: centre 50.81, limits 45.8159 and 55.8041."""
    chart = control_chart(FLOWRATE)
    assert chart.centre == pytest.approx(50.81)
    assert (chart.lower, chart.upper) == pytest.approx((45.8159, 55.8041), abs=0.002)
    assert chart.ranges.mean() == pytest.approx(1.8778, abs=1e-4)
    assert chart.in_control
    assert "provisional" in chart.remark


@pytest.mark.parametrize(
    ("values", "rule", "at"),
    [
        ((0, 0, 3.1), "beyond", (2,)),
        ((0.5,) * 9, "side", (8,)),
        ((0.5,) * 8, "side", None),
        ((-1.0, -0.6, -0.2, 0.2, 0.6, 1.0), "trend", (5,)),
        ((-1.0, -0.6, -0.2, 0.2, 0.6, 0.6), "trend", None),
        ((2.1, 0.0, 2.1), "warning", (2,)),
        ((2.1, 0.0, -2.1), "warning", None),
        ((-1.9, 1.9), "range", (1,)),
        ((-1.8, 1.8), "range", None),
    ],
)
def test_run_rules(values: tuple[float, ...], rule: str, at: tuple[int, ...] | None) -> None:
    """With stated centre 0 and standard deviation 1; a moving range may reach 3.69."""
    assert control_chart(values, stated=(0.0, 1.0)).alarms.get(rule) == at


def test_limits_from_the_first_values_judge_the_later_ones() -> None:
    chart = control_chart([*FLOWRATE, 60.0], base=10)
    assert chart.upper == pytest.approx(control_chart(FLOWRATE).upper)
    assert chart.alarms["beyond"] == (10,)
    with pytest.raises(ValueError, match="limits need from 2 to 2"):
        control_chart([1.0, 2.0], base=3)
    with pytest.raises(ValueError, match="not finite"):
        control_chart([1.0, NAN])


@pytest.mark.parametrize(
    ("value", "verdict"),
    [(10.0, PASS), (9.1, PASS), (8.95, UNDECIDED), (9.0, UNDECIDED), (8.85, FAIL),
     (11.05, UNDECIDED), (11.2, FAIL), (NAN, NOT_MEASURED)],
)  # fmt: skip
def test_a_result_is_undecided_where_its_interval_straddles_a_limit(
    value: float, verdict: str
) -> None:
    assert decide(value, 0.1, 9.0, 11.0) == verdict


def test_other_rules_of_decision() -> None:
    assert decide(8.95, 0.1, 9.0, None, guard=0.0) == FAIL
    assert decide(9.0, NAN, 9.0, None, guard=0.0) == PASS
    assert decide(9.5, NAN, 9.0, None) == UNDECIDED, "nothing is known of its uncertainty"
    assert decide(9.15, 0.1, 9.0, None, guard=2.0) == UNDECIDED
    assert overall([PASS, UNDECIDED]) == UNDECIDED
    assert overall([UNDECIDED, FAIL, NOT_MEASURED]) == FAIL
    assert overall([PASS, NOT_MEASURED]) == NOT_MEASURED
    assert overall([]) == ""


@pytest.mark.parametrize("value", [13.854321, 0.0, -0.1])
def test_equal_values_break_no_rule(value: float) -> None:
    """Runs of the virtual bench may be equal to the bit; the mean of three is not always."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        chart = control_chart([value] * 12)
    assert chart.in_control
    assert chart.sd == 0.0
    later = control_chart([value] * 12 + [value + 1.0], base=12)
    assert later.alarms["beyond"] == (12,)
