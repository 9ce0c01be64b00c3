"""All models by name, and model files: TOML with values, units, bounds, domain and data hash."""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

from plant import tomlfile
from plant.errors import PlantError
from plant.models import terms
from plant.models.braid import ChouHannaford, Hasselroth, TonduLopez, TonduLopezPressure
from plant.models.caldwell import Caldwell
from plant.models.law import Law
from plant.models.memory import Creep, MaxwellSlip, PrandtlIshlinskii
from plant.models.model import Domain, Geometry, Model, Parameter
from plant.models.rubber import BraidBladder, Fluidic, LinerBraid, Sarosi, SarosiFive
from plant.models.uncertainty import covariance_lines, read_covariance
from plant.models.units import to_si

VERSION = 1
LAWS: dict[str, Law] = {
    "chou-hannaford": ChouHannaford(),
    "caldwell": Caldwell(),
    "hasselroth": Hasselroth(),
    "black-box-low": terms.BLACK_BOX_LOW,
    "black-box-high": terms.BLACK_BOX_HIGH,
    "black-box": terms.BLACK_BOX,
    "black-box-low-t": terms.BLACK_BOX_LOW_T,
    "black-box-high-t": terms.BLACK_BOX_HIGH_T,
    "black-box-t": terms.BLACK_BOX_T,
    "quasi-static-low": terms.QUASI_STATIC_LOW,
    "quasi-static-high": terms.QUASI_STATIC_HIGH,
    "quasi-static": terms.QUASI_STATIC,
    "tondu-lopez": TonduLopez(),
    "tondu-lopez-kp": TonduLopezPressure(),
    "sarosi": Sarosi(),
    "sarosi-five": SarosiFive(),
    "fluidic": Fluidic(),
    "braid-bladder": BraidBladder(),
    "liner-braid": LinerBraid(),
    "prandtl-ishlinskii": PrandtlIshlinskii(terms.QUASI_STATIC),
    "maxwell-slip": MaxwellSlip(terms.QUASI_STATIC),
    "creep": Creep(terms.QUASI_STATIC),
}
"""All laws; a model file names one of them."""

_NUMBERS = ("value", "low", "high")
_TOP = (
    "name", "title", "law", "equations", "source", "version", "data", "data_sha256", "notes",
    "noise_n", "model_error_n", "domain", "geometry", "parameters", "covariance",
)  # fmt: skip
_DOMAIN = ("pressure_kpa", "length_mm", "temperature_c")
_GEOMETRY = ("rest_length_mm", "diameter_mm")
_PARAMETER = (*_NUMBERS, "unit", "sd", "fixed", "meaning")
LARGEST_MM = 1e5


def names() -> tuple[str, ...]:
    """Names of the shipped models: simple models first, laws with memory last."""
    return tuple(LAWS)


def get(name: str) -> Model:
    """A shipped model with its shipped values. Raises `PlantError` if unknown."""
    if name not in LAWS:
        from difflib import get_close_matches

        near = get_close_matches(name, LAWS, n=1)
        hint = f"did you mean {near[0]}?" if near else f"known: {', '.join(LAWS)}"
        raise PlantError(f"no model {name!r}; {hint}")
    file = resources.files("configs").joinpath("plant", "models", f"{name}.toml")
    return _model(_parse(file.read_text(encoding="utf-8"), file.name), f"shipped {file.name}")


def load(source: str | Path) -> Model:
    """A shipped model by name, or a model file by path. `PlantError` names an invalid key."""
    text = str(source)
    if not text.endswith(".toml"):
        return get(text)
    path = Path(source)
    try:
        raw = tomlfile.read_text(path)
    except (OSError, UnicodeDecodeError) as error:
        raise PlantError(f"model file {path}: cannot be read ({error})") from error
    return _model(_parse(raw, str(path)), f"model file {path}")


def to_toml(model: Model, heading: str = "") -> str:
    """Text of a model file; `load` reads back an equal model."""
    law = next(name for name, law in LAWS.items() if law is model.law)
    lines = [f"# {line}" for line in heading.splitlines()]
    lines += [f"name = {_text(model.name)}", f"title = {_text(model.title)}", f"law = {_text(law)}"]
    lines += [f"equations = [{', '.join(_text(e) for e in model.equations)}]"]
    lines += [f"source = {_text(model.source)}", f"version = {model.version}"]
    lines += [f"data = {_text(model.data)}", f"data_sha256 = {_text(model.data_sha256)}"]
    lines += ["notes = [", *(f"    {_text(note)}," for note in model.notes), "]"]
    for key in ("noise_n", "model_error_n"):
        if getattr(model, key) is not None:
            lines.append(f"{key} = {_number(getattr(model, key))}")
    lines += ["", "[domain]"]
    for axis in _DOMAIN:
        low, high = getattr(model.domain, axis)
        lines.append(f"{axis} = [{_number(low)}, {_number(high)}]")
    if model.geometry is not None:
        lines += ["", "[geometry]"]
        lines += [f"{key} = {_number(getattr(model.geometry, key))}" for key in _GEOMETRY]
    for p in model.parameters:
        lines += ["", f"[parameters.{p.name}]"]
        lines += [f"value = {_number(p.value)}", f"unit = {_text(p.unit)}"]
        lines += [f"low = {_number(p.low)}", f"high = {_number(p.high)}"]
        if p.sd is not None:
            lines.append(f"sd = {_number(p.sd)}")
        if p.fixed:
            lines.append("fixed = true")
        lines.append(f"meaning = {_text(p.meaning)}")
    if model.covariance is not None:
        lines += covariance_lines(model.covariance)
    return "\n".join(lines) + "\n"


def _text(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)


def _number(value: float) -> str:
    text = repr(float(value))
    return text if any(c in text for c in ".enia") else text + ".0"


def _parse(text: str, origin: str) -> dict[str, Any]:
    try:
        return tomlfile.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise PlantError(f"{origin}: not valid TOML ({error})") from error


def _model(table: Mapping[str, Any], origin: str) -> Model:
    law_name = table.get("law")
    if not isinstance(law_name, str) or law_name not in LAWS:
        raise PlantError(f"{origin}: law = {law_name!r}; known: {', '.join(LAWS)}")
    if table.get("version") != VERSION:
        raise PlantError(
            f"{origin}: version = {table.get('version')!r}, this program reads {VERSION}; "
            "fit the model again"
        )
    tomlfile.check_keys(table, _TOP, origin)
    law = LAWS[law_name]
    given = _within(table, "parameters", origin)
    if set(given) != set(law.parameters):
        missing = [n for n in law.parameters if n not in given]
        extra = [n for n in given if n not in law.parameters]
        raise PlantError(
            f"{origin}: parameters of {law_name} are {', '.join(law.parameters)}"
            f"{'; missing ' + ', '.join(missing) if missing else ''}"
            f"{'; unknown ' + ', '.join(extra) if extra else ''}"
        )
    domain = _within(table, "domain", origin)
    tomlfile.check_keys(domain, _DOMAIN, f"{origin} [domain]")
    pressure, length, temperature = (_range(domain, axis, origin) for axis in _DOMAIN)
    parameters = tuple(
        _parameter(n, _within(given, n, f"{origin} [parameters]"), origin) for n in law.parameters
    )
    covariance = None
    if "covariance" in table:
        stated = {p.name: p.sd for p in parameters if p.sd is not None}
        covariance = read_covariance(
            _within(table, "covariance", origin), law.parameters, stated, origin
        )
    return Model(
        name=str(table.get("name", law_name)),
        title=str(table.get("title", "")),
        law=law,
        parameters=parameters,
        domain=Domain(pressure, length, temperature),
        equations=_texts(table, "equations", origin),
        source=str(table.get("source", "")),
        data=str(table.get("data", "")),
        data_sha256=str(table.get("data_sha256", "")),
        notes=_texts(table, "notes", origin),
        geometry=_geometry(table, origin),
        covariance=covariance,
        noise_n=_size(table, "noise_n", origin),
        model_error_n=_size(table, "model_error_n", origin),
    )


def _geometry(table: Mapping[str, Any], origin: str) -> Geometry | None:
    if "geometry" not in table:
        return None
    given, where = _within(table, "geometry", origin), f"{origin} [geometry]"
    tomlfile.check_keys(given, _GEOMETRY, where)
    return Geometry(
        *(tomlfile.number_in_range(given.get(k), k, 0.1, LARGEST_MM, where) for k in _GEOMETRY)
    )


def _size(table: Mapping[str, Any], key: str, origin: str) -> float | None:
    if key not in table:
        return None
    return tomlfile.number_in_range(table[key], key, 0.0, 1e9, origin)


def _parameter(name: str, table: Mapping[str, Any], origin: str) -> Parameter:
    where = f"{origin} [parameters.{name}]"
    tomlfile.check_keys(table, _PARAMETER, where)
    numbers = [_real(table.get(key), key, where) for key in _NUMBERS]
    value, low, high = numbers
    if not low <= value <= high:
        raise PlantError(f"{where}: value = {value:g} is outside low = {low:g} to high = {high:g}")
    unit = str(table.get("unit", ""))
    to_si(unit)
    sd = table.get("sd")
    return Parameter(
        name, unit, value, low, high, str(table.get("meaning", "")),
        bool(table.get("fixed", False)), None if sd is None else _real(sd, "sd", where),
    )  # fmt: skip


def _range(table: Mapping[str, Any], key: str, origin: str) -> tuple[float, float]:
    pair = table.get(key)
    if isinstance(pair, list) and len(pair) == 2:
        low, high = (_real(value, key, f"{origin} [domain]") for value in pair)
        if low <= high:
            return low, high
    raise PlantError(f"{origin} [domain]: {key} = {pair!r}; expected [lowest, highest]")


def _real(value: object, key: str, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or math.isnan(value):
        raise PlantError(f"{where}: {key} = {value!r}; expected a number")
    return float(value)


def _within(table: Mapping[str, Any], key: str, origin: str) -> Mapping[str, Any]:
    found = table.get(key, {})
    if not isinstance(found, Mapping):
        raise PlantError(f"{origin}: {key} = {found!r}; expected a table")
    return found


def _texts(table: Mapping[str, Any], key: str, origin: str) -> tuple[str, ...]:
    found = table.get(key, [])
    if not isinstance(found, list):
        raise PlantError(f"{origin}: {key} = {found!r}; expected a list of texts")
    return tuple(str(text) for text in found)
