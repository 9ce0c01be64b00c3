"""The derived files of a run: samples, table, report and view file, in one folder."""

from __future__ import annotations

from pathlib import Path

from daq.errors import PamrigError, RecordError
from daq.store.derive import derive, samples_file
from daq.store.run import Run, open_run


def derive_all(folder: Path | str, only_results: bool = False) -> Run:
    """Make all derived files of a run again, and return the run, opened again.

    Args:
        folder: of the run.
        only_results: only table and report, which exclusions change; sound files of samples and
            of the viewer stay.

    Raises:
        RecordError: the record is too damaged for this, or the folder cannot be written.
    """
    from analysis.reduction.points import write_table
    from analysis.reporting.report import write_report
    from analysis.run_table import contents_of, record_findings, reduce_run
    from daq.live.viewfile import FILE

    run = open_run(folder)
    record_findings(run)  # before derived files are replaced
    reduction = reduce_run(run)

    def table(run: Run, out: Path) -> None:
        del run
        write_table(reduction, out)

    def report(run: Run, out: Path) -> None:
        write_report(run, out / "report.html", reduction)

    makers = [table, report]
    kept = [FILE, *map(samples_file, run.streams)] if only_results else []
    if not run.manifest.get("imported"):
        makers.append(_view)
    with contents_of(run):
        derive(run, makers, kept)
    return open_run(folder)


def try_derive(
    folder: Path | str, error: BaseException | None = None, only_results: bool = False
) -> str:
    """Make all derived files of a run; returns the reason why this was not possible, or "".

    The record does not change. If the run ended because it could not be stored on the disk
    (``error`` is a RecordError), no files are derived.
    """
    if isinstance(error, RecordError):
        return "the disk could not store the run"
    try:
        derive_all(folder, only_results)
    except PamrigError as problem:
        return str(problem)
    return ""


def _view(run: Run, out: Path) -> None:
    from analysis.layouts.layouts import measured_edges
    from analysis.registry import analysis_of
    from daq.live.viewfile import FILE, view_maker

    if (out / FILE).exists():  # taken over
        return
    kind = analysis_of(run.manifest.get("protocol"))
    layout = kind.layout(run.manifest.get("parameters") or {})
    view_maker(layout, measured_edges(run))(run, out)
