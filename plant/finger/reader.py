"""Read fingers and valve blocks from TOML files or by shipped name."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from plant import tomlfile
from plant.constants import PlantConstants, nominal
from plant.errors import PlantError
from plant.finger.body import Finger, Pair
from plant.links import load_arm
from plant.tomlfile import check_keys, number_in_range

_KEYS = ("name", "arm", "stops", "pair")
_STOPS = {"stiffness_n_mm": (1e3, 1e-3, 1e4), "damping_n_s_mm": (1e3, 0.0, 10.0)}
_PAIR = {"pulley_radius_mm": (1e-3, 0.1, 1000.0), "length_mm": (1e-3, 1.0, 2000.0)}


def load_finger(source: str | Path | Mapping[str, Any] = "finger") -> Finger:
    """Read a finger from a TOML file, from a parsed table, or by the name of a shipped one.

    Raises:
        PlantError: names file, table and key, the expected and the given value.
    """
    if isinstance(source, Mapping):
        return _finger(source, "finger table")
    return _finger(*tomlfile.load_table(source, "fingers", "finger"))


def load_valve(source: str | Path = "thesis") -> PlantConstants:
    """The reference bench with the valve block of a TOML file, or of a shipped name.

    Raises `PlantError` as `PlantConstants.with_overrides` does, naming the file.
    """
    table, origin = tomlfile.load_table(source, "valves", "valve block")
    return nominal().with_overrides(table, origin)


def valve_changes(source: str | Path) -> dict[str, Any]:
    """Constants of a valve block, by plant-file key. Raises `PlantError`."""
    return tomlfile.load_table(source, "valves", "valve block")[0]


def _finger(table: Mapping[str, Any], origin: str) -> Finger:
    check_keys(table, _KEYS, origin)
    for key in ("name", "arm", "pair"):
        if key not in table:
            raise PlantError(f"{origin}: {key} is missing; known keys: {', '.join(_KEYS)}")
    rows = table["pair"]
    if not isinstance(rows, list) or not all(isinstance(row, Mapping) for row in rows):
        raise PlantError(f"{origin}: expected tables [[pair]], got {rows!r:.40}")
    if not isinstance(table["arm"], (str, Mapping)):
        raise PlantError(f"{origin}: arm = {table['arm']!r:.40}; expected a name, file or table")
    arm = load_arm(table["arm"])
    pairs = tuple(_pair(row, f"{origin}, pair {i + 1}") for i, row in enumerate(rows))
    stops = table.get("stops", {})
    if not isinstance(stops, Mapping):
        raise PlantError(f"{origin}: stops = {stops!r}; expected a table")
    read = _numbers(stops, _STOPS, f"{origin} [stops]")
    try:
        return Finger(
            str(table["name"]),
            arm,
            pairs,
            read.get("stiffness_n_mm", 20e3),
            read.get("damping_n_s_mm", 20.0),
        )
    except PlantError as error:
        raise PlantError(f"{origin}: {error}") from None


def _pair(row: Mapping[str, Any], origin: str) -> Pair:
    joint = row.get("joint")
    if not isinstance(joint, str):
        raise PlantError(f"{origin}: joint = {joint!r}; expected the name of one of the arm's")
    rest = {key: value for key, value in row.items() if key != "joint"}
    read = _numbers(rest, _PAIR, f"{origin} ({joint})")
    for key in _PAIR:
        if key not in read:
            raise PlantError(f"{origin} ({joint}): {key} is missing; every pair states it")
    return Pair(joint, read["pulley_radius_mm"], read["length_mm"])


def _numbers(
    table: Mapping[str, Any], allowed: Mapping[str, tuple[float, float, float]], origin: str
) -> dict[str, float]:
    check_keys(table, allowed, origin)
    read = {}
    for key, value in table.items():
        to_si, low, high = allowed[key]
        read[key] = number_in_range(value, key, low, high, origin) * to_si
    return read
