"""The report of a run as one self-contained HTML file, or as JSON."""

from __future__ import annotations

import hashlib
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from analysis.figures.timeline import timeline_figure
from analysis.figures.wording import fixed, outcome_sentence, ratio_unit, value_cell, with_u
from analysis.findings.findings import Findings, Section
from analysis.reduction.points import Reduction
from analysis.registry import analysis_of
from analysis.reporting.conditions import (
    calibrations_due,
    condition_sections,
    conditions,
    simulated,
)
from analysis.reporting.page_one import page_one, quantity_words
from analysis.reporting.results import acceptance_json, judge, results_of
from analysis.reporting.sections import figure_parts, section_parts
from analysis.run_table import contents_of, record_findings, reduce_run
from daq.errors import RecordError
from daq.record.safe_read import LARGEST_BULK, names_inside, open_inside
from daq.store.annotations import ANNOTATIONS, SEAL, read_annotations
from daq.store.run import PARTIAL
from daq.wholefile import write_whole

if TYPE_CHECKING:
    from daq.store.run import Run

SCHEMA = "pamrig-report/1"
NORMAL_EVENTS = (
    "point", "zero", "length", "state", "command", "tare", "clockfit", "armed", "controller",
    "trial", "marker", "manual", "load", "catch", "mounted", "leak", "try", "result",
    "stretch", "disarmed", "kept", "hold",
)  # fmt: skip
"""Kinds of events of a normal run. All other kinds are listed among faults and gaps."""
BULKY = ("text", "crc", "files", "notes", "labels", "calibrations", "schema")
"""Keys that the appendix of the HTML report leaves out."""


def report_json(
    run: Run, reduction: Reduction | None = None, findings: Findings | None = None
) -> dict[str, Any]:
    """The contents of the report as plain values. Unknown values are null, never NaN.

    Args:
        run: an opened run, finished or not.
        reduction: its reduction, if already made.
        findings: its findings, if already made.
    """
    kind = analysis_of(run.manifest.get("protocol"))
    reduction = reduction or reduce_run(run)
    with contents_of(run):
        findings = findings or kind.findings(run, reduction)
        parts = findings.report_entries
        if parts is None:
            parts = {
                "results": findings.data,
                "sections": [_section_json(section) for section in findings.sections],
            }
        results = results_of(reduction, kind.results)
        plain: dict[str, Any] = plain_values(
            {
                **_common(run, reduction),
                "means": [result.as_dict() for result in results],
                "acceptance": acceptance_json(judge(results, acceptance_of(run))),
                "title": kind.title,
                "headline": findings.headline,
                "results": None,
                **parts,
            }
        )
    return plain


def _common(run: Run, reduction: Reduction) -> dict[str, Any]:
    """The entries of every report: operator, times, specimen, outcome, points and so on."""
    manifest, final = run.manifest, run.final or {}
    return {
        "schema": SCHEMA,
        "run_id": manifest.get("run_id"),
        "protocol": manifest.get("protocol"),
        "specimen": manifest.get("specimen"),
        "operator": manifest.get("operator") or None,
        "note": manifest.get("note") or None,
        "started_utc": (manifest.get("started") or {}).get("utc"),
        "ended_utc": (final.get("ended") or {}).get("utc"),
        "duration_s": final.get("duration_s"),
        "imported": bool(manifest.get("imported")),
        "labels": list(manifest.get("labels") or []),
        "simulated": simulated(run),
        "steps_by_hand": conditions(run),
        "continues": manifest.get("continues"),
        "outcome": run.outcome,
        "reason": final.get("reason") or None,
        "outcome_sentence": outcome_sentence(run.outcome, final.get("reason") or ""),
        "notes": list(reduction.notes),
        "points": reduction.table.to_dict("records"),
        "excluded": list(reduction.excluded),
        "annotations": [vars(a) for a in read_annotations(run.folder)],
        "markers": [
            {"t_s": event["t_ns"] / 1e9, "text": event["text"], "state": event.get("state")}
            for event in run.events
            if event.get("kind") == "marker"
        ],
        "zeros": list(reduction.zeros),
        "calibrations": [
            {"quantity": name, **calibration.to_dict()}
            for name, calibration in reduction.calibrations.items()
        ],
        "calibrations_due": calibrations_due(run),
        "faults": [
            {
                "t_s": event["t_ns"] / 1e9,
                **{k: v for k, v in event.items() if k not in ("n", "t_ns")},
            }
            for event in run.events
            if event.get("kind") not in NORMAL_EVENTS
            and not event.get("confirmed")
            and not (event.get("kind") == "prediction" and not event.get("stopped"))
            and not (event.get("kind") == "soaked" and event.get("settled"))
            and not (event.get("kind") == "camera_sync" and event.get("found"))
        ],
        "counters": final.get("counters"),
        "lateness": final.get("lateness"),
        "problems": list(record_findings(run)),
        "clock_fit": final.get("clock_fit") or _last(run, "clockfit"),
        "camera_sync": _last(run, "camera_sync"),
        "rig": {k: v for k, v in (manifest.get("rig") or {}).items() if k != "text"} or None,
        "devices": manifest.get("devices"),
        "conditions": manifest.get("conditions"),
        "source": manifest.get("source"),
        "parameters": manifest.get("parameters"),
        "provenance": {
            "software": manifest.get("software"),
            "rig_config_crc32": (manifest.get("rig") or {}).get("crc32"),
            "record_sha256": record_hash(Path(run.folder)),
        },
    }


def write_report(run: Run, out: Path | None = None, reduction: Reduction | None = None) -> Path:
    """Write the HTML report. It needs no other file and no network.

    Args:
        run: an opened run, finished or not.
        out: the HTML file; the default is ``derived/report.html`` of the run.
        reduction: its reduction, if already made.
    """
    out = out or Path(run.folder) / "derived" / "report.html"
    out.parent.mkdir(parents=True, exist_ok=True)
    write_whole(out, render_report(run, reduction))
    return out


def render_report(run: Run, reduction: Reduction | None = None) -> str:
    """The HTML report as text; arguments as for :func:`write_report`."""
    reduction = reduction or reduce_run(run)
    kind = analysis_of(run.manifest.get("protocol"))
    with contents_of(run):
        findings = kind.findings(run, reduction)
        timeline = None if run.manifest.get("imported") else timeline_figure(run)
        results = results_of(reduction, kind.results)
        judged = judge(results, acceptance_of(run))
    data = report_json(run, reduction, findings)
    with contents_of(run):
        first = page_one(run, reduction, data, results, judged)
        first["tables"] = [section_parts(section) for section in findings.page_one]
    parts = [section_parts(section) for section in findings.sections]
    html: str = (
        environment()
        .get_template("report.html.j2")
        .render(
            r=data,
            one=first,
            timeline=figure_parts(timeline) if timeline is not None else {},
            conditions=[section_parts(section) for section in condition_sections(run)],
            figures=[part for part in parts if part["image"]],
            sections=[part for part in parts if not part["image"]],
            provenance=_flat({k: data[k] for k in _APPENDIX if data.get(k) is not None}),
        )
    )
    return html


def acceptance_of(run: Run) -> dict[str, Any] | None:
    """The acceptance limits of a run's protocol, as recorded; None without."""
    found = (run.manifest.get("parameters") or {}).get("acceptance")
    return found if isinstance(found, dict) else None


def _section_json(section: Section) -> dict[str, Any]:
    """A section as plain values: title, text and the rows of its table."""
    rows = [] if section.table is None else section.table.to_dict("records")
    return {"title": section.title, "text": list(section.words), "rows": rows}


_APPENDIX = ("rig", "devices", "conditions", "source", "parameters", "provenance")


def record_hash(folder: Path) -> str:
    """SHA-256 over names and contents of the record, without derived files and annotations."""
    total = hashlib.sha256()
    for name, _ in names_inside(folder):
        if name.startswith(("derived/", "derived-", f"{PARTIAL}/")) or name in (ANNOTATIONS, SEAL):
            continue
        try:
            with open_inside(folder, name, LARGEST_BULK) as (file, _):
                digest = hashlib.file_digest(file, "sha256").hexdigest()
        except RecordError as error:
            digest = error.what
        total.update(f"{name}\n{digest}\n".encode())
    return total.hexdigest()


def _last(run: Run, kind: str) -> dict[str, Any] | None:
    found = [event for event in run.events if event.get("kind") == kind]
    return {k: v for k, v in found[-1].items() if k not in ("n", "kind")} if found else None


def environment() -> Any:
    """The templates of all reports; whatever they show is escaped."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("analysis.reporting"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(
        with_u=with_u, cell=value_cell, fixed=fixed, quantity=quantity_words, ratio=ratio_unit
    )
    return environment


def _flat(values: Any, path: str = "") -> list[tuple[str, str]]:
    """Nested values as (path, text) rows, without the keys in ``BULKY``."""
    if isinstance(values, dict):
        rows = []
        for key, value in values.items():
            if key not in BULKY:
                rows += _flat(value, f"{path}.{key}" if path else str(key))
        return rows
    if isinstance(values, list) and any(isinstance(value, dict) for value in values):
        return [row for i, value in enumerate(values) for row in _flat(value, f"{path}[{i}]")]
    if isinstance(values, list):
        return [(path, ", ".join(value_cell(value) for value in values))]
    return [(path, value_cell(values))]


def plain_values(value: Any) -> Any:
    """Values of Python types only, with None in place of NaN, for JSON."""
    if isinstance(value, dict):
        return {str(key): plain_values(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain_values(item) for item in value]
    if hasattr(value, "item"):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
