"""`pamrig virtual --withheld`: a bench with a secret, on ports, and `--reveal`."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

from daq.interrupt import stop_on_signals
from rigs.rigfile.config import RigConfig, load_rig
from rigs.virtual.bench import VirtualBench
from rigs.virtual.server import open_server


def serve_withheld(
    rig: str,
    folder: Path,
    *,
    seed: int | None = None,
    seconds: float = 0.0,
    tcp: bool = False,
) -> None:
    """Serve a bench that hides an effect until Ctrl-C; only the seal of its answer is printed.

    `seed` is that of the instruments' noise; the effect comes from the operating system's entropy.
    """
    import typer

    from cli.investigate.runnable import draw_runnable
    from rigs.virtual.withheld.bench import Envelope, WithheldBench

    config = load_rig(rig, seed)
    typer.echo("drawing an effect, and trying whether the rig runs with it ...")
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


def reveal(folder: Path) -> None:
    """Print the answer of the withheld bench in `folder`, once it has been found to match its seal.

    Raises:
        PamrigError: there is none, or the answer is not the one that was sealed.
    """
    import typer

    from rigs.virtual.withheld.bench import ask

    typer.echo(json.dumps(ask(folder), indent=2, allow_nan=False))
