"""The search for a term: pieces that may enter, and forward selection on slots left out.

Inputs enter one piece at a time, simpler ones first where they do as well; what is closed is that
of slots that the pieces were not fitted to.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from math import factorial

import numpy as np

from gap.estimation.config import ESTIMATION
from gap.estimation.cross_validation import floor_squares
from gap.estimation.fit_problem import FitProblem, FitResult
from gap.model.empirical import inputs_of, scales_of, waves_at, weighed
from gap.model.features import BLOCKS
from gap.validation.config import ValidationConfig
from gap.validation.terms.held_out_terms import HeldOutTerms, Whole, gain_and_errors, joined
from gap.validation.terms.pieces import (
    GAS_INPUTS,
    MUSCLE_INPUTS,
    NO_FLOWS,
    PULL_CHANGES,
    FlowColumns,
    Piece,
    columns_in_load,
    error_of_sensor,
    errors_of_entries,
    groups_of,
    pieces_of,
    raised,
    with_flows,
)
from gap.validation.terms.refit import FittedTerm, TermColumns, fitted_with_term
from gap.validation.terms.waves import Wave, WaveRows, waves_of
from plant.arrays import Array
from plant.effects.empirical import (
    CELL,
    CELL_GAIN,
    FLOW,
    IN_GAS,
    INPUTS,
    OF_CELL,
    READING,
    SCALE_INPUTS,
    SEEN,
    SUPPLY,
    spline_columns,
)

_RATE = "pressure_rate_kpa_s"
HALF = 0.5
"""Share of a gap from which it counts as closed."""
_STEEPEST = 0.5
"""Most that the error of a gauge may rise with its reading, kPa/kPa, and that a term may take of
what a pull changes, N/N. A matter of definition."""

_LASTS_LONGER = 1.25
"""Times the longest of the others that a trial must last for a flow in time to be unknown there. A
matter of definition."""


@dataclass
class TermSearch:
    """Pieces that may enter, and the sums from which any of them is fitted.

    Attributes:
        fit: where the plant is made linear; with the term of a refit, where there was one.
        basis: columns of all pieces at every row of the block; those of flows stand last.
        beside: the same at every row of the problem, for what they do to other blocks.
        flows: the same before they are summed up to a pressure.
        recalibrated: sums at the plant that was recalibrated without a term: what is closed is
            closed of its errors.
        gaps: squared errors of that plant on every slot, left out, beyond the floor.
        floors: squares of the floor on every slot.
        lasts: time in s that the trials of every slot last.
        refused: errors of the block's sensor that entries of the catalogue say, and that the
            diagnosis has had to choose from; see `error_of_sensor`.
        known: columns of the term that the constants were fitted with, if any.
    """

    block: str
    fit: FitResult
    pieces: tuple[Piece, ...]
    basis: Array
    beside: Array
    flows: FlowColumns
    terms: HeldOutTerms
    recalibrated: HeldOutTerms
    gaps: Array
    floors: Array
    lasts: Array
    config: ValidationConfig
    refused: frozenset[str] = frozenset()
    known: frozenset[int] = frozenset()

    def floor(self, without: frozenset[int]) -> float:
        """Squares of the floor on the slots that are not `without`."""
        kept = [slot not in without for slot in self.terms.slots]
        return float(self.floors[kept].sum())

    def gap(self, without: frozenset[int]) -> float:
        """The gap on the slots that are not `without`."""
        kept = [slot not in without for slot in self.terms.slots]
        return max(float(self.gaps[kept].sum()), 0.0)

    def least_gain(self, without: frozenset[int], further: bool) -> float:
        """What a piece must close on the slots that are not `without`; one beside another more."""
        share = self.config.further_share if further else self.config.term_share
        return share * self.gap(without)

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
        # Only a slot that is left out can judge what was fitted to one alone.
        if without and float(errors.sum()) - self.floor(without) > HALF * self.gap(without):
            return self._of_one_slot(without) or self._needed(chosen, without)
        return self._needed(chosen, without)

    def _of_one_slot(self, without: frozenset[int]) -> list[Piece]:
        """The piece with the fewest columns that takes nearly all of a gap that one slot holds.

        No other slot can foretell that one, so it is told by the fit to it: whether the piece
        foretells a slot that had no part in it is then asked of those that are `without`.
        """
        kept = {s: g for s, g in zip(self.terms.slots, self.gaps, strict=True) if s not in without}
        slot = max(kept, key=lambda s: kept[s])
        if kept[slot] < self.config.foretold_share * self.gap(without):
            return []
        floor = float(self.floors[self.terms.slots.index(slot)])
        gap = self.recalibrated.error_of_fit(slot, self.columns([]), without) - floor
        if gap < floor:
            return []
        left = {
            k: self.terms.error_of_fit(slot, piece.at, without) - floor
            for k, piece in enumerate(self.pieces)
        }
        enough = [k for k, e in left.items() if e < (1.0 - self.config.foretold_share) * gap]
        best = min(enough, key=lambda k: (len(self.pieces[k].at), left[k]), default=None)
        return [] if best is None else [self.pieces[best]]

    @property
    def telling(self) -> int | None:
        """The slot without which the others show no gap: it has led the constants astray for them.

        None where the others show one by themselves, or none with it either.
        """
        slot = self.terms.slots[int(np.argmax(self.gaps))]
        alone = frozenset({slot})
        beside, floor = self.gap(alone), self.floor(alone)
        left = float(self.recalibrated.errors(self.columns([]), alone).sum()) - floor
        nearly = (1.0 - self.config.foretold_share) * beside
        return slot if beside > floor and left < nearly else None

    def of_few_numbers(self, without: frozenset[int] = frozenset()) -> list[Piece]:
        """The piece with the fewest numbers that takes nearly all of the gap, of the fit itself.

        Of so few, what thousands of readings hold is a test although none of them was left out.
        """
        gap, floor = self.gap(without), self.floor(without)
        left: list[tuple[int, float, Piece]] = []
        for piece in self.pieces:
            if len(piece.at) > self.config.few_numbers or self.is_refused(piece):
                continue
            errors = [
                self.terms.error_of_fit(slot, piece.at, without)
                for slot in self.terms.slots
                if slot not in without
            ]
            over = float(np.sum(errors)) - floor
            if over < self.config.few_left * gap:
                left.append((len(piece.at), over, piece))
        return [min(left, key=lambda one: one[:2])[2]] if left else []

    def _next(
        self, chosen: list[Piece], errors: Array, without: frozenset[int]
    ) -> tuple[Piece, Array] | None:
        """The simplest piece of those that do about as well as the best."""
        new = [p for p in self.pieces if not any(one.holds(p) for one in chosen)]
        if self._outlast(without):
            new = [p for p in new if not (p.scale == FLOW and "time_s" in p.inputs)]
        tried: list[tuple[Piece, Array]] = []
        for piece in new:
            after = self.errors([*chosen, piece], without)
            gain, sure = gain_and_errors(errors, after)
            # One slot alone may hold most of a gap: no number of standard errors shows it then.
            enough = sure > self.config.term_errors or gain > HALF * self.gap(without)
            enough = enough and gain > self.least_gain(without, bool(chosen))
            if enough and self._leaves_a_plant([*chosen, piece], without):
                tried.append((piece, after))
        if not tried:
            return None
        best = min(tried, key=lambda one: float(one[1].sum()))
        known = {INPUTS[name] for piece in chosen for name in piece.inputs}
        # All others are judged at its constants, and by how they act to first order.
        if frozenset(best[0].at.tolist()) == self.known and not self.is_refused(best[0]):
            return best
        floor = self.floor(without)
        left = max(float(best[1].sum()) - floor, 0.0)

        def alike(after: Array) -> bool:
            more = float((after - best[1]).sum())
            # Of a large gap a small share is still much: no more is left than by the best, but for
            # about the floor.
            return more <= self.config.alike_share * float((errors - best[1]).sum()) and (
                more <= left + floor
            )

        simple = [one for one in tried if alike(one[1])] or [best]
        return min(
            simple,
            key=lambda one: (
                self.is_refused(one[0]),
                len({INPUTS[name] for name in one[0].inputs} - known),
                # What drives the gas makes its pressure change as well.
                _RATE in one[0].inputs,
                one[0].fine,
                len(one[0].at),
                float(one[1].sum()),
            ),
        )

    def _outlast(self, without: frozenset[int]) -> bool:
        """Whether slots that are `without` last longer than the others.

        What flows so late, the others do not tell, and as a sum over time it grows without end.
        """
        out = np.array([slot in without for slot in self.terms.slots])
        most = float(self.lasts[~out].max(initial=0.0))
        return bool((self.lasts[out] > _LASTS_LONGER * most).any())

    def is_refused(self, piece: Piece) -> bool:
        """Whether an entry says the same that did not explain the gap: another is likelier."""
        return error_of_sensor(self.block, piece) in self.refused

    def _leaves_a_plant(self, chosen: Sequence[Piece], without: frozenset[int]) -> bool:
        """Whether with some pieces a gauge still measures, and a muscle still carries its load.

        An error as large as the reading stands for gas that has no pressure at all. What takes
        from a pull all that it changes leaves the mean pull alone, which is the load: it "closes"
        every gap of a hung load, and says no length at all.
        """
        columns = self.columns(chosen)
        for piece in chosen:
            sign = _of_itself(self.block, piece)
            if not sign:
                continue
            own = self.terms.coefficients(columns, without)[np.isin(columns, piece.at)]
            (knots,) = piece.knots
            shown = spline_columns(np.array(knots), knots) @ own
            if (sign * np.diff(shown) > _STEEPEST * np.diff(knots)).any():
                return False
        return True

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
            if lost < self.least_gain(without, further=True) or little:
                chosen = rest
        return chosen

    def within(
        self, chosen: Sequence[Piece], groups: frozenset[str], told_by: int | None = None
    ) -> list[Piece]:
        """The chosen pieces, as far as they can be made of some inputs alone."""
        made: list[Piece] = []
        for piece in chosen:
            if piece.groups <= groups:
                made.append(piece)
                continue
            names = {n for n in (*piece.inputs, *SCALE_INPUTS[piece.scale]) if INPUTS[n] in groups}
            alone = [
                p
                for p in self.pieces
                if set(p.inputs) <= names and p.groups <= groups and p.scale in ("", piece.scale)
                and not self.is_refused(p)
            ]  # fmt: skip
            made += sorted(alone, key=lambda one: self._judged([one], told_by))[:1]
        return list({id(piece): piece for piece in made}.values())

    def _judged(self, chosen: Sequence[Piece], told_by: int | None) -> float:
        """Squared errors on slots left out, without the one that alone tells of a term."""
        judged = np.array([slot != told_by for slot in self.terms.slots])
        return float(self.errors(chosen)[judged].sum())

    def shares(self, chosen: Sequence[Piece], told_by: int | None = None) -> dict[str, float]:
        """Shapley values of the inputs in what is closed on slots left out; negative ones are 0.

        Empty where all of it is an offset. The slot `told_by`, which alone tells of the term,
        is not judged.
        """
        names = sorted(groups_of(chosen))
        nothing = self._judged([], told_by)
        worth = {
            frozenset(some): nothing
            - self._judged(self.within(chosen, frozenset(some), told_by), told_by)
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


def search_of(
    problem: FitProblem, fit: FitResult, block: str, config: ValidationConfig,
    first: TermSearch | None = None, known: tuple[Whole, FittedTerm] | None = None,
    walled: FitResult | None = None, has_own_gap: bool = True,
) -> TermSearch | None:  # fmt: skip
    """Pieces and sums for one block; None where too few slots have it or it shows no gap.

    Args:
        walled: the fit with every constant inside its tolerance, where `fit` may be beyond: the
            gap is what that leaves.
        first: the search at the recalibrated plant, where `fit` is another.
        known: a term that `fit` was fitted with: numbers of its columns, and the fit. What it does
            is taken as it is there: simulated gas does not take in a flow in proportion.
        has_own_gap: whether constants fitted to this block alone leave a gap in it. Otherwise
            another has led them astray, and an error of the force cell, which the load shows as
            well, would stand for what the load's gap is.
    """
    here = problem.rows.block == BLOCKS.index(block)
    count = int(here.sum())
    with_cell = has_own_gap if first is None else any(p.scale in OF_CELL for p in first.pieces)
    scales = _scales(problem, fit, block, count, with_cell)
    flows = NO_FLOWS
    if block != "pressure":
        at = inputs_of(problem.grid, block, MUSCLE_INPUTS) | scales
        pieces, columns = pieces_of(at, count, _waves(problem, fit, block, at, first))
    else:
        if first is None:
            at = inputs_of(problem.grid, block, GAS_INPUTS)
            pieces, columns = pieces_of(at, count, _waves(problem, fit, block, at, None))
            pieces, flows = with_flows(problem, pieces, columns.shape[1])
        else:  # only what a flow does depends on the fit
            pieces, flows = first.pieces, first.flows
            columns = first.basis[:, : first.basis.shape[1] - len(flows.scales)]
        columns = np.hstack([columns, raised(problem, fit, flows)])
    if not pieces:
        return None
    beside = columns_in_load(problem, pieces, columns.shape[1])
    size = max(float(np.sqrt(np.mean(fit.residual[here] ** 2))), 1e-9)
    stated = float(np.sqrt(np.mean(problem.stated_residual[here] ** 2)))
    penalty = np.zeros((columns.shape[1],) * 2)
    for piece in pieces:
        free = np.eye(len(piece.at)) / config.term_sd**2 + piece.rough / config.term_bend**2
        if piece.scale in IN_GAS:
            # A short flow must be larger to be seen as much as a long one. Constants that are led
            # astray hide most of a flow, so what it may be is told by the plant as stated.
            unit = np.sqrt(np.mean(columns[:, piece.at] ** 2, axis=0)) / max(size, stated)
            unit = np.maximum(unit, _LEAST_SEEN * unit.max(initial=0.0))
            if piece.scale == SUPPLY:  # where it is hardly seen it is no larger than elsewhere
                unit = np.full(len(piece.at), unit.max(initial=0.0))
        else:  # a scale has its own unit
            unit = np.full(len(piece.at), _rms(scales.get(piece.scale)) / size)
        penalty[np.ix_(piece.at, piece.at)] = free * unit * unit[:, None]
    residual = fit.residual
    if known is not None:
        residual = known[1].left.copy()
        residual[here] += columns[:, known[0]] @ known[1].beta
        residual += beside[:, known[0]] @ known[1].beta
    terms = HeldOutTerms.of(
        problem, replace(fit, residual=residual), block, columns, penalty, beside=beside
    )
    if len(terms.slots) < config.least_slots:
        return None
    if first is not None:
        return replace(
            first, fit=fit, pieces=pieces, basis=columns, beside=beside, flows=flows, terms=terms,
            known=frozenset() if known is None else frozenset(known[0].tolist()),
        )  # fmt: skip
    plain = terms
    if walled is not None and walled is not fit:
        none = np.empty((count, 0))
        plain = HeldOutTerms.of(
            problem, walled, block, none, np.empty((0, 0)), ESTIMATION.tolerance_sd
        )
    base = plain.errors(np.empty(0, dtype=np.int64))
    floor = floor_squares(problem, problem.units)[block][list(terms.slots)]
    last = np.zeros(int(problem.units.max()) + 1)
    np.maximum.at(last, problem.units[problem.rows.trial[here]], problem.rows.time_s[here])
    made = TermSearch(
        block, fit, pieces, columns, beside, flows, terms, plain, base - floor, floor,
        last[list(terms.slots)], config,
        errors_of_entries(block, {candidate.id for candidate in problem.candidates}),
    )  # fmt: skip
    return made if made.gaps.sum() > 0.0 else None


def _scales(
    problem: FitProblem, fit: FitResult, block: str, count: int, with_cell: bool
) -> dict[str, Array]:
    """What parts of a force or load may be multiplied by, at every row of the block."""
    if block not in ("force", "load"):
        return {}
    made = scales_of(problem.grid, block, problem.constants(fit.shift))
    held = problem.grid.points[block].held
    if held.all() or not held.any():  # nothing was read, or `pull_per_mm` says the same
        del made[SEEN]
    weighs = with_cell and "load" in problem.grid.points and weighed(problem.grid)[CELL].any()
    if block == "force" and weighs:
        made[CELL] = np.ones(count)
    else:
        del made[CELL_GAIN]
    return made


def _waves(
    problem: FitProblem, fit: FitResult, block: str, at: dict[str, Array], first: TermSearch | None
) -> dict[Wave, Array]:
    """What repeats in the residual of a block, and its columns; as in the first search, if any."""
    if first is not None:
        own = [Wave(p.inputs[0], p.scale, p.period) for p in first.pieces if p.period]
    else:
        here = problem.rows.block == BLOCKS.index(block)
        trial = problem.rows.trial[here]
        rows = WaveRows.of(
            problem.grid.points[block], fit.residual[here], problem.rows.compared_s[here], trial,
            problem.units[trial],
        )  # fmt: skip
        own = waves_of(rows, at)
    return {
        wave: waves_at(problem.grid, block, wave.input, wave.period) for wave in dict.fromkeys(own)
    }


def refitted(
    problem: FitProblem, search: TermSearch, chosen: Sequence[Piece]
) -> tuple[Whole, FittedTerm]:
    """Constants fitted with some pieces, and the numbers of their columns."""
    own = np.sort(search.columns(chosen))
    columns = search.beside[:, own]
    columns[problem.rows.block == BLOCKS.index(search.block)] = search.basis[:, own]
    penalty = search.terms.penalty[np.ix_(own, own)]
    plain = search.basis.shape[1] - len(search.flows.scales)
    flows = search.flows.only(own[own >= plain] - plain)
    term = TermColumns(columns, penalty, flows)
    return own, fitted_with_term(problem, search.fit, term, search.terms.coefficients(own))


_LEAST_SEEN = 1e-3
"""Least that a flow at one knot is taken to show, in what it shows at another. One that never acts
there would else be as large as rounding errors make it. A matter of definition."""


def _of_itself(block: str, piece: Piece) -> int:
    """Sign of the slope by which a piece takes away what it is an error of; 0 where it cannot."""
    if piece.scale == READING and piece.inputs == ("pressure_kpa",):
        return 1
    if block == "load" and not piece.scale and set(piece.inputs) & set(PULL_CHANGES):
        return -1
    return 0


def _rms(x: Array | None) -> float:
    """Root mean square of a scale; 1 without one."""
    return 1.0 if x is None else max(float(np.sqrt(np.mean(x**2))), 1e-15)
