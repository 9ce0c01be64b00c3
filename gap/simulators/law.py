"""A law of the muscle as `pamrig fit` writes it, as the force stage."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from gap.data.simulator import Parameter, Stage
from gap.data.trial import Trial, sampled
from gap.errors import GapError
from gap.simulators.description import Description, read_table_of
from gap.simulators.external import External, StaticExternal
from gap.simulators.inputs import stage_sources
from plant.arrays import Array
from plant.errors import PlantError
from plant.models import catalogue
from plant.models.law import History, static_force
from plant.models.model import Domain, Model

ROOM_C = 21.0


def open_law(about: Description) -> External:
    """A law of a model file, or a shipped one by name. Raises `GapError`."""
    name = about.text("model")
    path = about.file(name) if name.endswith(".toml") else None
    if path is not None and not path.is_file():
        raise about.error("model", f"no such file {name}", "it is relative to this file")
    try:
        model = catalogue.load(path if path is not None else name)
    except PlantError as error:
        raise about.error("model", str(error)) from None
    about = _with_fit(about, model, path)
    return LawWithMemory(about, model) if model.law.memory else StaticLaw(about, model)


def parameter_name(name: str, unit: str) -> str:
    """The name of a law's parameter with its unit: stiffness in N/mm is `stiffness_n_per_mm`."""
    words = "".join(
        c if c.isalnum() or c == "/" else " "
        for c in unit.replace("%", " percent ").replace("^", "")
    )
    top, _, bottom = words.partition("/")
    parts = [part for part in top.lower().split() if part != "1"]
    if bottom:
        parts += ["per", *bottom.lower().split()]
    return "_".join([name, *parts])


class _Law(External):
    """What laws with and without memory share: values in their own units."""

    def __init__(self, about: Description, model: Model) -> None:
        free = [p for p in model.parameters if not p.fixed]
        names = {parameter_name(p.name, p.unit): p for p in free}
        super().__init__(
            about, [Parameter(name, p.value, p.sd or 0.0) for name, p in names.items()]
        )
        self.model = model
        self._bounds = {name: (p.low, p.high) for name, p in names.items()}
        self._own = {name: p.name for name, p in names.items()}
        self._temperature_c = about.number("temperature_c", ROOM_C)
        self._fitted = about.text("model").endswith(".toml")

    @property
    def domain(self) -> Domain | None:
        """Pressures and lengths of the points that the law of a model file was fitted to.

        A law that ships goes with the numbers of another muscle.
        """
        return self.model.domain if self._fitted else None

    def _q(self, values: Mapping[str, float]) -> Array:
        # A parameter that was fitted to its bound has an interval beyond it, where no law holds.
        own = {
            self._own[name]: min(max(value, self._bounds[name][0]), self._bounds[name][1])
            for name, value in values.items()
        }
        return self.model.with_values(own).q

    def _pull(self, force: Array) -> Array:
        """A muscle hangs loose where a law that only pulls is negative."""
        return np.maximum(force, 0.0) if self.model.pulls_only else force

    def _inputs(self, pressure_kpa: Array, length_mm: Array) -> tuple[Array, Array, Array]:
        p, length = pressure_kpa.ravel() * 1e3, length_mm.ravel() * 1e-3
        return p, length, np.full(len(p), self._temperature_c)


class StaticLaw(_Law, StaticExternal):
    """A law without memory."""

    def _law(
        self, pressure_kpa: Array, length_mm: Array, values: Mapping[str, float], trial: str
    ) -> Array:
        with np.errstate(invalid="ignore", divide="ignore"):
            force = static_force(
                self.model.law, self._q(values), *self._inputs(pressure_kpa, length_mm)
            )
        return self._pull(np.asarray(force)).reshape(pressure_kpa.shape)

    def _name(self) -> str:
        return f"the law {self.model.name}"


class LawWithMemory(_Law):
    """A law whose force depends on the path to a point; every trial starts vented."""

    def _stage(
        self, trial: Trial, stage: Stage, wanted: Array, values: Mapping[str, float]
    ) -> Array | None:
        sources = stage_sources(trial, stage, self.about.inputs)
        if sources is None:
            return None
        p, length = (sampled(k, sources[k], wanted) for k in ("pressure_kpa", "length_mm"))
        start = np.zeros(len(wanted), dtype=bool)
        start[:1] = True
        past = History(None if trial.settled else wanted, start)
        with np.errstate(invalid="ignore", divide="ignore"):
            force = self.model.law.force(self._q(values), *self._inputs(p, length), past)
        bad = np.flatnonzero(~np.isfinite(force))
        if len(bad):
            raise GapError(
                f"{self.origin}: trial {trial.name}",
                f"the law {self.model.name} has no finite force at {p[bad[0]]:.6g} kPa and "
                f"{length[bad[0]]:.6g} mm",
            )
        return self._pull(np.asarray(force))


def _with_fit(about: Description, model: Model, path: Path | None) -> Description:
    """The description with what the fit knows of its own error, where it does not state it."""
    if path is None:
        return about
    fitted = read_table_of(path)
    table = dict(about.table)
    if "covariance" in fitted and "covariance" not in table:
        table["covariance"] = _renamed(fitted["covariance"], model)
    error, noise = (
        about.number_of(fitted, key, f"{key} of the model", 0.0, 0.0)
        if key not in table and key in fitted
        else stated
        for key, stated in (("model_error_n", about.model_error_n), ("noise_n", about.noise_n))
    )
    return dataclasses.replace(about, table=table, model_error_n=error, noise_n=noise)


def _renamed(covariance: object, model: Model) -> object:
    """A covariance whose names carry units."""
    if not isinstance(covariance, Mapping) or not isinstance(covariance.get("names"), list):
        return covariance
    units = {p.name: parameter_name(p.name, p.unit) for p in model.parameters}
    return {**covariance, "names": [units.get(name, name) for name in covariance["names"]]}
