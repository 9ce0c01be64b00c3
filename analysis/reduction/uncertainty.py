"""Type A standard uncertainty of the mean of a settled window, with the resolution."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

FEW_INDEPENDENT = 5.0
"""With fewer independent samples than this, a window does not give a reliable noise estimate."""

FEWEST_FOR_TREND = 8
"""A straight line is taken from this many readings or more."""


@dataclass(frozen=True)
class WindowMean:
    """Mean of a window of readings, with its standard uncertainty estimated from the window.

    Attributes:
        mean: mean of the readings, in their unit; NaN if there were none.
        u: standard uncertainty of the mean from noise and resolution. It is increased by
            Student's t so that k = 2 covers 95 % for any number of independent readings.
        n: number of readings.
        n_effective: equivalent number of independent readings.
        sd: standard deviation of a single reading.
    """

    mean: float
    u: float
    n: int
    n_effective: float
    sd: float


NO_READINGS = WindowMean(math.nan, math.nan, 0, 0.0, math.nan)


def correlation_time(values: npt.NDArray[np.float64]) -> float:
    """Integrated autocorrelation time of a window, in samples, at least 1.

    The estimator is Geyer's initial positive monotone sequence of the sample autocovariance.
    Subtraction of the window's own mean removes the variance of that mean from every
    autocovariance. This makes short windows appear less correlated; an iteration corrects it.

    Args:
        values: shape (n,), equally spaced in time.

    Returns:
        1 + 2 sum of autocorrelations, between 1 and n / 3.
    """
    n = len(values)
    if n < 4:
        return 1.0
    deviation = values - values.mean()
    size = 1 << (2 * n - 1).bit_length()
    spectrum = np.fft.rfft(deviation, size)
    covariance = np.fft.irfft(spectrum * np.conj(spectrum), size)[:n] / (n - np.arange(n))
    if covariance[0] <= 0.0:
        return 1.0
    variance_of_mean = 0.0
    tau = 1.0
    for _ in range(3):
        rho = (covariance + variance_of_mean) / (covariance[0] + variance_of_mean)
        pairs = rho[0 : 2 * (n // 4) : 2] + rho[1 : 2 * (n // 4) : 2]
        stop = np.flatnonzero(pairs <= 0.0)
        positive = np.minimum.accumulate(pairs[: stop[0]] if len(stop) else pairs)
        tau = float(min(max(2.0 * positive.sum() - 1.0, 1.0), n / 3.0))
        variance_of_mean = (covariance[0] + variance_of_mean) * tau / n
    return tau


def window_mean(
    values: npt.NDArray[np.float64], resolution: float = 0.0, trend: bool = False
) -> WindowMean:
    """Mean of a settled window and its standard uncertainty from noise and resolution.

    The resolution is added as that of one reading (step / sqrt 12) only if the noise is below
    half a step. With more noise the rounding is already part of the scatter and decreases on
    averaging.

    Args:
        values: shape (n,), readings equally spaced in time, in the unit of the result.
        resolution: one step of the instrument, same unit.
        trend: the quantity changes steadily in the window: what follows a straight line is no
            noise. Has no effect on fewer than ``FEWEST_FOR_TREND`` readings.

    Returns:
        WindowMean. For a single reading ``u`` is that of the resolution, NaN if the resolution
        is not known. Without readings all values are NaN.
    """
    n = len(values)
    u_resolution = resolution / math.sqrt(12.0)
    if n == 0:
        return NO_READINGS
    mean = float(values.mean())
    if n == 1:
        return WindowMean(mean, u_resolution if resolution > 0 else math.nan, 1, 1.0, math.nan)
    if trend and n >= FEWEST_FOR_TREND:
        at = np.arange(n) - (n - 1) / 2.0
        values = values - at * (float(at @ values) / float(at @ at))
    tau = min(correlation_time(values), n / 2.0)
    n_effective = n / tau
    variance = float(values.var()) / (1.0 - 1.0 / n_effective)
    sd = math.sqrt(variance)
    u_noise = sd / math.sqrt(n_effective) * student_ratio(n_effective - 1.0)
    if sd < resolution / 2.0:
        u_noise = math.hypot(u_noise, u_resolution)
    return WindowMean(mean, u_noise, n, n_effective, sd)


def student_ratio(degrees_of_freedom: float) -> float:
    """Student's two-sided 95.45 % quantile divided by 2, so that k = 2 covers 95.45 %."""
    from scipy.special import stdtrit

    return float(stdtrit(max(degrees_of_freedom, 1.0), 0.977249868)) / 2.0
