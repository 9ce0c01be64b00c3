"""Findings of a hysteresis test (C-4 to C-7, Tables 4-4 and 4-5, Figures 4-39 and 4-40).

At each set pressure of a cycle: the value at rising pressure minus that at falling pressure. For
each cycle: the mean difference by the rules of the thesis, and the area of the loop, which is
proportional to the energy lost per cycle.

Errors of the calibrations are common to all readings of a loop. The zero of force or length cancels
in each difference. Its gain scales the whole loop. An error of pressure moves all readings along
their branches, and a gain error of pressure also stretches the loop along its axis.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from analysis.figures.wording import from_to
from analysis.findings.findings import (
    BARS,
    EXPANDED,
    Analysis,
    Findings,
    ResultColumns,
    Section,
    as_in,
    max_pressure_kpa,
    source_table,
)
from analysis.layouts.static import hysteresis_layout
from analysis.reduction.points import Reduction, is_imported, reduce_points
from analysis.reduction.setpoint import at_set_pressure
from analysis.regression.force_lines import nominal_kpa
from plant.arrays import Array

if TYPE_CHECKING:
    from collections.abc import Mapping

    import pandas as pd
    from matplotlib.figure import Figure

    from daq.calibration import Calibration
    from daq.store.run import Run

CycleKey = tuple[float, float]
"""Held length (mm) or hung mass (kg), and turning pressure (kPa)."""
LOWEST_MEAN_KPA = 200.0
"""The isometric means of the thesis (Table 4-4) start here and end one step below the turn."""

EXTRA = {"mass_kg": "float64", "cycle_max_kpa": "float64"}


@dataclass(frozen=True)
class Kind:
    """Isometric or isotonic cycles: columns, units, and the tables of the thesis.

    Attributes:
        value, value_unit: the measured quantity.
        held, held_unit: the quantity that is constant.
        label: axis label.
        under: words of the title.
        figure, table, chapter: figure and tables of the thesis.
        rule: the rule of the thesis's means, for the table and for its comparison.
        files: data of the table and of its means; key of the means of the chapter.
        remark: about the comparison.
    """

    value: str
    value_unit: str
    held: str
    held_unit: str
    label: str
    under: str
    figure: str
    table: str
    chapter: str
    rule: tuple[str, str]
    files: tuple[str, str, str, str]
    remark: str

    def held_values(self, table: pd.DataFrame) -> pd.Series:
        """The constant quantity of each row, to 4 decimals."""
        held = table[self.held]
        if self.held == "set_length_mm":
            held = held.fillna(table["length_mm"])
        return held.astype(float).round(4)


ISOMETRIC = Kind(
    "force_n", "N", "set_length_mm", "mm", "force (N)", "at held lengths", "4-39", "C-5", "4-4",
    (
        "The mean is taken from 200 kPa to one step below the turn",
        "means from 200 kPa to one step below the turn, not of whole columns",
    ),
    ("c05_isometric_hysteresis_difference", "force_difference_n", "t4_4",
     "mean_force_difference_n"),
    "Section 4.22 states about 1 % of the total force; the largest differences are 2.3 to 5.6 % of"
    " the range of the cycles to 600 kPa.",
)  # fmt: skip
ISOTONIC = Kind(
    "length_mm", "mm", "mass_kg", "kg", "length (mm)", "under hung loads", "4-40", "C-7", "4-5",
    (
        "The mean is taken over every pressure of the cycle",
        "plain means of its columns",
    ),
    ("c07_isotonic_hysteresis_difference", "length_difference_mm", "t4_5",
     "mean_length_difference_mm_as_printed"),
    "Table 4-5 does not reproduce: it repeats the eight numbers of Table 4-4, which are forces in"
    " newton, in place of the means of Table C-7 in mm. Every difference of Table C-7 is a"
    " multiple of 0.11 mm, one pixel of the camera; the means are about one pixel or less.",
)  # fmt: skip


@dataclass(frozen=True)
class CommonErrors:
    """Standard uncertainties of the calibrations, which all readings of a loop share.

    Attributes:
        u_value_gain: of force or length, relative.
        u_pressure_gain: relative.
        u_pressure_offset_kpa: of the zero of pressure.
        pressure_offset_kpa: pressure at reading zero; gain errors grow from there.
    """

    u_value_gain: float
    u_pressure_gain: float
    u_pressure_offset_kpa: float
    pressure_offset_kpa: float


def common_errors(kind: Kind, calibrations: Mapping[str, Calibration]) -> CommonErrors | None:
    """What the calibrations of a run allow; None if it has none (imported data)."""
    value, pressure = calibrations.get(kind.value), calibrations.get("pressure_kpa")
    if value is None or pressure is None:
        return None
    return CommonErrors(value.u_gain, pressure.u_gain, pressure.u_offset, pressure.offset)


@dataclass(frozen=True)
class Cycle:
    """One cycle of rising and falling pressure.

    Attributes:
        kind: isometric or isotonic.
        held: held length in mm or hung mass in kg.
        top_kpa: pressure at which it turned.
        repeat: number of the replicate.
        pressure_kpa: set pressures with a reading in both directions, increasing.
        difference: value at rising minus value at falling pressure, in N or mm.
        u_noise: standard uncertainty of each difference from noise.
        up: value at rising pressure.
        common: what the calibrations allow; None for imported data.
    """

    kind: Kind
    held: float
    top_kpa: float
    repeat: int
    pressure_kpa: Array
    difference: Array
    u_noise: Array
    up: Array
    common: CommonErrors | None = None

    @property
    def name(self) -> str:
        """The constant quantity as text ("61.9 mm", "1.154 kg")."""
        return f"{self.held:g} {self.kind.held_unit}"

    @property
    def key(self) -> CycleKey:
        """Identifies the cycle in the tables of the thesis."""
        return self.held, self.top_kpa

    @property
    def area(self) -> float:
        """Area of the loop by the trapezoidal rule, in N kPa or mm kPa."""
        return float(np.trapezoid(self.difference, self.pressure_kpa))

    @property
    def u_area(self) -> float:
        """Standard uncertainty of the area: noise, which is independent, and calibrations."""
        x = self.pressure_kpa
        if len(x) < 2:
            return math.nan
        weight = np.zeros(len(x))
        weight[:-1] += np.diff(x) / 2
        weight[1:] += np.diff(x) / 2
        return self._u(weight, stretched=True)

    @property
    def u_difference(self) -> Array:
        """Standard uncertainty of each difference."""
        return np.array([self._u(weight) for weight in np.eye(len(self.difference))])

    def mean(self) -> tuple[float, float]:
        """Mean difference by the rule of the thesis (see ``Kind.rule``), and its uncertainty."""
        use = np.ones(len(self.difference), dtype=bool)
        if self.kind is ISOMETRIC:
            use = (self.pressure_kpa >= LOWEST_MEAN_KPA) & (self.pressure_kpa < self.top_kpa)
        if not use.any():
            return math.nan, math.nan
        return float(self.difference[use].mean()), self._u(use / int(use.sum()))

    def _u(self, weight: Array, stretched: bool = False) -> float:
        """Standard uncertainty of a weighted sum of the differences.

        Args:
            weight: of each difference.
            stretched: the weights are widths in kPa, which a gain error of pressure stretches.
        """
        parts = [float(np.sqrt(np.nansum((weight * self.u_noise) ** 2)))]
        if self.common is not None:
            e, total = self.common, float(weight @ self.difference)
            slope = weight * self._slope()
            by_gain = float(slope @ (self.pressure_kpa - e.pressure_offset_kpa))
            # A gain error changes the loop that is measured between the set pressures, and the
            # area of a given loop. A reader may mean either: the larger one is stated.
            worst = max(abs(by_gain), abs(total) if stretched else 0.0)
            parts += [
                e.u_value_gain * total, e.u_pressure_gain * worst,
                e.u_pressure_offset_kpa * float(slope.sum()),
            ]  # fmt: skip
        return math.hypot(*parts)

    def _slope(self) -> Array:
        """Change of the difference with pressure; 0 at the turn and where the muscle is vented."""
        slope = np.zeros(len(self.difference))
        below = self.pressure_kpa < self.pressure_kpa.max()
        if below.sum() > 1:
            slope[below] = np.gradient(self.difference[below], self.pressure_kpa[below])
        slope[self.pressure_kpa <= 0.0] = 0.0
        return slope


def kind_of(table: pd.DataFrame) -> Kind:
    """Isotonic if loads were hung (lengths differ), isometric if lengths were held."""
    hung = "mass_kg" in table and bool(table["mass_kg"].notna().any())
    return ISOTONIC if hung else ISOMETRIC


def cycles_of(table: pd.DataFrame, calibrations: Mapping[str, Calibration] = {}) -> list[Cycle]:
    """All cycles of a table with readings in both directions.

    If the turning pressure was read once only, its difference is 0, as in Tables C-5 and C-7.

    Args:
        table: settled points.
        calibrations: of the run; without them uncertainties are those of noise alone.
    """
    kind = kind_of(table)
    common = common_errors(kind, calibrations)
    top = table["cycle_max_kpa"] if "cycle_max_kpa" in table else table["pressure_kpa"] * 0.0
    keys = [
        kind.held_values(table).rename("held"),
        top.astype(float).fillna(0.0).rename("top"),
        table["repeat"].rename("repeat"),
    ]
    found = []
    for key, rows in table.assign(nominal=nominal_kpa(table)).groupby(keys, sort=True):
        held, turn, repeat = cast("tuple[float, float, Any]", key)
        up: dict[float, tuple[float, float]] = {}
        down: dict[float, tuple[float, float]] = {}
        for row in rows.to_dict("records"):
            way = {"up": up, "down": down}.get(row["direction"])
            if way is not None and math.isfinite(row[kind.value]):
                reading = float(row[kind.value]), float(row[f"u_{kind.value}_noise"])
                way[float(row["nominal"])] = reading
        if not (up and down):
            continue
        highest = max(up)
        down.setdefault(highest, up[highest])
        both = sorted(set(up) & set(down))
        u = [
            0.0 if p == highest and down[p] == up[p] else math.hypot(up[p][1], down[p][1])
            for p in both
        ]
        found.append(
            Cycle(
                kind,
                float(held),
                float(turn) or highest,
                int(repeat) if str(repeat).isdecimal() else 1,
                np.array(both),
                np.array([up[p][0] - down[p][0] for p in both]),
                np.array(u),
                np.array([up[p][0] for p in both]),
                common,
            )
        )
    return found


def hysteresis_findings(run: Run, reduction: Reduction) -> Findings:
    """Loops, differences, means and areas, compared with those of the thesis."""
    import pandas as pd

    table = reduction.table
    kind = kind_of(table)
    unit = kind.value_unit
    cycles = cycles_of(table, reduction.calibrations)
    rows = []
    for cycle in cycles:
        mean, u_mean = cycle.mean()
        largest, span = float(np.abs(cycle.difference).max()), float(np.ptp(cycle.up))
        rows.append(
            {
                "held": cycle.name, "top": cycle.top_kpa, "repeat": cycle.repeat,
                "mean": mean, "u_mean": u_mean, "largest": round(largest, 3),
                "share": round(100 * mean / span, 2) + 0.0 if span else None,  # no "−0"
                "area": cycle.area, "u_area": cycle.u_area,
            }
        )  # fmt: skip
    dotted = ", dotted for the smaller cycles" if len({c.top_kpa for c in cycles}) > 1 else ""
    sections = [
        Section(
            f"Cycles of rising and falling pressure {kind.under}",
            figure=(lambda: _figure(table, cycles, kind)) if len(table) else None,
            caption=f"Above{as_in(run, f'Figure {kind.figure}')}: rising filled, falling open;"
            f" below: rising minus falling{dotted}. {BARS}",
        ),
        Section(
            "Hysteresis of each cycle",
            (
                f"{kind.rule[0]}; largest is the largest difference at one pressure; share is the"
                " mean in % of the range at rising pressure; area is that of the loop.",
            ),
            pd.DataFrame(rows),
            (
                ("held", "held"), ("top", "turned at, kPa"), ("repeat", "repeat"),
                ("mean", f"mean up − down, {unit}"), ("largest", f"largest, {unit}"),
                ("share", "share, %"), ("area", f"loop area, {unit} kPa"),
            ),
            caption=f"{EXPANDED}, from the noise of the readings"
            + (
                " and from the calibrations: zeros cancel, a gain error scales a whole loop."
                if reduction.calibrations
                else "; no calibration is known."
            ),
        ),
        _differences(cycles, kind),
    ]  # fmt: skip
    if source_table(run) in ("C-4", "C-6"):
        sections.append(_thesis(cycles, kind))
    data = {"isotonic": kind is ISOTONIC, "cycles": rows}
    return Findings(_headline(rows, kind), tuple(sections), data)


def _headline(rows: list[dict[str, Any]], kind: Kind) -> str:
    if not rows:
        return "No cycle was measured in both directions, so there is no result."
    known = [row for row in rows if math.isfinite(row["mean"])]
    if not known:
        cycles = "One cycle was" if len(rows) == 1 else f"{len(rows)} cycles were"
        return f"{cycles} measured, over too few pressures for a mean difference."
    unit, what = kind.value_unit, "length" if kind is ISOTONIC else "force"
    if all(abs(row["mean"]) <= 2 * row["u_mean"] for row in known):
        most = max(abs(row["mean"]) + 2 * row["u_mean"] for row in known)
        return (
            f"At rising and at falling pressure the {what} is the same within its uncertainty: the"
            f" means of each cycle differ by less than {most:.2g} {unit}."
        )
    low, high = (pick(row["mean"] for row in known) for pick in (min, max))
    return (
        f"At rising pressure the {what} is {from_to(low, high)} {unit} above that at falling"
        " pressure (means of the cycles)."
    )


def _differences(cycles: list[Cycle], kind: Kind) -> Section:
    """The form of C-5 and C-7: one row per pressure, one column per cycle."""
    import pandas as pd

    cells: dict[float, dict[str, Any]] = {}
    for k, cycle in enumerate(cycles):
        for p, d, u in zip(cycle.pressure_kpa, cycle.difference, cycle.u_difference, strict=True):
            row = cells.setdefault(float(p), {"pressure_kpa": float(p)})
            row[f"c{k}"], row[f"u_c{k}"] = float(d), float(u)
    heads = [
        (f"c{k}", f"{c.name} to {c.top_kpa:g}, {kind.value_unit}") for k, c in enumerate(cycles)
    ]
    return Section(
        "Rising minus falling",
        (),
        pd.DataFrame([cells[p] for p in sorted(cells)]),
        (("pressure_kpa", "pressure, kPa"), *heads),
    )


def _thesis(cycles: list[Cycle], kind: Kind) -> Section:
    """Tables C-5 and 4-4, or C-7 and 4-5, compared with the readings."""
    import pandas as pd

    from plant.thesis import load

    file, column, chapter_file, chapter_key = kind.files
    held = "mass_kg" if kind is ISOTONIC else "length_mm"

    def number(row: dict[str, Any], name: str) -> float:
        return float(str(row[name]))

    def key(row: dict[str, Any]) -> CycleKey:
        return number(row, held), number(row, "cycle_max_kpa")

    own = {c.key: c for c in cycles}
    printed = load(file)
    off = []
    groups: dict[CycleKey, list[float]] = {}
    for row in printed:
        cycle, pressure = own[key(row)], number(row, "pressure_kpa")
        at = np.flatnonzero(cycle.pressure_kpa == pressure)
        again = round(float(cycle.difference[at[0]]), 2) if len(at) else math.nan
        distance = abs(again - number(row, column))
        if not distance < 0.005:
            off.append(distance)
        if kind is ISOTONIC or LOWEST_MEAN_KPA <= pressure < cycle.top_kpa:
            groups.setdefault(cycle.key, []).append(number(row, column))
    chapter = {key(row): number(row, chapter_key) for row in load(chapter_file)}
    appendix = {key(row): number(row, "mean_as_printed") for row in load(f"{file}_mean")}
    rows = []
    for who, cycle in own.items():
        again = float(np.mean(groups[who]))
        rows.append(
            {
                "cycle": f"{cycle.name} to {cycle.top_kpa:g} kPa",
                "again": round(again, 4),
                "readings": round(cycle.mean()[0], 4),
                "appendix": appendix[who],
                "chapter": chapter[who],
                "same": abs(again - appendix[who]) <= 0.00501,
            }
        )
    unit, agree = kind.value_unit, sum(bool(row["same"]) for row in rows)
    words = (
        f"{agree} of {len(rows)} means under Table {kind.table} follow from its own differences, as"
        f" {kind.rule[1]}. {len(printed) - len(off)} of {len(printed)} differences follow from the"
        f" printed readings; the other {len(off)} differ by at most {max(off, default=0.0):.2f}"
        f" {unit} (digits that were not printed; at the turn there is no reading at falling"
        " pressure)."
    )
    return Section(
        f"Comparison with the thesis: Tables {kind.table} and {kind.chapter}",
        (words, kind.remark),
        pd.DataFrame(rows),
        (
            ("cycle", "cycle"), ("readings", f"from the readings, {unit}"),
            ("again", f"from {kind.table}, {unit}"),
            ("appendix", f"printed under {kind.table}, {unit}"),
            ("chapter", f"printed in {kind.chapter}"), ("same", "same"),
        ),
    )  # fmt: skip


def _figure(table: pd.DataFrame, cycles: list[Cycle], kind: Kind) -> Figure:
    from analysis.figures.drawing import (
        COVERAGE,
        DOUBLE_COLUMN,
        QUIET,
        curve,
        marker,
        new_figure,
        sequence,
        style,
    )

    held = kind.held_values(table)
    values = sorted(held.dropna().unique())
    colours = dict(zip(values, sequence(len(values)), strict=True))
    with style():
        figure, (top, bottom) = new_figure(DOUBLE_COLUMN, 6.4, rows=2, sharex=True)
        for k, value in enumerate(values):
            rows = table[held == value]
            label: str | None = f"{value:g} {kind.held_unit}"
            turns = rows.get("cycle_max_kpa", rows["pressure_kpa"] * 0.0).astype(float).fillna(0.0)
            for (direction, _), part in [*rows.groupby(["direction", turns])][::-1]:
                curve(
                    top, part, ("pressure_kpa", kind.value), nominal_kpa(part), colours[value], k,
                    down=direction == "down", label=label,
                )  # fmt: skip
                label = None
        for cycle in cycles:
            bottom.errorbar(
                cycle.pressure_kpa, cycle.difference, yerr=COVERAGE * cycle.u_difference,
                fmt=marker(values.index(cycle.held)), markersize=3.4, color=colours[cycle.held],
                linestyle="-" if cycle.top_kpa >= max(c.top_kpa for c in cycles) else ":",
                linewidth=1.0, elinewidth=0.7,
            )  # fmt: skip
        bottom.axhline(0.0, color=QUIET, linewidth=0.8)
        top.set_ylabel(kind.label)
        bottom.set_ylabel(f"rising − falling ({kind.value_unit})")
        bottom.set_xlabel("pressure (kPa gauge)")
        top.legend(ncols=4, loc="lower center", bbox_to_anchor=(0.5, 1.0), fontsize=8)
        figure.align_ylabels([top, bottom])
    return figure


def _with_work(
    run: Run, made: Findings, table: pd.DataFrame, calibrations: Mapping[str, Calibration]
) -> Findings:
    """The findings of cycles under loads, with work and efficiency of each."""
    from analysis.findings.muscle.energy import lifting_section

    parameters = run.manifest.get("parameters") or {}
    section, rows = lifting_section(table, parameters, calibrations.get("length_mm"))
    if section is None:
        return made
    data = {**made.data, "energy": rows}
    return replace(made, sections=(*made.sections, section), data=data)


def _findings(run: Run, reduction: Reduction) -> Findings:
    """Findings of both kinds of cycle, each corrected to the set pressures."""
    hung = reduction.table["mass_kg"].notna()
    parts = []
    measured = reduction.table[hung]
    for use, value in ((~hung, "force_n"), (hung, "length_mm")):
        table = at_set_pressure(reduction.table[use].reset_index(drop=True), value)
        if len(table) or (value == "force_n" and not hung.any()):
            made = hysteresis_findings(run, replace(reduction, table=table))
            if value == "length_mm" and not is_imported(run):
                made = _with_work(run, made, measured, reduction.calibrations)
            parts.append(made)
    if len(parts) == 1:
        return parts[0]
    return Findings(
        " ".join(part.headline for part in parts),
        tuple(section for part in parts for section in part.sections),
        {"isometric": parts[0].data, "isotonic": parts[1].data},
    )


HYSTERESIS = Analysis(
    "hysteresis",
    "Hysteresis test",
    partial(reduce_points, extra=EXTRA),
    lambda parameters: hysteresis_layout(
        parameters.get("lengths_mm") or (),
        parameters.get("masses_kg") or (),
        max_pressure_kpa(parameters, "cycles_kpa"),
    ),
    _findings,
    ResultColumns(
        ("force_n", "length_mm"),
        only={"force_n": ("mass_kg", ""), "length_mm": ("set_length_mm", "")},
    ),
)
ANALYSES = (HYSTERESIS,)
