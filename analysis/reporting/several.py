"""One report over several runs: comparison, repeatability, mountings, specimens, control chart."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from analysis.figures.wording import decimals_of, fixed
from analysis.registry import analysis_of
from analysis.reporting.conditions import simulated
from analysis.reporting.page_one import limits_text, method_text
from analysis.reporting.report import acceptance_of, environment, plain_values
from analysis.reporting.results import (
    QUANTITIES,
    SETTINGS,
    At,
    Judged,
    Result,
    chosen,
    judge,
    matches,
    point_groups,
    results_of,
    rounded,
    setting_text,
)
from analysis.run_table import contents_of, record_findings, reduce_run
from analysis.statistics.components import Components, variance_components
from analysis.statistics.conformity import overall
from analysis.statistics.control_chart import RULES, ControlChart, control_chart
from daq.errors import ConfigError

if TYPE_CHECKING:
    from analysis.reduction.points import Reduction
    from daq.store.run import Run

SCHEMA = "pamrig-comparison/1"
COLUMNS_MOST = 4
"""Quantities on page one; all are under Details."""
CHARTS_MOST = 2
LETTERS = "abcdefghijklmnopqrstuvwxyz"
FEWEST_CHARTED = 3

Key = tuple[str, At]


@dataclass(frozen=True)
class Tested:
    """One run of a comparison.

    Attributes:
        number: from 1, in order of time.
        run: the run.
        reduction: its table.
        results: its results by quantity and settings.
        judged: its results with limits.
        method: its method in one line.
    """

    number: int
    run: Run
    reduction: Reduction
    results: Mapping[Key, Result]
    judged: tuple[Judged, ...]
    method: str

    @property
    def specimen(self) -> str:
        """What was tested."""
        return str(self.run.manifest.get("specimen") or "not stated")

    @property
    def date(self) -> str:
        """Day and time of its start, UTC."""
        utc = str((self.run.manifest.get("started") or {}).get("utc") or "")
        return utc[:16].replace("T", " ") or "not stated"

    @property
    def mountings(self) -> list[str]:
        """Names of the mountings in it."""
        return list(dict.fromkeys(str(m) for m in self.reduction.table.get("mounting", ())))


@dataclass(frozen=True)
class Compared:
    """One quantity at one setting over all runs that have it.

    Attributes:
        key: quantity and settings.
        numbers: of the runs, in order of time.
        results: of these runs.
        components: from every single point.
        chart: of the means of the runs; None with fewer than three.
    """

    key: Key
    numbers: tuple[int, ...]
    results: tuple[Result, ...]
    components: Components
    chart: ControlChart | None

    @property
    def name(self) -> str:
        """Quantity and settings in words."""
        quantity, at = self.key
        words = (QUANTITIES.get(quantity, (quantity, ""))[0], *(setting_text(k, v) for k, v in at))
        return ", ".join(words)

    @property
    def unit(self) -> str:
        """Unit of the quantity."""
        return QUANTITIES.get(self.key[0], ("", ""))[1]

    @property
    def decimals(self) -> int:
        """Decimals of its values: two digits of the smallest expanded uncertainty."""
        known = [r.mean.expanded for r in self.results if r.mean.expanded > 0.0]
        spread = min(known, default=abs(self.components.mean) / 100 or 1e-3)
        return decimals_of(spread)

    def as_dict(self) -> dict[str, Any]:
        """Plain values for --json."""
        chart = None
        if self.chart is not None:
            series = {"values": self.chart.values.tolist(), "ranges": self.chart.ranges.tolist()}
            chart = {**vars(self.chart), **series, "rules": RULES}
        return {
            "quantity": self.key[0], "unit": self.unit, "at": dict(self.key[1]),
            "runs": [{"number": number, **result.as_dict()}
                     for number, result in zip(self.numbers, self.results, strict=True)],
            "components": asdict(self.components), "chart": chart,
        }  # fmt: skip


@dataclass(frozen=True)
class Comparison:
    """Several runs of one protocol, in order of time, and what they have in common."""

    title: str
    runs: tuple[Tested, ...]
    compared: tuple[Compared, ...]
    notes: tuple[str, ...]

    @property
    def shown(self) -> list[Compared]:
        """The quantities of page one."""
        wanted = chosen([one.results[0] for one in self.compared], COLUMNS_MOST)
        keys = {(r.quantity, r.at) for r in wanted}
        return [one for one in self.compared if one.key in keys]

    @property
    def charted(self) -> list[Compared]:
        """The quantities whose control chart is drawn: the last of those of page one."""
        return [one for one in self.shown if one.chart is not None][-CHARTS_MOST:]


def compare_runs(
    runs: Sequence[Run],
    *,
    at: Mapping[str, float | str] | None = None,
    base: int | None = None,
    stated: tuple[float, float] | None = None,
) -> Comparison:
    """Compare runs of one protocol.

    Each run counts as a mounting of its own, and so does each mounting within it.

    Args:
        runs: two or more; their order does not matter.
        at: settings to which the comparison is restricted; a key "quantity" names a quantity.
        base: limits of the control charts are from the first ``base`` runs; None: from all.
        stated: centre and standard deviation of the control chart; for one quantity only.

    Raises:
        ConfigError: the runs are of different protocols or one is given twice, nothing is common
            to two of them, or the limits do not fit the runs.
        RecordError: a run is damaged.
    """
    names = sorted({str(run.manifest.get("protocol")) for run in runs})
    if len(names) > 1:
        raise ConfigError("report", f"the runs are of different tests: {', '.join(names)}",
                          "compare runs of one protocol")  # fmt: skip
    ids = [run.run_id for run in runs]
    twice = next((name for name in ids if ids.count(name) > 1), "")
    if twice:
        raise ConfigError("report", f"{twice} is given twice", "name each run once")
    kind = analysis_of(runs[0].manifest.get("protocol"))
    ordered = sorted(runs, key=lambda r: str((r.manifest.get("started") or {}).get("utc")))
    tested = []
    for number, run in enumerate(ordered, start=1):
        reduction = reduce_run(run)
        with contents_of(run):
            results = results_of(reduction, kind.results)
            judged = tuple(judge(results, acceptance_of(run)))
            method = method_text(run.manifest)
        tested.append(
            Tested(number, run, reduction, {(r.quantity, r.at): r for r in results}, judged, method)
        )
    keys = [
        key
        for key in dict.fromkeys(key for one in tested for key in one.results)
        if sum(key in one.results for one in tested) > 1 and _wanted(key, at or {})
    ]
    if not keys:
        raise ConfigError("report", "no result at one setting is common to two of these runs"
                          + (" and to --at" if at else ""),
                          "compare runs with equal settings")  # fmt: skip
    if stated is not None and len(keys) > 1:
        raise ConfigError("--chart-limits", f"is for one quantity, and {len(keys)} are common to"
                          " these runs", "choose one with --at")  # fmt: skip
    groups = [point_groups(one.reduction, kind.results) for one in tested]
    compared = tuple(_compare(key, tested, groups, base, stated) for key in keys)
    return Comparison(kind.title, tuple(tested), compared, tuple(_notes(tested)))


def _wanted(key: Key, at: Mapping[str, float | str]) -> bool:
    quantity, settings = key
    return at.get("quantity", quantity) == quantity and matches(
        dict(settings), {k: v for k, v in at.items() if k != "quantity"}
    )


def _compare(
    key: Key, tested: Sequence[Tested], groups: Sequence[Mapping[Key, Any]], base: int | None,
    stated: tuple[float, float] | None,
) -> Compared:  # fmt: skip
    there = [one for one in tested if key in one.results]
    values: list[float] = []
    specimens: list[str] = []
    mountings: list[tuple[int, str]] = []
    for one in there:
        points = groups[one.number - 1][key]
        values += points[key[0]].to_list()
        specimens += [one.specimen] * len(points)
        mountings += [(one.number, str(name)) for name in points["mounting"]]
    means = [one.results[key].mean.mean for one in there]
    chart = None
    if len(means) >= FEWEST_CHARTED or stated is not None:
        if base is not None and not 2 <= base <= len(means):
            raise ConfigError("--base", f"{base} of {len(means)} runs", f"2 to {len(means)}")
        chart = control_chart(means, base, stated)
    return Compared(
        key, tuple(one.number for one in there), tuple(one.results[key] for one in there),
        variance_components(values, specimens, mountings), chart,
    )  # fmt: skip


def _notes(tested: Sequence[Tested]) -> list[str]:
    """What differs between the runs besides specimen, mounting and date."""
    notes = []
    methods = {one.method for one in tested}
    if len(methods) > 1:
        notes.append(
            f"the runs were made by {len(methods)} different methods: "
            + " | ".join(sorted(methods))
        )
    names = dict.fromkeys(name for one in tested for name in one.reduction.calibrations)
    for name in names:
        used = dict.fromkeys(
            c.id or "no certificate named"
            for one in tested
            if (c := one.reduction.calibrations.get(name)) is not None
        )
        if len(used) > 1:
            notes.append(f"{name} has {len(used)} calibrations: {', '.join(used)}")
    for one in tested:
        if one.run.outcome != "clean":
            notes.append(f"run {one.number} is {one.run.outcome}")
        notes += [f"run {one.number}: the record: {text}" for text in record_findings(one.run)]
    return notes


def comparison_json(found: Comparison) -> dict[str, Any]:
    """The comparison as plain values; unknown ones are null."""
    plain: dict[str, Any] = plain_values(
        {
            "schema": SCHEMA,
            "title": found.title,
            "runs": [
                {
                    "number": one.number,
                    "run_id": one.run.run_id,
                    "specimen": one.specimen,
                    "mountings": one.mountings,
                    "operator": one.run.manifest.get("operator") or None,
                    "started_utc": (one.run.manifest.get("started") or {}).get("utc"),
                    "outcome": one.run.outcome,
                    "simulated": simulated(one.run),
                    "verdict": overall([j.verdict for j in one.judged]) or None,
                }
                for one in found.runs
            ],
            "quantities": [one.as_dict() for one in found.compared],
            "notes": list(found.notes),
        }
    )
    return plain


def render_comparison(found: Comparison) -> str:
    """The comparison as one self-contained HTML page."""
    from analysis.figures.comparison import chart_figure, overlay_figure
    from analysis.reporting.sections import figure_parts

    marked = [one for one in found.runs if simulated(one.run)]
    html: str = (
        environment()
        .get_template("several.html.j2")
        .render(
            c=found,
            headline=headline(found),
            marked=len(marked),
            first=_page_one(found),
            statistics=_statistics(found.shown),
            all_statistics=_statistics(found.compared)
            if len(found.shown) < len(found.compared)
            else None,
            overlay=figure_parts(overlay_figure(curves_of(found))),
            charts=[
                (one, figure_parts(chart_figure(*chart_data(found, one))), chart_sentence(one))
                for one in found.charted
            ],
            rules=RULES,
        )
    )  # fmt: skip
    return html


def headline(found: Comparison) -> str:
    """The result of the last quantity of page one in one sentence."""
    one = found.shown[-1]
    c = one.components
    parts = [
        f"{name} {fixed(part.sd, one.decimals + 1)} {one.unit}".strip()
        for name, part in (
            ("repeatability", c.repeatability), ("between mountings", c.mounting),
            ("between specimens", c.specimen),
        )
        if math.isfinite(part.sd)
    ]  # fmt: skip
    spread = f"; standard deviations: {', '.join(parts)}" if parts else ""
    text = f"{one.name}: {fixed(c.mean, one.decimals)} {one.unit}".strip()
    return f"{text[:1].upper()}{text[1:]}, mean of {c.n} tests in {len(one.numbers)} runs{spread}."


def _page_one(found: Comparison) -> dict[str, Any]:
    shown = found.shown
    limits = any(one.judged for one in found.runs)
    rows = []
    for one in found.runs:
        cells = []
        for compared in shown:
            result = one.results.get(compared.key)
            cells.append("–" if result is None else _with_u(result))
        rows.append({
            "number": one.number, "date": one.date, "specimen": one.specimen,
            "mountings": ", ".join(one.mountings), "cells": cells,
            "verdict": overall([j.verdict for j in one.judged]) or "–",
        })  # fmt: skip
    stated = dict.fromkeys((j.quantity, j.lower, j.upper) for one in found.runs for j in one.judged)
    return {
        "heads": [(one.name, one.unit) for one in shown], "rows": rows, "limits": limits,
        "method": found.runs[0].method,
        "limits_text": "; ".join(
            f"{QUANTITIES.get(q, (q, ''))[0]} {limits_text(a, b, QUANTITIES.get(q, ('', ''))[1])}"
            for q, a, b in stated
        ),
    }  # fmt: skip


def _with_u(result: Result) -> str:
    text = rounded(result.mean)
    known = text["expanded"] != "–"
    return f"{text['mean']} ± {text['expanded']}" if known else text["mean"]


def _statistics(compared: Sequence[Compared]) -> dict[str, Any]:
    """Rows of standard deviations, and their remarks once each, by letter."""
    remarks: dict[str, str] = {}
    rows = []
    for one in compared:
        c = one.components
        cells = []
        for what, part in (
            ("Repeatability", c.repeatability), ("Between mountings", c.mounting),
            ("Between specimens", c.specimen),
        ):  # fmt: skip
            mark = ""
            if part.remark:
                text = f"{what}: {part.remark}."
                mark = remarks.setdefault(text, LETTERS[len(remarks) % len(LETTERS)])
            sd = fixed(part.sd, one.decimals + 1) if math.isfinite(part.sd) else "–"
            cells.append({"text": f"{sd} ({part.dof})" if part.dof else sd, "mark": mark})
        total = fixed(c.total, one.decimals + 1) if math.isfinite(c.total) else "–"
        rows.append({"name": one.name, "unit": one.unit, "n": c.n, "cells": cells, "total": total,
                     "mean": fixed(c.mean, one.decimals)})  # fmt: skip
    return {"rows": rows, "remarks": [(mark, text) for text, mark in remarks.items()]}


def chart_sentence(one: Compared) -> str:
    """What the control chart of a quantity says, in one or two sentences."""
    chart = one.chart
    assert chart is not None
    limits = (
        f"Centre {fixed(chart.centre, one.decimals)}, limits"
        f" {fixed(chart.lower, one.decimals)} to {fixed(chart.upper, one.decimals)}"
        f" {one.unit} ({chart.remark})."
    )
    if chart.in_control:
        return f"{limits} No rule is broken."
    said = [
        f"{RULES[rule]} (run {', '.join(str(one.numbers[i]) for i in at)})"
        for rule, at in chart.alarms.items()
    ]
    return f"{limits} Broken: {'; '.join(said)}."


def chart_data(
    found: Comparison, one: Compared
) -> tuple[ControlChart, list[str], npt.NDArray[np.float64], str]:
    """Chart, labels of the runs, expanded uncertainties and the label of its axis."""
    assert one.chart is not None
    days = {t.number: t.date[:10] for t in found.runs}
    shown = [days[number] for number in one.numbers]
    labels = [
        f"{number}\n{day}" if i == 0 or day != shown[i - 1] else str(number)
        for i, (number, day) in enumerate(zip(one.numbers, shown, strict=True))
    ]
    u = np.array([r.mean.expanded for r in one.results])
    name = QUANTITIES.get(one.key[0], (one.key[0], ""))[0]
    return one.chart, labels, u, f"{name} ({one.unit})"


def curves_of(found: Comparison) -> dict[str, Any]:
    """Curves of every run over the setting that has most levels, for the figure.

    Of one quantity, with rising pressures only where there are both.
    """
    quantity = found.shown[-1].key[0]
    every = [one for one in found.compared if one.key[0] == quantity]
    rising = [one for one in every if ("direction", "up") in one.key[1]]
    every = rising or every
    levels: dict[str, set[float]] = {}
    for one in every:
        for name, value in one.key[1]:
            if isinstance(value, float):
                levels.setdefault(name, set()).add(value)
    over = max(levels, key=lambda name: len(levels[name]), default="")
    curves: dict[tuple[int, At], list[tuple[float, float, float, float]]] = {}
    for one in every:
        at = dict(one.key[1])
        rest = tuple((k, v) for k, v in one.key[1] if k != over)
        middle = float(np.mean([r.mean.mean for r in one.results]))
        for number, result in zip(one.numbers, one.results, strict=True):
            place = float(at.get(over, 0.0)) if over else 0.0
            curves.setdefault((number, rest), []).append(
                (place, result.mean.mean, result.mean.expanded, result.mean.mean - middle)
            )
    name, unit = SETTINGS.get(over, ("", ""))
    return {
        "x_label": f"{name} ({unit})" if unit else name,
        "y_label": f"{QUANTITIES.get(quantity, (quantity, ''))[0]} ({found.shown[-1].unit})",
        "curves": curves,
        "names": {t.number: f"{t.number}: {t.specimen}, {t.date[:10]}" for t in found.runs},
        "specimens": {one.number: one.specimen for one in found.runs},
    }  # fmt: skip
