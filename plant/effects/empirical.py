"""A measured correction of one reading: what is left of a gap whose cause has no name.

    [empirical.force]
    unit = "N"
    [[empirical.force.terms]]
    inputs = ["pressure_kpa", "length_mm"]
    knots = [[0.0, 200.0, 500.0], [52.0, 60.0, 70.0]]
    coefficients = [...]                 # one a pair of splines, the last input runs fastest

The correction is added to the prediction of one block: force (pull of the muscle, N), load (pull
that a hung load asks for, N), pressure (kPa) or camera (mm). It is a sum of terms, each a product
of B-splines of its inputs (de Boor, A Practical Guide to Splines, 1978): cubic on four knots or
more, straight between two or three. An input outside its knots counts as the nearest knot: beyond
its domain a correction is held at its edge. A term with a `scale` is multiplied by what the braid
of the same plant file says at that pressure and length: its pull in N ("pull"), or how that changes
by 1 kPa ("pull_per_kpa") or by 1 mm ("pull_per_mm"); its splines then give a share of the pull, an
error of the pressure in kPa or of the length in mm. With the scale "flow" its splines give a flow
in mg/s into the chamber, whose pressure it raises, with "valve_flow" a share of the flow of the
valve that is open, with "inlet_flow" or "outlet_flow" of that one alone; with "inlet_on_ms",
"inlet_off_ms", "outlet_on_ms" or "outlet_off_ms" the time in ms by which that valve opens or shuts
later than its delay says, with "opens_ms", "shuts_ms" or "edges_ms" that by which both valves do
the one, the other or both; with "short_pulses" the share that passes of commands too short for
their valve to move by its delays, with "supply" what the supply is above the stated one, in kPa.
What a flow raised is forgotten with `FORGOTTEN_S`.
With the scale "reading" its splines are what the gauge shows too much, in kPa: the gas itself is
below the reading by as much. With "cell" those of a force are what its cell shows too much, in N: a
load that hangs on it is below its reading by as much; with "cell_gain" they are that as a share of
the pull. With "seen" those of a force or load are what the camera shows too much, in mm: where the
length was read, and not held at a stated one, the muscle is shorter by as much.

A term with a `period` repeats in its first input: in the place of splines it has cosine and sine of
that period and of half of it, in this order, and goes on beyond its knots, which say where it was
learnt. A correction says nothing of another bench.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.interpolate import BSpline

from plant.arrays import Array
from plant.constants import GAS_CONSTANT_J_KG_K, PlantConstants
from plant.errors import PlantError
from plant.physics.muscle import braid_force, braid_force_slope, braid_volume

BLOCKS = {"force": "N", "load": "N", "pressure": "kPa", "camera": "mm"}
"""Readings that a correction can be added to, with its unit."""
SHIFTS_S: Mapping[str, float] = {
    **{f"moves_{ms}ms_mm": 1e-3 * ms for ms in (50, 100, 150)},
    **{f"moved_{ms}ms_mm": -1e-3 * ms for ms in (50, 100, 150)},
}
"""Inputs that are what the length does within a time from now on, or has done within one before, s:
a camera whose clock is off shows the length of another instant."""
INPUTS = {
    "pressure_kpa": "pressure",
    "length_mm": "length",
    "velocity_mm_s": "velocity",
    **dict.fromkeys(SHIFTS_S, "velocity"),
    "pressure_rate_kpa_s": "pressure rate",
    "temperature_c": "temperature",
    "order": "order",
    "time_s": "history",
    "since_edge_s": "history",
    "valve": "history",
    "openings": "history",
    "slip": "history",
    "change_1s_kpa": "history",
    "change_10s_kpa": "history",
    "pull_change_1s_n": "history",
    "pull_change_10s_n": "history",
    "pull_change_100s_n": "history",
}
"""Inputs of a correction, and what a person calls each."""
CELL = "cell"
"""Scale of a term of the force whose splines are what the force cell shows too much, N."""
CELL_GAIN = "cell_gain"
"""The same as a share of the pull, and for a load as a share of what the cell reads of it."""
OF_CELL = (CELL, CELL_GAIN)
"""Scales of errors of the force cell, which a load shows as well."""
SCALES = ("pull", "pull_per_kpa", "pull_per_mm")
"""What the splines of a force can be multiplied by, all of the braid at a pressure and a length."""
SEEN = "seen"
"""Scale of a term of the force or load whose splines are what the camera shows too much, mm."""
FLOW = "flow"
"""Scale of a term of the pressure whose splines are a flow into the chamber, mg/s."""
VALVE_FLOW = "valve_flow"
"""Scale of a term of the pressure whose splines are a share of the valve's own flow."""
INLET_FLOW = "inlet_flow"
"""Scale of a term of the pressure whose splines are a share of the inlet's flow."""
OUTLET_FLOW = "outlet_flow"
"""The same of the outlet."""
LATE = ("inlet_on_ms", "inlet_off_ms", "outlet_on_ms", "outlet_off_ms")
"""Scales of a term of the pressure whose splines are ms by which a valve opens or shuts late."""
ALL_LATE: Mapping[str, tuple[str, ...]] = {
    **{scale: (scale,) for scale in LATE},
    "opens_ms": ("inlet_on_ms", "outlet_on_ms"),
    "shuts_ms": ("inlet_off_ms", "outlet_off_ms"),
    "edges_ms": LATE,
}
"""Scales of one valve or both that are late, with those of `LATE` that each stands for."""
SHORT_PULSES = "short_pulses"
"""Scale of a term of the pressure whose splines are the share that passes of short commands."""
SUPPLY = "supply"
"""Scale of a term of the pressure whose splines are kPa that the supply is above what is stated."""
FLOWS = (FLOW, VALVE_FLOW, INLET_FLOW, OUTLET_FLOW, *ALL_LATE, SHORT_PULSES, SUPPLY)
"""Scales of terms whose flow the simulated gas takes in."""
READING = "reading"
"""Scale of a term of the pressure whose splines are what the gauge shows too much, kPa."""
IN_GAS = (*FLOWS, READING)
"""Scales of terms that are part of the simulation of the gas."""
SCALE_INPUTS: Mapping[str, tuple[str, ...]] = {
    "": (),
    "pull": ("pressure_kpa", "length_mm"),
    "pull_per_kpa": ("length_mm",),
    "pull_per_mm": ("pressure_kpa", "length_mm"),
    SEEN: ("pressure_kpa", "length_mm"),
    CELL_GAIN: ("pressure_kpa", "length_mm"),
    **dict.fromkeys((*IN_GAS, CELL), ()),
}
"""Inputs that a scale is itself made of; that of a flow is what the valves did before."""
_SCALES_OF = {
    "force": (*SCALES, *OF_CELL, SEEN), "load": (*SCALES, SEEN), "pressure": IN_GAS, "camera": (),
}  # fmt: skip
FORGOTTEN_S = 5.0
"""Time constant with which the diagnosis draws a predicted pressure to the reading."""
WAVES = 4
"""Columns of an input in which a term repeats."""
Waves = Mapping[tuple[str, float], Array]
"""Columns of waves by input and period, shape (instants, `WAVES`) each."""
STATIC = ("pressure_kpa", "length_mm")
"""Inputs that a law without time has."""


@dataclass(frozen=True)
class SplineTerm:
    """Products of B-splines of one or two inputs, or a constant where there is no input.

    Attributes:
        knots: ascending, one tuple an input, in its unit.
        coefficients: one a product of splines, the last input running fastest.
        scale: one of `SCALES` that the splines are multiplied by, one of `IN_GAS`, `OF_CELL`,
            `SEEN`, or "" for none.
        period: with which it repeats in its first input, in that input's unit; 0 for splines.
    """

    inputs: tuple[str, ...]
    knots: tuple[tuple[float, ...], ...]
    coefficients: tuple[float, ...]
    scale: str = ""
    period: float = 0.0

    def value(self, at: Mapping[str, Array], count: int, waves: Waves | None = None) -> Array:
        """Value at `count` instants, shape (count,); see `Correction.value`."""
        made = self.splines(at, count, waves)
        return np.asarray(made * at[self.scale] if self.scale not in ("", CELL) else made)

    def splines(self, at: Mapping[str, Array], count: int, waves: Waves | None = None) -> Array:
        """Value before it is multiplied by the scale, shape (count,)."""
        first = None
        if self.period:
            first = (waves or {}).get((self.inputs[0], self.period))
            if first is None:
                first = wave_columns(at[self.inputs[0]], self.period)
        columns = product_splines([at[name] for name in self.inputs], self.knots, count, first)
        return np.asarray(columns @ np.asarray(self.coefficients))


@dataclass(frozen=True)
class Correction:
    """What is added to the prediction of one block; zero without terms."""

    block: str
    terms: tuple[SplineTerm, ...]

    @property
    def inputs(self) -> tuple[str, ...]:
        """Inputs that it needs, in the order of `INPUTS`."""
        return tuple(name for name in INPUTS if any(name in term.inputs for term in self.terms))

    @property
    def scales(self) -> tuple[str, ...]:
        """Scales that it needs."""
        own = (*SCALES, SEEN, CELL_GAIN)
        return tuple(name for name in own if any(term.scale == name for term in self.terms))

    @property
    def periods(self) -> tuple[tuple[str, float], ...]:
        """Inputs in which it repeats, each with its period."""
        return tuple(dict.fromkeys((t.inputs[0], t.period) for t in self.terms if t.period))

    @property
    def domain(self) -> dict[str, tuple[float, float]]:
        """Range of each input; outside it the correction is held at its edge."""
        made: dict[str, tuple[float, float]] = {}
        for term in self.terms:
            for name, knots in zip(term.inputs, term.knots, strict=True):
                low, high = made.get(name, (knots[0], knots[-1]))
                made[name] = (min(low, knots[0]), max(high, knots[-1]))
        return {name: made[name] for name in self.inputs}

    def value(self, at: Mapping[str, Array], count: int, waves: Waves | None = None) -> Array:
        """Correction at `count` instants in the block's unit, shape (count,).

        Args:
            at: each input and each scale that it needs, shape (count,).
            waves: means of waves where an instant stands for a while, by input and period; those
                that are not there are taken at the instant, shape (count, `WAVES`).
        """
        made = np.zeros(count)
        for term in self.terms:
            made += term.value(at, count, waves)
        return made

    def as_config(self) -> dict[str, Any]:
        """The table that `Corrections.from_config` reads."""
        return {
            "unit": BLOCKS[self.block],
            "terms": [
                {
                    "inputs": list(t.inputs),
                    "knots": [list(k) for k in t.knots],
                    "coefficients": list(t.coefficients),
                    **({"scale": t.scale} if t.scale else {}),
                    **({"period": t.period} if t.period else {}),
                }
                for t in self.terms
            ],
        }


@dataclass(frozen=True)
class Corrections:
    """The corrections that a plant file states, by block."""

    of: Mapping[str, Correction] = field(default_factory=dict)

    def __bool__(self) -> bool:
        return bool(self.of)

    @classmethod
    def from_config(cls, config: object, origin: str = "empirical") -> Corrections:
        """Read the tables `[empirical.<block>]`; `origin` names the file in errors.

        Raises `PlantError` for a block, key or input that is not known, and for knots and
        coefficients that do not belong together.
        """
        made = {}
        for block, table in _table(config, origin).items():
            where = f"{origin}.{block}"
            if block not in BLOCKS:
                raise PlantError(f"{origin}: unknown block {block!r}; known: {', '.join(BLOCKS)}")
            known = _table(table, where)
            _only(known, ("unit", "terms"), where)
            if known.get("unit") != BLOCKS[block]:
                raise PlantError(
                    f"{where}: unit = {known.get('unit')!r}; expected {BLOCKS[block]!r}"
                )
            terms = known.get("terms")
            if not isinstance(terms, list) or not terms:
                raise PlantError(f"{where}: terms is missing; expected one table or more")
            made[block] = Correction(
                block, tuple(_term(t, block, f"{where}.terms[{k}]") for k, t in enumerate(terms))
            )
        return cls(made)

    def refuse(self, what: str) -> None:
        """Raise `PlantError` where there is a correction: `what` cannot take one."""
        if self.of:
            raise PlantError(
                f"[empirical.{next(iter(self.of))}]: {what} cannot take a correction learnt from "
                "measured data; take the table out"
            )


UNCORRECTED = Corrections()
"""A plant without corrections."""


def braid_scales(p_pa: Array, length_m: Array, c: PlantConstants) -> dict[str, Array]:
    """All `SCALES` of the plant's braid, shape of the arguments: N, N/kPa and N/mm."""
    per_pa = braid_force(np.ones_like(p_pa), length_m, c.braid_length_m, c.turns)
    return {
        "pull": np.asarray(per_pa * p_pa),
        "pull_per_kpa": np.asarray(per_pa * 1e3),
        "pull_per_mm": np.asarray(braid_force_slope(p_pa, length_m, c.turns) * 1e-3),
    }


def pressure_per_flow(length_m: Array, c: PlantConstants) -> Array:
    """How fast a flow of 1 mg/s raises the pressure of the muscle, kPa/s, at lengths in m.

    An ideal gas at the constants' temperature: dp/dt = R T/V dm/dt.
    """
    volume = braid_volume(length_m, c.braid_length_m, c.turns) + c.dead_volume_m3
    return np.asarray(1e-9 * GAS_CONSTANT_J_KG_K * c.gas_temperature_k / volume)


def spline_columns(x: Array, knots: tuple[float, ...]) -> Array:
    """B-splines of x, shape (n, splines): hats on two or three knots, cubic on more.

    They add up to one everywhere; outside the knots x counts as the nearest one.
    """
    degree = 3 if len(knots) > 3 else 1
    whole = np.r_[[knots[0]] * degree, knots, [knots[-1]] * degree]
    inside = np.clip(x, knots[0], knots[-1])
    return np.asarray(BSpline.design_matrix(inside, whole, degree).toarray())


def wave_columns(x: Array, period: float) -> Array:
    """Cosine and sine of x with a period, and with half of it, shape (n, `WAVES`)."""
    times = np.arange(1.0, WAVES // 2 + 1)
    turns = 2.0 * np.pi * np.asarray(x, dtype=np.float64)[:, None] / period * times
    return np.stack([np.cos(turns), np.sin(turns)], axis=2).reshape(len(turns), WAVES)


def product_splines(
    x: list[Array], knots: tuple[tuple[float, ...], ...], count: int, first: Array | None = None
) -> Array:
    """Products of the splines of each input, shape (count, products); a one without any input.

    `first` are columns that stand in the place of the splines of the first input: its waves.
    """
    made = np.ones((count, 1))
    for k, (values, own) in enumerate(zip(x, knots, strict=True)):
        if first is not None and k == 0:
            columns = first
        else:
            columns = spline_columns(np.asarray(values, dtype=np.float64), own)
        made = (made[:, :, None] * columns[:, None, :]).reshape(count, -1)
    return made


def splines_on(knots: tuple[float, ...]) -> int:
    """Number of splines that stand on these knots."""
    return len(knots) + (2 if len(knots) > 3 else 0)


def columns_on(knots: tuple[tuple[float, ...], ...], period: float = 0.0) -> list[int]:
    """Number of columns of each input: splines on its knots, or waves of the first."""
    return [WAVES if period and k == 0 else splines_on(own) for k, own in enumerate(knots)]


def _table(value: object, where: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise PlantError(f"{where} = {value!r:.40}: expected a table")
    return value


def _only(table: Mapping[str, Any], known: tuple[str, ...], where: str) -> None:
    for key in table:
        if key not in known:
            raise PlantError(f"{where}: unknown key {key!r}; known: {', '.join(known)}")


def _term(value: object, block: str, where: str) -> SplineTerm:
    table = _table(value, where)
    _only(table, ("inputs", "knots", "coefficients", "scale", "period"), where)
    inputs = table.get("inputs")
    if not isinstance(inputs, list) or len(inputs) > 2:
        raise PlantError(f"{where}: inputs = {inputs!r:.40}; expected a list of up to two inputs")
    for name in inputs:
        if not isinstance(name, str) or name not in INPUTS:
            raise PlantError(f"{where}: unknown input {name!r:.40}; known: {', '.join(INPUTS)}")
    knots = table.get("knots")
    if not isinstance(knots, list) or len(knots) != len(inputs):
        raise PlantError(f"{where}: knots: expected a list of numbers for each input")
    each = tuple(_numbers(k, f"{where}: knots") for k in knots)
    for name, own in zip(inputs, each, strict=True):
        if len(own) < 2 or not np.all(np.diff(own) > 0.0):
            raise PlantError(f"{where}: knots of {name}: expected two numbers or more that rise")
    period = _period(table.get("period", 0.0), bool(inputs), where)
    coefficients = _numbers(table.get("coefficients"), f"{where}: coefficients")
    needed = int(np.prod(columns_on(each, period), dtype=np.int64))
    if len(coefficients) != needed:
        raise PlantError(
            f"{where}: {len(coefficients)} coefficients; {needed} belong to these knots"
        )
    scale = table.get("scale", "")
    if scale not in ("", *_SCALES_OF[block]):
        allowed = ", ".join(_SCALES_OF[block]) or "none"
        raise PlantError(f"{where}: scale = {scale!r:.40}; allowed {allowed}")
    return SplineTerm(tuple(inputs), each, coefficients, scale, period)


def _period(value: object, has_input: bool, where: str) -> float:
    """Period of a term, 0 for none; `PlantError` where it is no period of an input."""
    (period,) = _numbers([value], f"{where}: period")
    if period and (period < _LEAST_PERIOD or not has_input):
        raise PlantError(
            f"{where}: period = {value!r:.40}; expected {_LEAST_PERIOD:g} or more, and an input"
        )
    return period


_LEAST_PERIOD = 1e-6


_MOST_NUMBERS = 2000


def _numbers(value: object, where: str) -> tuple[float, ...]:
    if not isinstance(value, list) or len(value) > _MOST_NUMBERS:
        raise PlantError(f"{where}: expected a list of up to {_MOST_NUMBERS} numbers")
    for one in value:
        number = isinstance(one, (int, float)) and not isinstance(one, bool)
        if not number or not np.isfinite(one):
            raise PlantError(f"{where}: {one!r:.40} is not a finite number")
    return tuple(float(one) for one in value)
