"""What is made of a record: samples, table, report and view file, in one sealed folder."""

from __future__ import annotations

from pathlib import Path

from daq.errors import PamrigError, RecordError
from daq.store.derive import derive
from daq.store.run import Run, open_run


def derive_all(folder: Path | str) -> Run:
    """Make everything derived of a run anew and return the run, opened afresh.

    The report that a run gets is written last, so that it may name what stands beside it.

    Raises:
        RecordError: the record is damaged where nothing can be made of it, or the folder
            cannot be written.
    """
    from analysis.reduction.points import write_table
    from analysis.reporting.report import write_report
    from analysis.run_table import reduce_run

    run = open_run(folder)
    reduction = reduce_run(run)

    def table(run: Run, out: Path) -> None:
        del run
        write_table(reduction, out)

    def report(run: Run, out: Path) -> None:
        write_report(run, out / "report.html", reduction)

    makers = [table, report]
    if not run.manifest.get("imported"):
        makers.append(_view)
    derive(run, makers)
    return open_run(folder)


def try_derive(folder: Path | str, error: BaseException | None = None) -> str:
    """Make everything derived of a run; why that was not possible, or "".

    The record stays as it is either way. Where the run itself ended because the disk refused to
    store it (``error`` is a RecordError), nothing is derived.
    """
    if isinstance(error, RecordError):
        return "the disk would not take it"
    try:
        derive_all(folder)
    except PamrigError as problem:
        return str(problem)
    return ""


def _view(run: Run, out: Path) -> None:
    from analysis.layouts.layouts import measured_edges
    from analysis.registry import analysis_of
    from daq.live.viewfile import view_maker

    kind = analysis_of(run.manifest.get("protocol"))
    layout = kind.layout(run.manifest.get("parameters") or {})
    view_maker(layout, measured_edges(run))(run, out)
