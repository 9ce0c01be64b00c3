"""What an explanation looks like, in a few plain numbers on which belief in it can rest."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gap.agreement import repeated
from gap.inquiry import Inquiry
from gap.mimic import Mimicked
from gap.naming import Naming
from gap.shrink import Held
from plant.catalogue import CATALOGUE

_MOST = 1e9
"""Stands for a margin over rivals where none was near enough to be fitted."""


def traits_of(
    q: Inquiry, naming: Naming, held: Mapping[str, Held], mimicked: Mimicked
) -> dict[str, float]:
    """Traits of what a search found, all plain numbers.

    `excess` and `left` are whitened sums of squares beyond noise before and after, `repeated` and
    `repeated_left` what of them the replicates share, `rows` the number of features; `margin` and
    `margin_family` how much more the best explanation of other effects, and of other families,
    leaves; `more` what one further effect would take of what is left; `bent` the largest shift of
    a constant in sd; `one` and `two` the share that another entry and a pair of others could
    imitate on these data, `member_...` the same of one effect alone; `share` what part of all
    that is explained the last effect took.
    """
    state = naming.chosen.state
    own = {_family(name) for name in state.ids}
    others = [c.cost for c in naming.rivals if set(c.state.ids) != set(state.ids)]
    other_family = [c.cost for c in naming.rivals if {_family(n) for n in c.state.ids} != own]
    explained = max(q.base.cost - state.cost, 1.0)
    closed = [c for c in (h.closed() for h in held.values()) if c is not None]
    best_closed = max(closed, default=(0.0, -1.0, 1.0))
    reach = [
        abs(a) / s.bounds[1]
        for s, a in zip(state.suspects, state.amounts, strict=True)
        if np.isfinite(s.bounds[1]) and s.bounds[1] > 0.0
    ]
    made = {
        "rows": float(len(q.rows)),
        "excess": naming.excess,
        "left": naming.left,
        "effects": float(len(naming.chosen.keys)),
        "shapes": float(len(state.suspects)),
        "first": max(naming.first_gain.values(), default=0.0),
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
        "one": mimicked.one.share if mimicked.one else 0.0,
        "two": mimicked.two.share if mimicked.two else 0.0,
        "member_one": mimicked.member_one,
        "member_two": mimicked.member_two,
        "apart": float(mimicked.apart),
        "same_family": float(len(own) < len(state.ids)),
        "share": naming.steps[-1][1] / explained if naming.steps else 0.0,
        "closed": best_closed[0],
        "closed_low": best_closed[1],
        "freedom": float(q.noise.freedom),
        "settled": float(q.data.settled),
        "repeated": repeated(q, q.base.residual),
        "repeated_left": repeated(q, state.residual),
        "alarm": naming.alarm,
        "chance": naming.chance,
    }
    for block, h in held.items():
        floor = max(h.rms("floor"), 1e-9)
        made[f"{block}_before"] = h.rms("recalibrated") / floor
        made[f"{block}_after"] = h.rms("after") / floor
    return {name: float(min(value, _MOST)) for name, value in made.items()}


def _family(name: str) -> str:
    return CATALOGUE[name].family if name in CATALOGUE else name
