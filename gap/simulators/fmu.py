"""A simulator that is an FMU: FMI 2.0 or 3.0, co-simulation, through FMPy (`pip install
'pamrig[fmu]'`).

Simscape, Modelica tools and others export their models in this form (fmi-standard.org). An FMU
holds a compiled program; it runs with all rights of the user, as a Python function does.
"""

from __future__ import annotations

import shutil
import tempfile
import weakref
import zipfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from gap.data.simulator import Stage
from gap.data.trial import COMMANDS, Channel, Trial, sampled
from gap.errors import GapError
from gap.simulators.description import Description
from gap.simulators.external import External, StaticExternal, first_line
from gap.simulators.inputs import stage_sources
from plant.arrays import Array

STEP_S = 1e-3
CHANNELS = (
    "supply_kpa", "inlet_cmd", "outlet_cmd", "length_mm", "pressure_kpa", "force_n",
    "temperature_c", "load_kg", "pressure_start_kpa",
)  # fmt: skip
"""What `[variables.NAME]` may map."""
_WHOLE = ("Integer", "Enumeration", "Int8", "Int16", "Int32", "Int64", "UInt8", "UInt16", "UInt32",
          "UInt64")  # fmt: skip
_REAL = ("Real", "Float64", "Float32")
_FATAL = 4


@dataclass(frozen=True)
class _Variable:
    """A variable of an FMU: its value is `factor` times ours plus `offset`."""

    name: str
    reference: int
    type: str
    causality: str
    factor: float = 1.0
    offset: float = 0.0

    def to_fmu(self, value: Array | float) -> list[Any]:
        """Values as the FMU takes them."""
        made = np.atleast_1d(np.asarray(value, dtype=np.float64)) * self.factor + self.offset
        if self.type == "Boolean":
            return list((made != 0.0).tolist())
        return list((np.round(made).astype(np.int64) if self.type in _WHOLE else made).tolist())


class FmuSimulator(External):
    """An FMU with memory, run once for each trial and stage."""

    def __init__(self, about: Description) -> None:
        super().__init__(about)
        self._step_s = about.number("step_s", 0.0, 0.0)
        files = about.texts("file")
        opened = {name: _Unit(about, name) for name in dict.fromkeys(files.values())}
        self._units = {stage: opened[name] for stage, name in files.items()}
        self._map = self._mapped()
        for stage in self.stages:
            self._output(stage)
            self._inputs(stage)
        self._check_names()

    def _mapped(self) -> dict[str, Mapping[str, Any]]:
        about = self.about
        found: dict[str, Mapping[str, Any]] = {}
        table = about.inner("variables")
        about.known(table, CHANNELS, "variables.")
        for channel, entry in table.items():
            where = f"variables.{channel}"
            entry = {"name": entry} if isinstance(entry, str) else entry
            if not isinstance(entry, Mapping) or not isinstance(entry.get("name"), str):
                raise about.error(where, "expected a table with name, factor and offset")
            about.known(entry, ("name", "factor", "offset"), f"{where}.")
            factor = about.number_of(entry, "factor", f"{where}.factor", 1.0)
            if factor == 0.0:
                raise about.error(f"{where}.factor", "is 0")
            offset = about.number_of(entry, "offset", f"{where}.offset", 0.0)
            found[channel] = {"name": entry["name"], "factor": factor, "offset": offset}
        return found

    def _check_names(self) -> None:
        """Every variable that the description names is in one of its FMUs."""
        named = {f"variables.{key}.name": str(m["name"]) for key, m in self._map.items()}
        named |= {f"start.{name}": name for name in self.about.inner("start")}
        named |= {f"parameters.{p.name}.variable": self._of(p.name)[0] for p in self.parameters}
        for key, name in named.items():
            units = self._units.values()
            if not any(name in unit.variables for unit in units):
                files = " and ".join(dict.fromkeys(unit.name for unit in units))
                raise self.about.error(key, f"{files} has no variable {name!r}")
        for parameter in self.parameters:
            name = self._of(parameter.name)[0]
            for unit in self._units.values():
                causality = unit.variables[name].causality if name in unit.variables else "input"
                if causality not in ("parameter", "input"):
                    raise self.about.error(
                        f"parameters.{parameter.name}.variable",
                        f"{name} is of causality {causality!r} in {unit.name}, expected parameter",
                    )

    def _of(self, parameter: str) -> tuple[str, float, float]:
        """Variable, factor and offset of a parameter."""
        table = self.about.inner("parameters")[parameter]
        where = f"parameters.{parameter}"
        name = table.get("variable", parameter)
        if not isinstance(name, str):
            raise self.about.error(f"{where}.variable", f"expected a name, got {name!r}")
        return (
            name,
            self.about.number_of(table, "factor", f"{where}.factor", 1.0),
            self.about.number_of(table, "offset", f"{where}.offset", 0.0),
        )

    def _output(self, stage: Stage) -> _Variable:
        unit = self._units[stage.name]
        if stage.output not in self._map:
            raise self.about.error(f"variables.{stage.output}", "is missing: the output of a stage")
        made = unit.variable(f"variables.{stage.output}.name", **self._map[stage.output])
        if made.type not in _REAL:
            raise self.about.error(
                f"variables.{stage.output}.name", f"{made.name} is of type {made.type}, not a real"
            )
        return made

    def _inputs(self, stage: Stage) -> dict[str, _Variable]:
        """The variables that a stage is fed through, by channel."""
        unit = self._units[stage.name]
        found = {}
        for channel, entry in self._map.items():
            if channel == stage.output or entry["name"] not in unit.variables:
                continue
            made = unit.variable(f"variables.{channel}.name", **entry)
            if made.causality in ("input", "parameter"):
                found[channel] = made
            elif channel in stage.inputs:
                raise self.about.error(
                    f"variables.{channel}.name",
                    f"{made.name} is of causality {made.causality!r}, but the stage {stage.name} "
                    "is fed with what was measured",
                    "give this stage an FMU in which it is an input: "
                    f'file = {{ {stage.name} = "..." }}',
                )
        fed = [name for name in stage.inputs if name in found]
        if not fed:
            raise self.about.error(
                "variables", f"feeds the stage {stage.name} with none of {', '.join(stage.inputs)}"
            )
        return found

    def _start(self, unit: _Unit, values: Mapping[str, float]) -> list[tuple[_Variable, float]]:
        """Start values and parameters, with the variables that take them."""
        found = []
        start = self.about.inner("start")
        for name in start:
            if name in unit.variables:
                value = start[name]
                number = float(value) if isinstance(value, bool) else None
                if number is None:
                    number = self.about.number_of(start, name, f"start.{name}", None)
                found.append((unit.variables[name], number))
        for key, value in values.items():
            name, factor, offset = self._of(key)
            if name in unit.variables:
                made = unit.variable(f"parameters.{key}.variable", name, factor, offset)
                found.append((made, value))
        return found

    def _stage(
        self, trial: Trial, stage: Stage, wanted: Array, values: Mapping[str, float]
    ) -> Array | None:
        sources = stage_sources(trial, stage, self.about.inputs)
        if sources is None:
            return None
        self._needs_time(trial)
        unit, output = self._units[stage.name], self._output(stage)
        feeds = {name: v for name, v in self._inputs(stage).items() if name in sources}
        axis = self._axis(unit, {name: sources[name] for name in feeds}, wanted)
        start = self._start(unit, values)
        inputs = []
        for name, variable in feeds.items():
            if variable.causality == "parameter":
                start.append((variable, float(sampled(name, sources[name], axis[:1])[0])))
                continue
            # A step is fed with the command in force as it begins, and with what was measured as
            # it ends: the output is read there.
            at = np.r_[axis[0], axis[:-1]] if name in COMMANDS else axis
            inputs.append((variable, sampled(name, sources[name], at)))
        made = unit.run(trial.name, start, inputs, output, axis - axis[0])
        return np.interp(wanted, axis, made)

    def _axis(self, unit: _Unit, sources: Mapping[str, Channel | float], wanted: Array) -> Array:
        """Communication points: in equal steps, and at the edges of commands if the FMU can."""
        times = [source.time_s for source in sources.values() if isinstance(source, Channel)]
        first = min(float(t[0]) for t in [*times, wanted])
        last = max(float(t[-1]) for t in [*times, wanted])
        step = self._step_s or unit.step_s or STEP_S
        count = int(np.ceil((last - first) / step - 1e-9)) + 1
        axis = first + step * np.arange(count, dtype=np.float64)
        if not unit.variable_step:
            return axis
        edges = [
            source.time_s
            for name, source in sources.items()
            if name in COMMANDS and isinstance(source, Channel)
        ]
        axis = np.unique(np.concatenate([axis, *edges]))
        return axis[np.r_[True, np.diff(axis) > 1e-3 * step]]


class StaticFmuSimulator(StaticExternal, FmuSimulator):
    """An FMU without memory: each point is one step."""

    def _law(
        self, pressure_kpa: Array, length_mm: Array, values: Mapping[str, float], trial: str
    ) -> Array:
        stage = self.stages[0]
        unit, fed = self._units[stage.name], self._inputs(stage)
        given = {"pressure_kpa": pressure_kpa.ravel(), "length_mm": length_mm.ravel()}
        inputs = [(v, np.r_[given[k][:1], given[k]]) for k, v in fed.items() if k in given]
        step = self._step_s or unit.step_s or STEP_S
        if not pressure_kpa.size:
            return np.zeros(pressure_kpa.shape)
        made = unit.run(
            trial, self._start(unit, values), inputs, self._output(stage),
            step * np.arange(pressure_kpa.size + 1, dtype=np.float64),
        )  # fmt: skip
        return made[1:].reshape(pressure_kpa.shape)


class _Unit:
    """One FMU, unpacked and loaded."""

    def __init__(self, about: Description, name: str) -> None:
        self.name = name
        self._about = about
        self._message = ""
        path = about.file(name)
        if not path.is_file():
            raise about.error("file", f"no such file {name}", "it is relative to this file")
        if not zipfile.is_zipfile(path):
            raise about.error("file", f"{name} is no FMU: not a zip file")
        fmpy = _fmpy(about)
        self._folder = tempfile.mkdtemp(prefix="pamrig-fmu-")
        self._close = weakref.finalize(self, _discard, self._folder, held := _Held())
        self._held = held
        try:
            fmpy.extract(str(path), self._folder)
            described = fmpy.read_model_description(self._folder)
            self._check(described)
            self._described = described
            self.variables = {
                v.name: _Variable(v.name, v.valueReference, str(v.type), str(v.causality))
                for v in described.modelVariables
                if not getattr(v, "dimensions", None)
            }
            self._load()
        except GapError:
            self._close()
            raise
        except Exception as error:
            self._close()
            raise about.error("file", f"{name} cannot be opened: {first_line(error)}") from None
        experiment = described.defaultExperiment
        stated = getattr(experiment, "stepSize", None) if experiment is not None else None
        self.step_s = float(stated) if stated else 0.0
        self.variable_step = bool(described.coSimulation.canHandleVariableCommunicationStepSize)

    def _check(self, described: Any) -> None:
        version = str(described.fmiVersion)
        if not version.startswith(("2.", "3.")):
            raise self._about.error("file", f"{self.name} is FMI {version}, expected 2.0 or 3.0")
        if described.coSimulation is None:
            raise self._about.error(
                "file", f"{self.name} is for model exchange only", "export it for co-simulation"
            )
        self._three = version.startswith("3.")

    def _load(self) -> None:
        from fmpy.simulation import instantiate_fmu

        def note(*arguments: Any) -> None:
            text = arguments[-1]
            self_ = held.unit()
            if self_ is not None:
                self_._message = (text or b"").decode(errors="replace")

        held = self._held
        held.unit = weakref.ref(self)
        held.fmu = instantiate_fmu(
            self._folder, self._described, fmi_type="CoSimulation", logger=note
        )

    def variable(self, key: str, name: str, factor: float = 1.0, offset: float = 0.0) -> _Variable:
        """A variable with the units of a channel. Raises `GapError` if the FMU has none."""
        own = self.variables.get(name)
        if own is None:
            raise self._about.error(key, f"{self.name} has no variable {name!r}")
        return _Variable(own.name, own.reference, own.type, own.causality, factor, offset)

    def run(
        self,
        trial: str,
        start: Iterable[tuple[_Variable, float]],
        inputs: Iterable[tuple[_Variable, Array]],
        output: _Variable,
        time_s: Array,
    ) -> Array:
        """The output in our unit at every instant of `time_s`, which starts at 0.

        Args:
            trial: for messages.
            start: variables set before the first step.
            inputs: variables set before each step, with one value for each instant: the first at
                the start, the others for the step that ends there.
            output: the variable to read.
            time_s: communication points.

        Raises:
            GapError: the FMU reported an error, or a value that is no number.
        """
        now = 0.0
        self._message = ""
        try:
            if self._held.fmu is None:
                self._load()
            fmu = self._held.fmu
            if not self._three:
                fmu.setupExperiment(startTime=0.0)
            for variable, value in start:
                self._set(variable, variable.to_fmu(value))
            fmu.enterInitializationMode()
            fed = [
                (getattr(fmu, _setter(v)), [v.reference], v.to_fmu(value)) for v, value in inputs
            ]
            for put, reference, values in fed:
                put(reference, values[:1])
            fmu.exitInitializationMode()
            take, reference = getattr(fmu, f"get{output.type}"), [output.reference]
            made = np.empty(len(time_s))
            made[0] = take(reference)[0]
            times = time_s.tolist()
            for k in range(1, len(times)):
                now = times[k - 1]
                for put, where, values in fed:
                    put(where, values[k : k + 1])
                fmu.doStep(now, times[k] - now)
                made[k] = take(reference)[0]
            self._end()
        except Exception as error:
            self._drop(error)
            said = f" ({self._message.splitlines()[0][:120]})" if self._message.strip() else ""
            raise self._error(trial, f"failed at {now:g} s: {first_line(error)}{said}") from None
        bad = np.flatnonzero(~np.isfinite(made))
        if len(bad):
            raise self._error(
                trial, f"gave {made[bad[0]]} as {output.name} at {time_s[bad[0]]:g} s"
            )
        return np.asarray((made - output.offset) / output.factor)

    def _set(self, variable: _Variable, values: list[Any]) -> None:
        getattr(self._held.fmu, _setter(variable))([variable.reference], values)

    def _end(self) -> None:
        """Make it ready for the next run; one that cannot be reset is loaded anew."""
        fmu = self._held.fmu
        fmu.terminate()
        try:
            fmu.reset()
        except Exception:
            fmu.freeInstance()
            self._held.fmu = None

    def _drop(self, error: Exception) -> None:
        """Free an FMU that failed; after a fatal error it must not be called any more."""
        fmu, self._held.fmu = self._held.fmu, None
        if fmu is not None and getattr(error, "status", None) != _FATAL:
            try:
                fmu.freeInstance()
            except Exception:
                self._message = self._message or "and could not be freed"

    def _error(self, trial: str, what: str) -> GapError:
        where = f"{self._about.path}: {self.name}"
        return GapError(f"{where}, trial {trial}" if trial else where, what)


class _Held:
    """The loaded FMU, held apart from its owner so that it can be freed after it."""

    fmu: Any = None
    unit: Any = None


def _discard(folder: str, held: _Held) -> None:
    if held.fmu is not None:
        try:
            held.fmu.freeInstance()
        except Exception:
            held.fmu = None
    shutil.rmtree(folder, ignore_errors=True)


def _setter(variable: _Variable) -> str:
    return f"set{'Integer' if variable.type == 'Enumeration' else variable.type}"


def _fmpy(about: Description) -> Any:
    try:
        import fmpy
    except ImportError:
        raise GapError(
            f"{about.path}: kind", "an FMU needs FMPy, which is not installed",
            "pip install 'pamrig[fmu]'",
        ) from None  # fmt: skip
    return fmpy
