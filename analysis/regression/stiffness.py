"""Stiffness, torque and equilibrium of a joint at each pair of pressures, with uncertainty.

Locked at some angles, the torque at one pair of pressures is a polynomial in the angle. Its slope
with the sign changed is the stiffness. Random errors (readings, friction) come from the points and
their scatter about the polynomial; zeros and gains of the sensors are common to all points and are
added as such (GUM, JCGM 100:2008, 5.1 and 5.2).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from plant.arrays import Array

if TYPE_CHECKING:
    import pandas as pd

DEGREE = 2
"""Of the polynomial, where there are so many more angles. The ideal braid's is of this degree."""
MOST_CONDITION = 50.0
"""Of the scaled design of the pressure slopes. Beyond it they would be wrong by some tens of per
cent: a pair of pressures is measured to 1 part in 500, a torque to 1 in 100."""
_RAD = math.pi / 180.0


@dataclass(frozen=True)
class SensorErrors:
    """Standard uncertainties that all points have in common.

    Attributes:
        torque_zero_n_m, torque_gain: of the torque; the gain is relative.
        angle_zero_deg, angle_gain: of the angle.
    """

    torque_zero_n_m: float
    torque_gain: float
    angle_zero_deg: float
    angle_gain: float


@dataclass(frozen=True)
class LockedCell:
    """Torque and stiffness at one pair of pressures.

    Attributes:
        common_kpa, difference_kpa: the set-points; everything is stated for them.
        angle_deg: middle of the locked angles; torque and stiffness are those at it.
        torque_n_m, stiffness_n_m_rad: with ``u_`` each.
        equilibrium_deg: angle without torque, NaN outside the locked angles.
        points, angles: how many there were.
        scatter_n_m: root mean square about the polynomial.
        friction_n_m: half the largest difference between rising and falling pressure at any angle
            and pair; its rectangular distribution is part of all uncertainties. 0 with one
            direction alone: friction is not known then.
    """

    common_kpa: float
    difference_kpa: float
    angle_deg: float
    torque_n_m: float
    u_torque_n_m: float
    stiffness_n_m_rad: float
    u_stiffness_n_m_rad: float
    equilibrium_deg: float
    u_equilibrium_deg: float
    points: int
    angles: int
    scatter_n_m: float
    friction_n_m: float


@dataclass(frozen=True)
class FreeCell:
    """Equilibrium angle at one pair of pressures, the joint free.

    Attributes:
        hysteresis_deg: rising less falling difference; NaN with one direction.
    """

    common_kpa: float
    difference_kpa: float
    angle_deg: float
    u_angle_deg: float
    hysteresis_deg: float
    points: int


@dataclass(frozen=True)
class _Slopes:
    """dT/dp of either muscle, linear in the angle: (at 0, per rad), N m/kPa."""

    a: tuple[float, float]
    b: tuple[float, float]

    def at(self, angle_rad: float) -> tuple[float, float]:
        return self.a[0] + self.a[1] * angle_rad, self.b[0] + self.b[1] * angle_rad


def locked_cells(table: pd.DataFrame, errors: SensorErrors) -> list[LockedCell]:
    """Each pair of pressures at which the joint was locked at two angles or more.

    Args:
        table: points of a static test.
        errors: of torque and angle.
    """
    locked = table[table["state"].isin(["locked", "a", "b"]) & table["settled"]]
    if len(locked) < 2:
        return []
    slopes = _pressure_slopes(locked)
    both = locked[locked["state"] == "locked"]
    friction = _halved(both, "torque_n_m")
    cells = []
    for pair, rows in _pairs(both):
        angles = _distinct(rows["set_angle_deg"])
        if angles >= 2:
            cells.append(_locked_cell(pair, rows, slopes, errors, friction))
    return cells


def free_cells(
    table: pd.DataFrame,
    angle_zero_deg: float,
    angle_gain: float,
    locked: Sequence[LockedCell] = (),
) -> list[FreeCell]:
    """The equilibrium angle of each pair of pressures, for its set-points.

    A joint that swings in comes to rest anywhere within its friction, so that rising and falling
    pressure may differ by less than that. Where the locked joint has shown more, that counts.
    """
    free = table[(table["state"] == "free") & table["settled"]]
    if not len(free):
        return []
    a, b = (free[f"pressure_{k}_kpa"].to_numpy(float) for k in "ab")
    per_ratio = _per_ratio((a - b) / (a + b), free["angle_deg"].to_numpy(float))
    friction = max(
        _halved(free, "angle_deg"),
        *(cell.friction_n_m / cell.stiffness_n_m_rad / _RAD for cell in locked),
        0.0,
    )
    cells = []
    for (common, difference), rows in _pairs(free):
        slope_a, slope_b = _angle_slopes(common, difference, per_ratio)
        angle = rows["angle_deg"].to_numpy(float)
        angle = angle + slope_a * (rows["set_a_kpa"] - rows["pressure_a_kpa"]).to_numpy(float)
        angle = angle + slope_b * (rows["set_b_kpa"] - rows["pressure_b_kpa"]).to_numpy(float)
        up, down = (angle[(rows["direction"] == d).to_numpy()] for d in ("up", "down"))
        gap = float(up.mean() - down.mean()) if len(up) and len(down) else math.nan
        mean = float(angle.mean())
        noise = rows[["u_angle_deg_noise"]].to_numpy(float)
        pressure_noise = np.hypot(
            slope_a * rows["u_pressure_a_kpa_noise"].to_numpy(float),
            slope_b * rows["u_pressure_b_kpa_noise"].to_numpy(float),
        )
        parts = [
            math.sqrt(float(np.sum(noise**2) + np.sum(pressure_noise**2))) / len(rows),
            float(angle.std(ddof=1)) / math.sqrt(len(angle)) if len(angle) > 3 else 0.0,
            friction / math.sqrt(3.0),
            angle_zero_deg,
            angle_gain * mean,
            slope_a * float(rows["u_pressure_a_kpa_cal"].mean()),
            slope_b * float(rows["u_pressure_b_kpa_cal"].mean()),
        ]
        cells.append(FreeCell(common, difference, mean, math.hypot(*parts), gap, len(rows)))
    return cells


def _pairs(rows: pd.DataFrame) -> list[tuple[tuple[float, float], pd.DataFrame]]:
    """The points of each pair of set-points: common and differential pressure."""
    pairs = rows[["common_kpa", "difference_kpa"]].drop_duplicates().to_numpy(float)
    out = []
    for common, difference in sorted(map(tuple, pairs.tolist())):
        use = (rows["common_kpa"] == common) & (rows["difference_kpa"] == difference)
        out.append(((common, difference), rows[use]))
    return out


def _halved(rows: pd.DataFrame, column: str) -> float:
    """Half the largest difference between rising and falling pressure; 0 without both.

    At the ends of a path both points have come from the same side, so that theirs alone says
    nothing.
    """
    found = [0.0]
    for _, pair in _pairs(rows):
        for _, own in pair.groupby("set_angle_deg", dropna=False):
            up, down = (own.loc[own["direction"] == d, column] for d in ("up", "down"))
            if len(up) and len(down):
                found.append(abs(float(up.mean()) - float(down.mean())) / 2.0)
    return max(found)


def _locked_cell(
    key: tuple[float, float],
    rows: pd.DataFrame,
    slopes: _Slopes,
    errors: SensorErrors,
    friction_n_m: float,
) -> LockedCell:
    angles = _distinct(rows["set_angle_deg"])
    theta = rows["angle_deg"].to_numpy(float) * _RAD
    middle = float(theta.min() + theta.max()) / 2.0
    x = theta - middle
    at_a, at_b = (np.nan_to_num(at) for at in slopes.at(theta))  # type: ignore[arg-type]
    torque = rows["torque_n_m"].to_numpy(float)
    torque = torque + at_a * (rows["set_a_kpa"] - rows["pressure_a_kpa"]).to_numpy(float)
    torque = torque + at_b * (rows["set_b_kpa"] - rows["pressure_b_kpa"]).to_numpy(float)
    degree = min(DEGREE, angles - 1)
    u_friction = friction_n_m / math.sqrt(3.0)
    first = np.polyfit(x, torque, degree)
    slope = np.polyval(np.polyder(first), x)
    u = np.sqrt(
        rows["u_torque_n_m_noise"].to_numpy(float) ** 2
        + (slope * rows["u_angle_deg_noise"].to_numpy(float) * _RAD) ** 2
        + (at_a * rows["u_pressure_a_kpa_noise"].to_numpy(float)) ** 2
        + (at_b * rows["u_pressure_b_kpa_noise"].to_numpy(float)) ** 2
        + u_friction**2 * len(rows) / angles  # the points of an angle may have it in common
    )
    value, covariance, scatter = _weighted(x, torque, u, degree)
    noughts = np.concatenate([value, np.zeros(3 - len(value))])  # constant, linear, quadratic
    u_constant, u_linear = (math.sqrt(covariance[k, k]) for k in (0, 1))
    u_a, u_b = (float(rows[f"u_pressure_{k}_kpa_cal"].mean()) for k in "ab")
    mid_a, mid_b = slopes.at(middle)
    stiffness = -float(noughts[1])
    u_zero = errors.angle_zero_deg * _RAD
    u_stiffness = math.hypot(
        u_linear,
        stiffness * errors.torque_gain,
        stiffness * errors.angle_gain,
        2.0 * float(noughts[2]) * u_zero,
        slopes.a[1] * u_a,
        slopes.b[1] * u_b,
    )
    u_torque = math.hypot(
        u_constant,
        u_friction,
        errors.torque_zero_n_m,
        errors.torque_gain * float(noughts[0]),
        stiffness * math.hypot(u_zero, errors.angle_gain * middle),
        mid_a * u_a,
        mid_b * u_b,
    )
    rest = _root(noughts, float(x.min()), float(x.max()))
    at_rest = -float(noughts[1] + 2.0 * noughts[2] * rest) if math.isfinite(rest) else math.nan
    return LockedCell(
        *key,
        angle_deg=middle / _RAD,
        torque_n_m=float(noughts[0]),
        u_torque_n_m=u_torque,
        stiffness_n_m_rad=stiffness,
        u_stiffness_n_m_rad=u_stiffness,
        equilibrium_deg=(middle + rest) / _RAD,
        u_equilibrium_deg=math.hypot(u_torque, rest * u_linear) / abs(at_rest) / _RAD,
        points=len(rows),
        angles=angles,
        scatter_n_m=scatter,
        friction_n_m=friction_n_m,
    )


def _weighted(x: Array, y: Array, u: Array, degree: int) -> tuple[Array, Array, float]:
    """Coefficients (constant first), their covariance, and the scatter.

    The covariance is that of the stated uncertainties, or of the scatter where this is larger, with
    Student's t for its few degrees of freedom.
    """
    from scipy.special import stdtrit

    design = np.vander(x, degree + 1, increasing=True)
    weight = 1.0 / np.maximum(u, 1e-12)
    value, *_ = np.linalg.lstsq(design * weight[:, None], y * weight, rcond=None)
    covariance = np.linalg.inv((design * weight[:, None]).T @ (design * weight[:, None]))
    left = y - design @ value
    freedom = len(x) - degree - 1
    if freedom > 0:
        excess = float(np.sum((left * weight) ** 2)) / freedom
        if excess > 1.0:
            covariance = covariance * excess * (float(stdtrit(freedom, 0.977249868)) / 2.0) ** 2
    return np.asarray(value), np.asarray(covariance), float(np.sqrt(np.mean(left**2)))


def _root(noughts: Array, low: float, high: float) -> float:
    """Where the polynomial is 0, between two ends; NaN where it is not."""
    found = [
        float(r.real)
        for r in np.roots(noughts[::-1])
        if abs(r.imag) < 1e-12 and low <= r.real <= high
    ]
    return min(found, key=abs) if found else math.nan


def _pressure_slopes(locked: pd.DataFrame) -> _Slopes:
    """How the torque follows either pressure: no torque without pressure, linear in the angle.

    It only corrects the small difference of the pressures from their set-points, and carries the
    uncertainty of their calibrations. Where too few pairs were measured to tell the muscles apart,
    they count as equal; where even that does not decide, the slopes are NaN, and with them the
    uncertainties of the cell.
    """
    theta = locked["angle_deg"].to_numpy(float) * _RAD
    torque = locked["torque_n_m"].to_numpy(float)
    a, b = (locked[f"pressure_{k}_kpa"].to_numpy(float) for k in "ab")
    own = _decided(np.column_stack([a, a * theta, b, b * theta]), torque)
    if own is not None:
        return _Slopes((float(own[0]), float(own[1])), (float(own[2]), float(own[3])))
    equal = _decided(np.column_stack([a - b, (a + b) * theta]), torque)
    if equal is None:
        return _Slopes((math.nan, math.nan), (math.nan, math.nan))
    return _Slopes((float(equal[0]), float(equal[1])), (-float(equal[0]), float(equal[1])))


def _decided(design: Array, torque: Array) -> Array | None:
    """Least squares, None where the points do not decide."""
    scaled = design / np.maximum(np.abs(design).max(axis=0), 1e-12)
    if len(torque) < design.shape[1] or np.linalg.cond(scaled) > MOST_CONDITION:
        return None
    found, *_ = np.linalg.lstsq(design, torque, rcond=None)
    return np.asarray(found)


def _per_ratio(ratio: Array, angle_deg: Array) -> float:
    """Angle per ratio of differential to common pressure; NaN where the ratio did not change."""
    if np.ptp(ratio) < 1e-3:
        return math.nan
    return float(np.polyfit(ratio, angle_deg, 1)[0])


def _angle_slopes(common: float, difference: float, per_ratio: float) -> tuple[float, float]:
    """Angle per pressure of muscle a and b, deg/kPa; 0 where it is not known.

    The equilibrium of two equal muscles depends on (a - b) / (a + b) alone, as long as their forces
    are proportional to their pressures.
    """
    if not math.isfinite(per_ratio):
        return 0.0, 0.0
    a, b = common + difference / 2.0, common - difference / 2.0
    return per_ratio * 2.0 * b / (a + b) ** 2, -per_ratio * 2.0 * a / (a + b) ** 2


def _distinct(values: pd.Series[Any]) -> int:
    return int(values.round(6).nunique())


def as_rows(cells: list[LockedCell] | list[FreeCell]) -> list[Mapping[str, Any]]:
    """Cells as plain rows."""
    return [dict(vars(cell)) for cell in cells]
