"""Comparison with the printed results of the thesis: Table C-9, Equations 4-34 and 4-35."""

from __future__ import annotations

import csv
from importlib import resources
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.regression.force_lines import (
    THESIS_DIGITS,
    LengthLaw,
    LengthLine,
    against_length,
    per_length,
)

if TYPE_CHECKING:
    import pandas as pd

IMPORTED_MM = 51.45
HEADED_MM = 51.0
"""The shortest length: as imported, and as in the heading of Table C-1."""

EQUATIONS = {
    "4-34": ("gradient", "0.0087", "-0.426"),
    "4-35": ("intercept", "-0.159", "-0.43"),
}
"""Slope and constant as printed. The constant of 4-35 is printed -0.043 in the equation and -0.43
in Table 4-1; only -0.43 follows from Table C-9."""

FULL_REGRESSION_C8_SSE = "57.21"
FULL_REGRESSION_C9_SSE = "421"


def printed_rows(name: str) -> list[dict[str, str]]:
    """Rows of a table of the thesis as text, digits as printed."""
    table = resources.files("plant.data").joinpath(f"{name}.csv")
    return list(csv.DictReader(table.read_text(encoding="utf-8").splitlines()))


def printed_c9() -> list[dict[str, str]]:
    """Table C-9 as text, shortest length first."""
    rows = printed_rows("c09_c15_per_length_coefs_150_600")
    return [row for row in rows if row["table"] == "C-9"]


def to_printed(value: float, printed: str) -> str:
    """The value with the number of decimals of the printed one."""
    decimals = len(printed.partition(".")[2])
    return f"{value:.{decimals}f}"


def compare_c9(lines: list[LengthLine], table: pd.DataFrame) -> dict[str, Any]:
    """Compare the recomputed coefficients with the printed ones.

    Args:
        lines: first-stage regressions of Table C-1 at 21 degC over 150 to 600 kPa.
        table: the settled points of these regressions.

    Returns:
        ``rows`` (one per length), the number of ``matching`` pairs, and ``readings``: the
        equations and sums of squares for both values of the shortest length.
    """
    printed_table = printed_c9()
    rows = []
    for line, printed in zip(lines, printed_table, strict=False):
        gradient, intercept = printed["pressure_gradient_coef"], printed["intercept_coef"]
        again = (
            to_printed(line.gradient_n_per_kpa, gradient),
            to_printed(line.intercept_n, intercept),
        )
        rows.append(
            {
                "length_mm": printed["length_mm"],
                "gradient_printed": gradient,
                "gradient_recomputed": again[0],
                "gradient_unrounded": line.gradient_n_per_kpa,
                "intercept_printed": intercept,
                "intercept_recomputed": again[1],
                "intercept_unrounded": line.intercept_n,
                "same": again == (gradient, intercept)
                and abs(line.length_mm - float(printed["length_mm"])) < 0.005,
            }
        )
    readings = [_reading(table, shortest) for shortest in (IMPORTED_MM, HEADED_MM)]
    return {
        "rows": rows,
        "matching": sum(row["same"] for row in rows),
        "pairs": len(printed_table),
        "readings": readings,
        "sse_c8_printed": FULL_REGRESSION_C8_SSE,
        "sse_c9_printed": FULL_REGRESSION_C9_SSE,
    }


def printed_law(name: str) -> tuple[float, float]:
    """Slope and constant of Equation 4-34 or 4-35 as printed."""
    _, slope, constant = EQUATIONS[name]
    return float(slope), float(constant)


def _reading(table: pd.DataFrame, shortest_mm: float) -> dict[str, Any]:
    """Equations and sums of squares if the shortest length is ``shortest_mm``."""
    read = table.copy()
    shortest = read["length_mm"] == read["length_mm"].min()
    read.loc[shortest, ["length_mm", "set_length_mm"]] = shortest_mm
    lines = per_length(read)
    laws = {digits: against_length(lines, digits) for digits in (THESIS_DIGITS, None)}
    equations = []
    for name, (part, slope, constant) in EQUATIONS.items():
        rounded, exact = _pair(laws[THESIS_DIGITS], part), _pair(laws[None], part)
        again = (to_printed(rounded[0], slope), to_printed(rounded[1], constant))
        equations.append(
            {
                "equation": name,
                "printed": [slope, constant],
                "from_printed_digits": list(again),
                "from_printed_digits_unrounded": list(rounded),
                "from_unrounded": list(exact),
                "same": again == (slope, constant),
            }
        )
    return {
        "shortest_mm": shortest_mm,
        "equations": equations,
        "sse_c8": _sse(read[read["pressure_kpa"] <= 125.0], product=False),
        "sse_c9": _sse(read[read["pressure_kpa"] >= 150.0], product=True),
    }


def _pair(law: LengthLaw | None, part: str) -> tuple[float, float]:
    if law is None:
        return float("nan"), float("nan")
    fit = getattr(law, part)
    return fit.slope, fit.intercept


def _sse(rows: pd.DataFrame, *, product: bool) -> float:
    """Error sum of squares of Full-regression C-8 (L and P) or C-9 (P L and P - 125)."""
    pressure = rows["pressure_kpa"].to_numpy(dtype=np.float64)
    length = rows["length_mm"].to_numpy(dtype=np.float64)
    force = rows["force_n"].to_numpy(dtype=np.float64)
    first, second = (pressure * length, pressure - 125.0) if product else (length, pressure)
    design = np.column_stack([np.ones_like(pressure), first, second])
    coefficients = np.linalg.lstsq(design, force, rcond=None)[0]
    residual = force - design @ coefficients
    return float(residual @ residual)
