"""The protocols by name; none is imported before it is needed."""

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
        raise ConfigError(name, "is not a protocol", f"one of: {', '.join(PROTOCOLS)}")
    found = import_module(f"rigs.protocols.{name.replace('-', '_')}").PROCEDURE
    assert isinstance(found, Procedure)
    return found
