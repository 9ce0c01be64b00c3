"""Findings of an isometric test: lines in pressure, laws in length, comparison with the thesis."""

from __future__ import annotations

import math
from dataclasses import asdict
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
    max_pressure_kpa,
    source_table,
)
from analysis.findings.thesis_check import compare_c9, printed_law
from analysis.layouts.layouts import isometric_layout
from analysis.reduction.points import Reduction, reduce_isometric
from analysis.regression.force_lines import (
    THESIS_DIGITS,
    THESIS_REGION_KPA,
    LengthLaw,
    LengthLine,
    against_length,
    coldest,
    covered_kpa,
    per_length,
)

if TYPE_CHECKING:
    from daq.store.run import Run

Region = tuple[float, float]
Law = tuple[float, LengthLaw]
"""Temperature in degC and the law at it."""


def isometric_findings(
    run: Run, reduction: Reduction, region_kpa: Region = THESIS_REGION_KPA
) -> Findings:
    """Lines at each length and their laws; Table C-9 is compared for an import of Table C-1.

    Args:
        run: an opened run.
        reduction: its reduction.
        region_kpa: pressure region of the straight lines.
    """
    table = reduction.table
    lines = per_length(table, region_kpa, reduction.calibrations)
    groups = by_temperature(lines)
    first = against_length(groups[0]) if groups else None
    laws = [
        (group[0].temperature_c, law)
        for group in groups
        if (law := against_length(group)) is not None
    ]
    covered = covered_kpa(table, region_kpa)
    thesis = None
    if source_table(run) == "C-1" and region_kpa == THESIS_REGION_KPA:
        cold = [line for line in lines if abs(line.temperature_c - 21.0) < 0.5]
        at_21 = table[table["temperature_c"].sub(21.0).abs() < 0.5]
        thesis = compare_c9(cold, at_21) if cold else None
    sections = [
        *_figures(run, reduction, region_kpa, of_thesis=thesis is not None),
        *_line_sections(run, lines, laws, covered, bool(reduction.calibrations)),
        *(_thesis_sections(thesis) if thesis else ()),
    ]
    # These entries of the report are older than its sections; other programs read them.
    entries = {
        "region_kpa": list(region_kpa),
        "covered_kpa": list(covered),
        "lengths": [asdict(line) for line in lines],
        "laws": [{"temperature_c": temperature, **asdict(law)} for temperature, law in laws],
        "thesis": thesis,
    }
    headline = _headline(lines, first, len(table), covered)
    return Findings(headline, tuple(sections), report_entries=entries)


def by_temperature(lines: list[LengthLine]) -> list[list[LengthLine]]:
    """The lines grouped by temperature (to 2 degC), coldest first."""
    groups: list[list[LengthLine]] = []
    for line in sorted(lines, key=lambda line: (_or_zero(line.temperature_c), line.length_mm)):
        last = groups[-1][0].temperature_c if groups else math.nan
        if groups and not abs(_or_zero(line.temperature_c) - _or_zero(last)) > 2.0:
            groups[-1].append(line)
        else:
            groups.append([line])
    return groups


def _or_zero(value: float) -> float:
    return value if math.isfinite(value) else 0.0


def _headline(lines: list[LengthLine], law: LengthLaw | None, points: int, covered: Region) -> str:
    if not points:
        return NO_SETTLED_POINT
    low, high = covered
    if not lines:
        return (
            f"{points} settled points were measured, too few between {low:g} and {high:g} kPa"
            " for a straight line at any length."
        )
    gradients = sorted(line.gradient_n_per_kpa for line in lines)
    lengths = sorted(line.length_mm for line in lines)
    text = f"Between {low:g} and {high:g} kPa the force rises by "
    if len(lines) == 1:
        u = [lines[0].u_gradient_fit, lines[0].u_gradient_cal]
        gradient = with_u(gradients[0], math.hypot(*(x for x in u if x == x)))
        k = " (k = 2)" if "±" in gradient else ""
        return f"{text}{gradient} N/kPa at a length of {lengths[0]:.2f} mm{k}."
    text += (
        f"{gradients[0]:.3f} to {gradients[-1]:.3f} N/kPa, for lengths from {lengths[0]:.2f} to"
        f" {lengths[-1]:.2f} mm"
    )
    if law is not None:
        gradient = f"{law.gradient.slope:.4f} L {signed(law.gradient.intercept, 3)}"
        text += f"; this gradient is {gradient} N/kPa, L in mm"
    return text + "."


def _figures(run: Run, reduction: Reduction, region_kpa: Region, of_thesis: bool) -> list[Section]:
    """Force against pressure, coefficients against length, and residuals; lowest temperature."""
    from analysis.figures import isometric as figures

    table = coldest(reduction.table)
    if not len(table):
        return []
    only = " Only the lowest temperature is shown." if len(table) < len(reduction.table) else ""
    both = bool((table["direction"] == "down").any())
    rising = " Filled and solid: pressure rising; open and dashed: falling." if both else ""
    sections = [
        Section(
            "Force against pressure",
            figure=lambda: figures.force_figure(table),
            caption=f"Settled points, one curve per length{as_in(run, 'Figure 4-9')}."
            f" {BARS}{only}{rising}",
        )
    ]
    lines = per_length(table, region_kpa, reduction.calibrations)
    groups = by_temperature(lines)
    if not groups or len(groups[0]) < 3:
        return sections
    cold = groups[0]
    printed = (printed_law("4-34"), printed_law("4-35")) if of_thesis else None
    law = against_length(cold, THESIS_DIGITS if of_thesis else None)
    coefficients = "Gradient and intercept of each length, and the straight lines through them."
    if of_thesis:
        coefficients = (
            "Lines fitted to the coefficients rounded to three digits as in Table C-9, and the"
            " equations as printed in the thesis (4-35 with −0.43)."
        )
    return [
        *sections,
        Section(
            "Coefficients against length",
            figure=lambda: figures.regression_figure(cold, law, printed),
            caption=coefficients,
        ),
        Section(
            "Residuals of the straight lines",
            figure=lambda: figures.residual_figure(table, lines, region_kpa),
            caption="Measured force minus the straight line of its length. A systematic dependence"
            " on pressure shows that the model is incomplete; noise has none.",
        ),
    ]


def _line_sections(
    run: Run, lines: list[LengthLine], laws: list[Law], covered: Region, calibrated: bool
) -> list[Section]:
    """Tables of the lines at each length, and the laws in words."""
    import pandas as pd

    if not lines:
        return []
    several = len(laws) > 1
    frame = pd.DataFrame([asdict(line) for line in lines])
    for name in ("gradient", "intercept"):
        u_fit, u_cal = (frame[f"u_{name}_{part}"].fillna(0.0) for part in ("fit", "cal"))
        frame[name] = frame["gradient_n_per_kpa" if name == "gradient" else "intercept_n"]
        frame[f"u_{name}"] = np.hypot(u_fit, u_cal)
    frame = frame.round({"length_mm": 2, "temperature_c": 0, "r2": 4, "sd_n": 3,
                         "down_minus_up_n": 3})  # fmt: skip
    columns = [
        ("length_mm", "length, mm"),
        *([("temperature_c", "temperature, °C")] if several else []),
        ("n", "points"), ("gradient", "gradient, N/kPa"), ("intercept", "intercept, N"),
        ("r2", "R²"), ("sd_n", "scatter, N"),
        *([("down_minus_up_n", "falling − rising, N")]
          if frame["down_minus_up_n"].notna().any() else []),
    ]  # fmt: skip
    calibrations = " and from zero and gain of the calibrations" if calibrated else ""
    words = (
        f"Force = gradient · pressure + intercept by least squares{as_in(run, 'Equation 4-32')}."
        f" {EXPANDED}, from the scatter about the line{calibrations}."
    )
    title = f"Straight lines at each length, {covered[0]:g} to {covered[1]:g} kPa"
    sections = [Section(title, (words,), frame, tuple(columns))]
    if laws:
        sentences = tuple(
            (f"At {temperature:.0f} °C: " if several else "") + _law_words(law)
            for temperature, law in laws
        )
        sections.append(Section("Gradient and intercept against length", sentences))
    return sections


def _law_words(law: LengthLaw) -> str:
    g, i = law.gradient, law.intercept
    return (
        f"gradient = {g.slope:.5f} L {signed(g.intercept, 4)} N/kPa (standard errors"
        f" {g.u_slope:.5f} and {g.u_intercept:.3f}, R² {g.r2:.3f}); intercept ="
        f" {i.slope:.4f} L {signed(i.intercept, 3)} N ({i.u_slope:.3f} and {i.u_intercept:.1f}, R²"
        f" {i.r2:.3f}); L in mm."
    ).replace("= -", "= −")


def _thesis_sections(thesis: dict[str, Any]) -> tuple[Section, ...]:
    """Table C-9 compared, and the question of the shortest length."""
    import pandas as pd

    readings = thesis["readings"]
    rows = []
    for k, equation in enumerate(readings[0]["equations"]):
        again = [reading["equations"][k] for reading in readings]
        rows.append(
            (
                f"Equation {equation['equation']}, slope and constant",
                ", ".join(equation["printed"]),
                *(", ".join(e["from_printed_digits"]) for e in again),
            )
        )
        exact = [f"{e['from_unrounded'][0]:.5f}, {e['from_unrounded'][1]:.4f}" for e in again]
        rows.append(("the same from unrounded coefficients", "", *exact))
    for name, key, form in (("C-8", "sse_c8", ".2f"), ("C-9", "sse_c9", ".0f")):
        sums = [f"{reading[key]:{form}}" for reading in readings]
        words = f"Full-regression {name}, error sum of squares"
        rows.append((words, thesis[f"{key}_printed"], *sums))
    heads = ("quantity", "printed", *(f"with {r['shortest_mm']:g} mm" for r in readings))
    c9 = pd.DataFrame(thesis["rows"])
    c9["gradient_unrounded"] = c9["gradient_unrounded"].map("{:.6f}".format)
    c9["intercept_unrounded"] = c9["intercept_unrounded"].map("{:.4f}".format)
    return (
        Section(
            "Comparison with the thesis",
            (
                f"{thesis['matching']} of {thesis['pairs']} gradient and intercept pairs of Table"
                " C-9 are reproduced to their printed digits.",
            ),
            c9,
            (
                ("length_mm", "length, mm"), ("gradient_printed", "gradient, printed"),
                ("gradient_recomputed", "gradient, recomputed"),
                ("gradient_unrounded", "unrounded"), ("intercept_printed", "intercept, printed"),
                ("intercept_recomputed", "intercept, recomputed"),
                ("intercept_unrounded", "unrounded"), ("same", "same"),
            ),
        ),
        Section(
            "Is the shortest length 51 or 51.45 mm?",
            (
                "The heading of Table C-1 gives its shortest length as 51 mm; all other tables give"
                " 51.45 mm. Gradient and intercept at one length do not depend on its value, so"
                " the pairs above cannot decide. Results across lengths can.",
                "Only 51.45 mm gives the printed values, so 51 is a shortened heading. Equation"
                " 4-34's −0.426 follows from the coefficients as printed in Table C-9 (three"
                " digits), not from the unrounded ones (−0.425). Equation 4-35 prints −0.043; Table"
                " C-9 gives −0.43, as does Table 4-1.",
            ),
            pd.DataFrame(rows, columns=list(heads)),
            tuple((head, head) for head in heads),
        ),
    )  # fmt: skip


ISOMETRIC = Analysis(
    "isometric",
    "Isometric test",
    reduce_isometric,
    lambda parameters: isometric_layout(pressure_max_kpa=max_pressure_kpa(parameters)),
    isometric_findings,
)
ANALYSES = (ISOMETRIC,)
