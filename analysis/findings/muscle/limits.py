"""Findings of the tests of blocked force and of free contraction.

Blocked force: the length is held at L0, nothing shortens. Free contraction: almost nothing hangs.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.figures.wording import with_u
from analysis.findings.findings import (
    BARS,
    EXPANDED,
    NO_SETTLED_POINT,
    Analysis,
    Findings,
    ResultColumns,
    Section,
    max_pressure_kpa,
    records,
)
from analysis.findings.hysteresis import Cycle, cycles_of
from analysis.layouts.muscle import blocked_layout, free_layout
from analysis.reduction.points import Reduction, reduce_points
from analysis.reduction.setpoint import at_set_pressure
from analysis.regression.force_lines import line_uncertainty, nominal_kpa
from analysis.regression.least_squares import Line, straight_line

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from daq.calibration import Calibration
    from daq.store.run import Run

EXTRA = {"mass_kg": "float64"}
RISEN = 0.05
"""The line is fitted to points with more than this share of the largest force."""


def blocked_force_findings(run: Run, reduction: Reduction) -> Findings:
    """Force against pressure at L0: the largest force, the line, the hysteresis."""
    import pandas as pd

    table = reduction.table[reduction.table["settled"]]
    if not len(table):
        return Findings(NO_SETTLED_POINT)
    l0_mm = float((run.manifest.get("parameters") or {}).get("rest_length_mm", math.nan))
    top = table.iloc[int(table["force_n"].to_numpy(float).argmax())]
    line, row = _force_line(table, reduction.calibrations)
    cycles = _cycles(table, "force_n", reduction.calibrations)
    measured = table["length_mm"].mean()
    camera = reduction.calibrations.get("length_mm")
    seen = (
        f"; measured {measured:.2f} mm (expanded uncertainty"
        f" {2 * float(camera.u(measured)):.2f} mm)"
        if camera is not None and math.isfinite(measured)
        else ""
    )
    words = (
        f"The length was held at the stated slack length L0 = {l0_mm:g} mm{seen}. The line is"
        f" fitted to all settled points above {100 * RISEN:g} % of the largest force, of all"
        " repeats and both directions. Threshold: where the line has no force.",
    )
    sections = [
        Section(
            "Blocked force",
            figure=lambda: _curves(table, "force_n", "blocked force (N)", line),
            caption=f"Rising filled, falling open; line as fitted. {BARS}",
        )
    ]
    if row:
        sections.append(
            Section(
                "Line of force against pressure", words, pd.DataFrame([row]),
                (("slope_n_kpa", "slope, N/kPa"), ("intercept_n", "force at no pressure, N"),
                 ("threshold_kpa", "threshold, kPa"), ("points", "points")),
                caption=f"{EXPANDED}, with scatter and calibrations.",
            )
        )  # fmt: skip
    hysteresis, rows = _hysteresis(cycles, "N")
    sections += [*hysteresis, _points(table, ("force_n", "force, N"))]
    headline = (
        f"At L0 = {l0_mm:g} mm and {top['pressure_kpa']:.1f} kPa the blocked force is"
        f" {with_u(top['force_n'], top['u_force_n'])} N (k = 2)"
    )
    if row:
        slope = with_u(row["slope_n_kpa"], row["u_slope_n_kpa"])
        headline += f"; it rises by {slope} N/kPa"
    data = {
        "rest_length_mm": l0_mm, "force_n": float(top["force_n"]),
        "u_force_n": float(top["u_force_n"]), "pressure_kpa": float(top["pressure_kpa"]),
        "line": row, "cycles": rows, "points": records(table),
    }  # fmt: skip
    return Findings(headline + ".", tuple(sections), data)


def _force_line(
    table: pd.DataFrame, calibrations: Mapping[str, Calibration]
) -> tuple[Line | None, dict[str, Any]]:
    """The line through the risen points, and its row; nothing with fewer than three."""
    risen = table[table["force_n"] > RISEN * table["force_n"].max()]
    x, y = risen["pressure_kpa"].to_numpy(float), risen["force_n"].to_numpy(float)
    line = straight_line(x, y)
    if line is None or not line.slope:
        return None, {}
    u_slope, u_intercept = line_uncertainty(line, x, y, calibrations)
    # Slope and intercept are correlated; slope and force at the mean pressure are not.
    middle = float(x.mean())
    at_middle = float(line.at(middle))
    u_middle = math.sqrt(max(u_intercept**2 - (u_slope * middle) ** 2, line.s**2 / len(x)))
    threshold = -line.intercept / line.slope
    u_threshold = math.hypot(u_middle, u_slope * at_middle / line.slope) / abs(line.slope)
    pressure = calibrations.get("pressure_kpa")
    if pressure is not None:
        u_threshold = math.hypot(u_threshold, pressure.u_offset)
    return line, {
        "slope_n_kpa": line.slope, "u_slope_n_kpa": u_slope, "intercept_n": line.intercept,
        "u_intercept_n": u_intercept, "threshold_kpa": threshold, "u_threshold_kpa": u_threshold,
        "points": len(x),
    }  # fmt: skip


def free_contraction_findings(run: Run, reduction: Reduction) -> Findings:
    """Contraction against pressure under almost no load."""
    import pandas as pd

    table = reduction.table[reduction.table["settled"] & reduction.table["length_mm"].notna()]
    if not len(table):
        return Findings(NO_SETTLED_POINT)
    parameters = run.manifest.get("parameters") or {}
    stated = float(parameters.get("rest_length_mm") or 0.0)
    l0_mm, u_l0, how = _rest(table, stated, float(parameters.get("u_rest_length_mm") or 0.0))
    if not math.isfinite(l0_mm):
        return Findings("No length was measured at no pressure, and none is stated: no L0.")
    rows = table.reset_index(drop=True)
    strain, u_strain = contraction(
        rows, l0_mm, u_l0, reduction.calibrations.get("length_mm"), shared=not stated
    )
    rows = rows.assign(contraction=strain, u_contraction=u_strain)
    best = rows.iloc[int(rows["contraction"].to_numpy(float).argmax())]
    cycles = _cycles(table, "length_mm", reduction.calibrations)
    weight = float(table["force_n"].mean())
    words = (
        f"Contraction is 1 − L/L0 with {how}. A load of {weight:.2f} N hangs on the muscle, so"
        " that the contraction is a little below that under no load at all. Zero and gain of the"
        " length are common to L and to a measured L0, which the uncertainty takes into account.",
    )
    percent = rows.assign(percent=100 * rows["contraction"], u_percent=100 * rows["u_contraction"])
    columns = (
        ("set_pressure_kpa", "set pressure, kPa"), ("pressure_kpa", "pressure, kPa"),
        ("direction", "direction"), ("repeat", "repeat"), ("length_mm", "length, mm"),
        ("percent", "contraction, %"),
    )  # fmt: skip
    hysteresis, loops = _hysteresis(cycles, "mm")
    sections = (
        Section(
            "Free contraction",
            figure=lambda: _curves(percent, "percent", "contraction (%)", None),
            caption=f"Rising filled, falling open. {BARS}",
        ),
        Section("Contraction at each point", words, percent, columns, caption=f"{EXPANDED}."),
        *hysteresis,
    )
    headline = (
        "The largest free contraction is"
        f" {with_u(100 * best['contraction'], 100 * best['u_contraction'])} % (k = 2)"
        f" at {best['pressure_kpa']:.1f} kPa, of"
        f" L0 = {l0_mm:.2f} mm."
    )
    data = {
        "rest_length_mm": l0_mm, "u_rest_length_mm": u_l0, "rest_length_stated": bool(stated),
        "load_n": weight, "contraction": float(best["contraction"]),
        "u_contraction": float(best["u_contraction"]),
        "pressure_kpa": float(best["pressure_kpa"]), "cycles": loops,
        "points": records(pd.DataFrame(rows)),
    }  # fmt: skip
    return Findings(headline, sections, data)


def _rest(table: pd.DataFrame, stated: float, u_stated: float) -> tuple[float, float, str]:
    """L0, its uncertainty (by noise, where it was measured), and how it is known."""
    if stated:
        return stated, u_stated, f"the stated L0 = {stated:g} mm"
    vented = table[(table["set_pressure_kpa"] == 0.0) & (table["direction"] != "down")]
    if not len(vented):
        vented = table[table["set_pressure_kpa"] == 0.0]
    if not len(vented):
        return math.nan, math.nan, ""
    l0 = float(vented["length_mm"].mean())
    noise = math.sqrt(float((vented["u_length_mm_noise"].astype(float) ** 2).sum())) / len(vented)
    spread = (
        float(vented["length_mm"].std(ddof=1)) / math.sqrt(len(vented)) if len(vented) > 1 else 0
    )
    count = "one point" if len(vented) == 1 else f"{len(vented)} points"
    how = f"L0 = {l0:.3f} mm, the mean length at no pressure before it rose ({count})"
    return l0, max(noise, spread), how


def contraction(
    rows: pd.DataFrame, l0_mm: float, u_l0: float, camera: Calibration | None, shared: bool
) -> tuple[Any, Any]:
    """1 − L/L0 of each row and its standard uncertainty.

    Args:
        rows: points with lengths.
        l0_mm, u_l0: L0 and its uncertainty by noise, or of a stated one as a whole.
        camera: calibration of the lengths, None if it is not known.
        shared: L0 was measured with the same sensor, whose errors it shares.
    """
    length = rows["length_mm"].to_numpy(np.float64)
    strain = 1.0 - length / l0_mm
    noise = rows["u_length_mm_noise"].to_numpy(np.float64)
    u = np.hypot(noise / l0_mm, (1.0 - strain) * u_l0 / l0_mm)
    if camera is not None:
        for moved, rest in (
            (length + camera.u_offset, l0_mm + camera.u_offset),
            (
                length + camera.u_gain * (length - camera.offset),
                l0_mm + camera.u_gain * (l0_mm - camera.offset),
            ),
        ):
            u = np.hypot(u, 1.0 - moved / (rest if shared else l0_mm) - strain)
    return strain, u


def _cycles(
    table: pd.DataFrame, value: str, calibrations: Mapping[str, Calibration]
) -> list[Cycle]:
    """Cycles of the table, corrected to the set pressures; of all, not of settled points alone."""
    both = table.assign(cycle_max_kpa=table["set_pressure_kpa"].max())
    if value == "force_n":
        both = both.drop(columns=[c for c in ("mass_kg",) if c in both])
    return cycles_of(at_set_pressure(both.reset_index(drop=True), value), calibrations)


def _hysteresis(cycles: list[Cycle], unit: str) -> tuple[list[Section], list[dict[str, Any]]]:
    """Rising minus falling, one row for each replicate."""
    import pandas as pd

    rows: list[dict[str, Any]] = []
    for cycle in cycles:
        if len(cycle.pressure_kpa) < 2:
            continue
        at = int(np.argmax(np.abs(cycle.difference)))
        rows.append(
            {
                "repeat": cycle.repeat, "largest": float(cycle.difference[at]),
                "u_largest": float(cycle.u_difference[at]),
                "at_kpa": float(cycle.pressure_kpa[at]), "area": cycle.area,
                "u_area": cycle.u_area,
            }
        )  # fmt: skip
    if not rows:
        return [], rows
    words = (
        "The value at rising minus that at falling pressure, corrected to the set pressures; the"
        " area is that of the loop.",
    )
    columns = (
        ("repeat", "repeat"), ("largest", f"largest difference, {unit}"), ("at_kpa", "at, kPa"),
        ("area", f"loop area, {unit} kPa"),
    )  # fmt: skip
    return [Section("Hysteresis", words, pd.DataFrame(rows), columns, caption=f"{EXPANDED}.")], rows


def _points(table: pd.DataFrame, value: tuple[str, str]) -> Section:
    columns = (
        ("order", "point"), ("repeat", "repeat"), ("direction", "direction"),
        ("set_pressure_kpa", "set pressure, kPa"), ("pressure_kpa", "pressure, kPa"),
        ("length_mm", "length, mm"), value,
    )  # fmt: skip
    return Section("Settled points", (), table, columns, caption=f"{EXPANDED}.")


def _curves(table: pd.DataFrame, value: str, label: str, line: Line | None) -> Figure:
    from analysis.figures.drawing import QUIET, CurveEnds, curve, curves_figure, directions_legend

    repeats = list(dict.fromkeys(table["repeat"]))

    def draw(axes: Any, colours: list[Any], ends: CurveEnds) -> None:
        for k, repeat in enumerate(repeats):
            end = (math.nan, math.nan)
            for direction, part in table[table["repeat"] == repeat].groupby("direction"):
                end = curve(
                    axes, part, ("pressure_kpa", value), nominal_kpa(part), colours[k], k,
                    down=direction == "down",
                )  # fmt: skip
            ends.append((*end, f"{repeat}", colours[k]))
        if line is not None:
            x = np.array([-line.intercept / line.slope, table["pressure_kpa"].max()])
            axes.plot(x, line.at(x), color=QUIET, linewidth=0.9, linestyle="-.")
        directions_legend(axes, "upper left")

    return curves_figure(len(repeats), "pressure (kPa gauge)", label, "repeat", draw)


BLOCKED_FORCE = Analysis(
    "blocked-force",
    "Blocked force test",
    reduce_points,
    lambda parameters: blocked_layout(max_pressure_kpa(parameters)),
    blocked_force_findings,
)
FREE_CONTRACTION = Analysis(
    "free-contraction",
    "Free contraction test",
    partial(reduce_points, extra=EXTRA),
    lambda parameters: free_layout(max_pressure_kpa(parameters)),
    free_contraction_findings,
    ResultColumns(("length_mm",)),
)
ANALYSES = (BLOCKED_FORCE, FREE_CONTRACTION)
