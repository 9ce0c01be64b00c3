"""The report of a diagnosis: one HTML file that stands alone and can be printed."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from daq.version import version
from gap.output import write_text
from gap.reporting.empirical import empirical_sentences
from gap.reporting.examination import Examination
from gap.reporting.figures import NAMES, drawn, figures
from gap.reporting.text import (
    HEADS,
    careful,
    experiment_sentence,
    gap_sentences,
    headline,
    limits,
    parameter_text,
    rivals,
    sentence,
    told_apart,
)
from gap.verdict import Verdict

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NEAREST = 8
"""Rivals that are named one by one; the others stand in a fold."""


def render_report(examined: Examination) -> str:
    """HTML of a diagnosis; everything that came from data is escaped."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("gap.reporting"), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    return environment.get_template("letter.html.j2").render(**context(examined))


def write_report(examined: Examination, path: Path) -> str:
    """Write the report to `path` and return the page. Raises `GapError` if it cannot be written."""
    page = render_report(examined)
    write_text(path, page)
    return page


def report_figures(examined: Examination) -> list[tuple[str, Figure]]:
    """Title and figure of everything that the report draws, in its order."""
    return [(NAMES[name], figure) for name, figure in drawn(examined).items() if figure is not None]


def context(examined: Examination) -> dict[str, Any]:
    """Everything the page shows, as plain values."""
    verdict, data = examined.verdict, examined.data
    near = rivals(verdict)
    return {
        "head": HEADS.get(verdict.status, verdict.status),
        "status": verdict.status,
        "headline": headline(verdict),
        "reason": str(verdict.reason),
        "careful": careful(verdict),
        "gap": gap_sentences(verdict),
        "explanations": _explanations(verdict),
        "empirical": empirical_sentences(verdict),
        "figures": figures(examined),
        "contrasts": sorted(verdict.contrasts, key=lambda c: -abs(c.z)),
        "near": near[:NEAREST],
        "far": near[NEAREST:],
        "next": _next(verdict),
        "next_why": sentence(verdict.next_experiment.why) if verdict.next_experiment else "",
        "told_apart": told_apart(verdict),
        "limits": limits(verdict),
        "mimics": _confounders(verdict),
        "explained": bool(verdict.effects) and verdict.status.explained,
        "held_out": verdict.headline_gap is not None and bool(verdict.headline_gap.held_out),
        "origin": data.origin,
        "trials": len(data.trials),
        "slots": len(data.slots),
        "mountings": len({trial.mounting for trial in data.trials}),
        "protocols": ", ".join(sorted({trial.protocol for trial in data.trials})),
        "notes": verdict.notes,
        "digest": examined.digest,
        "made": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "version": version(),
    }


def _next(verdict: Verdict) -> str:
    if verdict.next_experiment is None:
        return ""
    return experiment_sentence(verdict.next_experiment, named=len(verdict.effects) == 1)


def _explanations(verdict: Verdict) -> list[dict[str, str]]:
    rows = [
        {
            "what": verdict.label(effect),
            "family": effect.family.replace("_", " "),
            "probability": _percent(effect.probability),
            "parameters": "; ".join(
                parameter_text(name, e) for name, e in effect.parameters.items()
            ),
        }
        for effect in verdict.effects
    ]
    for name, value in (
        ("no gap above the floor", verdict.probability_none),
        ("something else", verdict.probability_unknown),
    ):
        rows.append({"what": name, "family": "", "probability": _percent(value), "parameters": ""})
    return rows


def _percent(value: float) -> str:
    """A probability as text; never "certain"."""
    if value > 0.99:
        return "> 99 %"
    return f"{100 * value:.0f} %" if value >= 0.01 else "< 1 %"


def _confounders(verdict: Verdict) -> list[str]:
    """What could stand in for the best entry, and how well."""
    found = verdict.evidence.get("mimics", [])
    return [
        f"{' and '.join(one['ids'])} could take {100 * float(one['share']):.0f} % of its effect"
        for one in found
    ]
