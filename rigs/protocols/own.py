"""Protocols that a user writes: a class in a file, or in an installed package.

The class derives from :class:`OwnTest`. Its annotated fields are the keys of its protocol file;
their bounds follow from the unit at the end of the name and from the limits of the rig.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import MISSING, Field, dataclass, fields
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, get_type_hints

from analysis.findings.findings import Analysis
from analysis.findings.points import points_analysis
from daq.errors import ConfigError, PamrigError
from daq.user_program import load_program, place_in
from rigs.execution.procedure import Procedure
from rigs.protocols.names import PROTOCOLS
from rigs.protocols.parts.method import Method, MethodParameters, read_method
from rigs.protocols.parts.trials import Logbook
from rigs.rigfile.acceptance import read_acceptance
from rigs.rigfile.config import Limits, RigConfig
from rigs.rigfile.toml_reader import Table, load_toml
from rigs.steps.custom_step import Steps

GROUP = "pamrig.protocols"
"""Entry points of installed packages: protocol name to a class derived from :class:`OwnTest`."""

LARGEST = 1e9
DAY_S = 86400.0
BASE = ("name", "slack_length_mm", "method", "source", "acceptance")


@dataclass(frozen=True, kw_only=True)
class OwnTest(MethodParameters):
    """Base of a user's protocol: a frozen dataclass with a generator of steps.

    Class attributes that may be set:
        protocol: name in records and files; made from the class name if empty.
        analysis: table, findings and screen; the settled points if None.
        needs_drift_n: settling criterion of the force in N, None if it is not watched.

    Attributes:
        name: of the test, as its file says.
        slack_length_mm: where the balance is tared.
        method: order, repeats, mountings, preconditioning, settling and measuring, read from the
            same keys as for every shipped test.
        source: the protocol file.
        acceptance: limits that the report judges the results by, or None.
    """

    protocol: ClassVar[str] = ""
    analysis: ClassVar[Analysis | None] = None
    needs_drift_n: ClassVar[float | None] = 0.05

    name: str
    slack_length_mm: float
    method: Method
    source: str

    def book(self) -> Logbook:
        """Numbers the trials and points of one pass through the steps."""
        return Logbook(self.method, self.protocol_name(), self.slack_length_mm)

    def steps(self) -> Steps:
        """The method, top to bottom; a new generator each time."""
        raise NotImplementedError

    @classmethod
    def protocol_name(cls) -> str:
        """Its name in records and files: ``StressRelaxation`` is ``stress-relaxation``."""
        return cls.protocol or re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "-", cls.__name__).lower()


def procedure_of(test: type[OwnTest], where: str) -> Procedure:
    """The procedure of a user's class.

    Raises:
        ConfigError: the name is that of a shipped protocol, or is none; a field has a type that
            no file can state.
    """
    name = test.protocol_name()
    if name in PROTOCOLS or not re.fullmatch(r"[a-z][a-z0-9-]{0,40}", name):
        raise ConfigError(
            where,
            f"{name!r} cannot name a protocol",
            "small letters, digits and hyphens, and no name of a shipped protocol: set `protocol`",
        )
    readers = {field.name: _reader(test, field, where) for field in _own_fields(test)}
    analysis = test.analysis or points_analysis(name)
    return Procedure(analysis, partial(_read, test, analysis, readers))


def load_own(path: str) -> Procedure:
    """The one protocol in a user's Python file.

    Raises:
        ConfigError: the file is missing, cannot be run, or does not hold one class.
    """
    file = Path(path)
    if not file.is_file():
        raise ConfigError(path, "no such file", "a Python file with a class derived from OwnTest")
    try:
        module = load_program(file)
    except PamrigError:
        raise
    except (Exception, SystemExit) as error:
        raise ConfigError(
            f"{path}{place_in(error, path)}", f"cannot be run: {type(error).__name__}: {error}"
        ) from error
    found = [
        value
        for value in vars(module).values()
        if isinstance(value, type)
        and issubclass(value, OwnTest)
        and value.__module__ == module.__name__
    ]
    if len(found) != 1:
        names = ", ".join(test.__name__ for test in found) or "none"
        raise ConfigError(path, f"expected one class derived from OwnTest, found {names}")
    return procedure_of(found[0], path)


Reader = Callable[[Table, Limits], Any]


def _own_fields(test: type[OwnTest]) -> list[Field[Any]]:
    return [field for field in fields(test) if field.name not in BASE]


def _reader(test: type[OwnTest], field: Field[Any], where: str) -> Reader:
    """How one key is read, from the type and the name of its field."""
    kind = get_type_hints(test)[field.name]
    key, default = field.name, ... if field.default is MISSING else field.default
    if field.default_factory is not MISSING:
        default = field.default_factory()

    def number(t: Table, limits: Limits) -> float:
        low, high, unit = _bounds(field, limits)
        return t.number(key, low, high, default, unit=unit)

    def numbers(t: Table, limits: Limits) -> tuple[float, ...]:
        low, high, unit = _bounds(field, limits)
        return t.numbers(key, low, high, default, unit=unit)

    def integer(t: Table, limits: Limits) -> int:
        low, high, _ = _bounds(field, limits)
        return t.integer(key, int(low), int(high), default)

    readers: dict[Any, Reader] = {
        float: number,
        tuple[float, ...]: numbers,
        int: integer,
        str: lambda t, limits: t.text(key, default),
        bool: lambda t, limits: t.flag(key, default),
    }
    if kind not in readers:
        raise ConfigError(
            where, f"{key}: {kind} is not read from a file",
            "float, int, bool, str or tuple[float, ...]",
        )  # fmt: skip
    return readers[kind]


def _bounds(field: Field[Any], limits: Limits) -> tuple[float, float, str]:
    """Lowest and highest value and unit of a field.

    ``field(metadata={"low": ..., "high": ...})`` states them; otherwise the unit in the name does.
    """
    unit = field.name.rsplit("_", 1)[-1]
    low, high, shown = {
        "kpa": (0.0, limits.pressure_kpa, "kPa"),
        "mm": (limits.length_min_mm, limits.length_max_mm, "mm"),
        "s": (0.0, DAY_S, "s"),
        "n": (-limits.force_n, limits.force_n, "N"),
    }.get(unit, (-LARGEST, LARGEST, ""))
    return field.metadata.get("low", low), field.metadata.get("high", high), shown


def _read(
    test: type[OwnTest], analysis: Analysis, readers: dict[str, Reader], name: str,
    config: RigConfig,
) -> OwnTest:  # fmt: skip
    """The parameters from a protocol file; the defaults of the class without one.

    Raises:
        ConfigError: unknown or missing key, wrong type, or a value beyond the rig's limit.
    """
    limits = config.limits
    if name and name != test.protocol_name():
        t = load_toml(name, "protocols")
        t.text("protocol", choices=(test.protocol_name(),))
    else:
        t = Table({}, f"{test.__name__} (no protocol file)")
    low, high = limits.length_min_mm, limits.length_max_mm
    plan = test(
        name=t.text("name", test.protocol_name()),
        slack_length_mm=t.number("slack_length_mm", low, high, low, unit="mm"),
        method=read_method(t, limits, drift_n=test.needs_drift_n),
        source=t.source,
        acceptance=read_acceptance(t, analysis.results),
        **{key: read(t, limits) for key, read in readers.items()},
    )
    t.finish()
    return plan
