"""The load of a scenario: a held length, a hung mass, joints, or the ram."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from daq.errors import ConfigError
from plant.constants import STANDARD_GRAVITY_M_S2, PlantConstants
from plant.effects.effects import Effects
from plant.errors import LinkError, PlantError
from plant.links.arm import Arm
from plant.links.reader import load_arm
from plant.scene.ram import RamConstants
from plant.scene.scene import Coordinate, Switch
from rigs.rigfile.toml_reader import Table

KINDS = ("held", "hung", "joint", "ram")
_DEG = math.pi / 180.0


@dataclass(frozen=True)
class Mechanism:
    """The mechanical part of a scene, and the attachment of muscles.

    `hung_kg` is the stated hung mass, without the payload of an effect.
    """

    kind: str
    coordinates: tuple[Coordinate, ...] = ()
    arm: Arm | None = None
    switches: tuple[Switch, ...] = ()
    ram: RamConstants | None = None
    held_m: float = 0.0
    hung_kg: float = 0.0

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all coordinates."""
        return self.arm.joints if self.arm is not None else tuple(c.name for c in self.coordinates)

    @property
    def single(self) -> bool:
        """True if only one muscle is possible."""
        return self.kind != "joint"

    @property
    def held_mm(self) -> float | None:
        """Held length of the muscle; None for other loads."""
        return self.held_m * 1e3 if self.kind == "held" else None

    @property
    def load_kg(self) -> float | None:
        """Stated hung mass; None for other loads."""
        return self.hung_kg if self.kind == "hung" else None

    @property
    def unit(self) -> str:
        """Unit of positions."""
        return "deg" if self.kind == "joint" else "mm"

    @property
    def scale(self) -> float:
        """Factor from that unit to SI."""
        return _DEG if self.kind == "joint" else 1e-3

    def chamber(self, constants: PlantConstants) -> PlantConstants:
        """The constants, with the dead volume of the ram if the load is a ram."""
        if self.ram is None:
            return constants
        return dataclasses.replace(constants, dead_volume_m3=self.ram.dead_volume_m3)

    def attach(
        self, row: Table, constants: PlantConstants
    ) -> tuple[Mapping[str, float], float, bool]:
        """Reach, rest length and whether it is a tendon, from a table [[muscle]].

        Raises:
            ConfigError: an unknown joint, or a length outside the braid.
        """
        if self.kind == "held":
            return {}, self.held_m, False
        if self.kind in ("hung", "ram"):
            return {self.coordinates[0].name: 1.0}, 0.0, False
        joint = row.text("joint")
        if joint not in self.names:
            raise row.fail("joint", f"unknown joint {joint!r}", f"known: {', '.join(self.names)}")
        radius = row.number("radius_mm", 0.1, 1000, unit="mm") * 1e-3
        way = row.text("pulls", choices=("up", "down"))
        rest = row.number("rest_mm", 1, 2000, unit="mm") * 1e-3
        if not rest < constants.braid_length_m:
            raise row.fail(
                "rest_mm",
                f"{rest * 1e3:g} mm is outside the braid: no muscle of this plant is longer than "
                f"braid_length_mm = {constants.braid_length_m * 1e3:g}",
            )
        return {joint: -radius if way == "up" else radius}, rest, True


def read_mechanism(t: Table, constants: PlantConstants, effects: Effects) -> Mechanism:
    """The table [load] of a scenario. Raises `ConfigError` naming file and key."""
    load = t.table("load")
    kind = load.text("kind", choices=KINDS)
    if kind == "held":
        length = load.number("length_mm", 1, 2000, unit="mm") * 1e-3
        if not length < constants.braid_length_m:
            raise load.fail(
                "length_mm",
                f"{length * 1e3:g} mm is outside the braid (above 0 and below braid_length_mm = "
                f"{constants.braid_length_m * 1e3:g})",
            )
        found = Mechanism(kind, held_m=length)
    elif kind == "hung":
        found = _hung(load, constants, effects)
    elif kind == "ram":
        found = _ram(load)
    else:
        found = _joint(load, effects)
    load.finish()
    return found


def _mass(load: Table, key: str, low: float, high: float, default: float | None = None) -> float:
    """A mass; a negative one has its own message."""
    value = load.raw(key, default)
    if isinstance(value, (int, float)) and not isinstance(value, bool) and value < 0:
        raise load.fail(key, f"negative mass, {value!r}", "a mass is 0 or more")
    return load.number(key, low, high, ... if default is None else default)


def _hung(load: Table, c: PlantConstants, effects: Effects) -> Mechanism:
    stated = _mass(load, "mass_kg", 0.001, 1000)
    mass = stated + effects.carried_kg
    low, high = c.length_min_m * 1e3, c.length_max_m * 1e3
    start = load.number("start_mm", low, high, high, unit="mm") * 1e-3
    spring = load.number("spring_n_mm", 0, 1e3, 0.0, unit="N/mm") * 1e3
    rest = load.number("spring_rest_mm", 0, 1e4, 0.0, unit="mm") * 1e-3
    slide = Coordinate(
        "length",
        mass=mass,
        pull=mass * STANDARD_GRAVITY_M_S2,
        damping=c.load_damping_n_s_m,
        spring=spring,
        spring_rest=rest,
        low=c.length_min_m,
        high=c.length_max_m,
        stop_stiffness=c.stop_stiffness_n_m,
        stop_damping=c.stop_damping_n_s_m,
        coulomb=load.number("friction_n", 0, 1000, 0.0, unit="N"),
        start=start,
    )
    switches = _switches(load, "length", 1e-3)
    return Mechanism("hung", (slide,), switches=switches, hung_kg=stated)


def _ram(load: Table) -> Mechanism:
    plain = RamConstants()
    try:
        ram = RamConstants(
            bore_m=load.number("bore_mm", 1, 1000, plain.bore_m * 1e3) * 1e-3,
            stroke_m=load.number("stroke_mm", 1, 5000, plain.stroke_m * 1e3) * 1e-3,
            mass_kg=_mass(load, "mass_kg", 0.01, 1e4, plain.mass_kg),
            friction_n=load.number("friction_n", 0, 1e4, plain.friction_n),
            dead_volume_m3=load.number("dead_volume_ml", 0.01, 1e4, 20.0) * 1e-6,
            switches_m=tuple(
                v * 1e-3 for v in load.numbers("switches_mm", 0, 5000, [50.0, 150.0], least=0)
            ),
            switch_reach_m=load.number("switch_reach_mm", 0.5, 100, plain.switch_reach_m * 1e3)
            * 1e-3,
        )
    except PlantError as error:
        raise ConfigError(f"{load.source}: load", str(error)) from None
    height = Coordinate(
        "height",
        mass=ram.mass_kg,
        pull=-ram.mass_kg * STANDARD_GRAVITY_M_S2,
        low=0.0,
        high=ram.stroke_m,
        stop_stiffness=ram.end_stiffness_n_m,
        stop_damping=ram.end_damping_n_s_m,
        coulomb=ram.friction_n,
        start=load.number("start_mm", 0, ram.stroke_m * 1e3, 0.0) * 1e-3,
    )
    switches = tuple(
        Switch("height", at, ram.switch_reach_m, ram.switch_gap_m) for at in ram.switches_m
    )
    return Mechanism("ram", (height,), switches=switches, ram=ram)


def _joint(load: Table, effects: Effects) -> Mechanism:
    given = load.raw("arm")
    if not isinstance(given, (str, dict)):
        raise load.fail("arm", f"expected an arm's name, file or table, got {given!r}")
    try:
        arm = load_arm(given)
        payload = _mass(load, "payload_g", 0, 1e5, 0.0) * 1e-3
        arm = arm.with_payload(payload + effects.carried_kg)
    except LinkError as error:
        where = f"{load.source}: load.arm"
        text = str(error).removeprefix("arm table: ").removeprefix("arm table, ")
        what, _, remedy = text.partition("; ")
        raise ConfigError(where, what, remedy) from None
    coordinates = _joints(load, arm)
    return Mechanism("joint", coordinates, arm)


def _joints(load: Table, arm: Arm) -> tuple[Coordinate, ...]:
    """Tables [[load.joint]]: start positions, springs and load torques of joints."""
    found: list[Coordinate] = []
    given = load.raw("joint", [])
    if not isinstance(given, list) or not all(isinstance(row, dict) for row in given):
        raise load.fail("joint", f"expected tables [[load.joint]], got {given!r:.60}")
    for i, values in enumerate(given):
        row = Table(values, load.source, f"load.joint[{i + 1}]")
        name = row.text("name")
        if name not in arm.joints:
            raise row.fail(
                "name", f"unknown joint {name!r}", f"the arm has {', '.join(arm.joints)}"
            )
        if name in [c.name for c in found]:
            raise row.fail("name", f"joint {name!r} has more than one table")
        link = arm.links[arm.joint(name)]
        low = max(link.low_rad, -100.0) / _DEG
        high = min(link.high_rad, 100.0) / _DEG
        found.append(
            Coordinate(
                name,
                pull=row.number("torque_n_m", -1e4, 1e4, 0.0),
                damping=row.number("damping_n_m_s", 0, 1e4, 0.0),
                spring=row.number("spring_n_m_rad", 0, 1e6, 0.0),
                spring_rest=row.number("spring_rest_deg", -360, 360, 0.0) * _DEG,
                start=row.number("start_deg", low, high, 0.0, unit="deg") * _DEG,
            )
        )
        row.finish()
    return tuple(found)


def _switches(load: Table, coordinate: str, scale: float) -> tuple[Switch, ...]:
    places: Sequence[float] = load.numbers("switches_mm", 0, 1e4, [], least=0)
    return tuple(Switch(coordinate, at * scale) for at in places)
