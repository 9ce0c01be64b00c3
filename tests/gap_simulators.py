"""Simulators that stand for the built-in plant in tests: the same equations, written by hand."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gap.data.simulator import FORCE_STAGE, Parameter, Stage
from gap.data.trial import Channel, Trial

Array = npt.NDArray[np.float64]
BRAID_MM, TURNS = 88.4, 1.855


@dataclass(frozen=True)
class StaticBraid:
    """Schulte's braid as a user would write it: a static force law."""

    parameters: tuple[Parameter, ...]
    covariance: Array | None = None
    model_error_n: float = 0.0
    noise_n: float = 0.0
    origin: str = "braid.toml"
    factor: float = 1.0

    @property
    def stages(self) -> tuple[Stage, ...]:
        return (FORCE_STAGE,)

    def force_n(
        self, pressure_kpa: Array, length_mm: Array, parameters: Mapping[str, float]
    ) -> Array:
        stated = {p.name: p.nominal for p in self.parameters}
        b, n = ({**stated, **parameters}[name] for name in ("braid_mm", "turns"))
        area_mm2 = (3.0 * length_mm**2 - b**2) / (4.0 * np.pi * n**2)
        return np.asarray(self.factor * pressure_kpa * 1e-3 * area_mm2)

    def simulate(self, trial: Trial, parameters: Mapping[str, float]) -> dict[str, Channel]:
        pressure = trial["pressure_kpa"]
        length = trial.get("length_mm")
        held = np.full(len(pressure), trial.held_length_mm)
        x = np.interp(pressure.time_s, length.time_s, length.value) if len(length) else held
        return {"force": Channel(pressure.time_s, self.force_n(pressure.value, x, parameters))}


@dataclass(frozen=True)
class BraidWithMemory:
    """The same braid as a simulator that gives channels of a whole trial and no law."""

    law: StaticBraid

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return self.law.parameters

    @property
    def covariance(self) -> Array | None:
        return None

    @property
    def model_error_n(self) -> float:
        return 0.0

    @property
    def noise_n(self) -> float:
        return 0.0

    @property
    def origin(self) -> str:
        return "memory.toml"

    @property
    def stages(self) -> tuple[Stage, ...]:
        return (FORCE_STAGE,)

    def simulate(self, trial: Trial, parameters: Mapping[str, float]) -> dict[str, Channel]:
        return self.law.simulate(trial, parameters)


def braid(tolerance_mm: float = 0.2652, **changes: float) -> StaticBraid:
    """The thesis's braid, with the tolerances of its plant file."""
    return StaticBraid(
        (
            Parameter("braid_mm", BRAID_MM, tolerance_mm),
            Parameter("turns", TURNS, 0.01855),
        ),
        **changes,  # type: ignore[arg-type]
    )
