"""Findings of an isotonic test: lengths under hung loads (Table C-3, Figure 4-13)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.findings.findings import (
    BARS,
    EXPANDED,
    NO_SETTLED_POINT,
    Analysis,
    Findings,
    ResultColumns,
    Section,
    as_in,
    claims_section,
    max_pressure_kpa,
    source_table,
)
from analysis.layouts.static import isotonic_layout
from analysis.reduction.points import Reduction, reduce_points
from analysis.regression.force_lines import nominal_kpa

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from daq.calibration import Calibration
    from daq.store.run import Run

EXTRA = {"mass_kg": "float64"}


@dataclass(frozen=True)
class LoadCurve:
    """The points of one load, in order of pressure: mean force in N, name, rows."""

    load_n: float
    name: str
    rows: pd.DataFrame

    @property
    def has_length(self) -> bool:
        """True if the camera measured a length at any point."""
        return bool(self.rows["length_mm"].notna().any())


def isotonic_findings(run: Run, reduction: Reduction) -> Findings:
    """Length against pressure, one curve per load, and the contraction under each load."""
    import pandas as pd

    every = curves_of(reduction.table)
    curves = [curve for curve in every if curve.has_length]
    without = [curve.name for curve in every if not curve.has_length]
    camera = reduction.calibrations.get("length_mm")
    rest_mm = (run.manifest.get("parameters") or {}).get("rest_length_mm") or None
    rows = [_curve_row(curve, camera, rest_mm) for curve in curves]
    sections = [
        Section(
            "Length against pressure",
            figure=lambda: _figure(curves),
            caption=f"One curve per load{as_in(run, 'Figure 4-13')}. {BARS}",
        ),
        Section(
            "Contraction under each load",
            (
                "Longest and shortest settled length, and the contraction at the shortest,"
                f" {_reference(rest_mm)}. All uncertainties include zero and gain of the camera,"
                " which are common to all lengths.",
                *([f"No length was measured under {', '.join(without)}."] if without else []),
            ),
            pd.DataFrame(rows),
            (
                ("load", "load"), ("n", "points"), ("longest", "longest, mm"),
                ("at_longest", "at, kPa"), ("shortest", "shortest, mm"),
                ("at_shortest", "at, kPa"), ("contraction", "contraction"),
            ),
            caption=f"{EXPANDED}.",
        ),
        _wide(curves),
    ]  # fmt: skip
    if source_table(run) == "C-3":
        sections.append(_thesis(curves, rows))
    data = {"loads": rows, "rest_length_mm": rest_mm}
    return Findings(_headline(rows, bool(without), rest_mm), tuple(sections), data)


def curves_of(table: pd.DataFrame) -> list[LoadCurve]:
    """The points of each load, lightest first. A load is a hung mass if known, else a force."""
    by_mass = "mass_kg" in table and table["mass_kg"].notna().any()
    name, digits = ("mass_kg", 4) if by_mass else ("force_n", 1)
    groups = [
        (float(str(load)), float(rows["force_n"].mean()), rows)
        for load, rows in table.groupby(table[name].astype(float).round(digits), sort=True)
    ]
    # One unit for all loads: kg as marked, or newton where every load is a whole number of them.
    whole = all(abs(newton - round(newton)) < 0.005 for _, newton, _ in groups)
    return [
        LoadCurve(
            newton,
            f"{load:g} kg" if by_mass and not whole else f"{newton:.4g} N",
            rows.sort_values("pressure_kpa", kind="stable"),
        )
        for load, newton, rows in groups
    ]


def _reference(rest_mm: float | None) -> str:
    """What a contraction is relative to."""
    if rest_mm is None:
        return (
            "relative to the longest settled length (the protocol states no rest_length_mm, the"
            " length L0 of the vented muscle without load)"
        )
    return f"1 − L/L0 with the length of the vented muscle without load, L0 = {rest_mm:g} mm"


def _curve_row(
    curve: LoadCurve, camera: Calibration | None, rest_mm: float | None
) -> dict[str, Any]:
    good = curve.rows.dropna(subset=["length_mm"])
    good = good.assign(nominal=nominal_kpa(good)).sort_values("length_mm", kind="stable")
    short, long = good.iloc[0], good.iloc[-1]
    reference = float(long["length_mm"]) if rest_mm is None else rest_mm
    ratio = 1.0 - float(short["length_mm"]) / reference
    measured = (long, short) if rest_mm is None else (short,)
    noise = [float(r["u_length_mm_noise"]) / float(r["length_mm"]) for r in measured]
    u = (1.0 - ratio) * math.hypot(*noise)
    if camera is not None:  # L0 was measured elsewhere and does not share the camera's errors
        ends = np.array([r["length_mm"] for r in reversed(measured)], dtype=np.float64)
        for moved in (ends + camera.u_offset, ends + camera.u_gain * (ends - camera.offset)):
            again = moved[-1] if rest_mm is None else reference
            u = math.hypot(u, 1.0 - moved[0] / again - ratio)
    return {
        "load": curve.name,
        "n": len(good),
        "longest": float(long["length_mm"]),
        "u_longest": float(long["u_length_mm"]),
        "at_longest": float(long["nominal"]),
        "shortest": float(short["length_mm"]),
        "u_shortest": float(short["u_length_mm"]),
        "at_shortest": float(short["nominal"]),
        "contraction": ratio,
        "u_contraction": u,
    }


def _wide(curves: list[LoadCurve]) -> Section:
    """The form of Table C-3: one row per pressure, one column per load."""
    import pandas as pd

    cells: dict[float, dict[str, Any]] = {}
    for k, curve in enumerate(curves):
        for nominal, part in curve.rows.groupby(nominal_kpa(curve.rows)):
            pressure = float(str(nominal))
            row = cells.setdefault(pressure, {"pressure_kpa": pressure})
            n = max(int(part["length_mm"].notna().sum()), 1)
            noise = float(np.sqrt((part["u_length_mm_noise"].astype(float) ** 2).sum())) / n
            cal = float(part["u_length_mm_cal"].astype(float).mean())
            row[f"l{k}"] = float(part["length_mm"].mean())
            row[f"u_l{k}"] = math.hypot(noise, 0.0 if math.isnan(cal) else cal)
    heads = [(f"l{k}", f"{curve.name}, mm") for k, curve in enumerate(curves)]
    return Section(
        "Length at each pressure and load",
        (),
        pd.DataFrame([cells[p] for p in sorted(cells)]),
        (("pressure_kpa", "pressure, kPa"), *heads),
        caption=f"Length under each load, mean of repeated points; {EXPANDED}.",
    )


def _headline(rows: list[dict[str, Any]], lengths_missing: bool, rest_mm: float | None) -> str:
    if not rows:
        missing = "No length was measured, so there is no result."
        return missing if lengths_missing else NO_SETTLED_POINT
    percent = [100 * row["contraction"] for row in rows]
    loads = f"{rows[0]['load']} to {rows[-1]['load']}" if len(rows) > 1 else rows[0]["load"]
    span = f"{min(percent):.0f} to {max(percent):.0f}" if len(rows) > 1 else f"{percent[0]:.1f}"
    reference = "its longest settled length" if rest_mm is None else f"L0 = {rest_mm:g} mm"
    return f"Under {loads} the muscle contracts by {span} % of {reference}."


def _thesis(curves: list[LoadCurve], rows: list[dict[str, Any]]) -> Section:
    """Comparison of Table C-3 with the statements of the thesis about it."""
    lengths = {
        round(curve.load_n, 2): curve.rows.set_index(
            curve.rows["set_pressure_kpa"].astype(float)
        )["length_mm"].astype(float)
        for curve in curves
    }  # fmt: skip
    crossed = []
    if 10.0 in lengths and 13.0 in lengths:
        ten, thirteen = lengths[10.0], lengths[13.0]
        both = ten.index.intersection(thirteen.index)
        crossed = [float(p) for p in both if thirteen[p] < ten[p]]
    rising = [
        curve.name
        for curve, values in list(zip(curves, lengths.values(), strict=True))[:2]
        if bool((values[values.index <= 125].diff().dropna() >= 0).all())
    ]
    low, high = min(r["contraction"] for r in rows), max(r["contraction"] for r in rows)
    at = ", ".join(f"{p:g}" for p in crossed) + " kPa" if crossed else "no pressure"
    return claims_section(
        "Comparison with the thesis",
        "The thesis prints no number derived from Table C-3; these statements can be checked.",
        (
            (
                "contraction lies within 0 to 0.2 (quoted with Equation 4-19)",
                f"{low:.2f} to {high:.2f} from 0 to 600 kPa",
                high <= 0.2,
            ),
            (
                "length rises with pressure up to 125 kPa for the two lightest loads (4.8.3)",
                f"throughout for: {', '.join(rising) or 'neither'}; otherwise it rises and falls",
                len(rising) == 2,
            ),
            ("a heavier load hangs lower", f"13 N shorter than 10 N at {at}", not crossed),
        ),
        "in the table",
    )


def _figure(curves: list[LoadCurve]) -> Figure:
    from analysis.figures.drawing import CurveEnds, curve, curves_figure, directions_legend

    def draw(axes: Any, colours: list[Any], ends: CurveEnds) -> None:
        for k, load in enumerate(curves):
            end = (math.nan, math.nan)
            for direction, part in load.rows.groupby("direction", sort=True):
                end = curve(
                    axes, part, ("pressure_kpa", "length_mm"), nominal_kpa(part), colours[k], k,
                    down=direction == "down",
                )  # fmt: skip
            ends.append((*end, load.name, colours[k]))
        if any((load.rows["direction"] == "down").any() for load in curves):
            directions_legend(axes, "upper right")

    return curves_figure(
        len(curves), "pressure (kPa gauge)", "length (mm)", "load", draw, zero_line=False
    )


ISOTONIC = Analysis(
    "isotonic",
    "Isotonic test",
    partial(reduce_points, extra=EXTRA),
    lambda parameters: isotonic_layout(max_pressure_kpa(parameters)),
    isotonic_findings,
    ResultColumns(("length_mm",)),
)
ANALYSES = (ISOTONIC,)
