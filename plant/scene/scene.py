"""Simulation of a whole bench: muscles or cylinders with their valves, and the moved mechanism.

    hung = Scene([Unit("muscle", nominal(), reach={"load": 1.0})],
                 [Coordinate("load", mass_kg=3.0, pull=3.0 * 9.80665, low=0.051, high=0.0725,
                             stop_stiffness=20e3, start=0.066)])
    hung.advance(1e-3, [1e-3], [0.0])

The lengths of the units depend on the coordinates: L = rest + sum of reach * q. With an arm of
`plant.links`, its joints are the coordinates. Otherwise each coordinate is a separate mass (or
inertia). Without coordinates all lengths are constant.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from plant.arrays import Array
from plant.constants import PlantConstants
from plant.effects.effects import NONE, Effects
from plant.errors import PlantError
from plant.links.arm import Arm
from plant.links.layout import WORK
from plant.models.model import Model
from plant.physics import layout as at
from plant.scene import layout as sc
from plant.scene.model_table import ModelTable, model_table
from plant.simulator.bench import STEP_MAX_S, STEP_SAFETY, Source, build_params, build_state

LOAD_SAFETY = 0.15
"""Substep times the highest angular frequency of the mechanism."""
DAMPING_SAFETY = 1.5
"""Substep times the fastest damping rate of the mechanism."""
JOINT_STOP_N_M_RAD = 5.0
JOINT_STOP_N_M_S_RAD = 1e-3
LOG_ROWS = 4096


@dataclass(frozen=True)
class Piston:
    """The piston of a cylinder, which replaces a muscle."""

    area_m2: float


@dataclass(frozen=True)
class Unit:
    """A muscle or cylinder with its valve block.

    Attributes:
        name: for messages and records.
        constants: valve, gas and braid.
        model: None for the braid of `constants` with `effects`; a force law; or a piston.
        reach: dL/dq for each coordinate, m per m or m per rad: -r for a muscle that shortens when a
            joint rotates a pulley of radius r.
        rest_m: length with all coordinates at zero.
        tendon: the unit pulls through a tendon and cannot push.
        pressure_pa: initial gauge pressure.
    """

    name: str
    constants: PlantConstants
    effects: Effects = NONE
    model: Model | Piston | None = None
    source: Source = "valve"
    reach: Mapping[str, float] = field(default_factory=dict)
    rest_m: float = 0.0
    tendon: bool = False
    pressure_pa: float = 0.0
    temperature_c: float = 21.0


@dataclass(frozen=True)
class Coordinate:
    """One coordinate of the mechanism; SI, metres or radians.

    With an arm, `mass` is not used (the links have masses), and the joint's range is taken from the
    arm if `low` and `high` are not given.
    """

    name: str
    mass: float = 0.0
    pull: float = 0.0
    damping: float = 0.0
    spring: float = 0.0
    spring_rest: float = 0.0
    low: float = -math.inf
    high: float = math.inf
    stop_stiffness: float = 0.0
    stop_damping: float = 0.0
    coulomb: float = 0.0
    start: float = 0.0
    start_rate: float = 0.0


@dataclass(frozen=True)
class Switch:
    """A proximity switch: on within `reach` of position `at`, off beyond `reach` + `gap`."""

    coordinate: str
    at: float
    reach: float = 2e-3
    gap: float = 0.5e-3


@dataclass(frozen=True)
class Event:
    """An event with its exact time; `kind` is one of `LOG_WORDS`."""

    time_s: float
    kind: str
    which: str
    value: float


class Scene:
    """A scene, simulated tick by tick or from a recording of commands.

    Attributes:
        world: the arrays of the kernel; `units[k]` is the state of unit k in the layout of
            `plant.physics.layout`, `motion` has positions and rates of the coordinates.

    Raises:
        PlantError: names the unit or coordinate, the expected and the given value.
    """

    def __init__(
        self,
        units: Sequence[Unit],
        coordinates: Sequence[Coordinate] = (),
        arm: Arm | None = None,
        switches: Sequence[Switch] = (),
        step_share: float = 1.0,
        load_safety: float = LOAD_SAFETY,
    ) -> None:
        if not units:
            raise PlantError("a scene needs at least one muscle or cylinder")
        self.units = tuple(units)
        self.coordinates = _joined(coordinates, arm)
        self.arm = arm
        self.switches = tuple(switches)
        names = [u.name for u in self.units] + [c.name for c in self.coordinates]
        twice = sorted({n for n in names if names.count(n) > 1})
        if twice:
            raise PlantError(f"scene: more than one part has the name {twice[0]!r}")
        for c in self.coordinates:
            _check_coordinate(c, arm is not None)
        self.tables: dict[str, ModelTable] = {}
        self.world = self._arrays(step_share, load_safety)
        self._place()

    # ---- building -------------------------------------------------------------------

    def _arrays(self, step_share: float, load_safety: float) -> sc.World:
        m, n = len(self.units), len(self.coordinates)
        kinds, shape = np.zeros(m, np.int64), np.zeros((m, sc.SHAPE_SIZE))
        state, params = np.zeros((m, at.STATE_SIZE)), np.zeros((m, at.PARAMS_SIZE))
        reach = np.zeros((m, n + 1))
        tables: list[ModelTable] = []
        for k, unit in enumerate(self.units):
            unit.constants.check_plain("a scene")
            params[k] = build_params(unit.constants, unit.effects, unit.source)
            params[k, at.STEP_MAX] = STEP_MAX_S * step_share
            params[k, at.STEP_SAFETY] = STEP_SAFETY * step_share
            reach[k] = self._reach(unit)
            loose = unit.tendon or (isinstance(unit.model, Model) and unit.model.pulls_only)
            shape[k, sc.PULLS_ONLY] = 1.0 if loose else 0.0
            if isinstance(unit.model, Piston):
                kinds[k], shape[k, sc.AREA] = sc.CYLINDER, unit.model.area_m2
            elif unit.model is not None:
                table = model_table(unit.model, unit.constants, unit.temperature_c)
                kinds[k] = sc.TABLE
                keep = shape[k, : sc.MEMORY_KIND].copy()
                shape[k] = table.memory
                shape[k, : sc.MEMORY_KIND] = keep
                shape[k, sc.TABLE_ROW] = len(tables)
                tables.append(table)
                self.tables[unit.name] = table
            middle = 0.5 * (unit.constants.length_min_m + unit.constants.length_max_m)
            state[k] = build_state(unit.constants, middle)
            state[k, at.PRESSURE] = unit.pressure_pa
        coords, motion = np.zeros((n, sc.COORDS_SIZE)), np.zeros((sc.MOTION_ROWS, n))
        for j, c in enumerate(self.coordinates):
            coords[j] = (
                c.mass, c.pull, c.damping, c.spring, c.spring_rest,
                c.low, c.high, c.stop_stiffness, c.stop_damping, c.coulomb,
            )  # fmt: skip
            motion[sc.PLACE, j], motion[sc.RATE, j] = c.start, c.start_rate
        switches = np.zeros((len(self.switches), sc.SWITCHES_SIZE))
        for i, s in enumerate(self.switches):
            on = abs(self._coordinate(s.coordinate).start - s.at) <= s.reach
            switches[i] = (self.index(s.coordinate), s.at, s.reach, s.gap, float(on))
        clock = np.zeros(sc.CLOCK_SIZE)
        clock[sc.STEP_MAX] = STEP_MAX_S * step_share
        clock[sc.GAS_SAFETY] = STEP_SAFETY * step_share
        clock[sc.LOAD_SAFETY] = load_safety * step_share
        clock[sc.DAMPING_SAFETY] = DAMPING_SAFETY * step_share
        arm = np.zeros((0, 16)) if self.arm is None else self.arm.table
        gravity = np.zeros(3) if self.arm is None else self.arm.gravity
        return sc.World(
            state, params, kinds, shape, reach, coords, motion,
            np.ascontiguousarray(arm), np.ascontiguousarray(gravity), *_stacked(tables),
            switches, np.zeros((LOG_ROWS, sc.LOG_SIZE)), clock,
            np.zeros((sc.WORK_ROWS, max(m, n, 1))), np.zeros((n, WORK)), np.zeros((n, n)),
        )  # fmt: skip

    def _reach(self, unit: Unit) -> list[float]:
        for name in unit.reach:
            if name not in {c.name for c in self.coordinates}:
                known = ", ".join(c.name for c in self.coordinates) or "none"
                raise PlantError(f"muscle {unit.name!r}: unknown joint {name!r}; known: {known}")
        return [*(unit.reach.get(c.name, 0.0) for c in self.coordinates), unit.rest_m]

    def _place(self) -> None:
        """Set the initial lengths of the units, and check them."""
        w = self.world
        for k, unit in enumerate(self.units):
            if not unit.pressure_pa > -unit.constants.atmosphere_pa:
                raise PlantError(f"muscle {unit.name!r}: pressure {unit.pressure_pa!r} Pa")
            length = w.reach[k, -1] + w.reach[k, :-1] @ w.motion[sc.PLACE]
            w.units[k, at.LENGTH] = length
            if isinstance(unit.model, Piston):
                if not unit.model.area_m2 > 0.0:
                    raise PlantError(f"cylinder {unit.name!r}: area {unit.model.area_m2!r} m2")
                continue
            self._check_lengths(k, unit, float(length))
        self.refresh()

    def _check_lengths(self, k: int, unit: Unit, start: float) -> None:
        """Raise if the mechanism could move a muscle outside the range of its braid."""
        ends = [start]
        reach = self.world.reach[k]
        finite = [
            (r * c.low, r * c.high) if r else (0.0, 0.0)
            for r, c in zip(reach[:-1], self.coordinates, strict=True)
        ]
        if all(math.isfinite(v) for pair in finite for v in pair):
            ends += [reach[-1] + sum(pick(pair) for pair in finite) for pick in (min, max)]
        for length in ends:
            if not 0.0 < length < unit.constants.braid_length_m:
                raise PlantError(
                    f"muscle {unit.name!r}: within the range of its joints it would be "
                    f"{length * 1e3:g} mm long, outside the braid (above 0 and below "
                    f"{unit.constants.braid_length_m * 1e3:g} mm)"
                )

    # ---- use ------------------------------------------------------------------------

    def index(self, coordinate: str) -> int:
        """Index of a coordinate. Raises `PlantError` for an unknown name."""
        for j, c in enumerate(self.coordinates):
            if c.name == coordinate:
                return j
        known = ", ".join(c.name for c in self.coordinates) or "none"
        raise PlantError(f"scene: unknown joint {coordinate!r}; known: {known}")

    def _coordinate(self, name: str) -> Coordinate:
        return self.coordinates[self.index(name)]

    def advance(
        self, dt_s: float, inlet_on_s: Array | Sequence[float], vent_on_s: Array | Sequence[float]
    ) -> None:
        """One control tick: unit k fills for the first `inlet_on_s[k]`, vents for `vent_on_s[k]`.

        As in `plant.simulator.bench.advance`, `dt_s` or more keeps a command on at the end of the
        tick.
        """
        from plant.scene.kernel import (
            advance,  # compiled where a scene is used, not where it may be
        )

        fill = np.asarray(inlet_on_s, dtype=np.float64)
        vent = np.asarray(vent_on_s, dtype=np.float64)
        advance(self.world, dt_s, fill, vent)
        if self.world.clock[sc.TROUBLE]:
            raise PlantError("scene: a joint moves no inertia; give the links mass")

    def refresh(self) -> None:
        """Update lengths and forces after a change of the arrays; no time passes."""
        commands = self.world.units[:, at.INLET_COMMAND : at.OUTLET_COMMAND + 1]
        self.advance(0.0, commands[:, 0].copy(), commands[:, 1].copy())

    @property
    def time_s(self) -> float:
        """Simulated time."""
        return float(self.world.units[0, at.TIME])

    @property
    def places(self) -> Array:
        """Position of each coordinate, shape (n,), m or rad."""
        return np.array(self.world.motion[sc.PLACE])

    @property
    def rates(self) -> Array:
        """Rate of each coordinate, shape (n,)."""
        return np.array(self.world.motion[sc.RATE])

    @property
    def pressures_kpa(self) -> Array:
        """Gauge pressure of each unit, shape (M,)."""
        return np.asarray(self.world.units[:, at.PRESSURE] * 1e-3)

    @property
    def lengths_mm(self) -> Array:
        """Length of each unit, shape (M,)."""
        return np.asarray(self.world.units[:, at.LENGTH] * 1e3)

    @property
    def forces_n(self) -> Array:
        """Tensile force of each unit, shape (M,)."""
        return np.asarray(self.world.units[:, at.FORCE].copy())

    def take_events(self) -> list[Event]:
        """Events since the last call: valve edges, stops, switches, friction.

        The log has `LOG_ROWS` rows; when it is full, later events are lost.
        """
        count = min(int(self.world.clock[sc.LOGGED]), LOG_ROWS)
        found = []
        for time, kind, which, value in self.world.log[:count]:
            word = sc.LOG_WORDS[int(kind)]
            if kind <= sc.LOG_OUTLET:
                name = self.units[int(which)].name
            elif kind == sc.LOG_SWITCH:
                name = f"{self.switches[int(which)].coordinate} {int(which)}"
            else:
                name = self.coordinates[int(which)].name
            found.append(Event(float(time), word, name, float(value)))
        self.world.clock[sc.LOGGED] = 0.0
        return found


def _joined(coordinates: Sequence[Coordinate], arm: Arm | None) -> tuple[Coordinate, ...]:
    """The coordinates; with an arm they are its joints, in its order, with its ranges."""
    if arm is None:
        return tuple(coordinates)
    given = {c.name: c for c in coordinates}
    for name in given:
        arm.joint(name)
    joined = []
    for link in arm.links:
        c = given.get(link.joint, Coordinate(link.joint))
        if c.low == -math.inf and c.high == math.inf:
            c = dataclasses.replace(c, low=link.low_rad, high=link.high_rad)
        if math.isfinite(c.low) and c.stop_stiffness == 0.0:
            c = dataclasses.replace(
                c, stop_stiffness=JOINT_STOP_N_M_RAD, stop_damping=JOINT_STOP_N_M_S_RAD
            )
        joined.append(c)
    return tuple(joined)


def _check_coordinate(c: Coordinate, on_arm: bool) -> None:
    where = f"coordinate {c.name!r}"
    if not on_arm and not (math.isfinite(c.mass) and c.mass > 0.0):
        raise PlantError(f"{where}: mass {c.mass!r}; expected more than 0")
    if on_arm and c.coulomb != 0.0:
        raise PlantError(
            f"{where}: Coulomb friction is possible for sliding masses, not for an arm"
        )
    for name in ("damping", "spring", "stop_stiffness", "stop_damping", "coulomb"):
        value = getattr(c, name)
        if not (math.isfinite(value) and value >= 0.0):
            raise PlantError(f"{where}: {name} = {value!r}; expected 0 or more")
    if not c.low < c.high:
        raise PlantError(f"{where}: its range must increase, got {c.low} to {c.high}")
    if not c.low <= c.start <= c.high:
        raise PlantError(f"{where}: starts at {c.start:g}, outside its range {c.low:g}..{c.high:g}")
    if not (math.isfinite(c.pull) and math.isfinite(c.start_rate)):
        raise PlantError(f"{where}: pull and start_rate must be finite numbers")


def _stacked(tables: Sequence[ModelTable]) -> tuple[Array, Array, Array]:
    """All tables in arrays of one shape; smaller tables are padded with zeros."""
    if not tables:
        return np.zeros((1, 1, 1, 16)), np.zeros((1, 1, 4)), np.ones((1, 6))
    rows, columns = (max(t.force.shape[i] for t in tables) for i in range(2))
    force = np.zeros((len(tables), rows, columns, 16))
    volume = np.zeros((len(tables), columns, 4))
    axes = np.zeros((len(tables), 6))
    for i, t in enumerate(tables):
        force[i, : t.force.shape[0], : t.force.shape[1]] = t.force
        volume[i, : t.volume.shape[0]] = t.volume
        axes[i] = t.axes
        axes[i, 4:] = t.force.shape[:2]
    return force, volume, axes
