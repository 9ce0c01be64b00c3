"""Compiling the simulation before anybody waits for it."""

from __future__ import annotations

import threading
from collections.abc import Callable

from daq.clock import VirtualClock
from rigs.rigfile.config import RigConfig
from rigs.virtual.bench import VirtualBench

PATIENCE_S = 3.0


def warm_up(
    config: RigConfig, report: Callable[[str], object], patience_s: float = PATIENCE_S
) -> None:
    """Run a bench like this one for a moment, so that the real one never stands still to compile.

    A fresh installation compiles the plant once, which takes a minute or more of a slow
    machine; that would come after the ports are open, and every client would time out.

    Args:
        config: a rig with a [virtual] table.
        report: takes what is being waited for, once it takes longer than ``patience_s``.

    Raises:
        ConfigError: the plant refuses a constant or an effect of the rig file.
    """
    slow = threading.Timer(
        patience_s, report, ("compiling the simulation; only the first start takes so long",)
    )
    slow.daemon = True
    slow.start()
    try:
        clock = VirtualClock()
        bench = VirtualBench(config, clock)
        clock.sleep(0.05)
        bench.expose()
    finally:
        slow.cancel()
