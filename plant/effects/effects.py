"""Which effects of the catalogue are switched on, and how strongly.

An effect is a named addition to the nominal plant; with none the plant is exactly nominal. Rig
files name them as `[effects.<id>]` tables; parameters are in the units of their names.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from plant.constants import PlantConstants
from plant.effects.arguments import Values
from plant.effects.catalogue import CATALOGUE
from plant.effects.effect import Effect, Parameter
from plant.errors import PlantError


@dataclass(frozen=True)
class Effects:
    """Effects in force: id -> parameter -> value, complete with the defaults of shape parameters.

    Empty means the nominal plant. Build with `from_config`.
    """

    values: Mapping[str, Mapping[str, float | str]] = field(default_factory=dict)

    @classmethod
    def from_config(cls, config: Mapping[str, Any] | None, origin: str = "effects") -> Effects:
        """Read `{"liner_threshold": {"threshold_kpa": 100}}`; `origin` names the file in errors.

        Raises `PlantError` for an unknown effect or parameter, a missing headline parameter, and
        a value of the wrong type or out of range.
        """
        if config is not None and not isinstance(config, Mapping):
            raise PlantError(f"{origin} = {config!r:.40}: expected a table with a table an effect")
        values: dict[str, Mapping[str, float | str]] = {}
        for name, table in (config or {}).items():
            values[name] = _read(_entry(name, origin), table, f"{origin}.{name}")
        return cls(values)

    def __contains__(self, name: str) -> bool:
        return name in self.values

    def __bool__(self) -> bool:
        return bool(self.values)

    def get(self, name: str, parameter: str, default: float = 0.0) -> float:
        """Value of a numeric parameter, or `default` when the effect is off."""
        value = self.values.get(name, {}).get(parameter, default)
        if isinstance(value, str):
            raise PlantError(f"effect {name!r}: {parameter} is a word, {value!r}, not a number")
        return value

    def word(self, name: str, parameter: str) -> str:
        """The word that a parameter takes, such as an edge; "" when the effect is off."""
        value = self.values.get(name, {}).get(parameter, "")
        if not isinstance(value, str):
            raise PlantError(f"effect {name!r}: {parameter} is a number, {value!r}, not a word")
        return value

    def active(self) -> list[tuple[Effect, Values]]:
        """The effects in force with their parameters, in the order of the catalogue."""
        return [(e, self.values[e.id]) for e in CATALOGUE.values() if e.id in self.values]

    @property
    def carried_kg(self) -> float:
        """Mass that hangs beside the stated load."""
        return sum(amount for effect, amount in self.headlines() if effect.plant.mass is not None)

    def check_actuator(self, c: PlantConstants, origin: str = "effects") -> None:
        """Raise `PlantError` where an effect is of a braid and the actuator has none."""
        for effect, _ in self.active():
            if effect.of_braid and c.actuator == "cylinder":
                raise PlantError(f"{origin}.{effect.id}: an effect of a braid; a cylinder has none")

    def headlines(self) -> list[tuple[Effect, float]]:
        """The effects in force that have a headline parameter, with its value."""
        return [(e, float(v[e.headline])) for e, v in self.active() if e.headline is not None]


NONE = Effects()
"""The nominal plant."""


def _entry(name: str, origin: str) -> Effect:
    if name not in CATALOGUE:
        from difflib import get_close_matches

        near = get_close_matches(name, CATALOGUE, n=1)
        hint = f"did you mean {near[0]}?" if near else f"known: {', '.join(CATALOGUE)}"
        raise PlantError(f"{origin}: unknown effect {name!r}; {hint}")
    return CATALOGUE[name]


def _read(entry: Effect, table: object, origin: str) -> dict[str, float | str]:
    known = {parameter.name: parameter for parameter in entry.parameters}
    listed = ", ".join(known) or "no parameters"
    if not isinstance(table, Mapping):
        raise PlantError(f"{origin} = {table!r}: expected a table with {listed}")
    values: dict[str, float | str] = {}
    for name, value in table.items():
        if name not in known:
            raise PlantError(f"{origin}: unknown parameter {name!r}; known: {listed}")
        values[name] = _value(known[name], value, origin)
    for parameter in entry.parameters:
        if parameter.name not in values:
            if parameter.default is None:
                raise PlantError(
                    f"{origin}: {parameter.name} is missing "
                    f"({parameter.meaning}; {_allowed(parameter)})"
                )
            values[parameter.name] = parameter.default
    return values


def _value(parameter: Parameter, value: object, origin: str) -> float | str:
    allowed = _allowed(parameter)
    if parameter.choices:
        if not isinstance(value, str) or value not in parameter.choices:
            raise PlantError(f"{origin}: {parameter.name} = {value!r}; {allowed}")
        return value
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise PlantError(
            f"{origin}: {parameter.name} = {value!r} is a {type(value).__name__}; "
            f"expected a number, {allowed}"
        )
    if not parameter.low <= value <= parameter.high:
        raise PlantError(f"{origin}: {parameter.name} = {value!r} is out of range; {allowed}")
    return float(value)


def _allowed(parameter: Parameter) -> str:
    if parameter.choices:
        return f"allowed {', '.join(parameter.choices)}"
    return f"allowed {parameter.low:g} to {parameter.high:g}"
