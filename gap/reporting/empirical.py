"""An empirical term for people: what a gap without a name looks like, in lines and as a figure."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from gap.verdict import EmpiricalTerm, TermCourse, Verdict
from plant.effects.empirical import SHIFTS_S, SplineTerm

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BLUE, QUIET = "#0072B2", "#8a8a8a"  # Okabe and Ito
INPUT_TEXT = {
    "pressure_kpa": "pressure, kPa", "length_mm": "length, mm", "velocity_mm_s": "velocity, mm/s",
    "pressure_rate_kpa_s": "pressure rate, kPa/s", "temperature_c": "temperature, °C",
    "order": "order of the trial", "time_s": "time in the trial, s",
    "since_edge_s": "time since a valve's command, s", "valve": "valve open: outlet -1, inlet 1",
    "openings": "openings of a valve so far",
    "slip": "slip since the last turn, -1 to 1",
    "change_1s_kpa": "pressure beyond its mean over 1 s, kPa",
    "change_10s_kpa": "pressure beyond its mean over 10 s, kPa",
    "pull_change_1s_n": "pull beyond its mean over 1 s, N",
    "pull_change_10s_n": "pull beyond its mean over 10 s, N",
    "pull_change_100s_n": "pull beyond its mean over 100 s, N",
    **{
        name: f"length {1e3 * s:.0f} ms later, less that now, mm" if s > 0.0
        else f"length now, less that {-1e3 * s:.0f} ms before, mm"
        for name, s in SHIFTS_S.items()
    },
}  # fmt: skip
_SCALED = {
    "pull": "share of the pull",
    "pull_per_kpa": "error of the pressure, kPa",
    "pull_per_mm": "error of the length, mm",
    "flow": "flow into the chamber, mg/s",
    "valve_flow": "share of the valve's flow",
    "inlet_flow": "share of the inlet's flow",
    "outlet_flow": "share of the outlet's flow",
    "inlet_on_ms": "inlet opens late, ms",
    "inlet_off_ms": "inlet shuts late, ms",
    "outlet_on_ms": "outlet opens late, ms",
    "outlet_off_ms": "outlet shuts late, ms",
    "opens_ms": "both valves open late, ms",
    "shuts_ms": "both valves shut late, ms",
    "edges_ms": "all commands act late, ms",
    "short_pulses": "share of short commands that passes",
    "supply": "supply higher than stated, kPa",
    "reading": "gauge shows too much, kPa",
    "cell": "force cell shows too much, N",
    "cell_gain": "force cell shows too much, share of the pull",
    "seen": "camera shows too much, mm",
}
_KINDS = {
    "": "an addition",
    "pull": "a change in proportion to the pull",
    "pull_per_kpa": "an error of the pressure",
    "pull_per_mm": "an error of the length",
    "flow": "a flow into the chamber",
    "valve_flow": "a change in proportion to the valve's flow",
    "inlet_flow": "a change in proportion to the inlet's flow",
    "outlet_flow": "a change in proportion to the outlet's flow",
    "inlet_on_ms": "an inlet that opens late or early",
    "inlet_off_ms": "an inlet that shuts late or early",
    "outlet_on_ms": "an outlet that opens late or early",
    "outlet_off_ms": "an outlet that shuts late or early",
    "opens_ms": "valves that both open late or early",
    "shuts_ms": "valves that both shut late or early",
    "edges_ms": "valves that all act late or early",
    "short_pulses": "commands that pass although they are too short for their valve",
    "supply": "a supply that is not at its pressure",
    "reading": "an error of the gauge's reading",
    "cell": "an error of the force cell's reading",
    "cell_gain": "an error of the force cell in proportion to its reading",
    "seen": "an error of the length that the camera reads",
}


_TOLD_BY = "without it the other slots show no gap; measure more of its kind"


def empirical_lines(verdict: Verdict) -> list[str]:
    """The term of a verdict in lines; none without a term."""
    term = verdict.empirical
    if term is None:
        return []
    shares = ", ".join(f"{name} {100 * share:.0f} %" for name, share in term.shares.items())
    shares = shares or "no input"
    lines = [
        f"looks like  {_kind(term)}, in the {term.correction.block} channel; depends on {shares}",
        f"  closes    {100 * term.closed:.0f} % ({100 * term.closed_low:.0f} to "
        f"{100 * term.closed_high:.0f}) on slots held out: {term.recalibrated:.3g} -> "
        f"{term.after:.3g}, floor {term.floor:.3g} {term.unit}",
    ]
    if term.told_by:
        lines.append(f"  told by   slot {term.told_by} alone, which is not counted: {_TOLD_BY}")
    lines += [f"  amount    {one}" for one in _amounts(term)]
    if _domain(term):
        lines.append(f"  domain    {'; '.join(_ends(name, ends) for name, ends in _domain(term))}")
    if term.expression is not None:
        lines.append(f"  formula   {term.expression.text}")
    return lines + [f"  near      {one}" for one in term.nearest]


def empirical_sentences(verdict: Verdict) -> list[str]:
    """The same for a page; none without a term."""
    term = verdict.empirical
    if term is None:
        return []
    shares = ", ".join(f"{name} ({100 * share:.0f} %)" for name, share in term.shares.items())
    shares = shares or "no input"
    ends = "; ".join(_ends(name, ends) for name, ends in _domain(term))
    made = [
        f"What has no name looks like {_kind(term)} in the {term.correction.block} channel, and "
        f"depends on {shares}.",
        f"A term learnt from it closes {100 * term.closed:.0f} % of the gap above the floor "
        f"({100 * term.closed_low:.0f} to {100 * term.closed_high:.0f} %) on slots held out: "
        f"{term.recalibrated:.3g} {term.unit} become {term.after:.3g} {term.unit}, the floor is "
        f"{term.floor:.3g} {term.unit}.{f' It holds for {ends}.' if ends else ''}",
    ]
    if term.told_by:
        made.append(f"Slot {term.told_by} alone tells of it and is not counted: {_TOLD_BY}.")
    if _amounts(term):
        made.append(f"What is the same everywhere: {'; '.join(_amounts(term))}.")
    if term.rate_share >= _SHOWN:
        made.append(f"{100 * term.rate_share:.0f} % of it depends on a rate.")
    if term.expression is not None:
        made.append(f"A formula does nearly as well: {term.expression.text}.")
    if term.nearest:
        made.append(f"Nearest entries: {'; '.join(map(str, term.nearest))}.")
    return made


_SHOWN = 0.01


def _amounts(term: EmpiricalTerm) -> list[str]:
    """Parts that are the same everywhere, such as "outlet shuts late 4.9 ms"."""
    made = []
    for one in term.correction.terms:
        if not one.inputs:
            what, _, unit = _SCALED.get(one.scale, f"addition, {term.unit}").partition(", ")
            made.append(f"{what} {one.coefficients[0]:.3g} {unit}".strip())
    return made


def _domain(term: EmpiricalTerm) -> list[tuple[str, tuple[float, float]]]:
    return list(term.correction.domain.items())


def _ends(name: str, ends: tuple[float, float]) -> str:
    what, _, unit = INPUT_TEXT[name].partition(", ")
    scale = f"{ends[0]:.4g} to {ends[1]:.4g}"
    # Pure numbers say their range in the text already, for the figure.
    what, unit = what.split(":")[0], "" if any(c.isdigit() for c in unit) else unit
    return f"{what} {scale} {unit}".strip()


def _kind(term: EmpiricalTerm) -> str:
    """What the terms are errors of."""
    used = dict.fromkeys((t.scale, _repeats(t)) for t in term.correction.terms)
    return " and ".join(_KINDS[scale] + repeats for scale, repeats in used)


def _repeats(term: SplineTerm) -> str:
    """How a part repeats, such as " that repeats every 0.13 s"; nothing where it does not."""
    if not term.period:
        return ""
    _, _, unit = INPUT_TEXT[term.inputs[0]].partition(", ")
    return f" that repeats every {term.period:.3g} {unit}".rstrip()


def empirical_figure(term: EmpiricalTerm | None) -> Figure | None:
    """Curves with their 95 % bands, and maps with the band's half-width beside them."""
    from matplotlib import pyplot

    if term is None or not term.courses:
        return None
    panels = sum(len(course.inputs) for course in term.courses if course.inputs)
    if not panels:
        return None
    made = pyplot.subplots(
        1, panels, figsize=(0.6 + 3.0 * panels, 2.7), squeeze=False, layout="constrained"
    )
    figure: Figure = made[0]
    axes: Any = made[1][0]
    pyplot.close(figure)
    place = 0
    for course in term.courses:
        unit = _SCALED.get(course.scale, f"{term.correction.block}, {term.unit}")
        if len(course.inputs) == 1:
            _curve(axes[place], course, unit)
        elif len(course.inputs) == 2:
            _map(figure, axes[place], course, course.value, unit)
            _map(figure, axes[place + 1], course, course.half_width, f"95 % half-width of {unit}")
        place += len(course.inputs)
    return figure


def _curve(axis: Any, course: TermCourse, unit: str) -> None:
    x = course.at[0]
    axis.axhline(0.0, color=QUIET, lw=0.7)
    axis.fill_between(
        x, course.value - course.half_width, course.value + course.half_width, color=BLUE,
        alpha=0.2, lw=0,
    )  # fmt: skip
    axis.plot(x, course.value, color=BLUE, lw=1.4)
    axis.set_xlabel(INPUT_TEXT[course.inputs[0]])
    axis.set_ylabel(unit)


def _map(figure: Any, axis: Any, course: TermCourse, values: Any, label: str) -> None:
    most = max(float(np.abs(course.value).max()), 1e-12)
    shown = axis.pcolormesh(
        course.at[0], course.at[1], values.T, cmap="RdBu_r", vmin=-most, vmax=most, shading="auto"
    )
    figure.colorbar(shown, ax=axis, label=label)
    axis.set_xlabel(INPUT_TEXT[course.inputs[0]])
    axis.set_ylabel(INPUT_TEXT[course.inputs[1]])
