"""Findings of creep and relaxation tests: how length or force change while all else is held."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.figures.wording import with_u
from analysis.findings.findings import (
    EXPANDED,
    NO_POINT,
    Analysis,
    Findings,
    ResultColumns,
    Section,
    records,
)
from analysis.layouts.muscle import held_layout
from analysis.reduction.muscle.time_laws import (
    PLAIN,
    TimeLaw,
    best_law,
    fit_rate,
    fit_time_laws,
)
from analysis.reduction.points import Reduction, reduce_points

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from daq.calibration import Calibration
    from daq.store.run import Run

EXTRA = {
    "mass_kg": "float64",
    "after_s": "float64",
    "from_s": "float64",
    "to_s": "float64",
}
AUTOCORRELATION = (
    "Each point is the mean of all readings in its part of the time. The slope is that of a line"
    " over the logarithm of time. Its uncertainty is that of least squares with the scatter of the"
    " residuals, times the square root of their integrated autocorrelation time tau (in points), so"
    " that n points count as n/tau; to it the gain of the calibration is added. The deviation of"
    " the measured pressure from its set-point is a second variable of each fit."
)
NOISE_BARS = (
    "Bars: expanded uncertainty from noise alone, k = 2, if larger than the marker; what the"
    " calibration adds is common to all points."
)
CHOICE = (
    "The law is the simplest whose AICc is within 2 of the least, of: no change, a line over the"
    " logarithm of time, one and two exponentials, each counted with n/tau points. A time constant"
    " beyond the duration is an extrapolation."
)


@dataclass(frozen=True)
class Quantity:
    """What a test measures: column, unit, words."""

    column: str
    unit: str
    label: str
    verb: str


FORCE = Quantity("force_n", "N", "force (N)", "relaxes")
LENGTH = Quantity("length_mm", "mm", "length (mm)", "creeps")


@dataclass(frozen=True)
class HeldTrial:
    """One trial: its points, its laws, and the line over the logarithm of time."""

    slot: str
    repeat: int
    rows: pd.DataFrame
    laws: list[TimeLaw]
    line: TimeLaw | None

    @property
    def best(self) -> TimeLaw | None:
        """The law that was chosen."""
        return best_law(self.laws) if self.laws else None


def held_trials(table: pd.DataFrame, quantity: Quantity) -> list[HeldTrial]:
    """The trials of a table with their laws."""
    out = []
    for (slot, repeat), part in table.groupby(["slot", "repeat"], sort=False):
        rows = part[part[quantity.column].notna()].sort_values("after_s")
        y = rows[quantity.column].to_numpy(np.float64)
        pressure = rows["pressure_kpa"].to_numpy(np.float64)
        middle = float(np.nanmean(pressure)) if len(pressure) else math.nan
        laws: list[TimeLaw] = []
        line = None
        if len(y) and middle > 0.0:
            # Force is about proportional to pressure; a length changes by less than its share.
            share = float(np.mean(y)) / middle
            given = (
                rows["after_s"].to_numpy(np.float64), y,
                rows[f"u_{quantity.column}_noise"].to_numpy(np.float64), pressure - middle,
                (share, abs(share) or 1.0) if quantity is FORCE else (0.0, share),
            )  # fmt: skip
            laws, line = fit_time_laws(*given), fit_rate(*given)
        out.append(HeldTrial(str(slot), int(str(repeat)), rows, laws, line))
    return out


def held_findings(quantity: Quantity, run: Run, reduction: Reduction) -> Findings:
    """Slope per decade and chosen law of each trial."""
    import pandas as pd

    del run
    table = reduction.table
    if not len(table):
        return Findings(NO_POINT)
    calibration = reduction.calibrations.get(quantity.column)
    trials = held_trials(table, quantity)
    rows = [_row(trial, quantity, calibration) for trial in trials]
    unit = quantity.unit
    chosen = [_chosen(trial, calibration) for trial in trials if trial.best is not None]
    columns = (
        ("slot", "held"), ("repeat", "repeat"), ("points", "points"), ("until_s", "until, s"),
        ("first", f"first, {unit}"), ("rate", f"slope, {unit}/decade"),
        ("share", "slope, %/decade"), ("tau", "tau, points"),
    )  # fmt: skip
    laws: tuple[tuple[str, str], ...] = (
        ("slot", "held"), ("repeat", "repeat"), ("law", "law"), ("level", f"level, {unit}"),
        ("a1", f"slope or first amplitude, {unit}"), ("t1", "time constant, s"),
        ("a2", f"second amplitude, {unit}"), ("t2", "time constant, s"),
        ("over", "AICc minus that of the next law"),
    )  # fmt: skip
    names = [name for name, _ in laws]
    used = [name for name in names if any(row[name] == row[name] for row in chosen)]
    laws = tuple(column for column in laws if column[0] in used)  # a constant has a level alone
    sections = [
        Section(
            f"{quantity.label.split(' (')[0].capitalize()} while held",
            figure=lambda: _figure(trials, quantity),
            caption=f"Lines: the law that was chosen. {NOISE_BARS} Below: distance from the law.",
        ),
        Section(
            "Slope over the logarithm of time", (AUTOCORRELATION,), pd.DataFrame(rows), columns,
            caption=f"{EXPANDED}.",
        ),
    ]  # fmt: skip
    if chosen:
        sections.append(
            Section(
                "Law that was chosen", (CHOICE,), pd.DataFrame(chosen), laws, caption=f"{EXPANDED}."
            )
        )
    points: tuple[tuple[str, str], ...] = (
        ("slot", "held"), ("repeat", "repeat"), ("from_s", "from, s"), ("to_s", "to, s"),
        ("pressure_kpa", "pressure, kPa"), ("length_mm", "length, mm"), ("force_n", "force, N"),
    )  # fmt: skip
    points = tuple(column for column in points if table[column[0]].notna().any())
    sections.append(Section("Points", (), table, points, caption=f"{EXPANDED}."))
    data = {"trials": rows, "laws": chosen, "points": records(table)}
    return Findings(held_headline(rows, quantity), tuple(sections), data)


def _row(trial: HeldTrial, quantity: Quantity, calibration: Calibration | None) -> dict[str, Any]:
    line = trial.line
    rate, u_rate = line.rate if line is not None else (math.nan, math.nan)
    if calibration is not None:
        u_rate = math.hypot(u_rate, calibration.u_gain * rate)
    first: dict[Any, Any] = trial.rows.iloc[0].to_dict() if len(trial.rows) else {}
    level = float(first.get(quantity.column, math.nan))
    pressures = trial.rows["pressure_kpa"]
    return {
        "slot": trial.slot, "repeat": trial.repeat, "points": len(trial.rows),
        "until_s": float(trial.rows["to_s"].max()),
        "first": level, "u_first": float(first.get(f"u_{quantity.column}", math.nan)),
        "rate": rate, "u_rate": u_rate, "share": 100.0 * rate / level,
        "u_share": 100.0 * u_rate / abs(level),
        "tau": round(line.tau, 2) if line is not None else math.nan,
        "pressure_range_kpa": float(pressures.max() - pressures.min()),
        "law": trial.best.name if trial.best is not None else None,
    }  # fmt: skip


def _chosen(trial: HeldTrial, calibration: Calibration | None) -> dict[str, Any]:
    best = trial.best
    assert best is not None
    others = [law.aicc for law in trial.laws if law is not best and math.isfinite(law.aicc)]
    gain = calibration.u_gain if calibration is not None else 0.0
    row: dict[str, Any] = {
        "slot": trial.slot, "repeat": trial.repeat, "law": best.name,
        "over": round(best.aicc - min(others), 1) if others else math.nan,
        "aicc": {law.name: law.aicc for law in trial.laws},
    }  # fmt: skip
    names = ("level", "a1", "t1", "a2", "t2")
    for k, name in enumerate(names):
        known = k < len(best.values)
        value, u = (best.values[k], best.u[k]) if known else (math.nan, math.nan)
        row[name] = value
        row[f"u_{name}"] = math.hypot(u, gain * value) if name.startswith("a") else u
    if calibration is not None:
        row["u_level"] = math.hypot(row["u_level"], float(calibration.u(best.values[0])))
    return row


def held_headline(rows: list[dict[str, Any]], quantity: Quantity) -> str:
    """The largest change in one sentence; none where the laws that were chosen are constant."""
    known = [row for row in rows if math.isfinite(row["rate"])]
    if not known:
        return "Too few points were measured for a slope over the logarithm of time."
    what = quantity.label.split(" (")[0]
    moved = [row for row in known if _moves(row)]
    if not moved:
        most, slot = max((abs(row["rate"]) + 2 * row["u_rate"], row["slot"]) for row in known)
        return (
            f"No change of the {what} was found: it is below {most:.2g} {quantity.unit} per decade"
            f" of time (k = 2; {slot})."
        )
    largest = max(moved, key=lambda row: abs(row["rate"]))
    trials = "1 trial" if len(known) == 1 else f"{len(known)} trials"
    return (
        f"The {what} {quantity.verb}: by {with_u(largest['rate'], largest['u_rate'])}"
        f" {quantity.unit} per decade of time at most (k = 2; {largest['slot']}), found in"
        f" {len(moved)} of {trials}."
    )


def _moves(row: dict[str, Any]) -> bool:
    """Whether the law chosen for a trial changes; without a law, whether the slope does."""
    if row["law"] is not None:
        return bool(row["law"] != PLAIN)
    return bool(abs(row["rate"]) > 2.0 * row["u_rate"])


def _figure(trials: list[HeldTrial], quantity: Quantity) -> Figure:
    from analysis.figures.drawing import (
        COVERAGE,
        QUIET,
        marker,
        new_figure,
        plain_decades,
        sequence,
        style,
    )

    colours = sequence(len(trials))
    with style():
        figure, (top, bottom) = new_figure(7.2, 5.6, rows=2, sharex=True)
        for k, trial in enumerate(trials):
            rows, colour = trial.rows, colours[k]
            if not len(rows):
                continue
            t, y = rows["after_s"].to_numpy(float), rows[quantity.column].to_numpy(float)
            bars = COVERAGE * rows[f"u_{quantity.column}_noise"].to_numpy(float)
            look = {"fmt": marker(k), "color": colour, "markersize": 3.4, "elinewidth": 0.7}
            top.errorbar(t, y, yerr=bars, label=f"{trial.slot}, repeat {trial.repeat}", **look)
            if (best := trial.best) is not None:
                fine = np.geomspace(t.min(), t.max(), 200)
                top.plot(fine, best.at(fine), color=colour, linewidth=1.0)
                bottom.errorbar(best.time_s, y - best.at(best.time_s), yerr=bars, **look)
        bottom.axhline(0.0, color=QUIET, linewidth=0.8)
        bottom.set_xscale("log")
        plain_decades(bottom.xaxis)
        bottom.set_xlabel("time held (s)")
        top.set_ylabel(quantity.label)
        bottom.set_ylabel(f"measured − law ({quantity.unit})")
        top.legend(ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0), fontsize=8)
        figure.align_ylabels([top, bottom])
    return figure


HELD_SETTINGS = ("set_length_mm", "mass_kg", "set_pressure_kpa", "to_s")

CREEP = Analysis(
    "creep",
    "Creep test",
    partial(reduce_points, extra=EXTRA, trend=True),
    lambda parameters: held_layout("Creep test", parameters, loaded=True),
    partial(held_findings, LENGTH),
    ResultColumns(("length_mm",), HELD_SETTINGS),
)
RELAXATION = Analysis(
    "relaxation",
    "Relaxation test",
    partial(reduce_points, extra=EXTRA, trend=True),
    lambda parameters: held_layout("Relaxation test", parameters, loaded=False),
    partial(held_findings, FORCE),
    ResultColumns(("force_n",), HELD_SETTINGS),
)
ANALYSES = (CREEP, RELAXATION)
