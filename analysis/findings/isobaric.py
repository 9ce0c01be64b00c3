"""What a table of forces at held pressures says (Figure 4-11, Table C-37, Equations 4-44, 4-45)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.findings.findings import Analysis, Findings, Section
from analysis.reduction.points import reduce_points
from analysis.regression.force_lines import line_uncertainty
from analysis.regression.least_squares import Line, straight_line
from daq.live.layout import LiveLayout

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from analysis.reduction.points import Reduction
    from daq.store.run import Run

REGION_KPA = (150.0, 600.0)
"""Section 4.10: over these pressures the force is a straight line in length."""
PRINTED_4_44 = ("0.00878", "-0.2391")
"""Slope and constant of Equation 4-44, the constant as Table C-38 has it (4-44 prints -0.231)."""
PRINTED_4_45 = ("-0.425", "-0.38")


def isobaric_findings(run: Run, reduction: Reduction) -> Findings:
    """Force against length at each pressure, the straight lines, and their laws in pressure."""
    import pandas as pd

    table = reduction.table
    lines = lines_in_length(table)
    groups = dict(_by_pressure(table))
    u = {
        p: line_uncertainty(
            line, groups[p]["length_mm"], groups[p]["force_n"], reduction.calibrations,
            ("length_mm", "force_n"),
        )
        for p, line in lines
    }  # fmt: skip
    inside = [(p, line) for p, line in lines if REGION_KPA[0] <= p <= REGION_KPA[1]]
    pressures = np.array([p for p, _ in inside])
    gradient = straight_line(pressures, np.array([line.slope for _, line in inside]))
    intercept = straight_line(pressures, np.array([line.intercept for _, line in inside]))
    rows = [
        {
            "pressure_kpa": p, "n": line.n, "gradient": line.slope,
            "u_gradient": u[p][0], "intercept": line.intercept, "u_intercept": u[p][1],
            "scatter": round(line.s, 3), "r2": round(line.r2, 4),
        }
        for p, line in lines
    ]  # fmt: skip
    sections = [
        Section(
            "Force against length",
            figure=lambda: _figure(table),
            caption="One curve a pressure (the form of the thesis's Figure 4-11). Bars: expanded"
            " uncertainty, k = 2, where larger than the marker.",
        ),
        Section(
            "Straight lines at each pressure",
            ("Force = gradient · length + intercept by least squares (Equations 4-42, 4-43).",),
            pd.DataFrame(rows),
            (
                ("pressure_kpa", "pressure, kPa"), ("n", "points"), ("gradient", "gradient, N/mm"),
                ("intercept", "intercept, N"), ("scatter", "scatter, N"), ("r2", "R²"),
            ),
            caption="± expanded uncertainty, k = 2, from the scatter about the line"
            + (
                " together with zero and gain of the calibrations."
                if reduction.calibrations
                else "."
            ),
        ),
    ]  # fmt: skip
    data: dict[str, Any] = {}
    if gradient is not None and intercept is not None:
        data = {
            "gradient_slope_n_mm_kpa": gradient.slope,
            "gradient_constant_n_mm": gradient.intercept,
            "intercept_slope_n_kpa": intercept.slope,
            "intercept_constant_n": intercept.intercept,
        }
        sections.append(
            Section(
                "Gradient and intercept against pressure",
                (
                    f"From {REGION_KPA[0]:g} to {REGION_KPA[1]:g} kPa: gradient ="
                    f" {gradient.slope:.5f} P {_signed(gradient.intercept, 4)} N/mm; intercept ="
                    f" {intercept.slope:.5f} P {_signed(intercept.intercept, 3)} N, P in kPa."
                    " The forms are those of Equations 4-44 and 4-45.",
                ),
            )
        )
    if (run.manifest.get("source") or {}).get("table") == "C-2":
        sections.append(_against_c37(lines))
    return Findings(_headline(table, inside, gradient), tuple(sections), data)


def lines_in_length(table: pd.DataFrame) -> list[tuple[float, Line]]:
    """At each set pressure the line of force against length, lowest temperature only."""
    fitted = [
        (pressure, straight_line(rows["length_mm"], rows["force_n"]))
        for pressure, rows in _by_pressure(table)
    ]
    return [(pressure, line) for pressure, line in fitted if line is not None]


def _by_pressure(table: pd.DataFrame) -> list[tuple[float, pd.DataFrame]]:
    """Rows of each set pressure, rising, lowest temperature only."""
    cold = table
    temperature = table["temperature_c"].astype(float)
    if temperature.max() - temperature.min() > 2.0:
        cold = table[temperature < temperature.min() + 2.0]
    nominal = cold["set_pressure_kpa"].fillna(cold["pressure_kpa"].round(0))
    return [(float(str(p)), rows) for p, rows in cold.groupby(nominal, sort=True)]


def _headline(table: pd.DataFrame, inside: list[tuple[float, Line]], gradient: Line | None) -> str:
    if not len(table):
        return "No settled point was reached, so there is no result."
    if not inside:
        return (
            f"{len(table)} settled points were measured, too few between {REGION_KPA[0]:g} and"
            f" {REGION_KPA[1]:g} kPa for a straight line in length."
        )
    slopes = sorted(line.slope for _, line in inside)
    held, pulls = f"at {inside[0][0]:g}", f"{slopes[0]:.2f}"
    if len(inside) > 1:
        held = f"between {inside[0][0]:g} and {inside[-1][0]:g}"
        pulls += f" to {slopes[-1]:.2f}"
    text = f"Held {held} kPa the muscle pulls {pulls} N harder for each mm that it is longer"
    if gradient is not None:
        law = f"{gradient.slope:.5f} P {_signed(gradient.intercept, 3)}"
        text += f"; the gradient grows with pressure as {law} N/mm, P in kPa"
    return text + "."


def _against_c37(lines: list[tuple[float, Line]]) -> Section:
    """Table C-37 beside C-2, and beside C-1, from which it was computed."""
    import pandas as pd

    from plant.thesis import array, load

    c01 = array("c01")
    cold = (c01["temperature_c"] == 21) if "temperature_c" in c01 else np.ones(len(c01), bool)
    length = np.where(c01["length_mm"] == 51, 51.45, c01["length_mm"])
    mine = dict(lines)
    rows = []
    for printed in load("c37"):
        p = float(str(printed["pressure_kpa"]))
        at = cold & (c01["pressure_kpa"] == p)
        other = straight_line(length[at], c01["force_n"][at])
        own = mine.get(p)
        assert other is not None
        g, i = float(str(printed["length_gradient_coef"])), float(str(printed["intercept_coef"]))
        same = abs(other.slope - g) < 1.5e-4 and abs(other.intercept - i) < 6e-4
        rows.append(
            {
                "pressure_kpa": p, "g_printed": g, "i_printed": i,
                "g_c2": round(own.slope, 5) if own else None,
                "i_c2": round(own.intercept, 3) if own else None,
                "g_c1": round(other.slope, 5), "i_c1": round(other.intercept, 3),
                "same": same,
            }
        )  # fmt: skip
    frame = pd.DataFrame(rows)
    off = frame[~frame["same"]]
    worst = float((frame["i_printed"] - frame["i_c2"]).abs().max())
    slip = straight_line(frame["pressure_kpa"], frame["g_printed"])
    right = straight_line(frame["pressure_kpa"], frame["g_c1"])
    constant = straight_line(frame["pressure_kpa"], frame["i_printed"])
    assert slip is not None
    assert right is not None
    assert constant is not None
    named = "; ".join(
        f"{r.pressure_kpa:g} kPa prints {r.g_printed:.5f} where {r.g_c1:.5f} comes out (a digit"
        " dropped)"
        for r in off.itertuples()
    )
    return Section(
        "Beside what the thesis printed: Table C-37",
        (
            f"Table C-37 is said to be of the isobaric test. It is not: from Table C-2 its"
            f" intercepts come out up to {worst:.1f} N apart, from Table C-1 (the isometric test)"
            f" {len(frame) - len(off)} of {len(frame)} rows come out to 0.0005 N and 0.0001 N/mm"
            f" or so. What does not: {named or 'nothing'}.",
            f"Equation 4-44 prints {PRINTED_4_44[0]} P − 0.231, Table C-38 {PRINTED_4_44[1]}: the"
            f" gradients as printed give {slip.slope:.5f} P {_signed(slip.intercept, 4)}, so that"
            f" the slip went into it and −0.231 is a second one; without the slip it is"
            f" {right.slope:.5f} P {_signed(right.intercept, 4)}. Equation 4-45 prints −0.38 −"
            f" 0.425 P; the intercepts give {_signed(constant.intercept, 3)}"
            f" {_signed(constant.slope, 5)} P.",
        ),
        frame,
        (
            ("pressure_kpa", "pressure, kPa"), ("g_printed", "gradient printed, N/mm"),
            ("g_c1", "from C-1, N/mm"), ("g_c2", "from C-2, N/mm"),
            ("i_printed", "intercept printed, N"), ("i_c1", "from C-1, N"),
            ("i_c2", "from C-2, N"), ("same", "as C-1"),
        ),
    )  # fmt: skip


def _figure(table: pd.DataFrame) -> Figure:
    from analysis.figures.drawing import (
        COVERAGE,
        MARKERS,
        labels_at_right,
        new_figure,
        sequence,
        style,
    )

    groups = _by_pressure(table)
    colours = sequence(len(groups))
    with style():
        figure, axes = new_figure(7.2, 4.9)
        ends: list[tuple[float, float, str, Any]] = []
        for k, (pressure, rows) in enumerate(groups):
            axes.errorbar(
                rows["length_mm"], rows["force_n"],
                xerr=COVERAGE * np.nan_to_num(rows["u_length_mm"].astype(float)),
                yerr=COVERAGE * np.nan_to_num(rows["u_force_n"].astype(float)),
                fmt=MARKERS[k % len(MARKERS)], markersize=3.4, color=colours[k], elinewidth=0.7,
            )  # fmt: skip
            named = rows["set_length_mm"].fillna(rows["length_mm"].round(2))
            mean = rows[["length_mm", "force_n"]].astype(float).groupby(named).mean().sort_index()
            axes.plot(mean["length_mm"], mean["force_n"], color=colours[k], linewidth=1.0)
            end = (float(mean["length_mm"].iloc[-1]), float(mean["force_n"].iloc[-1]))
            ends.append((*end, f"{pressure:g}", colours[k]))
        axes.axhline(0.0, color="#8a8a8a", linewidth=0.8)
        axes.set_xlabel("length (mm)")
        axes.set_ylabel("force (N)")
        labels_at_right(axes, ends, "pressure (kPa)")
    return figure


def _signed(value: float, decimals: int) -> str:
    return f"{'−' if value < 0 else '+'} {abs(value):.{decimals}f}"


def _layout(parameters: Mapping[str, Any]) -> LiveLayout:
    """Its screen."""
    from analysis.layouts.static import isobaric_layout

    del parameters
    return isobaric_layout()


ISOBARIC = Analysis("isobaric", "Isobaric test", reduce_points, _layout, isobaric_findings)
ANALYSES = (ISOBARIC,)
