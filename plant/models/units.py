"""Units of model parameters and their factors to SI, for example `N/(kPa mm^3)`."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator

from plant.errors import PlantError

BASE: dict[str, float] = {
    "1": 1.0,
    "N": 1.0,
    "Pa": 1.0,
    "kPa": 1e3,
    "bar": 1e5,
    "m": 1.0,
    "mm": 1e-3,
    "ml": 1e-6,
    "s": 1.0,
    "degC": 1.0,
    "°C": 1.0,
    "rad": 1.0,
    "deg": math.pi / 180.0,
    "%": 0.01,
}
"""Known units and their factors to SI; degrees Celsius are not converted to kelvin."""

_FACTOR = re.compile(r"^([A-Za-z%]+|1)(?:\^(\d+))?$")


def to_si(unit: str) -> float:
    """Factor that converts a number in `unit` to SI.

    A unit is a product of names with powers, divided by at most one product in brackets:
    `mm`, `1/%`, `N/mm`, `N/(kPa mm^3 degC)`. Raises `PlantError` for anything else.
    """
    top, slash, bottom = unit.partition("/")
    factor = _product(top, unit)
    return factor / _product(_without_brackets(bottom), unit) if slash else factor


def powers(unit: str) -> dict[str, int]:
    """Names in a unit with their powers: `N/(kPa mm^3)` has N 1, kPa -1, mm -3.

    Raises `PlantError` for a text that is no unit.
    """
    top, slash, bottom = unit.partition("/")
    found: dict[str, int] = {}
    sides = [(top, 1), (_without_brackets(bottom), -1)] if slash else [(top, 1)]
    for text, sign in sides:
        for name, power in _words(text, unit):
            found[name] = found.get(name, 0) + sign * power
    return found


def _without_brackets(bottom: str) -> str:
    bottom = bottom.strip()
    return bottom[1:-1] if bottom.startswith("(") and bottom.endswith(")") else bottom


def _product(text: str, unit: str) -> float:
    factor = 1.0
    for name, power in _words(text, unit):
        factor *= BASE[name] ** power
    return factor


def _words(text: str, unit: str) -> Iterator[tuple[str, int]]:
    for word in text.split() or [""]:
        match = _FACTOR.match(word)
        if match is None or match[1] not in BASE:
            raise PlantError(
                f"unit {unit!r}: cannot read {word!r}; known names: {', '.join(BASE)}, "
                "for example N/(kPa mm^3)"
            )
        yield match[1], int(match[2] or 1)
