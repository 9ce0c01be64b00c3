"""Constants of a bench: TOML files in practical units, values in SI."""

from __future__ import annotations

import dataclasses
import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

from plant import tomlfile
from plant.errors import PlantError

GAS_CONSTANT_J_KG_K = 287.05
"""Specific gas constant of air."""
REFERENCE_DENSITY_KG_M3 = 1.185
"""Density of air at the reference state of ISO 6358."""
REFERENCE_TEMPERATURE_K = 293.15
"""Temperature of the reference state of ISO 6358."""

STANDARD_GRAVITY_M_S2 = 9.80665


@dataclass(frozen=True)
class Key:
    """One key of a plant file: field, factor to SI, and bounds in the unit of the key."""

    name: str
    field: str
    to_si: float
    low: float
    high: float
    optional: bool = False
    """Whether a complete plant file may leave it out; `PlantConstants` has its value then."""


_KPA = 1e3
_MM = 1e-3
_MS = 1e-3
_MS_PER_KPA = 1e-6
_N_PER_MM = 1e3

KEYS: dict[str, Key] = {
    name: Key(name, field, to_si, low, high)
    for name, field, to_si, low, high in [
        ("supply_kpa", "supply_pa", _KPA, 0.0, 1200.0),
        ("atmosphere_kpa", "atmosphere_pa", _KPA, 50.0, 110.0),
        ("gas_temperature_k", "gas_temperature_k", 1.0, 230.0, 350.0),
        ("braid_length_mm", "braid_length_m", _MM, 10.0, 2000.0),
        ("turns", "turns", 1.0, 0.2, 100.0),
        ("inlet_conductance_m3_s_pa", "inlet_conductance_m3_s_pa", 1.0, 1e-13, 1e-6),
        ("outlet_conductance_m3_s_pa", "outlet_conductance_m3_s_pa", 1.0, 1e-13, 1e-6),
        ("critical_ratio", "critical_ratio", 1.0, 0.0, 0.95),
        ("dead_volume_ml", "dead_volume_m3", 1e-6, 1e-3, 10000.0),
        ("polytropic_exponent", "polytropic_exponent", 1.0, 1.0, 1.4),
        ("length_min_mm", "length_min_m", _MM, 1.0, 2000.0),
        ("length_max_mm", "length_max_m", _MM, 1.0, 2000.0),
        ("stop_stiffness_n_mm", "stop_stiffness_n_m", _N_PER_MM, 0.0, 1e4),
        ("stop_damping_n_s_mm", "stop_damping_n_s_m", _N_PER_MM, 0.0, 10.0),
        ("load_damping_n_s_mm", "load_damping_n_s_m", _N_PER_MM, 0.0, 10.0),
        ("inlet_on_ms", "inlet_on_s", _MS, 0.0, 100.0),
        ("inlet_on_ms_per_kpa", "inlet_on_s_per_pa", _MS_PER_KPA, -0.1, 0.1),
        ("inlet_off_ms", "inlet_off_s", _MS, 0.0, 100.0),
        ("inlet_off_ms_per_kpa", "inlet_off_s_per_pa", _MS_PER_KPA, -0.1, 0.1),
        ("outlet_on_ms", "outlet_on_s", _MS, 0.0, 100.0),
        ("outlet_on_ms_per_kpa", "outlet_on_s_per_pa", _MS_PER_KPA, -0.1, 0.1),
        ("outlet_off_ms", "outlet_off_s", _MS, 0.0, 100.0),
        ("outlet_off_ms_per_kpa", "outlet_off_s_per_pa", _MS_PER_KPA, -0.1, 0.1),
        ("inlet_pull_in_v", "inlet_pull_in_v", 1.0, 0.0, 60.0),
        ("inlet_pull_in_v_per_kpa", "inlet_pull_in_v_per_pa", 1e-3, -0.1, 0.1),
        ("inlet_drop_out_v", "inlet_drop_out_v", 1.0, 0.0, 60.0),
        ("outlet_pull_in_v", "outlet_pull_in_v", 1.0, 0.0, 60.0),
        ("outlet_pull_in_v_per_kpa", "outlet_pull_in_v_per_pa", 1e-3, -0.1, 0.1),
        ("outlet_drop_out_v", "outlet_drop_out_v", 1.0, 0.0, 60.0),
    ]
} | {
    name: Key(name, field, to_si, low, high, optional=True)
    for name, field, to_si, low, high in [
        ("inlet_closing_kpa", "inlet_closing_pa", _KPA, 0.0, 1000.0),
        ("outlet_closing_kpa", "outlet_closing_pa", _KPA, 0.0, 1000.0),
        ("inlet_dead_band", "inlet_dead_band", 1.0, 0.0, 0.9),
        ("outlet_dead_band", "outlet_dead_band", 1.0, 0.0, 0.9),
        ("valve_lag_ms", "valve_lag_s", _MS, 0.0, 1000.0),
        ("piston_area_mm2", "piston_area_m2", 1e-6, 1.0, 1e6),
    ]
}
"""All numeric keys of a plant file; bounds are in the unit of the key and included."""

CHOICES: dict[str, tuple[str, ...]] = {
    "delay_mode": ("inertial", "transport"),
    "outlet_normally": ("closed", "open"),
    "valve": ("on_off", "proportional"),
    "actuator": ("muscle", "cylinder"),
}
"""Keys with a text value, and their possible values."""
_OPTIONAL = frozenset({"valve", "actuator", *(name for name, key in KEYS.items() if key.optional)})

PROPORTIONAL: dict[str, float] = {
    "inlet_dead_band": 0.03, "outlet_dead_band": 0.03, "valve_lag_ms": 5.0,
}  # fmt: skip
"""Constants that a proportional valve alone has, and their tolerance where none is stated: wide,
since few data sheets give them."""

_BRAID = ("braid_length_mm", "turns")
PISTON_TOLERANCE = 0.01
"""Share (1 sd) by which a piston's area is known where nothing is stated: half a per cent of the
bore."""
_CYLINDER_TURNS = 1e6
"""Turns of the braid that stands for a cylinder. Threads that run round it keep its diameter and
carry nothing along it. The braid's formulas are those of a piston to 3 L^2 / b^2: 1e-6 for a piston
of 1 mm2 and a chamber of 2 m, the extremes that can be stated."""


@dataclass(frozen=True)
class PlantConstants:
    """All constants of one bench in SI (Pa gauge, m, s, N, K), named as in docs/reference/plant.md.

    `tolerances` holds one standard deviation per plant-file key, as a number in the unit of the key
    or relative to the value ("5 %"); read it with `tolerance_si`.
    """

    supply_pa: float
    atmosphere_pa: float
    gas_temperature_k: float
    braid_length_m: float
    turns: float
    inlet_conductance_m3_s_pa: float
    outlet_conductance_m3_s_pa: float
    critical_ratio: float
    dead_volume_m3: float
    polytropic_exponent: float
    length_min_m: float
    length_max_m: float
    stop_stiffness_n_m: float
    stop_damping_n_s_m: float
    load_damping_n_s_m: float
    inlet_on_s: float
    inlet_on_s_per_pa: float
    inlet_off_s: float
    inlet_off_s_per_pa: float
    outlet_on_s: float
    outlet_on_s_per_pa: float
    outlet_off_s: float
    outlet_off_s_per_pa: float
    inlet_pull_in_v: float
    inlet_pull_in_v_per_pa: float
    inlet_drop_out_v: float
    outlet_pull_in_v: float
    outlet_pull_in_v_per_pa: float
    outlet_drop_out_v: float
    delay_mode: str
    outlet_normally: str
    valve: str = "on_off"
    inlet_closing_pa: float = 0.0
    outlet_closing_pa: float = 0.0
    inlet_dead_band: float = 0.0
    outlet_dead_band: float = 0.0
    valve_lag_s: float = 0.0
    actuator: str = "muscle"
    piston_area_m2: float = 0.0
    tolerances: tuple[tuple[str, float | str], ...] = ()

    def __post_init__(self) -> None:
        """Give a cylinder the braid that behaves as it does."""
        if self.actuator == "cylinder":
            braid_m = _CYLINDER_TURNS * math.sqrt(4.0 * math.pi * self.piston_area_m2)
            object.__setattr__(self, "turns", _CYLINDER_TURNS)
            object.__setattr__(self, "braid_length_m", braid_m)

    def with_overrides(
        self, overrides: Mapping[str, Any], origin: str = "plant overrides"
    ) -> PlantConstants:
        """Return a copy with plant-file keys replaced, e.g. `{"supply_kpa": 700}`.

        `origin` names the file or table in error messages. Raises `PlantError` for an unknown
        key, a wrong type, a value out of range, or inconsistent constants.
        """
        changes: dict[str, Any] = {}
        for name, value in overrides.items():
            if name == "tolerance":
                merged = dict(self.tolerances) | _read_tolerances(value, origin)
                changes["tolerances"] = tuple(merged.items())
            elif name in CHOICES:
                changes[name] = _read_choice(name, value, origin)
            else:
                key = _key(name, origin)
                number = tomlfile.number_in_range(value, name, key.low, key.high, origin)
                changes[key.field] = number * key.to_si
        _check_actuator(changes.get("actuator", self.actuator), overrides, self, origin)
        return _consistent(dataclasses.replace(self, **changes), origin)

    def check_plain(self, what: str) -> None:
        """Raise `PlantError` where the constants are more than `what` follows.

        It follows a muscle whose valves have two states and delays.
        """
        if self.actuator != "muscle":
            raise PlantError(f"{what} has muscles; actuator = {self.actuator!r} is none")
        if self.valve != "on_off" or self.inlet_closing_pa or self.outlet_closing_pa:
            raise PlantError(
                f"{what} has on/off valves without a closing pressure; proportional valves and "
                "closing pressures are for single muscles and for the diagnosis"
            )

    @property
    def keys(self) -> tuple[str, ...]:
        """Numeric keys that a plant file of this actuator states."""
        others = _BRAID if self.actuator == "cylinder" else ("piston_area_mm2",)
        return tuple(name for name in KEYS if name not in others)

    def value(self, name: str) -> float:
        """Value of a numeric plant-file key in the unit of the key. Raises `PlantError`."""
        key = _key(name, "plant constants")
        return float(getattr(self, key.field)) / key.to_si

    def tolerance_si(self, name: str) -> float:
        """One standard deviation of a plant-file key in SI; 0 if not stated.

        What a proportional valve alone has is known to `PROPORTIONAL` where nothing is stated, the
        area of a piston to `PISTON_TOLERANCE`.
        """
        key = _key(name, "plant constants")
        usual = PROPORTIONAL.get(name, 0.0) if self.valve == "proportional" else 0.0
        if self.actuator == "cylinder":
            if name in _BRAID:
                return 0.0
            if name == "piston_area_mm2":
                usual = PISTON_TOLERANCE * self.value(name)
        stated = dict(self.tolerances).get(name, usual)
        if isinstance(stated, str):
            return abs(float(getattr(self, key.field))) * _percent(name, stated, "tolerance") / 100
        return stated * key.to_si


def load_constants(source: str | Path | Mapping[str, Any]) -> PlantConstants:
    """Read a complete set of constants from a TOML file or a parsed table.

    Raises `PlantError` with file, key and remedy if the file cannot be read, is not TOML, lacks a
    key, or has a key that is unknown, of the wrong type or out of range.
    """
    if isinstance(source, Mapping):
        return _from_table(source, "plant table")
    path = Path(source)
    origin = f"plant file {path}"
    try:
        return _from_table(tomlfile.loads(tomlfile.read_text(path)), origin)
    except (OSError, UnicodeDecodeError) as error:
        raise PlantError(f"{origin}: cannot be read ({error})") from error
    except tomllib.TOMLDecodeError as error:
        raise PlantError(f"{origin}: not valid TOML ({error})") from error


def shipped(name: str) -> PlantConstants:
    """Constants shipped with the package, by name ("thesis"). Raises `PlantError` if unknown."""
    known = tomlfile.shipped_names("")
    if name not in known:
        raise PlantError(f"plant {name!r}: not shipped; choose one of {', '.join(known)}")
    text = resources.files("configs").joinpath("plant", f"{name}.toml").read_text(encoding="utf-8")
    return _from_table(tomlfile.loads(text), f"shipped plant {name}.toml")


def nominal() -> PlantConstants:
    """The reference bench of the thesis, `configs/plant/thesis.toml`."""
    return shipped("thesis")


def _from_table(table: Mapping[str, Any], origin: str) -> PlantConstants:
    optional = _OPTIONAL | (set(_BRAID) if table.get("actuator") == "cylinder" else set())
    missing = [name for name in [*KEYS, *CHOICES] if name not in {*table, *optional}]
    if missing:
        raise PlantError(f"{origin}: missing {', '.join(missing)}; a plant file needs every key")
    # All placeholders are replaced, because the table has every key.
    blank: dict[str, Any] = {key.field: math.nan for key in KEYS.values() if not key.optional}
    return PlantConstants(**blank, delay_mode="", outlet_normally="").with_overrides(table, origin)


def _key(name: str, origin: str) -> Key:
    if name not in KEYS:
        tomlfile.check_keys([name], [*KEYS, *CHOICES, "tolerance"], origin)
        raise PlantError(f"{origin}: {name} is not a number")
    return KEYS[name]


def _read_choice(name: str, value: object, origin: str) -> str:
    allowed = CHOICES[name]
    if not isinstance(value, str) or value not in allowed:
        words = " or ".join(repr(word) for word in allowed)
        raise PlantError(f"{origin}: {name} = {value!r}; allowed {words}")
    return value


def _read_tolerances(table: object, origin: str) -> dict[str, float | str]:
    if not isinstance(table, Mapping):
        raise PlantError(f"{origin}: tolerance = {table!r}; expected a table of key = 1 sd")
    read: dict[str, float | str] = {}
    for name, value in table.items():
        where = f"{origin} [tolerance]"
        _key(name, where)
        if isinstance(value, str):
            _percent(name, value, where)
            read[name] = value
        elif isinstance(value, bool) or not isinstance(value, (int, float)) or not value >= 0:
            raise PlantError(
                f"{where}: {name} = {value!r}; expected a number >= 0 in the key's unit, "
                'or a percentage such as "5 %"'
            )
        else:
            read[name] = float(value)
    return read


def _percent(name: str, text: str, where: str) -> float:
    try:
        share = float(text.removesuffix("%").strip()) if text.endswith("%") else math.nan
    except ValueError:
        share = math.nan
    if not 0 <= share <= 100:
        raise PlantError(
            f'{where}: {name} = {text!r}; expected a percentage from 0 to 100 % such as "5 %"'
        )
    return share


def _check_actuator(
    actuator: str, stated: Mapping[str, Any], before: PlantConstants, origin: str
) -> None:
    """Raise `PlantError` where constants of a muscle and of a cylinder are mixed."""
    if actuator == "muscle":
        if "piston_area_mm2" in stated:
            raise PlantError(
                f"{origin}: piston_area_mm2 is of a cylinder alone; "
                'state actuator = "cylinder", or leave it out'
            )
        for name in _BRAID:
            if before.actuator == "cylinder" and name not in stated:
                raise PlantError(
                    f'{origin}: actuator = "muscle" in place of a cylinder needs {name}'
                )
        return
    for name in _BRAID:
        if name in stated:
            raise PlantError(f"{origin}: {name} is of a braid; a cylinder has piston_area_mm2")
    for name in ("piston_area_mm2", "length_min_mm", "length_max_mm"):
        if before.actuator == "muscle" and name not in stated:
            raise PlantError(f'{origin}: actuator = "cylinder" needs {name}')


def _consistent(c: PlantConstants, origin: str) -> PlantConstants:
    if not c.length_min_m < c.length_max_m < c.braid_length_m:
        raise PlantError(
            f"{origin}: lengths must increase: length_min_mm ({c.length_min_m * 1e3:g}), "
            f"length_max_mm ({c.length_max_m * 1e3:g}), "
            f"braid_length_mm ({c.braid_length_m * 1e3:g})"
        )
    for name in PROPORTIONAL:
        if c.valve != "proportional" and c.value(name) != 0.0:
            raise PlantError(
                f'{origin}: {name} is of a proportional valve alone; state valve = "proportional"'
            )
    return c
