"""What a gap without a name looks like: the inputs that it depends on, its shape, how much closes.

The residual that a fit leaves in one block is learnt by splines of its inputs. Inputs enter by
forward selection on slots that are left out whole (replicates stay together), simpler ones first
where they do about as well. The closed fraction is taken on slots that had
no part in the selection either: it is repeated without each slot.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import lsq_linear

from gap.estimation.config import ESTIMATION
from gap.estimation.cross_validation import HeldOut, floor_squares
from gap.estimation.fit_problem import FitProblem, FitResult
from gap.model.features import BLOCKS, UNITS
from gap.validation.config import VALIDATION, ValidationConfig
from gap.validation.expression import compact_expression
from gap.validation.terms.pieces import Piece, groups_of
from gap.validation.terms.refit import within_walls
from gap.validation.terms.search import HALF, TermSearch, refitted, search_of
from gap.verdict import EmpiricalTerm, NearEntry, TermCourse
from plant.arrays import Array
from plant.constants import KEYS
from plant.effects.empirical import (
    Correction,
    SplineTerm,
    product_splines,
    wave_columns,
)


def blocks_with_gap(problem: FitProblem, fit: FitResult) -> list[str]:
    """Blocks whose residual is larger than the noise explains, largest excess chi-square first.

    The camera counts least: what it shows of a held length is no part of the plant. A block that
    constants fitted to it alone explain is left out, if there is another that they do not: its gap
    is that of constants which the other has led astray. Where nothing can be held out of that
    other, all are left.
    """
    excess = {
        name: _excess(problem, fit.residual, number) * (_CAMERA if name == "camera" else 1.0)
        for number, name in enumerate(BLOCKS)
    }
    shown = sorted((b for b, e in excess.items() if e > 0.0), key=lambda b: -excess[b])
    if len(shown) < 2:
        return shown
    own = [b for b in shown if _has_own_gap(problem, fit, b)]
    return own if any(_slots(problem, b) >= VALIDATION.least_slots for b in own) else shown


def _slots(problem: FitProblem, block: str) -> int:
    """Number of slots that have a block."""
    here = problem.rows.block == BLOCKS.index(block)
    return len(np.unique(problem.units[problem.rows.trial[here]]))


_CAMERA = 0.2
_OWN_SD = 3.0
"""Standard errors of a chi-square beyond which it is a gap. A matter of definition."""


def _excess(problem: FitProblem, residual: Array, block: int) -> float:
    """Chi-square of one block beyond what the noise explains."""
    here = problem.rows.block == block
    return float((residual[here] ** 2 / problem.floor_variance[here] - 1.0).sum())


def _has_own_gap(problem: FitProblem, fit: FitResult, name: str) -> bool:
    """Whether constants fitted to this block alone, within their tolerances, leave a gap in it."""
    block = BLOCKS.index(name)
    here = problem.rows.block == block
    columns = problem.columns_of(fit)[:, : len(fit.shift)]
    wall = np.maximum(ESTIMATION.tolerance_sd, np.abs(fit.shift))
    sd = np.sqrt(problem.floor_variance[here])
    found = lsq_linear(
        np.vstack([columns[here] / sd[:, None], np.eye(len(wall))]),
        np.r_[fit.residual[here] / sd, -fit.shift],
        (-wall - fit.shift, wall - fit.shift + 1e-9),
    )
    left = _excess(problem, fit.residual - columns @ found.x, block)
    return left > _OWN_SD * float(np.sqrt(2.0 * here.sum()))


def empirical_term(
    problem: FitProblem, fit: FitResult, nearest: Sequence[str] = (), block: str | None = None,
    config: ValidationConfig = VALIDATION, refused: FitResult | None = None,
) -> EmpiricalTerm | None:  # fmt: skip
    """The term for what `fit` leaves; None where none closes a part of the gap for sure.

    Args:
        nearest: ids of entries of the catalogue to compare the term with.
        block: of features; by default the one with the largest gap of which a part closes.
        refused: an explanation that got no name; at its constants the gap may be seen whole.
    """
    walled = within_walls(problem, fit)
    for name in [block] if block else blocks_with_gap(problem, walled):
        found = _term_of(problem, fit, walled, name, nearest, config, refused)
        if found is not None:
            return found
    return None


def _term_of(
    problem: FitProblem, fit: FitResult, walled: FitResult, block: str, nearest: Sequence[str],
    config: ValidationConfig, refused: FitResult | None,
) -> EmpiricalTerm | None:  # fmt: skip
    first = search_of(
        problem, fit, block, config, walled=walled, has_own_gap=_has_own_gap(problem, walled, block)
    )
    if first is None:
        return None
    found: list[_Found] = []
    searches: list[TermSearch] = []
    for search in _searches(problem, first, refused):
        searches.append(search)
        chosen = search.select()
        held = _held_out(problem, search) if chosen else None
        held = None if held is None else _closing(held, config)
        closed = held.closed() if held is not None else None
        if held is None or closed is None:
            continue
        if not _can_be_stated(problem, search, chosen):
            continue
        found.append(_Found(search, chosen, held, closed[0], sum(map(search.is_refused, chosen))))
        if closed[0] > config.foretold_share:
            break
    slot = None if found else first.telling
    if slot is not None:
        found = [one for search in searches if (one := _told_by(problem, search, slot)) is not None]
    if not found:
        return None
    best = _simplest(found, config.alike_share)
    return _stated(problem, fit, best.search, best.chosen, best.held, nearest, slot)


class _Found(NamedTuple):
    """What one search has found, the share of the gap that it closes, and pieces refused before."""

    search: TermSearch
    chosen: list[Piece]
    held: HeldOut
    closed: float
    refused: int = 0


def _simplest(found: Sequence[_Found], alike_share: float) -> _Found:
    """What depends on the fewest inputs of those that close about as much as the best."""
    least = (1.0 - alike_share) * max(one.closed for one in found)
    alike = [one for one in found if one.closed >= least]
    return min(alike, key=lambda one: (one.refused, len(groups_of(one.chosen)), -one.closed))


def _told_by(problem: FitProblem, search: TermSearch, slot: int) -> _Found | None:
    """A term of few numbers that one slot tells; None where it does not foretell the others.

    Nothing foretells that slot, since without it nothing shows: it is not judged.
    """
    chosen = search.of_few_numbers()
    if not chosen or not _can_be_stated(problem, search, chosen):
        return None
    judged = [k for k, one in enumerate(search.terms.slots) if one != slot]
    base = search.errors([])
    after = base.copy()
    for k in judged:
        own = search.terms.slots[k]
        pieces = search.of_few_numbers(frozenset({own}))
        if pieces:
            after[k] = search.terms.error(own, search.columns(pieces))
    held = _held(problem, search, base, after, judged)
    closed = held.closed(_LEAST_JUDGED)
    gap = held.recalibrated - held.floor
    with_gap = gap > held.floor
    foretold = held.recalibrated - held.after > HALF * gap
    if closed is None or closed[0] <= HALF or not foretold[with_gap].all():
        return None
    if np.count_nonzero(with_gap) < _LEAST_JUDGED:
        return None
    return _Found(search, chosen, held, closed[0])


def _can_be_stated(problem: FitProblem, search: TermSearch, chosen: Sequence[Piece]) -> bool:
    """Whether a plant file takes the constants that go with some pieces.

    Millions of readings may move a constant to where no bench can be.
    """
    moved = search.terms.moved(search.columns(chosen))[: len(problem.names)]
    constants = problem.constants(search.fit.shift + moved)
    return all(
        KEYS[name].low <= constants.value(name) <= KEYS[name].high
        for name in problem.names
        if name in constants.keys
    )


_LEAST_JUDGED = 2
"""Other slots that a term of few numbers must foretell. A matter of definition."""


def _searches(
    problem: FitProblem, first: TermSearch, refused: FitResult | None
) -> Iterator[TermSearch]:
    """Searches at the constants from which a term may be seen for what it is, likely ones first.

    A large gap may have led the constants so far astray that no fit with a term finds back: the
    stated ones, from which the gap is the effect alone, are another start, and so are those of an
    explanation that got no name.
    """
    back = _with_constants_back(problem, first)
    if back is not None:
        yield back
    if np.abs(first.fit.shift).max() > first.config.astray_sd:
        yield from _starting_at(problem, first, np.zeros_like(first.fit.shift))
    yield first
    if refused is not None and _moved(refused, first.fit) > first.config.moved_sd:
        yield from _starting_at(problem, first, refused.shift)


def _starting_at(problem: FitProblem, first: TermSearch, shift: Array) -> Iterator[TermSearch]:
    """The searches that start at some constants, in sd."""
    at = problem.at(shift, first.fit.candidates, first.fit.amounts, first.fit)
    there = search_of(problem, at, first.block, first.config, first)
    if there is None:
        return
    back = _with_constants_back(problem, there)
    if back is not None:
        yield back
    yield there


def _moved(fit: FitResult, other: FitResult) -> float:
    """Largest difference of a constant between two fits, in sd."""
    return float(np.abs(fit.shift - other.shift).max())


def _closing(held: HeldOut, config: ValidationConfig) -> HeldOut | None:
    """What a term closes of the gap on slots left out; None where that is no part of it.

    For sure, or half of a gap that is as large as the floor, and half of it in most of the slots
    that hold a large part: where a gap is large in few slots the jackknife says nothing, yet a term
    that was fitted without such a slot has foretold it. Where one slot alone holds a large part,
    nearly all of it must be foretold, or half of the gap in each of three slots and more that
    have one. There a floor is no higher than what the term has reached.
    """
    found = held.closed()
    if found is None or found[1] > 0.0:
        return None if found is None else held
    held = held.with_floor_shown()
    return held if _foretells(held, config) else None


def _foretells(held: HeldOut, config: ValidationConfig) -> bool:
    """Whether half of a large gap is foretold where it is large; see `_closing`."""
    found = held.closed()
    gap = held.recalibrated - held.floor
    foretold = held.recalibrated - held.after > HALF * gap
    if found is None or float(gap.sum()) <= float(held.floor.sum()) or found[0] <= HALF:
        return False
    with_gap = gap > held.floor
    if np.count_nonzero(with_gap) >= config.foretold_slots and foretold[with_gap].all():
        return True
    large = gap > config.large_slot * gap.sum()
    share = HALF if np.count_nonzero(large) > 1 else config.foretold_share
    return found[0] > share and float(foretold[large].mean()) > HALF


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
        is_tried = len(chosen) == 1 and any(own[0] is chosen[0] for own in tried)
        wanted = tried if is_tried else [*tried, chosen]
        fits = [refitted(problem, search, own) for own in wanted if own]
        if not fits:
            break
        # The number of a term's columns counts as in a comparison of models (Schwarz 1978).
        each = float(np.log(len(problem.rows)))
        own, fitted = min(fits, key=lambda one: one[1].cost + len(one[0]) * each)
        if _moved(fitted.fit, search.fit) < config.moved_sd:
            break
        there = search_of(problem, fitted.fit, search.block, config, first, (own, fitted))
        if there is None:
            break
        search = there
    return None if search is first else search


def _stated(
    problem: FitProblem, fit: FitResult, search: TermSearch, chosen: list[Piece], held: HeldOut,
    nearest: Sequence[str], told_by: int | None,
) -> EmpiricalTerm | None:  # fmt: skip
    """The term of a search as it is handed out, with constants moved from those of `fit`."""
    found = held.closed(_LEAST_JUDGED)
    if found is None:
        return None
    columns = search.columns(chosen)
    coefficients = search.terms.coefficients(columns)
    shares = search.shares(chosen, told_by)
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
        expression=None  # a formula is judged by every slot
        if told_by is not None
        else compact_expression(
            problem, search.fit, search.errors(chosen), search.errors([]), correction, search.config
        ),
        nearest=_nearest(problem, search, chosen, shares, tuple(nearest)),
        told_by="" if told_by is None else tuple(problem.data.slots)[told_by],
    )


def _held_out(problem: FitProblem, search: TermSearch) -> HeldOut:
    """Errors on each slot, with the pieces selected and fitted without it."""
    slots = list(search.terms.slots)
    base = search.errors([])
    after = base.copy()
    for k, slot in enumerate(slots):
        chosen = search.select(frozenset({slot}))
        if chosen:
            after[k] = search.terms.error(slot, search.columns(chosen))
    return _held(problem, search, base, after, range(len(slots)))


def _held(
    problem: FitProblem, search: TermSearch, base: Array, after: Array, judged: Sequence[int]
) -> HeldOut:
    """The errors of some slots of a search, by their places among its slots."""
    slots = [search.terms.slots[k] for k in judged]
    floor = floor_squares(problem, problem.units)[search.block][slots]
    here = problem.rows.block == BLOCKS.index(search.block)
    weight = np.bincount(
        problem.units[problem.rows.trial[here]], weights=problem.rows.compared_s[here],
        minlength=max(slots) + 1,
    )[slots].astype(np.float64)  # fmt: skip
    base, after = base[list(judged)], after[list(judged)]
    return HeldOut(base, base, after, floor, weight)


def _spline_term(piece: Piece, coefficients: Array, chosen: Sequence[Piece]) -> SplineTerm:
    first = sum(len(one.at) for one in chosen[: [id(c) for c in chosen].index(id(piece))])
    own = coefficients[first : first + len(piece.at)]
    rounded = tuple(float(f"{c:.8g}") for c in own)
    return SplineTerm(piece.inputs, piece.knots, rounded, piece.scale, piece.period)


_SHOWN = 41


def _course(search: TermSearch, chosen: Sequence[Piece], piece: Piece) -> TermCourse:
    """One piece over its inputs; its band is the jackknife over slots."""
    spans = [(own[0], own[-1]) for own in piece.knots]
    if piece.period:
        spans[0] = (0.0, piece.period)
    axes = tuple(np.linspace(*span, _SHOWN) for span in spans)
    mesh = [m.ravel() for m in np.meshgrid(*axes, indexing="ij")]
    first = wave_columns(mesh[0], piece.period) if piece.period else None
    shown = product_splines(mesh, piece.knots, len(mesh[0]), first)
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
