"""Findings of a flow test: air velocity against pressure (Table D-5, Figure 5-22, Equation 5-9).

Two models are fitted: the Fanning form of the thesis, pressure = a + b velocity squared, and the
flow through the valve by ISO 6358, with conductance C and critical pressure ratio.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.figures.wording import decimals_of, fixed, p_text, percent_r2, with_u
from analysis.findings.findings import (
    EXPANDED,
    NO_POINT,
    VALVE_SETTINGS,
    Analysis,
    Findings,
    ResultColumns,
    Section,
    as_in,
    source_table,
)
from analysis.findings.thesis_check import printed_rows, to_printed
from analysis.layouts.valve import valve_layout
from analysis.reduction.valve import reduce_flow
from analysis.regression.least_squares import Line, straight_line
from plant.arrays import Array
from plant.constants import (
    GAS_CONSTANT_J_KG_K,
    REFERENCE_DENSITY_KG_M3,
    REFERENCE_TEMPERATURE_K,
)
from plant.physics.flow import subsonic_factors

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from analysis.reduction.points import Reduction
    from daq.store.run import Run

ATMOSPHERE_KPA = 101.325
U_ATMOSPHERE_KPA = 1.0
U_TEMPERATURE_K = 3.0
"""Standard uncertainty of atmosphere and room temperature, which are not in the record."""
DIGITS = {"coef": 6, "stdev": 6, "t": 2, "p": 3}
"""Decimals of the regression table."""


@dataclass(frozen=True)
class Meter:
    """The air-velocity meter and the conditions that relate velocity to mass flow.

    Attributes:
        bore_mm, u_bore_mm: diameter of the pipe of the meter.
        atmosphere_kpa, temperature_k: of the room.
    """

    bore_mm: float
    u_bore_mm: float = 0.0
    atmosphere_kpa: float = ATMOSPHERE_KPA
    temperature_k: float = REFERENCE_TEMPERATURE_K

    @property
    def velocity_per_conductance(self) -> float:
        """Velocity in m/s per conductance in m3/(s Pa) and upstream pressure in Pa, choked flow."""
        area = math.pi / 4 * (self.bore_mm * 1e-3) ** 2
        density = self.atmosphere_kpa * 1e3 / (GAS_CONSTANT_J_KG_K * self.temperature_k)
        cooling = math.sqrt(REFERENCE_TEMPERATURE_K / self.temperature_k)
        return REFERENCE_DENSITY_KG_M3 * cooling / (density * area)


def flow_share(pressure_kpa: Array, critical: float, atmosphere_kpa: float) -> Array:
    """Upstream absolute pressure in Pa times the subsonic factor of ISO 6358."""
    upstream = pressure_kpa + atmosphere_kpa
    ratio = atmosphere_kpa / np.maximum(upstream, atmosphere_kpa)
    return np.asarray(upstream * 1e3 * subsonic_factors(ratio, critical))


@dataclass(frozen=True)
class IsoFit:
    """Fit of ISO 6358: conductance in m3/(s Pa), critical ratio, scatter in m/s.

    ``u_*`` include the scatter of the readings and the common errors: zero and gain of pressure
    and velocity, bore of the meter, atmosphere and temperature. ``parts`` has each of these.
    """

    conductance: float
    critical: float
    u_conductance: float
    u_critical: float
    scatter: float
    parts: dict[str, tuple[float, float]]


def fit_iso(
    table: pd.DataFrame,
    meter: Meter,
    pressure_u: tuple[float, float] = (0.0, 0.0),
    velocity_u: tuple[float, float] = (0.0, 0.0),
) -> IsoFit | None:
    """Fit C and the critical ratio to velocities.

    Args:
        table: with pressure_kpa, velocity_m_s and their ``u_..._noise``.
        meter: the meter of the velocities.
        pressure_u: standard uncertainty of the pressure zero (kPa) and gain (relative).
        velocity_u: the same of the velocity zero (m/s) and gain (relative).

    Returns:
        None with fewer than four points with flow.
    """
    rows = table.dropna(subset=["pressure_kpa", "velocity_m_s"])
    rows = rows[rows["velocity_m_s"] > 0]
    if len(rows) < 4:
        return None
    p = rows["pressure_kpa"].to_numpy(dtype=np.float64)
    v = rows["velocity_m_s"].to_numpy(dtype=np.float64)
    u_p = np.nan_to_num(rows["u_pressure_kpa_noise"].to_numpy(dtype=np.float64))
    u_v = np.nan_to_num(rows["u_velocity_m_s_noise"].to_numpy(dtype=np.float64))
    best, cov, scatter = _solve(p, v, u_p, u_v, meter)
    noise = np.sqrt(np.diag(cov))
    air, warm = meter.atmosphere_kpa + U_ATMOSPHERE_KPA, meter.temperature_k + U_TEMPERATURE_K
    changed = {
        "pressure zero": (p + pressure_u[0], v, meter),
        "pressure gain": (p * (1 + pressure_u[1]), v, meter),
        "velocity zero": (p, v + velocity_u[0], meter),
        "velocity gain": (p, v * (1 + velocity_u[1]), meter),
        "bore": (p, v, replace(meter, bore_mm=meter.bore_mm + meter.u_bore_mm)),
        "atmosphere": (p, v, replace(meter, atmosphere_kpa=air)),
        "temperature": (p, v, replace(meter, temperature_k=warm)),
    }
    parts = {"scatter": (float(noise[0]), float(noise[1]))}
    for name, (p_1, v_1, meter_1) in changed.items():
        moved, _, _ = _solve(p_1, v_1, u_p, u_v, meter_1)
        parts[name] = (float(abs(moved[0] - best[0])), float(abs(moved[1] - best[1])))
    u = np.sqrt(np.sum(np.array(list(parts.values())) ** 2, axis=0))
    return IsoFit(float(best[0]), float(best[1]), float(u[0]), float(u[1]), scatter, parts)


def _solve(p: Array, v: Array, u_p: Array, u_v: Array, meter: Meter) -> tuple[Array, Array, float]:
    """(C, critical ratio), their covariance from the scatter, and the scatter in m/s."""
    from scipy.optimize import least_squares

    k = meter.velocity_per_conductance

    def model(x: Array) -> Array:
        return np.asarray(x[0] * 1e-9 * k * flow_share(p, float(x[1]), meter.atmosphere_kpa))

    top = float(v.max()) / (k * (float(p.max()) + meter.atmosphere_kpa) * 1e3) * 1e9
    slope = np.abs(np.gradient(v, p)) if len(np.unique(p)) == len(p) else np.zeros_like(p)
    floor = 1e-3 * float(v.max())
    sigma = np.sqrt(u_v**2 + (slope * u_p) ** 2 + floor**2)
    found = least_squares(
        lambda x: (model(x) - v) / sigma, [top, 0.4], bounds=([1e-9, 0.0], [np.inf, 0.95])
    )
    chi2 = float(2 * found.cost) / max(len(p) - 2, 1)
    covariance = np.linalg.pinv(found.jac.T @ found.jac) * max(chi2, 1.0)
    scale = np.array([1e-9, 1.0])
    residual = model(found.x) - v
    scatter = float(np.sqrt((residual**2).sum() / max(len(p) - 2, 1)))
    return np.asarray(found.x * scale), np.asarray(covariance * np.outer(scale, scale)), scatter


def flow_findings(run: Run, reduction: Reduction) -> Findings:
    """Velocity against pressure and both models."""
    table = reduction.table
    pressure, velocity = _columns(table)
    fanning = straight_line(velocity**2, pressure)
    meter = _meter(run)
    iso = None
    if meter is not None:
        cal = reduction.calibrations
        iso = fit_iso(
            table, meter, _zero_gain(cal.get("pressure_kpa")), _zero_gain(cal.get("velocity_m_s"))
        )
    sections = [
        Section(
            "Air velocity against pressure",
            figure=lambda: _figure(table, fanning, iso, meter),
            caption=f"Measured velocity and fits{as_in(run, 'Figure 5-22')}. Bars: expanded"
            " uncertainty, k = 2.",
        )
    ]
    data: dict[str, Any] = {}
    if fanning is not None:
        data |= {
            "fanning_constant_kpa": fanning.intercept,
            "u_fanning_constant_kpa": fanning.u_intercept,
            "fanning_coefficient": fanning.slope,
            "u_fanning_coefficient": fanning.u_slope,
            "fanning_s_kpa": fanning.s,
            "fanning_r2": fanning.r2,
        }
        sections.append(_fanning_section(run, fanning))
    if iso is not None and meter is not None:
        data |= {
            "conductance_m3_s_pa": iso.conductance,
            "u_conductance_m3_s_pa": iso.u_conductance,
            "critical_ratio": iso.critical,
            "u_critical_ratio": iso.u_critical,
            "bore_mm": meter.bore_mm,
        }
        sections.append(_iso_section(iso, fanning, table))
    else:
        sections.append(_shape_section(table, fanning))
    columns = (
        ("order", "order"), ("repeat", "repeat"), ("pressure_kpa", "pressure, kPa"),
        ("velocity_m_s", "air velocity, m/s"), ("settled", "settled"),
    )  # fmt: skip
    sections.append(
        Section("All points", table=table, columns=columns,
                caption=f"{EXPANDED}. table.csv has more digits.")
    )  # fmt: skip
    return Findings(_headline(fanning, iso, len(table)), tuple(sections), data)


def _columns(table: pd.DataFrame) -> tuple[Array, Array]:
    """Pressure in kPa and velocity in m/s."""
    pressure, velocity = (
        table[name].to_numpy(dtype=np.float64) for name in ("pressure_kpa", "velocity_m_s")
    )
    return pressure, velocity


def _fanning_velocity(line: Line, pressure: Array) -> Array:
    """Velocity of the Fanning form."""
    return np.asarray(np.sqrt(np.maximum((pressure - line.intercept) / line.slope, 0.0)))


def _fanning_rms(line: Line, table: pd.DataFrame, mean: Callable[[Array], Any]) -> float:
    """Rms residual of the velocities of the Fanning form, in m/s."""
    pressure, velocity = _columns(table)
    return float(np.sqrt(mean((_fanning_velocity(line, pressure) - velocity) ** 2)))


def _meter(run: Run) -> Meter | None:
    flow = run.manifest.get("parameters") or {}
    if not flow.get("bore_mm"):
        return None
    conditions = run.manifest.get("conditions") or {}
    kelvin = float(conditions.get("temperature_c", REFERENCE_TEMPERATURE_K - 273.15)) + 273.15
    return Meter(float(flow["bore_mm"]), float(flow.get("u_bore_mm", 0.0)), temperature_k=kelvin)


def _zero_gain(calibration: Any) -> tuple[float, float]:
    return (0.0, 0.0) if calibration is None else (calibration.u_offset, calibration.u_gain)


def _headline(fanning: Line | None, iso: IsoFit | None, points: int) -> str:
    if not points:
        return NO_POINT
    if iso is not None:
        return (
            "Flow of the valve by ISO 6358: C ="
            f" {with_u(1e9 * iso.conductance, 1e9 * iso.u_conductance)} · 10⁻⁹ m³/(s Pa), critical"
            f" pressure ratio {with_u(iso.critical, iso.u_critical)} (k = 2)."
        )
    if fanning is None:
        return f"{points} points were measured, too few for a fit."
    return (
        f"Pressure = {fanning.intercept:.2f} + {fanning.slope:.4f} V² (kPa, m/s) through"
        f" {fanning.n} points, R² {percent_r2(fanning.r2)}."
    ).replace("= -", "= −")


def _fanning_section(run: Run, line: Line) -> Section:
    """Coefficients as Full-regression D-1 prints them, compared with it for an import of D-5."""
    import pandas as pd

    frame = pd.DataFrame(
        [
            ("constant, kPa", line.intercept, line.u_intercept, line.t_intercept, line.p_intercept),
            ("V², kPa/(m/s)²", line.slope, line.u_slope, line.t_slope, line.p_slope),
        ],
        columns=["predictor", *DIGITS],
    )
    words = [
        "Pressure = a + b V² by least squares, the Fanning form:"
        f" s = {line.s:.2f} kPa, R² {percent_r2(line.r2)}, adjusted"
        f" {percent_r2(line.r2_adjusted)}."
    ]
    own = source_table(run) is None  # a table of the thesis is shown with the digits printed in it
    columns = [
        ("predictor", "predictor"), ("estimate" if own else "coef", "coefficient"),
        ("error" if own else "stdev", "standard error"),
        ("t", "t"), ("p_words", "p value"),
    ]  # fmt: skip
    if source_table(run) == "D-5":
        words += _compare_d1(line, frame)
        columns += [
            ("coef_printed", "printed coefficient"), ("stdev_printed", "printed error"),
            ("t_printed", "printed t"), ("p_printed", "printed p"), ("same", "same"),
        ]  # fmt: skip
    digits = [decimals_of(u) if u > 0.0 else 4 for u in frame["stdev"]]
    for name, column in (("estimate", "coef"), ("error", "stdev")):
        frame[name] = [fixed(v, d) for v, d in zip(frame[column], digits, strict=True)]
    frame["p_words"] = [p_text(p) for p in frame["p"]]
    return Section("Fanning form", tuple(words), frame.round(DIGITS),
                   tuple(columns))  # fmt: skip


def _compare_d1(line: Line, frame: pd.DataFrame) -> list[str]:
    """Add the digits of Full-regression D-1 to the frame; returns the comparison in words."""

    def printed(name: str) -> list[dict[str, str]]:
        return [row for row in printed_rows(name) if "D-1" in row.values()]

    coefficients = printed("full_regressions")
    for key in DIGITS:
        frame[f"{key}_printed"] = [row[key] for row in coefficients]
    frame["same"] = [
        all(to_printed(own[key], row[key]) == row[key] for key in DIGITS)
        for own, row in zip(frame.to_dict("records"), coefficients, strict=True)
    ]
    anova = {row["source"]: row for row in printed("full_regressions_anova")}
    s, r2 = coefficients[0]["s"], coefficients[0]["r2"]
    same = (
        f"{line.s:.2f}" == s and f"{100 * line.r2:.1f}" == r2,
        f"{line.ss_regression:.0f}" == anova["Regression"]["ss"],
        f"{line.ss_error:.0f}" == anova["Error"]["ss"],
        f"{line.f:.2f}" == anova["Regression"]["f"],
    )
    return [
        f"Comparison with Full-regression D-1: s and R² ({s}, {r2} %)"
        f" {'agree' if same[0] else 'do not agree'}; sum of squares of the regression"
        f" {line.ss_regression:.0f} (printed {anova['Regression']['ss']}), of the error"
        f" {line.ss_error:.0f} ({anova['Error']['ss']}), F {line.f:.2f}"
        f" ({anova['Regression']['f']})." + ("" if all(same) else " Rows that differ are shaded."),
        f"The constant is not significant (p = {line.p_intercept:.3f}); with it Equation 5-9 gives"
        " a pressure below zero for still air.",
    ]


def _iso_section(iso: IsoFit, fanning: Line | None, table: pd.DataFrame) -> Section:
    import pandas as pd

    rows = [
        {"source": name, "c": 100 * c / iso.conductance, "r": r}
        for name, (c, r) in iso.parts.items()
    ]
    rows.append(
        {"source": "combined", "c": 100 * iso.u_conductance / iso.conductance, "r": iso.u_critical}
    )
    frame = pd.DataFrame(rows)
    frame["c"], frame["r"] = frame["c"].round(2), frame["r"].round(4)
    words = [
        f"C = {with_u(1e9 * iso.conductance, 1e9 * iso.u_conductance)} · 10⁻⁹ m³/(s Pa), critical"
        f" pressure ratio {with_u(iso.critical, iso.u_critical)} (k = 2), scatter"
        f" {iso.scatter:.2f} m/s. The table has the standard uncertainty from each source."
    ]
    if fanning is not None:
        words.append(
            "The rms residual of the Fanning form is"
            f" {_fanning_rms(fanning, table, np.nanmean):.2f} m/s: choked flow is proportional to"
            " the absolute pressure, not to the square root of the gauge pressure."
        )
    return Section(
        "ISO 6358", tuple(words), frame,
        (("source", "source"), ("c", "u of C, %"), ("r", "u of the critical ratio")),
    )  # fmt: skip


def _shape_section(table: pd.DataFrame, fanning: Line | None) -> Section:
    """Without a bore only the shape of the ISO 6358 curve can be compared with the data."""
    meter = Meter(bore_mm=4.0)
    iso = fit_iso(table, meter)
    if iso is None or fanning is None:
        return Section("ISO 6358", ("Too few points.",))
    return Section(
        "ISO 6358",
        (
            "The bore of the meter is not known, so the conductance cannot be determined. The curve"
            f" with a free scale has a residual of {iso.scatter:.1f} m/s at a critical ratio of"
            f" {iso.critical:.2f}; the Fanning form has"
            f" {_fanning_rms(fanning, table, np.mean):.1f} m/s. Choked flow is proportional to the"
            " absolute pressure, these velocities to its square root: the measurement includes"
            " more than one small orifice (the line, the meter).",
        ),
    )


def _figure(
    table: pd.DataFrame, fanning: Line | None, iso: IsoFit | None, meter: Meter | None
) -> Figure:
    from analysis.figures.drawing import (
        COVERAGE,
        DOUBLE_COLUMN,
        INK,
        MEASURED,
        SET,
        new_figure,
        style,
    )

    rows = table.dropna(subset=["pressure_kpa", "velocity_m_s"])
    with style():
        figure, axes = new_figure(DOUBLE_COLUMN, 4.2)
        axes.errorbar(
            rows["pressure_kpa"], rows["velocity_m_s"],
            xerr=COVERAGE * np.nan_to_num(rows["u_pressure_kpa"]),
            yerr=COVERAGE * np.nan_to_num(rows["u_velocity_m_s"]),
            fmt="o", markersize=4, color=MEASURED, elinewidth=0.7, label="measured", zorder=3,
        )  # fmt: skip
        if len(rows):
            p = np.linspace(0.0, float(rows["pressure_kpa"].max()), 200)
            if fanning is not None:
                v = _fanning_velocity(fanning, p)
                axes.plot(p, v, color=SET, linestyle="--", label="P = a + b V²")
            if iso is not None and meter is not None:
                k = meter.velocity_per_conductance * iso.conductance
                axes.plot(
                    p, k * flow_share(p, iso.critical, meter.atmosphere_kpa), color=INK,
                    linewidth=1.2, label="ISO 6358",
                )  # fmt: skip
        axes.set_xlabel("pressure upstream of the valve (kPa gauge)")
        axes.set_ylabel("air velocity (m/s)")
        axes.legend(loc="lower right")
    return figure


FLOW = Analysis(
    "flow",
    "Flow test",
    reduce_flow,
    lambda parameters: valve_layout("Flow test", parameters, flow=True),
    flow_findings,
    ResultColumns(("velocity_m_s",), VALVE_SETTINGS),
)
ANALYSES = (FLOW,)
