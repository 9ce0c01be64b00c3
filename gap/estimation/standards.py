"""What readings of reference standards say of the instruments, before any test is explained.

An instrument that reads a standard wrong by more than is stated of it has an error that needs no
explanation by tests any more: it is stated, and the tests are diagnosed with it. One that reads
right has none that tests could show.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np
from scipy.optimize import least_squares

from daq.calibration import StandardReading
from gap.data.dataset import DataSet
from gap.errors import GapError
from plant.arrays import Array
from plant.constants import PlantConstants
from plant.effects.catalogue import CATALOGUE
from plant.effects.effects import NONE, Effects
from plant.errors import PlantError
from plant.simulator.readings import read_force, read_length, read_pressure
from plant.simulator.simulate import held_offset_mm


def _of_sensor(hook: str) -> tuple[str, ...]:
    """Effects on what one instrument shows, by their hook in the sensors."""
    return tuple(e.id for e in CATALOGUE.values() if getattr(e.sensors, hook) is not None)


ERRORS_OF: Mapping[str, tuple[str, ...]] = {
    "length_mm": _of_sensor("camera"),
    "held_length_mm": _of_sensor("held"),
    "pressure_kpa": _of_sensor("pressure"),
    "force_n": _of_sensor("force"),
}
"""Effects that a standard shows, by the channel that reads it."""
_STATED: Mapping[str, tuple[str, str]] = {
    "length_mm": ("length_zero_mm", "length_gain_percent"),
    "pressure_kpa": ("pressure_zero_kpa", "pressure_gain_percent"),
    "force_n": ("force_zero_n", "force_gain_percent"),
}
"""Keys of calibration.toml for zero and gain of a channel."""
_FULL = "full_"
"""What the name of a scale's full value begins with."""
SHOWN_CHI2 = 9.0
"""Chi-square from which an error is more than what is stated of the instrument: three standard
deviations. A matter of definition."""
_COARSE = 2.0
"""Times the accuracy that the advice counts on (`Effect.reference`) up to which a standard clears
an instrument. No other value was tried."""


@dataclass(frozen=True)
class StandardCheck:
    """What the standards show.

    Attributes:
        effects: errors of instruments that stand out, as a plant file states them.
        errors: headline parameter of each of them, with its standard uncertainty.
        cleared: effects of which the standards show nothing, and would have.
    """

    effects: Effects = NONE
    errors: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    cleared: tuple[str, ...] = ()

    @property
    def measured(self) -> tuple[str, ...]:
        """Ids of all that the standards have told, for better or worse."""
        return (*self.shown, *self.cleared)

    @property
    def shown(self) -> tuple[str, ...]:
        """Ids of the errors that stand out."""
        return tuple(self.effects.values)


@dataclass(frozen=True)
class _Fit:
    ids: tuple[str, ...]
    amounts: Array
    covariance: Array
    chi2: float
    scale: Mapping[str, float] = field(default_factory=dict)
    """What a plant file states beside the headline of a scale that bends, the first of `ids`."""


def check_standards(data: DataSet) -> StandardCheck:
    """Compare each instrument with the standards that it read.

    An error stands out by 9 in chi-square beside what calibration.toml states of the channel's zero
    and gain, and the uncertainties of the readings. Two errors of one instrument need that each.

    Raises:
        GapError: an error is larger than its effect may be.
    """
    shown: dict[str, Mapping[str, float | str]] = {}
    errors: dict[str, tuple[float, float]] = {}
    cleared: list[str] = []
    for channel, names in ERRORS_OF.items():
        own = [one for one in data.standards if one.channel == channel]
        if not own:
            continue
        found = _errors_of(channel, own, names, data)
        for k, name in enumerate(found.ids):
            headline = str(CATALOGUE[name].headline)
            amount = data.effects.get(name, headline) + float(found.amounts[k])
            bend = found.scale if k == 0 else {}
            shown[name] = {**data.effects.values.get(name, {}), headline: amount, **bend}
            errors[name] = amount, float(np.sqrt(found.covariance[k, k]))
        cleared += [n for n in names if n not in found.ids and _would_show(n, own, data.constants)]
    try:
        effects = Effects.from_config(shown)
    except PlantError as error:
        raise GapError(
            f"{data.origin}, standards.csv", f"shows an error of an instrument that is too large "
            f"({error})", "check true and read, and calibrate the instrument",
        ) from None  # fmt: skip
    return StandardCheck(effects, errors, tuple(cleared))


def with_known_errors(data: DataSet) -> tuple[DataSet, StandardCheck]:
    """The data set with what its standards show as stated, and what that is.

    Without standards it is the same data set.
    """
    if not data.standards:
        return data, StandardCheck()
    check = check_standards(data)
    stated = Effects({**data.effects.values, **check.effects.values})
    calibration = dict(data.calibration)
    for name, (_, u) in check.errors.items():
        key = CATALOGUE[name].calibration
        if key:  # how well the error is known takes the place of what was stated
            calibration[key] = max(calibration.get(key, 0.0), u)
    return replace(data, effects=stated, calibration=calibration, standards=()), check


def _read(channel: str, true: Array, constants: PlantConstants, effects: Effects) -> Array:
    """What a channel shows of true values with these effects."""
    match channel:
        case "length_mm":
            found = read_length(true, constants, effects)
        case "pressure_kpa":
            found = read_pressure(true, effects)
        case "force_n":
            found = read_force(true, effects)
        case _:
            found = true - held_offset_mm(true, constants, effects)
    return found


def _unit(name: str, own: Sequence[StandardReading], constants: PlantConstants) -> Array:
    """What an error of one in its headline parameter does to the readings."""
    true = np.array([one.true for one in own])
    one = Effects.from_config({name: {str(CATALOGUE[name].headline): 1.0}})
    off: Array = _read(own[0].channel, true, constants, one) - true
    return off


def _errors_of(
    channel: str, own: Sequence[StandardReading], names: tuple[str, ...], data: DataSet
) -> _Fit:
    """The errors that explain the readings, none where what is stated of the channel does."""
    true = np.array([one.true for one in own])
    off = np.array([one.read for one in own]) - _read(channel, true, data.constants, data.effects)
    covariance = np.diag([one.u**2 for one in own])
    if channel in _STATED:
        zero, gain = (data.calibration.get(key, 0.0) for key in _STATED[channel])
        covariance += zero**2 + (gain / 100.0) ** 2 * np.outer(true, true)
    weight = np.linalg.inv(covariance)
    best = _Fit((), np.zeros(0), np.zeros((0, 0)), float(off @ weight @ off))
    for count in (1, 2):
        tried = [
            _fitted(some, off, weight, own, data.constants)
            for some in combinations(names, count)
            if len(set(true)) >= count
        ]
        least = min((one for one in tried if one), key=lambda one: one.chi2, default=None)
        if least is not None and best.chi2 - least.chi2 > SHOWN_CHI2:
            best = least
    for name in names:
        if CATALOGUE[name].search.curve is not None and name not in data.effects.values:
            best = _bent(name, best, off, weight, own, data.constants)
    return best


def _bent(
    name: str, straight: _Fit, off: Array, weight: Array, own: Sequence[StandardReading],
    constants: PlantConstants,
) -> _Fit:  # fmt: skip
    """The fit with a scale that bends, where each of its numbers is worth 9 in chi-square.

    It goes with a power of the value, or along the curve of the effect, as plant files state them;
    alone, or beside what else the straight fit has.
    """
    search = CATALOGUE[name].search
    others = tuple(other for other in straight.ids if other != name)
    best = straight
    for keys in (("power",), tuple(search.curve or ())):
        if not set(keys) <= set(search.free):
            continue
        for beside in dict.fromkeys(((), others)):
            found = _along(name, keys, beside, off, weight, own, constants)
            more = _numbers(found) - _numbers(best) if found is not None else 0
            if found is not None and best.chi2 - found.chi2 > SHOWN_CHI2 * max(more, 1):
                best = found
    return best


def _numbers(fit: _Fit) -> int:
    """How many numbers were fitted: the full value of a scale is none."""
    return len(fit.ids) + sum(not key.startswith(_FULL) for key in fit.scale)


def _along(
    name: str, keys: tuple[str, ...], beside: tuple[str, ...], off: Array, weight: Array,
    own: Sequence[StandardReading], constants: PlantConstants,
) -> _Fit | None:  # fmt: skip
    """A scale that bends by some numbers, beside other errors; None where too few readings tell."""
    effect = CATALOGUE[name]
    true = np.array([one.true for one in own])
    if len(set(true)) < len(keys) + 2 + len(beside) or not true.max() > 0.0:
        return None
    full = [p.name for p in effect.parameters if p.name.startswith(_FULL)]
    columns = [_unit(other, own, constants) for other in beside]
    root = np.linalg.cholesky(weight).T

    def scale(x: Array) -> dict[str, float]:
        numbers = dict(zip(keys, np.exp(x[1 : 1 + len(keys)]).tolist(), strict=True))
        return {**numbers, **dict.fromkeys(full, float(true.max()))}

    def left(x: Array) -> Array:
        stated = {str(effect.headline): float(x[0]), **scale(x)}
        shown = _read(own[0].channel, true, constants, Effects.from_config({name: stated}))
        rest = off - (shown - true)
        for amount, column in zip(x[1 + len(keys) :], columns, strict=True):
            rest = rest - amount * column
        return np.asarray(root @ rest)

    most = effect.parameters[0].high
    first = float(off[np.argmax(true)] / _unit(name, own, constants)[np.argmax(true)])
    start = np.r_[np.clip(first, -0.9 * most, 0.9 * most), np.zeros(len(keys) + len(beside))]
    low, high = zip(*(effect.search.free[key] for key in keys), strict=True)
    open_end = np.full(len(beside), np.inf)
    bounds = np.r_[-most, np.log(low), -open_end], np.r_[most, np.log(high), open_end]
    fit = least_squares(left, start, bounds=bounds, x_scale="jac")
    covariance = np.linalg.pinv(fit.jac.T @ fit.jac)
    kept = [0, *range(1 + len(keys), len(fit.x))]
    chi2 = float(np.sum(fit.fun**2))
    return _Fit((name, *beside), fit.x[kept], covariance[np.ix_(kept, kept)], chi2, scale(fit.x))


def _fitted(
    names: tuple[str, ...], off: Array, weight: Array, own: Sequence[StandardReading],
    constants: PlantConstants,
) -> _Fit | None:  # fmt: skip
    """Some errors fitted to what the readings are off by; None where the standards tell none."""
    columns = np.stack([_unit(name, own, constants) for name in names], axis=1)
    inner = columns.T @ weight @ columns
    if np.linalg.matrix_rank(columns) < len(names) or np.linalg.cond(inner) > _SINGULAR:
        return None
    covariance = np.asarray(np.linalg.inv(inner), dtype=np.float64)
    amounts = np.asarray(covariance @ (columns.T @ weight @ off), dtype=np.float64)
    rest = off - columns @ amounts
    return _Fit(names, amounts, covariance, float(rest @ weight @ rest))


_SINGULAR = 1e10


def _would_show(name: str, own: Sequence[StandardReading], constants: PlantConstants) -> bool:
    """Whether the readings would show the error, whatever else the instrument may have."""
    names = [name, *(n for n in ERRORS_OF[own[0].channel] if n != name)]
    accuracy = np.array([_accuracy(n) for n in names])
    columns = np.stack([_unit(n, own, constants) for n in names], axis=1)
    weighted = columns / np.array([[one.u] for one in own]) * accuracy
    free = np.eye(len(names)) / _FREE**2
    covariance = np.linalg.inv(weighted.T @ weighted + free)
    return bool(np.sqrt(covariance[0, 0]) <= _COARSE)


_FREE = 1e3
"""Times the accuracy of a standard that an error may amount to: as much as wanted."""


def _accuracy(name: str) -> float:
    """What the advice takes for the accuracy of the standard, in the headline parameter."""
    reference = CATALOGUE[name].reference
    assert reference is not None, name
    return reference[1]
