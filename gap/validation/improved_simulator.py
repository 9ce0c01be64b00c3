"""The improved simulator as a description: what `pamrig gap shrink --out` writes for a user's own.

Its parameters get their recalibrated values, and the effects that explain the gap stand beside it.
"""

from __future__ import annotations

import tomllib
from pathlib import Path

from gap.estimation.fit_problem import FitProblem, FitResult
from gap.estimation.intervals import undamped_step
from gap.simulators.external import External
from gap.simulators.open import describe
from gap.validation.improved_plant import improved_plant


def improved_text(problem: FitProblem, fit: FitResult, folder: Path) -> str:
    """The improved plant as TOML, or the improved simulator where the data set has one.

    Args:
        problem: of the data set.
        fit: with the effects that the verdict stands by.
        folder: that the text will be written to; the files of a description are relative to it.
    """
    plant = improved_plant(problem, fit)
    simulator = problem.data.simulator
    if not isinstance(simulator, External):
        return plant
    values = problem.simulator_values(undamped_step(problem, fit).shift)
    effects = tomllib.loads(plant).get("effects", {})
    heading = "# Recalibrated on these data, with the effects that explain the gap.\n"
    return heading + describe(simulator, values, effects, folder)
