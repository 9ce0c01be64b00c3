"""What agreement within the floor leans on: constants and calibrations led beyond reliability.

Where nothing alarms, the plant agrees because it was recalibrated. If a stated quantity had to go
three standard deviations for that, an effect in its place may be as likely, and no test on this
bench tells the two apart: what is stated has to be checked.
"""

from __future__ import annotations

from gap.estimation.fit_problem import FitProblem
from gap.selection.forward import keys_of_shifted_constants
from gap.selection.refine import BENT, linear_gains, refine

PLAIN = 16.0
"""Gain (drop of the whitened sum of squares) of the best effect from which a check is asked for:
four standard deviations."""
LEAST = 9.0
"""Gain of the other effects that the same check must be able to tell: three."""


def relieving(problem: FitProblem) -> dict[str, float]:
    """Effects that would relieve a stated quantity at the end of its tolerance, with the gain.

    Best first; empty where none relieves one plainly.
    """
    if not keys_of_shifted_constants(problem, problem.base):
        return {}
    gains, amounts = linear_gains(problem, problem.base)
    found: dict[str, float] = {}
    for key in dict.fromkeys(
        keys_of_shifted_constants(problem, problem.base, BENT)
    ):  # they share what is to be made up for
        hypothesis = refine(problem, problem.base, (), key, gains, amounts)
        gain = problem.base.cost - problem.polish(hypothesis.fit).cost
        name = key.partition(":")[0]
        found[name] = max(found.get(name, 0.0), gain)
    best = max(found.values())
    if best < PLAIN:
        return {}
    ranked = sorted(found.items(), key=lambda item: -item[1])
    return {name: gain for name, gain in ranked if gain >= LEAST}
