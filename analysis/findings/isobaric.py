"""Findings of an isobaric test (thesis Figure 4-11, Table C-37, Equations 4-44 and 4-45)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.figures.wording import signed, with_u
from analysis.findings.findings import (
    BARS,
    EXPANDED,
    NO_SETTLED_POINT,
    Analysis,
    Findings,
    Section,
    as_in,
    source_table,
)
from analysis.layouts.static import isobaric_layout
from analysis.reduction.points import is_imported, reduce_points
from analysis.regression.force_lines import coldest, line_uncertainty, nominal_kpa
from analysis.regression.least_squares import Line, straight_line

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from analysis.reduction.points import Reduction
    from daq.store.run import Run

REGION_KPA = (150.0, 600.0)
"""Section 4.10: in this pressure region the force is linear in length."""
PRINTED_4_44 = ("0.00878", "-0.2391")
"""Slope and constant of Equation 4-44. The constant is that of Table C-38; 4-44 prints -0.231."""

PressureLines = list[tuple[float, Line]]


def isobaric_findings(run: Run, reduction: Reduction) -> Findings:
    """Force against length at each pressure, the lines, and their dependence on pressure."""
    import pandas as pd

    table = reduction.table
    lines = lines_in_length(table)
    groups = dict(_by_pressure(table))
    names = ("length_mm", "force_n")
    rows = []
    for p, line in lines:
        x, y = (groups[p][name] for name in names)
        u_gradient, u_intercept = line_uncertainty(line, x, y, reduction.calibrations, names)
        rows.append(
            {
                "pressure_kpa": p, "n": line.n, "gradient": line.slope,
                "u_gradient": u_gradient, "intercept": line.intercept,
                "u_intercept": u_intercept, "scatter": round(line.s, 3), "r2": round(line.r2, 4),
            }
        )  # fmt: skip
    inside = [(p, line) for p, line in lines if REGION_KPA[0] <= p <= REGION_KPA[1]]
    pressures = np.array([p for p, _ in inside])
    gradient = straight_line(pressures, np.array([line.slope for _, line in inside]))
    intercept = straight_line(pressures, np.array([line.intercept for _, line in inside]))
    with_calibrations = " and from zero and gain of the calibrations"
    sections = [
        Section(
            "Force against length",
            figure=lambda: _figure(table),
            caption=f"One curve per pressure{as_in(run, 'Figure 4-11')}. {BARS}",
        ),
        Section(
            "Straight lines at each pressure",
            ("Force = gradient · length + intercept by least squares.",),
            pd.DataFrame(rows),
            (
                ("pressure_kpa", "pressure, kPa"), ("n", "points"), ("gradient", "gradient, N/mm"),
                ("intercept", "intercept, N"), ("scatter", "scatter, N"), ("r2", "R²"),
            ),
            caption=f"{EXPANDED}, from the scatter about the line"
            f"{with_calibrations if reduction.calibrations else ''}.",
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
        words = (
            f"From {REGION_KPA[0]:g} to {REGION_KPA[1]:g} kPa: gradient ="
            f" {gradient.slope:.5f} P {signed(gradient.intercept, 4)} N/mm; intercept ="
            f" {intercept.slope:.5f} P {signed(intercept.intercept, 3)} N, P in kPa."
        )
        sections.append(Section("Gradient and intercept against pressure", (words,)))
    if not is_imported(run):
        from analysis.findings.muscle.energy import loops_section

        loops, lost = loops_section(table, reduction.calibrations)
        if loops is not None:
            sections.append(loops)
            data["loops"] = lost
    if source_table(run) == "C-2":
        sections.append(_compare_c37(lines))
    u = {row["pressure_kpa"]: row["u_gradient"] for row in rows}
    return Findings(_headline(table, inside, gradient, u), tuple(sections), data)


def lines_in_length(table: pd.DataFrame) -> PressureLines:
    """The line of force against length at each set pressure, at the lowest temperature."""
    fitted = [
        (pressure, straight_line(rows["length_mm"], rows["force_n"]))
        for pressure, rows in _by_pressure(table)
    ]
    return [(pressure, line) for pressure, line in fitted if line is not None]


def _by_pressure(table: pd.DataFrame) -> list[tuple[float, pd.DataFrame]]:
    """Rows of each set pressure, in increasing order, at the lowest temperature."""
    cold = coldest(table)
    return [(float(str(p)), rows) for p, rows in cold.groupby(nominal_kpa(cold), sort=True)]


def _headline(
    table: pd.DataFrame, inside: PressureLines, gradient: Line | None, u: Mapping[float, float]
) -> str:
    if not len(table):
        return NO_SETTLED_POINT
    if not inside:
        return (
            f"{len(table)} settled points were measured, too few between {REGION_KPA[0]:g} and"
            f" {REGION_KPA[1]:g} kPa for a straight line in length."
        )
    slopes = sorted(line.slope for _, line in inside)
    if len(inside) > 1:
        held = f"constant pressures between {inside[0][0]:g} and {inside[-1][0]:g}"
        rate = f"{slopes[0]:.2f} to {slopes[-1]:.2f} N per mm of length"
    else:
        held = f"a constant pressure of {inside[0][0]:g}"
        rate = f"{with_u(slopes[0], u[inside[0][0]])} N per mm of length (k = 2)"
    text = f"At {held} kPa the force rises by {rate}"
    if gradient is not None:
        law = f"{gradient.slope:.5f} P {signed(gradient.intercept, 3)}"
        text += f"; this gradient is {law} N/mm, P in kPa"
    return text + "."


def _compare_c37(lines: PressureLines) -> Section:
    """Table C-37 compared with C-2, and with C-1, from which it was computed."""
    import pandas as pd

    from plant.thesis import array, load

    c01 = array("c01")
    cold = (c01["temperature_c"] == 21) if "temperature_c" in c01 else np.ones(len(c01), bool)
    length = np.where(c01["length_mm"] == 51, 51.45, c01["length_mm"])
    from_c2 = dict(lines)
    rows = []
    for printed in load("c37"):
        p = float(str(printed["pressure_kpa"]))
        at = cold & (c01["pressure_kpa"] == p)
        from_c1 = straight_line(length[at], c01["force_n"][at])
        own = from_c2.get(p)
        assert from_c1 is not None
        g, i = float(str(printed["length_gradient_coef"])), float(str(printed["intercept_coef"]))
        rows.append(
            {
                "pressure_kpa": p, "g_printed": g, "i_printed": i,
                "g_c2": round(own.slope, 5) if own else None,
                "i_c2": round(own.intercept, 3) if own else None,
                "g_c1": round(from_c1.slope, 5), "i_c1": round(from_c1.intercept, 3),
                "same": abs(from_c1.slope - g) < 1.5e-4 and abs(from_c1.intercept - i) < 6e-4,
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
        f"at {r.pressure_kpa:g} kPa {r.g_printed:.5f} is printed, the result is {r.g_c1:.5f} (a"
        " digit is missing)"
        for r in off.itertuples()
    )
    return Section(
        "Comparison with the thesis: Table C-37",
        (
            "The thesis states that Table C-37 belongs to the isobaric test. This is wrong:"
            f" its intercepts differ by up to {worst:.1f} N from those of Table C-2. From Table"
            f" C-1 (the isometric test) {len(frame) - len(off)} of {len(frame)} rows are"
            f" reproduced to about 0.0005 N and 0.0001 N/mm. Exceptions: {named or 'none'}.",
            f"Equation 4-44 prints {PRINTED_4_44[0]} P − 0.231, Table C-38 {PRINTED_4_44[1]}. The"
            f" gradients as printed give {slip.slope:.5f} P {signed(slip.intercept, 4)}: they"
            " contain the missing digit, and −0.231 is a second error. With the corrected digit"
            f" the result is {right.slope:.5f} P {signed(right.intercept, 4)}. Equation 4-45"
            f" prints −0.38 − 0.425 P; the intercepts give {signed(constant.intercept, 3)}"
            f" {signed(constant.slope, 5)} P.",
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
    from analysis.figures.drawing import CurveEnds, curve, curves_figure

    def draw(axes: Any, colours: list[Any], ends: CurveEnds) -> None:
        for k, (pressure, rows) in enumerate(groups):
            lengths = rows["set_length_mm"].fillna(rows["length_mm"].round(2))
            end = curve(axes, rows, ("length_mm", "force_n"), lengths, colours[k], k)
            ends.append((*end, f"{pressure:g}", colours[k]))

    groups = _by_pressure(table)
    return curves_figure(len(groups), "length (mm)", "force (N)", "pressure (kPa)", draw)


ISOBARIC = Analysis(
    "isobaric", "Isobaric test", reduce_points, lambda _: isobaric_layout(), isobaric_findings
)
ANALYSES = (ISOBARIC,)
