"""Opens the simulator that a description names, and puts it into a data set."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gap.data.dataset import DataSet
from gap.data.from_runs import open_data
from gap.data.simulator import FORCE_STAGE, ExternalSimulator, Mask, domain_of, holds
from gap.data.trial import sampled
from gap.errors import GapError
from gap.simulators.description import Description, described, read_description
from gap.simulators.external import External
from gap.simulators.inputs import stage_sources
from gap.simulators.law import open_law
from gap.simulators.predictions import Predictions
from gap.simulators.python_function import PythonSimulator, StaticPythonSimulator
from gap.simulators.surface import Surface
from plant.effects.effects import NONE, Effects


def open_simulator(path: str | Path) -> External:
    """Open a simulator by its description, or a model file of `pamrig fit` as one.

    The description may name a Python function or an FMU. Both are programs, and they run with all
    rights of the user: open only what you would run.

    Raises:
        GapError: one line that names the file and the key.
    """
    about = read_description(Path(path))
    return _OPENERS[about.kind](about)


def stated_effects(path: str | Path) -> Effects:
    """Effects that the description of a simulator switches on beside it. Raises `GapError`."""
    return read_description(Path(path)).effects


def describe(
    simulator: External,
    parameters: Mapping[str, float],
    effects: Mapping[str, Mapping[str, Any]] | None = None,
    folder: Path | None = None,
) -> str:
    """The description of a simulator as TOML text with new nominal values.

    `open_simulator` reads it again.

    Args:
        simulator: from `open_simulator`.
        parameters: new nominal values by name; what is missing keeps its value.
        effects: further effects beside it, in the form of `bench.toml`; they replace one of the
            same name.
        folder: that the text will be written to: files are named relative to it. By default they
            get their full path.

    Raises:
        KeyError: a parameter that this simulator does not have.
    """
    known = [parameter.name for parameter in simulator.parameters]
    for name in parameters:
        if name not in known:
            raise KeyError(name)
    return described(simulator.about, simulator.parameters, parameters, effects or {}, folder)


def with_simulator(data: DataSet, source: str | Path | ExternalSimulator | None) -> DataSet:
    """The data set with a simulator in the place of the stages that it stands for.

    Every trial is predicted once with nominal values, so that what does not fit together is
    reported before the diagnosis, and by trial.

    Raises:
        GapError: the description or the simulator cannot be used, or predicts no trial.
    """
    if source is None:
        return data
    simulator = open_simulator(source) if isinstance(source, (str, Path)) else source
    predicted = [simulator.simulate(trial, {}) for trial in data.trials]
    if not any(predicted):
        stages = " and ".join(stage.name for stage in simulator.stages)
        raise GapError(
            simulator.origin, f"predicts no trial of {data.origin}",
            f"the stage {stages} needs measured channels that no trial has",
        )  # fmt: skip
    stated = simulator.effects if isinstance(simulator, External) else NONE
    effects = Effects({**data.effects.values, **stated.values})
    of_simulator = simulator.notes if isinstance(simulator, External) else ()
    notes = (*data.notes, *of_simulator, *_beyond_domain(data, simulator))
    return dataclasses.replace(data, simulator=simulator, effects=effects, notes=notes)


def _beyond_domain(data: DataSet, simulator: ExternalSimulator) -> list[str]:
    """What share of the forces is not compared, because the law says nothing there."""
    domain = domain_of(simulator)
    if domain is None:
        return []
    outside: list[Mask] = []
    for trial in data.trials:
        sources = stage_sources(trial, FORCE_STAGE, {})
        if sources is None or "force_n" not in trial:
            continue
        at = trial["force_n"].time_s
        pressure, length = (sampled(name, sources[name], at) for name in FORCE_STAGE.inputs)
        outside.append(~holds(domain, pressure, length))
    share = float(np.concatenate(outside).mean()) if outside else 0.0
    if share == 0.0:
        return []
    (p_low, p_high), (l_low, l_high) = domain.pressure_kpa, domain.length_mm
    return [
        f"{100.0 * share:.0f} % of the forces are not compared: they lie beyond the domain of the "
        f"law, {p_low:.4g} to {p_high:.4g} kPa and {l_low:.4g} to {l_high:.4g} mm"
    ]


def open_data_with(data: Path, simulator: Path | None) -> DataSet:
    """The data set of a folder or run, with the simulator of a description if one is named."""
    return with_simulator(open_data(data), simulator)


def _python(about: Description) -> External:
    if not about.flag("static"):
        return PythonSimulator(about)
    return StaticPythonSimulator(about)


def _fmu(about: Description) -> External:
    from gap.simulators.fmu import FmuSimulator, StaticFmuSimulator  # FMPy is optional

    return StaticFmuSimulator(about) if about.flag("static") else FmuSimulator(about)


_OPENERS: dict[str, Callable[[Description], External]] = {
    "python": _python,
    "fmu": _fmu,
    "predictions": Predictions,
    "law": open_law,
    "surface": Surface,
}
