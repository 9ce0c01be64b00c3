"""Units of a mapping file, by dimension, and their conversion into those of the dataset format.

Factors: SI brochure, 9th edition (2019), and NIST SP 811, appendix B.8 (exact but for mmHg, which
is the conventional one).
"""

from __future__ import annotations

import difflib
from dataclasses import dataclass

from gap.errors import GapError
from plant.arrays import Array

G_M_S2 = 9.80665
"""Standard acceleration of gravity, m/s2: turns a mass into the force that it weighs."""
_LBF_N = 0.45359237 * G_M_S2
_PSI_KPA = _LBF_N / 0.0254**2 / 1000.0

UNITS: dict[str, dict[str, tuple[float, float]]] = {
    "pressure": {
        "kPa": (1.0, 0.0), "Pa": (1e-3, 0.0), "MPa": (1e3, 0.0), "bar": (100.0, 0.0),
        "mbar": (0.1, 0.0), "hPa": (0.1, 0.0), "psi": (_PSI_KPA, 0.0),
        "mmHg": (0.133322387415, 0.0),
    },
    "force": {
        "N": (1.0, 0.0), "mN": (1e-3, 0.0), "kN": (1e3, 0.0), "gf": (1e-3 * G_M_S2, 0.0),
        "kgf": (G_M_S2, 0.0), "g": (1e-3 * G_M_S2, 0.0), "kg": (G_M_S2, 0.0), "lbf": (_LBF_N, 0.0),
    },
    "length": {
        "mm": (1.0, 0.0), "m": (1e3, 0.0), "cm": (10.0, 0.0), "um": (1e-3, 0.0),
        "in": (25.4, 0.0),
    },
    "temperature": {
        "C": (1.0, 0.0), "K": (1.0, -273.15), "F": (1.0 / 1.8, -32.0 / 1.8),
    },
    "mass": {
        "kg": (1.0, 0.0), "g": (1e-3, 0.0), "lb": (0.45359237, 0.0), "N": (1.0 / G_M_S2, 0.0),
    },
}  # fmt: skip
"""Unit -> (factor, addend): value in the dataset's unit = factor x value + addend."""
RELATIVE: dict[str, tuple[float, float]] = {
    "contraction": (-1.0, 1.0), "contraction %": (-0.01, 1.0),
    "strain": (1.0, 1.0), "strain %": (0.01, 1.0),
}  # fmt: skip
"""Units of length relative to the rest length: (factor, addend) of rest lengths."""
TIME_NS = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1, "min": 60 * 10**9, "h": 3600 * 10**9}
"""Nanoseconds in each unit of time."""
ISO = "ISO"
"""The unit of times that are dates with a time of day (ISO 8601)."""
SIGNALS = ("V", "mV", "A", "mA", "counts")
"""Units of a signal that says nothing without the calibration of its sensor."""
_SPELLED = {"°C": "C", "degC": "C", "°F": "F", "degF": "F", "µm": "um", "μm": "um", "µs": "us",
            "μs": "us", "inch": "in"}  # fmt: skip

DIMENSION = {
    "supply_kpa": "pressure", "pressure_kpa": "pressure", "length_mm": "length",
    "held_length_mm": "length", "tare_length_mm": "length", "force_n": "force",
    "temperature_c": "temperature", "load_kg": "mass",
}  # fmt: skip
"""Dimension of each number of the dataset format that a mapping can bring in."""


@dataclass(frozen=True)
class Conversion:
    """value of the dataset = factor x value of the file + addend."""

    factor: float
    addend: float

    def __call__(self, value: Array) -> Array:
        """Values of the file in the dataset's unit."""
        return self.factor * value + self.addend


def spelled(unit: str) -> str:
    """A unit as this module writes it."""
    return _SPELLED.get(unit, unit)


def conversion(unit: str, dimension: str, where: str, rest_length_mm: float | None) -> Conversion:
    """Conversion of a unit into that of the dataset format.

    Args:
        unit: as in the mapping file.
        dimension: a key of `UNITS`.
        where: file and key, for the message.
        rest_length_mm: length at which a contraction or strain is zero, if stated.

    Raises:
        GapError: unknown unit, unit of another dimension, or a contraction without a rest length.
    """
    name = spelled(unit)
    known = UNITS[dimension]
    if name in known:
        return Conversion(*known[name])
    if dimension == "length" and name in RELATIVE:
        if rest_length_mm is None:
            raise GapError(where, f"unit {unit!r} needs rest_length_mm", "state the rest length")
        factor, addend = RELATIVE[name]
        return Conversion(factor * rest_length_mm, addend * rest_length_mm)
    others = [other for other, units in UNITS.items() if name in units]
    others += ["length relative to a rest length"] if name in RELATIVE else []
    others += ["time"] if name in TIME_NS else []
    expected = f"expected one of {', '.join(accepted(dimension))}"
    if name in SIGNALS:
        raise GapError(where, f"{unit!r} is a signal", "state scale, offset and the unit it gives")
    if others:
        raise GapError(where, f"{unit!r} is a unit of {others[0]}, not of {dimension}", expected)
    near = difflib.get_close_matches(name, accepted(dimension), n=1, cutoff=0.5)
    hint = f"did you mean {near[0]!r}? " if near else ""
    raise GapError(where, f"unknown unit {unit!r}", hint + expected)


def accepted(dimension: str) -> list[str]:
    """Units that a quantity of this dimension can have in a file."""
    return [*UNITS[dimension], *(RELATIVE if dimension == "length" else ())]


def time_factor_ns(unit: str, where: str) -> int:
    """Nanoseconds in a unit of time. Raises `GapError` for a unit that is none of time."""
    name = spelled(unit)
    if name in TIME_NS:
        return TIME_NS[name]
    known = f"expected one of {', '.join([*TIME_NS, ISO])}"
    for dimension, units in UNITS.items():
        if name in units:
            raise GapError(where, f"{unit!r} is a unit of {dimension}, not of time", known)
    raise GapError(where, f"unknown unit {unit!r}", known)
