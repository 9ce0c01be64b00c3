"""The derived files of a run: samples, table, report and view file, in one folder."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from daq.errors import PamrigError, RecordError
from daq.store.derive import Maker, derive, samples_file
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
    from analysis.registry import analysis_of
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

    makers: list[Maker] = [table, report]
    if (files := analysis_of(run.manifest.get("protocol")).files) is not None:
        makers.append(files)
    kept = [FILE, *map(samples_file, run.streams)] if only_results else []
    if not run.manifest.get("imported"):
        makers.append(_view)
    with contents_of(run):
        derive(run, makers, kept)
    return open_run(folder)


def derive_version(folder: Path | str, pictures: Mapping[str, Any]) -> Path:
    """Make table and report again with other settings for the pictures, as a new version.

    The derived files and earlier versions stay as they are.

    Args:
        folder: of the run.
        pictures: as for :class:`daq.store.run.Run`.

    Returns:
        the folder of the version.

    Raises:
        RecordError: the run has no pictures, is too damaged, or cannot be written to.
    """
    from analysis.reduction.points import write_table
    from analysis.reporting.report import write_report
    from analysis.run_table import contents_of, record_findings, reduce_run
    from daq.store.versions import make_version

    run = open_run(folder, pictures)
    if not run.frames:
        raise RecordError(str(folder), "holds no pictures", "choose a run with a camera")
    record_findings(run)
    reduction = reduce_run(run)
    note = f"a derived version, made with other settings for the pictures: {_in_words(pictures)}"
    reduction = replace(reduction, own_notes=(note, *reduction.own_notes))

    def table(run: Run, out: Path) -> None:
        del run
        write_table(reduction, out)

    def report(run: Run, out: Path) -> None:
        write_report(run, out / "report.html", reduction)

    with contents_of(run):
        return make_version(run, [table, report])


def _in_words(pictures: Mapping[str, Any]) -> str:
    parts = [f"{key} {value}" for key, value in pictures.get("camera", {}).items() if key != "lens"]
    if "length_mm" in pictures:
        parts.append(f"calibration {pictures['length_mm'].get('id') or 'without id'}")
    return ", ".join(parts)


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
    from analysis.registry import layout_of
    from daq.live.viewfile import FILE, view_maker

    if (out / FILE).exists():  # taken over
        return
    view_maker(layout_of(run), measured_edges(run))(run, out)
