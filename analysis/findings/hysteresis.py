"""What a table of up and down cycles says (C-4 to C-7, Tables 4-4 and 4-5, Figures 4-39, 4-40).

At each set pressure of a cycle the value on the way up less that on the way down; their mean by
the thesis's own rules; and the area of the loop, the work that a cycle loses for each unit of
what was held.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import numpy.typing as npt

from analysis.findings.findings import Analysis, Findings, Section
from analysis.reduction.points import reduce_points
from analysis.reduction.setpoint import at_set_pressure
from daq.live.layout import LiveLayout

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from analysis.reduction.points import Reduction
    from daq.store.run import Run

Floats = npt.NDArray[np.float64]
LOWEST_MEAN_KPA = 200.0
"""The isometric means of the thesis (Table 4-4) run from here to one step below the turn."""

EXTRA = {"mass_kg": "float64", "cycle_max_kpa": "float64"}


@dataclass(frozen=True)
class Cycle:
    """One cycle up and down.

    Attributes:
        held: what was held, in words ("61.9 mm", "1.154 kg").
        top_kpa: pressure at which it turned.
        repeat: which replicate.
        pressure_kpa: set pressures with a reading both ways, rising.
        difference: up less down, in N (isometric) or mm (isotonic).
        u_difference: standard uncertainty from noise; what both ways share cancels.
        mean_up: mean value on the way up, for scale.
    """

    held: str
    top_kpa: float
    repeat: int
    pressure_kpa: Floats
    difference: Floats
    u_difference: Floats
    up: Floats

    @property
    def area(self) -> float:
        """Area of the loop, trapezoids over pressure: N kPa or mm kPa."""
        return float(np.trapezoid(self.difference, self.pressure_kpa))

    @property
    def u_area(self) -> float:
        """Its standard uncertainty, each difference with its own noise."""
        x = self.pressure_kpa
        if len(x) < 2:
            return math.nan
        weight = np.zeros(len(x))
        weight[:-1] += np.diff(x) / 2
        weight[1:] += np.diff(x) / 2
        return float(np.sqrt(np.nansum((weight * self.u_difference) ** 2)))

    def mean(self, isotonic: bool) -> tuple[float, float]:
        """The thesis's mean difference and its uncertainty: its two tables follow two rules.

        Isometric: 200 kPa to one step below the turn. Isotonic: every pressure of the cycle.
        """
        use = np.ones(len(self.difference), dtype=bool)
        if not isotonic:
            use = (self.pressure_kpa >= LOWEST_MEAN_KPA) & (self.pressure_kpa < self.top_kpa)
        if not use.any():
            return math.nan, math.nan
        u = float(np.sqrt(np.nansum(self.u_difference[use] ** 2))) / int(use.sum())
        return float(self.difference[use].mean()), u


def is_isotonic(table: pd.DataFrame) -> bool:
    """Whether loads were hung (lengths differ) rather than lengths held (forces differ)."""
    return "mass_kg" in table and bool(table["mass_kg"].notna().any())


def cycles_of(table: pd.DataFrame) -> list[Cycle]:
    """Every cycle of a table with both directions.

    At the turning pressure a cycle that was read once counts as without difference, as the
    thesis's Tables C-5 and C-7 have it.
    """
    isotonic = is_isotonic(table)
    value = "length_mm" if isotonic else "force_n"
    held = table["mass_kg"] if isotonic else table["set_length_mm"].fillna(table["length_mm"])
    top = table["cycle_max_kpa"] if "cycle_max_kpa" in table else table["pressure_kpa"] * 0.0
    nominal = table["set_pressure_kpa"].fillna(table["pressure_kpa"].round(0))
    keys = [
        held.astype(float).round(4).rename("held"),
        top.astype(float).fillna(0.0).rename("top"),
        table["repeat"].rename("repeat"),
    ]
    found = []
    for key, rows in table.assign(nominal=nominal).groupby(keys, sort=True):
        mass_or_mm, turn, repeat = cast("tuple[float, float, Any]", key)
        ways: dict[str, dict[float, tuple[float, float]]] = {"up": {}, "down": {}}
        for row in rows.to_dict("records"):
            if row["direction"] in ways and math.isfinite(row[value]):
                reading = (float(row[value]), float(row[f"u_{value}_noise"]))
                ways[str(row["direction"])][float(row["nominal"])] = reading
        if not (ways["up"] and ways["down"]):
            continue
        highest = max(ways["up"])
        ways["down"].setdefault(highest, ways["up"][highest])
        both = sorted(set(ways["up"]) & set(ways["down"]))
        turning = [p == highest and ways["down"][p] == ways["up"][p] for p in both]
        u = [
            0.0 if once else math.hypot(ways["up"][p][1], ways["down"][p][1])
            for p, once in zip(both, turning, strict=True)
        ]
        found.append(
            Cycle(
                f"{mass_or_mm:g} {'kg' if isotonic else 'mm'}",
                float(turn) or highest,
                int(repeat) if str(repeat).isdecimal() else 1,
                np.array(both),
                np.array([ways["up"][p][0] - ways["down"][p][0] for p in both]),
                np.array(u),
                np.array([ways["up"][p][0] for p in both]),
            )
        )
    return found


def hysteresis_findings(run: Run, reduction: Reduction) -> Findings:
    """Loops, differences, means and areas; the thesis's own beside them."""
    import pandas as pd

    table = reduction.table
    isotonic = is_isotonic(table)
    unit = "mm" if isotonic else "N"
    cycles = cycles_of(table)
    rows = []
    for cycle in cycles:
        mean, u_mean = cycle.mean(isotonic)
        largest, span = float(np.abs(cycle.difference).max()), float(np.ptp(cycle.up))
        rows.append(
            {
                "held": cycle.held, "top": cycle.top_kpa, "repeat": cycle.repeat,
                "mean": mean, "u_mean": u_mean, "largest": round(largest, 3),
                "share": round(100 * mean / span, 2) + 0.0 if span else None,  # no "−0"
                "area": cycle.area, "u_area": cycle.u_area,
            }
        )  # fmt: skip
    rule = (
        "The mean runs over every pressure of the cycle, as in Table C-7"
        if isotonic
        else "The mean runs from 200 kPa to one step below the turn, as in Tables C-5 and 4-4"
    )
    source = (run.manifest.get("source") or {}).get("table")
    sections = [
        Section(
            f"Cycles up and down {'under hung loads' if isotonic else 'at held lengths'}",
            figure=(lambda: _figure(table, cycles, isotonic)) if len(table) else None,
            caption=f"The form of the thesis's Figure {'4-40' if isotonic else '4-39'}. Above:"
            " rising filled, falling open; below: rising less falling"
            + (", dotted for the smaller cycles" if len({c.top_kpa for c in cycles}) > 1 else "")
            + ". Bars: expanded uncertainty, k = 2, where larger than the marker.",
        ),
        Section(
            "What each cycle loses",
            (
                f"{rule}; largest is the largest difference at one pressure; share is the mean in"
                " % of the range covered on the way up; area is that of the loop.",
            ),
            pd.DataFrame(rows),
            (
                ("held", "held"), ("top", "turned at, kPa"), ("repeat", "repeat"),
                ("mean", f"mean up − down, {unit}"), ("largest", f"largest, {unit}"),
                ("share", "share, %"), ("area", f"loop area, {unit} kPa"),
            ),
            caption="± expanded uncertainty, k = 2, from the noise of the readings; what both ways"
            " share cancels.",
        ),
        _differences(cycles, isotonic),
    ]  # fmt: skip
    if source in ("C-4", "C-6"):
        sections += _thesis(cycles, isotonic)
    data = {"isotonic": isotonic, "cycles": rows}
    return Findings(_headline(rows, unit), tuple(sections), data)


def _headline(rows: list[dict[str, Any]], unit: str) -> str:
    if not rows:
        return "No cycle was measured both ways, so there is no result."
    known = [row for row in rows if math.isfinite(row["mean"])]
    if not known:
        cycles = "One cycle was" if len(rows) == 1 else f"{len(rows)} cycles were"
        return f"{cycles} measured, none over the pressures of the thesis's mean."
    what = "length" if unit == "mm" else "force"
    if all(abs(row["mean"]) <= 2 * row["u_mean"] for row in known):
        most = max(abs(row["mean"]) + 2 * row["u_mean"] for row in known)
        return (
            f"On the way up and on the way down the {what} is the same within its uncertainty: the"
            f" means of each cycle differ by less than {most:.2g} {unit}."
        )
    low, high = (pick(row["mean"] for row in known) for pick in (min, max))
    return (
        f"On the way up the {what} is {low:.2f} to {high:.2f} {unit} above that on the way down,"
        " cycle by cycle (means)."
    ).replace(" -", " −")


def _differences(cycles: list[Cycle], isotonic: bool) -> Section:
    """The form of C-5 and C-7: a row a pressure, a column a cycle."""
    import pandas as pd

    cells: dict[float, dict[str, Any]] = {}
    for k, cycle in enumerate(cycles):
        for p, d, u in zip(cycle.pressure_kpa, cycle.difference, cycle.u_difference, strict=True):
            row = cells.setdefault(float(p), {"pressure_kpa": float(p)})
            row[f"c{k}"], row[f"u_c{k}"] = float(d), float(u)
    unit = "mm" if isotonic else "N"
    heads = [(f"c{k}", f"{c.held} to {c.top_kpa:g}, {unit}") for k, c in enumerate(cycles)]
    return Section(
        f"Rising less falling: the form of Table C-{7 if isotonic else 5}",
        (),
        pd.DataFrame([cells[p] for p in sorted(cells)]),
        (("pressure_kpa", "pressure, kPa"), *heads),
    )


def _thesis(cycles: list[Cycle], isotonic: bool) -> list[Section]:
    """Tables C-5 or C-7 and 4-4 or 4-5 beside what the readings give."""
    import pandas as pd

    from plant.thesis import load

    name, held = ("c07", "mass_kg") if isotonic else ("c05", "length_mm")
    column = "length_difference_mm" if isotonic else "force_difference_n"
    own = {(c.held.split()[0], c.top_kpa): c for c in cycles}
    printed = load(f"{name}_isotonic_hysteresis_difference" if isotonic else
                   f"{name}_isometric_hysteresis_difference")  # fmt: skip
    off = []
    for row in printed:
        cycle = own[f"{float(str(row[held])):g}", float(str(row["cycle_max_kpa"]))]
        at = np.flatnonzero(cycle.pressure_kpa == float(str(row["pressure_kpa"])))
        again = round(float(cycle.difference[at[0]]), 2) if len(at) else math.nan
        if not abs(again - float(str(row[column]))) < 0.005:
            off.append(abs(again - float(str(row[column]))))
    folder = "t4_5" if isotonic else "t4_4"
    key = "mean_length_difference_mm_as_printed" if isotonic else "mean_force_difference_n"
    kind = "isotonic" if isotonic else "isometric"

    def by_cycle(table: str, value: str) -> dict[tuple[str, float], float]:
        return {
            (f"{float(str(r[held])):g}", float(str(r["cycle_max_kpa"]))): float(str(r[value]))
            for r in load(table)
        }

    said = by_cycle(folder, key)
    means = by_cycle(f"{name}_{kind}_hysteresis_difference_mean", "mean_as_printed")
    rows = []
    by_printed = _printed_means(printed, held, column, isotonic)
    for who, cycle in own.items():
        again = by_printed[who]
        rows.append(
            {
                "cycle": f"{cycle.held} to {cycle.top_kpa:g} kPa",
                "again": round(again, 4),
                "readings": round(cycle.mean(isotonic)[0], 4),
                "appendix": means[who],
                "chapter": said[who],
                "same": abs(again - means[who]) <= 0.00501,
            }
        )
    unit = "mm" if isotonic else "N"
    agree = sum(bool(row["same"]) for row in rows)
    table_a, table_b = (f"C-{7 if isotonic else 5}", f"4-{5 if isotonic else 4}")
    rule = (
        "plain means of its columns"
        if isotonic
        else "means over 200 kPa to one step below the turn, not of whole columns"
    )
    words = [
        f"{agree} of {len(rows)} means under Table {table_a} come out of its own differences, as"
        f" {rule}. {len(printed) - len(off)} of {len(printed)} differences are those of the printed"
        f" readings; the other {len(off)} are"
        f" {max(off, default=0.0):.2f} {unit} off at most (digits that were not printed, and at the"
        " turn no reading on the way down)."
    ]
    if isotonic:
        words.append(
            "Table 4-5 does not reproduce: it repeats the eight numbers of Table 4-4, which are"
            " forces in newton, where the means of Table C-7 in mm belong. Every difference of"
            " Table C-7 is a whole multiple of 0.11 mm, one pixel of the camera, and the means"
            " are about a pixel or less."
        )
    else:
        words.append(
            "Section 4.22 calls this about 1 % of the total force; the largest gaps are 2.3 to 5.6"
            " % of the range of the cycles to 600 kPa."
        )
    return [
        Section(
            f"Beside what the thesis printed: Tables {table_a} and {table_b}",
            tuple(words),
            pd.DataFrame(rows),
            (
                ("cycle", "cycle"), ("readings", f"from the readings, {unit}"),
                ("again", f"from {table_a}, {unit}"),
                ("appendix", f"printed under {table_a}, {unit}"),
                ("chapter", f"printed in {table_b}"), ("same", "same"),
            ),
        )
    ]  # fmt: skip


def _printed_means(
    printed: list[dict[str, Any]], held: str, column: str, isotonic: bool
) -> dict[tuple[str, float], float]:
    """Means of the printed differences by the thesis's rules."""
    groups: dict[tuple[str, float], list[float]] = {}
    for row in printed:
        who = (f"{float(str(row[held])):g}", float(str(row["cycle_max_kpa"])))
        pressure = float(str(row["pressure_kpa"]))
        if isotonic or LOWEST_MEAN_KPA <= pressure < who[1]:
            groups.setdefault(who, []).append(float(str(row[column])))
    return {who: float(np.mean(values)) for who, values in groups.items()}


def _figure(table: pd.DataFrame, cycles: list[Cycle], isotonic: bool) -> Figure:
    from analysis.figures.drawing import COVERAGE, MARKERS, QUIET, new_figure, sequence, style

    value, label = ("length_mm", "length (mm)") if isotonic else ("force_n", "force (N)")
    held = table["mass_kg"] if isotonic else table["set_length_mm"].fillna(table["length_mm"])
    keys = held.astype(float).round(4)
    names = [f"{k:g} {'kg' if isotonic else 'mm'}" for k in sorted(keys.dropna().unique())]
    colours = dict(zip(names, sequence(len(names)), strict=True))
    with style():
        figure, (top, bottom) = new_figure(7.2, 6.4, rows=2, sharex=True)
        for k, name in enumerate(names):
            rows = table[(keys - float(name.split()[0])).abs() < 5e-5]
            named = "up" if (rows["direction"] == "up").any() else "down"
            for direction, part in rows.groupby("direction"):
                down = direction == "down"
                top.errorbar(
                    part["pressure_kpa"], part[value],
                    yerr=COVERAGE * np.nan_to_num(part[f"u_{value}"].astype(float)),
                    fmt=MARKERS[k % len(MARKERS)], color=colours[name], elinewidth=0.7,
                    markersize=5 if down else 3.4, zorder=3 if down else 4,
                    markerfacecolor="white" if down else colours[name],
                    label=name if direction == named else None,
                )  # fmt: skip
                turns = part.get("cycle_max_kpa", part["pressure_kpa"] * 0.0)
                for _, one in part.groupby(turns.astype(float).fillna(0.0)):
                    nominal = one["set_pressure_kpa"].fillna(one["pressure_kpa"].round(0))
                    mean = one[["pressure_kpa", value]].astype(float).groupby(nominal).mean()
                    top.plot(
                        mean["pressure_kpa"], mean[value], color=colours[name], linewidth=0.8,
                        linestyle="--" if down else "-",
                    )  # fmt: skip
        for cycle in cycles:
            k = names.index(cycle.held)
            bottom.errorbar(
                cycle.pressure_kpa, cycle.difference, yerr=COVERAGE * cycle.u_difference,
                fmt=MARKERS[k % len(MARKERS)], markersize=3.4, color=colours[cycle.held],
                linestyle="-" if cycle.top_kpa >= max(c.top_kpa for c in cycles) else ":",
                linewidth=1.0, elinewidth=0.7,
            )  # fmt: skip
        bottom.axhline(0.0, color=QUIET, linewidth=0.8)
        top.set_ylabel(label)
        bottom.set_ylabel(f"rising − falling ({'mm' if isotonic else 'N'})")
        bottom.set_xlabel("pressure (kPa gauge)")
        top.legend(ncols=4, loc="lower center", bbox_to_anchor=(0.5, 1.0), fontsize=8)
        figure.align_ylabels([top, bottom])
    return figure


def _reduce(run: Run) -> Reduction:
    """Settled points with the mass that hung and the turn of the cycle."""
    return reduce_points(run, extra=EXTRA)


def _findings(run: Run, reduction: Reduction) -> Findings:
    """Of both kinds of cycle, each by itself, at the set pressures."""
    hung = reduction.table["mass_kg"].notna()
    parts = []
    for use, value in ((~hung, "force_n"), (hung, "length_mm")):
        table = at_set_pressure(reduction.table[use].reset_index(drop=True), value)
        if len(table) or (value == "force_n" and not hung.any()):
            parts.append(hysteresis_findings(run, replace(reduction, table=table)))
    if len(parts) == 1:
        return parts[0]
    return Findings(
        " ".join(part.headline for part in parts),
        tuple(section for part in parts for section in part.sections),
        {"isometric": parts[0].data, "isotonic": parts[1].data},
    )


def _layout(parameters: Mapping[str, Any]) -> LiveLayout:
    """Its screen."""
    from analysis.layouts.static import hysteresis_layout

    return hysteresis_layout(
        parameters.get("lengths_mm") or (),
        parameters.get("masses_kg") or (),
        max(parameters.get("cycles_kpa") or [600.0]),
    )


HYSTERESIS = Analysis("hysteresis", "Hysteresis test", _reduce, _layout, _findings)
ANALYSES = (HYSTERESIS,)
