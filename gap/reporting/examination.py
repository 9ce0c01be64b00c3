"""A data set with its verdict and with what the verdict rests on, for whoever writes about it."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from gap.data.dataset import DataSet
from gap.decision.diagnose import diagnose_with_search
from gap.estimation.cross_validation import held_out
from gap.estimation.fit_problem import FitProblem
from gap.model.features import BLOCKS, UNITS
from gap.selection.search import SearchResult
from gap.validation.maps import Course, residual_maps
from gap.verdict import Verdict
from plant.arrays import Array


@dataclass(frozen=True)
class Rung:
    """One step of the ladder: error held out by slot, in the gap's unit."""

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
class Examination:
    """Verdict, ladder, residuals and their courses; only the verdict where nothing compares."""

    data: DataSet
    verdict: Verdict
    ladder: tuple[Rung, ...]
    field: Field | None
    digest: str
    courses: tuple[Course, ...] = ()


def examine(data: DataSet, without: Iterable[str] = ()) -> Examination:
    """Diagnose a data set and keep what a report needs.

    Raises:
        GapError: as `gap.decision.diagnose.diagnose`.
    """
    digest = fingerprint(data)
    verdict, problem, search = diagnose_with_search(data, without)
    if problem is None or search is None:
        return Examination(data, verdict, (), None, digest)
    block = _block(problem, search, verdict)
    if block is None:
        return Examination(data, verdict, (), None, digest)
    return Examination(
        data, verdict, _ladder(problem, search, block), _field(problem, search, block), digest,
        tuple(residual_maps(problem, search.best.fit)),
    )  # fmt: skip


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
    gap = verdict.gap
    if gap is None:
        return None
    held = held_out(problem, search.best.fit)
    there = [block for block in held if UNITS[block] == gap.unit]
    if not there:
        return None
    return min(there, key=lambda b: abs(held[b].rms("recalibrated") - gap.recalibrated))


def _ladder(problem: FitProblem, search: SearchResult, block: str) -> tuple[Rung, ...]:
    best = search.best.fit
    base = held_out(problem, problem.base)[block]
    rungs = [Rung("as stated", base.rms("before")), Rung("recalibrated", base.rms("recalibrated"))]
    ids = list(dict.fromkeys(candidate.id for candidate in best.candidates))
    for count in range(1, len(ids) + 1):
        first = set(ids[:count])
        part = best.kept(lambda candidate, some=first: candidate.id in some)  # type: ignore[misc]
        fit = best if count == len(ids) else problem.fit(*part)
        rungs.append(Rung(f"+ {ids[count - 1]}", held_out(problem, fit)[block].rms("after")))
    return tuple(rungs)


def _field(problem: FitProblem, search: SearchResult, block: str) -> Field:
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
        after=search.best.fit.residual[here],
        weight=rows.span_s[here],
    )
