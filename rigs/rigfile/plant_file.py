"""A plant file: constants and `[effects.<id>]`, as `pamrig gap shrink --out` writes them."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from daq.errors import ConfigError
from plant import tomlfile
from plant.constants import PlantConstants, nominal
from plant.effects.effects import Effects
from plant.effects.empirical import Corrections
from plant.errors import PlantError


def load_plant(path: Path) -> tuple[PlantConstants, Effects]:
    """Constants and `[effects.<id>]` of a plant file, over the nominal plant.

    A rig file serves as well: its `[virtual.plant]` and effects are taken. `[empirical.<block>]` is
    refused.

    Raises:
        ConfigError: the file cannot be read, or the plant refuses what it states.
    """
    try:
        table = tomlfile.loads(tomlfile.read_text(path))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigError(str(path), f"cannot be read as TOML ({error})") from None
    effects = table.pop("effects", {})
    empirical = table.pop("empirical", {})
    virtual = table.get("virtual")
    stated = virtual.get("plant", {}) if isinstance(virtual, dict) else table
    return _plant(stated, effects, empirical, str(path))


def _plant(
    stated: Any, effects: Any, empirical: Any, origin: str
) -> tuple[PlantConstants, Effects]:
    try:
        # What steps through time has no term that was learnt from readings.
        Corrections.from_config(empirical, f"{origin} empirical").refuse("a simulation in time")
        constants = nominal().with_overrides(stated, origin)
        return constants, Effects.from_config(effects, f"{origin} effects")
    except PlantError as error:
        raise ConfigError(origin, str(error).removeprefix(f"{origin}: ")) from None
