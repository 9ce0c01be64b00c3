"""What a gap without a name looks like: the inputs that it depends on, its shape, how much closes.

The residual that a fit leaves in one block is learnt by splines of its inputs. Inputs enter by
forward selection on slots that are left out whole (replicates stay together), simpler ones first
where they do as well to within one standard error. The closed fraction is taken on slots that had
no part in the selection either: it is repeated without each slot.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from math import factorial

import numpy as np

from gap.estimation.cross_validation import HeldOut, floor_squares
from gap.estimation.fit_problem import FitProblem, FitResult
from gap.model.empirical import inputs_of, scales_of
from gap.model.features import BLOCKS, UNITS
from gap.validation.config import VALIDATION, ValidationConfig
from gap.validation.expression import compact_expression
from gap.validation.terms.held_out_terms import HeldOutTerms, Whole, gain_and_errors, joined
from gap.validation.terms.pieces import GAS_INPUTS, MUSCLE_INPUTS, Piece, pieces_of, with_flows
from gap.validation.terms.refit import fitted_with_term
from gap.verdict import EmpiricalTerm, NearEntry, TermCourse
from plant.arrays import Array
from plant.effects.empirical import FLOWS, INPUTS, Correction, SplineTerm, product_splines


@dataclass
class TermSearch:
    """Pieces that may enter, and the sums from which any of them is fitted.

    Attributes:
        fit: where the plant is made linear.
        recalibrated: sums at the plant that was recalibrated without a term: what is closed is
            closed of its errors.
        gap: squared errors of that plant on slots left out, beyond the floor.
    """

    block: str
    fit: FitResult
    pieces: tuple[Piece, ...]
    basis: Array
    terms: HeldOutTerms
    recalibrated: HeldOutTerms
    gap: float
    config: ValidationConfig

    def columns(self, chosen: Sequence[Piece]) -> Whole:
        """Columns of some pieces."""
        return joined([piece.at for piece in chosen])

    def errors(self, chosen: Sequence[Piece], without: frozenset[int] = frozenset()) -> Array:
        """Squared errors on every slot that is not `without`, each left out in turn."""
        if not chosen:
            return self.recalibrated.errors(self.columns([]), without)
        return self.terms.errors(self.columns(chosen), without)

    def select(self, without: frozenset[int] = frozenset()) -> list[Piece]:
        """Forward selection on slots that are not `without`, then pieces that are not needed go."""
        chosen: list[Piece] = []
        errors = self.errors(chosen, without)
        for _ in range(self.config.most_terms):
            found = self._next(chosen, errors, without)
            if found is None:
                break
            piece, errors = found
            chosen = [one for one in chosen if not piece.holds(one)]
            chosen.append(piece)
            errors = self.errors(chosen, without)
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
            after = self.errors([*chosen, piece], without)
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
        return min(
            simple,
            key=lambda one: (len(one[0].groups - known), one[0].fine, float(one[1].sum())),
        )

    def _needed(self, chosen: list[Piece], without: frozenset[int]) -> list[Piece]:
        """Pieces without which the error on slots left out rises for sure, or by much."""
        for piece in [*chosen]:
            rest = [one for one in chosen if one is not piece]
            if not rest:
                break
            errors = self.errors(chosen, without)
            lost, sure = gain_and_errors(self.errors(rest, without), errors)
            whole = float((self.errors([], without) - errors).sum())
            # One slot alone may hold most of a gap: what all of it hangs on is needed.
            little = lost < self.config.alike_share * whole and sure < 1.0
            if lost < self.config.term_share * self.gap or little:
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
        """Shapley values of the inputs in what is closed on slots left out; negative ones are 0.

        Empty where all of it is an offset.
        """
        names = sorted(frozenset[str]().union(*(piece.groups for piece in chosen)))
        nothing = float(self.errors([]).sum())
        worth = {
            frozenset(some): nothing
            - float(self.errors(self.within(chosen, frozenset(some))).sum())
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
        total = sum(made.values())
        if total <= 0.0:  # an offset does as well
            return {}
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
    first = search_of(problem, fit, block, config)
    if first is None:
        return None
    for search in (_with_constants_back(problem, first), first):
        chosen = search.select() if search is not None else []
        if search is None or not chosen:
            continue
        held = _held_out(problem, search)
        if _closes(held, config):
            return _stated(problem, fit, search, chosen, held, nearest)
    return None


def _closes(held: HeldOut, config: ValidationConfig) -> bool:
    """Whether a term closes a part of the gap on slots left out, for sure.

    One slot may hold nearly all of a gap, as a valve that shuts late does where it is shut in time:
    the jackknife says nothing then. A term that was fitted without that slot and closes nearly all
    of it has foretold it.
    """
    found = held.closed()
    if found is None or found[1] > 0.0:
        return found is not None
    gap = held.recalibrated - held.floor
    large = gap > config.large_slot * gap.sum()
    foretold = (held.recalibrated - held.after)[large] > _HALF * gap[large]
    return found[0] > config.foretold_share and bool(foretold.all())


_HALF = 0.5


def _with_constants_back(problem: FitProblem, first: TermSearch) -> TermSearch | None:
    """The search where the constants are fitted together with what looks best of a term.

    None where that moves no constant by much: there all is linear anyway.
    """
    config, everything = first.config, frozenset[int]()
    explained = {p.at[0]: first.terms.explained(p.at, everything) for p in first.pieces}
    alone = sorted(first.pieces, key=lambda p: -explained[p.at[0]])[: config.refitted_terms]
    search = first
    for tried in ([[p] for p in alone], []):
        chosen = search.select()
        fits = [_refitted(problem, search, own) for own in [*tried, chosen] if own]
        if not fits:
            break
        fit = min(fits, key=lambda one: one[1])[0]
        if np.abs(fit.shift - search.fit.shift).max() < config.moved_sd:
            break
        again = search_of(problem, fit, search.block, config, first)
        if again is None:
            break
        search = again
    return None if search is first else search


def _refitted(
    problem: FitProblem, search: TermSearch, chosen: Sequence[Piece]
) -> tuple[FitResult, float]:
    """Constants fitted with some pieces, and the cost with that of their number (Schwarz 1978)."""
    own = search.columns(chosen)
    columns = np.zeros((len(problem.rows), len(own)))
    columns[problem.rows.block == BLOCKS.index(search.block)] = search.basis[:, own]
    penalty = search.terms.penalty[np.ix_(own, own)]
    fit, cost = fitted_with_term(problem, search.fit, columns, penalty)
    return fit, cost + len(own) * float(np.log(len(problem.rows)))


def _stated(
    problem: FitProblem, fit: FitResult, search: TermSearch, chosen: list[Piece], held: HeldOut,
    nearest: Sequence[str],
) -> EmpiricalTerm | None:  # fmt: skip
    """The term of a search as it is handed out, with constants moved from those of `fit`."""
    found = held.closed()
    if found is None:
        return None
    columns = search.columns(chosen)
    coefficients = search.terms.coefficients(columns)
    shares = search.shares(chosen)
    correction = Correction(
        search.block, tuple(_spline_term(p, coefficients, chosen) for p in chosen)
    )
    moved = np.r_[search.fit.shift - fit.shift, search.fit.amounts - fit.amounts]
    return EmpiricalTerm(
        unit=UNITS[search.block],
        correction=correction,
        shares=shares,
        closed=found[0],
        closed_low=found[1],
        closed_high=found[2],
        recalibrated=held.rms("recalibrated"),
        after=held.rms("after"),
        floor=held.rms("floor"),
        moved=moved + search.terms.moved(columns),
        courses=tuple(_course(search, chosen, piece) for piece in chosen if piece.inputs),
        expression=compact_expression(
            problem, search.fit, search.errors(chosen), search.errors([]), correction, search.config
        ),
        nearest=_nearest(problem, search, chosen, shares, tuple(nearest)),
    )


def search_of(
    problem: FitProblem, fit: FitResult, block: str, config: ValidationConfig,
    first: TermSearch | None = None,
) -> TermSearch | None:  # fmt: skip
    """Pieces and sums for one block; None where too few slots have it or it shows no gap.

    Args:
        first: the search at the recalibrated plant, where `fit` is another.
    """
    here = problem.rows.block == BLOCKS.index(block)
    names = GAS_INPUTS if block == "pressure" else MUSCLE_INPUTS
    at = inputs_of(problem.grid, block, names)
    count = int(here.sum())
    if block != "pressure":
        at |= scales_of(problem.grid, block, problem.constants(fit.shift))
    pieces, columns = pieces_of(at, count)
    if block == "pressure":
        pieces, columns = with_flows(problem, fit, pieces, columns)
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
    if first is not None:
        return replace(first, fit=fit, pieces=pieces, basis=columns, terms=terms)
    base = terms.errors(np.empty(0, dtype=np.int64))
    floor = floor_squares(problem, problem.units)[block][list(terms.slots)]
    gap = float(base.sum() - floor.sum())
    made = TermSearch(block, fit, pieces, columns, terms, terms, gap, config)
    return made if gap > 0.0 else None


def _rms(x: Array | None) -> float:
    """Root mean square of a scale; 1 without one."""
    return 1.0 if x is None else max(float(np.sqrt(np.mean(x**2))), 1e-15)


def _held_out(problem: FitProblem, search: TermSearch) -> HeldOut:
    """Errors on each slot, with the pieces selected and fitted without it."""
    slots = list(search.terms.slots)
    base = search.errors([])
    after = base.copy()
    for k, slot in enumerate(slots):
        chosen = search.select(frozenset({slot}))
        if chosen:
            after[k] = search.terms.error(slot, search.columns(chosen))
    floor = floor_squares(problem, problem.units)[search.block][slots]
    here = problem.rows.block == BLOCKS.index(search.block)
    weight = np.bincount(
        problem.units[problem.rows.trial[here]], weights=problem.rows.compared_s[here],
        minlength=max(slots) + 1,
    )[slots].astype(np.float64)  # fmt: skip
    return HeldOut(base, base, after, floor, weight)


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
    problem: FitProblem, search: TermSearch, chosen: Sequence[Piece],
    shares: dict[str, float], ids: Sequence[str],
) -> tuple[NearEntry, ...]:  # fmt: skip
    """How much of the term each entry could be, and the inputs in which they differ."""
    here = problem.rows.block == BLOCKS.index(search.block)
    weight: Array = np.sqrt(problem.rows.compared_s[here])
    n = len(problem.names)
    whole = problem.signatures(search.fit)
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
