"""Findings of a step test: comparison of the schemes, and with section 5.8 of the thesis."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.figures.valve_moves import ValveMoves
from analysis.findings.findings import (
    EXPANDED,
    Analysis,
    Findings,
    ResultColumns,
    Section,
    claims_section,
)
from analysis.layouts.valve import valve_layout
from analysis.reduction.step import reduce_step

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from analysis.reduction.points import Reduction
    from daq.store.run import Run

TITLES = {
    "two": "two-position (5.7.1)",
    "duty_in": "PWM of the inlet (5.7.2)",
    "duty": "PWM of both (5.7.3)",
    "slide": "sliding mode (5.7.4)",
    "burst": "bursts with valve model",
    "pwm": "proportional pulses",
    "reg": "the regulator's own loop",
}
THESIS = ("two", "duty_in", "duty", "slide")


def step_findings(run: Run, reduction: Reduction) -> Findings:
    """The responses, one row per scheme, and the comparison with the thesis."""
    import pandas as pd

    table = reduction.table
    supply = float((run.manifest.get("parameters") or {}).get("supply_kpa", 550.0))
    schemes = list(dict.fromkeys(table["scheme"]))
    rows = [_row(name, table[table["scheme"] == name], supply) for name in schemes]
    sections = [
        Section(
            "Responses",
            figure=lambda: _figure(run, table),
            caption="Measured pressure (1 kHz) of the first repeat; dashed: set-point.",
        ),
        Section(
            "Comparison of the schemes",
            (
                f"In % of the supply ({supply:g} kPa): error is the mean of the last part of a"
                " step minus its set-point, ripple the range in that part, overshoot the distance"
                " beyond the set-point; worst of all steps. Settled: steps that settled within"
                " the tolerance band, and their settling time (median).",
            ),
            pd.DataFrame(rows),
            (
                ("scheme", "scheme"), ("steps", "steps"), ("error", "error mean, %"),
                ("error_worst", "error worst, %"), ("ripple", "ripple worst, %"),
                ("overshoot", "overshoot worst, %"), ("settled_steps", "settled"),
                ("settle", "after, s"), ("switchings", "switchings, 1/s"),
            ),
            caption=f"{EXPANDED}.",
        ),
    ]  # fmt: skip
    claims = _claims(rows)
    if claims is not None:
        sections.append(claims)
    columns = (
        ("order", "order"), ("scheme", "scheme"), ("from_kpa", "from, kPa"),
        ("set_pressure_kpa", "to, kPa"), ("error_kpa", "error, kPa"),
        ("ripple_kpa", "ripple, kPa"), ("overshoot_kpa", "overshoot, kPa"),
        ("rise_s", "rise, s"), ("settle_s", "settled after, s"),
    )  # fmt: skip
    caption = f"{EXPANDED}. Shaded: did not settle within the tolerance band."
    sections.append(Section("All steps", (), table, columns, caption=caption))
    return Findings(_headline(rows), tuple(sections), {"schemes": rows, "supply_kpa": supply})


def _row(name: str, part: pd.DataFrame, supply: float) -> dict[str, Any]:
    def worst(column: str) -> tuple[float, float]:
        if not part[column].notna().any():
            return math.nan, math.nan
        at = int(np.nanargmax(part[column].to_numpy()))
        row = part.iloc[at]
        return 100 * float(row[column]) / supply, 100 * float(row[f"u_{column}"]) / supply

    error, u_error = worst("error_kpa")
    ripple, u_ripple = worst("ripple_kpa")
    overshoot, u_overshoot = worst("overshoot_kpa")
    settled = part[part["settled"]]
    return {
        "scheme": TITLES.get(name, name),
        "name": name,
        "steps": len(part),
        "error": 100 * float(part["error_kpa"].mean()) / supply,
        "u_error": 100 * float(part["u_error_kpa"].mean()) / supply,
        "error_worst": error,
        "u_error_worst": u_error,
        "ripple": ripple,
        "u_ripple": u_ripple,
        "overshoot": overshoot,
        "u_overshoot": u_overshoot,
        "settled_steps": f"{len(settled)} of {len(part)}",
        "settle": float(settled["settle_s"].median()) if len(settled) else math.nan,
        "switchings": round(float(part["switchings_per_s"].mean()), 1),
    }


def _headline(rows: list[dict[str, Any]]) -> str:
    good = [row for row in rows if math.isfinite(row["ripple"])]
    if not good:
        return "No step was made, so there is no result."
    best = min(good, key=lambda row: row["error_worst"] + row["ripple"])
    worst = max(good, key=lambda row: row["error_worst"] + row["ripple"])
    text = (
        f"Smallest error and ripple: {best['scheme']}, at worst {best['error_worst']:.1f} and"
        f" {best['ripple']:.1f} % of supply"
    )
    if worst is not best:
        text += (
            f"; largest: {worst['scheme']}, {worst['error_worst']:.1f} and {worst['ripple']:.1f} %"
        )
    return text + "."


def _claims(rows: list[dict[str, Any]]) -> Section | None:
    """Comparison of the four schemes with the statements of section 5.8."""
    by = {row["name"]: row for row in rows if math.isfinite(row["ripple"])}
    if not all(name in by for name in THESIS):
        return None
    ripple = {name: by[name]["ripple"] for name in THESIS}
    short = {name: TITLES[name].split(" (")[0] for name in THESIS}
    named = ", ".join(f"{short[name]} {ripple[name]:.1f} %" for name in THESIS)
    calmest = min(THESIS, key=lambda name: ripple[name])
    return claims_section(
        "Comparison with the thesis",
        "The thesis gives no number. Here, oscillation means a ripple above 1 % of supply, and"
        " considerable means above 5 %. The listings of its programs have defects that may explain"
        " differences (docs/reference/valve-schemes.md).",
        (
            (
                "two-position: wild movement and considerable overshoot",
                f"overshoot {by['two']['overshoot']:.1f} %, ripple {ripple['two']:.1f} %",
                by["two"]["overshoot"] > 5.0 and ripple["two"] > 5.0,
            ),
            (
                "PWM of the inlet oscillates more than two-position",
                f"ripple {ripple['duty_in']:.1f} and {ripple['two']:.1f} %",
                ripple["duty_in"] > ripple["two"],
            ),
            (
                "sliding mode is the most stable of the four",
                f"smallest ripple: {short[calmest]} ({named})",
                calmest == "slide",
            ),
            ("none of the four stops oscillating", named, min(ripple.values()) > 1.0),
        ),
    )


def _figure(run: Run, table: pd.DataFrame) -> Figure:
    from analysis.figures.drawing import (
        DOUBLE_COLUMN,
        INK,
        new_figure,
        style,
    )

    moves = ValveMoves(run, table)
    first = moves.first
    schemes = list(dict.fromkeys(first["scheme"]))
    count = max(len(schemes), 1)
    with style():
        figure, axes = new_figure(DOUBLE_COLUMN, 0.7 + 1.35 * count, rows=count, sharex=True)
        for ax, name in zip(np.atleast_1d(axes), schemes, strict=False):
            moves.draw_pressure(ax, first[first["scheme"] == name].sort_values("order"))
            ax.set_title(TITLES.get(name, name), loc="left", fontsize=8.5, color=INK)
            ax.set_ylim(bottom=0)
        np.atleast_1d(axes)[-1].set_xlabel("time (s)")
        figure.supylabel("pressure (kPa gauge)", fontsize=9)
    return figure


STEP = Analysis(
    "step",
    "Step test",
    reduce_step,
    lambda parameters: valve_layout(
        "Step test",
        parameters,
        window_s=10.0,
        result_axis=("rms error, second half of step (kPa)", 100.0),
    ),
    step_findings,
    ResultColumns(
        ("rise_s", "overshoot_kpa", "settle_s"),
        ("scheme", "from_kpa", "set_pressure_kpa"),
        settled=False,
    ),
)
ANALYSES = (STEP,)
