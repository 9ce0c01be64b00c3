"""Residual features of a data set under any constants and effects: the one function all use."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from gap.effects.candidates import Shape
from gap.model import force as laws
from gap.model import pressure as chamber
from gap.model.features import BLOCKS, Points
from gap.model.force import Active, Context
from gap.model.grid import Grid
from plant.constants import KEYS, PlantConstants

Array = npt.NDArray[np.float64]

SCALE = {"pressure": 1e-3, "force": 1.0, "load": 1.0, "camera": 1e3}
FOLLOW_S = 5.0

_DELAYS = (
    ("inlet_on_s", "inlet_on_s_per_pa"), ("inlet_off_s", "inlet_off_s_per_pa"),
    ("outlet_on_s", "outlet_on_s_per_pa"), ("outlet_off_s", "outlet_off_s_per_pa"),
)  # fmt: skip
_EDGE = {"inlet_on": 0, "inlet_off": 1, "outlet_on": 2, "outlet_off": 3}


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
        return np.asarray(total / np.bincount(points.row, weights=points.weight))

    def _rest(self, points: Points, active: Active, context: Context) -> Array:
        """What the last tare took away from each reading, N."""
        return laws.rest_pull(points, self.tared[points.trial], active, context)

    def _force(self, points: Points, c: PlantConstants, active: Active) -> Array:
        context = Context(c, self.order)
        pull = laws.muscle_force(points, active, context) - self._rest(points, active, context)
        force = laws.force_read(pull, points, active)
        for name, _, amount, _shape in active:
            if name == "force_clock":
                force = laws.moved(points, force, -amount * 1e-3)
            elif name == "force_smoothed":
                force = force + 0.5 * amount * 1e-3 * _bend(points, force)
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
        shown = true
        for name, _, amount, shape in active:
            if name in laws.CAMERA_MAPS:
                shown = shown + laws.read_minus_true(name, amount, shape, true, c)
        return points.reading - shown

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
        raw = points.reading - out
        for name, _, amount, _shape in active:
            if name == "pressure_smoothed":
                raw = raw - 0.5 * amount * 1e-3 * _bend(points, out)
        return np.asarray(np.clip(raw, -3e6, 3e6))

    def _parameters(self, c: PlantConstants, active: Active) -> Array:
        q = np.zeros(chamber.SIZE)
        q[chamber.ATMOSPHERE] = c.atmosphere_pa
        q[chamber.TEMPERATURE] = c.gas_temperature_k
        q[chamber.BRAID] = c.braid_length_m
        q[chamber.TURNS] = c.turns
        q[chamber.AREA_IN] = c.inlet_conductance_m3_s_pa
        q[chamber.AREA_OUT] = c.outlet_conductance_m3_s_pa
        q[chamber.RATIO_IN] = q[chamber.RATIO_OUT] = c.critical_ratio
        q[chamber.VOLUME] = c.dead_volume_m3
        q[chamber.EXPONENT] = c.polytropic_exponent
        q[chamber.SUPPLY_SHIFT] = c.supply_pa - self.grid.data.constants.supply_pa
        q[chamber.TRANSPORT] = 1.0 if c.delay_mode == "transport" else 0.0
        q[chamber.FOLLOW] = FOLLOW_S
        for i, (at, slope) in enumerate(_DELAYS):
            q[chamber.DELAY + i] = getattr(c, at)
            q[chamber.DELAY_SLOPE + i] = getattr(c, slope)
        for name, option, amount, shape in active:
            _switch(q, name, option, amount, shape)
        q[chamber.RATIO_IN] = min(max(q[chamber.RATIO_IN], 0.0), 0.95)
        q[chamber.RATIO_OUT] = min(max(q[chamber.RATIO_OUT], 0.0), 0.95)
        return q


def _switch(q: Array, name: str, option: str, amount: float, shape: Shape) -> None:  # noqa: C901 - one case for each stage
    """Put one effect into the parameters of the pressure stage; others leave it alone."""
    if name == "dead_volume":
        if "elastic" in shape:
            # Stated as the extra volume that 300 kPa makes.
            q[chamber.ELASTIC] += amount * 1e-6 / 3e5
        elif "line_s" in shape:
            q[chamber.LINE] = max(amount, 0.0) * 1e-6
            q[chamber.LINE_TIME] = shape["line_s"]
        else:
            q[chamber.VOLUME] += amount * 1e-6
    elif name == "polytropic":
        q[chamber.EXPONENT] += amount
        q[chamber.HEAT_RATE] = 1.0 / shape["heat_s"] if "heat_s" in shape else 0.0
    elif name == "leak":
        q[chamber.LEAK_LAMINAR if "laminar" in shape else chamber.LEAK] += amount
    elif name == "flow_area":
        inlet = option == "inlet"
        if "drop" in shape:
            q[chamber.AREA_DROP_IN if inlet else chamber.AREA_DROP_OUT] += amount
        else:
            q[chamber.AREA_IN if inlet else chamber.AREA_OUT] *= max(1.0 + amount, 0.02)
    elif name == "critical_ratio":
        if "outlet" not in shape:
            q[chamber.RATIO_IN] += amount
        if "inlet" not in shape:
            q[chamber.RATIO_OUT] += amount
    elif name == "supply_droop":
        q[chamber.DROOP] = amount * 1e3
        q[chamber.DROOP_TIME] = shape.get("tau_s", 0.0)
        q[chamber.DROOP_BACK] = shape.get("back_s", 0.0)
    elif name == "valve_delay":
        q[chamber.DELAY + _EDGE[option]] += amount * 1e-3
    elif name == "valve_delay_pressure":
        q[chamber.DELAY_SLOPE + _EDGE[option]] += amount * 1e-6
    elif name == "transport_delay":
        q[chamber.TRANSPORT] = 1.0 if amount > 0.5 else 0.0
    elif name == "pressure_zero":
        q[chamber.ZERO] = amount * 1e3
    elif name == "pressure_gain":
        q[chamber.GAIN] = amount * 1e-2
    elif name == "pressure_lag":
        # A tube before the sensor is a lag of its own; the headline is the two together.
        before = shape.get("before", 0.0)
        q[chamber.LAG] = (1.0 - before) * max(amount, 0.0) * 1e-3
        q[chamber.LAG_BEFORE] = before * max(amount, 0.0) * 1e-3
    elif name == "pressure_clock":
        q[chamber.CLOCK] = amount * 1e-3


def _slope(points: Points, values: Array) -> Array:
    """Time derivative trial by trial; settled points have none."""
    made = np.zeros(len(values))
    for a, b in zip(points.first[:-1], points.first[1:], strict=True):
        if b - a > 2 and not points.settled[a]:
            made[a:b] = np.gradient(values[a:b], points.time_s[a:b])
    return made


def _bend(points: Points, values: Array) -> Array:
    return _slope(points, _slope(points, values))


def shifted(c: PlantConstants, key: str, amount_si: float) -> PlantConstants:
    """Return constants with one plant-file key moved by `amount_si`."""
    field_name = KEYS[key].field
    return dataclasses.replace(c, **{field_name: getattr(c, field_name) + amount_si})
