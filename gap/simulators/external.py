"""What the bindings share: parameters, checks of what came back, predictions of a trial."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from time import perf_counter

import numpy as np

from daq.progress import stage as tell
from gap.data.simulator import Parameter, Stage
from gap.data.trial import Channel, Trial, sampled
from gap.errors import GapError
from gap.simulators.cached import Cached
from gap.simulators.description import Description
from gap.simulators.inputs import stage_sources, wanted_times
from plant.arrays import Array
from plant.effects.effects import Effects

_SLOW_S = 5.0
"""Time in runs of a simulator from which they are told of."""
_LONGEST = 1000
"""Characters of a path."""
NO_TIME = "is a table of settled points, without time"
NO_TIME_REMEDY = "state static = true if the force depends on pressure and length alone"


class External(ABC):
    """A simulator with memory: it needs the inputs of a whole trial.

    Args:
        about: its description.
        base: what the simulator itself knows of its parameters.
    """

    def __init__(self, about: Description, base: Iterable[Parameter] = ()) -> None:
        self.about = about
        self._parameters = about.parameters(base)
        self._covariance = about.covariance(self._parameters)
        self._nominal = {p.name: p.nominal for p in self._parameters}
        self._kept = Cached()
        self._runs, self._run_s = 0, 0.0

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Everything that a fit may change."""
        return self._parameters

    @property
    def stages(self) -> tuple[Stage, ...]:
        """The stages that it stands for, in the order of the chain."""
        return self.about.stages

    @property
    def covariance(self) -> Array | None:
        """Prior covariance of the parameters, shape (parameters, parameters)."""
        return self._covariance

    @property
    def model_error_n(self) -> float:
        """One sd of the error in N of the form of its force stage."""
        return self.about.model_error_n

    @property
    def noise_n(self) -> float:
        """One sd of a single reading of the force in N; 0 where it is not known."""
        return self.about.noise_n

    @property
    def notes(self) -> tuple[str, ...]:
        """What a reader of a verdict should know of it."""
        return ()

    @property
    def origin(self) -> str:
        """The file that describes it."""
        return str(self.about.path)

    def sources(self) -> list[Path]:
        """Its description and the files that the description names."""
        texts = set(_texts(self.about.table))
        texts |= {part for text in texts for part in (*text.split(":"), text.rpartition(":")[0])}
        named = (self.about.file(text) for text in sorted(texts) if 0 < len(text) < _LONGEST)
        return [self.about.path, *(path for path in named if os.path.isfile(path))]

    @property
    def effects(self) -> Effects:
        """Effects that its description switches on beside it."""
        return self.about.effects

    def simulate(self, trial: Trial, parameters: Mapping[str, float]) -> dict[str, Channel]:
        """Predicted channels by stage; see `gap.data.simulator.Simulator`.

        Raises:
            KeyError: a parameter that this simulator does not have.
            GapError: the simulator failed; names the file, the trial and the point.
        """
        values = self._values(parameters)
        return self._kept.get(trial, values, lambda: self._timed(trial, values))

    def _timed(self, trial: Trial, values: Mapping[str, float]) -> dict[str, Channel]:
        """One run; a slow simulator is told of, for it alone decides how long all takes."""
        start = perf_counter()
        made = self._predicted(trial, values)
        self._runs += 1
        self._run_s += perf_counter() - start
        if self._run_s > _SLOW_S:
            tell(f"{self.origin}: {self._runs} runs, {self._run_s / self._runs:.2g} s each")
        return made

    def _values(self, parameters: Mapping[str, float]) -> dict[str, float]:
        for name in parameters:
            if name not in self._nominal:
                raise KeyError(name)
        return {**self._nominal, **{name: float(value) for name, value in parameters.items()}}

    def _predicted(self, trial: Trial, values: Mapping[str, float]) -> dict[str, Channel]:
        found: dict[str, Channel] = {}
        for stage in self.stages:
            wanted = wanted_times(trial, stage)
            if wanted is None:
                continue
            made = self._stage(trial, stage, wanted, values)
            if made is not None:
                found[stage.name] = Channel(wanted, made)
        return found

    @abstractmethod
    def _stage(
        self, trial: Trial, stage: Stage, wanted: Array, values: Mapping[str, float]
    ) -> Array | None:
        """Predicted output of a stage at `wanted`; None if the trial lacks its inputs."""

    def _needs_time(self, trial: Trial) -> None:
        if trial.settled:
            raise GapError(f"{self.origin}: trial {trial.name}", NO_TIME, NO_TIME_REMEDY)


class StaticExternal(External):
    """A simulator whose force stage is a function of pressure and length alone."""

    def force_n(
        self, pressure_kpa: Array, length_mm: Array, parameters: Mapping[str, float]
    ) -> Array:
        """Pull in N at gauge pressures and lengths of equal shape.

        Raises:
            KeyError: a parameter that this simulator does not have.
            GapError: it has no finite value at a point.
        """
        return self._force(pressure_kpa, length_mm, self._values(parameters), "")

    def _force(
        self, pressure_kpa: Array, length_mm: Array, values: Mapping[str, float], trial: str
    ) -> Array:
        p = np.asarray(pressure_kpa, dtype=np.float64)
        length = np.asarray(length_mm, dtype=np.float64)
        force = self._law(p, length, values, trial)
        bad = np.flatnonzero(~np.isfinite(force.ravel()))
        if len(bad):
            at = int(bad[0])
            raise GapError(
                f"{self.origin}{f': trial {trial}' if trial else ''}",
                f"{self._name()} has no finite force at {p.flat[at]:.6g} kPa and "
                f"{length.flat[at]:.6g} mm",
                self._outside(),
            )
        return force

    def _stage(
        self, trial: Trial, stage: Stage, wanted: Array, values: Mapping[str, float]
    ) -> Array | None:
        sources = stage_sources(trial, stage, self.about.inputs)
        if sources is None:
            return None
        p, length = (sampled(name, sources[name], wanted) for name in ("pressure_kpa", "length_mm"))
        return self._force(p, length, values, trial.name)

    @abstractmethod
    def _law(
        self, pressure_kpa: Array, length_mm: Array, values: Mapping[str, float], trial: str
    ) -> Array:
        """Force in N, NaN where there is none; the shape of the pressure."""

    def _name(self) -> str:
        """What stands behind it, for messages."""
        return f"the {self.about.kind}"

    def _outside(self) -> str:
        """What to do about a point without a force."""
        return ""


def _texts(value: object) -> Iterator[str]:
    """All texts in a table and in its inner tables."""
    if isinstance(value, str):
        yield value.strip()
    elif isinstance(value, Mapping):
        for inner in value.values():
            yield from _texts(inner)
    elif isinstance(value, list):
        for inner in value:
            yield from _texts(inner)


def first_line(error: BaseException) -> str:
    """Kind and first line of an exception from code that is not ours."""
    text = (str(error).strip().splitlines() or [""])[0][:200]
    return f"{type(error).__name__}: {text}" if text else type(error).__name__
