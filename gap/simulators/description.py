"""The description of a simulator: a TOML file that names its kind, stages and parameters.

`read_description` checks what all kinds share; the kinds read their own keys from it. `describe`
writes it back with new nominal values.
"""

from __future__ import annotations

import contextlib
import difflib
import math
import os
import re
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gap.data.simulator import STAGES, Parameter, Stage
from gap.errors import GapError
from gap.output import toml_value
from plant import tomlfile
from plant.arrays import Array
from plant.effects.effects import Effects
from plant.errors import PlantError

SHARED = ("kind", "title", "stages", "model_error_n", "noise_n", "inputs", "parameters",
          "covariance", "effects")  # fmt: skip
KINDS: dict[str, tuple[str, ...]] = {
    "python": ("function", "static", "step_s"),
    "fmu": ("file", "static", "step_s", "variables", "start"),
    "predictions": ("table",),
    "law": ("model", "temperature_c"),
    "surface": ("table",),
}
"""Keys of each kind beside those that all share."""
PARAMETER_KEYS: dict[str, tuple[str, ...]] = {
    "python": (),
    "fmu": ("variable", "factor", "offset"),
    "predictions": ("table_high", "table_low"),
    "law": (),
    "surface": (),
}
"""Keys of `[parameters.NAME]` beside `nominal` and `tolerance`."""
INPUTS = ("supply_kpa", "temperature_c")
"""Channels that `[inputs]` may state for trials in which they were not measured."""
STATIC_KINDS = ("surface", "law")
_WORD = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_BARE = re.compile(r"[A-Za-z0-9_-]+")
_AGREE = 1e-3


@dataclass(frozen=True)
class Description:
    """What a description states, checked as far as all kinds share it.

    Attributes:
        path: of the file; files that it names are relative to its folder.
        table: the file as read.
        kind: one of `KINDS`.
        stages: that the simulator stands for, in the order of the chain.
        model_error_n: one sd in N of the error of the form of the force stage.
        noise_n: one sd in N of a single reading of the force, where it is known; else 0.
        inputs: values for channels that a trial has not measured, by `INPUTS`.
        effects: effects that the simulator is known to lack, switched on from the start.
    """

    path: Path
    table: Mapping[str, Any]
    kind: str
    stages: tuple[Stage, ...]
    model_error_n: float
    noise_n: float
    inputs: Mapping[str, float]
    effects: Effects

    def error(self, key: str, what: str, remedy: str = "") -> GapError:
        """The error that names this file and a key."""
        return GapError(f"{self.path}: {key}", what, remedy)

    def file(self, name: str) -> Path:
        """A file that the description names, relative to its own folder."""
        return self.path.parent / name

    def text(self, key: str) -> str:
        """The text under `key`. Raises `GapError` where there is none."""
        value = self.table.get(key)
        if not isinstance(value, str) or not value.strip():
            raise self.error(key, f"expected a text, got {_shown(value)}")
        return value.strip()

    def texts(self, key: str) -> dict[str, str]:
        """One text for each stage by name: a text for all of them, or a table of texts."""
        value = self.table.get(key)
        if not isinstance(value, Mapping):
            return {stage.name: self.text(key) for stage in self.stages}
        known = [stage.name for stage in self.stages]
        for name, text in value.items():
            if name not in known:
                raise self.error(
                    f"{key}.{name}", "is not a stage of this simulator", _near(name, known)
                )
            if not isinstance(text, str) or not text.strip():
                raise self.error(f"{key}.{name}", f"expected a text, got {_shown(text)}")
        for name in known:
            if name not in value:
                raise self.error(key, f"says nothing about the stage {name!r}")
        return {name: str(value[name]).strip() for name in known}

    def flag(self, key: str) -> bool:
        """True or false under `key`; false where there is nothing."""
        value = self.table.get(key, False)
        if not isinstance(value, bool):
            raise self.error(key, f"expected true or false, got {_shown(value)}")
        return value

    def number(self, key: str, default: float | None, low: float = -math.inf) -> float:
        """A finite number of at least `low` under `key`."""
        return self.number_of(self.table, key, key, default, low)

    def number_of(
        self, table: Mapping[str, Any], key: str, shown: str, default: float | None,
        low: float = -math.inf,
    ) -> float:  # fmt: skip
        """A finite number of at least `low` under `key` of an inner table."""
        value = table.get(key, default)
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise self.error(shown, f"expected a number, got {_shown(value)}")
        if not math.isfinite(value) or value < low:
            least = "" if low == -math.inf else f" of {low:g} or more"
            raise self.error(shown, f"expected a finite number{least}, got {value!r}")
        return float(value)

    def inner(self, key: str) -> Mapping[str, Any]:
        """The table under `key`; an empty one where there is none."""
        value = self.table.get(key, {})
        if not isinstance(value, Mapping):
            raise self.error(key, f"expected a table [{key}], got {_shown(value)}")
        return value

    def known(self, given: Iterable[str], known: Iterable[str], where: str) -> None:
        """Raise `GapError` for a key that is not known."""
        listed = list(known)
        for key in given:
            if key not in listed:
                raise self.error(f"{where}{key}", "unknown key", _near(key, listed))

    def parameters(self, base: Iterable[Parameter] = ()) -> tuple[Parameter, ...]:
        """The parameters with nominal values and tolerances.

        Args:
            base: what the simulator itself knows of its parameters; `[parameters.NAME]` may then
                change their values, and name no others.
        """
        stated = self.inner("parameters")
        found = {parameter.name: parameter for parameter in base}
        if found:
            self.known(stated, found, "parameters.")
        matrix = self.inner("covariance")
        sds = self._stated_sds(matrix) if matrix else {}
        for name, table in stated.items():
            where = f"parameters.{name}"
            if not _WORD.fullmatch(name):
                raise self.error(where, "expected a name of letters, digits and _")
            if not isinstance(table, Mapping):
                raise self.error(where, f"expected a table, got {_shown(table)}")
            self.known(table, ("nominal", "tolerance", *PARAMETER_KEYS[self.kind]), f"{where}.")
            before = found.get(name)
            nominal = self.number_of(
                table, "nominal", f"{where}.nominal", before.nominal if before else None
            )
            usual = sds.get(name, before.tolerance if before else None)
            tolerance = self.number_of(table, "tolerance", f"{where}.tolerance", usual, 0.0)
            if name in sds and abs(tolerance - sds[name]) > _AGREE * sds[name]:
                raise self.error(
                    f"{where}.tolerance", f"is {tolerance:g}, but {sds[name]:g} in [covariance]"
                )
            found[name] = Parameter(name, nominal, tolerance)
        return tuple(found.values())

    def covariance(self, parameters: tuple[Parameter, ...]) -> Array | None:
        """Prior covariance in the order of `parameters`; None where they are independent.

        Parameters that `[covariance]` does not name are independent of all others.
        """
        table = self.inner("covariance")
        if not table:
            return None
        names, matrix = self._matrix(table)
        known = [parameter.name for parameter in parameters]
        for name in names:
            if name not in known:
                raise self.error(
                    "covariance.names", f"{name!r} is not a parameter", _near(name, known)
                )
        made = np.diag([parameter.tolerance**2 for parameter in parameters])
        at = [known.index(name) for name in names]
        made[np.ix_(at, at)] = matrix
        return np.asarray(made, dtype=np.float64)

    def _stated_sds(self, table: Mapping[str, Any]) -> dict[str, float]:
        names, matrix = self._matrix(table)
        return dict(zip(names, np.sqrt(np.diag(matrix)).tolist(), strict=True))

    def _matrix(self, table: Mapping[str, Any]) -> tuple[list[str], Array]:
        self.known(table, ("names", "matrix"), "covariance.")
        names = table.get("names")
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise self.error("covariance.names", "expected a list of names of parameters")
        if len(set(names)) != len(names):
            raise self.error("covariance.names", "holds a name twice")
        try:
            matrix = np.array(table.get("matrix"), dtype=np.float64)
        except (TypeError, ValueError):
            matrix = np.empty(0)
        size = len(names)
        if matrix.shape != (size, size) or not np.isfinite(matrix).all():
            raise self.error("covariance.matrix", f"expected {size} rows of {size} numbers")
        scale = np.sqrt(np.clip(np.diag(matrix), 1e-300, None))
        unit = matrix / np.outer(scale, scale)
        if not np.allclose(unit, unit.T, atol=1e-6) or np.linalg.eigvalsh(unit).min() < -1e-6:
            raise self.error(
                "covariance.matrix", "is not a covariance matrix: expected a symmetric matrix "
                "without negative eigenvalues",
            )  # fmt: skip
        return names, np.asarray((matrix + matrix.T) / 2.0)


def read_table_of(path: Path) -> dict[str, Any]:
    """The TOML table of a file. Raises `GapError`."""
    try:
        return tomlfile.loads(tomlfile.read_text(path))
    except FileNotFoundError:
        raise GapError(str(path), "no such file", "give the description of a simulator") from None
    except OSError as error:
        raise GapError(str(path), f"cannot be read: {error.strerror}") from None
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise GapError(str(path), f"cannot be read as TOML ({error})") from None


def read_description(path: Path) -> Description:
    """Read and check what all kinds share.

    Raises:
        GapError: names the file and the key.
    """
    table = read_table_of(path)
    kind = table.get("kind")
    if kind is None and "law" in table and "domain" in table:
        # A model file as `pamrig fit` writes it is a simulator without a description.
        table, kind = {"kind": "law", "model": path.name}, "law"
    if not isinstance(kind, str) or kind not in KINDS:
        raise GapError(f"{path}: kind", f"expected one of {', '.join(KINDS)}, got {_shown(kind)}")
    bare = Description(path, table, kind, (), 0.0, 0.0, {}, Effects())
    bare.known(table, (*SHARED, *KINDS[kind]), "")
    stages = _stages(bare)
    if [stage.name for stage in stages] != ["force"]:
        if kind in STATIC_KINDS:
            raise bare.error("stages", f'a {kind} predicts force alone: expected ["force"]')
        if "static" in table and bare.flag("static"):
            raise bare.error("static", 'is for the stage force alone: stages = ["force"]')
    stated = bare.inner("inputs")
    bare.known(stated, INPUTS, "inputs.")
    inputs = {key: bare.number_of(stated, key, f"inputs.{key}", None) for key in stated}
    return Description(
        path,
        table,
        kind,
        stages,
        bare.number("model_error_n", 0.0, 0.0),
        bare.number("noise_n", 0.0, 0.0),
        inputs,
        _effects(bare),
    )


def _stages(about: Description) -> tuple[Stage, ...]:
    names = about.table.get("stages", ["force"] if about.kind in STATIC_KINDS else None)
    if not isinstance(names, list) or not names:
        raise about.error("stages", f'expected a list such as ["force"], got {_shown(names)}')
    for name in names:
        if name not in STAGES:
            raise about.error("stages", f"{name!r} is not a stage; known: {', '.join(STAGES)}")
    if len(set(names)) != len(names):
        raise about.error("stages", "names a stage twice")
    return tuple(stage for name, stage in STAGES.items() if name in names)


def _effects(about: Description) -> Effects:
    try:
        return Effects.from_config(about.inner("effects"), "effects")
    except PlantError as error:
        raise GapError(str(about.path), str(error)) from None


def described(
    about: Description,
    parameters: Iterable[Parameter],
    values: Mapping[str, float],
    effects: Mapping[str, Mapping[str, Any]],
    folder: Path | None,
) -> str:
    """A description as TOML text; see `gap.simulators.open.describe`."""
    table = {key: value for key, value in about.table.items() if key != "parameters"}
    for key in ("function", "file", "table", "model"):
        if key in table:
            table[key] = _moved(about, key, table[key], folder)
    stated = about.inner("parameters")
    table["parameters"] = {}
    for parameter in parameters:
        own = dict(stated.get(parameter.name, {}))
        for key in ("table_high", "table_low"):
            if key in own:
                own[key] = _moved(about, key, own[key], folder)
        own["nominal"] = float(values.get(parameter.name, parameter.nominal))
        own["tolerance"] = parameter.tolerance
        table["parameters"][parameter.name] = own
    table["effects"] = {
        name: dict(table) for name, table in {**about.effects.values, **effects}.items()
    }
    return "\n".join(_lines(table, ())).lstrip("\n") + "\n"


def _moved(about: Description, key: str, value: Any, folder: Path | None) -> Any:
    """A file's name as seen from another folder; names of modules and shipped laws stay."""
    if isinstance(value, Mapping):
        return {name: _moved(about, key, text, folder) for name, text in value.items()}
    name, colon, function = str(value).rpartition(":") if key == "function" else (value, "", "")
    path = about.file(name)
    if not path.is_file():
        return value
    target = path.resolve()
    if folder is not None:
        with contextlib.suppress(ValueError):  # on another drive
            target = Path(os.path.relpath(target, folder.resolve()))
    return f"{target.as_posix()}{colon}{function}"


def _lines(table: Mapping[str, Any], above: tuple[str, ...]) -> list[str]:
    lines = [
        f"{_key(key)} = {toml_value(value)}"
        for key, value in table.items()
        if not isinstance(value, Mapping)
    ]
    if above and (lines or not table):
        lines.insert(0, f"\n[{'.'.join(map(_key, above))}]")
    for key, value in table.items():
        if isinstance(value, Mapping) and (value or above):
            lines += _lines(value, (*above, key))
    return lines


def _key(name: str) -> str:
    return name if _BARE.fullmatch(name) else toml_value(name)


def _near(name: str, known: list[str]) -> str:
    near = difflib.get_close_matches(name, known, n=1)
    return f"did you mean {near[0]}?" if near else f"known: {', '.join(known) or 'none'}"


def _shown(value: object) -> str:
    return "nothing" if value is None else repr(value)[:60]
