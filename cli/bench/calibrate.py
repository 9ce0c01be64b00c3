"""`pamrig calibrate ...`: each command imports what it needs when it runs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Optional

import typer

calibrate_app = typer.Typer(help="Calibrate an instrument.", no_args_is_help=True)
RigOption = Annotated[str, typer.Option("--rig", help="Rig file, or the name of a shipped one.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON value, nothing else.")]


@calibrate_app.command("camera")
def calibrate_camera(
    out: Annotated[Path, typer.Option("--out", help="Calibration file to write.")],
    gauges: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option(help="Table of gauge-block pictures: file,length_mm,u_mm."),
    ] = None,
    board: Annotated[Optional[Path], typer.Option(help="Picture of a chessboard.")] = None,  # noqa: UP045
    squares: Annotated[str, typer.Option(help="Inner corners of the board: COLUMNSxROWS.")] = "9x6",
    square_mm: Annotated[float, typer.Option(help="Side of a square of the board.")] = 5.0,
    offset_mm: Annotated[float, typer.Option(help="Length at zero gap (board only).")] = 0.0,
    u_offset_mm: Annotated[float, typer.Option(help="Its standard uncertainty.")] = 0.0,
    domain_mm: Annotated[str, typer.Option(help="Lengths it holds for: LOW,HIGH (board).")] = "",
    nearer: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option(help="The board again, nearer to the camera by --nearer-mm."),
    ] = None,
    nearer_mm: Annotated[float, typer.Option(help="How much nearer.")] = 0.0,
    distance_mm: Annotated[
        Optional[float],  # noqa: UP045
        typer.Option(help="From the lens to the plane of the marks (gauges only)."),
    ] = None,
    u_off_plane_mm: Annotated[
        float, typer.Option(help="How well the marks stand in the calibrated plane.")
    ] = 0.0,
    identity: Annotated[str, typer.Option("--id", help="Name of this calibration.")] = "",
    as_json: JsonOption = False,
) -> None:
    """Pixels to millimetres: gauge-block pictures, or a chessboard in the plane of the marks."""
    from cli.data.commands import calibrate_camera_command

    calibrate_camera_command(
        out, gauges, board, squares, square_mm, offset_mm, u_offset_mm, domain_mm, nearer,
        nearer_mm, distance_mm, u_off_plane_mm, identity, as_json,
    )  # fmt: skip


@calibrate_app.command("pressure")
def calibrate_pressure(
    out: Annotated[Path, typer.Option("--out", help="Calibration file to write.")],
    rig: RigOption = "virtual",
    pressures: Annotated[str, typer.Option(help="To stop at, in kPa.")] = "0,100,200,300,400,500",
    gauge: Annotated[
        str, typer.Option(help="A gauge that you read; without: the rig's pressure_transmitter.")
    ] = "",
    u_each: Annotated[float, typer.Option(help="Of one gauge reading, in kPa.")] = 0.0,
    u_zero: Annotated[float, typer.Option(help="Of the gauge's zero, in kPa.")] = 0.0,
    u_gain: Annotated[float, typer.Option(help="Of the gauge's scale, relative.")] = 0.0,
    records: Annotated[Path, typer.Option(help="Folder for the record.")] = Path("calibrations"),
    operator: Annotated[str, typer.Option(help="Who calibrates.")] = "",
    replace: Annotated[bool, typer.Option("--replace", help="Replace an existing file.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Counts to kPa: the bench's own pressures, up and down, against a reference."""
    from cli.bench.calibrate_commands import pressure_command

    pressure_command(
        rig, out, pressures, gauge, u_each, u_zero, u_gain, records, operator, replace, as_json
    )


@calibrate_app.command("force")
def calibrate_force(
    out: Annotated[Path, typer.Option("--out", help="Calibration file to write.")],
    rig: RigOption = "virtual",
    masses: Annotated[str, typer.Option(help="Dead weights, in kg.")] = "0,1,2,5",
    weights: Annotated[str, typer.Option(help="Which set of weights.")] = "dead weights",
    u_each: Annotated[float, typer.Option(help="Of a single weight, in N.")] = 0.0,
    u_gain: Annotated[float, typer.Option(help="Of the set and of local g, relative.")] = 1e-4,
    records: Annotated[Path, typer.Option(help="Folder for the record.")] = Path("calibrations"),
    operator: Annotated[str, typer.Option(help="Who calibrates.")] = "",
    replace: Annotated[bool, typer.Option("--replace", help="Replace an existing file.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Grams (or a load cell's reading) to newtons: dead weights, up and down."""
    from cli.bench.calibrate_commands import force_command

    force_command(rig, out, masses, weights, u_each, u_gain, records, operator, replace, as_json)
