"""At-bound diagnostics: effects that would free a stated constant from the end of its tolerance.

Where there is no gap, the plant agrees because it was recalibrated. If stated constants had to
move far for that, one to the end of its tolerance or several by less, an effect in their place may
be as likely. No test on the bench tells the two apart: the stated value has to be checked.
"""

from __future__ import annotations

from gap.decision.config import DECISION, DecisionConfig
from gap.estimation.fit_problem import FitProblem
from gap.selection.candidate_fits import (
    Hypothesis,
    fit_further,
    keys_of_shifted_constants,
    linear_gains,
)
from gap.selection.config import SELECTION


def relieving(problem: FitProblem, config: DecisionConfig = DECISION) -> dict[str, float]:
    """Effects that would free constants that have moved far, with the gain, best first.

    Empty where none frees them plainly.
    """
    base = Hypothesis((), problem.base)
    # Several constants share what is to be made up for: none of them need be at its end.
    keys = keys_of_shifted_constants(problem, base.fit, SELECTION.shifted_constant_sd)
    if not keys:
        return {}
    linear = linear_gains(problem, base.fit)
    found: dict[str, float] = {}
    for key in dict.fromkeys(keys):
        gain = base.cost - problem.polish(fit_further(problem, base, key, linear).fit).cost
        name = key.partition(":")[0]
        found[name] = max(found.get(name, 0.0), gain)
    if max(found.values()) < config.relief_gain:
        return {}
    ranked = sorted(found.items(), key=lambda item: -item[1])
    return {name: gain for name, gain in ranked if gain >= config.relief_gain_others}
