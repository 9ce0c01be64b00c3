"""What an explanation looks like, in a few plain numbers on which belief in it can rest."""

from __future__ import annotations

import numpy as np

from gap.inquiry import Inquiry
from gap.naming import Naming
from plant.catalogue import CATALOGUE

_MOST = 1e9
"""Stands for a margin over rivals where none was near enough to be fitted."""


def traits_of(q: Inquiry, naming: Naming) -> dict[str, float]:
    """Traits of what a search found, all plain numbers.

    `excess` and `left` are whitened sums of squares beyond noise before and after, `rows` the
    number of features; `margin_family` is how much more the best explanation by other families
    leaves, `share` what part of all that is explained the last effect took.
    """
    state = naming.chosen.state
    own = {_family(name) for name in state.ids}
    others = [c.cost for c in naming.rivals if {_family(name) for name in c.state.ids} != own]
    explained = max(q.base.cost - state.cost, 1.0)
    margin = min(others, default=np.inf) - naming.chosen.cost
    return {
        "rows": float(len(q.rows)),
        "excess": naming.excess,
        "left": naming.left,
        "effects": float(len(naming.chosen.keys)),
        "margin_family": float(min(margin, _MOST)),
        "share": naming.steps[-1][1] / explained if naming.steps else 0.0,
        "settled": float(q.data.settled),
    }


def _family(name: str) -> str:
    return CATALOGUE[name].family if name in CATALOGUE else name
