"""The study's rows as text, and its verdict in words."""

from __future__ import annotations

from rigs.controllers.laws import TITLES
from rigs.controllers.pressure import PressureFigures
from rigs.controllers.study import MOST_PATH_RMS_MM, MOST_STEADY_DEG, Row

_HEAD = (
    "valve",
    "controller",
    "plant",
    "rise s",
    "settle s",
    "over %",
    "steady deg",
    "ripple deg",
    "others deg",
    "circle mm",
    "worst mm",
    "switch/s",
    "",
)


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def cells(row: Row) -> list[str]:
    """One row as text, in the order of the heading."""
    s, p = row.step, row.path
    faults = sorted({fault.split(": ")[1] for fault in (*s.faults, *p.faults)})
    note = "holds" if row.accepted else ", ".join(faults)
    if row.learned_g is not None:
        note = f"{note} ({row.learned_g:.1f} g)".strip()
    return [
        row.valve,
        TITLES[row.law],
        row.case,
        _number(s.rise_s, 2),
        _number(s.settling_s, 2),
        _number(s.overshoot_percent, 0),
        _number(s.steady_error_deg, 2),
        _number(s.ripple_deg, 2),
        _number(s.others_error_deg, 2),
        _number(p.rms_mm, 2),
        _number(p.worst_mm, 1),
        _number((s.switchings_per_s + p.switchings_per_s) / 2.0, 0),
        note,
    ]


def as_text(rows: list[Row]) -> str:
    """A table in columns, with a legend."""
    lines = [list(_HEAD), *[cells(row) for row in rows]]
    width = [max(len(line[k]) for line in lines) for k in range(len(_HEAD))]
    left = (0, 1, 2, len(_HEAD) - 1)
    text = [
        "  ".join(
            cell.ljust(width[k]) if k in left else cell.rjust(width[k])
            for k, cell in enumerate(line)
        ).rstrip()
        for line in lines
    ]
    legend = (
        "\nStep of 20 degrees of the base flexion: rise 10 to 90 %, settled within 1 degree; over\n"
        "the last second the largest error (steady), the range (ripple), the largest error of\n"
        "another joint (others). Circle: rms and largest distance of the fingertip from its\n"
        "place, after the first turn. switch/s: all valves.\n"
        f"holds: within {MOST_STEADY_DEG:g} degree and {MOST_PATH_RMS_MM:g} mm rms, no fault. "
        "- : never."
    )
    return "\n".join(text) + "\n" + legend


def as_markdown(rows: list[Row]) -> str:
    """The same table for a page."""
    lines = [
        "| " + " | ".join(_HEAD) + " |",
        "|" + "---|" * len(_HEAD),
        *["| " + " | ".join(cells(row)) + " |" for row in rows],
    ]
    return "\n".join(lines)


def pressure_cells(row: PressureFigures) -> list[str]:
    """One row of the pressure's table as text."""
    return [
        row.valve,
        row.law,
        _number(row.error_mean_kpa, 1),
        _number(row.error_worst_kpa, 1),
        _number(row.ripple_worst_kpa, 1),
        _number(row.overshoot_worst_kpa, 1),
        _number(row.settling_worst_s, 2),
        _number(row.switchings_per_s, 0),
        row.fault,
    ]


def pressure_text(rows: list[PressureFigures]) -> str:
    """The table of controllers of a pressure, with a legend."""
    head = [
        "valve",
        "scheme",
        "error kPa",
        "worst",
        "ripple",
        "overshoot",
        "settle s",
        "switch/s",
        "",
    ]
    lines = [head, *map(pressure_cells, rows)]
    width = [max(len(line[k]) for line in lines) for k in range(len(head))]
    text = [
        "  ".join(
            cell.ljust(width[k]) if k in (0, 1, 8) else cell.rjust(width[k])
            for k, cell in enumerate(line)
        ).rstrip()
        for line in lines
    ]
    legend = (
        "\nStaircase of five set-points, 2 s each, muscle at 62 mm. Error: mean and worst over\n"
        "the steps, of the last half second; ripple (range), overshoot and settling within\n"
        "5 kPa: the worst step. - : a step never settled."
    )
    return "\n".join(text) + "\n" + legend
