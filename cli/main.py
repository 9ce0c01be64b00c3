"""The command line: thin; each command imports what it needs when it runs.

Top floor: here, and in `cli.investigate.investigate`, rigs and diagnosis meet.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated, Any, Optional

import typer

from cli.bench.calibrate import calibrate_app
from cli.data.records import add_records
from cli.gap.effects import gap_effects
from cli.gap.main import gap_app
from cli.gap.report import gap_report
from cli.gap.runs import gap_export
from cli.gap.thesis import gap_thesis
from cli.investigate.command import gap_investigate
from cli.model.models import fit, models_app
from cli.protocols.protocols import add_protocols
from cli.simulate.simulate import add_simulation

app = typer.Typer(
    name="pamrig",
    help="Test bench for pneumatic artificial muscles: run tests, view, reduce, report.",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    add_completion=False,
)
runs_app = typer.Typer(help="List, show, verify and rebuild recorded runs.", no_args_is_help=True)
import_app = typer.Typer(help="Make a run of data from elsewhere.", no_args_is_help=True)
app.add_typer(runs_app, name="runs")
app.add_typer(models_app, name="models")
app.command()(fit)
app.add_typer(import_app, name="import")
app.add_typer(calibrate_app, name="calibrate")
app.add_typer(gap_app, name="gap")
gap_app.command("effects")(gap_effects)
gap_app.command("export")(gap_export)
gap_app.command("investigate")(gap_investigate)
gap_app.command("report")(gap_report)
gap_app.command("thesis")(gap_thesis)
add_protocols(app, runs_app)
add_records(runs_app)
add_simulation(app)

RigOption = Annotated[str, typer.Option("--rig", help="Rig file, or the name of a shipped one.")]
OutOption = Annotated[Path, typer.Option("--out", help="Folder of runs.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON value, nothing else.")]
RunArgument = Annotated[str, typer.Argument(help="Run folder, run id, or 'last'.")]
RUNS = Path("runs")


def emit(value: Any) -> None:
    """Print one JSON value."""
    typer.echo(json.dumps(value, indent=2, allow_nan=False))


@app.command()
def virtual(
    rig: RigOption = "virtual",
    folder: Annotated[Path, typer.Option("--dir", help="Where ports and rig file appear.")] = Path(
        "bench"
    ),
    seed: Annotated[Optional[int], typer.Option(help="Seed of the bench.")] = None,  # noqa: UP045
    seconds: Annotated[float, typer.Option(help="Stop after so long; 0 = until Ctrl-C.")] = 0.0,
    truth: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option(help="Write the bench's true state to this file, a JSON line each 10 ms."),
    ] = None,
    tcp: Annotated[
        bool, typer.Option("--tcp", help="TCP ports instead of pseudo-terminals.")
    ] = False,
    withheld: Annotated[
        bool, typer.Option("--withheld", help="Hide an effect; print only its answer's seal.")
    ] = False,
    reveal: Annotated[
        bool, typer.Option("--reveal", help="Print the answer of the withheld bench in --dir.")
    ] = False,
) -> None:
    """Keep a virtual bench running in real time, on ports that any client can open."""
    if withheld or reveal:
        from cli.investigate import withheld_server as withheldserver

        if reveal:
            withheldserver.reveal(folder)
        else:
            withheldserver.serve_withheld(rig, folder, seed=seed, seconds=seconds, tcp=tcp)
        return
    from rigs.virtual.server import serve_bench

    serve_bench(rig, folder, seed=seed, seconds=seconds, truth=truth, tcp=tcp)


@app.command()
def vent(rig: RigOption = "virtual") -> None:
    """Make a bench safe by hand: vent, disarm, confirm by the pressure reading."""
    from rigs.bench.vent import vent_rig
    from rigs.rigfile.config import load_rig

    pressure = vent_rig(load_rig(rig))
    typer.echo(f"vented and disarmed: pressure reads {pressure:.1f} kPa")


@app.command()
def doctor(rig: RigOption = "virtual", out: OutOption = RUNS, as_json: JsonOption = False) -> None:
    """Check a rig before a test: says what would stop a run."""
    from rigs.bench.doctor import examine, print_findings

    findings = examine(rig, out)
    if as_json:
        emit([vars(f) for f in findings])
    else:
        print_findings(findings)
    raise typer.Exit(2 if any(f.status == "stop" for f in findings) else 0)


@app.command()
def report(
    run: RunArgument = "last",
    out: Annotated[Optional[Path], typer.Option("--out", help="HTML file to write.")] = None,  # noqa: UP045
    runs: Annotated[Path, typer.Option("--runs", help="Folder of runs.")] = RUNS,
    as_json: JsonOption = False,
) -> None:
    """Reduce a run and write its report: one HTML file that stands alone."""
    from cli.data.commands import report_command

    report_command(run, runs, out, as_json)


@app.command()
def view(
    run: RunArgument = "last",
    runs: Annotated[Path, typer.Option("--runs", help="Folder of runs.")] = RUNS,
) -> None:
    """Open a recorded run in the viewer."""
    from cli.data.commands import view_command

    view_command(run, runs)


@app.command()
def length(
    frames: Annotated[
        str, typer.Argument(help="Picture, folder, TIFF stack, video or run folder.")
    ],
    method: Annotated[str, typer.Option(help="edge or macro.")] = "edge",
    calibration: Annotated[Optional[Path], typer.Option(help="Camera calibration file.")] = None,  # noqa: UP045
    preview: Annotated[
        Path | None, typer.Option(help="Write a picture of the measurement.")
    ] = None,
    threshold: Annotated[
        int, typer.Option(help="Macro: NIH grey level, 0 white to 255 black.")
    ] = 130,
    roi: Annotated[
        str, typer.Option(help="Region left,top,width,height (macro: after the flip).")
    ] = "",
    flip: Annotated[
        bool, typer.Option("--flip/--no-flip", help="Macro: flip horizontally.")
    ] = True,
    count: Annotated[int, typer.Option(help="Frames to take from a live camera.")] = 1,
    as_json: JsonOption = False,
) -> None:
    """Measure lengths in pictures."""
    from cli.data.commands import length_command

    raise typer.Exit(
        length_command(frames, method, calibration, preview, threshold, roi, flip, as_json, count)
    )


@app.command()
def links(
    arm: Annotated[str, typer.Argument(help="Arm file, or the name of a shipped one.")],
    form: Annotated[str, typer.Option("--print", help="text, latex or python.")] = "text",
) -> None:
    """Derive an arm's equations of motion and print them."""
    from cli.model.links import links_command

    links_command(arm, form)


@runs_app.command("list")
def runs_list(
    runs: Annotated[Path, typer.Option("--runs", help="Folder of runs.")] = RUNS,
    as_json: JsonOption = False,
) -> None:
    """All runs, oldest first."""
    from cli.data.runs import list_command

    list_command(runs, as_json)


@runs_app.command("show")
def runs_show(
    run: RunArgument = "last",
    runs: Annotated[Path, typer.Option("--runs", help="Folder of runs.")] = RUNS,
    as_json: JsonOption = False,
) -> None:
    """What one run is and how it ended."""
    from cli.data.runs import show_command

    show_command(run, runs, as_json)


@runs_app.command("verify")
def runs_verify(
    run: RunArgument = "last",
    runs: Annotated[Path, typer.Option("--runs", help="Folder of runs.")] = RUNS,
    as_json: JsonOption = False,
) -> None:
    """Check every byte of a record against its checksums; exit status 1 on damage."""
    from cli.data.runs import verify_command

    raise typer.Exit(verify_command(run, runs, as_json))


@runs_app.command("rebuild")
def runs_rebuild(
    run: RunArgument = "last",
    runs: Annotated[Path, typer.Option("--runs", help="Folder of runs.")] = RUNS,
    as_json: JsonOption = False,
) -> None:
    """Make everything derived from the record anew: table, samples, report, view."""
    from cli.data.runs import rebuild_command

    rebuild_command(run, runs, as_json)


@app.command()
def read(
    rig: RigOption = "virtual",
    seconds: Annotated[float, typer.Option(help="How long to listen.")] = 3.0,
    as_json: JsonOption = False,
) -> None:
    """Listen to every optional instrument of a rig: what it reads, and its faults."""
    from cli.bench.calibrate_commands import read_command

    read_command(rig, seconds, as_json)


@import_app.command("thesis")
def import_thesis(
    table: Annotated[str, typer.Argument(help="Thesis table: c01 (isometric).")],
    out: OutOption = RUNS,
    warm: Annotated[
        bool, typer.Option("--warm", help="Also the warm columns, which are a formula.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Make a run of a thesis table; only measured columns unless told otherwise."""
    from cli.data.commands import import_command

    import_command("thesis", table, out, warm, as_json)


@import_app.command("points")
def import_points(
    source: Annotated[str, typer.Argument(help="CSV of settled points, or an exchange folder.")],
    out: OutOption = RUNS,
    as_json: JsonOption = False,
) -> None:
    """Make a run of settled points measured elsewhere."""
    from cli.data.commands import import_command

    import_command("points", source, out, False, as_json)


@app.command()
def console(
    rig: RigOption = "virtual",
    beat: Annotated[bool, typer.Option("--beat", help="Send heartbeats from the start.")] = False,
) -> None:
    """Talk to a valve controller by hand; vents and disarms at the end."""
    from rigs.bench.console import converse
    from rigs.rigfile.config import load_rig

    raise typer.Exit(converse(load_rig(rig), beat=beat))


firmware_app = typer.Typer(help="Put the firmware on a board, and check it.", no_args_is_help=True)
app.add_typer(firmware_app, name="firmware")
PortOption = Annotated[str, typer.Option("--port", help="The board's own USB port.")]


@firmware_app.command("install")
def firmware_install(port: PortOption, as_json: JsonOption = False) -> None:
    """Copy the firmware to an RP2040 board, compare, and restart it."""
    from rigs.bench.firmware import install

    found = install(port)
    typer.echo(found.as_json() if as_json else found.as_text())


@firmware_app.command("check")
def firmware_check(port: PortOption, as_json: JsonOption = False) -> None:
    """Compare version and CRC of every file on a board; exit status 1 if they differ."""
    from rigs.bench.firmware import check

    found = check(port)
    typer.echo(found.as_json() if as_json else found.as_text())
    raise typer.Exit(0 if found.equal else 1)


def main() -> None:
    """Entry point of the console script: user errors become one line and exit status 2."""
    from daq.errors import PamrigError, printable

    try:
        app(standalone_mode=True)
    except PamrigError as error:
        typer.echo(printable(f"pamrig: {error}"), err=True)
        sys.exit(2)
    except BrokenPipeError:
        sys.exit(1)


if __name__ == "__main__":
    main()
