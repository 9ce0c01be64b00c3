"""Mean of repeated tests with its expanded uncertainty (GUM, JCGM 100:2008)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

COVERAGE = 0.954499736
"""Coverage probability of k = 2 for a normal distribution; the factor k belongs to it."""


@dataclass(frozen=True)
class RepeatMean:
    """Mean of repeated tests.

    Attributes:
        mean: arithmetic mean, in the unit of the values.
        sd: standard deviation of a single test; NaN for fewer than two.
        n: number of tests.
        u: combined standard uncertainty of the mean.
        dof: its effective degrees of freedom (Welch and Satterthwaite, GUM G.4.1).
        k: coverage factor: Student's t for `dof` and 95.45 %.
        expanded: k u; NaN where no uncertainty is known.
    """

    mean: float
    sd: float
    n: int
    u: float
    dof: float
    k: float
    expanded: float


def repeat_mean(
    values: npt.ArrayLike,
    u_noise: npt.ArrayLike,
    u_common: npt.ArrayLike,
    mountings: Sequence[Any] | None = None,
) -> RepeatMean:
    """Mean of repeated tests; the part of the uncertainty that they share does not average.

    The random part is the standard deviation of the mean. With two or more mountings it is taken
    from the means of the mountings, because tests within one are not independent. It is never
    less than what the noise of the single tests accounts for.

    Args:
        values: results of the tests, shape (n,); NaN is left out.
        u_noise: standard uncertainty of each from its own noise, shape (n,); NaN: not known.
        u_common: standard uncertainty common to all (calibration), shape (n,); NaN: not known.
        mountings: the mounting of each test, shape (n,); None: one for all.

    Raises:
        ValueError: no value is finite.
    """
    x, noise, common = (np.asarray(a, dtype=np.float64) for a in (values, u_noise, u_common))
    used = np.isfinite(x)
    if not used.any():
        raise ValueError("no finite value")
    x, noise, common = x[used], noise[used], common[used]
    n = len(x)
    mean = float(x.mean())
    sd = float(x.std(ddof=1)) if n > 1 else math.nan
    observed = x
    if mountings is not None:
        names = [name for name, use in zip(mountings, used, strict=True) if use]
        if len(set(names)) > 1:
            observed = np.array(
                [np.mean([v for v, m in zip(x, names, strict=True) if m == name])
                 for name in dict.fromkeys(names)]
            )  # fmt: skip
    u_random, dof = math.nan, math.inf
    if len(observed) > 1:
        dof = len(observed) - 1.0
        u_random = float(observed.std(ddof=1)) / math.sqrt(len(observed))
    u_reading = float(np.sqrt(np.sum(noise**2))) / n if np.isfinite(noise).all() else math.nan
    if math.isfinite(u_reading) and not u_random >= u_reading:
        u_random, dof = u_reading, math.inf  # a window's noise is already increased by its own t
    shared = common[np.isfinite(common)]
    parts = [part for part in (u_random, float(shared.mean()) if len(shared) else math.nan)
             if math.isfinite(part)]  # fmt: skip
    if not parts:
        return RepeatMean(mean, sd, n, math.nan, math.nan, math.nan, math.nan)
    u = math.hypot(*parts)
    effective = dof * (u / u_random) ** 4 if math.isfinite(dof) and u_random > 0.0 else math.inf
    k = coverage_factor(effective)
    return RepeatMean(mean, sd, n, u, effective, k, k * u)


def coverage_factor(dof: float) -> float:
    """Student's two-sided factor for 95.45 %; 2 for infinite degrees of freedom."""
    from scipy.special import stdtrit

    return float(stdtrit(dof, 0.5 + COVERAGE / 2.0)) if math.isfinite(dof) else 2.0
