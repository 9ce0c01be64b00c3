"""What a stage of a simulator is fed with: the inputs of a trial on one axis of time.

All channels of a trial are brought onto the instants at which any of them has a sample, so that
the edge of a valve command stands where it was recorded. Measured channels are interpolated in
straight lines, commands hold their last value.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gap.data.motion import moves
from gap.data.simulator import Stage
from gap.data.trial import SAME_S, Channel, Trial
from plant.arrays import Array


def wanted_times(trial: Trial, stage: Stage) -> Array | None:
    """Where a prediction is wanted: at the samples of the stage's output.

    The force of a hung load is wanted where its length was seen as well. None where nothing was
    measured that the prediction could be compared with.
    """
    times = [trial[stage.output].time_s] if stage.output in trial else []
    if stage.name == "force" and trial.load_kg > 0.0 and "length_mm" in trial:
        times.append(trial["length_mm"].time_s)
    return np.unique(np.concatenate(times)) if times else None


def length_of(trial: Trial) -> Channel | float | None:
    """The length that a model is fed with: the held one, or what was measured where it moved."""
    camera = trial.get("length_mm")
    known = bool(np.isfinite(trial.held_length_mm))
    if known and not moves(camera.value):
        return trial.held_length_mm
    return camera if len(camera) else None


def stage_sources(
    trial: Trial, stage: Stage, stated: Mapping[str, float]
) -> dict[str, Channel | float] | None:
    """The inputs of a stage by name; None if the trial lacks one that the stage cannot do without.

    Args:
        trial: of a data set.
        stage: of the chain.
        stated: values of channels that were not measured.
    """
    found: dict[str, Channel | float] = {}
    for name in stage.inputs:
        source = length_of(trial) if name == "length_mm" else trial.channels.get(name)
        source = stated.get(name) if source is None else source
        if source is not None:
            found[name] = source
        elif name != "supply_kpa":
            return None
    temperature = trial.channels.get("temperature_c")
    if temperature is not None:
        found["temperature_c"] = temperature
    elif np.isfinite(trial.temperature_c):
        found["temperature_c"] = trial.temperature_c
    elif "temperature_c" in stated:
        found["temperature_c"] = stated["temperature_c"]
    if np.isfinite(trial.load_kg):
        found["load_kg"] = trial.load_kg
    if stage.name == "pressure" and len(trial.get("pressure_kpa")):
        found["pressure_start_kpa"] = float(trial["pressure_kpa"].value[0])
    return found


def time_axis(sources: Mapping[str, Channel | float], wanted: Array, step_s: float) -> Array:
    """Every instant at which an input has a sample or the output is wanted, ascending.

    Args:
        sources: inputs of the stage.
        wanted: instants of the output.
        step_s: longest step; longer ones are divided. 0 for no limit.
    """
    times = [source.time_s for source in sources.values() if isinstance(source, Channel)]
    axis = np.unique(np.concatenate([*times, wanted]))
    axis = axis[np.r_[True, np.diff(axis) > SAME_S]]
    if step_s <= 0.0 or len(axis) < 2:
        return axis
    parts = np.maximum(np.ceil(np.diff(axis) / step_s - 1e-9), 1.0).astype(np.int64)
    first = np.repeat(axis[:-1], parts)
    number = np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts)
    inner = first + number * np.repeat(np.diff(axis) / parts, parts)
    return np.append(inner, axis[-1])
