"""The protocols by name; none is imported before it is asked for."""

from __future__ import annotations

from importlib import import_module

from daq.errors import ConfigError
from rigs.execution.procedure import Procedure
from rigs.protocols.names import PROTOCOLS


def procedure(name: str) -> Procedure:
    """The protocol of that name.

    Raises:
        ConfigError: there is none.
    """
    if name not in PROTOCOLS:
        raise ConfigError(name, "is no protocol", f"one of: {', '.join(PROTOCOLS)}")
    found = import_module(f"rigs.protocols.{name.replace('-', '_')}").PROCEDURE
    assert isinstance(found, Procedure)
    return found


def procedure_of(name: object) -> Procedure:
    """The protocol of a record; the isometric one for records of a protocol unknown here."""
    if name == "simulate":  # records of `pamrig simulate`; no rig runs it
        return import_module("analysis.findings.simulation").PROCEDURE  # type: ignore[no-any-return]
    return procedure(name if isinstance(name, str) and name in PROTOCOLS else "isometric")
