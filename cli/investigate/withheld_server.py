"""`pamrig virtual --withheld`: a virtual bench on ports that hides an effect."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import typer

from daq.interrupt import stop_on_signals
from rigs.rigfile.config import RigConfig, load_rig
from rigs.virtual.bench import VirtualBench
from rigs.virtual.server import open_server


def serve_withheld(
    rig: str, folder: Path, *, seed: int | None = None, seconds: float = 0.0, tcp: bool = False
) -> None:
    """Serve a bench that hides an effect until Ctrl-C; print only the hash of its answer.

    `seed` is for the noise of the instruments; the effect uses the operating system's entropy.
    """
    from cli.investigate.runnable import draw_runnable
    from rigs.virtual.withheld.bench import Envelope, WithheldBench

    config = load_rig(rig, seed)
    typer.echo("drawing an effect, and checking that the rig can run with it ...")
    secret = draw_runnable(config, report=typer.echo)
    benches: list[WithheldBench] = []

    def make(config: RigConfig, origin_ns: int) -> VirtualBench:
        benches.append(WithheldBench(config, secret, origin_ns=origin_ns))
        return benches[0]

    with open_server(config, folder, tcp, None, make) as server, stop_on_signals() as stop:
        bench = benches[0]
        stated: dict[str, Any] = config.virtual.plant if config.virtual is not None else {}
        envelope = Envelope(folder, bench.digest, bench.reveal(), stated)
        typer.echo(f"sealed   sha256:{bench.digest}")
        typer.echo(f"rig file {server.rig_file}")
        typer.echo(f"try:     pamrig gap investigate --rig {server.rig_file}")
        typer.echo(f"then:    pamrig virtual --reveal --dir {folder}")
        end = time.monotonic() + seconds if seconds > 0 else float("inf")
        try:
            while not stop.reason and time.monotonic() < end:
                server.step()
                envelope.step()
                server.rest()
        finally:
            envelope.close()
