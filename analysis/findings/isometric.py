"""What the report of an isometric test says: straight lines, their laws in length, the thesis."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from analysis.figures.wording import headline
from analysis.findings.findings import Analysis
from analysis.reduction.points import Reduction, reduce_isometric
from analysis.regression.force_lines import (
    THESIS_DIGITS,
    THESIS_REGION_KPA,
    LengthLaw,
    LengthLine,
    against_length,
    covered_kpa,
    per_length,
)
from daq.live.layout import LiveLayout

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from daq.store.run import Run


def isometric_json(
    run: Run, reduction: Reduction, region_kpa: tuple[float, float]
) -> dict[str, Any]:
    """Headline, lines and laws; Table C-9 beside them for an import of Table C-1."""
    lines = per_length(reduction.table, region_kpa, reduction.calibrations)
    laws = [(group, against_length(group)) for group in by_temperature(lines)]
    covered = covered_kpa(reduction.table, region_kpa)
    return {
        "headline": headline(lines, laws[0][1] if laws else None, len(reduction.table), covered),
        "region_kpa": list(region_kpa),
        "covered_kpa": list(covered),
        "lengths": [asdict(line) for line in lines],
        "laws": [_law(group, law) for group, law in laws if law is not None],
        "thesis": _thesis(run.manifest, reduction, lines, region_kpa),
    }


def isometric_figures(
    reduction: Reduction, data: dict[str, Any], region_kpa: tuple[float, float]
) -> dict[str, Figure | None]:
    """Force against pressure, the coefficients against length, what the lines leave over."""
    from analysis.figures import isometric as figures
    from analysis.findings.thesis_check import printed_law

    made: dict[str, Figure | None] = dict.fromkeys(("force", "regression", "residual"))
    table = _coldest(reduction.table)
    lines = per_length(table, region_kpa, reduction.calibrations)
    if len(table):
        made["force"] = figures.force_figure(table)
    groups = by_temperature(lines)
    if groups and len(groups[0]) >= 3:
        cold = groups[0]
        digits = THESIS_DIGITS if data["thesis"] else None
        printed = (printed_law("4-34"), printed_law("4-35")) if data["thesis"] else None
        made["regression"] = figures.regression_figure(cold, against_length(cold, digits), printed)
        made["residual"] = figures.residual_figure(table, lines, region_kpa)
    return made


def timeline(run: Run) -> Figure | None:
    """The run as it went; None for an import, or where no samples survived."""
    if run.manifest.get("imported"):
        return None
    from analysis.figures.timeline import timeline_figure

    return timeline_figure(run)


def by_temperature(lines: list[LengthLine]) -> list[list[LengthLine]]:
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


def _thesis(
    manifest: dict[str, Any],
    reduction: Reduction,
    lines: list[LengthLine],
    region_kpa: tuple[float, float],
) -> dict[str, Any] | None:
    """Table C-9 beside what was recomputed, for an import of Table C-1."""
    if (manifest.get("source") or {}).get("table") != "C-1" or region_kpa != THESIS_REGION_KPA:
        return None
    from analysis.findings.thesis_check import compare_c9

    cold = [line for line in lines if abs(line.temperature_c - 21.0) < 0.5]
    table = reduction.table[reduction.table["temperature_c"].sub(21.0).abs() < 0.5]
    return compare_c9(cold, table) if cold else None


def _coldest(table: pd.DataFrame) -> pd.DataFrame:
    """The rows of the lowest temperature where a table spans several: one curve a length."""
    temperature = table["temperature_c"].astype(float)
    if not temperature.max() - temperature.min() > 2.0:
        return table
    return table[temperature < temperature.min() + 2.0]


def _or(value: float, default: float) -> float:
    return value if math.isfinite(value) else default


def _layout(parameters: Mapping[str, Any]) -> LiveLayout:
    """Its screen."""
    from analysis.layouts.layouts import isometric_layout

    return isometric_layout(pressure_max_kpa=max(parameters.get("pressures_kpa") or [600.0]))


ISOMETRIC = Analysis("isometric", "Isometric test", reduce_isometric, _layout)
ANALYSES = (ISOMETRIC,)
