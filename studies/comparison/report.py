"""The studies' rows as text for a terminal and as tables for a page."""

from __future__ import annotations

from collections.abc import Sequence

from studies.comparison.pressure import PressureOutcome
from studies.comparison.spread import Outcome, Spread
from studies.comparison.study import MOST_PATH_RMS_MM, MOST_STEADY_DEG
from studies.controllers.laws import TITLES

_COLUMNS = (
    ("rise s", "rise_s", 2),
    ("settle s", "settling_s", 2),
    ("over %", "overshoot_percent", 0),
    ("steady deg", "steady_error_deg", 2),
    ("ripple deg", "ripple_deg", 2),
    ("others deg", "others_error_deg", 2),
    ("circle mm", "rms_mm", 2),
    ("worst mm", "worst_mm", 1),
    ("switch/s", "switchings_per_s", 0),
)
_HEAD = ("valve", "controller", "plant", *(title for title, _, _ in _COLUMNS), "held")
_LEGEND = (
    "Step of 20 degrees of the base flexion: rise 10 to 90 %, settled within 1 degree; over\n"
    "the last second the largest error (steady), the range (ripple), the largest error of\n"
    "another joint (others). Circle: rms and largest distance of the fingertip from its\n"
    "place, after the first turn. switch/s: all valves. - : never. Under the medians, least\n"
    "and largest over the draws of the noise. held: in how many draws it was within\n"
    f"{MOST_STEADY_DEG:g} degree and {MOST_PATH_RMS_MM:g} mm rms without a fault; (payload learnt)."
)


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def _range(figure: Spread, digits: int) -> str:
    """Least to largest as printed; empty where both are printed as the median is."""
    ends = [_number(value, digits) for value in (figure.low, figure.high)]
    return "" if set(ends) == {_number(figure.median, digits)} else " to ".join(ends)


def _held(outcome: Outcome) -> str:
    words = f"{outcome.held} of {outcome.draws}"
    if outcome.faults:
        words += f", {', '.join(outcome.faults)}"
    if outcome.learned_g is not None:
        words += f" ({_number(outcome.learned_g.median, 1)} g)"
    return words


def as_text(outcomes: Sequence[Outcome]) -> str:
    """A table in columns, medians above ranges, with a legend."""
    lines = [list(_HEAD)]
    for o in outcomes:
        found = [(o.figures[key], digits) for _, key, digits in _COLUMNS]
        medians = [_number(figure.median, digits) for figure, digits in found]
        lines.append([o.valve, TITLES[o.law], o.plant, *medians, _held(o)])
        ranges = [_range(figure, digits).replace(" to ", "..") for figure, digits in found]
        if any(ranges):
            lines.append(["", "", "", *ranges, ""])
    return _columns(lines, left=(0, 1, 2, len(_HEAD) - 1)) + "\n\n" + _LEGEND


def as_markdown(outcomes: Sequence[Outcome]) -> str:
    """The same table for a page: median, and in brackets least and largest."""
    rows = []
    for o in outcomes:
        found = [_median_and_range(o.figures[key], digits) for _, key, digits in _COLUMNS]
        rows.append([o.valve, TITLES[o.law], o.plant, *found, _held(o)])
    return _page(list(_HEAD), rows)


def _median_and_range(figure: Spread, digits: int) -> str:
    ends = _range(figure, digits)
    return _number(figure.median, digits) + (f" ({ends})" if ends else "")


def plants_markdown(outcomes: Sequence[Outcome]) -> str:
    """Plants down, laws across: circle rms (mm) and steady error of the step (degrees)."""
    laws = list(dict.fromkeys(o.law for o in outcomes))
    plants = list(dict.fromkeys(o.plant for o in outcomes))
    cells = {(o.plant, o.law): o for o in outcomes}
    rows = []
    for plant in plants:
        row = [plant]
        for law in laws:
            figures = cells[plant, law].figures
            row.append(
                f"{_median_and_range(figures['rms_mm'], 2)} / "
                f"{_median_and_range(figures['steady_error_deg'], 2)}"
            )
        rows.append(row)
    return _page(["plant", *(TITLES[law] for law in laws)], rows)


_PRESSURE_COLUMNS = (
    ("error, mean kPa", "error_mean_kpa", 1),
    ("error, worst kPa", "error_worst_kpa", 1),
    ("ripple kPa", "ripple_worst_kpa", 1),
    ("overshoot kPa", "overshoot_worst_kpa", 1),
    ("settle s", "settling_worst_s", 2),
    ("switch/s", "switchings_per_s", 0),
)


def pressure_text(outcomes: Sequence[PressureOutcome]) -> str:
    """The table of controllers of a pressure, with a legend."""
    lines = [["valve", "scheme", *(title for title, _, _ in _PRESSURE_COLUMNS), ""]]
    for o in outcomes:
        found = [(o.figures[key], digits) for _, key, digits in _PRESSURE_COLUMNS]
        medians = [_number(figure.median, digits) for figure, digits in found]
        lines.append([o.valve, o.law, *medians, ", ".join(o.faults)])
        ranges = [_range(figure, digits).replace(" to ", "..") for figure, digits in found]
        if any(ranges):
            lines.append(["", "", *ranges, ""])
    legend = (
        "Staircase of five set-points, 2 s each, muscle at 62 mm. Error: mean and worst over\n"
        "the steps, of the last half second; ripple (range), overshoot and settling within\n"
        "5 kPa: the worst step. - : a step never settled. Under the medians, least and largest\n"
        "over the draws of the noise."
    )
    return _columns(lines, left=(0, 1, len(lines[0]) - 1)) + "\n\n" + legend


def pressure_markdown(outcomes: Sequence[PressureOutcome]) -> str:
    """The same table for a page."""
    rows = []
    for o in outcomes:
        found = [_median_and_range(o.figures[key], digits) for _, key, digits in _PRESSURE_COLUMNS]
        rows.append([o.valve, f"`{o.law}`", *found])
    return _page(["valve", "scheme", *(title for title, _, _ in _PRESSURE_COLUMNS)], rows)


def _columns(lines: Sequence[Sequence[str]], left: Sequence[int]) -> str:
    width = [max(len(line[k]) for line in lines) for k in range(len(lines[0]))]
    return "\n".join(
        "  ".join(
            cell.ljust(width[k]) if k in left else cell.rjust(width[k])
            for k, cell in enumerate(line)
        ).rstrip()
        for line in lines
    )


def _page(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
