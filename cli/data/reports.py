"""`pamrig report`, `pamrig view` and `pamrig import thesis|points|data`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cli.data.import_data import import_data, import_template
from cli.options import RUNS, JsonOption, OutOption, RunArgument, RunsOption, WarmOption
from cli.output import print_json, state_findings, writing
from cli.progress import progress_line

THESIS_TABLES = (
    "Thesis table: c01 (isometric), c02 (c01 plus noise), c03 (isotonic), c04, c05 and c06, c07 "
    "(hysteresis), d01, d02, d03 (switching times), d04 (switching voltages), d05 (air velocity)."
)


def report(
    run: RunArgument = "last",
    out: Annotated[Path | None, typer.Option("--out", help="HTML file to write.")] = None,
    runs: RunsOption = RUNS,
    as_json: JsonOption = False,
) -> None:
    """Reduce a run and write its report: one self-contained HTML file."""
    from analysis.reporting.derived import derive_all
    from analysis.reporting.report import report_json
    from analysis.run_table import record_findings
    from daq.store.store import find_run

    found = find_run(runs, run)
    if as_json:
        with progress_line("making the table"):
            made = report_json(found)
        print_json(made)
        return
    with progress_line("making table and report"):
        path = derive_all(found.folder).folder / "derived" / "report.html"
    if out is not None:
        with writing(out):
            out.write_bytes(path.read_bytes())
    typer.echo(str(out or path))
    state_findings(record_findings(found))


def view(run: RunArgument = "last", runs: RunsOption = RUNS) -> None:
    """Show a recorded run as a page in the browser, until Ctrl-C."""
    import signal
    import sys

    from analysis.layouts.layouts import measured_edges
    from analysis.registry import analysis_of
    from analysis.run_table import contents_of
    from daq.live.page import has_screen
    from daq.live.viewfile import open_view
    from daq.store.store import find_run

    found = find_run(runs, run)
    with contents_of(found):
        kind = analysis_of(found.manifest.get("protocol"))
        layout = kind.layout(found.manifest.get("parameters") or {})
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
