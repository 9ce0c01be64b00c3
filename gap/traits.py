"""What an explanation looks like, in a few plain numbers on which belief in it can rest."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gap.inquiry import Inquiry
from gap.mimic import Mimicked
from gap.naming import Naming
from gap.shrink import Held
from plant.catalogue import CATALOGUE


def traits_of(
    q: Inquiry,
    naming: Naming,
    held: Mapping[str, Held],
    mimicked: Mimicked | None = None,
) -> dict[str, float]:
    """Traits of what a search found, all plain numbers.

    `excess` and `left` are whitened sums of squares beyond noise before and after, `rows` the
    number of features; `margin` is how much more the best explanation of other effects leaves;
    `more` what one further effect would take of what is left; `bent` the largest shift of a
    constant in sd, after; `range` the largest amount over the end of its catalogue range.
    """
    state = naming.chosen.state
    others = [c.cost for c in naming.rivals if set(c.state.ids) != set(state.ids)]
    other_family = [
        c.cost
        for c in naming.rivals
        if {_family(i) for i in c.state.ids} != {_family(i) for i in state.ids}
    ]
    best_first = max(naming.first_gain.values(), default=0.0)
    reach = [
        abs(a) / s.bounds[1]
        for s, a in zip(state.suspects, state.amounts, strict=True)
        if np.isfinite(s.bounds[1]) and s.bounds[1] > 0.0
    ]
    closed = [h.closed() for h in held.values()]
    best_closed = max((c for c in closed if c is not None), default=None)
    made = {
        "rows": float(len(q.rows)),
        "excess": naming.excess,
        "left": naming.left,
        "effects": float(len(naming.chosen.keys)),
        "shapes": float(len(state.suspects)),
        "first": best_first,
        "gain": naming.steps[0][1] if naming.steps else 0.0,
        "last": naming.steps[-1][1] if naming.steps else 0.0,
        "margin": min(others, default=np.inf) - naming.chosen.cost,
        "margin_family": min(other_family, default=np.inf) - naming.chosen.cost,
        "more": max(naming.last_gain.values(), default=0.0),
        "bent": float(np.abs(state.shift).max(initial=0.0)),
        "bent_base": float(np.abs(q.base.shift).max(initial=0.0)),
        "shift2": float(state.shift @ state.shift),
        "shift2_base": float(q.base.shift @ q.base.shift),
        "range": max(reach, default=0.0),
        "one": mimicked.one.share if mimicked and mimicked.one else 0.0,
        "two": mimicked.two.share if mimicked and mimicked.two else 0.0,
        "member_one": mimicked.member_one if mimicked else 0.0,
        "member_two": mimicked.member_two if mimicked else 0.0,
        "apart": float(mimicked.apart) if mimicked else 1.0,
        "share": naming.steps[-1][1] / max(q.base.cost - state.cost, 1.0) if naming.steps else 0.0,
        "closed": best_closed[0] if best_closed else 0.0,
        "closed_low": best_closed[1] if best_closed else -1.0,
        "freedom": float(q.noise.freedom),
        "pairs": float(q.noise.pairs),
        "settled": float(q.data.settled),
    }
    made["chance"] = naming.chance
    made["alarm"] = naming.alarm
    for block, h in held.items():
        floor = max(h.rms("floor"), 1e-9)
        made[f"{block}_before"] = h.rms("recalibrated") / floor
        made[f"{block}_after"] = h.rms("after") / floor
    return {name: float(min(value, 1e9)) for name, value in made.items()}


def _family(name: str) -> str:
    return CATALOGUE[name].family if name in CATALOGUE else name
