"""What a gap without a name looks like: the inputs that it depends on, its shape, how much closes.

The residual that a fit leaves in one block is learnt by splines of its inputs. Inputs enter by
forward selection on slots that are left out whole (replicates stay together), simpler ones first
where they do as well to within one standard error. The closed fraction is taken on slots that had
no part in the selection either: it is repeated without each slot.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from math import factorial

import numpy as np

from gap.estimation.cross_validation import HeldOut, floor_squares
from gap.estimation.fit_problem import FitProblem, FitResult
from gap.model.empirical import inputs_of, point_inputs_of, risen, scales_of, valve_flow
from gap.model.features import BLOCKS, UNITS
from gap.validation.config import VALIDATION, ValidationConfig
from gap.validation.expression import compact_expression
from gap.validation.held_out_terms import HeldOutTerms, Whole, gain_and_errors, joined
from gap.verdict import EmpiricalTerm, NearEntry, TermCourse
from plant.arrays import Array
from plant.effects.empirical import (
    FLOW,
    FLOWS,
    INPUTS,
    VALVE_FLOW,
    Correction,
    SplineTerm,
    product_splines,
    splines_on,
)

_KNOTS = {"pressure_kpa": 9, "length_mm": 5, "time_s": 14, "since_edge_s": 9, "valve": 3}
_USUAL_KNOTS = 6
_CROSS_KNOTS = {"pressure_kpa": 4, "length_mm": 4, "since_edge_s": 4}
_USUAL_CROSS_KNOTS = 3
_MUSCLE = (
    "pressure_kpa", "length_mm", "velocity_mm_s", "pressure_rate_kpa_s", "temperature_c", "order",
    "time_s", "slip", "change_1s_kpa", "change_10s_kpa",
)  # fmt: skip
_GAS = (
    "pressure_kpa", "length_mm", "velocity_mm_s", "pressure_rate_kpa_s", "temperature_c", "order",
    "time_s", "since_edge_s", "valve", "change_1s_kpa",
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
)  # fmt: skip
_FLOWS = (
    (FLOW, ("pressure_kpa",)), (FLOW, ("pressure_rate_kpa_s",)), (FLOW, ("velocity_mm_s",)),
    (FLOW, ("time_s",)), (FLOW, ("change_1s_kpa",)), (FLOW, ("valve",)),
    (FLOW, ("valve", "since_edge_s")), (FLOW, ("valve", "pressure_kpa")),
    (VALVE_FLOW, ("valve",)), (VALVE_FLOW, ("valve", "pressure_kpa")),
    (VALVE_FLOW, ("valve", "since_edge_s")), (VALVE_FLOW, ("valve", "time_s")),
    (VALVE_FLOW, ("valve", "order")),
)  # fmt: skip
_FLOW_KNOTS = {"time_s": 6}
_USUAL_FLOW_KNOTS = 3
_AROUND_ZERO = ("pressure_rate_kpa_s", "velocity_mm_s", "change_1s_kpa", "slip")
_EDGE_KNOTS = (0.0, 0.004, 0.012, 0.03, 0.08, 0.25, 2.0)
"""Seconds after an edge: valves take some ten milliseconds, gas some hundred."""


@dataclass(frozen=True)
class Piece:
    """A term that may enter: an offset, splines of one input, or products of those of two.

    Attributes:
        scale: one of `SCALES` that they are multiplied by, or "".
        at: numbers of its columns among those of all pieces.
        rough: second differences of its coefficients as a form, shape (columns, columns).
    """

    inputs: tuple[str, ...]
    knots: tuple[tuple[float, ...], ...]
    scale: str
    at: Whole
    rough: Array

    def holds(self, other: Piece) -> bool:
        """Whether it can be what the other is: a product holds what its inputs do alone, splines
        hold a line.
        """
        inside = set(other.inputs) <= set(self.inputs)
        return self.scale == other.scale and inside and len(self.at) >= len(other.at)

    @property
    def groups(self) -> frozenset[str]:
        """Its inputs as a person calls them."""
        return frozenset(INPUTS[name] for name in self.inputs)


@dataclass
class TermSearch:
    """Pieces that may enter, and the sums from which any of them is fitted."""

    block: str
    pieces: tuple[Piece, ...]
    basis: Array
    terms: HeldOutTerms
    gap: float
    config: ValidationConfig

    def columns(self, chosen: Sequence[Piece]) -> Whole:
        """Columns of some pieces."""
        return joined([piece.at for piece in chosen])

    def select(self, without: frozenset[int] = frozenset()) -> list[Piece]:
        """Forward selection on slots that are not `without`, then pieces that are not needed go."""
        chosen: list[Piece] = []
        errors = self.terms.errors(self.columns(chosen), without)
        for _ in range(self.config.most_terms):
            found = self._next(chosen, errors, without)
            if found is None:
                break
            piece, errors = found
            chosen = [one for one in chosen if not piece.holds(one)]
            chosen.append(piece)
            errors = self.terms.errors(self.columns(chosen), without)
        return self._needed(chosen, without)

    def _next(
        self, chosen: list[Piece], errors: Array, without: frozenset[int]
    ) -> tuple[Piece, Array] | None:
        """The simplest piece of those that do best to within one standard error."""
        new = [p for p in self.pieces if not any(one.holds(p) for one in chosen)]
        # What explains least of the slots that it is fitted to will not predict the others.
        new.sort(key=lambda p: -self.terms.explained(self.columns([*chosen, p]), without))
        tried: list[tuple[Piece, Array]] = []
        for piece in new[: self.config.tried_terms]:
            after = self.terms.errors(self.columns([*chosen, piece]), without)
            gain, sure = gain_and_errors(errors, after)
            if sure > self.config.term_errors and gain > self.config.term_share * self.gap:
                tried.append((piece, after))
        if not tried:
            return None
        best = min(tried, key=lambda one: float(one[1].sum()))
        known = frozenset[str]().union(*(piece.groups for piece in chosen))

        def alike(after: Array) -> bool:
            most = self.config.alike_share * float((errors - best[1]).sum())
            return float((after - best[1]).sum()) <= most

        simple = [one for one in tried if alike(one[1])] or [best]
        return min(simple, key=lambda one: (len(one[0].groups - known), float(one[1].sum())))

    def _needed(self, chosen: list[Piece], without: frozenset[int]) -> list[Piece]:
        """Pieces without which the error on slots left out rises for sure."""
        for piece in [*chosen]:
            rest = [one for one in chosen if one is not piece]
            if not rest:
                break
            lost, sure = gain_and_errors(
                self.terms.errors(self.columns(rest), without),
                self.terms.errors(self.columns(chosen), without),
            )
            if lost < self.config.term_share * self.gap or sure < 1.0:
                chosen = rest
        return chosen

    def within(self, chosen: Sequence[Piece], groups: frozenset[str]) -> list[Piece]:
        """The chosen pieces, as far as they can be made of some inputs alone."""
        made: list[Piece] = []
        for piece in chosen:
            if piece.groups <= groups:
                made.append(piece)
                continue
            left = [n for n in piece.inputs if INPUTS[n] in groups]
            alone = [p for p in self.pieces if list(p.inputs) == left and p.scale == piece.scale]
            made += sorted(alone, key=lambda one: len(one.at))[-1:]
        return list({id(piece): piece for piece in made}.values())

    def shares(self, chosen: Sequence[Piece]) -> dict[str, float]:
        """Shapley values of the inputs in what is closed on slots left out; negative ones are 0."""
        names = sorted(frozenset[str]().union(*(piece.groups for piece in chosen)))
        nothing = float(self.terms.errors(self.columns([])).sum())
        worth = {
            frozenset(some): nothing
            - float(self.terms.errors(self.columns(self.within(chosen, frozenset(some)))).sum())
            for count in range(len(names) + 1)
            for some in combinations(names, count)
        }
        n = len(names)
        made = {}
        for name in names:
            value = 0.0
            for some, alone in worth.items():
                if name not in some:
                    k = len(some)
                    weight = factorial(k) * factorial(n - k - 1) / factorial(n)
                    value += weight * (worth[some | {name}] - alone)
            made[name] = max(value, 0.0)
        total = max(sum(made.values()), 1e-300)
        return dict(sorted(((k, v / total) for k, v in made.items()), key=lambda one: -one[1]))


def blocks_with_gap(problem: FitProblem, fit: FitResult) -> list[str]:
    """Blocks whose residual is larger than the noise explains, largest excess chi-square first.

    The camera counts least: what it shows of a held length is no part of the plant.
    """
    whitened = fit.residual**2 / problem.floor_variance - 1.0
    excess = {
        name: float(whitened[problem.rows.block == number].sum())
        * (_CAMERA if name == "camera" else 1.0)
        for number, name in enumerate(BLOCKS)
    }
    return sorted((b for b, e in excess.items() if e > 0.0), key=lambda b: -excess[b])


_CAMERA = 0.2


def empirical_term(
    problem: FitProblem, fit: FitResult, nearest: Sequence[str] = (), block: str | None = None,
    config: ValidationConfig = VALIDATION,
) -> EmpiricalTerm | None:  # fmt: skip
    """The term for what `fit` leaves; None where none closes a part of the gap for sure.

    Args:
        nearest: ids of entries of the catalogue to compare the term with.
        block: of features; by default the one with the largest gap of which a part closes.
    """
    for name in [block] if block else blocks_with_gap(problem, fit):
        found = _term_of(problem, fit, name, nearest, config)
        if found is not None:
            return found
    return None


def _term_of(
    problem: FitProblem, fit: FitResult, block: str, nearest: Sequence[str],
    config: ValidationConfig,
) -> EmpiricalTerm | None:  # fmt: skip
    search = search_of(problem, fit, block, config)
    if search is None:
        return None
    chosen = search.select()
    if not chosen:
        return None
    held = _held_out(problem, search, block)
    found = held.closed()
    if found is None or found[1] <= 0.0:
        return None
    shares = search.shares(chosen)
    terms = tuple(_spline_term(p, search.terms.coefficients(search.columns(chosen)), chosen)
                  for p in chosen)  # fmt: skip
    return EmpiricalTerm(
        unit=UNITS[block],
        correction=Correction(block, terms),
        shares=shares,
        closed=found[0],
        closed_low=found[1],
        closed_high=found[2],
        recalibrated=held.rms("recalibrated"),
        after=held.rms("after"),
        floor=held.rms("floor"),
        moved=search.terms.moved(search.columns(chosen)),
        courses=tuple(_course(search, chosen, piece) for piece in chosen if piece.inputs),
        expression=compact_expression(problem, fit, search.terms.errors(search.columns(chosen)),
                                      Correction(block, terms), config),
        nearest=_nearest(problem, fit, search, chosen, shares, tuple(nearest)),
    )  # fmt: skip


def search_of(
    problem: FitProblem, fit: FitResult, block: str, config: ValidationConfig
) -> TermSearch | None:
    """Pieces and sums for one block; None where too few slots have it or it shows no gap."""
    here = problem.rows.block == BLOCKS.index(block)
    names = _GAS if block == "pressure" else _MUSCLE
    at = inputs_of(problem.grid, block, names)
    count = int(here.sum())
    if block != "pressure":
        at |= scales_of(problem.grid, block, problem.constants(fit.shift))
    pieces, columns = _pieces(at, count)
    if block == "pressure":
        pieces, columns = _with_flows(problem, fit, pieces, columns)
    if not pieces:
        return None
    size = max(float(np.sqrt(np.mean(fit.residual[here] ** 2))), 1e-9)
    penalty = np.zeros((columns.shape[1],) * 2)
    for piece in pieces:
        free = np.eye(len(piece.at)) / config.term_sd**2 + piece.rough / config.term_bend**2
        own = np.sqrt(np.mean(columns[:, piece.at] ** 2, axis=0))
        # A scale has its own unit; a short flow must be larger to be seen as much as a long one.
        unit = own if piece.scale in FLOWS else np.full(len(own), _rms(at.get(piece.scale)))
        penalty[np.ix_(piece.at, piece.at)] = free * unit * unit[:, None] / size**2
    terms = HeldOutTerms.of(problem, fit, block, columns, penalty)
    if len(terms.slots) < config.least_slots:
        return None
    base = terms.errors(np.empty(0, dtype=np.int64))
    floor = floor_squares(problem, problem.units)[block][list(terms.slots)]
    gap = float(base.sum() - floor.sum())
    return TermSearch(block, pieces, columns, terms, gap, config) if gap > 0.0 else None


def _rms(x: Array | None) -> float:
    """Root mean square of a scale; 1 without one."""
    return 1.0 if x is None else max(float(np.sqrt(np.mean(x**2))), 1e-15)


def _held_out(problem: FitProblem, search: TermSearch, block: str) -> HeldOut:
    """Errors on each slot, with the pieces selected and fitted without it."""
    terms = search.terms
    slots = list(terms.slots)
    base = terms.errors(np.empty(0, dtype=np.int64))
    after = np.array([terms.error(s, search.columns(search.select(frozenset({s})))) for s in slots])
    floor = floor_squares(problem, problem.units)[block][slots]
    here = problem.rows.block == BLOCKS.index(block)
    weight = np.bincount(
        problem.units[problem.rows.trial[here]], weights=problem.rows.span_s[here],
        minlength=max(slots) + 1,
    )[slots].astype(np.float64)  # fmt: skip
    return HeldOut(base, base, after, floor, weight)


def _pieces(at: dict[str, Array], count: int) -> tuple[tuple[Piece, ...], Array]:
    """All pieces that these inputs can make, and their columns side by side."""
    varied = {
        name: x
        for name, x in at.items()
        if name in INPUTS and np.ptp(x) > 1e-6 * (1.0 + np.abs(x).max())
    }
    single = [("", name) for name in varied] + [(s, name) for s, name in _SCALED if s in at]
    wanted: list[tuple[str, tuple[str, ...], int]] = [("", (), 0)]
    wanted += [(scale, (name,), _most_knots(name, 1)) for scale, name in single]
    # A line carries to slots beyond the others' range, where splines go astray.
    wanted += [(scale, (name,), 2) for scale, name in single if name != "since_edge_s"]
    wanted += [("", pair, 0) for pair in _PRODUCTS]
    made: list[Piece] = []
    columns: list[Array] = []
    first = 0
    for scale, inputs, most in wanted:
        if not all(name in varied for name in inputs):
            continue
        knots = tuple(_knots(varied[n], most or _most_knots(n, len(inputs)), n) for n in inputs)
        if most == 2 and len(np.unique(np.round(varied[inputs[0]], 6))) <= 3:
            continue  # the splines on so few settings say as much
        own = product_splines([varied[n] for n in inputs], knots, count)
        columns.append(own * at[scale][:, None] if scale else own)
        width = own.shape[1]
        made.append(Piece(inputs, knots, scale, np.arange(first, first + width), _rough(knots)))
        first += width
    return tuple(made), np.hstack(columns) if columns else np.empty((count, 0))


def _with_flows(
    problem: FitProblem, fit: FitResult, pieces: tuple[Piece, ...], columns: Array
) -> tuple[tuple[Piece, ...], Array]:
    """The pieces with those of flows into the chamber, which are summed up over time."""
    at = point_inputs_of(problem.grid, "pressure", _GAS)
    count = len(next(iter(at.values())))
    made, flows = list(pieces), []
    first = columns.shape[1]
    own_flow = valve_flow(problem.grid, problem.constants(fit.shift))
    for scale, inputs in _FLOWS:
        if any(np.ptp(at[name]) < 1e-6 for name in inputs):
            continue
        knots = tuple(_knots(at[n], _FLOW_KNOTS.get(n, _USUAL_FLOW_KNOTS), n) for n in inputs)
        own = product_splines([at[n] for n in inputs], knots, count)
        flows.append(own * own_flow[:, None] if scale == VALVE_FLOW else own)
        width = flows[-1].shape[1]
        made.append(Piece(inputs, knots, scale, np.arange(first, first + width), _rough(knots)))
        first += width
    if not flows:
        return pieces, columns
    raised = risen(problem.grid, np.hstack(flows), problem.constants(fit.shift))
    return tuple(made), np.hstack([columns, raised])


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


def _rough(knots: tuple[tuple[float, ...], ...]) -> Array:
    """Sum of squared second differences along each input (Eilers and Marx 1996)."""
    widths = [splines_on(own) for own in knots]
    made = np.zeros((int(np.prod(widths)),) * 2)
    for k, width in enumerate(widths):
        if width < 3:
            continue
        bend = np.diff(np.eye(width), 2, axis=0)
        parts = [np.eye(w) for w in widths]
        parts[k] = bend.T @ bend
        whole: Array = np.ones((1, 1))
        for part in parts:
            whole = np.kron(whole, part).astype(np.float64)
        made += whole
    return made


def _spline_term(piece: Piece, coefficients: Array, chosen: Sequence[Piece]) -> SplineTerm:
    first = sum(len(one.at) for one in chosen[: [id(c) for c in chosen].index(id(piece))])
    own = coefficients[first : first + len(piece.at)]
    return SplineTerm(piece.inputs, piece.knots, tuple(float(f"{c:.8g}") for c in own), piece.scale)


_SHOWN = 41


def _course(search: TermSearch, chosen: Sequence[Piece], piece: Piece) -> TermCourse:
    """One piece over its inputs; its band is the jackknife over slots."""
    axes = tuple(np.linspace(k[0], k[-1], _SHOWN) for k in piece.knots)
    mesh = [m.ravel() for m in np.meshgrid(*axes, indexing="ij")]
    shown = product_splines(mesh, piece.knots, len(mesh[0]))
    shape = tuple(len(a) for a in axes)
    columns = search.columns(chosen)
    place = np.flatnonzero(np.isin(columns, piece.at))
    value = shown @ search.terms.coefficients(columns)[place]
    left = np.array(
        [
            shown @ search.terms.coefficients(columns, frozenset({s}))[place]
            for s in search.terms.slots
        ]
    )
    n = len(left)
    spread = np.sqrt((n - 1) / n * np.sum((left - left.mean(axis=0)) ** 2, axis=0))
    return TermCourse(
        piece.inputs, piece.scale, axes, value.reshape(shape), 1.96 * spread.reshape(shape)
    )


def _nearest(
    problem: FitProblem, fit: FitResult, search: TermSearch, chosen: Sequence[Piece],
    shares: dict[str, float], ids: Sequence[str],
) -> tuple[NearEntry, ...]:  # fmt: skip
    """How much of the term each entry could be, and the inputs in which they differ."""
    here = problem.rows.block == BLOCKS.index(search.block)
    weight: Array = np.sqrt(problem.rows.span_s[here])
    n = len(problem.names)
    whole = problem.signatures(fit)
    known = whole[here, :n] * weight[:, None]
    scale = np.sqrt(np.maximum(np.mean(known**2, axis=0), 1e-300))
    even = known / scale

    def beyond(x: Array) -> Array:
        """What the constants cannot make of it."""
        inner = even.T @ even + 1e-6 * len(even) * np.eye(n)
        return np.asarray(x - even @ np.linalg.solve(inner, even.T @ x))

    columns = search.columns(chosen)
    term = beyond(search.basis[:, columns] @ search.terms.coefficients(columns) * weight)
    own = {name for name, share in shares.items() if share >= _COUNTS}
    made = []
    for name in ids:
        places = [j for j, s in enumerate(problem.candidates) if s.id == name]
        signatures: list[Array] = [beyond(whole[here, n + 1 + j] * weight) for j in places]
        signatures = [s for s in signatures if float(s @ s) > 0.0]
        if not signatures:
            continue
        alike = [
            float((s @ term) ** 2 / (s @ s) / max(float(term @ term), 1e-300)) for s in signatures
        ]
        found = _groups_of(search, signatures[int(np.argmax(alike))], weight)
        made.append(
            NearEntry(name, max(alike), tuple(sorted(own - found)), tuple(sorted(found - own)))
        )
    return tuple(sorted(made, key=lambda one: -one.share))


_COUNTS = 0.1


def _groups_of(search: TermSearch, weighted: Array, weight: Array) -> set[str]:
    """Inputs without which the splines of all others make less of some weighted values."""
    total = float(weighted @ weighted)

    def left(groups: set[str]) -> float:
        own = [p for p in search.pieces if not p.scale and p.groups <= groups]
        basis = search.basis[:, search.columns(own)] * weight[:, None]
        inner = basis.T @ basis
        inner += 1e-6 * (np.trace(inner) / max(len(inner), 1) + 1e-300) * np.eye(len(inner))
        rest = weighted - basis @ np.linalg.solve(inner, basis.T @ weighted)
        return float(rest @ rest) / total

    names = {name for piece in search.pieces for name in piece.groups}
    everything = left(names)
    return {name for name in names if left(names - {name}) - everything > _COUNTS}
