"""Findings of the switching-time (D-1 to D-3) and switching-voltage (D-4) tests."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.figures.wording import from_to, p_text
from analysis.findings.findings import (
    NO_POINT,
    VALVE_SETTINGS,
    Analysis,
    Findings,
    ResultColumns,
    Section,
    as_in,
    source_table,
)
from analysis.layouts.valve import valve_layout
from analysis.reduction.valve import reduce_switching_time, reduce_switching_voltage
from analysis.regression.least_squares import Line, mean_of_repeats, pooled, straight_line

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from analysis.reduction.points import Reduction
    from daq.store.run import Run

EDGES = tuple((valve, edge) for valve in ("inlet", "outlet") for edge in ("on", "off"))
"""The four edges: valve, and whether it switches on or off."""


@dataclass(frozen=True)
class EdgeLine:
    """Line of one edge against pressure, and the standard uncertainty common to all readings."""

    line: Line
    u_common: float

    @property
    def u_intercept(self) -> float:
        """Standard uncertainty of the value at 0 kPa."""
        return math.hypot(self.line.u_intercept, self.u_common)


EdgeLines = dict[tuple[str, str], EdgeLine]


def time_findings(run: Run, reduction: Reduction) -> Findings:
    """Delays against pressure (Figure 5-21), the form of Tables D-1 to D-3, and their lines."""
    words = (
        "Time from the edge of the command to that of the valve, corrected for propagation delay."
        " The pressure is that upstream of the valve when the command changed."
    )
    extra = (_std_row(reduction.table),) if source_table(run) == "D-1 to D-3" else ()
    return _findings(
        run, reduction, "ms",
        Section(
            "Switching times against pressure",
            (words,),
            figure=lambda: _figure(reduction.table, "ms", "delay (ms)"),
            caption=f"Filled: command on; open: command off{as_in(run, 'Figure 5-21')}."
            " Bars: expanded uncertainty, k = 2. Lines: least squares.",
        ),
        "Switching times: mean of the repeats",
        extra,
    )  # fmt: skip


def voltage_findings(run: Run, reduction: Reduction) -> Findings:
    """Voltages against pressure (Figure 5-17), the form of Table D-4, and their lines."""
    words = (
        "On: the lowest voltage at which a closed valve opens on command, found by bisection. Off:"
        " the highest voltage at which an open valve closes."
    )
    return _findings(
        run, reduction, "v",
        Section(
            "Switching voltages against pressure",
            (words,),
            figure=lambda: _figure(reduction.table, "v", "voltage (V)"),
            caption=f"Filled: turns on; open: turns off{as_in(run, 'Figure 5-17')}."
            " Bars: expanded uncertainty, k = 2. Lines: least squares.",
        ),
        "Switching voltages",
    )  # fmt: skip


def _findings(
    run: Run,
    reduction: Reduction,
    unit: str,
    first: Section,
    title: str,
    extra: tuple[Section, ...] = (),
) -> Findings:
    table = reduction.table
    lines = _lines(table, unit)
    if run.manifest.get("imported"):
        first = Section(first.title, figure=first.figure, caption=first.caption)
    sections = (first, _wide(table, unit, title), _line_section(lines, unit), *extra)
    return Findings(_headline(lines, unit, table), sections, _results(lines, unit))


def _readings(table: pd.DataFrame, valve: str, edge: str, unit: str) -> pd.DataFrame:
    """Readings of one edge: set pressure, x (kPa), y and the uncertainties of y."""
    import pandas as pd

    rows = table[table["valve"] == valve]
    at = "off_pressure_kpa" if edge == "off" and "off_pressure_kpa" in rows else "pressure_kpa"
    y = f"{edge}_{unit}"
    return pd.DataFrame(
        {
            "set_kpa": rows["set_pressure_kpa"].fillna(rows["pressure_kpa"].round(0)),
            "x": rows[at].fillna(rows["pressure_kpa"]),
            "y": rows[y],
            "u": rows[f"u_{y}"],
            "noise": rows[f"u_{y}_noise"],
            "cal": rows[f"u_{y}_cal"],
        }
    ).dropna(subset=["x", "y"])


def _lines(table: pd.DataFrame, unit: str) -> EdgeLines:
    """The line of each edge that has enough readings."""
    lines: EdgeLines = {}
    for each in EDGES:
        rows = _readings(table, *each, unit)
        line = straight_line(rows["x"].to_numpy(), rows["y"].to_numpy())
        if line is not None:
            cal = float(rows["cal"].mean())
            lines[each] = EdgeLine(line, cal if math.isfinite(cal) else 0.0)
    return lines


def _results(lines: EdgeLines, unit: str) -> dict[str, Any]:
    out: dict[str, Any] = {}
    for (valve, edge), found in lines.items():
        name, line = f"{valve}_{edge}_{unit}", found.line
        out[name], out[f"u_{name}"] = line.intercept, found.u_intercept
        out[f"{name}_per_kpa"], out[f"u_{name}_per_kpa"] = line.slope, line.u_slope
        out[f"{name}_scatter"] = line.s
    return out


def _headline(lines: EdgeLines, unit: str, table: pd.DataFrame) -> str:
    if not len(table):
        return NO_POINT
    timed = unit == "ms"
    decimals, shown, verb, at = (1, "ms", "switches", "in") if timed else (2, "V", "turns", "at")
    reached = [p for each in lines for p in _readings(table, *each, unit)["set_kpa"]]
    span = (min(reached, default=0.0), max(reached, default=0.0))
    parts = []
    for valve in ("inlet", "outlet"):
        if (valve, "on") in lines and (valve, "off") in lines:
            on, off = (lines[valve, edge].line for edge in ("on", "off"))
            low, high = span
            ends = [from_to(float(x.at(low)), float(x.at(high)), decimals) for x in (on, off)]
            parts.append(
                f"the {valve} {verb} on {at} {ends[0]} {shown} and off {at} {ends[1]} {shown}"
            )
    if not parts:
        measured = "One point was" if len(table) == 1 else f"{len(table)} points were"
        return f"{measured} measured, too few for a line in pressure."
    return f"From {span[0]:g} to {span[1]:g} kPa {'; '.join(parts)} (from the lines)."


def _pooled(readings: pd.DataFrame) -> tuple[float, int]:
    """Pooled standard deviation of the readings at one set pressure, and degrees of freedom."""
    return pooled([g["y"].to_numpy(dtype=np.float64) for _, g in readings.groupby("set_kpa")])


def _wide(table: pd.DataFrame, unit: str, title: str) -> Section:
    """Means of the repeats with their uncertainty, one row per set pressure."""
    import pandas as pd

    shown = {"ms": "ms", "v": "V"}[unit]
    edges = {each: _readings(table, *each, unit) for each in EDGES}
    pools = {each: _pooled(readings) for each, readings in edges.items()}
    rows = []
    for pressure in sorted({p for r in edges.values() for p in r["set_kpa"]}):
        row: dict[str, Any] = {"pressure_kpa": float(pressure)}
        for each, readings in edges.items():
            here = readings[readings["set_kpa"] == pressure]
            mean, u = mean_of_repeats(here["y"], *pools[each])
            noise = float(np.sqrt((here["noise"] ** 2).sum())) / max(len(here), 1)
            cal = float(here["cal"].mean()) if len(here) else math.nan
            u = math.hypot(max(0.0 if math.isnan(u) else u, noise), 0.0 if math.isnan(cal) else cal)
            name = "_".join((*each, unit))
            row[name], row[f"u_{name}"] = mean, u
        if "air_delay_ms" in table:
            row["air_delay_ms"] = round(float(table["air_delay_ms"].mean()), 3)
        rows.append(row)
    heads = [("_".join((*each, unit)), f"{' '.join(each)}, {shown}") for each in EDGES]
    if "air_delay_ms" in table:
        heads.append(("air_delay_ms", "air delay, ms"))
    scatter = ", ".join(
        f"{valve} {edge} {sd:.3f}" for (valve, edge), (sd, dof) in pools.items() if dof
    )
    words = f"Standard deviation of a single reading at one pressure, {shown}: {scatter}."
    return Section(
        title, (words,) if scatter else (), pd.DataFrame(rows),
        (("pressure_kpa", "pressure, kPa"), *heads),
        caption="± expanded uncertainty, k = 2: repeats, resolution and errors common to all"
        " readings.",
    )  # fmt: skip


def _line_section(lines: EdgeLines, unit: str) -> Section:
    import pandas as pd

    rows = [
        {
            "edge": f"{valve} {edge}",
            "n": found.line.n,
            "intercept": found.line.intercept,
            "u_intercept": found.u_intercept,
            "slope": 1e3 * found.line.slope,
            "u_slope": 1e3 * found.line.u_slope,
            "scatter": round(found.line.s, 3),
            "p": p_text(found.line.p_slope),
        }
        for (valve, edge), found in lines.items()
    ]
    shown = {"ms": "ms", "v": "V"}[unit]
    return Section(
        "Straight lines in pressure",
        ("Least squares over all readings." if rows else "Too few readings for a line.",),
        pd.DataFrame(rows),
        (
            ("edge", "edge"), ("n", "readings"), ("intercept", f"at 0 kPa, {shown}"),
            ("slope", f"slope, {shown}/MPa"), ("scatter", f"scatter, {shown}"),
            ("p", "p of zero slope"),
        ),
        caption="± expanded uncertainty, k = 2, from the scatter about the line; that at 0 kPa"
        " includes errors common to all readings.",
    )  # fmt: skip


def _std_row(table: pd.DataFrame) -> Section:
    """The row "std" under Table D-3, recomputed by the rule that reproduces it."""
    import pandas as pd

    from plant.thesis import load

    printed = load("d03")[0]
    rows = []
    for valve, edge in EDGES:
        readings = _readings(table, valve, edge, "ms")
        again = float(readings["y"].to_numpy(dtype=np.float64).std())
        value = float(str(printed[f"{valve}_{edge}"]))
        rows.append(
            {
                "edge": f"{valve} {edge}",
                "printed": value,
                "recomputed": round(again, 4),
                "within": round(_pooled(readings)[0], 3),
                "same": round(again, 3) == value,
            }
        )
    return Section(
        "Comparison with the thesis: the row std of Table D-3",
        (
            f"{sum(bool(r['same']) for r in rows)} of 4 are the standard deviation of all 39"
            " readings, divided by n. That is the spread over pressures, not the repeatability;"
            " the last column is the scatter at one pressure. By that the on times of the inlet"
            " scatter less than those of the outlet, as section 5.13 states; the printed row"
            " states the opposite.",
        ),
        pd.DataFrame(rows),
        (
            ("edge", "edge"), ("printed", "printed, ms"), ("recomputed", "recomputed, ms"),
            ("within", "at one pressure, ms"), ("same", "same"),
        ),
    )  # fmt: skip


def _figure(table: pd.DataFrame, unit: str, label: str) -> Figure:
    from analysis.figures.drawing import (
        COVERAGE,
        DOUBLE_COLUMN,
        MEASURED,
        SET,
        new_figure,
        style,
    )

    looks = {"inlet": (MEASURED, "o"), "outlet": (SET, "s")}
    lines = _lines(table, unit)
    with style():
        figure, axes = new_figure(DOUBLE_COLUMN, 4.4)
        for valve, edge in EDGES:
            rows = _readings(table, valve, edge, unit)
            filled = edge == "on"
            colour, shape = looks[valve]
            axes.errorbar(
                rows["x"], rows["y"],
                yerr=COVERAGE * np.nan_to_num(rows["u"].to_numpy(dtype=np.float64)),
                fmt=shape, markersize=4 if filled else 5, color=colour,
                markerfacecolor=colour if filled else "white",
                elinewidth=0.7, alpha=0.9, label=f"{valve} {edge}", zorder=3,
            )  # fmt: skip
            if (valve, edge) in lines:
                x = np.array([rows["x"].min(), rows["x"].max()])
                axes.plot(
                    x, lines[valve, edge].line.at(x), color=colour, linewidth=1.2,
                    linestyle="-" if filled else "--",
                )  # fmt: skip
        axes.set_xlabel("pressure upstream of the valve (kPa gauge)")
        axes.set_ylabel(label)
        axes.margins(y=0.12)
        axes.legend(ncols=4, loc="lower center", bbox_to_anchor=(0.5, 1.0), fontsize=8)
    return figure


SWITCHING_TIME = Analysis(
    "switching-time",
    "Switching-time test",
    reduce_switching_time,
    lambda parameters: valve_layout("Switching-time test", parameters),
    time_findings,
    ResultColumns(("on_ms", "off_ms"), VALVE_SETTINGS),
)
SWITCHING_VOLTAGE = Analysis(
    "switching-voltage",
    "Switching-voltage test",
    reduce_switching_voltage,
    lambda parameters: valve_layout("Switching-voltage test", parameters, voltage=True),
    voltage_findings,
    ResultColumns(("on_v", "off_v"), VALVE_SETTINGS),
)
ANALYSES = (SWITCHING_TIME, SWITCHING_VOLTAGE)
