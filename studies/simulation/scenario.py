"""Reading and checking of scenario files: plant, load, muscles, firmware, commands."""

from __future__ import annotations

import math
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from daq.errors import ConfigError
from plant import tomlfile
from plant.constants import PlantConstants, shipped
from plant.effects.effects import Effects
from plant.errors import PlantError
from plant.models import catalogue as models
from plant.models.model import Model
from rigs.rigfile.plant_file import load_plant
from rigs.rigfile.toml_reader import Table, find_config, load_toml
from studies.simulation.mechanism import Mechanism, read_mechanism
from valvefw.config import bounds

SCHEMES = ("two", "duty_in", "duty", "slide", "ram", "burst", "pwm", "reg", "open", "idle")
LONGEST_S = 3600.0


@dataclass(frozen=True)
class MuscleSpec:
    """One muscle (or the ram's cylinder) with its valve and controller.

    `reach` by coordinate, m per m or m per rad; `parameters` of its firmware.
    """

    name: str
    constants: PlantConstants
    effects: Effects
    model: Model | None
    reach: Mapping[str, float]
    rest_m: float
    tendon: bool
    start_kpa: float
    parameters: Mapping[str, int]


@dataclass(frozen=True)
class Command:
    """At `at_s`, to one muscle or to all (""): `scheme`, `setpoint_kpa` or `pulse`."""

    at_s: float
    muscle: str
    kind: str
    value: str | float
    more: tuple[int, ...] = ()


@dataclass(frozen=True)
class Window:
    """A time window whose means are a settled point."""

    at_s: float
    seconds: float
    settled: bool = True


@dataclass(frozen=True)
class SensorSpec:
    """Noise (1 sd), errors, resolution, rates and delays of the sensors."""

    pressure_noise_kpa: float
    pressure_zero_kpa: float
    pressure_gain: float
    pressure_range_kpa: float
    force_noise_n: float
    force_step_n: float
    force_rate_hz: float
    place_noise: float
    place_step: float
    place_rate_hz: float
    place_delay_s: float


@dataclass(frozen=True)
class Scenario:
    """All inputs of a simulation; `source` and `text` are those of its file."""

    name: str
    description: str
    duration_s: float
    seed: int
    temperature_c: float
    mechanism: Mechanism
    muscles: tuple[MuscleSpec, ...]
    commands: tuple[Command, ...]
    windows: tuple[Window, ...]
    sensors: SensorSpec
    step_share: float
    source: str
    text: str

    @property
    def crc32(self) -> str:
        """CRC-32 of the file."""
        return f"{zlib.crc32(self.text.encode()):08x}"


def load_scenario(name: str, plant: Path | None = None) -> Scenario:
    """Read a scenario file, by path or by the name of a shipped one.

    A `plant` file (constants and effects, from `pamrig gap shrink`) replaces plant and effects of
    the scenario, except those of single muscles.

    Raises:
        ConfigError: states file and key: an unknown key or joint, a value of the wrong type or
            out of range, or an impossible mass, inertia, length or parameter.
    """
    t = load_toml(name, "scenarios")
    text, _ = find_config(name, "scenarios")
    constants = _constants(t)
    effects = _effects(t, "effects")
    if plant is not None:
        constants, effects = load_plant(plant)
        # The run stores the text of its scenario: add the plant that replaced the original one.
        used = tomlfile.read_text(plant).splitlines()
        text = "\n".join([text.rstrip(), f"# plant taken from {plant}:", *("# " + x for x in used)])
    mechanism = read_mechanism(t, constants, effects)
    muscles = _muscles(t, constants, effects, mechanism)
    duration = t.number("duration_s", 1e-3, LONGEST_S, unit="s")
    scenario = Scenario(
        name=t.text("name"),
        description=t.text("description", ""),
        duration_s=duration,
        seed=t.integer("seed", 0, 2**31 - 1, 1),
        temperature_c=t.number("temperature_c", -20, 80, 21.0, unit="°C"),
        mechanism=mechanism,
        muscles=muscles,
        commands=_commands(t, muscles, duration),
        windows=_windows(t, duration),
        sensors=_sensors(t, mechanism),
        step_share=t.number("step_share", 0.01, 1.0, 1.0),
        source=t.source,
        text=text,
    )
    t.finish()
    return scenario


def rows(t: Table, key: str) -> list[Table]:
    """The tables of an array [[key]], each with its position for messages."""
    found = t.raw(key, [])
    if not isinstance(found, list) or not all(isinstance(row, dict) for row in found):
        raise t.fail(key, f"expected tables [[{key}]], got {found!r:.60}")
    return [Table(row, t.source, f"{key}[{i + 1}]") for i, row in enumerate(found)]


def _constants(t: Table) -> PlantConstants:
    try:
        base = shipped(t.text("plant_base", "thesis"))
    except PlantError as error:
        raise t.fail("plant_base", str(error)) from None
    try:
        return base.with_overrides(_table(t, "plant"), f"{t.source}: plant")
    except PlantError as error:
        raise _plain(error) from None


def _effects(t: Table, key: str) -> Effects:
    try:
        return Effects.from_config(_table(t, key), f"{t.source}: {key}")
    except PlantError as error:
        raise _plain(error) from None


def _table(t: Table, key: str) -> dict[str, Any]:
    """A parsed table for another package."""
    found = t.raw(key, {})
    if not isinstance(found, dict):
        raise t.fail(key, f"expected a table, got {found!r:.60}")
    return found


def _plain(error: PlantError) -> ConfigError:
    where, _, what = str(error).partition(": ")
    rest, _, remedy = what.partition("; ")
    return ConfigError(where, rest or str(error), remedy)


def _muscles(
    t: Table, constants: PlantConstants, effects: Effects, mechanism: Mechanism
) -> tuple[MuscleSpec, ...]:
    found = []
    shared = t.table("controller", optional=True)
    for row in rows(t, "muscle"):
        found.append(_muscle(row, shared, constants, effects, mechanism))
    shared.raw("parameters")
    shared.finish()
    if not found:
        raise t.fail("muscle", "the scenario has no muscle", "add a table [[muscle]]")
    names = [m.name for m in found]
    for name in names:
        if names.count(name) > 1:
            raise t.fail("muscle", f"more than one is named {name!r}", "use unique names")
    if mechanism.single and len(found) > 1:
        raise t.fail("muscle", f"load.kind = {mechanism.kind!r} takes one, got {len(found)}")
    return tuple(found)


def _muscle(
    row: Table, shared: Table, constants: PlantConstants, effects: Effects, mechanism: Mechanism
) -> MuscleSpec:
    name = row.text("name")
    if not name.strip():
        raise row.fail("name", "is empty", "commands and streams need the name")
    try:
        own = constants.with_overrides(_table(row, "plant"), f"{row.source}: {row.path}.plant")
        model = None
        if "model" in row:
            if mechanism.kind == "ram":
                raise row.fail("model", "a ram has no muscle model", "leave it out")
            chosen = row.text("model")
            try:
                model = models.load(chosen)
            except PlantError as error:
                raise row.fail("model", str(error)) from None
        if "effects" in row:
            effects = Effects.from_config(
                _table(row, "effects"), f"{row.source}: {row.path}.effects"
            )
    except PlantError as error:
        raise _plain(error) from None
    reach, rest, tendon = mechanism.attach(row, own)
    if model is None and tendon:
        _check_range(row, own, mechanism, reach, rest)
    parameters: dict[str, int] = {}
    for table in (shared, row):
        parameters.update(_parameters(table))
    spec = MuscleSpec(
        name,
        mechanism.chamber(own),
        effects,
        model,
        reach,
        rest,
        tendon,
        row.number("start_kpa", 0, 1000, 0.0, unit="kPa"),
        parameters,
    )
    row.finish()
    return spec


def _check_range(
    row: Table,
    c: PlantConstants,
    mechanism: Mechanism,
    reach: Mapping[str, float],
    rest_m: float,
) -> None:
    """Raise ConfigError if the range of a joint exceeds the length range of the muscle.

    Models of other muscles have their own length range in their tables.
    """
    assert mechanism.arm is not None
    for joint, radius in reach.items():
        link = mechanism.arm.links[mechanism.arm.joint(joint)]
        ends = [rest_m + radius * angle for angle in (link.low_rad, link.high_rad)]
        if not all(map(math.isfinite, ends)):
            continue  # a joint without a range is limited by the muscles
        low, high = min(ends) * 1e3, max(ends) * 1e3
        least, most = c.length_min_m * 1e3, c.length_max_m * 1e3
        if low < least or high > most:
            raise row.fail(
                "rest_mm",
                f"the range of joint {joint!r} would take the muscle from {low:.1f} to {high:.1f} "
                f"mm, outside the braid's {least:g} to {most:g}",
                "change rest_mm, radius_mm or the joint's range_deg",
            )


def _parameters(table: Table) -> dict[str, int]:
    given = table.raw("parameters", {})
    if not isinstance(given, dict):
        raise table.fail("parameters", f"expected a table of firmware parameters, got {given!r}")
    for key, value in given.items():
        limits = bounds(key)
        if limits is None:
            raise table.fail(
                f"parameters.{key}", "the firmware has no such parameter", "see the wire format"
            )
        if isinstance(value, bool) or not isinstance(value, int):
            raise table.fail(f"parameters.{key}", f"expected a whole number, got {value!r}")
        if not limits[0] <= value <= limits[1]:
            raise table.fail(f"parameters.{key}", f"{value} is outside {limits[0]} to {limits[1]}")
    return dict(given)


def _commands(t: Table, muscles: tuple[MuscleSpec, ...], duration: float) -> tuple[Command, ...]:
    names = [m.name for m in muscles]
    found = []
    for row in rows(t, "command"):
        at = row.number("at_s", 0.0, duration, unit="s")
        muscle = row.text("muscle", "")
        if muscle and muscle not in names:
            raise row.fail("muscle", f"no muscle named {muscle!r}", f"known: {', '.join(names)}")
        kinds = [key for key in ("scheme", "setpoint_kpa", "pulse") if key in row]
        if len(kinds) != 1:
            raise row.fail("at_s", "expected one of scheme, setpoint_kpa, pulse beside it")
        kind = kinds[0]
        more: tuple[int, ...] = ()
        value: str | float
        if kind == "scheme":
            value = row.text("scheme", choices=SCHEMES)
        elif kind == "setpoint_kpa":
            value = row.number("setpoint_kpa", 0, 1000, unit="kPa")
        else:
            value = row.text("pulse", choices=("inlet", "outlet"))
            more = (
                5 * round(row.number("width_ms", 0.005, 1000, unit="ms") * 200),
                row.integer("count", 1, 10_000, 1),
                1000 * round(row.number("period_ms", 1, 10_000, 100.0, unit="ms")),
            )
        found.append(Command(at, muscle, kind, value, more))
        row.finish()
    return tuple(sorted(found, key=lambda c: c.at_s))


def _windows(t: Table, duration: float) -> tuple[Window, ...]:
    found = []
    for row in rows(t, "measure"):
        at = row.number("at_s", 0.0, duration, unit="s")
        window = Window(
            at,
            row.number("seconds", 0.05, duration, 0.5, unit="s"),
            row.flag("settled", True),
        )
        if at + window.seconds > duration + 1e-9:
            raise row.fail("seconds", f"the window ends after duration_s = {duration:g}")
        found.append(window)
        row.finish()
    return tuple(sorted(found, key=lambda w: w.at_s))


def _sensors(t: Table, mechanism: Mechanism) -> SensorSpec:
    s = t.table("sensors", optional=True)
    unit = mechanism.unit
    noise = {"mm": 0.01, "deg": 0.05}[unit]
    step = {"mm": 0.001, "deg": 360.0 / 4096}[unit]
    spec = SensorSpec(
        pressure_noise_kpa=s.number("pressure_noise_kpa", 0, 100, 0.5, unit="kPa"),
        pressure_zero_kpa=s.number("pressure_zero_kpa", -50, 50, 0.0, unit="kPa"),
        pressure_gain=s.number("pressure_gain_percent", -20, 20, 0.0, unit="%") / 100.0,
        pressure_range_kpa=s.number("pressure_range_kpa", 100, 2000, 1000.0, unit="kPa"),
        force_noise_n=s.number("force_noise_n", 0, 10, 0.05, unit="N"),
        force_step_n=s.number("force_step_n", 1e-6, 10, 0.01, unit="N"),
        force_rate_hz=s.number("force_rate_hz", 1, 1000, 80.0, unit="Hz"),
        place_noise=s.number(f"place_noise_{unit}", 0, 10, noise, unit=unit),
        place_step=s.number(f"place_step_{unit}", 1e-6, 10, step, unit=unit),
        place_rate_hz=s.number("place_rate_hz", 1, 1000, 50.0, unit="Hz"),
        place_delay_s=s.number("place_delay_ms", 0, 1000, 0.0, unit="ms") * 1e-3,
    )
    s.finish()
    return spec


def plant_refusal(error: PlantError, source: str) -> ConfigError:
    """An error of the plant as an error of the scenario file."""
    what, _, remedy = str(error).partition("; ")
    return ConfigError(source, what, remedy)


def as_plain(scenario: Scenario) -> dict[str, Any]:
    """The main values of the scenario for the record, which also has the text of the file."""
    return {
        "name": scenario.name,
        "description": scenario.description,
        "duration_s": scenario.duration_s,
        "seed": scenario.seed,
        "load": scenario.mechanism.kind,
        "coordinates": list(scenario.mechanism.names),
        "muscles": [m.name for m in scenario.muscles],
        "models": [m.model.name if m.model else "braid" for m in scenario.muscles],
        "step_share": scenario.step_share,
    }
