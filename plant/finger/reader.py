"""Read a finger from TOML, and the valve blocks that come with the package."""

from __future__ import annotations

import difflib
import os
import tomllib
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

from plant import tomlfile
from plant.constants import PlantConstants, nominal
from plant.errors import PlantError
from plant.finger.body import Finger, Pair
from plant.links import load_arm

_KEYS = ("name", "arm", "stops", "pair")
_STOPS = {"stiffness_n_mm": (1e3, 1e-3, 1e4), "damping_n_s_mm": (1e3, 0.0, 10.0)}
_PAIR = {"pulley_radius_mm": (1e-3, 0.1, 1000.0), "length_mm": (1e-3, 1.0, 2000.0)}


def load_finger(source: str | Path | Mapping[str, Any] = "finger") -> Finger:
    """Read a finger from a TOML file, from a parsed table, or by the name of a shipped one.

    Raises:
        PlantError: names file, table and key, says what was expected and what came.
    """
    if isinstance(source, Mapping):
        return _finger(source, "finger table")
    table, origin = _table(str(source), "fingers", "finger")
    return _finger(table, origin)


def load_valve(source: str | Path = "thesis") -> PlantConstants:
    """The reference bench with the valve block of a TOML file, or of a shipped name.

    Raises `PlantError` as `PlantConstants.with_overrides` does, naming the file.
    """
    table, origin = _table(str(source), "valves", "valve block")
    return nominal().with_overrides(table, origin)


def valve_changes(source: str | Path) -> dict[str, Any]:
    """What a valve block changes of the reference bench, by plant-file key. Raises `PlantError`."""
    return _table(str(source), "valves", "valve block")[0]


def _names(folder: str) -> list[str]:
    entries = resources.files("configs").joinpath("plant", folder).iterdir()
    return sorted(e.name.removesuffix(".toml") for e in entries if e.name.endswith(".toml"))


def _table(source: str, folder: str, what: str) -> tuple[dict[str, Any], str]:
    path = Path(source)
    if path.suffix != ".toml" and not os.path.exists(path):
        known = _names(folder)
        if source not in known:
            near = difflib.get_close_matches(source, known, n=1)
            hint = f"did you mean {near[0]}?" if near else "give a .toml file or one of these"
            raise PlantError(
                f"{what} {source!r}: neither a file nor shipped; {hint} ({', '.join(known)})"
            )
        entry = resources.files("configs").joinpath("plant", folder, f"{source}.toml")
        text, origin = entry.read_text(encoding="utf-8"), f"shipped {what} {source}.toml"
    else:
        origin = f"{what} file {path}"
        try:
            text = tomlfile.read_text(path)
        except (OSError, UnicodeDecodeError) as error:
            raise PlantError(f"{origin}: cannot be read ({error}); check the path") from error
    try:
        return tomlfile.loads(text), origin
    except tomllib.TOMLDecodeError as error:
        raise PlantError(f"{origin}: not valid TOML ({error}); correct that line") from error


def _finger(table: Mapping[str, Any], origin: str) -> Finger:
    _known(table, _KEYS, origin)
    for key in ("name", "arm", "pair"):
        if key not in table:
            raise PlantError(f"{origin}: {key} is missing; known keys: {', '.join(_KEYS)}")
    rows = table["pair"]
    if not isinstance(rows, list) or not all(isinstance(row, Mapping) for row in rows):
        raise PlantError(f"{origin}: expected tables [[pair]], got {rows!r:.40}")
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
    _known(table, tuple(allowed), origin)
    read = {}
    for key, value in table.items():
        to_si, low, high = allowed[key]
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise PlantError(f"{origin}: {key} = {value!r}; expected a number {low:g} to {high:g}")
        if not low <= value <= high:
            raise PlantError(f"{origin}: {key} = {value!r} is out of range {low:g} to {high:g}")
        read[key] = value * to_si
    return read


def _known(table: Mapping[str, Any], known: tuple[str, ...], origin: str) -> None:
    for key in table:
        if key not in known:
            near = difflib.get_close_matches(key, known, n=1)
            hint = f"did you mean {near[0]}?" if near else f"known keys: {', '.join(known)}"
            raise PlantError(f"{origin}: unknown key {key!r}; {hint}")
