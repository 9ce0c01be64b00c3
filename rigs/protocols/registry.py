"""The protocols by name; none is imported before it is needed."""

from __future__ import annotations

from importlib import import_module

from daq.errors import ConfigError
from daq.user_program import installed, load_installed
from rigs.execution.procedure import Procedure
from rigs.protocols.names import MODULES, PROTOCOLS


def procedure(name: str) -> Procedure:
    """A protocol by name, shipped or of an installed package; or that of a user's Python file.

    Raises:
        ConfigError: there is none, or it cannot be used.
    """
    if name.endswith(".py"):
        from rigs.protocols.own import load_own

        return load_own(name)
    if name not in PROTOCOLS:
        return _installed(name)
    module = MODULES.get(name, name.replace("-", "_"))
    found = import_module(f"rigs.protocols.{module}").PROCEDURE
    assert isinstance(found, Procedure)
    return found


def _installed(name: str) -> Procedure:
    from rigs.protocols.own import GROUP, OwnTest, procedure_of

    known = installed(GROUP)
    if name not in known:
        raise ConfigError(name, "is not a protocol", f"one of: {', '.join([*PROTOCOLS, *known])}")
    test = load_installed(GROUP, name)
    if not (isinstance(test, type) and issubclass(test, OwnTest)):
        raise ConfigError(f"{GROUP}: {name}", "is not a class derived from OwnTest")
    if test.protocol_name() != name:
        raise ConfigError(f"{GROUP}: {name}", f"its class calls itself {test.protocol_name()!r}")
    return procedure_of(test, f"{GROUP}: {name}")
