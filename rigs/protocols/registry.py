"""Which protocols there are, and where each one lives; none is imported before it is asked for."""

from __future__ import annotations

from importlib import import_module

from daq.errors import ConfigError
from rigs.protocols.procedure import Procedure

PROTOCOLS: dict[str, str] = {
    "isometric": "Run an isometric test: length held, pressure stepped, force read.",
}
"""Name of each protocol's command and what it does; its module is ``rigs.protocols.NAME`` with _
for -, and holds PROCEDURE."""


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
    return procedure(name if isinstance(name, str) and name in PROTOCOLS else "isometric")
