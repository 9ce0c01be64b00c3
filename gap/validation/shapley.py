"""Exact Shapley shares of the stages in the end-to-end gap.

The gap of a set of modelled stages is the squared error at the chain's end when all other stages
are real (`gap.validation.chain`). A stage's value is what modelling it adds to the squared gap,
averaged over all orders in which the stages could be modelled one after the other: 2^S runs for S
stages, and the values add up to the whole squared gap. A stage whose error makes up for another's
has a negative one.

Squared gaps are taken free of noise as products of the errors of different replicates of a slot,
which have the gap in common and no noise. Ends of different units are added in floors squared.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations
from math import factorial

import numpy as np
from scipy.stats import t as student

from gap.validation.chain import Chain
from gap.verdict import Share
from plant.arrays import Array

_MOST_SHARE = 2.0
"""Share beyond which the whole is a small difference of large parts, and shares say nothing."""


@dataclass(frozen=True)
class Waterfall:
    """The end-to-end gap by stage.

    Attributes:
        stages: stages that are there.
        value: each slot's part of each stage's value, floors squared, shape (slots, stages).
        unit, rms, floor: of each kind of end: its unit, the free-running error and the floor.
    """

    stages: tuple[str, ...]
    value: Array
    ends: dict[str, tuple[float, float]]

    def shares(self, known: bool = False) -> tuple[Share, ...]:
        """Shares of the gap, largest first, with 95 % intervals by the jackknife over slots.

        None where the gap is not certain to be there, unless it is `known` to be.
        """
        slots = np.flatnonzero(np.any(self.value != 0.0, axis=1))
        value = self.value[slots]
        n = len(value)
        total = value.sum(axis=0)
        whole = float(total.sum())
        if n == 0 or whole <= 0.0 or np.abs(total).max() > _MOST_SHARE * whole:
            return ()
        if n < 3:
            return self._sorted(total / whole, np.full(len(total), np.inf))
        left = total[None, :] - value
        wholes = left.sum(axis=1)
        if not (known and np.all(wholes > 0.0)) and not _certain(whole, wholes):
            return ()
        shares = left / wholes[:, None]
        spread = np.sqrt((n - 1) / n * np.sum((shares - shares.mean(axis=0)) ** 2, axis=0))
        return self._sorted(total / whole, float(student.ppf(0.975, n - 1)) * spread)

    def _sorted(self, share: Array, reach: Array) -> tuple[Share, ...]:
        low, high = np.minimum(share, 0.0), np.maximum(share, 1.0)
        made = [
            Share(name, float(s), float(max(s - r, min(a, 0.0))), float(min(s + r, max(b, 1.0))))
            for name, s, r, a, b in zip(self.stages, share, reach, low, high, strict=True)
        ]
        return tuple(sorted(made, key=lambda one: -one.share))


def _certain(whole: float, wholes: Array) -> bool:
    """Whether the jackknife leaves the whole above nothing: 95 % one-sided."""
    n = len(wholes)
    error = float(np.sqrt((n - 1) / n * np.sum((wholes - wholes.mean()) ** 2)))
    return bool(np.all(wholes > 0.0)) and whole > float(student.ppf(0.95, n - 1)) * error


def waterfall(chain: Chain) -> Waterfall:
    """Run all 2^S subsets of real stages and share the squared gap among the stages."""
    stages = chain.stages
    squares: dict[frozenset[str], dict[str, Array]] = {}
    first = chain.run(())
    floors = {name: _floor(chain, name, values) for name, values in first.items()}
    for count in range(len(stages) + 1):
        for real in combinations(stages, count):
            ran = first if not real else chain.run(real)
            squares[frozenset(real)] = {
                name: common_squares(chain, name, values, "muscle" not in real)
                for name, values in ran.items()
            }
    slots = len(chain.grid.data.slots)
    value = np.zeros((slots, len(stages)))
    ends: dict[str, tuple[float, float]] = {}
    for name in first:
        span = float(chain.problem.rows.compared_s[chain.rows_of(name)].sum())
        floor = floors[name]
        part = _shapley(stages, lambda real, kind=name: squares[real][kind])  # type: ignore[misc]
        value += part / max(span * floor**2, 1e-12)
        own = chain.of_rows(name, first[name])
        weight = chain.problem.rows.compared_s[chain.rows_of(name)]
        ends[name] = (float(np.sqrt((weight @ own**2) / max(span, 1e-12))), floor)
    return Waterfall(stages, value, ends)


def _shapley(stages: tuple[str, ...], gap: Callable[[frozenset[str]], Array]) -> Array:
    """Values of the stages for a squared gap by set of real stages, shape (slots, stages)."""
    n = len(stages)
    made: list[Array] = []
    for stage in stages:
        others = [s for s in stages if s != stage]
        total = 0.0 * gap(frozenset())
        for count in range(n):
            weight = factorial(count) * factorial(n - count - 1) / factorial(n)
            for real in combinations(others, count):
                kept = frozenset(real)
                total = total + weight * (gap(kept) - gap(kept | {stage}))
        made.append(total)
    return np.stack(made, axis=1)


def common_squares(chain: Chain, name: str, values: Array, noisy: bool) -> Array:
    """Squared error that replicates have in common, by slot, times seconds (or points).

    The mean product of different replicates, bin by bin. Where no slot has replicates the noise
    model's variance is taken off instead, if the sensor's noise is in the error (`noisy`).
    """
    slots = chain.grid.data.slots
    made = np.zeros(len(slots))
    tables = replicate_tables(chain, name, values)
    replicated = any(len(table) > 1 for _, table, _ in tables)
    variance = chain.problem.floor_variance[chain.rows_of(name)]
    expected = (
        replicate_tables(chain, name, _spread(chain, name, variance)) if not replicated else []
    )
    for k, (slot, table, span) in enumerate(tables):
        count = len(table)
        if count > 1:
            mean = table.mean(axis=0)
            product = mean**2 - table.var(axis=0, ddof=1) / count
            made[slot] += count * float(span @ product)
        elif not replicated:
            off = expected[k][1][0] if noisy else 0.0
            made[slot] += float(span @ (table[0] ** 2 - off))
    return made


def _spread(chain: Chain, name: str, own: Array) -> Array:
    """Values of `rows_of(name)` put back among all rows of the block."""
    at = np.flatnonzero(
        chain.problem.rows.block == chain.problem.rows.block[chain.rows_of(name)[0]]
    )
    made = np.zeros(len(at))
    made[np.isin(at, chain.rows_of(name))] = own
    return made


def replicate_tables(chain: Chain, name: str, values: Array) -> list[tuple[int, Array, Array]]:
    """For each slot: its number, errors in the bins all replicates share, and the bins' seconds.

    Errors have shape (replicates, bins), seconds shape (bins,).
    """
    rows = chain.problem.rows
    at = chain.rows_of(name)
    own = chain.of_rows(name, values)
    place = np.full(len(rows), -1, dtype=np.int64)
    place[at] = np.arange(len(at))
    made: list[tuple[int, Array, Array]] = []
    for slot, members in enumerate(chain.grid.data.slots.values()):
        parts = [chain.problem.noise.trial_rows[t] for t in members]
        parts = [p[place[p] >= 0] for p in parts]
        parts = [p for p in parts if len(p)]
        if not parts:
            continue
        common = set(rows.bin[parts[0]].tolist())
        for p in parts[1:]:
            common &= set(rows.bin[p].tolist())
        if len(common) < 3:
            parts, common = parts[:1], set(rows.bin[parts[0]].tolist())
        kept = [p[np.isin(rows.bin[p], list(common))] for p in parts]
        table = np.stack([own[place[p]] for p in kept])
        made.append((slot, table, np.mean([rows.compared_s[p] for p in kept], axis=0)))
    return made


def _floor(chain: Chain, name: str, values: Array) -> float:
    """What replicates differ by at this end, as one standard deviation."""
    total = weight = 0.0
    for _, table, span in replicate_tables(chain, name, values):
        if len(table) > 1:
            total += float(span @ table.var(axis=0, ddof=1))
            weight += float(span.sum())
    if weight > 0.0:
        return float(np.sqrt(max(total / weight, 1e-12)))
    return float(np.sqrt(np.mean(chain.problem.floor_variance[chain.rows_of(name)])))
