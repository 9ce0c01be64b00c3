"""What the commands do, between the command line and the packages that do the work."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from daq.clock import RealClock
from daq.errors import ConfigError, PamrigError
from rigs.config import load_rig

if TYPE_CHECKING:
    from rigs.runner import Runner


VIEWER_S = 30.0


class ProgressLine:
    """One line on the terminal: state, points done, time left. Quiet where there is no one."""

    def __init__(self, quiet: bool) -> None:
        import sys

        self._quiet = quiet
        self._tty = sys.stderr.isatty()
        self._runner: Runner | None = None
        self._start = 0.0
        self._last = 0.0
        self._width = 0

    def start(self, runner: Runner, record: Any) -> None:
        """The run begins."""
        self._runner = runner
        self._start = time.monotonic()
        if not self._quiet:
            typer.echo(f"recording to {record.folder}", err=True)

    def state(self, text: str) -> None:
        """A new phase; always printed where there is no terminal to redraw."""
        if not self._quiet and not self._tty:
            typer.echo(f"  {text}{self._left()}", err=True)
        self.redraw(text)

    def redraw(self, text: str = "") -> None:
        """Redraw the line, ten times a second at most."""
        now = time.monotonic()
        if self._quiet or not self._tty or self._runner is None or now - self._last < 0.1:
            return
        self._last = now
        line = f"{text or self._runner.progress.state}{self._left()}"
        typer.echo("\r" + line.ljust(self._width), nl=False, err=True)
        self._width = len(line)

    def _left(self) -> str:
        if self._runner is None:
            return ""
        p = self._runner.progress
        text = f"  {p.done}/{p.points} points"
        if p.done:
            seconds = (time.monotonic() - self._start) / p.done * (p.points - p.done)
            text += f", about {seconds:.0f} s left"
        return text

    def close(self) -> None:
        """Leave the terminal on a fresh line."""
        if self._width:
            typer.echo("", err=True)


def isometric_command(
    rig: str,
    protocol: str,
    out: Path,
    specimen: str,
    operator: str,
    note: str,
    seed: int | None,
    live: bool,
    browser: bool,
    wire: bool,
    as_json: bool,
) -> int:
    """Run, derive, say what came of it; returns the exit status."""
    from rigs.interrupt import stop_on_signals
    from rigs.isometric import load_isometric
    from rigs.runner import Watch
    from rigs.session import run_isometric

    config = load_rig(rig, seed)
    if seed is not None and config.virtual is None:
        raise ConfigError(config.source, "--seed is for virtual benches", "leave it out")
    parameters = load_isometric(protocol, config.limits)
    line = ProgressLine(quiet=as_json)
    watch = Watch(
        state=line.state, point=lambda *_: line.redraw(), log=lambda t: typer.echo(t, err=True)
    )
    make_live = None
    if live:
        from rigs.livefeed import LiveFeed, open_live

        def make_live(run_id: str) -> LiveFeed:
            feed = open_live(run_id, max(parameters.pressures_kpa), open_browser=browser)
            view = feed.view
            if view.error:
                typer.echo(f"live view: none ({view.error}); the test goes on", err=True)
                return feed
            where = view.web_url or f"open it with: rerun --connect {view.url}"
            typer.echo(f"live view: {where}", err=True)
            if browser and config.is_virtual:
                # On the virtual clock the test is over before a page has loaded.
                typer.echo(f"waiting up to {VIEWER_S:.0f} s for a viewer", err=True)
                view.wait_for_viewer(VIEWER_S)
            return feed

    with stop_on_signals() as stop:
        result = run_isometric(
            config, parameters, out, specimen=specimen, operator=operator, note=note,
            stop=stop, make_live=make_live, watch=watch, on_start=line.start, wire=wire,
        )  # fmt: skip
    line.close()
    status = {"clean": 0, "stopped": 130}.get(result.outcome, 2)
    if as_json:
        from daq.run import open_run
        from rigs.report import report_json

        typer.echo(json.dumps(report_json(open_run(result.folder)), indent=2, allow_nan=False))
        return status
    typer.echo(
        f"{result.outcome}: {result.points} of {parameters.points} points in {result.folder}"
    )
    if result.error:
        typer.echo(f"  because: {result.error}")
    if result.not_derived:
        typer.echo(f"  table and report could not be made: {result.not_derived}")
        typer.echo(f"  the record is safe; later: pamrig runs rebuild {result.folder}")
        return status or 2
    typer.echo(f"  report: {result.folder / 'derived' / 'report.html'}")
    typer.echo(f"  table:  {result.folder / 'derived' / 'table.csv'}")
    return status


def report_command(run: str, runs: Path, out: Path | None, as_json: bool) -> None:
    """Reduce a run anew and write its report."""
    from daq.store import find_run
    from rigs.products import derive_all
    from rigs.report import report_json

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
    from daq.store import find_run
    from daq.viewfile import open_view
    from rigs.liveview import isometric_layout, measured_edges

    found = find_run(runs, run)
    pressures = found.manifest.get("parameters", {}).get("pressures_kpa") or [600.0]
    layout = isometric_layout(pressure_max_kpa=max(pressures))
    view = open_view(found, layout, measured_edges(found))
    try:
        typer.echo(view.message)
        view.wait()
    except KeyboardInterrupt:
        pass
    finally:
        view.close()


def import_command(kind: str, source: str, out: Path, warm: bool, as_json: bool) -> None:
    """Make a run of foreign data and derive its table and report."""
    from rigs.importer import import_points, import_thesis
    from rigs.products import derive_all

    if kind == "thesis":
        folder = import_thesis(source, out, RealClock(), include_formula=warm)
    else:
        folder = import_points(source, out, RealClock())
    run = derive_all(folder)
    if as_json:
        from rigs.report import report_json

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
    from rigs.length import length_report

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
    from rigs import calibrate_camera as cc

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
