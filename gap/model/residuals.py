"""Residual features of a data set under any constants and effects: the one function all use."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from gap.effects.terms import Active, terms
from gap.model import force as laws
from gap.model import pressure as chamber
from gap.model.features import BLOCKS
from gap.model.grid import Grid
from plant.arrays import Array
from plant.constants import KEYS, PlantConstants
from plant.effects.arguments import Context, Points

SCALE = {"pressure": 1e-3, "force": 1.0, "load": 1.0, "camera": 1e3}


@dataclass
class Model:
    """Measured minus predicted, reduced to feature rows, in kPa, N and mm."""

    grid: Grid
    order: Array = field(init=False)
    tared: Array = field(init=False)
    fall_pa: float = 0.0

    def __post_init__(self) -> None:
        order = np.array([trial.order for trial in self.grid.data.trials], dtype=np.float64)
        self.order = order - order.min() if len(order) else order
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
                raw = getattr(self, f"_{block}")(points, constants, active)
                made[block] = self._features(points, raw) * SCALE[block]
        return made

    def stacked(self, parts: dict[str, Array]) -> Array:
        """All rows in one vector; blocks that are absent in `parts` are zero."""
        whole = np.zeros(len(self.grid.rows))
        for block, values in parts.items():
            at = self.grid.offset[block]
            whole[at : at + len(values)] = values
        return whole

    def _features(self, points: Points, raw: Array) -> Array:
        total = np.bincount(points.row, weights=raw * points.weight)
        return np.asarray(total / points.row_weight)

    def _rest(self, points: Points, active: Active, context: Context) -> Array:
        """What the last tare took away from each reading, N."""
        return laws.rest_pull(points, self.tared[points.trial], active, context)

    def _force(self, points: Points, c: PlantConstants, active: Active) -> Array:
        context = Context(c, self.order)
        pull = laws.muscle_force(points, active, context) - self._rest(points, active, context)
        force = laws.force_read(pull, active)
        for term in terms(active):
            if term.diagnosis.force_shown is not None:
                force = term.diagnosis.force_shown(force, points, term.amount)
        return points.reading - force

    def _load(self, points: Points, c: PlantConstants, active: Active) -> Array:
        context = Context(c, self.order)
        asked = laws.load_pull(points, active, context)
        given = laws.force_true(points.reading, active) + self._rest(points, active, context)
        without = np.isnan(given)
        if without.any():
            given = np.where(without, laws.muscle_force(points, active, context), given)
        return asked - given

    def _camera(self, points: Points, c: PlantConstants, active: Active) -> Array:
        true = laws.true_length(points, active, c)
        return points.reading - (true + laws.read_minus_true(active, true, c))

    def _pressure(self, points: Points, c: PlantConstants, active: Active) -> Array:
        grid = self.grid
        q = self._parameters(c, active)
        true = laws.true_length(points, active, c)
        length = np.ascontiguousarray(np.clip(true, 1e-4, 0.999 * c.braid_length_m))
        supply = grid.supply
        out = np.empty(len(points.reading))
        fall = np.zeros(1)
        reading = np.ascontiguousarray(points.reading)
        chamber.predict(
            q, points.first, points.time_s, reading, length, supply, grid.first_edge,
            grid.edge_s, grid.edge_to, grid.edge_of, out, fall,
        )  # fmt: skip
        self.fall_pa = float(fall[0])
        for term in terms(active):
            if term.diagnosis.pressure_shown is not None:
                out = term.diagnosis.pressure_shown(out, points, term.amount)
        return np.asarray(np.clip(points.reading - out, -3e6, 3e6))

    def _parameters(self, c: PlantConstants, active: Active) -> Array:
        return chamber.parameters(c, active, self.grid.data.constants.supply_pa)


def shifted(c: PlantConstants, key: str, amount_si: float) -> PlantConstants:
    """Return constants with one plant-file key moved by `amount_si`."""
    field_name = KEYS[key].field
    return dataclasses.replace(c, **{field_name: getattr(c, field_name) + amount_si})
