"""What a data set cannot show for want of a column, by the diagnosis's own definitions.

An effect can only be named if it changes a feature of the data. So each missing column is put in,
with values that a test could have, and the signatures of all candidate effects are computed with
and without it. Nothing here lists effects or what they need.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from gap.data.dataset import DataSet
from gap.data.trial import Channel, Trial
from gap.effects.candidates import CANDIDATES, Candidate
from gap.model.grid import make_grid
from gap.model.residuals import Model
from gap.model.sensitivities import candidate_columns
from plant.arrays import Array
from plant.constants import PlantConstants
from plant.effects.catalogue import CATALOGUE

_TRACE = 1e-9
"""A signature below this (kPa, N or mm per unit of the effect) is none."""
_MOST_TRIALS = 6
_MOST_SAMPLES = 1500
_POINTS = 64
_SPAN_S = 2.0


@dataclass(frozen=True)
class Cost:
    """What one missing column costs.

    Attributes:
        column: of trials.csv or samples, or "time_s".
        effects: ids that cannot be named without it, though they could with it.
        families: theirs, in the order of the catalogue.
    """

    column: str
    effects: tuple[str, ...]
    families: tuple[str, ...]


@dataclass(frozen=True)
class Costs:
    """What a data set can and cannot show.

    Attributes:
        shown: ids of the effects that change some feature of the data.
        missing: one entry for each missing column.
        together: ids that need more than one of the missing columns.
    """

    shown: tuple[str, ...]
    missing: tuple[Cost, ...]
    together: tuple[str, ...]


def costs_of(data: DataSet, order_known: bool = True) -> Costs:
    """What each column that is missing costs. Two columns may cost the same effect.

    Args:
        data: the data set as read.
        order_known: whether the order of its trials is known.
    """
    few = _few(data, order_known)
    shown = _shown(few)
    missing = {column: add for column, add in _COLUMNS.items() if _lacks(data, column, order_known)}
    found = []
    whole = few
    gained: set[str] = set()
    for column in missing:
        more = _shown(_with(few, column)) - shown
        gained |= more
        found.append(Cost(column, _sorted(more), _families(more)))
    # A muscle that carries a load moves, so the load decides which length is put in.
    for column in sorted(missing, key=lambda name: name not in ("time_s", "load_kg")):
        whole = _with(whole, column)
    together = _shown(whole) - shown - gained if missing else set()
    return Costs(_sorted(shown), tuple(found), _sorted(together))


def _sorted(ids: set[str]) -> tuple[str, ...]:
    return tuple(name for name in CATALOGUE if name in ids)


def _families(ids: set[str]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(CATALOGUE[name].family for name in _sorted(ids)))


def _shown(data: DataSet) -> set[str]:
    """Ids of the catalogue whose signature in this data is not zero."""
    model = Model(make_grid(data))
    found: set[str] = set()
    timed = not data.settled
    for candidate in CANDIDATES:
        if candidate.defect or candidate.id in found:
            continue
        if not (timed or candidate.search.scan != "clock"):
            continue
        if _trace(model, data.constants, candidate):
            found.add(candidate.id)
    return found


def _trace(model: Model, constants: PlantConstants, candidate: Candidate) -> bool:
    column = candidate_columns(model, constants, [], [candidate])
    return bool(np.abs(np.nan_to_num(column)).max(initial=0.0) > _TRACE)


def _few(data: DataSet, order_known: bool) -> DataSet:
    """A few trials of the data, shortened: enough to see which effects can show at all."""
    step = max(1, len(data.trials) // _MOST_TRIALS)
    trials = [_shortened(trial) for trial in data.trials[::step][:_MOST_TRIALS]]
    if len(trials) == 1:
        trials = [trials[0], replace(trials[0], name=f"{trials[0].name} again")]
    if not order_known:
        trials = [replace(trial, order=0.0) for trial in trials]
    elif len({trial.order for trial in trials}) == 1:
        trials = [replace(trial, order=float(k)) for k, trial in enumerate(trials)]
    return replace(data, trials=tuple(trials))


def _shortened(trial: Trial) -> Trial:
    longest = max((len(channel) for channel in trial.channels.values()), default=0)
    if longest <= _MOST_SAMPLES or trial.settled:
        return trial
    end = max(
        float(channel.time_s[min(_MOST_SAMPLES, len(channel) - 1)])
        for channel in trial.channels.values()
        if len(channel) == longest
    )
    kept = {
        name: Channel(channel.time_s[channel.time_s <= end], channel.value[channel.time_s <= end])
        for name, channel in trial.channels.items()
    }
    return replace(trial, channels={name: ch for name, ch in kept.items() if len(ch)})


def _lacks(data: DataSet, column: str, order_known: bool) -> bool:
    trials = data.trials
    if column == "time_s":
        return all(trial.settled for trial in trials)
    if column == "order":
        return not order_known
    if column == "direction":
        return all(t.settled for t in trials) and not any(t.direction.any() for t in trials)
    if column == "load_kg":
        return not any(np.isfinite(trial.load_kg) for trial in trials)
    if column == "temperature_c":
        return not any(column in t or np.isfinite(t.temperature_c) for t in trials)
    if column == "valve commands":
        return not any("inlet_cmd" in trial or "outlet_cmd" in trial for trial in trials)
    return not any(column in trial for trial in trials)


def _with(data: DataSet, column: str) -> DataSet:
    """The data with a column that it lacks, in all trials."""
    add = _COLUMNS[column]
    made = [add(trial, k, data.constants) for k, trial in enumerate(data.trials)]
    return replace(data, trials=tuple(made))


def _times(trial: Trial) -> Array:
    """Times of the longest channel of a trial."""
    longest = max(trial.channels.values(), key=len)
    return longest.time_s


def _added(trial: Trial, **channels: Array) -> Trial:
    at = _times(trial)
    more = {name: Channel(at, value) for name, value in channels.items()}
    return replace(trial, channels={**trial.channels, **more})


def _ramp(trial: Trial, low: float, high: float) -> Array:
    return np.linspace(low, high, len(_times(trial)))


def _time(trial: Trial, k: int, c: PlantConstants) -> Trial:
    """The points as samples of a course in time, ten samples from one to the next."""
    rows = max(len(channel) for channel in trial.channels.values())
    count = max(_POINTS, 10 * rows)
    at = np.linspace(0.0, _SPAN_S, count)
    place = np.linspace(0.0, rows - 1, count)
    channels = {
        name: Channel(at, np.interp(place, channel.time_s, channel.value))
        for name, channel in trial.channels.items()
    }
    return replace(
        trial, settled=False, channels=channels, direction=np.zeros(count, dtype=np.int64)
    )


def _pressure(trial: Trial, k: int, c: PlantConstants) -> Trial:
    return _added(trial, pressure_kpa=_ramp(trial, 0.0, 0.8e-3 * c.supply_pa))


def _force(trial: Trial, k: int, c: PlantConstants) -> Trial:
    return _added(trial, force_n=_ramp(trial, 0.0, 10.0))


def _length(trial: Trial, k: int, c: PlantConstants) -> Trial:
    """Where a length is held, the camera sees it; where none is stated, the muscle moves."""
    if np.isfinite(trial.held_length_mm):
        return _added(trial, length_mm=np.full(len(_times(trial)), trial.held_length_mm))
    return _added(trial, length_mm=_ramp(trial, 1e3 * c.length_min_m, 1e3 * c.length_max_m))


def _temperature(trial: Trial, k: int, c: PlantConstants) -> Trial:
    return _added(trial, temperature_c=_ramp(trial, 20.0, 40.0))


def _supply(trial: Trial, k: int, c: PlantConstants) -> Trial:
    return _added(trial, supply_kpa=_ramp(trial, 1e-3 * c.supply_pa, 0.9e-3 * c.supply_pa))


def _commands(trial: Trial, k: int, c: PlantConstants) -> Trial:
    if trial.settled:
        return trial
    part = np.linspace(0.0, 4.0, len(_times(trial)), endpoint=False).astype(np.int64)
    return _added(
        trial, inlet_cmd=(part == 1).astype(np.float64), outlet_cmd=(part == 3).astype(np.float64)
    )


def _load(trial: Trial, k: int, c: PlantConstants) -> Trial:
    return replace(trial, load_kg=1.0, held_length_mm=float("nan"))


def _order(trial: Trial, k: int, c: PlantConstants) -> Trial:
    return replace(trial, order=float(k))


def _direction(trial: Trial, k: int, c: PlantConstants) -> Trial:
    if not trial.settled:
        return trial
    return replace(trial, direction=np.where(np.arange(len(trial.direction)) % 2, 1, -1))


_COLUMNS: Mapping[str, Callable[[Trial, int, PlantConstants], Trial]] = {
    "time_s": _time,
    "pressure_kpa": _pressure,
    "length_mm": _length,
    "force_n": _force,
    "supply_kpa": _supply,
    "valve commands": _commands,
    "temperature_c": _temperature,
    "load_kg": _load,
    "direction": _direction,
    "order": _order,
}
"""What a data set may lack, and what puts it in."""
