"""Findings of a test that has no analysis of its own: its settled points, as table and figure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

from analysis.findings.findings import (
    BARS,
    EXPANDED,
    NO_POINT,
    POINT_SETTINGS,
    Analysis,
    Findings,
    ResultColumns,
    Section,
    max_pressure_kpa,
    records,
)
from analysis.layouts.layouts import isometric_layout
from analysis.reduction.points import reduce_points

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from analysis.reduction.points import Reduction
    from daq.live.layout import LiveLayout
    from daq.store.run import Run

QUANTITIES = {"force_n": "force (N)", "length_mm": "length (mm)"}
"""Measured quantities that are drawn against pressure, with their axis labels."""


def points_findings(run: Run, reduction: Reduction) -> Findings:
    """The settled points, and each measured quantity against pressure."""
    del run
    table = reduction.table
    if not len(table):
        return Findings(NO_POINT)
    low, high = table["pressure_kpa"].min(), table["pressure_kpa"].max()
    sections = [
        Section(
            f"{label.split(' (')[0].capitalize()} against pressure",
            figure=partial(_figure, table, name, label),
            caption=f"One curve per slot. {BARS}",
        )
        for name, label in QUANTITIES.items()
        if table[name].notna().any()
    ]
    columns = (
        ("order", "point"), ("slot", "slot"), ("direction", "direction"),
        ("set_pressure_kpa", "set pressure, kPa"), ("pressure_kpa", "pressure, kPa"),
        ("length_mm", "length, mm"), ("force_n", "force, N"), ("settled", "settled"),
    )  # fmt: skip
    sections.append(Section("Settled points", (), table, columns, caption=f"{EXPANDED}."))
    headline = f"{len(table)} points were measured at {low:.1f} to {high:.1f} kPa."
    return Findings(headline, tuple(sections), {"points": records(table)})


def _figure(table: pd.DataFrame, name: str, label: str) -> Figure:
    from analysis.figures.drawing import CurveEnds, curve, curves_figure

    groups = [
        (str(slot), rows) for slot, rows in table[table[name].notna()].groupby("slot", sort=False)
    ]

    def draw(axes: Any, colours: list[Any], ends: CurveEnds) -> None:
        for k, (slot, rows) in enumerate(groups):
            pressures = rows["set_pressure_kpa"].fillna(rows["pressure_kpa"].round(1))
            end = curve(axes, rows, ("pressure_kpa", name), pressures, colours[k], k)
            ends.append((*end, slot, colours[k]))

    return curves_figure(len(groups), "pressure (kPa)", label, "slot", draw)


def points_analysis(name: str, title: str = "") -> Analysis:
    """The analysis of a protocol that brings none: its settled points.

    Args:
        name: the protocol, as in records.
        title: of its report and its screen; made from the name if empty.
    """
    title = title or f"{name.replace('-', ' ').capitalize()} test"

    def layout(parameters: Mapping[str, Any]) -> LiveLayout:
        return replace(isometric_layout(max_pressure_kpa(parameters)), title=title)

    results = ResultColumns(settings=("slot", *POINT_SETTINGS))
    return Analysis(name, title, reduce_points, layout, points_findings, results)


INTERACTIVE = points_analysis("interactive", "Interactive session")
ANALYSES = (INTERACTIVE,)
