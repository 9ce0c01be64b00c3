"""Whether another effect, of the amount it needs, leaves what the hidden ones leave."""

from __future__ import annotations

import numpy as np

from blind.physics.bench import NoSuchBenchError, no_effect
from blind.physics.entries import Hidden, scaled
from blind.recalibrate import END_SD, MOST_STEPS, Recalibration

Floats = np.ndarray


def stand_in(of: Recalibration, hidden: list[Hidden], rival: Hidden) -> float:
    """Share of what the hidden effects leave that a rival of the right amount leaves too.

    Constants and the rival's amount are fitted together, at the size that they have: a linear
    comparison of two effects of other sizes tells apart what no bench could.
    """
    signal, w = of.signature_of(hidden), of.weight
    left = of.left_of(hidden)
    x, slopes = of.warm[tuple((h.id, h.variant) for h in hidden)]
    whole = float(np.sum((left * w) ** 2) + x @ x)
    column = of.signature(rival)
    reach = rival.entry.limit / abs(rival.strength)
    # None at all of some effects is a time constant of zero.
    low, high = (-1.0, 1.0) if rival.entry.either_sign else (0.05 / reach, 1.0)

    def tried(at: Floats) -> tuple[Floats, float]:
        e = no_effect()
        scaled(rival, float(at[-1])).put(e)
        try:
            made = signal - of.difference(of.constants(at[:-1]), e)
        except NoSuchBenchError:
            return signal, np.inf
        return made, float(np.sum((made * w) ** 2) + at[:-1] @ at[:-1])

    # From what is left with the constants moved, and from the whole with the bench's own.
    target, bare = of.bare(left), of.bare(column)
    starts = [
        np.append(constants, float(like @ part) / max(float(like @ like), 1e-12))
        for constants, part, like in ((x, target, bare), (of.shift, signal * w, column * w))
    ]
    if rival.entry.stage == "valve":
        # What comes late or early is no multiple of what comes later or earlier still.
        starts += [
            np.append(of.shift, sign * share)
            for share in (0.1, 0.2, 0.4, 0.75, 1.3, 2.2) for sign in (-1.0, 1.0) if sign >= low
        ]  # fmt: skip
    for start in starts:
        start[-1] = np.clip(start[-1], low * reach, high * reach)
    at = min(starts, key=lambda start: tried(start)[1])
    left, cost = tried(at)
    slopes = np.column_stack([slopes, column * w])
    damping = 1e-3
    for _ in range(MOST_STEPS // 2):
        h = slopes.T @ slopes + np.diag(np.append(np.ones(len(x)), 0.0))
        right = slopes.T @ (left * w) - np.append(at[:-1], 0.0)
        step = np.linalg.solve(h + damping * np.diag(np.diag(h)), right)
        fresh = at + step
        fresh[:-1] = np.clip(fresh[:-1], -END_SD, END_SD)
        fresh[-1] = np.clip(fresh[-1], low * reach, high * reach)
        moved = fresh - at
        if float(np.abs(moved).max()) < 1e-3:
            break
        made, fresh_cost = tried(fresh)
        if not np.isfinite(fresh_cost):
            damping *= 10.0
            continue
        miss = (left - made) * w - slopes @ moved
        slopes = slopes + np.outer(miss, moved) / max(float(moved @ moved), 1e-12)
        if fresh_cost >= cost:
            damping *= 10.0
            continue
        gained = cost - fresh_cost
        at, left, cost, damping = fresh, made, fresh_cost, damping / 5.0
        if gained < 1e-3 * whole:
            break
    return float(np.clip(1.0 - cost / max(whole, 1e-12), 0.0, 1.0))
