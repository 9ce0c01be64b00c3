"""What a table of switching times (D-1 to D-3) or switching voltages (D-4) says."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.findings.findings import Analysis, Findings, Section
from analysis.layouts.valve import valve_layout
from analysis.reduction.valve import reduce_switching_time, reduce_switching_voltage
from analysis.regression.least_squares import Line, mean_of_repeats, pooled, straight_line
from daq.live.layout import LiveLayout

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from analysis.reduction.points import Reduction
    from daq.store.run import Run

VALVES = ("inlet", "outlet")
EDGES = ("on", "off")
EACH = tuple((valve, edge) for valve in VALVES for edge in EDGES)


def time_findings(run: Run, reduction: Reduction) -> Findings:
    """Delays against pressure (Figure 5-21): the form of Tables D-1 to D-3, and their laws."""
    table = reduction.table
    laws = _laws(table, "ms")
    sections = [
        Section(
            "Switching times against pressure",
            (
                "Time from a command's edge to the valve's own, the air's way to the sensor taken"
                " off. Pressure is that at the solenoid's upstream side when the command changed.",
            )
            if not run.manifest.get("imported")
            else (),
            figure=lambda: _figure(table, laws, "ms", "delay (ms)"),
            caption="The form of the thesis's Figure 5-21. Filled: command on; open: command off."
            " Bars: expanded uncertainty, k = 2. Lines: least squares.",
        ),
        _wide(table, "ms", "The form of Tables D-1 to D-3: mean of the repeats", ", ms"),
        _law_section(laws, "ms"),
    ]
    if _source(run) == "D-1 to D-3":
        sections.append(_std_row(table))
    return Findings(_headline(laws, "ms", len(table)), tuple(sections), _results(laws, "ms"))


def voltage_findings(run: Run, reduction: Reduction) -> Findings:
    """Voltages against pressure (Figure 5-17): the form of Table D-4, and their laws."""
    table = reduction.table
    laws = _laws(table, "v")
    words = (
        "On: the lowest voltage at which a valve opens when it is told to; it is lowered in"
        " halves between one that opens it and one that does not. Off: the highest at which an"
        " open valve lets go.",
    )
    sections = [
        Section(
            "Switching voltages against pressure",
            words if not run.manifest.get("imported") else (),
            figure=lambda: _figure(table, laws, "v", "voltage (V)"),
            caption="The form of the thesis's Figure 5-17. Filled: turns on; open: turns off."
            " Bars: expanded uncertainty, k = 2. Lines: least squares.",
        ),
        _wide(table, "v", "The form of Table D-4", ", V"),
        _law_section(laws, "v"),
    ]
    return Findings(_headline(laws, "v", len(table)), tuple(sections), _results(laws, "v"))


def _source(run: Run) -> str:
    return str((run.manifest.get("source") or {}).get("table", ""))


def _of(table: pd.DataFrame, valve: str, edge: str, unit: str) -> pd.DataFrame:
    """Readings of one edge of one valve: x (kPa), y and their uncertainties."""
    import pandas as pd

    rows = table[table["valve"] == valve]
    at = "off_pressure_kpa" if edge == "off" and "off_pressure_kpa" in rows else "pressure_kpa"
    x = rows[at].fillna(rows["pressure_kpa"])
    y = f"{edge}_{unit}"
    return pd.DataFrame(
        {
            "set_kpa": rows["set_pressure_kpa"].fillna(rows["pressure_kpa"].round(0)),
            "x": x,
            "y": rows[y],
            "u": rows[f"u_{y}"],
            "noise": rows[f"u_{y}_noise"],
            "cal": rows[f"u_{y}_cal"],
        }
    ).dropna(subset=["x", "y"])


def _laws(table: pd.DataFrame, unit: str) -> dict[tuple[str, str], tuple[Line, float] | None]:
    """For each edge its line and what all readings have in common (standard, in ``unit``)."""
    laws: dict[tuple[str, str], tuple[Line, float] | None] = {}
    for valve, edge in EACH:
        rows = _of(table, valve, edge, unit)
        line = straight_line(rows["x"].to_numpy(), rows["y"].to_numpy())
        cal = float(rows["cal"].mean()) if len(rows) else math.nan
        laws[valve, edge] = None if line is None else (line, cal if math.isfinite(cal) else 0.0)
    return laws


def _results(laws: dict[tuple[str, str], tuple[Line, float] | None], unit: str) -> dict[str, Any]:
    out: dict[str, Any] = {}
    for (valve, edge), law in laws.items():
        if law is None:
            continue
        line, cal = law
        name = f"{valve}_{edge}_{unit}"
        out[name] = line.intercept
        out[f"u_{name}"] = math.hypot(line.u_intercept, cal)
        out[f"{name}_per_kpa"], out[f"u_{name}_per_kpa"] = line.slope, line.u_slope
        out[f"{name}_scatter"] = line.s
    return out


def _headline(
    laws: dict[tuple[str, str], tuple[Line, float] | None], unit: str, points: int
) -> str:
    if not points:
        return "No point was measured, so there is no result."
    timed = unit == "ms"
    decimals, shown, verb, at = (1, "ms", "switches", "in") if timed else (2, "V", "turns", "at")
    parts = []
    for valve in VALVES:
        on, off = laws[valve, "on"], laws[valve, "off"]
        if on is None or off is None:
            continue
        ends = [f"{line.at(p):.{decimals}f}" for line in (on[0], off[0]) for p in (0.0, 600.0)]
        parts.append(
            f"the {valve} {verb} on {at} {ends[0]} to {ends[1]} {shown} and off {at}"
            f" {ends[2]} to {ends[3]} {shown}"
        )
    if not parts:
        measured = "One point was" if points == 1 else f"{points} points were"
        return f"{measured} measured, too few for a law in pressure."
    return f"From 0 to 600 kPa {'; '.join(parts)} (by their lines)."


def _wide(table: pd.DataFrame, unit: str, title: str, unit_words: str) -> Section:
    """One row a set pressure: means of the repeats with what they do not repeat."""
    import pandas as pd

    edges = {each: _of(table, *each, unit) for each in EACH}
    pools = {
        each: pooled([g["y"].to_numpy(dtype=np.float64) for _, g in rows.groupby("set_kpa")])
        for each, rows in edges.items()
    }
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
    heads = [("_".join((*each, unit)), " ".join(each) + unit_words) for each in EACH]
    if "air_delay_ms" in table:
        heads.append(("air_delay_ms", "air delay, ms"))
    scatter = ", ".join(
        f"{valve} {edge} {sd:.3f}" for (valve, edge), (sd, dof) in pools.items() if dof
    )
    words = (
        (f"Standard deviation of a single reading within one pressure{unit_words}: {scatter}.",)
        if scatter
        else ()
    )
    return Section(
        title, words, pd.DataFrame(rows), (("pressure_kpa", "pressure, kPa"), *heads),
        caption="± expanded uncertainty, k = 2: repeats, resolution and what all readings share.",
    )  # fmt: skip


def _law_section(laws: dict[tuple[str, str], tuple[Line, float] | None], unit: str) -> Section:
    import pandas as pd

    rows = []
    for (valve, edge), law in laws.items():
        if law is None:
            continue
        line, cal = law
        rows.append(
            {
                "edge": f"{valve} {edge}",
                "n": line.n,
                "intercept": line.intercept,
                "u_intercept": math.hypot(line.u_intercept, cal),
                "slope": 1e3 * line.slope,
                "u_slope": 1e3 * line.u_slope,
                "scatter": round(line.s, 3),
                "p": f"{line.p_slope:.2g}",
            }
        )
    shown = unit.upper() if unit == "v" else unit
    heads = (
        ("edge", "edge"), ("n", "readings"), ("intercept", f"at 0 kPa, {shown}"),
        ("slope", f"per MPa, {shown}"), ("scatter", f"scatter, {shown}"), ("p", "p of no slope"),
    )  # fmt: skip
    return Section(
        "Straight lines in pressure",
        ("Least squares over all readings." if rows else "Too few readings for a line.",),
        pd.DataFrame(rows),
        heads,
        caption="± expanded uncertainty, k = 2, from the scatter about the line; that at 0 kPa"
        " also holds what all readings share.",
    )


def _std_row(table: pd.DataFrame) -> Section:
    """The row "std" under Table D-3, by the rule that gives it."""
    import pandas as pd

    from plant.thesis import load

    printed = load("d03")[0]
    rows = []
    for valve, edge in EACH:
        values = _of(table, valve, edge, "ms")["y"].to_numpy(dtype=np.float64)
        within, _ = pooled(
            [g["y"].to_numpy() for _, g in _of(table, valve, edge, "ms").groupby("set_kpa")]
        )
        again = float(values.std())
        rows.append(
            {
                "edge": f"{valve} {edge}",
                "printed": float(str(printed[f"{valve}_{edge}"])),
                "recomputed": round(again, 4),
                "within": round(within, 3),
                "same": round(again, 3) == float(str(printed[f"{valve}_{edge}"])),
            }
        )
    return Section(
        "Beside what the thesis printed: the row std of Table D-3",
        (
            f"{sum(bool(r['same']) for r in rows)} of 4 come out as the standard deviation of all"
            " 39 readings, divided by n. That is the spread over pressures, no repeatability; the"
            " last column has the scatter within one pressure. By it the inlet's on times"
            " scatter less than the outlet's, as section 5.13 says; the printed row says the"
            " opposite.",
        ),
        pd.DataFrame(rows),
        (
            ("edge", "edge"), ("printed", "printed, ms"), ("recomputed", "recomputed, ms"),
            ("within", "within a pressure, ms"), ("same", "same"),
        ),
    )  # fmt: skip


def _figure(
    table: pd.DataFrame,
    laws: dict[tuple[str, str], tuple[Line, float] | None],
    unit: str,
    label: str,
) -> Figure:
    from analysis.figures.drawing import COVERAGE, MEASURED, SET, new_figure, style

    colours = {"inlet": MEASURED, "outlet": SET}
    markers = {"inlet": "o", "outlet": "s"}
    with style():
        figure, axes = new_figure(7.2, 4.4)
        for valve, edge in EACH:
            rows = _of(table, valve, edge, unit)
            filled = edge == "on"
            bars = COVERAGE * np.nan_to_num(rows["u"].to_numpy(dtype=np.float64))
            axes.errorbar(
                rows["x"], rows["y"], yerr=bars,
                fmt=markers[valve], markersize=4 if filled else 5,
                color=colours[valve], markerfacecolor=colours[valve] if filled else "white",
                elinewidth=0.7, alpha=0.9, label=f"{valve} {edge}", zorder=3,
            )  # fmt: skip
            law = laws[valve, edge]
            if law is not None and len(rows):
                x = np.array([rows["x"].min(), rows["x"].max()])
                axes.plot(
                    x, law[0].at(x), color=colours[valve], linewidth=1.2,
                    linestyle="-" if filled else "--",
                )  # fmt: skip
        axes.set_xlabel("pressure upstream of the valve (kPa gauge)")
        axes.set_ylabel(label)
        axes.margins(y=0.12)
        axes.legend(ncols=4, loc="lower center", bbox_to_anchor=(0.5, 1.0), fontsize=8)
    return figure


def _time_layout(parameters: Mapping[str, Any]) -> LiveLayout:
    """Its screen."""
    return valve_layout("Switching-time test", parameters)


def _voltage_layout(parameters: Mapping[str, Any]) -> LiveLayout:
    """Its screen."""
    return valve_layout("Switching-voltage test", parameters, voltage=True)


SWITCHING_TIME = Analysis(
    "switching-time", "Switching-time test", reduce_switching_time, _time_layout, time_findings
)
SWITCHING_VOLTAGE = Analysis(
    "switching-voltage",
    "Switching-voltage test",
    reduce_switching_voltage,
    _voltage_layout,
    voltage_findings,
)
ANALYSES = (SWITCHING_TIME, SWITCHING_VOLTAGE)
