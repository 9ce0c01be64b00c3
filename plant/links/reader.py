"""Read an arm from TOML; unknown keys and values out of range are errors."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from plant import tomlfile
from plant.errors import LinkError
from plant.links.arm import Arm, Link, check_name
from plant.links.inertia import Six, Three, rod_inertia
from plant.tomlfile import check_keys, number_in_range

MAX_LINKS = 100

_DEG = math.pi / 180.0
# Key: conversion to SI, lowest, highest; in the key's own unit.
_NUMBERS: dict[str, tuple[float, float, float]] = {
    "a_mm": (1e-3, -10_000.0, 10_000.0),
    "alpha_deg": (_DEG, -360.0, 360.0),
    "d_mm": (1e-3, -10_000.0, 10_000.0),
    "offset_deg": (_DEG, -360.0, 360.0),
    "mass_g": (1e-3, 0.0, 1e6),
    "damping_n_m_s": (1.0, 0.0, 1e4),
    "rod_diameter_mm": (1e-3, 0.0, 1e4),
}
_LISTS: dict[str, tuple[int, float, float]] = {
    "com_mm": (3, -10_000.0, 10_000.0),
    "inertia_g_mm2": (6, -1e15, 1e15),
    "range_deg": (2, -36_000.0, 36_000.0),
}
_LINK_KEYS = ("joint", *_NUMBERS, *_LISTS)
_ARM_KEYS = ("name", "gravity_m_s2", "link")


def load_arm(source: str | Path | Mapping[str, Any]) -> Arm:
    """Read an arm from a TOML file, from a parsed table, or by the name of a shipped one.

    Raises:
        LinkError: names file, link and key, the expected and the given value.
    """
    if isinstance(source, Mapping):
        return _arm(source, "arm table")
    return _arm(*tomlfile.load_table(source, "links", "arm", LinkError))


def _arm(table: Mapping[str, Any], origin: str) -> Arm:
    check_keys(table, _ARM_KEYS, origin, LinkError)
    name = table.get("name")
    _word("name", name, "finger", origin)
    rows = table.get("link")
    if not isinstance(rows, list) or not 1 <= len(rows) <= MAX_LINKS:
        raise LinkError(f"{origin}: expected 1 to {MAX_LINKS} tables [[link]], got {rows!r:.40}")
    gravity = table.get("gravity_m_s2")
    if gravity is None:
        raise LinkError(f"{origin}: gravity_m_s2 is missing; state it, [0, 0, 0] for none")
    x, y, z = _list(gravity, "gravity_m_s2", 3, -100.0, 100.0, origin)
    links = tuple(_link(row, f"{origin}, link {i + 1}") for i, row in enumerate(rows))
    try:
        return Arm(str(name), links, (x, y, z))
    except LinkError as error:
        raise LinkError(f"{origin}: {error}") from None


def _link(row: object, origin: str) -> Link:
    if not isinstance(row, Mapping):
        raise LinkError(f"{origin}: expected a table, got {row!r}")
    joint = row.get("joint")
    _word("joint", joint, "flexion", origin)
    origin = f"{origin} ({joint})"
    check_keys(row, _LINK_KEYS, origin, LinkError)
    for key in ("a_mm", "mass_g"):
        if key not in row:
            raise LinkError(f"{origin}: {key} is missing; every link states its length and mass")
    value = {key: _number(row[key], key, origin) for key in _NUMBERS if key in row}
    length, mass = value["a_mm"], value["mass_g"]
    com, inertia = _body(row, length, mass, value, origin)
    low, high = -math.inf, math.inf
    if "range_deg" in row:
        ends = _list(row["range_deg"], "range_deg", *_LISTS["range_deg"], origin)
        low, high = ends[0] * _DEG, ends[1] * _DEG
    try:
        return Link(
            str(joint),
            length,
            value.get("alpha_deg", 0.0),
            value.get("d_mm", 0.0),
            value.get("offset_deg", 0.0),
            mass,
            com,
            inertia,
            value.get("damping_n_m_s", 0.0),
            low,
            high,
        )
    except LinkError as error:
        raise LinkError(f"{origin}: {error}") from None


def _word(key: str, value: object, example: str, origin: str) -> None:
    try:
        check_name(key, value, example)
    except LinkError as error:
        raise LinkError(f"{origin}: {error}") from None


def _body(
    row: Mapping[str, Any], length: float, mass: float, value: Mapping[str, float], origin: str
) -> tuple[Three, Six]:
    """Centre of mass and tensor, from the diameter of a rod or from explicit values."""
    stated = [key for key in ("com_mm", "inertia_g_mm2") if key in row]
    if "rod_diameter_mm" in value:
        if stated:
            raise LinkError(
                f"{origin}: {' and '.join(stated)} contradict rod_diameter_mm; state either the "
                "rod or the body"
            )
        return (-length / 2.0, 0.0, 0.0), rod_inertia(mass, length, value["rod_diameter_mm"])
    if mass == 0.0 and not stated:
        return (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    if len(stated) < 2:
        raise LinkError(
            f"{origin}: a link with mass needs rod_diameter_mm, or com_mm = [x, y, z] and "
            "inertia_g_mm2 = [xx, yy, zz, xy, xz, yz] about the centre of mass"
        )
    com = _list(row["com_mm"], "com_mm", *_LISTS["com_mm"], origin)
    six = _list(row["inertia_g_mm2"], "inertia_g_mm2", *_LISTS["inertia_g_mm2"], origin)
    return (com[0] * 1e-3, com[1] * 1e-3, com[2] * 1e-3), tuple(v * 1e-9 for v in six)  # type: ignore[return-value]


def _number(value: object, key: str, origin: str) -> float:
    to_si, low, high = _NUMBERS[key]
    if key == "mass_g" and isinstance(value, (int, float)) and value < 0:
        raise LinkError(f"{origin}: negative mass, mass_g = {value!r}; a link has mass 0 or more")
    return number_in_range(value, key, low, high, origin, LinkError) * to_si


def _list(
    value: object, key: str, count: int, low: float, high: float, origin: str
) -> tuple[float, ...]:
    if not isinstance(value, (list, tuple)) or len(value) != count:
        raise LinkError(f"{origin}: {key} = {value!r}; expected a list of {count} numbers")
    return tuple(
        number_in_range(v, f"{key}[{i}]", low, high, origin, LinkError) for i, v in enumerate(value)
    )
