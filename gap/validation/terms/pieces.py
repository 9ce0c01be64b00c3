"""Pieces that an empirical term may be made of: splines of one input, or products of those of two.

Those of a force or a length are values at every row; those of the gas are flows into the chamber,
summed up over time to a pressure.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from gap.estimation.fit_problem import FitProblem, FitResult
from gap.model.empirical import (
    Flow,
    inputs_of,
    point_inputs_of,
    risen,
    short_pulses,
    shown_too_much,
    valve_flows,
    weighed,
)
from gap.model.features import BLOCKS
from gap.validation.terms.held_out_terms import Whole
from gap.validation.terms.waves import Wave
from plant.arrays import Array
from plant.effects.catalogue import CATALOGUE
from plant.effects.empirical import (
    ALL_LATE,
    CELL,
    CELL_GAIN,
    FLOW,
    FLOWS,
    INLET_FLOW,
    INPUTS,
    OF_CELL,
    OUTLET_FLOW,
    READING,
    SCALE_INPUTS,
    SCALES,
    SEEN,
    SHIFTS_S,
    SHORT_PULSES,
    SUPPLY,
    VALVE_FLOW,
    columns_on,
    product_splines,
)

_KNOTS = {"pressure_kpa": 9, "length_mm": 5, "time_s": 14, "since_edge_s": 9, "valve": 3}
_USUAL_KNOTS = 6
_CROSS_KNOTS = {"pressure_kpa": 4, "length_mm": 4, "since_edge_s": 4}
_USUAL_CROSS_KNOTS = 3
PULL_CHANGES = ("pull_change_1s_n", "pull_change_10s_n", "pull_change_100s_n")
"""Pull of the stated braid beyond its own mean over some time."""
MUSCLE_INPUTS = (
    "pressure_kpa", "length_mm", "velocity_mm_s", "pressure_rate_kpa_s", "temperature_c", "order",
    "time_s", "slip", "change_1s_kpa", "change_10s_kpa", *PULL_CHANGES, *SHIFTS_S,
)  # fmt: skip
GAS_INPUTS = (
    "pressure_kpa", "length_mm", "velocity_mm_s", "pressure_rate_kpa_s", "temperature_c", "order",
    "time_s", "since_edge_s", "valve", "openings", "change_1s_kpa",
)  # fmt: skip
_PRODUCTS = (
    ("pressure_kpa", "length_mm"), ("slip", "pressure_kpa"), ("slip", "length_mm"),
    ("velocity_mm_s", "length_mm"), ("velocity_mm_s", "pressure_kpa"),
    ("valve", "pressure_kpa"), ("valve", "since_edge_s"),
)  # fmt: skip
# A pressure or a length that is not what it is read as, and a pull that is not in proportion.
_SCALED = (
    ("pull_per_kpa", "pressure_kpa"), ("pull_per_kpa", "slip"), ("pull_per_kpa", "time_s"),
    ("pull_per_mm", "length_mm"), ("pull_per_mm", "pressure_kpa"), ("pull_per_mm", "velocity_mm_s"),
    ("pull", "length_mm"), ("pull", "temperature_c"), ("pull", "order"), ("pull", "slip"),
    ("pull", "time_s"), ("pull", "change_1s_kpa"), ("pull", "change_10s_kpa"),
    (CELL, "time_s"), (CELL, "temperature_c"), (CELL, "order"),
    (CELL_GAIN, "temperature_c"),
    (SEEN, "length_mm"), (SEEN, "velocity_mm_s"), (SEEN, "order"),
)  # fmt: skip
_SHIFTED = tuple((scale, name) for scale in ("pull_per_mm", SEEN) for name in SHIFTS_S)
"""A length of another instant; what that does not grow with in proportion is no shift in time."""
_FLOWS = (
    (FLOW, ("pressure_kpa",)), (FLOW, ("pressure_rate_kpa_s",)), (FLOW, ("velocity_mm_s",)),
    (FLOW, ("time_s",)), (FLOW, ("change_1s_kpa",)), (FLOW, ("valve",)),
    (FLOW, ("valve", "since_edge_s")), (FLOW, ("valve", "pressure_kpa")),
    (VALVE_FLOW, ("valve",)), (VALVE_FLOW, ("valve", "pressure_kpa")),
    (VALVE_FLOW, ("valve", "since_edge_s")), (VALVE_FLOW, ("valve", "time_s")),
    (VALVE_FLOW, ("valve", "order")),
    *((late, own) for late in ALL_LATE
      for own in ((), ("pressure_kpa",), ("time_s",), ("openings",), ("order",))),
    *((flow, own) for flow in (INLET_FLOW, OUTLET_FLOW)
      for own in ((), ("since_edge_s",), ("pressure_kpa",), ("time_s",), ("openings",))),
    (SHORT_PULSES, ()), (SHORT_PULSES, ("pressure_kpa",)),
    # What is the same everywhere is a constant of the plant.
    (SUPPLY, ("time_s",)), (SUPPLY, ("since_edge_s",)), (SUPPLY, ("order",)),
    *((READING, own) for own in ((), ("pressure_kpa",), ("temperature_c",), ("time_s",),
      ("order",))),
)  # fmt: skip
_HISTORY = "history"
_FLOW_KNOTS = {"time_s": 6}
_USUAL_FLOW_KNOTS = 3
_AROUND_ZERO = ("pressure_rate_kpa_s", "velocity_mm_s", "change_1s_kpa", "slip")
_EDGE_KNOTS = (0.0, 0.004, 0.012, 0.03, 0.08, 0.25, 2.0)
"""Seconds after an edge: valves take some ten milliseconds, gas some hundred."""


_START_KNOTS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0, 1.4, 2.0, 4.0, 8.0, 16.0, 32.0)
"""Seconds of a trial, close at its start, where a supply settles."""
_FINE = ("slip", "length_mm")
_FINE_MM = 0.5
"""Distance of knots by which a guide that sticks in one place is found. Set on: the spacing of
rows of practice set 43103."""
_MANY_KNOTS = 20
"""Knots of one input above which a piece counts as fine: more than any other piece has."""
_EVERY_MM = -1
"""In the place of a number of knots: as many as `_FINE_MM` asks for."""

_Knots = tuple[tuple[float, ...], ...]
ZERO, GAIN = "zero", "gain"
_ERRORS = {
    ("force", "", ()): ZERO,
    ("force", CELL, ()): ZERO,
    ("force", "pull", ()): GAIN,
    ("force", CELL_GAIN, ()): GAIN,
    ("pressure", "", ()): ZERO,
    ("pressure", "", ("pressure_kpa",)): GAIN,
    ("pressure", READING, ()): ZERO,
    ("pressure", READING, ("pressure_kpa",)): GAIN,
}
"""Parts that are an error of the sensor itself, by block, scale and inputs."""


@dataclass(frozen=True)
class Piece:
    """A term that may enter: an offset, splines of one input, or products of those of two.

    Attributes:
        scale: one of `SCALES` that they are multiplied by, or "".
        period: with which it repeats in its first input; 0 for splines.
        at: numbers of its columns among those of all pieces.
        rough: second differences of its coefficients as a form, shape (columns, columns).
    """

    inputs: tuple[str, ...]
    knots: tuple[tuple[float, ...], ...]
    scale: str
    at: Whole
    rough: Array
    period: float = 0.0

    def holds(self, other: Piece) -> bool:
        """Whether it can be what the other is: a product holds what its inputs do alone, splines
        hold a line.
        """
        inside = set(other.inputs) <= set(self.inputs)
        alike = self.scale == other.scale and self.period == other.period
        return alike and inside and len(self.at) >= len(other.at)

    @property
    def fine(self) -> bool:
        """Whether its knots are many: it strays where a slot has another range."""
        return any(len(own) > _MANY_KNOTS for own in self.knots)

    @property
    def groups(self) -> frozenset[str]:
        """What it depends on, as a person calls it: its inputs, and those of its scale.

        What a flow into the chamber does is its sum over time, a history.
        """
        made = frozenset(INPUTS[name] for name in (*self.inputs, *SCALE_INPUTS[self.scale]))
        return made | {_HISTORY} if self.scale in FLOWS else made


def groups_of(pieces: Iterable[Piece]) -> frozenset[str]:
    """What some pieces depend on together; see `Piece.groups`."""
    return frozenset[str]().union(*(piece.groups for piece in pieces))


def error_of_sensor(block: str, piece: Piece) -> str:
    """`ZERO` or `GAIN` where a piece of a block is such an error of its sensor, else ""."""
    return _ERRORS.get((block, piece.scale, piece.inputs), "")


def errors_of_entries(block: str, ids: Iterable[str]) -> frozenset[str]:
    """The same of the entries of the catalogue that are errors of the sensor of a block."""
    made: set[str] = set()
    for effect in (CATALOGUE[name] for name in ids if name in CATALOGUE):
        read = {"force": effect.sensors.force, "pressure": effect.sensors.pressure}.get(block)
        if read is not None:
            gain, zero = read(1.0)
            made |= {GAIN} if gain else set()
            made |= {ZERO} if zero else set()
    return frozenset(made)


def pieces_of(
    at: dict[str, Array], count: int, waves: Mapping[Wave, Array] = MappingProxyType({})
) -> tuple[tuple[Piece, ...], Array]:
    """All pieces that these inputs can make, and their columns side by side, shape (rows, columns).

    Args:
        at: inputs, and scales of a force, at every row, shape (rows,) each.
        count: number of rows.
        waves: what repeats, with its columns; each makes a piece, and one that grows with the
            pressure.
    """
    varied = {
        name: x
        for name, x in at.items()
        if name in INPUTS and np.ptp(x) > 1e-6 * (1.0 + np.abs(x).max())
    }
    single = [("", name) for name in varied if name not in SHIFTS_S]
    single += [(s, name) for s, name in _SCALED if s in at]
    wanted: list[tuple[str, tuple[str, ...], int]] = [("", (), 0)]
    wanted += [(scale, (), 0) for scale in (*SCALES, *OF_CELL, SEEN) if scale in at]
    wanted += [(scale, (name,), _most_knots(name, 1)) for scale, name in single]
    # A line carries to slots beyond the others' range, where splines go astray.
    lines = [one for one in single if one[1] != "since_edge_s"]
    lines += [(s, name) for s, name in _SHIFTED if s in at]
    wanted += [(scale, (name,), 2) for scale, name in lines]
    wanted += [("", pair, 0) for pair in _PRODUCTS]
    # What a fine product takes is shared out to its inputs by as fine splines of each.
    wanted += [("", inputs, _EVERY_MM) for inputs in (_FINE, ("length_mm",))]
    parts: list[tuple[_Knots, tuple[str, ...], str, Wave | None]] = []
    for scale, inputs, most in wanted:
        if not all(name in varied for name in inputs):
            continue
        knots = tuple(
            _fine_knots(varied[n], n)
            if most == _EVERY_MM
            else _knots(varied[n], most or _most_knots(n, len(inputs)), n)
            for n in inputs
        )
        if most == 2 and len(np.unique(np.round(varied[inputs[0]], 6))) <= 3:
            continue  # the splines on so few settings say as much
        parts.append((knots, inputs, scale, None))
    for wave in waves:
        for inputs in ((wave.input,), (wave.input, "pressure_kpa")):
            if all(name in varied for name in inputs):
                ends = tuple((float(varied[n].min()), float(varied[n].max())) for n in inputs)
                parts.append((ends, inputs, wave.scale, wave))
    made: list[Piece] = []
    columns: list[Array] = []
    first = 0
    for knots, inputs, scale, repeats in parts:
        shown, period = (waves[repeats], repeats.period) if repeats else (None, 0.0)
        own = product_splines([varied[n] for n in inputs], knots, count, shown)
        columns.append(own * at[scale][:, None] if scale else own)
        place = np.arange(first, first + own.shape[1])
        made.append(Piece(inputs, knots, scale, place, _rough(knots, period), period))
        first += own.shape[1]
    return tuple(made), np.hstack(columns) if columns else np.empty((count, 0))


def columns_in_load(problem: FitProblem, pieces: Iterable[Piece], width: int) -> Array:
    """What pieces of a force that are errors of its cell add to the load that it weighs.

    Returns:
        One row a feature of the problem, zero but in the load, shape (rows, width).
    """
    made = np.zeros((len(problem.rows), width))
    own = [piece for piece in pieces if piece.scale in OF_CELL]
    if own:
        here = problem.rows.block == BLOCKS.index("load")
        names = tuple(dict.fromkeys(name for piece in own for name in piece.inputs))
        at = inputs_of(problem.grid, "load", names)
        read = weighed(problem.grid)
        for piece in own:
            shown = product_splines([at[n] for n in piece.inputs], piece.knots, int(here.sum()))
            made[np.ix_(here, piece.at)] = -shown * read[piece.scale][:, None]
    return made


@dataclass(frozen=True)
class FlowColumns:
    """Columns of flows into the chamber, before they are summed up to a pressure.

    Attributes:
        values: splines at every point of the pressure, shape (points, columns).
        scales: of each column, one of `plant.effects.empirical.IN_GAS`.
    """

    values: Array
    scales: tuple[str, ...]

    def only(self, at: Whole) -> FlowColumns:
        """Some of the columns."""
        return FlowColumns(self.values[:, at], tuple(self.scales[k] for k in at.tolist()))

    def flow(self, beta: Array) -> Flow:
        """The flow with these coefficients, shape (columns,)."""
        scales = np.array(self.scales)
        return Flow({s: self.values[:, scales == s] @ beta[scales == s] for s in set(self.scales)})


NO_FLOWS = FlowColumns(np.empty((0, 0)), ())


def with_flows(
    problem: FitProblem, pieces: tuple[Piece, ...], first: int
) -> tuple[tuple[Piece, ...], FlowColumns]:
    """The pieces with those of flows into the chamber, whose columns are numbered from `first`."""
    at = point_inputs_of(problem.grid, "pressure", GAS_INPUTS)
    count = len(next(iter(at.values())))
    made = list(pieces)
    values: list[Array] = [np.empty((count, 0))]
    scales: list[str] = []
    forgets = bool(short_pulses(problem.grid, problem.data.constants).any())
    for scale, inputs in _FLOWS:
        if scale == SHORT_PULSES and not forgets:
            continue
        if any(np.ptp(at[name]) < 1e-6 for name in inputs):
            continue
        knots = tuple(_flow_knots(at[n], n, scale) for n in inputs)
        own = product_splines([at[n] for n in inputs], knots, count)
        values.append(own)
        width = own.shape[1]
        scales += [scale] * width
        made.append(Piece(inputs, knots, scale, np.arange(first, first + width), _rough(knots)))
        first += width
    return tuple(made), FlowColumns(np.hstack(values), tuple(scales))


def raised(problem: FitProblem, fit: FitResult, flows: FlowColumns) -> Array:
    """Pressure by which each flow, or error of the gauge, raises every row of a fit, kPa."""
    c = problem.constants(fit.shift)
    scales = np.array(flows.scales)
    flow = flows.values.copy()
    for scale, own in valve_flows(problem.grid, c).items():
        flow[:, scales == scale] *= own[:, None]
    shown = scales == READING
    made = risen(problem.grid, np.where(shown, 0.0, flow), c)
    if shown.any():  # what someone else has simulated follows no reading
        followed = not problem.model.covers("pressure")
        made[:, shown] = shown_too_much(problem.grid, flow[:, shown], c, followed)
    return made


def _flow_knots(x: Array, name: str, scale: str) -> tuple[float, ...]:
    if scale in (INLET_FLOW, OUTLET_FLOW, SUPPLY) and name == "time_s":
        last = float(x.max())
        return (0.0, *(t for t in _START_KNOTS if t < 0.9 * last), last)
    return _knots(x, _FLOW_KNOTS.get(name, _USUAL_FLOW_KNOTS), name)


def _fine_knots(x: Array, name: str) -> tuple[float, ...]:
    """Knots near enough for a place of the guide; only its direction matters of a slip."""
    if name != "length_mm":
        return (float(x.min()), float(x.max()))
    count = max(round(float(np.ptp(x)) / _FINE_MM), 3)
    return tuple(np.linspace(float(x.min()), float(x.max()), count + 1).tolist())


def _most_knots(name: str, inputs: int) -> int:
    if inputs == 1:
        return _KNOTS.get(name, _USUAL_KNOTS)
    return _CROSS_KNOTS.get(name, _USUAL_CROSS_KNOTS)


def _knots(x: Array, most: int, name: str) -> tuple[float, ...]:
    """Rising knots over the range of x: at its settings where these are few, else at quantiles."""
    if name == "since_edge_s":
        return _EDGE_KNOTS
    settings = np.unique(np.round(x, 6))
    if len(settings) <= 3:
        return tuple(settings.tolist())
    even = np.linspace(settings[0], settings[-1], most)
    quantiles = np.quantile(x, np.linspace(0.0, 1.0, most))
    # Half way: few rows must not leave a wide range to one spline, nor many a narrow one.
    if name in _AROUND_ZERO and settings[0] < 0.0 < settings[-1] and most == 3:
        return (float(settings[0]), 0.0, float(settings[-1]))
    inner = np.unique(np.round(0.5 * (even + quantiles), 6))
    apart = 1e-3 * float(np.ptp(inner))
    kept = [float(inner[0])]
    kept += [float(k) for k in inner[1:-1] if k - kept[-1] > apart and inner[-1] - k > apart]
    return (*kept, float(inner[-1]))


_SLOPE = 0.25
"""Weight of first differences beside second ones: where no row is, a spline comes to rest within
some knots. Set on: practice sets 44321 and 44343; 1 and 4 do as well."""


def _rough(knots: _Knots, period: float = 0.0) -> Array:
    """Sum of squared second and first differences along each input (Eilers and Marx 1996).

    Waves have none: their columns have no order.
    """
    widths = columns_on(knots, period)
    made = np.zeros((int(np.prod(widths)),) * 2)
    for k, width in enumerate(widths):
        if width < 3 or (period and k == 0):
            continue
        bend, slope = (np.diff(np.eye(width), order, axis=0) for order in (2, 1))
        parts = [np.eye(w) for w in widths]
        parts[k] = bend.T @ bend + _SLOPE * slope.T @ slope
        whole: Array = np.ones((1, 1))
        for part in parts:
            whole = np.kron(whole, part).astype(np.float64)
        made += whole
    return made
