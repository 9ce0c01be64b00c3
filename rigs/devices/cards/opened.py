"""Opens the card of a rig file; the manufacturer's package is imported only then."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from daq.clock import Clock
from daq.errors import ConfigError
from rigs.devices.cards.card import Backend
from rigs.devices.cards.labjack import LabJack
from rigs.devices.cards.ni import NationalInstruments
from rigs.rigfile.instruments import CardDevice

PACKAGES = {"labjack": ("labjack.ljm", "labjack"), "nidaqmx": ("nidaqmx", "ni")}
"""Kind to module and extra."""


def backend(device: CardDevice, clock: Clock, library: Any = None) -> Backend:
    """The manufacturer's package for a card.

    Args:
        device: its table of the rig file.
        clock: of the bench.
        library: a stand-in for the package; the package itself by default.

    Raises:
        ConfigError: the package is not installed.
    """
    if library is None:
        module, extra = PACKAGES[device.kind]
        try:
            library = import_module(module)
            if device.kind == "nidaqmx":
                for part in ("constants", "errors", "system"):
                    import_module(f"nidaqmx.{part}")
        except ImportError:
            raise ConfigError(
                "card.kind", f"the package for {device.kind} is not installed",
                f"pip install 'pamrig[{extra}]', and the manufacturer's driver",
            ) from None  # fmt: skip
    loaded = getattr(getattr(library, "ljm", None), "_staticLib", library)
    if loaded is None:
        raise ConfigError("card.kind", "the LJM library is not installed", "get it from LabJack")
    if device.kind == "labjack":
        return LabJack(library, device.port, clock)
    return NationalInstruments(library, device.port)
