"""A data set with its verdict and with what the verdict rests on, for whoever writes about it."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from gap.data.dataset import DataSet
from gap.decision.diagnosis import Diagnosis, diagnosis
from gap.estimation.cross_validation import held_out
from gap.estimation.fit_problem import FitProblem, FitResult
from gap.model.features import BLOCKS, UNITS
from gap.selection.search import SearchResult
from gap.validation.maps import Course, residual_maps
from gap.verdict import Verdict
from plant.arrays import Array


@dataclass(frozen=True)
class Rung:
    """One step of the ladder: error held out by slot, if there are several, in the gap's unit."""

    label: str
    rms: float


@dataclass(frozen=True)
class Field:
    """Residuals of the gap's block before and after, one value a row, shape (rows,).

    Pressures in kPa, lengths in mm, `order` counts the trials, residuals in the gap's unit.
    """

    block: str
    unit: str
    pressure_kpa: Array
    length_mm: Array
    order: Array
    time_s: Array
    before: Array
    after: Array
    weight: Array


@dataclass(frozen=True)
class Trace:
    """One trial as measured and as predicted, over time or, where settled, over pressure.

    Attributes:
        x: time in s or pressure in kPa, ascending, shape (rows,).
        measured, recalibrated, after: in the gap's unit, shape (rows,).
    """

    trial: str
    settled: bool
    x: Array
    measured: Array
    recalibrated: Array
    after: Array


@dataclass(frozen=True)
class Examination:
    """Verdict, ladder, residuals and their courses; only the verdict where nothing compares."""

    data: DataSet
    verdict: Verdict
    ladder: tuple[Rung, ...]
    field: Field | None
    digest: str
    courses: tuple[Course, ...] = ()
    traces: tuple[Trace, ...] = ()


def examine(
    data: DataSet, without: Iterable[str] = (), found: Diagnosis | None = None
) -> Examination:
    """Diagnose a data set and keep what a report needs; `found` is its diagnosis if known.

    Raises:
        GapError: as `gap.decision.diagnose.diagnose`.
    """
    digest = fingerprint(data)
    found = found or diagnosis(data, without, keep=False)
    verdict, problem, search = found.verdict, found.problem, found.search
    if problem is None or search is None:
        return Examination(data, verdict, (), None, digest)
    block = _block(problem, search, verdict)
    if block is None:
        return Examination(data, verdict, (), None, digest)
    fit = standing_fit(problem, search, verdict)
    return Examination(
        data, verdict, _ladder(problem, fit, block), _field(problem, fit, block), digest,
        tuple(residual_maps(problem, fit)), _traces(problem, fit, block),
    )  # fmt: skip


def standing_fit(problem: FitProblem, search: SearchResult, verdict: Verdict) -> FitResult:
    """The fit of the first entry that the verdict stands by; else the recalibrated plant."""
    if not verdict.effects or not verdict.status.explained:
        return problem.base
    first = problem.fitted(verdict.effects[0].ids)
    if not first:
        return problem.base
    for hypothesis in (search.best, *search.rivals):
        if set(hypothesis.fit.ids) == set(first):
            return hypothesis.fit
    return problem.fit_effects(first)


def fingerprint(data: DataSet) -> str:
    """SHA-256 of every number of a data set: which data a report is about."""
    crc = hashlib.sha256()
    for trial in data.trials:
        crc.update(f"{trial.name}\0{trial.slot}\0{trial.mounting}\0".encode())
        for name in sorted(trial.channels):
            crc.update(name.encode())
            crc.update(np.ascontiguousarray(trial.channels[name].time_s).tobytes())
            crc.update(np.ascontiguousarray(trial.channels[name].value).tobytes())
    return crc.hexdigest()


def _block(problem: FitProblem, search: SearchResult, verdict: Verdict) -> str | None:
    """The block that the verdict's gap is about: of its unit, and of its recalibrated error."""
    gap = verdict.headline_gap
    if gap is None:
        return None
    held = held_out(problem, search.best.fit)
    there = [block for block in held if UNITS[block] == gap.unit]
    if not there:
        return None
    return min(there, key=lambda b: abs(held[b].rms("recalibrated") - gap.recalibrated))


def _ladder(problem: FitProblem, best: FitResult, block: str) -> tuple[Rung, ...]:
    several = len(problem.data.slots) > 1
    base = held_out(problem, problem.base)[block]
    rungs = [Rung("as stated", base.rms("before"))]
    rungs.append(Rung("recalibrated", base.errors(several)[0]))
    ids = list(dict.fromkeys(candidate.id for candidate in best.candidates))
    for count in range(1, len(ids) + 1):
        first = set(ids[:count])
        part = best.kept(lambda candidate, some=first: candidate.id in some)  # type: ignore[misc]
        fit = best if count == len(ids) else problem.fit(*part)
        rungs.append(Rung(f"+ {ids[count - 1]}", held_out(problem, fit)[block].errors(several)[1]))
    return tuple(rungs)


_TRACES = 3


def _traces(problem: FitProblem, fit: FitResult, block: str) -> tuple[Trace, ...]:
    """Measured and predicted in the settings whose gap is largest, the first replicate of each."""
    measured = problem.model.readings(block)
    if measured is None:
        return ()
    at = np.flatnonzero(problem.rows.block == BLOCKS.index(block))
    of_trial = problem.rows.trial[at]
    ranked: list[tuple[float, int]] = []
    for members in problem.data.slots.values():
        here = at[of_trial == members[0]]
        if len(here) >= _LEAST_ROWS:
            ranked.append((-float(np.mean(problem.base.residual[here] ** 2)), members[0]))
    return tuple(
        _trace(problem, fit, at[of_trial == t], measured[of_trial == t], t)
        for _, t in sorted(ranked)[:_TRACES]
    )


_LEAST_ROWS = 4


def _trace(problem: FitProblem, fit: FitResult, here: Array, measured: Array, number: int) -> Trace:
    trial = problem.data.trials[number]
    x = problem.rows.pressure[here] * 1e-3 if trial.settled else problem.rows.time_s[here]
    order = np.argsort(x, kind="stable")
    return Trace(
        trial.name, trial.settled, x[order], measured[order],
        (measured - problem.base.residual[here])[order],
        (measured - fit.residual[here])[order],
    )  # fmt: skip


def _field(problem: FitProblem, fit: FitResult, block: str) -> Field:
    here = problem.rows.block == BLOCKS.index(block)
    rows = problem.rows
    orders = np.array([trial.order for trial in problem.data.trials])
    return Field(
        block=block,
        unit=UNITS[block],
        pressure_kpa=rows.pressure[here] * 1e-3,
        length_mm=rows.length[here] * 1e3,
        order=orders[rows.trial[here]],
        time_s=rows.time_s[here],
        before=problem.base.residual[here],
        after=fit.residual[here],
        weight=rows.compared_s[here],
    )
