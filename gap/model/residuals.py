"""Residual features of a data set under any constants and effects: the one function all use."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable
from dataclasses import InitVar, dataclass, field, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from gap.effects.terms import Active, acting_in, terms
from gap.model import force as laws
from gap.model import pressure as chamber
from gap.model.empirical import Flow, correction_at, flow_at, in_load
from gap.model.features import BLOCKS
from gap.model.grid import Grid, full_values, room_temperature, trial_order
from gap.model.nominal import NominalPlant
from gap.model.threads import each
from plant.arrays import Array
from plant.constants import KEYS, STANDARD_GRAVITY_M_S2, PlantConstants
from plant.effects import pressure_stage
from plant.effects.arguments import Context, Points
from plant.effects.empirical import Correction

SCALE = {"pressure": 1e-3, "force": 1.0, "load": 1.0, "camera": 1e3}
_KEPT_BYTES = 64 << 20
"""Predictions that a model keeps."""
_NUMBERS = tuple(f.name for f in dataclasses.fields(PlantConstants) if f.name != "tolerances")
T = TypeVar("T")
R = TypeVar("R")


@dataclass
class Model:
    """Measured minus predicted, reduced to feature rows, in kPa, N and mm.

    Args:
        grid: points and rows of a data set.
        around: parameters of the data set's simulator, in sd, at which it is made linear.
        like: a model of the same plant on other data, whose `around` and error of the law hold.

    Attributes:
        nominal: the data set's simulator on these points; None for the built-in plant.
        order: of the trials, from 0; all zero where it is not known.
        tared: length in m at which the force of each trial was set to zero.
    """

    grid: Grid
    around: InitVar[Array | None] = None
    like: InitVar[Model | None] = None
    nominal: NominalPlant | None = field(init=False, default=None)
    order: Array = field(init=False)
    _plain_context: Context = field(init=False)
    tared: Array = field(init=False)
    _plain: dict[str, tuple[PlantConstants, Array]] = field(init=False, default_factory=dict)
    _corrections: dict[str, Array] = field(init=False, default_factory=dict)
    _kept: dict[tuple[Any, ...], Array] = field(init=False, default_factory=dict, repr=False)

    def __post_init__(self, around: Array | None, like: Model | None) -> None:
        simulator = self.grid.data.simulator
        if simulator is not None:
            known = like.nominal if like is not None else None
            if around is None and known is not None:
                around = known.around
            self.nominal = NominalPlant(
                simulator, self.grid.data, self.grid.points, around,
                known.error if known is not None else None,
            )  # fmt: skip
        self.order = trial_order(self.grid.data)
        data = self.grid.data
        self._plain_context = Context(
            data.constants, self.order, None, room_temperature(data), *full_values(data)
        )
        tared_mm = [trial.tare_length_mm for trial in self.grid.data.trials]
        self.tared = 1e-3 * np.array(tared_mm, dtype=np.float64)

    def residual(
        self, constants: PlantConstants, active: Active, blocks: Iterable[str] = BLOCKS
    ) -> dict[str, Array]:
        """Feature rows by block, measured minus predicted; only the blocks asked for."""
        made: dict[str, Array] = {}
        for block in blocks:
            points = self.grid.points.get(block)
            if points is not None:
                made[block] = self._kept_rows(block, points, constants, active)
        return made

    def _kept_rows(self, block: str, points: Points, c: PlantConstants, active: Active) -> Array:
        """Rows of one block; the last are kept, as steps of a search start where others end."""
        acting = tuple(
            (name, option, amount, *sorted(shape.items()))
            for name, option, amount, shape in acting_in(block, active)
        )
        key = (block, tuple(vars(c)[name] for name in _NUMBERS), acting)
        found = self._kept.get(key)
        if found is None:
            raw = getattr(self, f"_{block}")(points, c, active)
            found = self._features(points, raw) * SCALE[block] - self._corrected(block)
            found.flags.writeable = False
            while (len(self._kept) + 1) * 8 * len(self.grid.rows) > _KEPT_BYTES and self._kept:
                self._kept.pop(next(iter(self._kept), key), None)
            self._kept[key] = found
        return found

    def _corrected(self, block: str) -> Array | float:
        """What the data set's empirical term adds to the prediction of a block, one value a row."""
        stated = self.grid.data.corrections.of
        if block not in stated and not (block == "load" and "force" in stated):
            return 0.0
        if block not in self._corrections:
            c = self.grid.data.constants
            correction = stated.get(block, Correction(block, ()))
            made = correction_at(self.grid, correction, c)
            flow = flow_at(self.grid, correction, c) if self.covers(block) else None
            if flow is not None:  # no chamber of ours to put it into
                made = made + flow.raised(self.grid, c)
            if block == "load" and "force" in stated:
                made = made + in_load(self.grid, stated["force"], c)
            self._corrections[block] = made
        return self._corrections[block]

    @cached_property
    def _corrected_push(self) -> chamber.Push | None:
        """What the data set's empirical term adds to the gas of the chamber."""
        correction = self.grid.data.corrections.of.get("pressure")
        if correction is None or self.covers("pressure"):
            return None
        c = self.grid.data.constants
        flow = flow_at(self.grid, correction, c)
        return None if flow is None else flow.push(self.grid, c)

    def pressure_with_flow(self, flow: Flow, c: PlantConstants, active: Active) -> Array:
        """Rows of the pressure, measured minus predicted, with a flow into the chamber.

        Where a simulator from elsewhere predicts the pressure, the flow adds to it in proportion.
        """
        points = self.grid.points["pressure"]
        if self.covers("pressure"):
            raw = self._pressure(points, c, active)
            rows = self._features(points, raw) * SCALE["pressure"]
            return rows - self._corrected("pressure") - flow.raised(self.grid, c)
        raw = self._pressure(points, c, active, flow.push(self.grid, c))
        return self._features(points, raw) * SCALE["pressure"] - self._corrected("pressure")

    def each(self, make: Callable[[T], R], items: Iterable[T]) -> list[R]:
        """`make` of each item, on several threads where the model has no code of others in it."""
        return each(make, items) if self.nominal is None else [make(item) for item in items]

    def largest_fall_pa(self, c: PlantConstants, active: Active) -> float:
        """Largest fall of the supply in a prediction of pressure; 0 where none is predicted."""
        points = self.grid.points.get("pressure")
        return 0.0 if points is None else self._built_in_pressure(points, c, active)[1]

    def readings(self, block: str) -> Array | None:
        """What was read, one value a row of a block, in its unit; None without a reading."""
        points = self.grid.points.get(block)
        if points is None or not np.isfinite(points.reading).all():
            return None
        return self._features(points, points.reading) * SCALE[block]

    def stacked(self, parts: dict[str, Array]) -> Array:
        """All rows in one vector; blocks that are absent in `parts` are zero."""
        whole = np.zeros(len(self.grid.rows))
        for block, values in parts.items():
            at = self.grid.offset[block]
            whole[at : at + len(values)] = values
        return whole

    def _features(self, points: Points, raw: Array) -> Array:
        start = points.row_start
        if start is None:
            total = np.bincount(points.row, weights=raw * points.weight)
        else:
            total = np.add.reduceat(raw * points.weight, start)
        return np.asarray(total / points.row_weight)

    def _means(self, points: Points, columns: Array) -> Array:
        """Means over each row of columns at the points, shape (rows of the block, columns)."""
        return np.stack([self._features(points, x) for x in columns.T], axis=1)

    def _rest(self, points: Points, active: Active, context: Context) -> Array:
        """What the last tare took away from each reading, N."""
        return laws.rest_pull(points, self.tared[points.trial], active, context)

    def context(self, c: PlantConstants, active: Active) -> Context:
        """What forces need beside the points, with the force law that holds."""
        if self.nominal is None:
            return replace(self._plain_context, constants=c)
        law = self.nominal.law(self.nominal.shift(active))
        return replace(self._plain_context, constants=c, law=law)

    def error_columns(self, c: PlantConstants, active: Active) -> Array | None:
        """What one sd of each term of the law's error adds to the readings, shape (rows, terms).

        An error of the pull adds to a reading in proportion, so two predictions tell of all terms.
        None where a recording is smoothed or late: a reading then takes from its neighbours.
        """
        nominal = self.nominal
        count = nominal.error.count if nominal is not None and nominal.error is not None else 0
        if any(term.diagnosis.force_shown is not None for term in terms(active)):
            return None
        columns = np.zeros((len(self.grid.rows), count))
        for block, of in (("force", self._force), ("load", self._load)):
            points = self.grid.points.get(block)
            added = nominal.error_terms(block) if nominal is not None else None
            if points is None or added is None:
                continue
            shown = of(points, c, active) - of(points, c, active, more_n=1.0)
            rows = self._means(points, shown[:, None] * added) * SCALE[block]
            at = self.grid.offset[block]
            columns[at : at + len(rows)] = rows
        return columns

    def pull(
        self, block: str, points: Points, c: PlantConstants, active: Active, more_n: float = 0.0
    ) -> Array:
        """True pull of the muscle in N at the points of a block, whatever they are fed with.

        With `more_n` added to it.
        """
        pull = laws.muscle_force(points, active, self.context(c, active)) + more_n
        if self.nominal is None:
            return pull
        shift = self.nominal.shift(active)
        error = self.nominal.beyond(block, shift)
        if error is not None:
            pull = pull + error
        return pull + self.instead(block, c, shift)

    def covers(self, block: str) -> bool:
        """Whether a simulator from elsewhere predicts a block."""
        return self.nominal is not None and self.nominal.covers(block)

    def instead(self, block: str, c: PlantConstants, shift: Array) -> Array | float:
        """A simulator's prediction beyond that of the built-in plant, on measured inputs: N or Pa.

        Zero where no simulator with memory predicts the block.
        """
        assert self.nominal is not None
        predicted = self.nominal.predicted(block, shift)
        if predicted is None:
            return 0.0
        kept = self._plain.get(block)
        if kept is None or kept[0] != c:
            points = self.grid.points[block]
            if block == "pressure":
                plain, _ = self._built_in_pressure(points, c, [])
            else:
                plain = laws.muscle_force(points, [], replace(self._plain_context, constants=c))
            kept = self._plain[block] = (c, plain)
        return predicted - kept[1]

    def _force(
        self, points: Points, c: PlantConstants, active: Active, more_n: float = 0.0
    ) -> Array:
        context = self.context(c, active)
        pull = self.pull("force", points, c, active, more_n) - self._rest(points, active, context)
        force = laws.force_read(pull, active, context)
        for term in terms(active):
            if term.diagnosis.force_shown is not None:
                force = term.diagnosis.force_shown(force, points, term.amount)
        return points.reading - force

    def _load(
        self, points: Points, c: PlantConstants, active: Active, more_n: float = 0.0
    ) -> Array:
        context = self.context(c, active)
        asked = laws.load_pull(points, active, context)
        given = laws.force_true(points.reading, active, context)
        given = given + self._rest(points, active, context)
        without = np.isnan(given)
        if without.any():
            given = np.where(without, self.pull("load", points, c, active, more_n), given)
        missing = asked - given
        least, most = laws.drag_slack(points, active)
        # A load at rest may be held by anything up to its friction: zeros and noise of the forces
        # are no part of it.
        small = _HOLDS_NOTHING * points.mass * STANDARD_GRAVITY_M_S2
        holds = ~without & (np.abs(missing) > small)
        return missing - np.where(holds, np.clip(missing, least, most), 0.0)

    def _camera(self, points: Points, c: PlantConstants, active: Active) -> Array:
        true = laws.true_length(points, active, c)
        return points.reading - (true + laws.read_minus_true(active, true, c))

    def _pressure(
        self, points: Points, c: PlantConstants, active: Active, push: chamber.Push | None = None
    ) -> Array:
        if self.covers("pressure"):
            out = self._simulated_pressure(points, c, active)
        else:
            out, _ = self._built_in_pressure(points, c, active, push)
        for term in terms(active):
            if term.diagnosis.pressure_shown is not None:
                out = term.diagnosis.pressure_shown(out, points, term.amount)
        if points.clipped.any():  # what is below the end of the gauge reads as that end
            out = np.where(points.clipped, np.maximum(out, points.reading), out)
        return np.asarray(np.clip(points.reading - out, -3e6, 3e6))

    def _simulated_pressure(self, points: Points, c: PlantConstants, active: Active) -> Array:
        """Prediction of a simulator with memory, with what the effects do to it, Pa.

        The gas does what the built-in chamber's would along that path. The gauge's own error is in
        the pressure that the simulator was started from.
        """
        assert self.nominal is not None
        q, plain = self._parameters(c, active), self._parameters(c, [])
        zero, gain = float(q[pressure_stage.ZERO]), float(q[pressure_stage.GAIN])
        damping = float(q[pressure_stage.LAG_DAMPING])
        lags = (
            (float(q[pressure_stage.LAG]), float(q[pressure_stage.LAG_WITH_PRESSURE]), damping),
            (float(q[pressure_stage.LAG_BEFORE]), 0.0, 0.0),
        )
        q[[getattr(pressure_stage, of) for of in ("ZERO", "GAIN", "LAG", "LAG_BEFORE")]] = 0.0
        path = self.nominal.pressure_from(self.nominal.shift(active), zero, gain)
        context = replace(self._plain_context, constants=c)
        length = self.length_in_braid(points, c, active)
        stated = self.length_in_braid(points, c, [])
        if not (np.array_equal(plain, q) and np.array_equal(stated, length)):
            grid = self.grid
            path = chamber.perturbed(
                (plain, stated), (q, length), path, points.first, points.time_s,
                grid.supply, grid.first_edge, grid.edge_s, grid.edge_to, grid.edge_of,
            )  # fmt: skip
        for lag_s, power, swings in lags:
            if lag_s > 0.0:
                path = chamber.behind_lag(
                    points.first, points.time_s, path, lag_s, power, c.atmosphere_pa, swings
                )
        return laws.gauge_shows(path * (1.0 + gain) + zero, active, context)

    def length_in_braid(self, points: Points, c: PlantConstants, active: Active) -> Array:
        """True length in m, within what the chamber's volume is defined for."""
        true = laws.true_length(points, active, c)
        return np.ascontiguousarray(np.clip(true, 1e-4, 0.999 * c.braid_length_m))

    def _built_in_pressure(
        self, points: Points, c: PlantConstants, active: Active, push: chamber.Push | None = None
    ) -> tuple[Array, float]:
        """Prediction of the built-in chamber, Pa, before what smooths a reading.

        With the largest fall of the supply, Pa. `push` is what is added from point to point.
        """
        corrected = self._corrected_push
        if corrected is not None:
            push = corrected if push is None else push + corrected
        grid = self.grid
        q = self._parameters(c, active)
        length = self.length_in_braid(points, c, active)
        supply = grid.supply
        out = np.empty(len(points.reading))
        fall = np.zeros(1)
        context = replace(self._plain_context, constants=c)
        straight = laws.gauge_straightened(points.known_reading, active, context)
        reading = np.ascontiguousarray(straight)
        chamber.predict(
            q, points.first, points.time_s, reading, length, supply, grid.first_edge,
            grid.edge_s, grid.edge_to, grid.edge_of, out, fall, push=push,
        )  # fmt: skip
        return laws.gauge_shows(out, active, context), float(fall[0])

    def _parameters(self, c: PlantConstants, active: Active) -> Array:
        data = self.grid.data
        return chamber.parameters(c, active, data.constants.supply_pa, len(data.trials))


_HOLDS_NOTHING = 0.05
"""Share of a load's weight up to which what is missing is not for friction to hold. No other value
was tried."""


def shifted(c: PlantConstants, key: str, amount_si: float) -> PlantConstants:
    """Return constants with one plant-file key moved by `amount_si`."""
    field_name = KEYS[key].field
    return dataclasses.replace(c, **{field_name: getattr(c, field_name) + amount_si})
