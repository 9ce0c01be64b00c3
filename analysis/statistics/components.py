"""Variance components of repeated tests on several mountings and specimens.

Analysis of variance of random effects, nested: repeats within mountings within specimens. With
one specimen it is the one-way model of ISO 5725-2. Unequal numbers are weighted as there.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

FEW = 5
"""With fewer degrees of freedom a standard deviation is known to no better than a factor of 2."""


@dataclass(frozen=True)
class Component:
    """A standard deviation from an analysis of variance.

    Attributes:
        sd: standard deviation in the unit of the values; 0 where the mean square is not above
            that of the level below; NaN where there is too little to estimate it.
        dof: degrees of freedom of its mean square.
        groups: number of groups compared.
        mean_square: of this level, in the squared unit; NaN without degrees of freedom.
        p: probability of a mean square this large without any effect (F test against the level
            below); NaN where it is not defined.
        remark: why there is no value, or how far it can be relied on; "" for a good one.
    """

    sd: float
    dof: int
    groups: int
    mean_square: float
    p: float
    remark: str


@dataclass(frozen=True)
class Components:
    """Repeatability, and the standard deviations between mountings and between specimens.

    Attributes:
        mean: mean of all values.
        n: number of values.
        repeatability: of tests of one specimen in one mounting.
        mounting: between mountings of one specimen.
        specimen: between specimens; contains the mountings where each specimen has one.
        total: square root of the sum of the components' variances: of one test of any specimen
            in any mounting; NaN where none is known.
    """

    mean: float
    n: int
    repeatability: Component
    mounting: Component
    specimen: Component
    total: float


def variance_components(
    values: npt.ArrayLike, specimens: Sequence[Hashable], mountings: Sequence[Hashable]
) -> Components:
    """Estimate the components by nested analysis of variance.

    Args:
        values: one result a test, shape (n,); NaN is left out.
        specimens: specimen of each, shape (n,).
        mountings: mounting of each, shape (n,); one name in two specimens means two mountings.

    Raises:
        ValueError: no value is finite.
    """
    x = np.asarray(values, dtype=np.float64)
    used = np.isfinite(x)
    if not used.any():
        raise ValueError("no finite value")
    cells: dict[Hashable, dict[Hashable, list[float]]] = {}
    for value, specimen, mounting in zip(x[used], *_kept(used, specimens, mountings), strict=True):
        cells.setdefault(specimen, {}).setdefault(mounting, []).append(float(value))
    n = int(used.sum())
    mean = float(x[used].mean())
    groups = [(s, np.array(v)) for s, each in cells.items() for v in each.values()]
    of_specimen = {
        s: np.concatenate([np.array(v) for v in each.values()]) for s, each in cells.items()
    }

    within = sum(float(((v - v.mean()) ** 2).sum()) for _, v in groups)
    repeat_dof = n - len(groups)
    ms_repeat = within / repeat_dof if repeat_dof else math.nan
    repeatability = Component(
        math.sqrt(ms_repeat) if repeat_dof else math.nan, repeat_dof, len(groups), ms_repeat,
        math.nan, _remark(repeat_dof, "no test was repeated in one mounting"),
    )  # fmt: skip

    between = sum(len(v) * (float(v.mean()) - float(of_specimen[s].mean())) ** 2 for s, v in groups)
    mounting_dof = len(groups) - len(cells)
    per_specimen = sum(len(v) ** 2 / len(of_specimen[s]) for s, v in groups)
    variance_m, mounting = _component(
        between, mounting_dof, (n - per_specimen) / mounting_dof if mounting_dof else math.nan,
        (ms_repeat, repeat_dof), len(groups), "no specimen was mounted more than once",
    )  # fmt: skip

    across = sum(len(v) * (float(v.mean()) - mean) ** 2 for v in of_specimen.values())
    specimen_dof = len(cells) - 1
    weight = (
        (n - sum(len(v) ** 2 for v in of_specimen.values()) / n) / specimen_dof
        if specimen_dof
        else math.nan
    )
    below = (ms_repeat, repeat_dof)
    if mounting_dof and math.isfinite(variance_m) and specimen_dof:
        squares = sum(len(v) ** 2 for _, v in groups) / n
        share = (per_specimen - squares) / specimen_dof
        expected = (ms_repeat if repeat_dof else 0.0) + share * variance_m
        if not repeat_dof:
            expected = mounting.mean_square
        below = (expected, mounting_dof)
    _, specimen = _component(
        across, specimen_dof, weight, below, len(cells), "only one specimen was tested"
    )
    if specimen_dof and not mounting_dof:
        said = "contains the mountings: each specimen was mounted once"
        specimen = Component(
            **{**vars(specimen), "remark": "; ".join(filter(None, (said, specimen.remark)))}
        )
    known = [c.sd**2 for c in (repeatability, mounting, specimen) if math.isfinite(c.sd)]
    return Components(
        mean, n, repeatability, mounting, specimen, math.sqrt(sum(known)) if known else math.nan
    )


def _kept(used: npt.NDArray[np.bool_], *names: Sequence[Hashable]) -> tuple[list[Hashable], ...]:
    return tuple([one for one, use in zip(each, used, strict=True) if use] for each in names)


def _component(
    squares: float, dof: int, weight: float, below: tuple[float, int], groups: int, none: str
) -> tuple[float, Component]:
    """Variance (which may be negative) and component of a level.

    ``below``: expected mean square without it, and its degrees of freedom.
    """
    from scipy.special import fdtrc

    if not dof:
        return math.nan, Component(math.nan, 0, groups, math.nan, math.nan, none)
    mean_square = squares / dof
    base, base_dof = below
    if not math.isfinite(base):  # nothing repeated: all scatter below is in it
        said = "contains the repeatability: nothing was repeated"
        variance, p = mean_square / weight, math.nan
    else:
        said = ""
        variance = (mean_square - base) / weight
        p = float(fdtrc(dof, base_dof, mean_square / base)) if base > 0.0 and base_dof else math.nan
        if variance <= 0.0:
            said = "not distinguishable from the scatter below it"
    remark = "; ".join(filter(None, (said, _remark(dof, ""))))
    return variance, Component(math.sqrt(max(variance, 0.0)), dof, groups, mean_square, p, remark)


def _remark(dof: int, none: str) -> str:
    if not dof:
        return none
    return f"only {dof} degree{'s' if dof > 1 else ''} of freedom" if dof < FEW else ""
