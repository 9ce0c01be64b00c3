"""The fit problem: one data set to which constants and candidate effects are fitted.

Everything above it (selection, validation, design) uses the fits and sensitivities of this object.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from gap.data.dataset import DataSet
from gap.data.repair import repaired
from gap.effects.candidates import CANDIDATES, Candidate, single_labels
from gap.effects.terms import OF_TRIAL, Active
from gap.estimation.by_trial import effects_by_trial
from gap.estimation.information import Evidence, covariance, damped_step, gather, tolerance
from gap.estimation.noise import Noise, learn_noise, usual_noise
from gap.estimation.non_identical import non_identical, unexplainable
from gap.model.features import Rows
from gap.model.grid import Grid, make_grid
from gap.model.residuals import Model
from gap.model.sensitivities import (
    calibration_columns,
    candidate_columns,
    constant_columns,
    miscalibrated,
    mounted,
    mounting_columns,
    nominal_columns,
    nominal_shift,
)
from plant.arrays import Array
from plant.constants import KEYS, PlantConstants
from plant.effects.catalogue import CATALOGUE

Whole = npt.NDArray[np.int64]

_ROUNDS = 12
_SMALLER = 3
_RELINEARISED = 4
_NEAR_FITS = 4
_NEAR_SD = 0.1
"""How far, in sd, parameters may lie from those at which a simulator was made linear."""


@dataclass(frozen=True)
class FitResult:
    """A fitted plant: constants moved by `shift` sd, candidates with their amounts.

    Attributes:
        residual: measured minus predicted at this state, shape (rows,).
        cost: whitened sum of squares, the constants' prior included.
        cover: covariance of [constants in sd, amounts].
    """

    shift: Array
    candidates: tuple[Candidate, ...]
    amounts: Array
    residual: Array
    cost: float
    cover: Array

    @property
    def ids(self) -> tuple[str, ...]:
        """Catalogue ids (or defects) in force, each once, in order of entry."""
        return tuple(dict.fromkeys(candidate.id for candidate in self.candidates))

    def kept(self, keep: Callable[[Candidate], bool]) -> tuple[list[Candidate], list[float]]:
        """Candidates for which `keep` holds, and their amounts: the start of another fit."""
        pairs = zip(self.candidates, self.amounts.tolist(), strict=True)
        kept = [(candidate, amount) for candidate, amount in pairs if keep(candidate)]
        return [candidate for candidate, _ in kept], [amount for _, amount in kept]

    @property
    def active(self) -> Active:
        """What the model takes."""
        return [
            (s.id, s.option, float(a), s.shape)
            for s, a in zip(self.candidates, self.amounts, strict=True)
        ]


@dataclass(frozen=True, eq=False)
class ProblemState:
    """What a fit problem has learnt of its data; fields as those of `FitProblem`.

    Attributes:
        around: parameters at which the data set's simulator was run; None without one.
        by_trial: see `FitProblem.by_trial`.
    """

    names: tuple[str, ...]
    stated_columns: Array
    stated_residual: Array
    columns: Array
    base: FitResult
    noise: Noise
    around: Array | None
    by_trial: Active = field(default_factory=list)

    def check(self) -> None:
        """Raise `ValueError` where its parts do not belong together."""
        shape = (len(self.stated_residual), len(self.names))
        right = self.stated_columns.shape == shape == self.columns.shape
        if not right or self.base.residual.shape != shape[:1] != self.noise.white.shape:
            raise ValueError("parts of different problems")


@dataclass(frozen=True, eq=False)
class FitProblem:
    """One data set to which constants and candidate effects are fitted.

    Immutable: a variant is a new problem (`restricted_to`, `with_stated_effects`, `on_model`). A
    problem keeps the sensitivities that it computed last, and shares them with its variants.

    Attributes:
        data: the data set, repaired (`gap.data.repair`).
        candidates: effects that a search may use.
        model: predicts every feature of the data.
        stated_effects: effects that the data set states; they are no gap.
        noise: learnt from the replicates.
        names: what is recalibrated, in the order of `FitResult.shift`: constants of the plant, then
            the offset of each mounting, then the calibrations that the data set states, then the
            parameters of its simulator and the terms of its model error.
        mountings: number of mountings.
        stated_columns: sensitivities of `names` at the stated plant, shape (rows, names).
        stated_residual: measured minus predicted of the stated plant, shape (rows,).
        columns: sensitivities of `names` at `base`.
        base: the fit without any effect: constants recalibrated within their tolerances.
    """

    data: DataSet
    candidates: tuple[Candidate, ...]
    model: Model
    stated_effects: Active
    noise: Noise
    names: tuple[str, ...]
    mountings: int
    stated_columns: Array
    stated_residual: Array
    columns: Array
    base: FitResult
    _kept: dict[str, tuple[Any, ...]] = field(default_factory=dict, repr=False)

    @classmethod
    def of(cls, data: DataSet, candidates: Sequence[Candidate] = CANDIDATES) -> FitProblem:
        """Learn the noise of a data set and recalibrate its constants."""
        data = repaired(data)
        usable = _usable(data, candidates)
        model = Model(make_grid(data))
        stated = _stated_effects(data)
        residual = _stacked_residual(model, data.constants, stated)
        names, columns = constant_columns(model, data.constants, stated, data.constants)
        mountings = int(data.mountings.max(initial=-1)) + 1
        names += [f"mounting {number + 1}" for number in range(mountings)]
        names += [f"calibration {key}" for key in data.calibration]
        names += model.nominal.names if model.nominal is not None else ()
        offsets = _offset_columns(model, data, mountings, data.constants, stated)
        columns = np.hstack([columns, offsets])
        noise = learn_noise(model, data.constants, residual)
        start = np.zeros(len(names))
        nothing = FitResult(start, (), np.empty(0), residual, np.inf, np.eye(len(names)))
        problem = cls(
            data, usable, model, stated, noise, tuple(names), mountings, columns, residual, columns,
            nothing,
        )._recalibrated(start)  # fmt: skip
        problem = problem._with_effects_by_trial()
        left = problem.base.residual
        if non_identical(data):
            # What the stated plant misses differs between such replicates: it is no noise.
            others = np.delete(problem.signatures(problem.base), len(names), axis=1)
            left = unexplainable(others, left, usual_noise(model, data.constants, left))
        noise = learn_noise(model, problem.constants(problem.base.shift), left)
        return replace(problem, noise=noise)._recalibrated(problem.base.shift)

    def _with_effects_by_trial(self) -> FitProblem:
        """The problem with what replicates differ by taken for stated; itself without any.

        Refitted from the stated constants, for what one trial had may have bent them.
        """
        problem, slots = self, list(self.data.slots.values())
        for _ in range(2):
            c = problem.constants(problem.base.shift)
            shared = _of_all_trials(problem.stated_effects)
            plain = replace(problem, stated_effects=shared)
            active = plain.active_effects(problem.base.shift, (), np.empty(0))
            found = effects_by_trial(problem.model, c, active, problem.candidates, slots)
            if not found:
                return self
            stated = [*shared, *found]
            residual = _stacked_residual(problem.model, problem.data.constants, stated)
            noise = learn_noise(problem.model, problem.data.constants, residual)
            problem = replace(
                problem, stated_effects=stated, stated_residual=residual, noise=noise, _kept={}
            )._recalibrated(np.zeros(len(problem.names)))
        return problem

    @classmethod
    def restored(
        cls, data: DataSet, state: ProblemState, candidates: Sequence[Candidate] = CANDIDATES
    ) -> FitProblem:
        """The problem that `of` made of the same data and candidates, from its state."""
        data = repaired(data)
        return cls(
            data, _usable(data, candidates), Model(make_grid(data), state.around),
            [*_stated_effects(data), *state.by_trial], state.noise, state.names,
            int(data.mountings.max(initial=-1)) + 1, state.stated_columns, state.stated_residual,
            state.columns, state.base,
        )  # fmt: skip

    def state(self) -> ProblemState:
        """What took long to compute; see `restored`."""
        nominal = self.model.nominal
        return ProblemState(
            self.names, self.stated_columns, self.stated_residual, self.columns, self.base,
            self.noise, None if nominal is None else nominal.around, self.by_trial,
        )  # fmt: skip

    def _recalibrated(self, shift: Array) -> FitProblem:
        """The problem with its base fitted from `shift`."""
        problem = self
        for _ in range(_RELINEARISED):
            start = problem._descend(shift, (), np.empty(0), problem.stated_columns)
            base = problem.polish(start, 6)
            moved = problem._run_near(base)
            if moved is None:
                break
            problem, shift = moved, base.shift
        columns = problem.columns_at(base.shift, (), np.empty(0))
        return replace(problem, base=base, columns=columns, _kept={})

    def _run_near(self, base: FitResult) -> FitProblem | None:
        """The problem with a simulator with memory run at the parameters of a fit.

        None where it was run near enough to them.
        """
        nominal = self.model.nominal
        if nominal is None or nominal.static or not len(nominal.around):
            return None
        own = base.shift[len(self.names) - len(nominal.names) :][: len(nominal.around)]
        if np.abs(own - nominal.around).max() < _NEAR_SD:
            return None
        model = Model(self.grid, own, self.model)
        return replace(self, model=model, _kept={})

    def run_as_stated(self) -> FitProblem:
        """The problem with a simulator with memory run at its stated parameters.

        Recalibration may have moved them far to make up for an effect: from where it runs then the
        way back is no straight line. The problem itself where that changes nothing.
        """
        nominal = self.model.nominal
        if nominal is None or nominal.static or not np.any(nominal.around):
            return self
        model = Model(self.grid, np.zeros(len(nominal.around)), self.model)
        problem = replace(self, model=model, _kept={})
        start = problem._descend(np.zeros(len(self.names)), (), np.empty(0), problem.stated_columns)
        base = problem.polish(start, 6)
        columns = problem.columns_at(base.shift, (), np.empty(0))
        return replace(problem, base=base, columns=columns, _kept={})

    def restricted_to(self, usable: Callable[[Candidate], bool]) -> FitProblem:
        """The same problem with the candidates for which `usable` holds."""
        return replace(self, candidates=tuple(s for s in self.candidates if usable(s)))

    def with_stated_effects(self, effects: Active) -> FitProblem:
        """The same problem for a plant that has more stated effects; its base stays."""
        return replace(self, stated_effects=[*self.stated_effects, *effects], _kept={})

    def with_free_constants(self, names: Sequence[str], share: float) -> FitProblem:
        """The same data for a plant some of whose constants are known to `share` of them only.

        Recalibrated anew, from where the constants are.
        """
        c = self.data.constants
        known = {name for name in names if name in self.names and c.tolerance_si(name) > 0.0}
        wide = {name: share * c.value(name) for name in sorted(known)}
        freed = replace(c, tolerances=tuple((dict(c.tolerances) | wide).items()))
        wider = np.array(
            [
                freed.tolerance_si(name) / c.tolerance_si(name) if name in known else 1.0
                for name in self.names
            ]
        )
        base = replace(self.base, shift=self.base.shift / wider)
        problem = replace(
            self, data=replace(self.data, constants=freed), base=base,
            stated_columns=self.stated_columns * wider, columns=self.columns * wider, _kept={},
        )  # fmt: skip
        return problem._recalibrated(base.shift)

    def on_model(self, data: DataSet, model: Model, noise: Noise) -> FitProblem:
        """The same plant and fits on other trials, with their model and noise."""
        stated = _of_all_trials(self.stated_effects)
        return replace(self, data=data, model=model, noise=noise, stated_effects=stated, _kept={})

    @property
    def by_trial(self) -> Active:
        """What trials have more of an effect than their replicates, each with its trial."""
        return [one for one in self.stated_effects if OF_TRIAL in one[3]]

    @property
    def grid(self) -> Grid:
        """Features of the data, and what the model needs to predict them."""
        return self.model.grid

    @property
    def rows(self) -> Rows:
        """One row a feature."""
        return self.model.grid.rows

    @property
    def unnamed(self) -> int:
        """Number of entries of `names` that are no constants of the plant; they stand last."""
        return self.mountings + len(self.data.calibration) + self.own

    @property
    def own(self) -> int:
        """Number of entries that the data set's simulator adds, at the end of `names`."""
        return len(self.model.nominal.names) if self.model.nominal is not None else 0

    def simulator_values(self, shift: Array) -> dict[str, float]:
        """Parameters of the data set's simulator moved by `shift` sd, by name, in their units."""
        nominal = self.model.nominal
        if nominal is None:
            return {}
        own = shift[len(self.names) - self.own :]
        return nominal.prior.values(own[: len(nominal.prior.names)])

    @cached_property
    def units(self) -> Whole:
        """Slot of each trial, shape (trials,)."""
        slots = {slot: k for k, slot in enumerate(self.data.slots)}
        return np.array([slots[trial.slot] for trial in self.data.trials], dtype=np.int64)

    @cached_property
    def floor_variance(self) -> Array:
        """Variance of each row that the noise explains, shape (rows,)."""
        return self.noise.variance()

    def constants(self, shift: Array) -> PlantConstants:
        """Constants of the bench moved by `shift` sd of their tolerances."""
        c = self.data.constants
        changes = {}
        recalibrated = len(self.names) - self.unnamed
        for key, sd in zip(self.names[:recalibrated], shift, strict=False):
            field = KEYS[key].field
            value = getattr(c, field) + float(sd) * c.tolerance_si(key)
            if getattr(c, field) > 0.0 and not field.endswith("per_pa"):
                value = max(value, 0.02 * getattr(c, field))
            changes[field] = value
        return replace(c, **changes)

    def active_effects(
        self, shift: Array, candidates: Sequence[Candidate], amounts: Array
    ) -> Active:
        """What the model takes: what is given, each mounting's offset, and candidates in force."""
        own = shift[len(self.names) - self.unnamed :]
        active = [
            (s.id, s.option, float(a), s.shape) for s, a in zip(candidates, amounts, strict=True)
        ]
        last = self.mountings + len(self.data.calibration)
        off = miscalibrated(own[self.mountings : last], self.data.calibration)
        nominal = nominal_shift(own[last:])
        return [*self.stated_effects, *mounted(own[: self.mountings]), *off, *nominal, *active]

    def fit(
        self,
        candidates: Sequence[Candidate],
        start: Sequence[float] = (),
        near: FitResult | None = None,
    ) -> FitResult:
        """Gauss-Newton over constants (with their prior) and the amounts of `candidates`.

        Starts from the constants of `near`, by default of the recalibrated plant.
        """
        amounts = np.array(start or [0.0] * len(candidates), dtype=np.float64)
        at = self.base if near is None else near
        columns = self.columns if at is self.base else self.columns_near(at)
        # An amount on top of constants that have already given way may lead far astray; the
        # descent moves both, and gets there from a smaller one.
        for _ in range(_SMALLER):
            if self.cost_at(at.shift, candidates, amounts) < 1.5 * at.cost:
                break
            amounts[-1:] *= 0.3
        else:
            amounts[-1:] = 0.0
        found = self._descend(at.shift, candidates, amounts, columns)
        if found.cost > at.cost and np.any(amounts[-1:]):
            # It got lost; from nothing at all it can only get better.
            amounts[-1:] = 0.0
            found = min(
                found, self._descend(at.shift, candidates, amounts, columns), key=lambda s: s.cost
            )
        return found

    def fitted(self, ids: Sequence[str]) -> tuple[str, ...]:
        """Those of some effects that a fit can hold."""
        known = {candidate.id for candidate in self.candidates}
        return tuple(name for name in ids if name in known)

    def fit_effects(self, ids: Sequence[str]) -> FitResult:
        """Fit effects by their ids, each in its first shape, from the amount of its sensitivity.

        What has no candidate is left out: what a reference standard showed is stated, not fitted.
        """
        own = [next(s for s in self.candidates if s.id == name) for name in self.fitted(ids)]
        return self.fit(own, [candidate.step for candidate in own])

    def columns_near(self, fit: FitResult) -> Array:
        """Sensitivities of the constants at a fit; those of the last fits are kept."""
        kept = self._kept.get("near", ())
        for known, columns in kept:
            if known is fit:
                return np.asarray(columns)
        columns = self.columns_at(fit.shift, fit.candidates, fit.amounts)
        self._kept["near"] = (*kept[1 - _NEAR_FITS :], (fit, columns))
        return columns

    def fit_afresh(self, candidates: Sequence[Candidate], start: Sequence[float] = ()) -> FitResult:
        """Return what `fit` gives when it starts from the constants as stated."""
        amounts = np.array(start or [0.0] * len(candidates), dtype=np.float64)
        return self._descend(np.zeros(len(self.names)), candidates, amounts, self.stated_columns)

    def fit_from(
        self, shift: Array, candidates: Sequence[Candidate], start: Sequence[float]
    ) -> FitResult:
        """Return what `fit` gives when it starts from given constants, in sd."""
        amounts = _bounded(candidates, np.array(start, dtype=np.float64))
        return self._descend(
            shift, candidates, amounts, self.columns_at(shift, candidates, amounts)
        )

    def polish(self, fit: FitResult, rounds: int = 3) -> FitResult:
        """Fit again from a fit, with signatures of the constants taken there."""
        for _ in range(rounds):
            columns = self.columns_at(fit.shift, fit.candidates, fit.amounts)
            better = self._descend(fit.shift, fit.candidates, fit.amounts, columns)
            gained = fit.cost - better.cost
            if gained > -1e-9:
                fit = better
            if gained < max(1.0, 3e-4 * fit.cost):
                break
        return fit

    def columns_of(self, fit: FitResult) -> Array:
        """Signatures of constants and amounts at a fit, shape (rows, constants + candidates)."""
        slopes = self.slopes(fit.shift, fit.candidates, fit.amounts)
        return np.hstack([self.columns_near(fit), slopes])

    def columns_at(self, shift: Array, candidates: Sequence[Candidate], amounts: Array) -> Array:
        """Signatures of the constants, shape (rows, constants), with candidates in force."""
        active = self.active_effects(shift, candidates, amounts)
        c = self.constants(shift)
        names, columns = constant_columns(self.model, c, active, self.data.constants)
        names += self.names[len(self.names) - self.unnamed :]
        columns = np.hstack(
            [columns, _offset_columns(self.model, self.data, self.mountings, c, active)]
        )
        made = np.zeros((len(self.rows), len(self.names)))
        for j, name in enumerate(self.names):
            if name in names:
                made[:, j] = columns[:, names.index(name)]
        return np.nan_to_num(made)

    def _descend(
        self, shift: Array, candidates: Sequence[Candidate], amounts: Array, constants: Array
    ) -> FitResult:
        n = len(self.names)
        shift = shift.copy()
        amounts = _bounded(candidates, amounts)
        residual, cost = self._at(shift, candidates, amounts)
        matrix, right = np.eye(n + len(candidates)), np.zeros(n + len(candidates))
        damping = 1e-6
        stale = True
        for _ in range(_ROUNDS):
            if stale:
                columns = np.hstack([constants, self.slopes(shift, candidates, amounts)])
                matrix, right = self.normal(columns, residual, shift)
            beta = damped_step(matrix, right, damping)
            new_shift = shift + beta[:n]
            new_amounts = _bounded(candidates, amounts + beta[n:])
            trial, trial_cost = self._at(new_shift, candidates, new_amounts)
            stale = trial_cost < cost
            if not stale:
                damping = max(damping, 1e-4) * 8.0
                continue
            gain = cost - trial_cost
            shift, amounts, residual, cost = new_shift, new_amounts, trial, trial_cost
            damping = damping / 10.0
            if gain < max(0.2, 1e-4 * cost):
                break
        return FitResult(shift, tuple(candidates), amounts, residual, cost, covariance(matrix))

    def at(
        self, shift: Array, candidates: Sequence[Candidate], amounts: Array, like: FitResult
    ) -> FitResult:
        """Return the fit at given constants and amounts, with the covariance of another."""
        amounts = _bounded(candidates, amounts)
        residual, cost = self._at(shift, candidates, amounts)
        return FitResult(shift, tuple(candidates), amounts, residual, cost, like.cover)

    def _at(
        self, shift: Array, candidates: Sequence[Candidate], amounts: Array
    ) -> tuple[Array, float]:
        residual = self.residual_at(shift, candidates, amounts)
        return residual, self.whitened(residual) + tolerance(shift)[0]

    def cost_at(self, shift: Array, candidates: Sequence[Candidate], amounts: Array) -> float:
        """Whitened sum of squares at given constants and amounts, prior included."""
        return self._at(shift, candidates, amounts)[1]

    def residual_at(self, shift: Array, candidates: Sequence[Candidate], amounts: Array) -> Array:
        """Measured minus predicted at given constants and amounts, shape (rows,)."""
        return _stacked_residual(
            self.model, self.constants(shift), self.active_effects(shift, candidates, amounts)
        )

    def predicted_difference(self, first: FitResult, second: FitResult) -> Array:
        """Prediction of the second fit minus that of the first, without offsets of mountings.

        Shape (rows,).
        """
        one, two = (
            _stacked_residual(self.model, self.constants(fit.shift), fit.active)
            for fit in (first, second)
        )
        return one - two

    def whitened(self, residual: Array) -> float:
        """Sum of squares of a residual in the noise's own measure."""
        total = 0.0
        for trial, rows in enumerate(self.noise.trial_rows):
            if len(rows):
                total += float(self.noise.solve(trial, residual[rows][:, None])[0][0, 0])
        return total

    def slopes(self, shift: Array, candidates: Sequence[Candidate], amounts: Array) -> Array:
        """Signatures of the candidates in force, at their present amounts."""
        made = np.zeros((len(self.rows), len(candidates)))
        c = self.constants(shift)
        active = self.active_effects(shift, candidates, amounts)
        ahead = len(active) - len(candidates)

        def slope(j: int) -> Array:
            candidate = candidates[j]
            there = [block for block in candidate.blocks if block in self.grid.points]
            step = max(0.3 * candidate.step, 0.02 * abs(amounts[j]))
            if candidate.switch:
                step = 1.0
            low = [*active]
            high = [*active]
            less = max(amounts[j] - step, 0.0) if candidate.sign else amounts[j] - step
            low[ahead + j] = (candidate.id, candidate.option, less, candidate.shape)
            high[ahead + j] = (candidate.id, candidate.option, amounts[j] + step, candidate.shape)
            a = self.model.residual(c, low, there)
            b = self.model.residual(c, high, there)
            span = high[ahead + j][2] - low[ahead + j][2]
            return self.model.stacked({k: (a[k] - b[k]) / span for k in there})

        for j, column in enumerate(self.model.each(slope, range(len(candidates)))):
            made[:, j] = column
        return np.nan_to_num(made)

    def normal(self, columns: Array, residual: Array, shift: Array) -> tuple[Array, Array]:
        """Matrix and right side of the normal equations, the constants' prior included."""
        n = len(self.names)
        width = columns.shape[1]
        both = np.hstack([columns, residual[:, None]])
        gram = np.zeros((width + 1, width + 1))
        for trial, rows in enumerate(self.noise.trial_rows):
            if len(rows):
                gram += self.noise.solve(trial, both[rows])[0]
        matrix = gram[:width, :width].copy()
        right = gram[:width, width].copy()
        _, slope, stiffness = tolerance(shift)
        matrix[range(n), range(n)] += stiffness
        right[:n] -= slope
        return matrix, right

    def stated(self) -> FitResult:
        """The plant as stated, nothing fitted: where a large effect leaves constants alone."""
        shift = np.zeros(len(self.names))
        residual, cost = self._at(shift, (), np.empty(0))
        return FitResult(shift, (), np.empty(0), residual, cost, np.eye(len(shift)))

    def signatures(self, fit: FitResult) -> Array:
        """Columns [constants | residual | candidates] at a fit, shape (rows, columns)."""
        constants = self.columns if np.any(fit.shift) else self.stated_columns
        return np.hstack([constants, fit.residual[:, None], self._candidate_columns(fit)])

    def _candidate_columns(self, fit: FitResult) -> Array:
        """Sensitivities of all candidates at a fit; those of the last fit are kept."""
        kept = self._kept.get("candidates")
        if (
            kept is None
            or kept[0] is not fit
            or not set(map(id, self.candidates)) <= kept[1].keys()
        ):
            active = self.active_effects(fit.shift, fit.candidates, fit.amounts)
            columns = candidate_columns(
                self.model, self.constants(fit.shift), active, self.candidates
            )
            place = {id(candidate): j for j, candidate in enumerate(self.candidates)}
            kept = self._kept["candidates"] = (fit, place, np.nan_to_num(columns))
        _, place, columns = kept
        return np.asarray(columns[:, [place[id(candidate)] for candidate in self.candidates]])

    def evidence(self, fit: FitResult) -> Evidence:
        """Inner products of constants, residual and all candidates at `fit`."""
        columns = self.signatures(fit)
        n = len(self.names)
        return gather(
            self.noise, columns[:, :n], fit.residual, columns[:, n + 1 :], self.rows.block,
            self.rows.compared_s, self.units, fit.shift,
        )  # fmt: skip

    def all_columns(self, fit: FitResult) -> Array:
        """Signatures at a fit: [constants | effects in force | all candidates]."""
        return np.hstack([self.columns_of(fit), self._candidate_columns(fit)])

    def schemes(self) -> dict[str, Whole]:
        """What can be held out whole: slots, and protocols and mountings with three or more."""
        made = {"slot": self.units}
        for name in ("protocol", "mounting"):
            labels = [str(getattr(trial, name)) for trial in self.data.trials]
            known = {label: k for k, label in enumerate(dict.fromkeys(labels))}
            if len(known) >= 3:
                made[name] = np.array([known[label] for label in labels], dtype=np.int64)
        return made


def _usable(data: DataSet, candidates: Sequence[Candidate]) -> tuple[Candidate, ...]:
    """Candidates for a data set.

    A table of settled points has no time in it, so nothing in it can be out of time. A cylinder has
    no braid.
    """
    if data.constants.actuator == "cylinder":
        candidates = [s for s in candidates if s.defect or not CATALOGUE[s.id].of_braid]
    if not data.settled:
        return tuple(candidates)
    usable = tuple(s for s in candidates if not (s.defect or s.search.scan == "clock"))
    # Lengths set by hand: one of them may be wrong.
    return usable + single_labels(usable, [trial.held_length_mm for trial in data.trials])


def _of_all_trials(active: Active) -> Active:
    """Effects without those that act in one trial alone."""
    return [one for one in active if OF_TRIAL not in one[3]]


def _bounded(candidates: Sequence[Candidate], amounts: Array) -> Array:
    ranges = np.array([s.bounds for s in candidates]).reshape(-1, 2)
    return np.asarray(np.clip(amounts, ranges[:, 0], ranges[:, 1]))


def _stacked_residual(model: Model, c: PlantConstants, active: Active) -> Array:
    """Measured minus predicted, one value a row; what cannot be predicted counts as 0."""
    return np.nan_to_num(model.stacked(model.residual(c, active)), nan=0.0, posinf=3e3, neginf=-3e3)


def _offset_columns(
    model: Model, data: DataSet, mountings: int, c: PlantConstants, active: Active
) -> Array:
    """Sensitivities of mountings and calibrations, whose errors all trials of one share, and of
    the numbers of the data set's simulator.
    """
    return np.hstack(
        [
            mounting_columns(model, c, active, mountings),
            calibration_columns(model, c, active, data.calibration),
            nominal_columns(model, c, active),
        ]
    )


def _stated_effects(data: DataSet) -> Active:
    """Effects that `bench.toml` states, in the terms of the candidates."""
    made: Active = []
    for name, table in data.effects.values.items():
        entry = CATALOGUE[name]
        shape = next(s.shape for s in CANDIDATES if s.id == name)
        if entry.diagnosis.stated is not None:
            shape = entry.diagnosis.stated(shape, table, data.constants)
        option = next((str(v) for v in table.values() if isinstance(v, str)), "")
        made.append((name, option, entry.amount(table, data.constants), shape))
    return made
