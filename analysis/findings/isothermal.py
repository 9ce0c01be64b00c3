"""What forces at several temperatures say (thesis 4.8.4, Figure 4-15, Equations 4-47 to 4-50)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.findings.findings import Analysis, Findings, Section
from analysis.reduction.points import reduce_points
from analysis.regression.force_lines import line_uncertainty
from analysis.regression.least_squares import straight_line
from daq.calibration import Calibration
from daq.live.layout import LiveLayout

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from analysis.reduction.points import Reduction
    from daq.store.run import Run

REGION_KPA = (150.0, 600.0)
"""Section 4.8.1: over these pressures the force is a straight line in pressure."""

EXTRA = {"set_temperature_c": "float64"}


def isothermal_findings(run: Run, reduction: Reduction) -> Findings:
    """Gradient of force against pressure at each temperature, and how it grows with it."""
    del run
    held = reduction.table[reduction.table["slot"].str.startswith("L")]
    barred = reduction.table[reduction.table["slot"].str.startswith("P")]
    lines = temperature_lines(held, reduction.calibrations)
    growth = temperature_growth(lines)
    sections = []
    if len(held):
        sections.append(
            Section(
                "Force against pressure at each temperature",
                figure=lambda: _figure(held),
                caption="Settled points, one curve a length, one colour and line style a"
                " temperature (the form of the thesis's Figure 4-15). Bars: expanded uncertainty,"
                " k = 2, where larger than the marker.",
            )
        )
    if len(lines):
        sections.append(
            Section(
                "Straight lines at each length and temperature",
                (
                    "Force = gradient · pressure + intercept by least squares,"
                    f" {REGION_KPA[0]:g} to {REGION_KPA[1]:g} kPa (Equation 4-32).",
                ),
                lines,
                (
                    ("length_mm", "length, mm"), ("temperature_c", "temperature, °C"),
                    ("n", "points"), ("gradient", "gradient, N/kPa"),
                    ("intercept", "intercept, N"),
                ),
                caption="± expanded uncertainty, k = 2, from the scatter about the line together"
                " with zero and gain of the calibrations.",
            )
        )  # fmt: skip
    if len(growth):
        sections.append(
            Section(
                "How the gradient changes with temperature",
                (
                    "Gradient against temperature by a straight line (the form of Equation 4-47),"
                    " as a share of the gradient in the middle of the range.",
                ),
                growth,
                (("length_mm", "length, mm"), ("n", "temperatures"), ("growth", "growth, %/K")),
                caption="± expanded uncertainty, k = 2: from the lines' own uncertainties, or the"
                " scatter about the line where that is larger.",
            )
        )
    if len(barred):
        sections.append(
            Section(
                "Force at held pressures",
                (),
                barred_table(barred),
                (
                    ("pressure_kpa", "pressure, kPa"), ("temperature_c", "temperature, °C"),
                    ("length_mm", "length, mm"), ("n", "points"), ("force_n", "force, N"),
                ),
                caption="Mean of the points of one setting; ± expanded uncertainty, k = 2.",
            )
        )  # fmt: skip
    return Findings(
        _headline(reduction.table, growth),
        tuple(sections),
        {"lines": lines.to_dict("records"), "growth": growth.to_dict("records")},
    )


def temperature_lines(
    table: pd.DataFrame, calibrations: Mapping[str, Calibration] = {}
) -> pd.DataFrame:
    """One row a set length and temperature: the line of force against pressure.

    Args:
        table: settled points of held lengths, with ``set_temperature_c``.
        calibrations: by quantity; their zero and gain are in ``u_gradient`` and ``u_intercept``,
            not in ``u_gradient_fit``, as all temperatures share them.
    """
    import pandas as pd

    rows: list[dict[str, Any]] = []
    inside = table[table["set_pressure_kpa"].between(*REGION_KPA)]
    for (length, set_c), part in inside.groupby(["set_length_mm", "set_temperature_c"]):
        part = part.dropna(subset=["pressure_kpa", "force_n"])
        line = straight_line(part["pressure_kpa"], part["force_n"])
        if line is None:
            continue
        u_gradient, u_intercept = line_uncertainty(
            line, part["pressure_kpa"], part["force_n"], calibrations
        )
        rows.append(
            {
                "length_mm": float(str(length)), "set_temperature_c": float(str(set_c)),
                "temperature_c": round(float(part["temperature_c"].mean()), 3), "n": line.n,
                "gradient": line.slope, "u_gradient": u_gradient, "u_gradient_fit": line.u_slope,
                "intercept": line.intercept, "u_intercept": u_intercept,
            }
        )  # fmt: skip
    columns = ["length_mm", "set_temperature_c", "temperature_c", "n", "gradient", "u_gradient",
               "u_gradient_fit", "intercept", "u_intercept"]  # fmt: skip
    return pd.DataFrame(rows, columns=columns)


def temperature_growth(lines: pd.DataFrame) -> pd.DataFrame:
    """One row a length: relative slope of the gradient against temperature, in %/K.

    Its uncertainty is what the gradients' own uncertainties leave, or the scatter about the
    line where three or more temperatures show more.
    """
    import pandas as pd

    rows: list[dict[str, Any]] = []
    for length, part in lines.groupby("length_mm"):
        t = part["temperature_c"].to_numpy(dtype=np.float64)
        line = straight_line(part["temperature_c"], part["gradient"])
        if line is None:
            continue
        spread = t - t.mean()
        own = part["u_gradient_fit"].to_numpy(dtype=np.float64)
        u = float(np.sqrt(((spread * own) ** 2).sum()) / (spread**2).sum())
        if np.isfinite(line.u_slope):
            u = max(u, line.u_slope)
        middle = line.slope * float(t.mean()) + line.intercept
        rows.append(
            {
                "length_mm": float(str(length)), "n": line.n,
                "growth": 100 * line.slope / middle, "u_growth": 100 * u / abs(middle),
            }
        )  # fmt: skip
    return pd.DataFrame(rows, columns=["length_mm", "n", "growth", "u_growth"])


def barred_table(table: pd.DataFrame) -> pd.DataFrame:
    """One row a set pressure, temperature and length: mean force."""
    import pandas as pd

    rows: list[dict[str, Any]] = []
    keys = ["set_pressure_kpa", "set_temperature_c", "set_length_mm"]
    for (pressure, _, length), part in table.groupby(keys):
        noise = float(np.sqrt((part["u_force_n_noise"] ** 2).sum())) / len(part)
        rows.append(
            {
                "pressure_kpa": float(str(pressure)),
                "temperature_c": round(float(part["temperature_c"].mean()), 2),
                "length_mm": float(str(length)), "n": len(part),
                "force_n": float(part["force_n"].mean()),
                "u_force_n": float(np.hypot(noise, part["u_force_n_cal"].mean())),
            }
        )  # fmt: skip
    return pd.DataFrame(rows)


def _headline(table: pd.DataFrame, growth: pd.DataFrame) -> str:
    if not len(table):
        return "No settled point was reached, so there is no result."
    low, high = float(table["temperature_c"].min()), float(table["temperature_c"].max())
    span = f"{low:.1f} to {high:.1f} °C"
    if not len(growth):
        return f"{len(table)} settled points from {span}; too few for lines against temperature."
    beyond = growth[growth["growth"].abs() > 2 * growth["u_growth"]]
    if not len(beyond):
        most = float((growth["growth"].abs() + 2 * growth["u_growth"]).max())
        return (
            f"From {span} the gradient of force against pressure does not change by more than its"
            f" uncertainty: by less than {most:.2g} %/K at every length."
        )
    first, last = float(growth["growth"].min()), float(growth["growth"].max())
    return (
        f"From {span} the gradient of force against pressure changes by {first:.2g} to"
        f" {last:.2g} %/K, beyond its uncertainty at {len(beyond)} of {len(growth)} lengths."
    )


def _figure(table: pd.DataFrame) -> Figure:
    from matplotlib.lines import Line2D

    from analysis.figures.drawing import (
        COVERAGE,
        MARKERS,
        QUIET,
        labels_at_right,
        new_figure,
        sequence,
        style,
    )

    warm = sorted(table["set_temperature_c"].unique())
    colours = sequence(len(warm))
    dashes = ("-", "--", ":", "-.")
    with style():
        figure, axes = new_figure(7.2, 4.9)
        ends: list[tuple[float, float, str, Any]] = []
        for (set_c, length), rows in table.groupby(["set_temperature_c", "set_length_mm"]):
            k = warm.index(set_c)
            axes.errorbar(
                rows["pressure_kpa"], rows["force_n"],
                yerr=COVERAGE * np.nan_to_num(rows["u_force_n"].astype(float)),
                fmt=MARKERS[k % len(MARKERS)], markersize=3.4, color=colours[k], elinewidth=0.7,
            )  # fmt: skip
            mean = rows.groupby("set_pressure_kpa")[["pressure_kpa", "force_n"]].mean()
            axes.plot(
                mean["pressure_kpa"], mean["force_n"], color=colours[k], linewidth=1.0,
                linestyle=dashes[k % len(dashes)],
            )  # fmt: skip
            if k == len(warm) - 1:
                end = (float(mean["pressure_kpa"].iloc[-1]), float(mean["force_n"].iloc[-1]))
                ends.append((*end, f"{float(str(length)):g}", colours[k]))
        axes.axhline(0.0, color=QUIET, linewidth=0.8)
        axes.set_xlabel("pressure (kPa gauge)")
        axes.set_ylabel("force (N)")
        handles = [
            Line2D([], [], color=colours[k], marker=MARKERS[k % len(MARKERS)], markersize=4,
                   ls=dashes[k % len(dashes)], label=f"{t:g} °C")
            for k, t in enumerate(warm)
        ]  # fmt: skip
        axes.legend(handles=handles, ncols=len(warm), loc="lower left", bbox_to_anchor=(0.0, 1.0))
        labels_at_right(axes, ends, "length (mm)")
    return figure


def _reduce(run: Run) -> Reduction:
    """Settled points with the temperature that was asked for at each."""
    return reduce_points(run, extra=EXTRA)


def _layout(parameters: Mapping[str, Any]) -> LiveLayout:
    """Its screen."""
    from analysis.layouts.static import isothermal_layout

    return isothermal_layout(max(parameters.get("pressures_kpa") or [600.0]))


ISOTHERMAL = Analysis("isothermal", "Isothermal test", _reduce, _layout, isothermal_findings)
ANALYSES = (ISOTHERMAL,)
