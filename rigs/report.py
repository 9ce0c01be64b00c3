"""The report of a run: one HTML file that stands alone, or the same as JSON."""

from __future__ import annotations

import hashlib
import math
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rigs.protocols.registry import procedure_of
from rigs.reduction import Reduction
from rigs.regression import (
    THESIS_DIGITS,
    THESIS_REGION_KPA,
    LengthLaw,
    LengthLine,
    against_length,
    per_length,
)
from rigs.report_sections import data_address, section_parts
from rigs.wording import headline, outcome_sentence, signed, value_cell, with_u

if TYPE_CHECKING:
    import pandas as pd

    from daq.run import Run

SCHEMA = "pamrig-report/1"
QUIET_EVENTS = (
    "point",
    "zero",
    "length",
    "state",
    "command",
    "tare",
    "clockfit",
    "armed",
    "controller",
    "trial",
    "marker",
    "lowered",
    "manual",
)
"""Events of a run as it should be; any other kind is shown among faults and gaps."""
BULKY = ("text", "crc", "files", "notes", "labels", "calibrations", "schema")


def report_json(
    run: Run,
    reduction: Reduction | None = None,
    region_kpa: tuple[float, float] = THESIS_REGION_KPA,
) -> dict[str, Any]:
    """Everything the report says, as plain values: null for what is unknown, never NaN.

    Args:
        run: an opened run, finished or not.
        reduction: its reduction if already made.
        region_kpa: pressures over which the straight lines are fitted.
    """
    kind = procedure_of(run.manifest.get("protocol"))
    reduction = reduction or kind.reduce(run)
    found = kind.findings(run, reduction) if kind.findings is not None else None
    lines: list[LengthLine] = []
    if found is None:
        lines = per_length(reduction.table, region_kpa, reduction.calibrations)
    laws = [(group, against_length(group)) for group in _by_temperature(lines)]
    manifest, final = run.manifest, run.final or {}
    sentence = headline(lines, laws[0][1] if laws else None, len(reduction.table), region_kpa)
    data: dict[str, Any] = {
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
        "outcome": run.outcome,
        "reason": final.get("reason") or None,
        "title": kind.title,
        "headline": found.headline if found is not None else sentence,
        "outcome_sentence": outcome_sentence(run.outcome, final.get("reason") or ""),
        "notes": list(reduction.notes),
        "region_kpa": list(region_kpa),
        "lengths": [asdict(line) for line in lines],
        "laws": [_law(group, law) for group, law in laws if law is not None],
        "results": found.data if found is not None else None,
        "points": reduction.table.to_dict("records"),
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
        "faults": [
            {
                "t_s": event["t_ns"] / 1e9,
                **{k: v for k, v in event.items() if k not in ("n", "t_ns")},
            }
            for event in run.events
            if event.get("kind") not in QUIET_EVENTS and not event.get("confirmed")
        ],
        "counters": final.get("counters"),
        "problems": [f"{p.file} at byte {p.offset}: {p.what}" for p in run.problems],
        "clock_fit": final.get("clock_fit") or _last(run, "clockfit"),
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
        "thesis": _thesis(manifest, reduction, lines, region_kpa),
    }
    plain: dict[str, Any] = _plain(data)
    return plain


def write_report(
    run: Run,
    out: Path | None = None,
    reduction: Reduction | None = None,
    region_kpa: tuple[float, float] = THESIS_REGION_KPA,
) -> Path:
    """Write the report; it needs no other file and no network.

    Args:
        run: an opened run, finished or not.
        out: the HTML file; ``derived/report.html`` of the run if not given.
        reduction: its reduction if already made.
        region_kpa: pressures over which the straight lines are fitted.
    """
    out = out or Path(run.folder) / "derived" / "report.html"
    kind = procedure_of(run.manifest.get("protocol"))
    reduction = reduction or kind.reduce(run)
    data = report_json(run, reduction, region_kpa)
    found = kind.findings(run, reduction) if kind.findings is not None else None
    html = (
        _environment()
        .get_template("report.html.j2")
        .render(
            r=data,
            figures=_figures(run, reduction, data, region_kpa),
            sections=[section_parts(section) for section in found.sections] if found else [],
            provenance=_flat({k: data[k] for k in _APPENDIX if data.get(k) is not None}),
        )
    )
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(html, encoding="utf-8")
    return out


_APPENDIX = ("rig", "devices", "conditions", "source", "parameters", "provenance")


def record_hash(folder: Path) -> str:
    """SHA-256 over the names and contents of the record's files; what is derived is left out."""
    total = hashlib.sha256()
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_file() and not name.startswith("derived/"):
            with open(path, "rb") as file:
                digest = hashlib.file_digest(file, "sha256")
            total.update(f"{name}\n{digest.hexdigest()}\n".encode())
    return total.hexdigest()


def _by_temperature(lines: list[LengthLine]) -> list[list[LengthLine]]:
    """The lines of one temperature (to 2 degC) together, coldest first."""
    groups: list[list[LengthLine]] = []
    for line in sorted(lines, key=lambda line: (_or(line.temperature_c, 0.0), line.length_mm)):
        last = groups[-1][0].temperature_c if groups else math.nan
        if groups and not abs(_or(line.temperature_c, 0.0) - _or(last, 0.0)) > 2.0:
            groups[-1].append(line)
        else:
            groups.append([line])
    return groups


def _law(lines: list[LengthLine], law: LengthLaw) -> dict[str, Any]:
    return {"temperature_c": lines[0].temperature_c, **asdict(law)}


def _last(run: Run, kind: str) -> dict[str, Any] | None:
    found = [event for event in run.events if event.get("kind") == kind]
    return {k: v for k, v in found[-1].items() if k not in ("n", "kind")} if found else None


def _thesis(
    manifest: dict[str, Any],
    reduction: Reduction,
    lines: list[LengthLine],
    region_kpa: tuple[float, float],
) -> dict[str, Any] | None:
    """Table C-9 beside what was recomputed, for an import of Table C-1."""
    if (manifest.get("source") or {}).get("table") != "C-1" or region_kpa != THESIS_REGION_KPA:
        return None
    from rigs.thesis_check import compare_c9

    cold = [line for line in lines if abs(line.temperature_c - 21.0) < 0.5]
    table = reduction.table[reduction.table["temperature_c"].sub(21.0).abs() < 0.5]
    return compare_c9(cold, table) if cold else None


def _figures(
    run: Run, reduction: Reduction, data: dict[str, Any], region_kpa: tuple[float, float]
) -> dict[str, str]:
    """Each figure as a data address, by name."""
    from rigs import figures
    from rigs.drawing import as_svg
    from rigs.thesis_check import printed_law
    from rigs.timeline import timeline_figure

    made = dict.fromkeys(("force", "regression", "residual", "timeline"), "")
    isometric = data["results"] is None
    table = _coldest(reduction.table) if isometric else reduction.table
    lines = per_length(table, region_kpa, reduction.calibrations) if isometric else []
    if len(table) and isometric:
        made["force"] = data_address(as_svg(figures.force_figure(table)))
    groups = _by_temperature(lines)
    if groups and len(groups[0]) >= 3:
        cold = groups[0]
        digits = THESIS_DIGITS if data["thesis"] else None
        printed = (printed_law("4-34"), printed_law("4-35")) if data["thesis"] else None
        figure = figures.regression_figure(cold, against_length(cold, digits), printed)
        made["regression"] = data_address(as_svg(figure))
        figure = figures.residual_figure(table, lines, region_kpa)
        made["residual"] = data_address(as_svg(figure))
    if not data["imported"]:
        timeline = timeline_figure(run)
        if timeline is not None:
            made["timeline"] = data_address(as_svg(timeline))
    return made


def _coldest(table: pd.DataFrame) -> pd.DataFrame:
    """The rows of the lowest temperature where a table spans several: one curve a length."""
    temperature = table["temperature_c"].astype(float)
    if not temperature.max() - temperature.min() > 2.0:
        return table
    return table[temperature < temperature.min() + 2.0]


def _environment() -> Any:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("rigs", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(with_u=with_u, cell=value_cell, signed=signed)
    environment.filters["fixed"] = partial(_fixed)
    return environment


def _fixed(value: float | None, decimals: int) -> str:
    return "–" if value is None else f"{value:.{decimals}f}".replace("-", "−")


def _flat(values: Any, path: str = "") -> list[tuple[str, str]]:
    """Nested values as (path, text) rows; bulky texts are left to the record itself."""
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


def _plain(value: Any) -> Any:
    """Python's own types only, with None for NaN, as JSON wants it."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if hasattr(value, "item"):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _or(value: float, default: float) -> float:
    return value if math.isfinite(value) else default
