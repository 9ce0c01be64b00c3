"""`pamrig report`, `pamrig view` and `pamrig import thesis|points|data`."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cli.completion import run_names
from cli.data.import_data import import_data, import_template
from cli.options import RUNS, JsonOption, OutOption, RunArgument, RunsOption, WarmOption
from cli.output import print_json, state_findings, writing
from cli.progress import progress_line
from daq.wholefile import write_whole

if TYPE_CHECKING:
    from daq.store.run import Run

THESIS_TABLES = (
    "Thesis table: c01 (isometric), c02 (c01 plus noise), c03 (isotonic), c04, c05 and c06, c07 "
    "(hysteresis), d01, d02, d03 (switching times), d04 (switching voltages), d05 (air velocity)."
)


def report(
    runs_given: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[RUN]...",
            help="Run folders, run ids, or 'last'; several are compared in one report.",
            autocompletion=run_names,
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", help="HTML file to write; of several runs comparison.html."),
    ] = None,
    pdf: Annotated[
        Path | None,
        typer.Option("--pdf", help="Also write the page as PDF (pip install 'pamrig[pdf]')."),
    ] = None,
    figures: Annotated[
        Path | None, typer.Option("--figures", help="Folder for each figure as PDF and SVG.")
    ] = None,
    column: Annotated[
        str, typer.Option("--column", help="Width of --figures: double (180 mm), single (88 mm).")
    ] = "double",
    at: Annotated[
        str | None,
        typer.Option("--at", help="Several runs: only these settings: set_pressure_kpa=300,..."),
    ] = None,
    base: Annotated[
        int | None,
        typer.Option("--base", help="Several runs: limits of the control chart from the first N."),
    ] = None,
    chart_limits: Annotated[
        str | None,
        typer.Option(
            "--chart-limits",
            help="Several runs: centre and standard deviation of the chart: 20.7,0.05 (with --at).",
        ),
    ] = None,
    runs: RunsOption = RUNS,
    as_json: JsonOption = False,
) -> None:
    """Reduce runs and write their report: one self-contained HTML file."""
    from daq.errors import ConfigError
    from daq.store.store import find_run

    if column not in ("double", "single"):
        raise ConfigError("--column", f"{column!r} is neither double nor single")
    found = [find_run(runs, name) for name in runs_given or ["last"]]
    wanted = Wanted(out, pdf, figures, column, as_json)
    several = {"--at": at, "--base": base, "--chart-limits": chart_limits}
    if len(found) > 1:
        _report_several(found, wanted, _settings(at), base, _chart_limits(chart_limits))
        return
    for option, value in several.items():
        if value is not None:
            raise ConfigError(option, "is for a report over several runs", "name more runs")
    _report_one(found[0], wanted)


@dataclass(frozen=True)
class Wanted:
    """What a report is written to."""

    out: Path | None
    pdf: Path | None
    figures: Path | None
    column: str
    as_json: bool


def _settings(text: str | None) -> dict[str, float | str]:
    """The settings of --at: NAME=VALUE, separated by commas."""
    from daq.errors import ConfigError

    found: dict[str, float | str] = {}
    for part in filter(None, (one.strip() for one in (text or "").split(","))):
        name, sign, value = (word.strip() for word in part.partition("="))
        if not (name and sign and value):
            raise ConfigError("--at", f"{part!r} is not NAME=VALUE", "set_length_mm=60")
        try:
            found[name] = float(value)
        except ValueError:
            found[name] = value
    return found


def _chart_limits(text: str | None) -> tuple[float, float] | None:
    """Centre and standard deviation of --chart-limits."""
    from daq.errors import ConfigError

    if text is None:
        return None
    try:
        centre, sd = (float(part) for part in text.split(","))
    except ValueError:
        centre, sd = math.nan, math.nan
    if not (math.isfinite(centre) and math.isfinite(sd) and sd > 0.0):
        raise ConfigError(
            "--chart-limits", f"{text!r} is no centre and standard deviation above 0", "20.7,0.05"
        )
    return centre, sd


def _report_several(
    found: list[Run], wanted: Wanted, at: dict[str, float | str], base: int | None,
    stated: tuple[float, float] | None,
) -> None:  # fmt: skip
    """One report over several runs."""
    from analysis.reporting.figure_files import comparison_figures, write_figures
    from analysis.reporting.pdf import page_to_pdf
    from analysis.reporting.several import compare_runs, comparison_json, render_comparison

    with progress_line(f"comparing {len(found)} runs"):
        compared = compare_runs(found, at=at, base=base, stated=stated)
    out = wanted.out or (None if wanted.as_json else Path("comparison.html"))
    paths: list[Path] = []
    if out is not None or wanted.pdf is not None:
        with progress_line("making the report"):
            html = render_comparison(compared)
        if out is not None:
            with writing(out):
                out.parent.mkdir(parents=True, exist_ok=True)
                write_whole(out, html)
            paths.append(out)
        if wanted.pdf is not None:
            with progress_line("making the PDF"), writing(wanted.pdf):
                write_whole(wanted.pdf, page_to_pdf(html))
            paths.append(wanted.pdf)
    if wanted.figures is not None:
        with progress_line("drawing the figures"), writing(wanted.figures):
            paths += write_figures(comparison_figures(compared, wanted.column), wanted.figures)
    if wanted.as_json:
        print_json(comparison_json(compared))
        return
    for path in paths:
        typer.echo(str(path))
    for note in compared.notes:
        typer.echo(f"NOTE: {note}", err=True)


def _report_one(found: Run, wanted: Wanted) -> None:
    """The report of one run: its derived files, and what was asked for besides."""
    from analysis.reporting.derived import derive_all
    from analysis.reporting.figure_files import run_figures, write_figures
    from analysis.reporting.pdf import page_to_pdf
    from analysis.reporting.report import report_json
    from analysis.run_table import record_findings

    page: bytes | None = None
    if not wanted.as_json or wanted.out is not None or wanted.pdf is not None:
        with progress_line("making table and report"):
            path = derive_all(found.folder).folder / "derived" / "report.html"
        page = path.read_bytes()
    if wanted.out is not None and page is not None:
        with writing(wanted.out):
            write_whole(wanted.out, page)
    if wanted.pdf is not None and page is not None:
        with progress_line("making the PDF"), writing(wanted.pdf):
            write_whole(wanted.pdf, page_to_pdf(page.decode("utf-8")))
    files: list[Path] = []
    if wanted.figures is not None:
        with progress_line("drawing the figures"), writing(wanted.figures):
            files = write_figures(run_figures(found, wanted.column), wanted.figures)
    if wanted.as_json:
        with progress_line("making the table"):
            made = report_json(found)
        print_json(made)
        return
    typer.echo(str(wanted.out or path))
    for other in (wanted.pdf, *files):
        if other is not None:
            typer.echo(str(other))
    state_findings(record_findings(found))


def view(run: RunArgument = "last", runs: RunsOption = RUNS) -> None:
    """Show a recorded run as a page in the browser, until Ctrl-C."""
    import signal
    import sys

    from analysis.layouts.layouts import measured_edges
    from analysis.registry import layout_of
    from analysis.run_table import contents_of
    from daq.live.page import has_screen
    from daq.live.viewfile import open_view
    from daq.store.store import find_run

    found = find_run(runs, run)
    with contents_of(found):
        layout = layout_of(found)
    # On SIGTERM, exit normally, so that `finally` also deletes a temporary view.
    before = signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    with contents_of(found):
        opened = open_view(found, layout, measured_edges(found))
    try:
        typer.echo(opened.message)
        if has_screen():
            import threading
            import webbrowser

            threading.Thread(target=webbrowser.open, args=(opened.url,), daemon=True).start()
        opened.wait()
    except KeyboardInterrupt:
        pass
    finally:
        signal.signal(signal.SIGTERM, before)
        opened.close()


def add_imports(app: typer.Typer) -> None:
    """Add the commands of `pamrig import`."""
    app.command("thesis")(import_thesis)
    app.command("points")(import_points)
    app.command("data")(import_data)
    app.command("template")(import_template)


def import_thesis(
    table: Annotated[str, typer.Argument(help=THESIS_TABLES)],
    out: OutOption = RUNS,
    warm: WarmOption = False,
    as_json: JsonOption = False,
) -> None:
    """Make a run from a thesis table; only measured columns by default."""
    from analysis.formats.importer import import_thesis
    from daq.clock import RealClock

    with progress_line(f"importing {table}"):
        folder = import_thesis(table, out, RealClock(), include_formula=warm)
    _report_import(table, folder, as_json)


def import_points(
    source: Annotated[str, typer.Argument(help="CSV of settled points, or a dataset folder.")],
    out: OutOption = RUNS,
    as_json: JsonOption = False,
) -> None:
    """Make a run from settled points measured elsewhere."""
    from analysis.formats.importer import import_points
    from daq.clock import RealClock

    with progress_line(f"importing {source}"):
        folder = import_points(source, out, RealClock())
    _report_import(source, folder, as_json)


def _report_import(source: str, folder: Path, as_json: bool) -> None:
    """Derive table and report of an imported run, and print where they are."""
    from analysis.reporting.derived import derive_all

    with progress_line("making table and report"):
        run = derive_all(folder)
    if as_json:
        from analysis.reporting.report import report_json

        print_json(report_json(run))
        return
    typer.echo(f"imported {source} as {folder}")
    typer.echo(f"  report: {folder / 'derived' / 'report.html'}")
