"""Figures of ways that take turns, so that a busy machine is busy for all of them alike."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Spread:
    """Median and range of paired repeats."""

    median: float
    low: float
    high: float

    @staticmethod
    def of(values: Sequence[float]) -> Spread:
        known = [v for v in values if math.isfinite(v)]
        if not known:
            return Spread(math.nan, math.nan, math.nan)
        return Spread(float(np.median(known)), min(known), max(known))

    def __str__(self) -> str:
        return f"{short(self.median)} ({short(self.low)} to {short(self.high)})"


def short(value: float) -> str:
    """Three digits, without an exponent where a reader does not need one."""
    if not math.isfinite(value):
        return "none"
    if value == 0.0:
        return "0"
    if not 1e-4 <= abs(value) < 1e7:
        return f"{value:.1e}"
    digits = max(0, 2 - math.floor(math.log10(abs(value))))
    return f"{round(value, digits):,.{digits}f}" if digits else f"{float(f'{value:.3g}'):,.0f}"


def ratios(theirs: Sequence[float], ours: Sequence[float]) -> Spread:
    """Theirs over ours, round by round."""
    return Spread.of([a / b if b else math.nan for a, b in zip(theirs, ours, strict=True)])


def rounds(ways: dict[str, Callable[[], Any]], count: int) -> dict[str, dict[str, list[float]]]:
    """Processor and wall seconds of each way in each of ``count`` rounds, after one to warm up."""
    for way in ways.values():
        way()
    out: dict[str, dict[str, list[float]]] = {n: {"cpu_s": [], "wall_s": []} for n in ways}
    for k in range(count):
        turn = list(ways) if k % 2 == 0 else list(ways)[::-1]
        for name in turn:
            wall, cpu = time.perf_counter(), time.process_time()
            ways[name]()
            out[name]["cpu_s"].append(time.process_time() - cpu)
            out[name]["wall_s"].append(time.perf_counter() - wall)
    return out


@dataclass(frozen=True)
class Growth:
    """Exponent of a power law fitted in logarithms, with its 95 % interval."""

    exponent: float
    low: float
    high: float

    @staticmethod
    def of(sizes: Sequence[float], costs: Sequence[float]) -> Growth:
        """Least squares; the interval from the scatter about the line (Student)."""
        from scipy import stats

        fit = stats.linregress(np.log(sizes), np.log(costs))
        half = (
            float(stats.t.ppf(0.975, len(sizes) - 2) * fit.stderr) if len(sizes) > 2 else math.inf
        )
        return Growth(float(fit.slope), float(fit.slope) - half, float(fit.slope) + half)

    def __str__(self) -> str:
        if not math.isfinite(self.low):
            return f"{self.exponent:.3f}"
        return f"{self.exponent:.3f} ({self.low:.3f} to {self.high:.3f})"


def table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """A table as a page holds it."""
    return [
        "| " + " | ".join(heads) + " |",
        "|" + "--|" * len(heads),
        *("| " + " | ".join(row) + " |" for row in rows),
        "",
    ]
