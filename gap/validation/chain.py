"""The whole chain from valve commands to the muscle's pull, each stage real or modelled.

The recorded commands are replayed (never the controller): commands give flow (valve), flow gives
pressure (chamber), pressure gives pull (muscle), a hung load requires a pull (load). A stage is
modelled by the recalibrated plant; a real stage has in addition what was found in it and what its
model still leaves between measured input and measured output, so that it gives the measured output
for the measured input and answers another input as its model does. With every stage real the chain
gives the measurement; with none it runs end to end on commands and settings alone.

There is no flow meter between valve and chamber. What arises while a valve may be open is laid to
the valve, what arises while both are shut to the chamber, and what a named effect takes away to the
stage of that effect.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gap.effects.candidates import Candidate
from gap.effects.terms import Active
from gap.estimation.fit_problem import FitProblem, FitResult
from gap.model import force as laws
from gap.model import pressure as chamber
from gap.model.features import BLOCKS
from gap.model.residuals import SCALE
from plant.arrays import Array
from plant.constants import PlantConstants
from plant.effects.arguments import Points
from plant.effects.catalogue import CATALOGUE

Mask = npt.NDArray[np.bool_]

STAGES = ("valve", "chamber", "muscle", "load", "sensor")
ENDS = ("force", "load", "pressure")


@dataclass(frozen=True)
class _Gas:
    """Readings that a replay gives at every node, beside what was read there, Pa."""

    true: Array
    read: Array


class Chain:
    """Runs of the chain of one data set around a fitted state.

    Attributes:
        stages: stages that are there: gas with valve commands, muscle with force or load, load
            with a hung load whose force is read or in which something was found, sensor where a
            sensor effect was found.
        ends: trials that end in each kind of `ENDS`, shape (trials,) each. The pressure is read
            in every trial with valve commands; pull is read, or required by a hung load.
    """

    def __init__(self, problem: FitProblem, fit: FitResult) -> None:
        self.problem = problem
        self.grid = problem.grid
        self._c = problem.constants(fit.shift)
        self._stated = problem.active_effects(fit.shift, (), np.empty(0))
        self._found = list(zip(fit.candidates, fit.amounts, strict=True))
        self._full = self._active(STAGES)
        self._points = {
            name: problem.grid.points[name] for name in ENDS if name in problem.grid.points
        }
        self.ends = self._ends()
        self._learn()
        self._rests = self._leftovers()
        self.stages = self._present()

    def _active(self, real: Iterable[str]) -> Active:
        """Effects in force: those stated by the bench, and those found in real stages."""
        kept = set(real)
        made = [(s.id, s.option, float(a), s.shape) for s, a in self._found if stage_of(s) in kept]
        return [*self._stated, *made]

    def _ends(self) -> dict[str, Mask]:
        there = {name: np.diff(points.first) > 0 for name, points in self._points.items()}
        if "force" in there and "load" in there:
            there["force"] = there["force"] & ~there["load"]
        return {name: there[name] for name in ENDS if name in there and there[name].any()}

    def _present(self) -> tuple[str, ...]:
        there = set()
        if "pressure" in self._points:
            there |= {"valve", "chamber"}
        if "force" in self._points or "load" in self._points:
            there.add("muscle")
        load = self._points.get("load")
        found = {stage_of(s) for s, _ in self._found}
        if load is not None and ("load" in found or bool(np.isfinite(load.reading).any())):
            there.add("load")
        return tuple(s for s in STAGES if s in there or (s == "sensor" and s in found))

    def _learn(self) -> None:
        """What the real gas does beyond the model with all that was found, node by node."""
        points = self._points.get("pressure")
        if points is None:
            self._step = self._acting = np.empty(0)
            return
        self._step = np.zeros(len(points.reading))
        self._acting = np.zeros(len(points.reading))
        self._replayed(self._c, self._full, self._step, learn=True)

    def _replayed(
        self, c: PlantConstants, active: Active, step: Array, learn: bool = False
    ) -> Array:
        points, grid = self._points["pressure"], self.grid
        parameters = self.problem.model._parameters(c, active)
        context = self.problem.model.context(c, active)
        reading = laws.gauge_straightened(points.reading, active, context)
        length = self.problem.model.length_in_braid(points, c, active)
        out = np.empty(len(points.reading))
        acting = self._acting if learn else np.empty(len(points.reading))
        chamber.replay(
            parameters, points.first, points.time_s, np.ascontiguousarray(reading), length,
            grid.supply, grid.first_edge, grid.edge_s, grid.edge_to, grid.edge_of, out, step,
            acting, learn=learn,
        )  # fmt: skip
        out = laws.gauge_shows(out, active, context)
        return np.nan_to_num(out, nan=0.0, posinf=3e6, neginf=-1e5)

    def _instead(self, kept: frozenset[str], c: PlantConstants, active: Active) -> Array | float:
        """A simulator's prediction of the pressure beyond the built-in one, Pa.

        It does not say what its valve does and what its chamber, so each has half of it.
        """
        modelled = 1.0 - 0.5 * len(kept & {"valve", "chamber"})
        nominal = self.problem.model.nominal
        if nominal is None or not modelled:
            return 0.0
        shift = nominal.shift(active)
        return modelled * self.problem.model.instead("pressure", c, shift)

    def _gas(self, real: frozenset[str], c: PlantConstants, active: Active) -> _Gas | None:
        points = self._points.get("pressure")
        if points is None:
            return None
        step = np.where(
            self._acting > 0.5,
            self._step if "valve" in real else 0.0,
            self._step if "chamber" in real else 0.0,
        )
        return _Gas(
            self._replayed(c, active, step) + self._instead(real, c, active), points.reading
        )

    def _fed(self, block: str, gas: _Gas | None) -> Points:
        """Points of a block fed with the replayed pressure instead of the measured one."""
        points = self._points[block]
        if gas is None:
            return points
        nodes = self._points["pressure"]
        moved = np.zeros(len(points.reading))
        slope = np.zeros(len(points.reading))
        off = gas.true - gas.read
        for t in range(len(points.first) - 1):
            a, b = points.first[t : t + 2]
            c, d = nodes.first[t : t + 2]
            if b > a and d > c:
                moved[a:b] = np.interp(points.time_s[a:b], nodes.time_s[c:d], off[c:d])
                if b - a > 2:
                    slope[a:b] = np.gradient(moved[a:b], points.time_s[a:b])
        return dataclasses.replace(
            points, pressure=points.pressure + moved, path=points.path + moved,
            pressure_slope=points.pressure_slope + slope,
        )  # fmt: skip

    def _leftovers(self) -> dict[str, tuple[Array, Array]]:
        """What muscle and load still leave between measured input and output, one a point."""
        made: dict[str, tuple[Array, Array]] = {}
        problem, c, active = self.problem, self._c, self._full
        points = self._points.get("force")
        if points is not None:
            rest = problem.model._force(points, c, active)
            made["force"] = (rest, np.zeros(len(rest)))
        points = self._points.get("load")
        if points is not None:
            required, pull = self._pulls(points, c, active)
            read = laws.force_true(points.reading, active, problem.model.context(c, active))
            there = np.isfinite(read)
            made["load"] = (
                np.where(there, read, required) - pull, np.where(there, required - read, 0.0),
            )  # fmt: skip
        return made

    def _pulls(self, points: Points, c: PlantConstants, active: Active) -> tuple[Array, Array]:
        model = self.problem.model
        required = laws.load_pull(points, active, model.context(c, active))
        return required, model.pull("load", points, c, active)

    def run(self, real: Iterable[str]) -> dict[str, Array]:
        """Measured minus predicted at the chain's ends, by kind of end, one a feature row.

        Stages in `real` are real, all others modelled. Rows are those of the block of the end's
        name; trials that do not end in it are zero.
        """
        kept = frozenset(real)
        return self._run(kept, self._active(kept), self._c)

    def _run(self, kept: frozenset[str], active: Active, c: PlantConstants) -> dict[str, Array]:
        gas = self._gas(kept, c, active)
        made: dict[str, Array] = {}
        for name, ending in self.ends.items():
            if name == "pressure":
                assert gas is not None
                raw, points = gas.read - gas.true, self._points[name]
            else:
                points = self._fed(name, gas)
                raw = self._missing(name, points, c, active, kept)
            raw = np.where(ending[points.trial], raw, 0.0)
            rows = self.problem.model._features(points, np.nan_to_num(raw)) * SCALE[name]
            made[name] = np.clip(rows, -3e3, 3e3)
        return made

    def free(self, shift: Array, amounts: Array | None) -> dict[str, Array]:
        """Measured minus predicted at the ends with every stage modelled, nothing measured fed in.

        Args:
            shift: constants in sd.
            amounts: of the candidates of the fit, all in force; None for the plant without them.
        """
        found = self._found
        kept: tuple[str, ...] = ()
        if amounts is not None:
            kept = STAGES
            self._found = [(s, float(a)) for (s, _), a in zip(found, amounts, strict=True)]
        try:
            return self._run(frozenset(), self._active(kept), self.problem.constants(shift))
        finally:
            self._found = found

    def _missing(
        self, name: str, points: Points, c: PlantConstants, active: Active, real: frozenset[str]
    ) -> Array:
        muscle, load = self._rests[name]
        if name == "force":
            raw = self.problem.model._force(points, c, active)
        else:
            required, pull = self._pulls(points, c, active)
            raw = required - pull
        raw = raw - (muscle if "muscle" in real else 0.0)
        return np.asarray(raw - (load if "load" in real else 0.0))

    def rows_of(self, name: str) -> npt.NDArray[np.int64]:
        """Indices of all rows of a kind of end that belong to trials which end in it."""
        rows = self.problem.rows
        at = np.flatnonzero(rows.block == BLOCKS.index(name))
        return at[self.ends[name][rows.trial[at]]]

    def of_rows(self, name: str, values: Array) -> Array:
        """The values of `run` that belong to `rows_of(name)`."""
        at = np.flatnonzero(self.problem.rows.block == BLOCKS.index(name))
        return np.asarray(values[self.ends[name][self.problem.rows.trial[at]]])


def stage_of(candidate: Candidate) -> str:
    """Stage of a candidate; what may sit anywhere, and shows in the force, counts to the muscle."""
    if candidate.defect:
        return "sensor"
    stage = CATALOGUE[candidate.id].stage
    return "muscle" if stage == "any" else stage
