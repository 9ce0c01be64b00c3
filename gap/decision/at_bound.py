"""What agreement within the floor leans on: constants and calibrations led beyond belief.

Where nothing alarms, the plant agrees because it was recalibrated. If a stated quantity had to go
three standard deviations for that, an effect in its place may be as likely, and no test on this
bench tells the two apart: what is stated has to be checked.
"""

from __future__ import annotations

from gap.estimation.fit_problem import Inquiry
from gap.selection.forward import bent_keys
from gap.selection.refine import BENT, linear_gains, refine

PLAIN = 16.0
"""Gain (drop of the whitened sum of squares) of the best effect from which a check is asked for:
four standard deviations."""
LEAST = 9.0
"""Gain of the other effects that the same check must be able to tell: three."""


def leaning(q: Inquiry) -> dict[str, float]:
    """Effects that would relieve a stated quantity at the end of its tolerance, with the gain.

    Best first; empty where none relieves one plainly.
    """
    if not bent_keys(q, q.base):
        return {}
    gains, amounts = linear_gains(q, q.base)
    found: dict[str, float] = {}
    for key in dict.fromkeys(bent_keys(q, q.base, BENT)):  # they share what is to be made up for
        choice = refine(q, q.base, (), key, gains, amounts)
        gain = q.base.cost - q.polish(choice.state).cost
        name = key.partition(":")[0]
        found[name] = max(found.get(name, 0.0), gain)
    best = max(found.values())
    if best < PLAIN:
        return {}
    ranked = sorted(found.items(), key=lambda item: -item[1])
    return {name: gain for name, gain in ranked if gain >= LEAST}
