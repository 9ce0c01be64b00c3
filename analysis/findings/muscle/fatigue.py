"""Findings of a fatigue test: drift over the cycles, failure, work and efficiency."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.findings.findings import (
    EXPANDED,
    NO_POINT,
    Analysis,
    Findings,
    ResultColumns,
    Section,
    records,
)
from analysis.layouts.muscle import fatigue_layout
from analysis.reduction.muscle.cycles import reduce_fatigue
from analysis.reduction.muscle.energy import Energy, State, cycle_energy, stated_air
from analysis.reduction.muscle.time_laws import TimeLaw, fit_rate

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from analysis.reduction.points import Reduction
    from daq.store.run import Run

BINS_PER_DECADE = 8
EARLY, COUNT = 5, 5
"""The reference is the mean of cycles 6 to 10: the first of a rested muscle are different."""
LAST = 10
MISSED_KPA = 5.0
PARTS = ["cycle", "n", "mean", "u", "low", "high"]
DRIFT = (
    "The cycles are averaged in parts whose length grows by a factor. The rate is the slope of a"
    " line over the logarithm of the number of cycles; its uncertainty counts the autocorrelation"
    " of the residuals, as on the page about creep. The change is that of the mean of the last"
    " cycles against that of cycles 6 to 10, in which the gain of the calibration cancels. A drift"
    " of the sensors is not known to the test."
)


@dataclass(frozen=True)
class Quantity:
    """What a fatigue test watches."""

    column: str
    unit: str
    name: str


FORCE = Quantity("force_range_n", "N", "force range")
STROKE = Quantity("stroke_mm", "mm", "stroke")


def parts_of(table: pd.DataFrame, column: str) -> pd.DataFrame:
    """Mean, extremes and uncertainty of the mean of a column in parts of the cycles."""
    import pandas as pd

    cycles = table["order"].to_numpy(np.float64)
    values = table[column].to_numpy(np.float64)
    good = np.isfinite(values)
    cycles, values = cycles[good], values[good]
    edges = np.floor(BINS_PER_DECADE * np.log10(cycles) + 1e-9)
    rows = []
    for edge in sorted(set(edges.tolist())):
        use = edges == edge
        n = int(use.sum())
        spread = float(values[use].std(ddof=1)) if n > 1 else math.nan
        rows.append(
            {
                "cycle": float(np.exp(np.log(cycles[use]).mean())), "n": n,
                "mean": float(values[use].mean()), "u": spread / math.sqrt(n),
                "low": float(values[use].min()), "high": float(values[use].max()),
            }
        )  # fmt: skip
    return pd.DataFrame(rows, columns=PARTS, dtype=np.float64)


def fatigue_findings(run: Run, reduction: Reduction) -> Findings:
    """Drift of range and leak, the failure, work and efficiency at both ends of the test."""
    import pandas as pd

    table = reduction.table
    if not len(table):
        return Findings(NO_POINT)
    parameters = run.manifest.get("parameters") or {}
    quantity = STROKE if table["stroke_mm"].notna().any() else FORCE
    failure = next((e for e in run.events if e.get("kind") == "failure"), None)
    drift, law = _drift(table, quantity)
    ends = _ends(table, quantity)
    stop = _reason(run, table, parameters, failure)
    rows = [{"what": quantity.name, "unit": quantity.unit, **drift}]
    if table["leak_kpa_s"].notna().sum() >= 2:
        leak = _plain(table, "leak_kpa_s") | {"change": math.nan, "u_change": math.nan}
        rows.append({"what": "leak", "unit": "kPa/s", **leak})
    columns = (
        ("what", "quantity"), ("unit", "unit"), ("first", "first cycles"),
        ("last", "last cycles"), ("change", "change, %"), ("rate", "rate, per decade"),
    )  # fmt: skip
    sections = [
        Section(
            "Over the cycles",
            figure=partial(_figure, table, quantity, law),
            caption="Lines: means of parts of the cycles; shaded: smallest and largest cycle of"
            " each part; dashed: line over the logarithm of the number of cycles.",
        ),
        Section("End of the test", (stop, *_missed(table, parameters))),
        Section("Drift", (DRIFT,), pd.DataFrame(rows), columns, caption=f"{EXPANDED}."),
        _energy_section(run, ends),
    ]
    shown = table.iloc[_log_rows(len(table))]
    points: list[tuple[str, str]] = [("order", "cycle")]
    for column, heading in (
        ("pressure_high_kpa", "high, kPa"), ("pressure_low_kpa", "low, kPa"),
        ("force_high_n", "force high, N"), ("force_low_n", "force low, N"),
        ("length_high_mm", "length high, mm"), ("length_low_mm", "length low, mm"),
        ("force_range_n", "force range, N"), ("stroke_mm", "stroke, mm"), ("work_j", "work, J"),
        ("leak_kpa_s", "leak, kPa/s"), ("temperature_c", "temperature, °C"),
    ):  # fmt: skip
        if shown[column].notna().any():
            points.append((column, heading))
    words = ("The table of the run has every cycle; here are some.",)
    sections.append(Section("Cycles", words, shown, tuple(points), caption=f"{EXPANDED}."))
    data = {
        "cycles": int(table["order"].max()), "failed": failure is not None,
        "end": stop, "quantity": quantity.column, "drift": drift, "energy": ends["energy"],
        "points": records(shown),
    }  # fmt: skip
    first = Section(
        "Results: first and last cycles", (), pd.DataFrame(rows), columns,
        caption=f"First: mean of cycles {EARLY + 1} to {EARLY + COUNT}, as far as they were made"
        f" (of a test of up to {EARLY} cycles: of these); last: mean of up to {LAST}. {EXPANDED}."
        " How change and rate are calculated is under Details.",
    )  # fmt: skip
    return Findings(
        _headline(table, quantity, drift, failure), tuple(sections), data, page_one=(first,)
    )


def _drift(table: pd.DataFrame, quantity: Quantity) -> tuple[dict[str, Any], TimeLaw | None]:
    parts = parts_of(table[table["order"] > EARLY], quantity.column)
    u = parts["u"].fillna(parts["u"].median()).to_numpy(np.float64)
    law = fit_rate(parts["cycle"].to_numpy(), parts["mean"].to_numpy(), u, None, (0.0, 1.0))
    rate, u_rate = law.rate if law is not None else (math.nan, math.nan)
    return {**_plain(table, quantity.column), "rate": rate, "u_rate": u_rate}, law


def _plain(table: pd.DataFrame, column: str) -> dict[str, Any]:
    """Means at both ends and the change between them."""
    values = table[table[column].notna()]
    start = values[values["order"] > EARLY].head(COUNT)
    last = values.tail(min(LAST, max(len(values) // 2, 1)))
    if not len(start):
        start = values.head(COUNT)
    a, b = float(start[column].mean()), float(last[column].mean())
    spread = [
        float(part[column].std(ddof=1)) / math.sqrt(len(part)) if len(part) > 1 else math.nan
        for part in (start, last)
    ]
    ratio = b / a if a else math.nan
    u = abs(ratio) * math.hypot(spread[0] / a, spread[1] / b) if a and b else math.nan
    common = float(start[f"u_{column}"].mean())
    return {
        "first": a, "u_first": common, "last": b, "u_last": float(last[f"u_{column}"].mean()),
        "change": 100.0 * (ratio - 1.0), "u_change": 100.0 * u, "rate": math.nan,
        "u_rate": math.nan,
    }  # fmt: skip


def _ends(table: pd.DataFrame, quantity: Quantity) -> dict[str, Any]:
    del quantity
    some = table[table["order"] > EARLY].head(COUNT)
    return {"first": some if len(some) else table.head(COUNT), "last": table.tail(LAST),
            "energy": []}  # fmt: skip


def _energy_section(run: Run, ends: dict[str, Any]) -> Section:
    """Work of the stroke, exergy of the air and efficiency, of the first and of the last cycles."""
    import pandas as pd

    from analysis.findings.muscle.energy import ENERGY_COLUMNS, ENERGY_WORDS, NOT_KNOWN

    title = "Work and efficiency"
    parameters = run.manifest.get("parameters") or {}
    if not parameters.get("mass_kg"):
        return Section(title, ("The length is held: no work is done over a cycle.",))
    air = stated_air(parameters)
    calibration = run.calibration("length_mm")
    rows: list[dict[str, Any]] = []
    for name in ("first", "last"):
        part = ends[name]
        mean = part.mean(numeric_only=True)
        states = [
            State(
                float(mean[f"pressure_{end}_kpa"]), float(mean["u_pressure_high_kpa"]),
                float(mean[f"length_{end}_mm"]), float(calibration.u(mean[f"length_{end}_mm"])),
            )
            for end in ("high", "low")
        ]  # fmt: skip
        made: Energy = cycle_energy(
            float(mean["work_j"]), float(mean["u_work_j"]), states[0], states[1], air
        )
        rows.append({"cycles": f"{part['order'].min()} to {part['order'].max()}", **vars(made)})
    ends["energy"] = rows
    words = (*ENERGY_WORDS, *(() if air is not None else (NOT_KNOWN,)))
    frame = pd.DataFrame(rows)
    return Section(title, words, frame, (("cycles", "cycles"), *ENERGY_COLUMNS),
                   caption=f"{EXPANDED}.")  # fmt: skip


def _missed(table: pd.DataFrame, parameters: dict[str, Any]) -> tuple[str, ...]:
    """Whether most cycles did not reach the high pressure."""
    missed = float(parameters.get("high_kpa", math.nan)) - float(
        table["pressure_high_kpa"].median()
    )
    if not missed > MISSED_KPA:
        return ()
    return (
        f"Half of the cycles missed the high pressure by more than {missed:.0f} kPa: they are too"
        " fast for the source of pressure and its valves. A lower rate_hz gives steadier values.",
    )


def _reason(
    run: Run, table: pd.DataFrame, parameters: dict[str, Any], failure: dict[str, Any] | None
) -> str:
    made, planned = int(table["order"].max()), int(parameters.get("cycles") or 0)
    if failure is not None:
        return (
            f"The muscle failed in cycle {failure['cycle']}: {failure['reason']}. The muscle was"
            " vented."
        )
    if made >= planned:
        return f"All {planned} cycles were made; no criterion of failure was met."
    return f"{made} of {planned} cycles were made when the run ended ({run.outcome})."


def _headline(
    table: pd.DataFrame, quantity: Quantity, drift: dict[str, Any], failure: dict[str, Any] | None
) -> str:
    made = int(table["order"].max())
    text = f"{made} cycles"
    if failure is not None:
        text = f"The muscle failed in cycle {failure['cycle']}"
    change, u = drift["change"], drift["u_change"]
    if not math.isfinite(u):
        return f"{text}; too few for a drift."
    return (
        (f"{text}; the {quantity.name} changed by {change:+z.2f} ± {2 * u:.2g} % (k = 2).")
        .replace("+0.00", "0.00")
        .replace("-", "−")
    )


def _log_rows(n: int, per_decade: int = 8) -> list[int]:
    """Some positions, evenly over the logarithm, with the first and the last."""
    if n <= 30:
        return list(range(n))
    at = np.unique(np.round(np.geomspace(1, n, int(per_decade * math.log10(n)) + 2)).astype(int))
    return [int(k) - 1 for k in at]


def _figure(table: pd.DataFrame, quantity: Quantity, law: TimeLaw | None) -> Figure:
    from analysis.figures.drawing import (
        INK,
        MEASURED,
        QUIET,
        new_figure,
        plain_decades,
        style,
    )

    wanted = [(quantity.column, f"{quantity.name}\n({quantity.unit})"),
              ("pressure_high_kpa", "high pressure\n(kPa)"), ("leak_kpa_s", "leak\n(kPa/s)"),
              ("temperature_c", "temperature\n(°C)")]  # fmt: skip
    shown = [(column, label) for column, label in wanted if table[column].notna().sum() > 1]
    with style():
        figure, axes = new_figure(7.2, 1.2 + 1.7 * len(shown), rows=len(shown), sharex=True)
        for axis, (column, label) in zip(np.atleast_1d(axes), shown, strict=True):
            parts = parts_of(table, column)
            axis.fill_between(
                parts["cycle"], parts["low"], parts["high"], color=MEASURED, alpha=0.2, linewidth=0
            )
            axis.plot(parts["cycle"], parts["mean"], color=MEASURED, marker="o", markersize=3,
                      linewidth=1.0)  # fmt: skip
            if column == quantity.column and law is not None:
                axis.plot(law.time_s, law.at(law.time_s), color=INK, linestyle="--", linewidth=0.9)
            low, high = axis.get_ylim()
            room = 0.002 * max(abs(low), abs(high)) - (high - low)
            if room > 0.0:  # noise is not to fill the axis
                axis.set_ylim(low - room / 2, high + room / 2)
            axis.set_ylabel(label)
            axis.axvline(1.0, color=QUIET, linewidth=0.5)
        last = np.atleast_1d(axes)[-1]
        last.set_xscale("log")
        plain_decades(last.xaxis)
        last.set_xlabel("cycle")
        figure.align_ylabels(np.atleast_1d(axes))
    return figure


FATIGUE = Analysis(
    "fatigue", "Fatigue test", reduce_fatigue, fatigue_layout, fatigue_findings,
    ResultColumns(quantities=()),  # its cycles are no repeats: they drift
)  # fmt: skip
ANALYSES = (FATIGUE,)
