"""What a column of an exported table is: its meaning, unit and, where it has one, uncertainty.

Names follow rules: a quantity and its unit (``pressure_kpa``); ``u_X`` is the standard uncertainty
of ``X``, ``u_X_noise`` and ``u_X_cal`` are its parts; ``set_X`` is what was asked for.
"""

from __future__ import annotations

from dataclasses import dataclass

QUDT = "http://qudt.org/vocab/unit/"

UNITS: dict[str, tuple[str, str]] = {
    "kpa": ("kPa", "KiloPA"),
    "mm": ("mm", "MilliM"),
    "n": ("N", "N"),
    "c": ("degC", "DEG_C"),
    "kg": ("kg", "KiloGM"),
    "g": ("g", "GM"),
    "s": ("s", "SEC"),
    "ms": ("ms", "MilliSEC"),
    "us": ("us", "MicroSEC"),
    "ns": ("ns", "NanoSEC"),
    "v": ("V", "V"),
    "a": ("A", "A"),
    "m_s": ("m/s", "M-PER-SEC"),
    "deg": ("deg", "DEG"),
    "nm": ("N m", "N-M"),
    "percent": ("%", "PERCENT"),
    "counts": ("count", "NUM"),
    "px": ("pixel", "PIXEL"),
}
"""Suffix of a name to the unit's symbol and its name in the QUDT vocabulary."""

MEANINGS: dict[str, str] = {
    "pressure": "gauge pressure in the muscle",
    "length": "length of the muscle between its marks",
    "force": "pulling force of the muscle",
    "temperature": "temperature",
    "mass": "mass that hangs from the muscle",
    "predicted_pressure": "pressure that the plant of --predict predicts from the valve commands",
    "predicted_force": "force that the plant of --predict predicts from pressure and length",
    "gap_share_valve": "share of valve and chamber in the difference of the forces",
    "gap_share_muscle": "share of the muscle in the difference of the forces",
    "setpoint": "set-point that the controller reports",
    "time": "time since the start of the run",
    "seq": "number of the sample since the controller started",
    "boot": "number of the start of the controller",
    "flags": "state of the controller, bit by bit (docs/reference/wire-format.md)",
    "inlet_cmd": "share of the millisecond for which the inlet was open by command",
    "outlet_cmd": "share of the millisecond for which the outlet was open by command",
    "row": "number of the reading",
    "stable": "whether the instrument called the reading stable",
    "direction": "whether the pressure was rising or falling",
    "repeat": "number of the repetition",
    "trial": "number of the trial",
    "slot": "points with the same slot were measured at equal conditions",
    "mounting": "number of the mounting of the specimen",
    "order": "number of the point in the order of measurement",
    "settled": "whether the reading stayed within its tolerance band",
    "n_samples": "number of samples in the measuring window",
}


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Attributes:
        name: as in the file.
        meaning: one sentence, without the unit.
        unit: symbol; empty for none.
        unit_code: address of the unit in the QUDT vocabulary; empty for none.
        uncertainty: name of the column with its standard uncertainty; empty for none.
    """

    name: str
    meaning: str
    unit: str = ""
    unit_code: str = ""
    uncertainty: str = ""


def described(names: list[str]) -> list[Column]:
    """The columns of a table, in its order.

    Args:
        names: of all columns of the table.
    """
    there = set(names)
    out = []
    for name in names:
        base, unit, code = _unit(_plain(name))
        uncertainty = f"u_{name}" if f"u_{name}" in there else ""
        out.append(Column(name, _meaning(name, base), unit, code, uncertainty))
    return out


def _plain(name: str) -> str:
    """A name without the marks of an uncertainty or a set value."""
    for part in ("_noise", "_cal"):
        if name.startswith("u_"):
            name = name.removesuffix(part)
    return name.removeprefix("u_").removeprefix("set_")


def _unit(name: str) -> tuple[str, str, str]:
    """The quantity, symbol and code of a name that ends in a unit."""
    if name in MEANINGS:
        return name, "", ""
    for suffix in sorted(UNITS, key=len, reverse=True):
        if name.endswith(f"_{suffix}"):
            symbol, code = UNITS[suffix]
            return name.removesuffix(f"_{suffix}"), symbol, QUDT + code
    return name, "", ""


def _meaning(name: str, base: str) -> str:
    text = MEANINGS.get(base, base.replace("_", " "))
    if name.startswith("set_"):
        return f"set value: {text}"
    if name.startswith("u_"):
        part = {"_noise": ", part of the noise", "_cal": ", part of the calibration"}
        kind = next((what for end, what in part.items() if name.endswith(end)), "")
        return f"standard uncertainty{kind}: {text}"
    return text
