"""One data set under question: fits constants and suspects to it, nonlinearly.

Everything above (naming, shrinking, advice) asks this object for fits; it keeps the grid, the
noise and the signatures, and counts nothing twice.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gap.data.dataset import DataSet
from gap.data.duplicates import without_copies
from gap.effects.candidates import SUSPECTS, Suspect
from gap.estimation.information import Evidence, gather, tolerance
from gap.estimation.noise import learn_noise, usual_noise
from gap.estimation.non_identical import controlled, out_of_reach
from gap.estimation.normal_equations import covariance, solved
from gap.model.force import Active
from gap.model.grid import make_grid
from gap.model.residuals import Model
from gap.model.sensitivities import (
    calibration_columns,
    constant_columns,
    miscalibrated,
    mounted,
    mounting_columns,
    suspect_columns,
)
from plant.constants import KEYS, PlantConstants
from plant.effects.catalogue import CATALOGUE

Array = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

_ROUNDS = 12
_SMALLER = 3


@dataclass(frozen=True)
class State:
    """A fitted plant: constants moved by `shift` sd, suspects with their amounts.

    Attributes:
        residual: measured minus predicted at this state, shape (rows,).
        cost: whitened sum of squares, the constants' prior included.
        cover: covariance of [constants in sd, amounts].
    """

    shift: Array
    suspects: tuple[Suspect, ...]
    amounts: Array
    residual: Array
    cost: float
    cover: Array

    @property
    def ids(self) -> tuple[str, ...]:
        """Catalogue ids (or defects) in force, each once, in order of entry."""
        return tuple(dict.fromkeys(suspect.id for suspect in self.suspects))

    @property
    def active(self) -> Active:
        """What the model takes."""
        return [
            (s.id, s.option, float(a), s.shape)
            for s, a in zip(self.suspects, self.amounts, strict=True)
        ]


class Inquiry:
    """Fits to one data set; see `State`.

    Attributes:
        names: constants that are recalibrated, in the order of `State.shift`.
        base: the state with no suspect: constants recalibrated within their tolerances.
        untouched: rows of the nominal plant as stated, shape (rows,).
    """

    def __init__(self, data: DataSet, suspects: Sequence[Suspect] = SUSPECTS) -> None:
        data = without_copies(data)
        self.data = data
        # A table of settled points has no time in it, so nothing in it can be out of time.
        timed = not data.settled
        self.suspects = tuple(
            s for s in suspects if timed or not (s.defect or s.id == "camera_delay")
        )
        self.grid = make_grid(data)
        self.model = Model(self.grid)
        self.given: Active = _given(data)
        self.rows = self.grid.rows
        self.untouched = self._residual(data.constants, self.given)
        self.noise = learn_noise(self.model, data.constants, self.untouched)
        self.names, stated = constant_columns(
            self.model, data.constants, self.given, data.constants
        )
        self.mountings = int(data.mountings.max(initial=-1)) + 1
        self.names += [f"mounting {number + 1}" for number in range(self.mountings)]
        self.names += [f"calibration {key}" for key in data.calibration]
        self.unnamed = self.mountings + len(data.calibration)
        self.stated_columns = np.hstack([stated, self._unnamed_columns(data.constants, self.given)])
        self.columns = self.stated_columns
        self.units = self._units()
        self._near: tuple[State, Array] | None = None
        self._signed: tuple[State, tuple[Suspect, ...], Array] | None = None
        self.base = self._recalibrate(np.zeros(len(self.names)))
        # Replicates that a controller made are not alike in time: what the plant as stated misses
        # differs between them, and would be taken for noise.
        left = self.base.residual
        if controlled(data):
            columns = np.delete(self.signatures(self.base), len(self.names), axis=1)
            usually = usual_noise(self.model, data.constants, left)
            left = out_of_reach(columns, left, usually)
        self.noise = learn_noise(self.model, self.constants(self.base.shift), left)
        self.base = self._recalibrate(self.base.shift)
        self.floor_variance = self.noise.variance()

    def _residual(self, c: PlantConstants, active: Active) -> Array:
        rows = self.model.stacked(self.model.residual(c, active))
        return np.nan_to_num(rows, nan=0.0, posinf=3e3, neginf=-3e3)

    def _units(self) -> Whole:
        slots = {slot: k for k, slot in enumerate(self.data.slots)}
        return np.array([slots[trial.slot] for trial in self.data.trials], dtype=np.int64)

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
        return dataclasses.replace(c, **changes)

    def found(self, shift: Array, suspects: Sequence[Suspect], amounts: Array) -> Active:
        """What the model takes: what is given, each mounting's offset, and suspects in force."""
        own = shift[len(self.names) - self.unnamed :]
        active = [
            (s.id, s.option, float(a), s.shape) for s, a in zip(suspects, amounts, strict=True)
        ]
        off = miscalibrated(own[self.mountings :], self.data.calibration)
        return [*self.given, *mounted(own[: self.mountings]), *off, *active]

    def _unnamed_columns(self, c: PlantConstants, active: Active) -> Array:
        """Signatures of mountings and calibrations, whose errors all trials of one share."""
        return np.hstack(
            [
                mounting_columns(self.model, c, active, self.mountings),
                calibration_columns(self.model, c, active, self.data.calibration),
            ]
        )

    def fit(
        self, suspects: Sequence[Suspect], start: Sequence[float] = (), near: State | None = None
    ) -> State:
        """Gauss-Newton over constants (with their prior) and the amounts of `suspects`.

        Starts from the constants of `near`, by default of the recalibrated plant.
        """
        amounts = np.array(start or [0.0] * len(suspects), dtype=np.float64)
        at = self.base if near is None else near
        columns = self.columns if at is self.base else self.columns_near(at)
        # An amount on top of constants that have already given way may lead far astray; the
        # descent moves both, and gets there from a smaller one.
        for _ in range(_SMALLER):
            if self.cost_at(at.shift, suspects, amounts) < 1.5 * at.cost:
                break
            amounts[-1:] *= 0.3
        else:
            amounts[-1:] = 0.0
        found = self._descend(at.shift, suspects, amounts, columns)
        if found.cost > at.cost and np.any(amounts[-1:]):
            # It got lost; from nothing at all it can only get better.
            amounts[-1:] = 0.0
            found = min(
                found, self._descend(at.shift, suspects, amounts, columns), key=lambda s: s.cost
            )
        return found

    def columns_near(self, state: State) -> Array:
        """Signatures of the constants at a state; those of the last one asked for are kept."""
        if self._near is None or self._near[0] is not state:
            self._near = (state, self.columns_at(state.shift, state.suspects, state.amounts))
        return self._near[1]

    def fit_afresh(self, suspects: Sequence[Suspect], start: Sequence[float] = ()) -> State:
        """Return what `fit` gives when it starts from the constants as stated."""
        amounts = np.array(start or [0.0] * len(suspects), dtype=np.float64)
        return self._descend(np.zeros(len(self.names)), suspects, amounts, self.stated_columns)

    def fit_from(self, shift: Array, suspects: Sequence[Suspect], start: Sequence[float]) -> State:
        """Return what `fit` gives when it starts from given constants, in sd."""
        amounts = _bounded(suspects, np.array(start, dtype=np.float64))
        return self._descend(shift, suspects, amounts, self.columns_at(shift, suspects, amounts))

    def polish(self, state: State, rounds: int = 3) -> State:
        """Fit again from a state, with signatures of the constants taken there."""
        for _ in range(rounds):
            columns = self.columns_at(state.shift, state.suspects, state.amounts)
            better = self._descend(state.shift, state.suspects, state.amounts, columns)
            gained = state.cost - better.cost
            if gained > -1e-9:
                state = better
            if gained < max(1.0, 3e-4 * state.cost):
                break
        return state

    def _recalibrate(self, shift: Array) -> State:
        state = self.polish(self._descend(shift, (), np.empty(0), self.stated_columns), 6)
        self.columns = self.columns_at(state.shift, (), np.empty(0))
        return state

    def columns_of(self, state: State) -> Array:
        """Signatures of constants and amounts at a state, shape (rows, constants + suspects)."""
        at = (state.shift, state.suspects, state.amounts)
        return np.hstack([self.columns_at(*at), self.slopes(*at)])

    def columns_at(self, shift: Array, suspects: Sequence[Suspect], amounts: Array) -> Array:
        """Signatures of the constants, shape (rows, constants), with suspects in force."""
        active = self.found(shift, suspects, amounts)
        c = self.constants(shift)
        names, columns = constant_columns(self.model, c, active, self.data.constants)
        names += self.names[len(self.names) - self.unnamed :]
        columns = np.hstack([columns, self._unnamed_columns(c, active)])
        made = np.zeros((len(self.rows), len(self.names)))
        for j, name in enumerate(self.names):
            if name in names:
                made[:, j] = columns[:, names.index(name)]
        return np.nan_to_num(made)

    def _descend(
        self, shift: Array, suspects: Sequence[Suspect], amounts: Array, constants: Array
    ) -> State:
        n = len(self.names)
        shift = shift.copy()
        amounts = _bounded(suspects, amounts)
        residual, cost = self._at(shift, suspects, amounts)
        matrix, right = np.eye(n + len(suspects)), np.zeros(n + len(suspects))
        damping = 1e-6
        stale = True
        for _ in range(_ROUNDS):
            if stale:
                columns = np.hstack([constants, self.slopes(shift, suspects, amounts)])
                matrix, right = self.normal(columns, residual, shift)
            beta = solved(matrix, right, damping)
            new_shift = shift + beta[:n]
            new_amounts = _bounded(suspects, amounts + beta[n:])
            trial, trial_cost = self._at(new_shift, suspects, new_amounts)
            stale = trial_cost < cost
            if not stale:
                damping = max(damping, 1e-4) * 8.0
                continue
            gain = cost - trial_cost
            shift, amounts, residual, cost = new_shift, new_amounts, trial, trial_cost
            damping = damping / 10.0
            if gain < max(0.2, 1e-4 * cost):
                break
        return State(shift, tuple(suspects), amounts, residual, cost, covariance(matrix))

    def state(
        self, shift: Array, suspects: Sequence[Suspect], amounts: Array, like: State
    ) -> State:
        """Return the state at given constants and amounts, with the covariance of another."""
        amounts = _bounded(suspects, amounts)
        residual, cost = self._at(shift, suspects, amounts)
        return State(shift, tuple(suspects), amounts, residual, cost, like.cover)

    def _at(self, shift: Array, suspects: Sequence[Suspect], amounts: Array) -> tuple[Array, float]:
        residual = self.residual_at(shift, suspects, amounts)
        return residual, self.whitened(residual) + tolerance(shift)[0]

    def cost_at(self, shift: Array, suspects: Sequence[Suspect], amounts: Array) -> float:
        """Whitened sum of squares at given constants and amounts, prior included."""
        return self._at(shift, suspects, amounts)[1]

    def residual_at(self, shift: Array, suspects: Sequence[Suspect], amounts: Array) -> Array:
        """Measured minus predicted at given constants and amounts, shape (rows,)."""
        return self._residual(self.constants(shift), self.found(shift, suspects, amounts))

    def whitened(self, residual: Array) -> float:
        """Sum of squares of a residual in the noise's own measure."""
        total = 0.0
        for trial, rows in enumerate(self.noise.trial_rows):
            if len(rows):
                total += float(self.noise.solve(trial, residual[rows][:, None])[0][0, 0])
        return total

    def slopes(self, shift: Array, suspects: Sequence[Suspect], amounts: Array) -> Array:
        """Signatures of the suspects in force, at their present amounts."""
        made = np.zeros((len(self.rows), len(suspects)))
        c = self.constants(shift)
        active = self.found(shift, suspects, amounts)
        ahead = len(active) - len(suspects)
        for j, suspect in enumerate(suspects):
            there = [block for block in suspect.blocks if block in self.grid.points]
            step = max(0.3 * suspect.step, 0.02 * abs(amounts[j]))
            if suspect.id == "transport_delay":
                step = 1.0
            low = [*active]
            high = [*active]
            less = max(amounts[j] - step, 0.0) if suspect.sign else amounts[j] - step
            low[ahead + j] = (suspect.id, suspect.option, less, suspect.shape)
            high[ahead + j] = (suspect.id, suspect.option, amounts[j] + step, suspect.shape)
            a = self.model.residual(c, low, there)
            b = self.model.residual(c, high, there)
            span = high[ahead + j][2] - low[ahead + j][2]
            made[:, j] = self.model.stacked({k: (a[k] - b[k]) / span for k in there})
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

    def stated(self) -> State:
        """The plant as stated, nothing fitted: where a large effect leaves constants alone."""
        shift = np.zeros(len(self.names))
        residual, cost = self._at(shift, (), np.empty(0))
        return State(shift, (), np.empty(0), residual, cost, np.eye(len(shift)))

    def signatures(self, state: State) -> Array:
        """Columns [constants | residual | suspects] at `state`, shape (rows, columns).

        Those of the last state asked for are kept.
        """
        kept = self._signed
        if kept is not None and kept[0] is state and kept[1] == self.suspects:
            return kept[2]
        c = self.constants(state.shift)
        constants = self.columns if np.any(state.shift) else self.stated_columns
        active = self.found(state.shift, state.suspects, state.amounts)
        suspects = suspect_columns(self.model, c, active, self.suspects)
        made = np.hstack([constants, state.residual[:, None], np.nan_to_num(suspects)])
        self._signed = (state, self.suspects, made)
        return made

    def evidence(self, state: State) -> Evidence:
        """Inner products of constants, residual and all suspects at `state`."""
        columns = self.signatures(state)
        n = len(self.names)
        return gather(
            self.noise, columns[:, :n], state.residual, columns[:, n + 1 :], self.rows.block,
            self.rows.span_s, self.units, state.shift,
        )  # fmt: skip

    def schemes(self) -> dict[str, Whole]:
        """What can be held out whole: slots, and protocols and mountings with three or more."""
        made = {"slot": self.units}
        for name in ("protocol", "mounting"):
            labels = [str(getattr(trial, name)) for trial in self.data.trials]
            known = {label: k for k, label in enumerate(dict.fromkeys(labels))}
            if len(known) >= 3:
                made[name] = np.array([known[label] for label in labels], dtype=np.int64)
        return made


def _bounded(suspects: Sequence[Suspect], amounts: Array) -> Array:
    ranges = np.array([s.bounds for s in suspects]).reshape(-1, 2)
    return np.asarray(np.clip(amounts, ranges[:, 0], ranges[:, 1]))


def _given(data: DataSet) -> Active:
    """Effects that `bench.toml` states, in the suspects' terms: they are no gap."""
    made: Active = []
    for name, table in data.effects.values.items():
        entry = CATALOGUE[name]
        shape = next(s.shape for s in SUSPECTS if s.id == name)
        option = next((str(v) for v in table.values() if isinstance(v, str)), "")
        amount = float(table[entry.headline]) if entry.headline else 1.0
        if name in ("flow_area", "polytropic"):
            amount -= 1.0
        elif name == "critical_ratio":
            amount -= data.constants.critical_ratio
        made.append((name, option, amount, shape))
    return made
