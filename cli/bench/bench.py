"""`pamrig virtual|vent|doctor|read|record|console` and `pamrig firmware ...`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cli.options import RUNS, JsonOption, OutOption, RigOption, SeedOption
from cli.output import print_json

if TYPE_CHECKING:
    from rigs.bench.firmware import Comparison

MAX_READ_S = 86400.0
PortOption = Annotated[str, typer.Option("--port", help="The board's own USB port.")]


def add_bench(app: typer.Typer) -> None:
    """Add the commands that use a bench."""
    for command in (virtual, vent, doctor, read, record, console):
        app.command()(command)


def add_firmware(app: typer.Typer) -> None:
    """Add the commands of `pamrig firmware`."""
    app.command("install")(install)
    app.command("check")(check)


def virtual(
    rig: RigOption = "virtual",
    folder: Annotated[Path, typer.Option("--dir", help="Folder for ports and rig file.")] = Path(
        "bench"
    ),
    seed: SeedOption = None,
    seconds: Annotated[float, typer.Option(help="Stop after this time; 0 = until Ctrl-C.")] = 0.0,
    truth: Annotated[
        Path | None,
        typer.Option(help="Write the bench's true state to this file, a JSON line each 10 ms."),
    ] = None,
    tcp: Annotated[
        bool, typer.Option("--tcp", help="TCP ports instead of pseudo-terminals.")
    ] = False,
    withheld: Annotated[
        bool, typer.Option("--withheld", help="Hide an effect; print only a hash of the answer.")
    ] = False,
    reveal: Annotated[
        bool, typer.Option("--reveal", help="Print the answer of the withheld bench in --dir.")
    ] = False,
) -> None:
    """Run a virtual bench in real time, on ports that any client can open."""
    if reveal:
        from rigs.virtual.withheld.bench import request_answer

        print_json(request_answer(folder))
    elif withheld:
        from cli.investigate.withheld_server import serve_withheld

        serve_withheld(rig, folder, seed=seed, seconds=seconds, tcp=tcp)
    else:
        from rigs.virtual.server import serve_bench

        serve_bench(rig, folder, seed=seed, seconds=seconds, truth=truth, tcp=tcp)


def vent(rig: RigOption = "virtual") -> None:
    """Make a bench safe by hand: vent, disarm, confirm by the pressure reading.

    A test that runs on the rig is asked to end, which vents.
    """
    from rigs.bench.vent import vent_beside
    from rigs.rigfile.config import load_rig

    pressure = vent_beside(load_rig(rig), lambda text: typer.echo(text, err=True))
    typer.echo(f"vented and disarmed: pressure reads {pressure:.1f} kPa")


def doctor(rig: RigOption = "virtual", out: OutOption = RUNS, as_json: JsonOption = False) -> None:
    """Check a rig before a test: list what would prevent a run."""
    from rigs.bench.doctor import examine, print_findings

    findings = examine(rig, out)
    if as_json:
        print_json([vars(f) for f in findings])
    else:
        print_findings(findings)
    raise typer.Exit(2 if any(f.status == "stop" for f in findings) else 0)


def read(
    rig: RigOption = "virtual",
    seconds: Annotated[float, typer.Option(help="How long to read.")] = 3.0,
    as_json: JsonOption = False,
) -> None:
    """Read every optional instrument of a rig: mean value and fault counts."""
    from daq.errors import ConfigError
    from rigs.bench.rig import open_rig
    from rigs.rigfile.config import load_rig

    if not 0.1 <= seconds <= MAX_READ_S:
        raise ConfigError("--seconds", f"{seconds:g} s is outside 0.1 to {MAX_READ_S:g} s")
    config = load_rig(rig)
    with open_rig(config) as opened:
        opened.valve.progress(seconds + 1.0)
        opened.event_loop.for_seconds(seconds)
        rows = []
        for name, instrument in opened.instruments.items():
            n = max(1, min(instrument.rows, round(seconds * instrument.rate_hz)))
            rows.append(
                {
                    "instrument": name,
                    "quantity": instrument.quantity,
                    "value": round(instrument.mean(n), 6),
                    **instrument.counters(),
                }
            )
    if as_json:
        typer.echo(json.dumps(rows, indent=2))
        return
    if not rows:
        typer.echo(f"{config.source} has no instruments beside valve, balance, stage and camera")
    for row in rows:
        faults = {k: v for k, v in row.items() if k not in ("instrument", "quantity", "value")}
        counts = ", ".join(f"{v} {k}" for k, v in faults.items())
        typer.echo(f"{row['instrument']:22} {row['quantity']:18} {row['value']:>10.5g}   {counts}")


def record(
    controller: Annotated[
        str, typer.Argument(help="Description of the controller: file, or shipped name.")
    ] = "own-controller",
    seconds: Annotated[
        float, typer.Option(help="How long to record; with --levels, for each of them.")
    ] = 10.0,
    levels: Annotated[
        str, typer.Option(help="Set-points in kPa, one after the other: 100,200,0.")
    ] = "",
    out: OutOption = RUNS,
    as_json: JsonOption = False,
) -> None:
    """Record a controller of your own that prints columns. It keeps no safety contract."""
    from daq.errors import ConfigError
    from rigs.recording.session import NO_CONTRACT
    from rigs.recording.session import record as run
    from rigs.rigfile.columns import load_columns

    if not 0.1 <= seconds <= MAX_READ_S:
        raise ConfigError("--seconds", f"{seconds:g} s is outside 0.1 to {MAX_READ_S:g} s")
    try:
        wanted = tuple(float(word) for word in levels.split(",")) if levels else ()
    except ValueError:
        raise ConfigError("--levels", f"{levels!r} is not a list of pressures in kPa") from None
    form = load_columns(controller)
    typer.echo(NO_CONTRACT, err=True)
    made = run(form, out, seconds, wanted)
    if as_json:
        told = {**made.times.as_dict(), "folder": str(made.folder), "outcome": made.outcome,
                "reason": made.reason, "rows": made.rows, "faults": made.faults}  # fmt: skip
        print_json({**told, "vented": made.vented, "safety": NO_CONTRACT})
    else:
        typer.echo(f"{made.folder}: {made.outcome}, {made.rows} rows, not rows: {made.faults}")
        typer.echo(
            f"time: {made.times.method}, u between rows {made.times.u_between_s:.2g} s, "
            f"u on this computer's clock {made.times.u_host_s:.2g} s"
        )
        if made.reason:
            typer.echo(made.reason, err=True)
    if made.vented is False:
        typer.echo("the set-point 0 was not taken: vent by hand", err=True)
    raise typer.Exit(0 if made.outcome == "clean" else 1)


def console(
    rig: RigOption = "virtual",
    beat: Annotated[bool, typer.Option("--beat", help="Send heartbeats from the start.")] = False,
) -> None:
    """Send commands to a valve controller by hand; vents and disarms at the end."""
    from rigs.bench.console import converse
    from rigs.rigfile.config import load_rig

    raise typer.Exit(converse(load_rig(rig), beat=beat))


def install(port: PortOption, as_json: JsonOption = False) -> None:
    """Copy the firmware to an RP2040 board, compare, and restart it."""
    from rigs.bench.firmware import install

    _print_comparison(install(port), as_json)


def check(port: PortOption, as_json: JsonOption = False) -> None:
    """Compare version and CRC of every file on a board; exit status 1 if they differ."""
    from rigs.bench.firmware import check

    found = check(port)
    _print_comparison(found, as_json)
    raise typer.Exit(0 if found.equal else 1)


def _print_comparison(found: Comparison, as_json: bool) -> None:
    typer.echo(found.as_json() if as_json else found.as_text())
