"""The first use of the compiled code on a computer: it takes half a minute, and says so."""

from __future__ import annotations

import importlib
import subprocess
import sys
import threading
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
QUICK_S = 2.0
"""Loading what is compiled already takes less."""


def compile_first() -> None:
    """Load the compiled code of a virtual test; where it must be compiled, show that.

    Simulation and picture measurement are compiled side by side. The result is kept on disk, for
    all later commands.
    """
    import numba  # noqa: F401 - takes a second itself, compiled or not

    said = threading.Event()

    def say() -> None:
        said.set()
        typer.echo("compiling the simulation for this computer (only the first time) ...", err=True)

    start = time.monotonic()
    timer = threading.Timer(QUICK_S, say)
    timer.daemon = True
    timer.start()
    try:
        measuring = subprocess.Popen([sys.executable, "-c", MEASURING])
        importlib.import_module(SIMULATION)
        measuring.wait()
    finally:
        timer.cancel()
    if said.is_set():
        typer.echo(f"compiled in {time.monotonic() - start:.0f} s", err=True)
