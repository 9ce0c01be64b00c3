"""The first use of compiled code on a computer: it takes up to a minute and is shown."""

from __future__ import annotations

import importlib
import subprocess
import sys
import time

import typer

SIMULATION = "plant.simulator.kernel"
MEASURING = """
import numpy as np
from analysis.reduction.pictures import measure_stored
from rigs.virtual.emulators.pictures.camera import render
measure_stored(render(60.0, np.random.default_rng(0)), {})
"""
"""Measures one picture: compiles what finds the edges."""


def compile_first() -> None:
    """Load the compiled simulation of a virtual bench; where it must be compiled, show that.

    Simulation and picture measurement are compiled side by side. The result is kept on disk, for
    all later commands. What a bench of another kind compiles later is shown too.
    """
    from numba.core import event

    start = time.monotonic()
    helpers: list[subprocess.Popen[bytes]] = []

    class First(event.Listener):  # type: ignore[misc, unused-ignore]
        """Hears of each function that is compiled; one that was stored is not."""

        def on_start(self, event: event.Event) -> None:
            """At the first, say what takes so long, and compile the other part beside it."""
            del event
            if not helpers:
                typer.echo("compiling the simulated bench, once for this computer ...", err=True)
                helpers.append(subprocess.Popen([sys.executable, "-c", MEASURING]))

        def on_end(self, event: event.Event) -> None:
            """Nothing: which one is the last is not known here."""

    event.register("numba:compile", First())
    importlib.import_module(SIMULATION)
    for helper in helpers:
        helper.wait()
        typer.echo(f"compiled in {time.monotonic() - start:.0f} s", err=True)
