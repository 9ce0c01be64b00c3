"""`pamrig calibrate camera|pose|pressure|force|length|regulator|check`."""

from __future__ import annotations

import dataclasses
import math
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cli.options import JsonOption, OperatorOption, RigOption, bounded
from cli.output import print_json, writing
from daq.errors import ConfigError

if TYPE_CHECKING:
    from analysis.regression.calibration_line import Reference
    from daq.calibration import Calibration
    from daq.interrupt import StopFlag
    from rigs.calibration.run import Calibrated
    from rigs.execution.runner import Watch

CalibrationOption = Annotated[Path, typer.Option("--out", help="Calibration file to write.")]
RecordsOption = Annotated[Path, typer.Option(help="Folder for the record.")]
ReplaceOption = Annotated[bool, typer.Option("--replace", help="Replace an existing file.")]
ValidOption = Annotated[
    int, typer.Option("--valid-days", help="Days after which it is due again; 0: none stated.")
]
RECORDS = Path("calibrations")


def add_calibration(app: typer.Typer) -> None:
    """Add the commands of `pamrig calibrate`."""
    for command in (camera, pose, pressure, force, length, regulator, check):
        app.command()(command)


def camera(
    out: CalibrationOption,
    gauges: Annotated[
        Path | None, typer.Option(help="Table of gauge-block pictures: file,length_mm,u_mm.")
    ] = None,
    board: Annotated[Path | None, typer.Option(help="Picture of a chessboard.")] = None,
    squares: Annotated[str, typer.Option(help="Inner corners of the board: COLUMNSxROWS.")] = "9x6",
    square_mm: Annotated[float, typer.Option(help="Side of a square of the board.")] = 5.0,
    offset_mm: Annotated[float, typer.Option(help="Length at zero gap (board only).")] = 0.0,
    u_offset_mm: Annotated[float, typer.Option(help="Its standard uncertainty.")] = 0.0,
    domain_mm: Annotated[str, typer.Option(help="Valid lengths: LOW,HIGH (board).")] = "",
    nearer: Annotated[
        Path | None, typer.Option(help="The board again, nearer to the camera by --nearer-mm.")
    ] = None,
    nearer_mm: Annotated[float, typer.Option(help="Distance between the two positions.")] = 0.0,
    distance_mm: Annotated[
        float | None, typer.Option(help="Distance from lens to marker plane (gauges only).")
    ] = None,
    u_off_plane_mm: Annotated[
        float, typer.Option(help="Standard uncertainty of the markers' distance to that plane.")
    ] = 0.0,
    identity: Annotated[str, typer.Option("--id", help="Name of this calibration.")] = "",
    valid_days: ValidOption = 0,
    as_json: JsonOption = False,
) -> None:
    """Pixels to millimetres: gauge-block pictures, or a chessboard in the marker plane."""
    from rigs.calibration import camera as cc
    from rigs.rigfile.camera_calibration import save_camera_calibration

    _valid_days(valid_days)
    bounded("--square-mm", square_mm, 0.0, 1000.0, "mm", above=True)
    bounded("--offset-mm", offset_mm, -10_000.0, 10_000.0, "mm")
    bounded("--u-offset-mm", u_offset_mm, 0.0, 1000.0, "mm")
    bounded("--nearer-mm", nearer_mm, -10_000.0, 10_000.0, "mm")
    bounded("--u-off-plane-mm", u_off_plane_mm, 0.0, 1000.0, "mm")
    if distance_mm is not None:
        bounded("--distance-mm", distance_mm, 0.0, 100_000.0, "mm", above=True)
    if (gauges is None) == (board is None):
        raise ConfigError("calibrate camera", "needs either --gauges or --board")
    if gauges is not None:
        found = cc.calibrate_from_gauges(
            gauges, identity=identity, distance_mm=distance_mm, u_off_plane_mm=u_off_plane_mm
        )
    else:
        assert board is not None
        domain = _pair(domain_mm, ",", "--domain-mm", "50,73")
        across, down = _pair(squares.lower(), "x", "--squares", "9x6")
        for corners in (across, down):
            bounded("--squares", corners, 3, 1000, "corners")
        found = cc.calibrate_from_board(
            board,
            (int(across), int(down)),
            square_mm,
            offset_mm=offset_mm,
            u_offset_mm=u_offset_mm,
            domain=domain,
            nearer=nearer,
            nearer_mm=nearer_mm,
            u_off_plane_mm=u_off_plane_mm,
            identity=identity,
        )
    found = dataclasses.replace(found, calibration=_valid(found.calibration, valid_days))
    with writing(out):
        save_camera_calibration(out, found)
    if as_json:
        print_json(found.to_dict())
        return
    c = found.calibration
    typer.echo(
        f"{c.scale:.6f} mm/pixel (u {c.u_gain * 100:.4f} %), {c.offset:.4f} mm at zero gap "
        f"(u {c.u_offset:.4f} mm), {c.domain[0]:g} to {c.domain[1]:g} mm; {c.note}"
    )
    if found.lens is not None:
        typer.echo(f"lens distortion k1 = {found.lens.k1:.5f} (u {found.lens.u_k1:.5f})")
    if found.off_plane_per_mm:
        typer.echo(f"off the plane: {found.off_plane_per_mm * 100:.4f} % per mm")
    typer.echo(f'written to {out}; in a rig file: [camera] calibration = "{out.name}"')


def pose(
    out: CalibrationOption,
    pictures: Annotated[str, typer.Option(help="Pictures of the ChArUco board: folder or video.")],
    board: Annotated[str, typer.Option(help="Squares of the board: COLUMNSxROWS.")] = "7x5",
    square_mm: Annotated[float, typer.Option(help="Side of a square.")] = 14.0,
    mark_mm: Annotated[float, typer.Option(help="Side of a mark in a square.")] = 10.0,
    dictionary: Annotated[str, typer.Option(help="Set of the marks.")] = "4x4_50",
    plane: Annotated[
        str, typer.Option(help="Picture of the board lying in the plane of motion.")
    ] = "",
    as_json: JsonOption = False,
) -> None:
    """Calibrate the camera for `pamrig pose`, by pictures of a ChArUco board at several tilts."""
    from rigs.calibration.pose import calibrate_pose
    from rigs.rigfile.tables.marks import save_pose_camera
    from vision.pose.detect import DICTIONARIES, Board

    bounded("--square-mm", square_mm, 0.0, 1000.0, "mm", above=True)
    bounded("--mark-mm", mark_mm, 0.0, 0.95 * square_mm, "mm", above=True)
    if dictionary not in DICTIONARIES:
        known = ", ".join(DICTIONARIES)
        raise ConfigError("--dictionary", f"{dictionary!r} is not known", f"known: {known}")
    across, down = _pair(board.lower(), "x", "--board", "7x5")
    for squares in (across, down):
        bounded("--board", squares, 3, 100, "squares")
    shape = Board(int(across), int(down), square_mm, mark_mm, dictionary)
    if shape.marks > (most := int(dictionary.split("_")[1])):
        raise ConfigError("--board", f"needs {shape.marks} marks, {dictionary} has {most}")
    camera = calibrate_pose(pictures, shape, plane)
    with writing(out):
        save_pose_camera(out, camera)
    if as_json:
        print_json(camera.to_dict())
        return
    typer.echo(
        f"{out}: focal length {camera.fx:.1f} and {camera.fy:.1f} pixels, centre "
        f"{camera.cx:.1f}, {camera.cy:.1f}, rms {camera.rms_px:.3f} pixels, {camera.views} pictures"
        + ("" if camera.plane else "; without a plane: give marks a reference")
    )


def pressure(
    out: CalibrationOption,
    rig: RigOption = "virtual",
    pressures: Annotated[
        str, typer.Option("--pressures-kpa", "--pressures", help="Pressures in kPa.")
    ] = "0,100,200,300,400,500",
    gauge: Annotated[
        str,
        typer.Option(help="A gauge read by the operator; default: the rig's pressure_transmitter."),
    ] = "",
    u_each: Annotated[float, typer.Option(help="u of one gauge reading, in kPa.")] = 0.0,
    u_zero: Annotated[float, typer.Option(help="u of the gauge's zero, in kPa.")] = 0.0,
    u_gain: Annotated[float, typer.Option(help="u of the gauge's scale, relative.")] = 0.0,
    records: RecordsOption = RECORDS,
    operator: OperatorOption = "",
    replace: ReplaceOption = False,
    valid_days: ValidOption = 0,
    as_json: JsonOption = False,
) -> None:
    """Counts to kPa: pressures up and down on the bench, compared with a reference."""
    from rigs.calibration.pressure import calibrate_pressure
    from rigs.rigfile.config import load_rig

    reference = _reference(gauge, u_each, u_zero, u_gain)
    with _calibrating(out, replace, valid_days) as stop:
        done = calibrate_pressure(
            load_rig(rig), _numbers(pressures, "--pressures-kpa"), records,
            reference=reference if gauge else None, who=operator, stop=stop, watch=_watch(as_json),
        )  # fmt: skip
    _write(done, out, replace, valid_days, as_json)


def force(
    out: CalibrationOption,
    rig: RigOption = "virtual",
    masses: Annotated[
        str, typer.Option("--masses-kg", "--masses", help="Dead weights, in kg.")
    ] = "0,1,2,5",
    weights: Annotated[str, typer.Option(help="Name of the set of weights.")] = "dead weights",
    u_each: Annotated[float, typer.Option(help="u of a single weight, in N.")] = 0.0,
    u_gain: Annotated[float, typer.Option(help="u of the set and of local g, relative.")] = 1e-4,
    records: RecordsOption = RECORDS,
    operator: OperatorOption = "",
    replace: ReplaceOption = False,
    valid_days: ValidOption = 0,
    as_json: JsonOption = False,
) -> None:
    """Grams (or a load cell's reading) to newtons: dead weights, up and down."""
    from rigs.calibration.force import calibrate_force
    from rigs.rigfile.config import load_rig

    reference = _reference(weights, u_each, 0.0, u_gain)
    with _calibrating(out, replace, valid_days) as stop:
        done = calibrate_force(
            load_rig(rig), _numbers(masses, "--masses-kg"), records, weights=reference,
            who=operator, stop=stop, watch=_watch(as_json),
        )  # fmt: skip
    _write(done, out, replace, valid_days, as_json)


def length(
    out: CalibrationOption,
    rig: RigOption = "virtual-laser",
    lengths: Annotated[
        str, typer.Option("--lengths-mm", help="Gauge blocks, or positions of the stage, in mm.")
    ] = "52,57,62,67,72",
    instrument: Annotated[
        str, typer.Option(help="The instrument; default: length_source of the rig.")
    ] = "",
    blocks: Annotated[
        str, typer.Option(help="Name of the blocks, or of the certificate of the stage.")
    ] = "",
    by_stage: Annotated[
        bool, typer.Option("--by-stage", help="The motor stage instead of gauge blocks.")
    ] = False,
    u_each: Annotated[float, typer.Option(help="u of a single length, in mm.")] = 0.0,
    u_zero: Annotated[
        float, typer.Option(help="u common to all lengths (seat, zero of the stage), in mm.")
    ] = 0.0,
    u_gain: Annotated[float, typer.Option(help="u common to all lengths, relative.")] = 0.0,
    records: RecordsOption = RECORDS,
    operator: OperatorOption = "",
    replace: ReplaceOption = False,
    valid_days: ValidOption = 0,
    as_json: JsonOption = False,
) -> None:
    """Reading of a laser, gauge, LVDT or encoder to mm: gauge blocks or the stage, up and down."""
    from rigs.calibration.length import calibrate_length
    from rigs.rigfile.config import load_rig

    name = blocks or ("stage" if by_stage else "gauge blocks")
    reference = _reference(name, u_each, u_zero, u_gain)
    with _calibrating(out, replace, valid_days) as stop:
        done = calibrate_length(
            load_rig(rig), _numbers(lengths, "--lengths-mm"), records, blocks=reference,
            instrument=instrument, by_stage=by_stage, who=operator, stop=stop,
            watch=_watch(as_json),
        )  # fmt: skip
    _write(done, out, replace, valid_days, as_json)


def regulator(
    out: CalibrationOption,
    rig: RigOption = "virtual-alicat",
    repeats: Annotated[int, typer.Option(help="How often every step is made.")] = 3,
    increment_kpa: Annotated[
        float, typer.Option("--increment-kpa", help="Small steps for the dead band, in kPa.")
    ] = 0.25,
    records: RecordsOption = RECORDS,
    operator: OperatorOption = "",
    replace: ReplaceOption = False,
    valid_days: ValidOption = 0,
    as_json: JsonOption = False,
) -> None:
    """Dynamics of a proportional regulator: steps, small steps and a ramp on the bench."""
    from rigs.calibration.regulator import calibrate_regulator, summary
    from rigs.rigfile.config import load_rig
    from rigs.rigfile.tables.regulator import write_dynamics

    bounded("--repeats", repeats, 2, 100, "")
    bounded("--increment-kpa", increment_kpa, 0.01, 50.0, "kPa")
    with _calibrating(out, replace, valid_days) as stop:
        done = calibrate_regulator(
            load_rig(rig), records, repeats=repeats, increment_kpa=increment_kpa,
            who=operator, stop=stop, watch=_watch(as_json),
        )  # fmt: skip
    about = {**done.about, **({"valid_days": valid_days} if valid_days else {})}
    write_dynamics(out, done.found.regulator, done.found.u, about, replace)
    rows = summary(done.found)
    if as_json:
        print_json(
            {**about, "values": {name: value for name, _, value, _ in rows},
             "u": done.found.u, "file": str(out), "folder": str(done.folder)}
        )  # fmt: skip
        return
    for name, unit, value, u in rows:
        typer.echo(f"{name:16} {value:10.4g} {unit:6} u {u:.2g}")
    if done.found.slew_above_kpa_s:
        typer.echo(f"slew limit not reached: above {done.found.slew_above_kpa_s:.0f} kPa/s")
    typer.echo(
        f"steps fit within {done.found.misfit_kpa:.2f} kPa rms; the ramp, which was not fitted,"
        f" is predicted within {done.ramp_kpa:.2f} kPa rms"
    )
    typer.echo(f"written: {out}   record: {done.folder}")
    typer.echo(f'in a rig file: [pressure_source] dynamics = "{out.name}"')


def check(
    out: Annotated[Path, typer.Option("--out", help="standards.csv to write.")],
    rig: RigOption = "virtual",
    channels: Annotated[
        str,
        typer.Option(
            "--channels",
            help="length_mm (camera), held_length_mm (holders), pressure_kpa (board's sensor).",
        ),
    ] = "length_mm,held_length_mm",
    u_blocks: Annotated[
        float, typer.Option("--u-mm", help="u of a length by gauge blocks, in mm.")
    ] = 0.01,
    u_gauge: Annotated[
        float, typer.Option("--u-kpa", help="u of the reference gauge as it is read, in kPa.")
    ] = 0.3,
    records: RecordsOption = RECORDS,
    operator: OperatorOption = "",
    replace: ReplaceOption = False,
    as_json: JsonOption = False,
) -> None:
    """What the instruments are off by now: blocks, gauge, for the diagnosis. Changes nothing."""
    from daq.wholefile import whole_files
    from gap.data.from_runs import standards_text
    from rigs.calibration.standards import GAUGE_CHANNEL, read_standards, readable_standards
    from rigs.rigfile.config import load_rig

    bounded("--u-mm", u_blocks, 0.0, 10.0, "mm", above=True)
    bounded("--u-kpa", u_gauge, 0.0, 100.0, "kPa", above=True)
    config = load_rig(rig)
    wanted = [word.strip() for word in channels.split(",") if word.strip()]
    possible = readable_standards(config)
    for word in wanted or [""]:
        if word not in possible:
            raise ConfigError(
                "--channels", f"{word!r} cannot be read with a standard here ({config.source})",
                f"possible: {', '.join(possible)}" if possible else "run it at a terminal",
            )  # fmt: skip
    u = {name: u_gauge if name == GAUGE_CHANNEL else u_blocks for name in wanted}
    with _calibrating(out, replace, 0) as stop:
        read, folder = read_standards(
            config, wanted, records, u=u, who=operator, stop=stop, watch=_watch(as_json)
        )
    with writing(out), whole_files() as part:
        part(out).write_text(standards_text(read), encoding="utf-8")
    if as_json:
        print_json(
            {"readings": [vars(one) for one in read], "file": str(out), "record": str(folder)}
        )
        return
    typer.echo(f"{'channel':>15} {'true':>9} {'read':>9} {'off':>8} {'u':>7}")
    for one in read:
        off = one.read - one.true
        typer.echo(f"{one.channel:>15} {one.true:9.3f} {one.read:9.3f} {off:8.3f} {one.u:7.3f}")
    typer.echo(f"written: {out}   record: {folder}")


def _pair(text: str, separator: str, key: str, example: str) -> tuple[float, float]:
    """Two numbers with a separator between them."""
    try:
        low, high = (float(part) for part in text.split(separator))
    except ValueError:
        raise ConfigError(key, f"expected two numbers as in {example}, got {text!r}") from None
    return low, high


def _numbers(text: str, key: str) -> list[float]:
    """The numbers of a list such as "0,100,200"."""
    try:
        return [float(word) for word in text.split(",") if word.strip()]
    except ValueError:
        raise ConfigError(
            key, f"{text!r} is not a list of numbers", "write it as 0,100,200"
        ) from None


def _reference(name: str, u_each: float, u_zero: float, u_gain: float) -> Reference:
    """What a sensor is compared with; the uncertainties are checked."""
    from analysis.regression.calibration_line import Reference

    return Reference(
        name,
        _uncertainty(u_each, "--u-each"),
        _uncertainty(u_zero, "--u-zero"),
        _uncertainty(u_gain, "--u-gain", relative=True),
    )


def _uncertainty(value: float, key: str, relative: bool = False) -> float:
    """Check a standard uncertainty from the command line."""
    if not 0.0 <= value < (1.0 if relative else math.inf):
        raise ConfigError(
            key,
            f"{value:g} is not a {'relative ' if relative else ''}standard uncertainty",
            "0.001 is 0.1 %" if relative else "give a number from 0 up",
        )
    return value


@contextmanager
def _calibrating(out: Path, replace: bool, valid_days: int) -> Iterator[StopFlag]:
    """A calibration, which Ctrl-C ends in good order; gives the flag that it watches.

    That the file can be written is checked before an hour of measurement depends on it.
    """
    from daq.interrupt import stop_on_signals

    _valid_days(valid_days)
    if out.exists() and not replace:
        raise ConfigError(str(out), "exists already", "choose another --out, or add --replace")
    if not out.absolute().parent.is_dir():
        raise ConfigError(str(out), "its folder does not exist", "create it first")
    with stop_on_signals() as stop:
        yield stop


def _watch(as_json: bool) -> Watch:
    from rigs.execution.runner import Watch

    if as_json:
        return Watch()

    def show(text: str) -> None:
        print(text, file=sys.stderr, flush=True)

    return Watch(state=show, log=show)


def _valid_days(days: int) -> None:
    from daq.calibration import MOST_DAYS

    bounded("--valid-days", days, 0, MOST_DAYS, "days")


def _valid(calibration: Calibration, days: int) -> Calibration:
    """The calibration with its due date."""
    return dataclasses.replace(calibration, valid_days=days)


def _write(done: Calibrated, out: Path, replace: bool, valid_days: int, as_json: bool) -> None:
    from rigs.rigfile.calibration_file import write_calibration

    c = _valid(done.file.calibration, valid_days)
    write_calibration(out, dataclasses.replace(done.file, calibration=c), done.points, replace)
    if as_json:
        print_json(
            {**c.to_dict(), "linearity": done.file.linearity, "file": str(out),
             "record": str(done.folder), "points": [list(p) for p in done.points]}
        )  # fmt: skip
        return
    typer.echo(f"{c.raw_unit:>12} {'reference ' + c.unit:>14} {'residual ' + c.unit:>14}")
    for raw, reference, residual in done.points:
        typer.echo(f"{raw:12.5g} {reference:14.5g} {residual:14.3g}")
    typer.echo(
        f"{c.quantity} = {c.offset:.6g} + {c.scale:.8g} * {c.raw_unit}, "
        f"u = {c.u_offset:.3g} {c.unit} + {c.u_gain * 100:.3g} %, "
        f"linear within {done.file.linearity:.3g} {c.unit}, "
        f"{c.domain[0]:g} to {c.domain[1]:g} {c.unit}"
    )
    typer.echo(f"written: {out}   record: {done.folder}")
