"""What the commands do, between the command line and the packages that do the work."""

from __future__ import annotations

import json
import signal
import sys
from pathlib import Path

import typer

from daq.clock import RealClock
from daq.errors import ConfigError, PamrigError


def report_command(run: str, runs: Path, out: Path | None, as_json: bool) -> None:
    """Reduce a run anew and write its report."""
    from analysis.reporting.derived import derive_all
    from analysis.reporting.report import report_json
    from daq.store.store import find_run

    found = find_run(runs, run)
    if as_json:
        typer.echo(json.dumps(report_json(found), indent=2, allow_nan=False))
        return
    found = derive_all(found.folder)
    path = found.folder / "derived" / "report.html"
    if out is not None:
        try:
            out.write_bytes(path.read_bytes())
        except OSError as error:
            raise PamrigError(
                str(out), f"cannot be written: {error}", "choose another file"
            ) from None
        path = out
    typer.echo(str(path))


def view_command(run: str, runs: Path) -> None:
    """Open a run's view and keep it open until Ctrl-C or the viewer is closed."""
    from analysis.layouts.layouts import measured_edges
    from analysis.registry import analysis_of
    from daq.live.viewfile import open_view
    from daq.store.store import find_run

    found = find_run(runs, run)
    kind = analysis_of(found.manifest.get("protocol"))
    layout = kind.layout(found.manifest.get("parameters") or {})
    # Ended by `kill`, the viewer's own program must not live on: let Python leave in good order.
    before = signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    view = open_view(found, layout, measured_edges(found))
    try:
        typer.echo(view.message)
        view.wait()
    except KeyboardInterrupt:
        pass
    finally:
        signal.signal(signal.SIGTERM, before)
        view.close()


def import_command(kind: str, source: str, out: Path, warm: bool, as_json: bool) -> None:
    """Make a run of foreign data and derive its table and report."""
    from analysis.formats.importer import import_points, import_thesis
    from analysis.reporting.derived import derive_all

    if kind == "thesis":
        folder = import_thesis(source, out, RealClock(), include_formula=warm)
    else:
        folder = import_points(source, out, RealClock())
    run = derive_all(folder)
    if as_json:
        from analysis.reporting.report import report_json

        typer.echo(json.dumps(report_json(run), indent=2, allow_nan=False))
        return
    typer.echo(f"imported {source} as {folder}")
    typer.echo(f"  report: {folder / 'derived' / 'report.html'}")


def length_command(
    frames: str,
    method: str,
    calibration: Path | None,
    preview: Path | None,
    threshold: int,
    roi: str,
    flip: bool,
    as_json: bool,
    count: int,
) -> int:
    """Measure lengths in pictures; 2 where none could be had."""
    from cli.data.length import length_report

    text, failed = length_report(
        frames, method, calibration, preview, threshold, roi, flip, as_json, count
    )
    typer.echo(text)
    if failed:
        typer.echo(f"pamrig: {failed}", err=True)
    return 2 if failed else 0


def calibrate_camera_command(
    out: Path,
    gauges: Path | None,
    board: Path | None,
    squares: str,
    square_mm: float,
    offset_mm: float,
    u_offset_mm: float,
    domain_mm: str,
    nearer: Path | None,
    nearer_mm: float,
    distance_mm: float | None,
    u_off_plane_mm: float,
    identity: str,
    as_json: bool,
) -> None:
    """Calibrate from gauge blocks or from a board, write the file, say what it holds."""
    from rigs.calibration import camera as cc

    if (gauges is None) == (board is None):
        raise ConfigError("pamrig calibrate camera", "give either --gauges or --board")
    if gauges is not None:
        camera = cc.calibrate_from_gauges(
            gauges, identity=identity, distance_mm=distance_mm, u_off_plane_mm=u_off_plane_mm
        )
    else:
        assert board is not None
        low, high = _pair(domain_mm, ",", "--domain-mm", "50,73")
        across, down = _pair(squares.lower(), "x", "--squares", "9x6")
        camera = cc.calibrate_from_board(
            board,
            (int(across), int(down)),
            square_mm,
            offset_mm=offset_mm,
            u_offset_mm=u_offset_mm,
            domain=(low, high),
            nearer=nearer,
            nearer_mm=nearer_mm,
            u_off_plane_mm=u_off_plane_mm,
            identity=identity,
        )
    try:
        cc.save_camera_calibration(out, camera)
    except OSError as error:
        raise PamrigError(str(out), f"cannot be written: {error}", "choose another file") from None
    if as_json:
        typer.echo(json.dumps(camera.to_dict(), indent=2, allow_nan=False))
        return
    c = camera.calibration
    typer.echo(
        f"{c.scale:.6f} mm/pixel (u {c.u_gain * 100:.4f} %), {c.offset:.4f} mm at zero gap "
        f"(u {c.u_offset:.4f} mm), {c.domain[0]:g} to {c.domain[1]:g} mm; {c.note}"
    )
    if camera.lens is not None:
        typer.echo(f"lens distortion k1 = {camera.lens.k1:.5f} (u {camera.lens.u_k1:.5f})")
    if camera.off_plane_per_mm:
        typer.echo(f"off the plane: {camera.off_plane_per_mm * 100:.4f} % per mm")
    typer.echo(f'written to {out}; in a rig file: [camera] calibration = "{out.name}"')


def _pair(text: str, separator: str, key: str, example: str) -> tuple[float, float]:
    """Two numbers with a separator between them."""
    parts = text.split(separator)
    try:
        low, high = (float(part) for part in parts)
    except ValueError:
        raise ConfigError(key, f"expected two numbers as in {example}, got {text!r}") from None
    return low, high
