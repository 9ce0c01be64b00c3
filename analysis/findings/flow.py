"""What a table of air velocity against pressure says (Table D-5, Figure 5-22, Equation 5-9).

Two forms are fitted: the thesis's Fanning form, pressure = a + b velocity squared, and the flow
of ISO 6358 through the valve, with its conductance C and critical pressure ratio.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from analysis.findings.findings import Analysis, Findings, Section
from analysis.layouts.valve import valve_layout
from analysis.reduction.valve import reduce_flow
from analysis.regression.least_squares import Line, straight_line
from daq.live.layout import LiveLayout

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from analysis.reduction.points import Reduction
    from daq.store.run import Run

Floats = npt.NDArray[np.float64]
GAS_J_KG_K = 287.05
DENSITY_0 = 1.185
TEMPERATURE_0 = 293.15
"""Gas constant of air, and the reference density and temperature of ISO 6358."""
ATMOSPHERE_KPA = 101.325
U_ATMOSPHERE_KPA = 1.0
U_TEMPERATURE_K = 3.0
"""Where the record knows no better: weather and room."""


@dataclass(frozen=True)
class Meter:
    """What turns a velocity into a flow of mass.

    Attributes:
        bore_mm, u_bore_mm: diameter of the pipe that the meter sits in.
        atmosphere_kpa, temperature_k: of the room.
    """

    bore_mm: float
    u_bore_mm: float = 0.0
    atmosphere_kpa: float = ATMOSPHERE_KPA
    temperature_k: float = TEMPERATURE_0

    @property
    def velocity_per_conductance(self) -> float:
        """m/s for each m3/(s Pa) of conductance and Pa of upstream pressure, choked."""
        area = math.pi / 4 * (self.bore_mm * 1e-3) ** 2
        density = self.atmosphere_kpa * 1e3 / (GAS_J_KG_K * self.temperature_k)
        return DENSITY_0 * math.sqrt(TEMPERATURE_0 / self.temperature_k) / (density * area)


def flow_share(pressure_kpa: Floats, critical: float, atmosphere_kpa: float) -> Floats:
    """Upstream absolute pressure in Pa times ISO 6358's share of the choked flow."""
    upstream = pressure_kpa + atmosphere_kpa
    ratio = np.clip(atmosphere_kpa / np.maximum(upstream, atmosphere_kpa), critical, 1.0)
    share = 1.0 - ((ratio - critical) / (1.0 - critical)) ** 2
    return np.asarray(upstream * 1e3 * np.sqrt(np.maximum(share, 0.0)))


@dataclass(frozen=True)
class IsoFit:
    """ISO 6358 through a table: conductance in m3/(s Pa), critical ratio, scatter in m/s.

    ``u_*`` hold the scatter of the readings and, common to all of them, pressure zero and gain,
    the meter's gain, its bore, and the room.
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
        meter: what the velocity was read in.
        pressure_u: standard uncertainty of the pressure's zero (kPa) and gain (relative).
        velocity_u: of the velocity's zero (m/s) and gain (relative).

    Returns:
        None with fewer than four points that flow.
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


def _solve(
    p: Floats, v: Floats, u_p: Floats, u_v: Floats, meter: Meter
) -> tuple[Floats, Floats, float]:
    """(C, critical ratio), their covariance from the scatter, and that scatter in m/s."""
    from scipy.optimize import least_squares

    k = meter.velocity_per_conductance

    def model(x: Floats) -> Floats:
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
    """Velocity against pressure and both forms."""
    table = reduction.table
    velocity = table["velocity_m_s"].to_numpy(dtype=np.float64)
    pressure = table["pressure_kpa"].to_numpy(dtype=np.float64)
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
            caption="The form of the thesis's Figure 5-22. Bars: expanded uncertainty, k = 2.",
        )
    ]
    data: dict[str, Any] = {}
    if fanning is not None:
        data |= _fanning_data(fanning)
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
        Section("All points: the form of Table D-5", table=table, columns=columns,
                caption="± expanded uncertainty, k = 2. The same with more digits: table.csv.")
    )  # fmt: skip
    return Findings(_headline(fanning, iso, len(table)), tuple(sections), data)


def _meter(run: Run) -> Meter | None:
    flow = run.manifest.get("parameters") or {}
    if not flow.get("bore_mm"):
        return None
    conditions = run.manifest.get("conditions") or {}
    kelvin = float(conditions.get("temperature_c", TEMPERATURE_0 - 273.15)) + 273.15
    return Meter(float(flow["bore_mm"]), float(flow.get("u_bore_mm", 0.0)), temperature_k=kelvin)


def _zero_gain(calibration: Any) -> tuple[float, float]:
    return (0.0, 0.0) if calibration is None else (calibration.u_offset, calibration.u_gain)


def _fanning_data(line: Line) -> dict[str, Any]:
    return {
        "fanning_constant_kpa": line.intercept,
        "u_fanning_constant_kpa": line.u_intercept,
        "fanning_coefficient": line.slope,
        "u_fanning_coefficient": line.u_slope,
        "fanning_s_kpa": line.s,
        "fanning_r2": line.r2,
    }


def _headline(fanning: Line | None, iso: IsoFit | None, points: int) -> str:
    if not points:
        return "No point was measured, so there is no result."
    if iso is not None:
        return (
            f"The valve passes air as ISO 6358 with C = {iso.conductance * 1e9:.3f} ±"
            f" {2e9 * iso.u_conductance:.3f} · 10⁻⁹ m³/(s Pa) and a critical pressure ratio of"
            f" {iso.critical:.3f} ± {2 * iso.u_critical:.3f} (k = 2)."
        )
    if fanning is None:
        return f"{points} points were measured, too few for a law."
    return (
        f"Pressure = {fanning.intercept:.2f} + {fanning.slope:.4f} V² (kPa, m/s) through"
        f" {fanning.n} points, R² {100 * fanning.r2:.1f} %."
    ).replace("= -", "= −")


def _fanning_section(run: Run, line: Line) -> Section:
    """Coefficients as Full-regression D-1 prints them, and beside it for an import of D-5."""
    import pandas as pd

    got = [
        ("constant, kPa", line.intercept, line.u_intercept, line.t_intercept, line.p_intercept),
        ("V², kPa/(m/s)²", line.slope, line.u_slope, line.t_slope, line.p_slope),
    ]
    digits = {"coef": 6, "stdev": 6, "t": 2, "p": 3}
    rows = [dict(zip(("predictor", "coef", "stdev", "t", "p"), r, strict=True)) for r in got]
    words = [
        "Pressure = a + b V² by least squares, the optimised Fanning form of Equation 5-9:"
        f" s = {line.s:.2f} kPa, R² = {100 * line.r2:.1f} %, adjusted"
        f" {100 * line.r2_adjusted:.1f} %."
    ]
    columns = [
        ("predictor", "predictor"), ("coef", "coefficient"), ("stdev", "standard error"),
        ("t", "t"), ("p", "p of no effect"),
    ]  # fmt: skip
    if (run.manifest.get("source") or {}).get("table") == "D-5":
        rows, words = _against_printed(line, rows, words, digits)
        columns += [
            ("coef_printed", "printed coefficient"), ("stdev_printed", "printed error"),
            ("t_printed", "printed t"), ("p_printed", "printed p"), ("same", "same"),
        ]  # fmt: skip
    frame = pd.DataFrame(rows)
    for key, places in digits.items():
        frame[key] = frame[key].round(places)
    return Section("The thesis's form (Equation 5-9)", tuple(words), frame, tuple(columns))


def _against_printed(
    line: Line, rows: list[dict[str, Any]], words: list[str], digits: dict[str, int]
) -> tuple[list[dict[str, Any]], list[str]]:
    """Full-regression D-1 digit by digit."""
    import csv
    from importlib import resources

    folder = resources.files("plant.data")

    def printed(name: str) -> list[dict[str, str]]:
        text = folder.joinpath(f"{name}.csv").read_text(encoding="utf-8")
        every = csv.DictReader(text.splitlines())
        return [row for row in every if "D-1" in row.values()]

    del digits
    coefficients = printed("full_regressions")
    for row, said in zip(rows, coefficients, strict=True):
        same = True
        for key in ("coef", "stdev", "t", "p"):
            row[f"{key}_printed"] = said[key]
            decimals = len(said[key].partition(".")[2])
            same &= f"{row[key]:.{decimals}f}" == said[key]
        row["same"] = same
    anova = {row["source"]: row for row in printed("full_regressions_anova")}
    said_s, said_r2 = coefficients[0]["s"], coefficients[0]["r2"]
    again = (
        f"{line.s:.2f}" == said_s and f"{100 * line.r2:.1f}" == said_r2,
        f"{line.ss_regression:.0f}" == anova["Regression"]["ss"],
        f"{line.ss_error:.0f}" == anova["Error"]["ss"],
        f"{line.f:.2f}" == anova["Regression"]["f"],
    )
    words.append(
        f"Beside Full-regression D-1: s and R² ({said_s}, {said_r2} %)"
        f" {'agree' if again[0] else 'do not agree'}; sum of squares of the regression"
        f" {line.ss_regression:.0f} (printed {anova['Regression']['ss']}), of the error"
        f" {line.ss_error:.0f} ({anova['Error']['ss']}), F {line.f:.2f}"
        f" ({anova['Regression']['f']})."
        + ("" if all(again) else " What differs is shaded or said here.")
    )
    words.append(
        f"The constant is no effect to speak of (p = {line.p_intercept:.3f}); with it Equation"
        " 5-9 gives a pressure below zero for still air."
    )
    return rows, words


def _iso_section(iso: IsoFit, fanning: Line | None, table: pd.DataFrame) -> Section:
    import pandas as pd

    rows = [
        {"source": name, "c": 100 * c / iso.conductance, "r": r}
        for name, (c, r) in iso.parts.items()
    ]
    rows.append(
        {"source": "together", "c": 100 * iso.u_conductance / iso.conductance, "r": iso.u_critical}
    )
    frame = pd.DataFrame(rows)
    frame["c"], frame["r"] = frame["c"].round(3), frame["r"].round(4)
    words = [
        f"C = {iso.conductance * 1e9:.4f} · 10⁻⁹ m³/(s Pa), critical pressure ratio"
        f" {iso.critical:.4f}, scatter {iso.scatter:.2f} m/s. Below, what each source leaves"
        " unknown (standard uncertainty)."
    ]
    if fanning is not None:
        v = table["velocity_m_s"].to_numpy(dtype=np.float64)
        p = table["pressure_kpa"].to_numpy(dtype=np.float64)
        guess = np.sqrt(np.maximum((p - fanning.intercept) / fanning.slope, 0.0))
        rms = float(np.sqrt(np.nanmean((guess - v) ** 2)))
        words.append(
            f"The Fanning form misses the velocities by {rms:.2f} m/s rms: where flow is choked it"
            " grows in proportion to absolute pressure, not with the root of the gauge pressure."
        )
    return Section(
        "ISO 6358", tuple(words), frame,
        (("source", "source"), ("c", "of C, %"), ("r", "of the ratio")),
    )  # fmt: skip


def _shape_section(table: pd.DataFrame, fanning: Line | None) -> Section:
    """Without a bore only the shape of ISO 6358 can be held against the data."""
    meter = Meter(bore_mm=4.0)
    iso = fit_iso(table, meter)
    if iso is None or fanning is None:
        return Section("ISO 6358", ("Too few points.",))
    v = table["velocity_m_s"].to_numpy(dtype=np.float64)
    p = table["pressure_kpa"].to_numpy(dtype=np.float64)
    guess = np.sqrt(np.maximum((p - fanning.intercept) / fanning.slope, 0.0))
    rms = float(np.sqrt(np.mean((guess - v) ** 2)))
    return Section(
        "ISO 6358",
        (
            "The bore in which the velocity was read is not known, so that no conductance can be"
            f" had. Its shape, scaled at will, leaves {iso.scatter:.1f} m/s with a critical ratio"
            f" of {iso.critical:.2f}; the Fanning form leaves {rms:.1f} m/s. Choked flow grows in"
            " proportion to absolute pressure, these velocities with its root: what was measured"
            " was more than one small orifice (the line, the meter).",
        ),
    )


def _figure(
    table: pd.DataFrame, fanning: Line | None, iso: IsoFit | None, meter: Meter | None
) -> Figure:
    from analysis.figures.drawing import COVERAGE, INK, MEASURED, SET, new_figure, style

    rows = table.dropna(subset=["pressure_kpa", "velocity_m_s"])
    with style():
        figure, axes = new_figure(7.2, 4.2)
        axes.errorbar(
            rows["pressure_kpa"], rows["velocity_m_s"],
            xerr=COVERAGE * np.nan_to_num(rows["u_pressure_kpa"]),
            yerr=COVERAGE * np.nan_to_num(rows["u_velocity_m_s"]),
            fmt="o", markersize=4, color=MEASURED, elinewidth=0.7, label="measured", zorder=3,
        )  # fmt: skip
        if len(rows):
            p = np.linspace(0.0, float(rows["pressure_kpa"].max()), 200)
            if fanning is not None:
                v = np.sqrt(np.maximum((p - fanning.intercept) / fanning.slope, 0.0))
                axes.plot(p, v, color=SET, linestyle="--", label="P = a + b V² (Equation 5-9)")
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


def _layout(parameters: Mapping[str, Any]) -> LiveLayout:
    """Its screen."""
    return valve_layout("Flow test", parameters, flow=True)


FLOW = Analysis("flow", "Flow test", reduce_flow, _layout, flow_findings)
ANALYSES = (FLOW,)
