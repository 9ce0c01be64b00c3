"""Results of the studies as text for a terminal and as Markdown tables."""

from __future__ import annotations

from collections.abc import Sequence

from studies.comparison.pressure import PressureOutcome
from studies.comparison.spread import Outcome, Spread
from studies.comparison.study import MOST_PATH_RMS_MM, MOST_STEADY_DEG
from studies.controllers.laws import TITLES

Columns = Sequence[tuple[str, str, int]]
"""Heading, key and digits of each figure."""

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
    "reference, after the first turn. switch/s: all valves. - : not reached. Below the\n"
    "medians: lowest and highest over the noise realizations. held: number of these within\n"
    f"{MOST_STEADY_DEG:g} degree and {MOST_PATH_RMS_MM:g} mm rms, no fault; (payload learned)."
)


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def _range(figure: Spread, digits: int) -> str:
    """Lowest to highest as printed; empty if both are printed like the median."""
    ends = [_number(value, digits) for value in (figure.low, figure.high)]
    return "" if set(ends) == {_number(figure.median, digits)} else " to ".join(ends)


def _held(outcome: Outcome) -> str:
    words = f"{outcome.held} of {outcome.draws}"
    if outcome.faults:
        words += f", {', '.join(outcome.faults)}"
    if outcome.learned_g is not None:
        words += f" ({_number(outcome.learned_g.median, 1)} g)"
    return words


def _text(
    head: Sequence[str],
    rows: Sequence[tuple[list[str], dict[str, Spread], str]],
    columns: Columns,
    legend: str,
) -> str:
    """A table in columns, medians above ranges, with a legend.

    Args:
        head: headings.
        rows: names, figures and last cell of each row.
        columns: heading, key and digits of each figure.
        legend: explanation of the figures.
    """
    lines = [list(head)]
    for names, figures, last in rows:
        found = [(figures[key], digits) for _, key, digits in columns]
        medians = [_number(figure.median, digits) for figure, digits in found]
        lines.append([*names, *medians, last])
        ranges = [_range(figure, digits).replace(" to ", "..") for figure, digits in found]
        if any(ranges):
            lines.append([*[""] * len(names), *ranges, ""])
    left = (*range(len(head) - len(columns) - 1), len(head) - 1)
    return _columns(lines, left) + "\n\n" + legend


def _cells(figures: dict[str, Spread], columns: Columns) -> list[str]:
    """Median of each figure, with lowest and highest in brackets."""
    return [_median_and_range(figures[key], digits) for _, key, digits in columns]


def _median_and_range(figure: Spread, digits: int) -> str:
    ends = _range(figure, digits)
    return _number(figure.median, digits) + (f" ({ends})" if ends else "")


def as_text(outcomes: Sequence[Outcome]) -> str:
    """The table of finger controllers as text."""
    rows = [([o.valve, TITLES[o.law], o.plant], o.figures, _held(o)) for o in outcomes]
    return _text(_HEAD, rows, _COLUMNS, _LEGEND)


def as_markdown(outcomes: Sequence[Outcome]) -> str:
    """The table of finger controllers as Markdown."""
    rows = [
        [o.valve, TITLES[o.law], o.plant, *_cells(o.figures, _COLUMNS), _held(o)] for o in outcomes
    ]
    return _page(_HEAD, rows)


def plants_markdown(outcomes: Sequence[Outcome]) -> str:
    """One row per plant, one column per law: circle rms (mm) / steady error of the step (deg)."""
    laws = list(dict.fromkeys(o.law for o in outcomes))
    figures = {(o.plant, o.law): o.figures for o in outcomes}
    keys = (("", "rms_mm", 2), ("", "steady_error_deg", 2))
    rows = [
        [plant, *(" / ".join(_cells(figures[plant, law], keys)) for law in laws)]
        for plant in dict.fromkeys(o.plant for o in outcomes)
    ]
    return _page(["plant", *(TITLES[law] for law in laws)], rows)


_PRESSURE_COLUMNS = (
    ("error, mean kPa", "error_mean_kpa", 1),
    ("error, worst kPa", "error_worst_kpa", 1),
    ("ripple kPa", "ripple_worst_kpa", 1),
    ("overshoot kPa", "overshoot_worst_kpa", 1),
    ("settle s", "settling_worst_s", 2),
    ("switch/s", "switchings_per_s", 0),
)
_PRESSURE_HEAD = ("valve", "scheme", *(title for title, _, _ in _PRESSURE_COLUMNS))
_PRESSURE_LEGEND = (
    "Staircase of five set-points, 2 s each, muscle at 62 mm. Error: mean and worst over\n"
    "the steps, of the last half second; ripple (range), overshoot and settling within\n"
    "5 kPa: the worst step. - : a step did not settle. Below the medians: lowest and highest\n"
    "over the noise realizations."
)


def pressure_text(outcomes: Sequence[PressureOutcome]) -> str:
    """The table of pressure controllers as text."""
    rows = [([o.valve, o.law], o.figures, ", ".join(o.faults)) for o in outcomes]
    return _text((*_PRESSURE_HEAD, ""), rows, _PRESSURE_COLUMNS, _PRESSURE_LEGEND)


def pressure_markdown(outcomes: Sequence[PressureOutcome]) -> str:
    """The table of pressure controllers as Markdown."""
    rows = [[o.valve, f"`{o.law}`", *_cells(o.figures, _PRESSURE_COLUMNS)] for o in outcomes]
    return _page(_PRESSURE_HEAD, rows)


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
