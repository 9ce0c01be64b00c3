"""Keys of the files that are read as plain tables: from the lists that their readers check against.

Which keys are needed is found by leaving each one out of an example and reading it again.
"""

from __future__ import annotations

import copy
import dataclasses
import json
import tempfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from daq.calibration import Calibration
from daq.errors import PamrigError
from docs.make.asked import HOUSE, REQUIRED, type_of
from docs.make.row import Row, number
from gap.data.dataset import CALIBRATION
from gap.errors import GapError
from gap.simulators import description
from plant import tomlfile
from plant.constants import CHOICES, KEYS, load_constants
from plant.effects.catalogue import CATALOGUE
from plant.effects.empirical import Corrections
from plant.errors import PlantError
from plant.finger import reader as fingers
from plant.links import reader as links
from plant.models import catalogue as models
from rigs.calibration.camera import read_gauge_table
from rigs.rigfile.camera_calibration import load_camera_calibration
from rigs.rigfile.tables.marks import load_pose_camera
from valvefw.config import PARAMETERS
from vision.marker.lens import Lens
from vision.pose.camera import Plane, PoseCamera

EXAMPLES = Path(__file__).with_name("examples") / "plain"
PLANT = HOUSE / "configs" / "plant"
Known = dict[str, Mapping[str, str]]
"""Table -> key -> range, "" where the reader states none."""
COVARIANCE = {"names": "", "matrix": ""}


def plain(*keys: str) -> dict[str, str]:
    """Keys without a stated range."""
    return dict.fromkeys(keys, "")


def between(low: float, high: float) -> str:
    """A range, in words."""
    return f"{number(low)} to {number(high)}"


@dataclasses.dataclass(frozen=True)
class Plain:
    """A kind of file that is read as plain tables.

    Attributes:
        kind: of file.
        known: keys that the reader knows.
        files: examples; each key occurs in one of them.
        read: the reader.
    """

    kind: str
    known: Known
    files: tuple[Path, ...]
    read: Callable[[Path], object]


def _simulator(path: Path) -> object:
    about = description.read_description(path)
    return about.covariance(about.parameters())


def _empirical(path: Path) -> object:
    return Corrections.from_config(tomlfile.loads(tomlfile.read_text(path)).get("empirical", {}))


def _simulator_keys() -> Known:
    own = {key: f'kind = "{kind}"' for kind, keys in description.KINDS.items() for key in keys}
    twice = {key for keys in description.KINDS.values() for key in keys
             if sum(key in other for other in description.KINDS.values()) > 1}  # fmt: skip
    own = {key: "" if key in twice else kind for key, kind in own.items()}
    extra = {key for keys in description.PARAMETER_KEYS.values() for key in keys}
    return {
        "": {**plain(*description.SHARED), "kind": ", ".join(description.KINDS), **own},
        "parameters.NAME": plain("nominal", "tolerance", *sorted(extra)),
        "inputs": plain(*description.INPUTS),
        "covariance": COVARIANCE,
        "variables.NAME": plain("name", "factor", "offset"),
    }


def plain_kinds() -> tuple[Plain, ...]:
    """All kinds of files that are read as plain tables."""
    return (
        Plain(
            "plant",
            {
                "": {**{k.name: between(k.low, k.high) for k in KEYS.values()},
                     **{key: ", ".join(words) for key, words in CHOICES.items()}, "tolerance": ""},
            },
            (PLANT / "thesis.toml", EXAMPLES / "plant-cylinder.toml"),
            load_constants,
        ),
        Plain(
            "arm",
            {
                "": plain(*(key for key in links._ARM_KEYS if key != "link")),
                "link[]": {
                    **plain("joint"),
                    **{k: between(low, high) for k, (_, low, high) in links._NUMBERS.items()},
                    **{k: f"{n} numbers, {between(low, high)}"
                       for k, (n, low, high) in links._LISTS.items()},
                },
            },
            (PLANT / "links" / "finger.toml", EXAMPLES / "arm.toml"),
            links.load_arm,
        ),
        Plain(
            "finger",
            {
                "": plain(*(k for k in fingers._KEYS if k not in ("stops", "pair"))),
                "stops": {k: between(low, high) for k, (_, low, high) in fingers._STOPS.items()},
                "pair[]": {
                    **plain("joint"),
                    **{k: between(low, high) for k, (_, low, high) in fingers._PAIR.items()},
                },
            },
            (PLANT / "fingers" / "finger.toml",),
            fingers.load_finger,
        ),
        Plain(
            "model",
            {
                "": {
                    **plain(*(k for k in models._TOP
                              if k not in ("domain", "geometry", "parameters", "covariance"))),
                    "law": "as `pamrig models list` lists", "version": str(models.VERSION),
                },
                "domain": plain(*models._DOMAIN),
                "geometry": {k: between(0.1, models.LARGEST_MM) for k in models._GEOMETRY},
                "parameters.NAME": plain(*models._PARAMETER),
                "covariance": COVARIANCE,
            },
            (PLANT / "models" / "liner-braid.toml", EXAMPLES / "model.toml"),
            models.load,
        ),
        Plain(
            "camera-calibration",
            {
                "calibration": plain(*(f.name for f in dataclasses.fields(Calibration))),
                "lens": plain(*(f.name for f in dataclasses.fields(Lens))),
                "off_plane": plain("per_mm", "u_per_mm", "u_mm"),
            },
            (EXAMPLES.parent / "calibrations" / "camera.toml",),
            load_camera_calibration,
        ),
        Plain(
            "pose-camera",
            {
                "pose_camera": plain(*(f.name for f in dataclasses.fields(PoseCamera)
                                       if f.name != "plane")),
                "pose_camera.plane": plain(*(f.name for f in dataclasses.fields(Plane))),
            },
            (EXAMPLES.parent / "pose-cameras" / "camera.toml",),
            load_pose_camera,
        ),
        Plain(
            "gauges",
            {"position[]": plain("file", "length_mm", "u_mm")},
            (EXAMPLES / "gauges.toml",),
            read_gauge_table,
        ),
        Plain(
            "uncertainty",
            {"": plain(*CALIBRATION)},
            (EXAMPLES / "uncertainty.toml",),
            lambda path: None,
        ),
        Plain(
            "empirical",
            {
                "empirical.NAME": plain("unit"),
                "empirical.NAME.terms[]": plain(
                    "inputs", "knots", "coefficients", "scale", "period"
                ),
            },
            (EXAMPLES / "empirical.toml",),
            _empirical,
        ),
        Plain(
            "simulator",
            _simulator_keys(),
            tuple(sorted(EXAMPLES.glob("simulator-*.toml"))),
            _simulator,
        ),
    )  # fmt: skip


def plain_rows() -> Iterator[Row]:
    """One row a key of the files that are read as plain tables."""
    for one in plain_kinds():
        tables = [tomlfile.loads(tomlfile.read_text(path)) for path in one.files]
        found = {where: value for table in tables for where, value in _values(table, "")}
        needed = _needed(one, tables)
        for table, keys in one.known.items():
            for key, limits in keys.items():
                path = f"{table}.{key}" if table else key
                if any(other == path or other.startswith(f"{path}.") for other in one.known):
                    continue  # has a section of its own
                if (table, key) not in found:
                    raise LookupError(f"{one.kind}: no example has {table or 'root'}.{key}")
                form = type_of(found[table, key])
                default = REQUIRED if (table, key) in needed else ""
                yield Row(one.kind, table, key, form, limits, default)


def listed_rows() -> Iterator[Row]:
    """Rows that state their meaning themselves: effects and firmware parameters."""
    for effect in CATALOGUE.values():
        for p in effect.parameters:
            limits = ", ".join(p.choices) or f"{between(p.low, p.high)} {p.unit}".strip()
            default = REQUIRED if p.default is None else f"{p.default}"
            form = "text" if p.choices else "number"
            yield Row("effects", f"effects.{effect.id}", p.name, form, limits, default, p.meaning)
    for key, usual, low, high, meaning in PARAMETERS:
        yield Row("firmware", "", key, "whole number", between(low, high), f"{usual}", meaning)


def _values(table: Mapping[str, Any], path: str) -> Iterator[tuple[tuple[str, str], Any]]:
    """Every value of a table by place; what a user names is NAME."""
    for key, value in table.items():
        yield (path, key), value
        if isinstance(value, Mapping):
            yield from _values(value, _named(f"{path}.{key}" if path else key))
        elif isinstance(value, list):
            for row in value:
                if isinstance(row, Mapping):
                    yield from _values(row, f"{path}.{key}[]" if path else f"{key}[]")


def _rows(table: Mapping[str, Any], path: str) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Every table within a table, with its place."""
    for (above, key), value in _values(table, path):
        where = f"{above}.{key}" if above else key
        if isinstance(value, Mapping):
            yield _named(where), value
        elif isinstance(value, list):
            yield from ((f"{where}[]", row) for row in value if isinstance(row, Mapping))


def _named(path: str) -> str:
    head, dot, _ = path.partition(".")
    if dot and head in ("parameters", "variables", "empirical"):
        return f"{head}.NAME"
    return path


def _needed(one: Plain, tables: list[dict[str, Any]]) -> set[tuple[str, str]]:
    """Keys that no example lacks, and without which none can be read."""
    can: dict[tuple[str, str], bool] = {
        (place, key): True
        for table in tables
        for place, row in [("", table), *_rows(table, "")]
        for key in one.known.get(place, {})
        if key not in row
    }
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "example.toml"
        for table in tables:
            for place, less in _without(table, table, ""):
                file.write_text(toml_text(less), "utf-8")
                try:
                    one.read(file)
                    can[place] = True
                except (PlantError, PamrigError, GapError):
                    can.setdefault(place, False)
    return {place for place, read in can.items() if not read}


def _without(
    whole: dict[str, Any], table: Mapping[str, Any], path: str
) -> Iterator[tuple[tuple[str, str], dict[str, Any]]]:
    """The whole table without one key, for every key in turn."""
    for place, holder, key in _places(table, path):
        kept = holder.pop(key)
        yield (place, key), copy.deepcopy(whole)
        holder[key] = kept


def _places(table: Any, path: str) -> Iterator[tuple[str, dict[str, Any], str]]:
    for key in list(table):
        value = table[key]
        yield path, table, key
        if isinstance(value, dict):
            yield from _places(value, _named(f"{path}.{key}" if path else key))
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            yield from _places(value[0], f"{path}.{key}[]" if path else f"{key}[]")


def toml_text(table: Mapping[str, Any]) -> str:
    """A table as TOML, tables within as inline tables."""
    return "".join(f"{json.dumps(key)} = {_inline(value)}\n" for key, value in table.items())


def _inline(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{json.dumps(k)} = {_inline(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_inline, value)) + "]"
    if isinstance(value, bool):
        return "true" if value else "false"
    return json.dumps(value) if isinstance(value, str) else repr(value)
