"""How well other entries, one or two together, stand in for an effect on one design."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from blind.physics.entries import Hidden
from blind.recalibrate import Recalibration
from blind.standin import stand_in

Floats = np.ndarray


def label(hidden: Hidden) -> str:
    """An entry with its edge or side."""
    return f"{hidden.id}:{hidden.variant}" if hidden.variant else hidden.id


def share_taken(target: Floats, columns: Floats) -> float:
    """Share of a bare signature (squared) that free amounts of columns take."""
    total = float(target @ target)
    if total <= 0.0 or columns.shape[1] == 0:
        return 0.0
    coefficient = np.linalg.lstsq(columns, target, rcond=1e-8)[0]
    left = target - columns @ coefficient
    return 1.0 - float(left @ left) / total


def best_rivals(
    target: Floats, rivals: list[Hidden], unit: Floats, without: set[str]
) -> list[tuple[float, tuple[str, ...]]]:
    """The best single rival and the best pair of rivals: share taken, and their labels.

    All signatures are bare (clear of recalibration). Rivals whose id is in `without` are skipped,
    and none takes a share with an amount that no bench has (friction below none, say).
    """
    keep = [i for i, r in enumerate(rivals) if r.id not in without]
    total = float(target @ target)
    if not keep or total <= 0.0:
        return []
    t = target / np.sqrt(total)
    columns = unit[:, keep]
    along = columns.T @ t
    gram = columns.T @ columns
    either = np.array([rivals[i].entry.either_sign for i in keep])
    one = np.where(either | (along > 0.0), along**2, 0.0)
    best = int(np.argmax(one))
    found: list[tuple[float, tuple[str, ...]]] = [(float(one[best]), (label(rivals[keep[best]]),))]
    top = np.argsort(-(along**2))[:200]
    pair_best, pair = 0.0, (0, 0)
    for a, b in combinations(top.tolist(), 2):
        g = gram[a, b]
        if abs(g) > 0.999 or rivals[keep[a]].id == rivals[keep[b]].id:
            continue
        first = (along[a] - g * along[b]) / (1.0 - g * g)
        second = (along[b] - g * along[a]) / (1.0 - g * g)
        if not (either[a] or first > 0.0) or not (either[b] or second > 0.0):
            continue
        value = first * along[a] + second * along[b]
        if value > pair_best:
            pair_best, pair = float(value), (a, b)
    if pair_best > 0.0:
        names = tuple(sorted(label(rivals[keep[i]]) for i in pair))
        found.append((min(pair_best, 1.0), names))
    return found


LEAST_ALIKE = 0.2
LEAST_ALIKE_IN_TIME = 0.04
"""Of two effects on the same edge of a valve: their signatures turn with their size."""


def fitted_rivals(
    one: Hidden, rivals: list[Hidden], along: Floats, recalibration: Recalibration, ids: set[str]
) -> list[tuple[float, tuple[str, ...]]]:
    """The nearest rival and those of its own family, each fitted at the size it needs.

    None of `ids`, which are hidden themselves, is a rival.
    """
    asked: dict[str, Hidden] = {}
    nearest: str | None = None
    for i in np.argsort(-(along**2)).tolist():
        rival = rivals[i]
        kin = rival.entry.family == one.entry.family and rival.variant in (None, one.variant)
        least = LEAST_ALIKE_IN_TIME if kin and rival.variant else LEAST_ALIKE
        if rival.id in ids or rival.entry.parameter is None or along[i] ** 2 < least:
            continue
        nearest = nearest or label(rival)
        if kin or label(rival) == nearest:
            asked.setdefault(label(rival), rival)
    return [(stand_in(recalibration, [one], rival), (name,)) for name, rival in asked.items()]


def family_reach(target: Floats, rivals: list[Hidden], unit: Floats, ids: set[str]) -> float:
    """Share that the plainest forms of the entries themselves take together, at best."""
    keep = [i for i, r in enumerate(rivals) if r.id in ids and r.form == 0]
    return share_taken(target, unit[:, keep])


def measure(recalibration: Recalibration, hidden: list[Hidden]) -> dict[str, object]:
    """Gap over floor, mimics and reach of the hidden effects together, as plain numbers.

    `mimic_index` is the largest share of any one hidden effect (clear of the others) that one or
    two other entries take, by signatures of a usual size, the nearest ones also fitted at the size
    they need; for an effect outside the catalogue it is what the catalogue closes. `reach` is what
    the plainest forms of the hidden effects close.
    """
    rivals, unit = recalibration.rival_signatures()
    together = recalibration.signature_of(hidden)
    left = recalibration.left_of(hidden)
    ids = {h.id for h in hidden}
    members = []
    for one in hidden:
        alone = recalibration.left_of([one])
        bare = recalibration.bare(alone)
        others = [i for i, r in enumerate(rivals) if r.id in ids - {one.id}]
        target = bare
        if others:
            basis = np.linalg.qr(unit[:, others])[0]
            target = bare - basis @ (basis.T @ bare)
        found = best_rivals(target, rivals, unit, ids)
        found += fitted_rivals(one, rivals, unit.T @ target, recalibration, ids)
        ratio = recalibration.ratio(alone)
        members.append(
            {
                "id": one.id,
                **ratio,
                "separation": float(np.linalg.norm(target)),
                "mimics": [
                    {"ids": list(names), "share": round(share, 4)} for share, names in found
                ],
            }
        )
    shares = [m["share"] for member in members for m in member["mimics"]]  # type: ignore[attr-defined]
    return {
        **recalibration.ratio(left),
        "untouched_over_floor": recalibration.ratio(together)["gap_over_floor"],
        "separation": float(np.linalg.norm(recalibration.bare(left))),
        "mimic_index": round(max(shares, default=0.0), 4),
        "reach": round(family_reach(recalibration.bare(left), rivals, unit, ids), 4),
        "members": members,
    }
