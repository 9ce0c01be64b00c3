"""Units of model parameters and their factors to SI, for example `N/(kPa mm^3)`."""

from __future__ import annotations

import math
import re

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
    bottom = bottom.strip()
    if bottom.startswith("(") and bottom.endswith(")"):
        bottom = bottom[1:-1]
    factor = _product(top, unit)
    return factor / _product(bottom, unit) if slash else factor


def _product(text: str, unit: str) -> float:
    factor = 1.0
    for word in text.split() or [""]:
        match = _FACTOR.match(word)
        if match is None or match[1] not in BASE:
            raise PlantError(
                f"unit {unit!r}: cannot read {word!r}; known names: {', '.join(BASE)}, "
                "for example N/(kPa mm^3)"
            )
        factor *= BASE[match[1]] ** int(match[2] or 1)
    return factor
