"""A simulator that is a Python function of the user.

Without memory (`static = true`) it is `function(pressure_kpa, length_mm, parameters) -> force_n`;
with memory `function(inputs, parameters)`, see docs/use/your-simulator.md. The function is the
user's own code, named on the command line by way of its description, and it runs as such.
"""

from __future__ import annotations

import importlib
import sys
import traceback
from collections.abc import Callable, Mapping
from contextlib import redirect_stdout
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from daq.user_program import load_program, place_in
from gap.data.simulator import Stage
from gap.data.trial import CHANNELS, COMMANDS, Trial, sampled
from gap.errors import GapError
from gap.simulators.description import Description
from gap.simulators.external import External, StaticExternal, first_line
from gap.simulators.inputs import stage_sources, time_axis
from plant.arrays import Array

Function = Callable[..., Any]


class PythonSimulator(External):
    """A function of the inputs of a trial, called once for each stage."""

    def __init__(self, about: Description) -> None:
        super().__init__(about)
        self._functions = _functions(about)
        self._step_s = about.number("step_s", 0.0, 0.0)

    def _stage(
        self, trial: Trial, stage: Stage, wanted: Array, values: Mapping[str, float]
    ) -> Array | None:
        sources = stage_sources(trial, stage, self.about.inputs)
        if sources is None:
            return None
        self._needs_time(trial)
        axis = time_axis(sources, wanted, self._step_s)
        inputs = {"time_s": axis}
        inputs |= {name: sampled(name, source, axis) for name, source in sources.items()}
        named = self._functions[stage.name]
        given = named.call(trial.name, inputs, dict(values))
        if isinstance(given, Mapping):
            if stage.output not in given:
                listed = ", ".join(str(key) for key in given) or "nothing"
                raise named.error(trial.name, f"returned no {stage.output}, but {listed}")
            given = given[stage.output]
        made = named.array(trial.name, given, axis.shape)
        bad = np.flatnonzero(~np.isfinite(made))
        if len(bad):
            raise named.error(
                trial.name, f"returned {made[bad[0]]} as {stage.output} at {axis[bad[0]]:g} s"
            )
        return np.interp(wanted, axis, made)


class StaticPythonSimulator(StaticExternal, PythonSimulator):
    """A function of pressure and length alone."""

    def _law(
        self, pressure_kpa: Array, length_mm: Array, values: Mapping[str, float], trial: str
    ) -> Array:
        named = self._functions["force"]
        # The function may work on its arguments: they are copies.
        given = named.call(trial, pressure_kpa.copy(), length_mm.copy(), dict(values))
        return named.array(trial, given, pressure_kpa.shape)

    def _name(self) -> str:
        return f"function {self._functions['force'].name}"


class _Named:
    """A function with the name that messages call it by."""

    def __init__(self, about: Description, name: str, function: Function) -> None:
        self.name = name
        self._about = about
        self._function = function

    def error(self, trial: str, what: str, remedy: str = "") -> GapError:
        """The error that names description, function and trial."""
        where = f"{self._about.path}: function {self.name}"
        return GapError(f"{where}, trial {trial}" if trial else where, what, remedy)

    def call(self, trial: str, *arguments: Any) -> Any:
        """What the function returns; whatever it raises becomes one line.

        What it prints goes to standard error: standard output may be JSON.
        """
        try:
            with redirect_stdout(sys.stderr):
                return self._function(*arguments)
        except (Exception, SystemExit) as error:
            raise self.error(
                trial, f"raised {first_line(error)}{_place(error)}", _remedy(error)
            ) from None

    def array(self, trial: str, given: Any, shape: tuple[int, ...]) -> Array:
        """Numbers of the expected shape."""
        if np.iscomplexobj(given):
            raise self.error(trial, "returned complex numbers, expected real ones")
        try:
            made = np.asarray(given, dtype=np.float64)
        except (TypeError, ValueError):
            raise self.error(
                trial, f"returned a {type(given).__name__}, expected an array of numbers"
            ) from None
        if made.shape != shape:
            raise self.error(trial, f"returned an array of shape {made.shape}, expected {shape}")
        return made


def _place(error: BaseException) -> str:
    frames = traceback.extract_tb(error.__traceback__)[1:]
    return f" ({Path(frames[-1].filename).name}, line {frames[-1].lineno})" if frames else ""


def _remedy(error: BaseException) -> str:
    name = error.args[0] if isinstance(error, KeyError) and error.args else None
    if name in (*CHANNELS, *COMMANDS, "load_kg"):
        return f"the trial has no {name}; supply_kpa and temperature_c may be stated under [inputs]"
    return ""


def _functions(about: Description) -> dict[str, _Named]:
    modules: dict[str, ModuleType] = {}
    found: dict[str, _Named] = {}
    for stage, text in about.texts("function").items():
        where, colon, name = text.rpartition(":")
        if not colon or not where or not name.isidentifier():
            raise about.error(
                "function", f'expected "file.py:name" or "package.module:name", got {text!r}'
            )
        if where not in modules:
            modules[where] = _module(about, where)
        function = getattr(modules[where], name, None)
        if not callable(function):
            what = "has no function" if function is None else "has something else than a function"
            raise about.error("function", f"{where} {what} {name!r}")
        found[stage] = _Named(about, name, function)
    return found


def _module(about: Description, where: str) -> ModuleType:
    try:
        if not where.endswith(".py"):
            return importlib.import_module(where)
        path = about.file(where).resolve()
        if not path.is_file():
            raise about.error("function", f"no such file {where}", "it is relative to this file")
        return load_program(path)
    except GapError:
        raise
    except (Exception, SystemExit) as error:
        raise about.error(
            "function", f"{where} cannot be imported: {first_line(error)}{place_in(error, where)}"
        ) from None
