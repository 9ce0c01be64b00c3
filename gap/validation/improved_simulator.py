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
from gap.verdict import EmpiricalTerm


def improved_text(
    problem: FitProblem, fit: FitResult, folder: Path, empirical: EmpiricalTerm | None = None
) -> str:
    """The improved plant as TOML, or the improved simulator where the data set has one.

    Args:
        problem: of the data set.
        fit: with the effects that the verdict stands by.
        empirical: describes what no effect explains. A description has no place for it: it stands
            there as a comment, to be put into bench.toml.
        folder: that the text will be written to; the files of a description are relative to it.
    """
    plant = improved_plant(problem, fit, empirical)
    simulator = problem.data.simulator
    if not isinstance(simulator, External):
        return plant
    values = problem.simulator_values(undamped_step(problem, fit).shift)
    effects = tomllib.loads(plant).get("effects", {})
    heading = "# Recalibrated on these data, with the effects that explain the gap.\n"
    text = heading + describe(simulator, values, effects, folder)
    term = plant.partition("\n[empirical.")[2]
    if not term:
        return text
    lines = f"[empirical.{term}".splitlines()
    return text + "\n# For bench.toml of the data set:\n" + "".join(f"# {x}\n" for x in lines)
