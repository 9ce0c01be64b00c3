"""Small data sets of settled points with an effect in them, made by the plant itself."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from gap.data.reader import read_dataset
from gap.estimation.fit_problem import FitProblem
from gap.estimation.shape_fit import fit_shapes
from gap.selection.candidate_fits import Hypothesis
from plant.constants import nominal
from plant.effects.effects import Effects
from plant.simulator.force_law import ForceLaw
from plant.simulator.readings import read_force, read_pressure

PRESSURES = (0.0, 60.0, 120.0, 200.0, 300.0, 400.0, 500.0)


def settled_set(
    folder: Path, effects: dict[str, dict[str, Any]], replicates: int = 3, seed: int = 1
) -> Path:
    """Isometric tables at five lengths, each `replicates` times, in the dataset format."""
    rng = np.random.default_rng(seed)
    on = Effects.from_config(effects)
    law = ForceLaw(nominal(), on)
    trials, samples = [], []
    order = 0
    for replicate in range(1, replicates + 1):
        for length in rng.permutation([53.0, 57.0, 61.0, 65.0, 69.0]):
            order += 1
            name = f"t{order:02d}"
            zero_p, zero_f = rng.normal(0.0, 0.3), rng.normal(0.0, 0.1)
            p = np.array(PRESSURES)
            force = law.lasting(p * 1e3, np.full(len(p), length * 1e-3), 21.0, float(order))
            rows = pd.DataFrame(
                {
                    "trial": name,
                    "pressure_kpa": read_pressure(p, on) + zero_p + rng.normal(0, 0.2, len(p)),
                    "force_n": read_force(force, on) + zero_f + rng.normal(0, 0.05, len(p)),
                    "direction": "up",
                }
            )
            samples.append(rows)
            trials.append(
                {
                    "trial": name,
                    "slot": f"L{length:g}",
                    "replicate": str(replicate),
                    "protocol": "isometric",
                    "mounting": "m1" if replicate < replicates else "m2",
                    "order": order,
                    "held_length_mm": length,
                    "temperature_c": 21.0,
                }
            )
    folder.mkdir(parents=True)
    pd.DataFrame(trials).to_csv(folder / "trials.csv", index=False)
    pd.concat(samples).to_csv(folder / "samples.csv", index=False)
    return folder


def table_with_two_effects(folder: Path) -> FitProblem:
    """Settled points of a bench with a stiff liner and a load cell that reads 12 % too much."""
    hidden = {"liner_threshold": {"threshold_kpa": 30.0}, "force_gain": {"percent": 12.0}}
    return FitProblem.of(read_dataset(settled_set(folder, hidden, replicates=4)))


def fitted(problem: FitProblem, *ids: str) -> Hypothesis:
    """The explanation by some effects, each in its first shape, its numbers fitted too."""
    candidates = [next(s for s in problem.candidates if s.id == name) for name in ids]
    fit = problem.polish(fit_shapes(problem, problem.fit(candidates, [s.step for s in candidates])))
    return Hypothesis(tuple(s.key for s in candidates), fit)
