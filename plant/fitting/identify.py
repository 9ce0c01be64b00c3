"""Identifiability: dead parameters, flat directions, parameters at a bound."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plant.arrays import Array

FLAT = 1e-7
"""Relative strength below which a direction is flat."""
WEAK = 1e-3
"""Relative strength below which a direction is weak: barely determined."""


@dataclass(frozen=True)
class Direction:
    """A combination of parameters: relative changes (absolute ones for a zero value).

    `strength` is its effect on the residuals, relative to the strongest direction, with all
    parameters scaled to the same effect.
    """

    strength: float
    changes: tuple[tuple[str, float], ...]

    def words(self) -> str:
        """For example "gain +1 % with diameter -0.5 % does not change the force"."""
        parts = [f"{name} {100 * share:+.3g} %" for name, share in self.changes]
        effect = (
            "does not change the force" if self.strength < FLAT else "changes the force very little"
        )
        return f"{' with '.join(parts)} {effect}"


@dataclass(frozen=True)
class Identifiability:
    """Which parameters the data determine.

    Attributes:
        states: per free parameter "free", "dead", "flat" or "at bound".
        dead: parameters without effect on any point.
        flat: combinations without effect on any point.
        weak: combinations with very little effect.
        at_bound: parameters at a bound.
        covariance: of the free parameters for unit residual variance, determined part only.
        condition: ratio of the strongest to the weakest direction; infinite if one is flat.
    """

    states: tuple[str, ...]
    dead: tuple[str, ...]
    flat: tuple[Direction, ...]
    weak: tuple[Direction, ...]
    at_bound: tuple[str, ...]
    covariance: Array
    condition: float

    def lines(self) -> list[str]:
        """Warnings for the user; empty if all parameters are determined."""
        lines = [f"Without effect: {name}; no point depends on it." for name in self.dead]
        lines += [f"Not determined: {d.words()}." for d in self.flat]
        lines += [f"Poorly determined: {d.words()}." for d in self.weak]
        lines += [
            f"At the limit of its range: {name}; its interval is not valid beyond the limit."
            for name in self.at_bound
        ]
        return lines


def examine(
    design: Array, value: Array, names: tuple[str, ...], low: Array, high: Array
) -> Identifiability:
    """Analyse the whitened sensitivities.

    Args:
        design: shape (n, k), residual standard deviations per unit of each parameter.
        value: shape (k,), fitted values in the same units; `low` and `high` their bounds.
        names: of the parameters.
    """
    norm = np.sqrt(np.sum(design**2, axis=0))
    size = np.maximum(np.abs(value), 1.0)
    biggest = float(np.max(norm * size)) if norm.size else 0.0
    alive = norm * size > 1e-12 * biggest if biggest > 0 else np.zeros(norm.size, dtype=bool)
    dead = tuple(n for n, a in zip(names, alive, strict=True) if not a)
    slack = 1e-6 * np.where(np.isfinite(high - low), high - low, 1.0)
    at_bound = (value <= low + slack) | (value >= high - slack)

    _, s, vt = np.linalg.svd(design[:, alive] / norm[alive], full_matrices=False)
    strength = s / s[0] if s.size else s
    relative = np.where(value != 0, np.abs(value), 1.0)
    shares = vt / (norm * relative)[alive]
    kept = [n for n, a in zip(names, alive, strict=True) if a]
    worst = float(strength[-1]) if strength.size else 1.0
    flat = tuple(_direction(row, worst, kept) for row in _sparse(shares[strength < FLAT]))
    between = (strength >= FLAT) & (strength < WEAK)
    weak = tuple(_direction(shares[i], strength[i], kept) for i in np.flatnonzero(between))

    sound = strength >= FLAT
    root = vt[sound].T / s[sound]
    part = (root @ root.T) / np.outer(norm[alive], norm[alive])
    covariance = np.zeros((len(names), len(names)))
    covariance[np.ix_(alive, alive)] = part
    in_flat = np.zeros(len(names), dtype=bool)
    in_flat[alive] = np.any(np.abs(vt[~sound]) > 1e-4, axis=0) if np.any(~sound) else False
    states = []
    for k in range(len(names)):
        states.append(
            "dead" if not alive[k] else "flat" if in_flat[k] else
            "at bound" if at_bound[k] else "free"
        )  # fmt: skip
    complete = bool(np.all(sound)) and not dead
    condition = float(1.0 / strength[-1]) if complete and s.size else float("inf")
    bounded = tuple(n for n, b in zip(names, at_bound, strict=True) if b)
    return Identifiability(tuple(states), dead, flat, weak, bounded, covariance, condition)


def _sparse(rows: Array) -> Array:
    """The same flat directions, combined so that each has as few parameters as possible."""
    reduced = rows.copy()
    for k in range(len(reduced)):
        rest = np.abs(reduced[k:])
        row, column = divmod(int(np.argmax(rest)), rest.shape[1])
        reduced[[k, k + row]] = reduced[[k + row, k]]
        reduced[k] /= reduced[k, column]
        for other in range(len(reduced)):
            if other != k:
                reduced[other] -= reduced[other, column] * reduced[k]
    return reduced


def _direction(shares: Array, strength: float, names: list[str]) -> Direction:
    """Scale the largest change to 1 %; omit changes below a hundredth of that."""
    largest = shares[np.argmax(np.abs(shares))]
    scaled = shares / largest * 0.01
    order = np.argsort(-np.abs(scaled), kind="stable")
    return Direction(
        float(strength), tuple((names[k], float(scaled[k])) for k in order if abs(scaled[k]) > 1e-4)
    )
