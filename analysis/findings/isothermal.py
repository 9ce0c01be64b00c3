"""Findings of an isothermal test (thesis 4.8.4, Figure 4-15, Equations 4-47 to 4-50)."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.figures.wording import significant
from analysis.findings.findings import (
    BARS,
    EXPANDED,
    NO_SETTLED_POINT,
    Analysis,
    Findings,
    Section,
    as_in,
    max_pressure_kpa,
)
from analysis.layouts.static import isothermal_layout
from analysis.reduction.points import Reduction, reduce_points
from analysis.regression.force_lines import line_uncertainty
from analysis.regression.least_squares import straight_line
from daq.calibration import Calibration

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from daq.store.run import Run

REGION_KPA = (150.0, 600.0)
"""Section 4.8.1: in this region the force is linear in pressure."""

EXTRA = {"set_temperature_c": "float64"}
LINE_COLUMNS = (
    "length_mm", "set_temperature_c", "temperature_c", "n", "gradient", "u_gradient",
    "u_gradient_fit", "intercept", "u_intercept",
)  # fmt: skip


def isothermal_findings(run: Run, reduction: Reduction) -> Findings:
    """Gradient of force against pressure at each temperature, and its change with temperature."""
    at_length = reduction.table[reduction.table["slot"].str.startswith("L")]
    at_pressure = reduction.table[reduction.table["slot"].str.startswith("P")]
    lines = temperature_lines(at_length, reduction.calibrations)
    growth = temperature_growth(lines)
    sections = [
        Section(
            "Force against pressure at each temperature",
            figure=(lambda: _figure(at_length)) if len(at_length) else None,
            caption="Settled points, one curve per length, one colour and line style per"
            f" temperature{as_in(run, 'Figure 4-15')}. {BARS}",
        ),
        Section(
            "Straight lines at each length and temperature",
            (
                "Force = gradient · pressure + intercept by least squares,"
                f" {REGION_KPA[0]:g} to {REGION_KPA[1]:g} kPa.",
            ),
            lines,
            (
                ("length_mm", "length, mm"), ("temperature_c", "temperature, °C"),
                ("n", "points"), ("gradient", "gradient, N/kPa"),
                ("intercept", "intercept, N"),
            ),
            caption=f"{EXPANDED}, from the scatter about the line and from zero and gain of the"
            " calibrations.",
        ),
        Section(
            "Change of the gradient with temperature",
            (
                "Slope of a straight line through gradient against temperature,"
                " relative to the gradient in the middle of the range.",
            ),
            growth,
            (("length_mm", "length, mm"), ("n", "temperatures"), ("growth", "growth, %/K")),
            caption=f"{EXPANDED}: from the uncertainties of the gradients, or the scatter about"
            " the line if that is larger.",
        ),
        Section(
            "Force at held pressures",
            (),
            force_at_pressure(at_pressure),
            (
                ("pressure_kpa", "pressure, kPa"), ("temperature_c", "temperature, °C"),
                ("length_mm", "length, mm"), ("n", "points"), ("force_n", "force, N"),
            ),
            caption=f"Mean of the points of one setting; {EXPANDED}.",
        ),
    ]  # fmt: skip
    filled = [s for s in sections if s.figure or (s.table is not None and len(s.table))]
    return Findings(
        isothermal_headline(reduction.table, growth),
        tuple(filled),
        {"lines": lines.to_dict("records"), "growth": growth.to_dict("records")},
    )


def temperature_lines(
    table: pd.DataFrame, calibrations: Mapping[str, Calibration] = {}
) -> pd.DataFrame:
    """The line of force against pressure, one row per set length and temperature.

    Args:
        table: settled points at held lengths, with ``set_temperature_c``.
        calibrations: by quantity. ``u_gradient`` and ``u_intercept`` include their zero and
            gain; ``u_gradient_fit`` does not, because they are common to all temperatures.
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
    return pd.DataFrame(rows, columns=list(LINE_COLUMNS))


def temperature_growth(lines: pd.DataFrame) -> pd.DataFrame:
    """Relative slope of the gradient against temperature in %/K, one row per length.

    The uncertainty is that from the gradients, or from the scatter about the line if that is
    larger (with three or more temperatures).
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


def force_at_pressure(table: pd.DataFrame) -> pd.DataFrame:
    """Mean force, one row per set pressure, temperature and length."""
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


def isothermal_headline(table: pd.DataFrame, growth: pd.DataFrame) -> str:
    """What the gradient does with temperature, in one sentence."""
    if not len(table):
        return NO_SETTLED_POINT
    low, high = float(table["temperature_c"].min()), float(table["temperature_c"].max())
    span = f"{low:.1f} to {high:.1f} °C"
    if not len(growth):
        return f"{len(table)} settled points from {span}; too few for lines against temperature."
    changed = growth[growth["growth"].abs() > 2 * growth["u_growth"]]
    if not len(changed):
        most = float((growth["growth"].abs() + 2 * growth["u_growth"]).max())
        return (
            f"From {span} the gradient of force against pressure does not change by more than its"
            f" uncertainty: by less than {most:.2g} %/K at every length."
        )
    first, last = float(growth["growth"].min()), float(growth["growth"].max())
    return (
        f"From {span} the gradient of force against pressure changes by {significant(first, 2)} to"
        f" {significant(last, 2)} %/K, more than its uncertainty at {len(changed)} of {len(growth)}"
        " lengths."
    )


def _figure(table: pd.DataFrame) -> Figure:
    from matplotlib.lines import Line2D

    from analysis.figures.drawing import DASHES, CurveEnds, curve, curves_figure, marker

    warm = sorted(table["set_temperature_c"].unique())

    def draw(axes: Any, colours: list[Any], ends: CurveEnds) -> None:
        for (set_c, length), rows in table.groupby(["set_temperature_c", "set_length_mm"]):
            k = warm.index(set_c)
            end = curve(
                axes, rows, ("pressure_kpa", "force_n"), rows["set_pressure_kpa"], colours[k], k,
                linestyle=DASHES[k % len(DASHES)],
            )  # fmt: skip
            if k == len(warm) - 1:
                ends.append((*end, f"{float(str(length)):g}", colours[k]))
        handles = [
            Line2D([], [], color=colours[k], marker=marker(k), markersize=4,
                   ls=DASHES[k % len(DASHES)], label=f"{t:g} °C")
            for k, t in enumerate(warm)
        ]  # fmt: skip
        axes.legend(handles=handles, ncols=len(warm), loc="lower left", bbox_to_anchor=(0.0, 1.0))

    return curves_figure(len(warm), "pressure (kPa gauge)", "force (N)", "length (mm)", draw)


ISOTHERMAL = Analysis(
    "isothermal",
    "Isothermal test",
    partial(reduce_points, extra=EXTRA),
    lambda parameters: isothermal_layout(max_pressure_kpa(parameters)),
    isothermal_findings,
)
ANALYSES = (ISOTHERMAL,)
