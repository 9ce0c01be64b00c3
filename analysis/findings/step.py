"""What a table of step responses says: schemes side by side, and what section 5.8 says of them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.findings.findings import Analysis, Findings, Section
from analysis.layouts.valve import valve_layout
from analysis.reduction.step import reduce_step
from analysis.reduction.valve import ValveRecord
from daq.live.layout import LiveLayout

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
    "burst": "bursts that know the valve",
    "pwm": "pulses by proportion",
}
THESIS = ("two", "duty_in", "duty", "slide")


def step_findings(run: Run, reduction: Reduction) -> Findings:
    """One row a scheme, the responses, and the thesis's statements."""
    import pandas as pd

    table = reduction.table
    supply = float((run.manifest.get("parameters") or {}).get("supply_kpa", 550.0))
    schemes = list(dict.fromkeys(table["scheme"]))
    rows = [_row(name, table[table["scheme"] == name], supply) for name in schemes]
    sections = [
        Section(
            "Responses",
            figure=lambda: _figure(run, table),
            caption="Measured pressure (1 kHz) of the first replicate; dashed: set-point.",
        ),
        Section(
            "Schemes side by side",
            (
                f"In % of the supply ({supply:g} kPa): error is the mean over the last stretch of"
                " a step less its set-point, ripple the range in it, overshoot how far beyond the"
                " set-point; worst over all steps. Settled: steps that came to stay within the"
                " band, and how long that took (median).",
            ),
            pd.DataFrame(rows),
            (
                ("scheme", "scheme"), ("steps", "steps"), ("error", "error mean, %"),
                ("error_worst", "error worst, %"), ("ripple", "ripple worst, %"),
                ("overshoot", "overshoot worst, %"), ("settled_steps", "settled"),
                ("settle", "after, s"), ("switchings", "switchings, 1/s"),
            ),
            caption="± expanded uncertainty, k = 2.",
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
    caption = "± expanded uncertainty, k = 2. Shaded: did not come to stay within the band."
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
    came = part[part["settled"]]
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
        "settled_steps": f"{len(came)} of {len(part)}",
        "settle": float(came["settle_s"].median()) if len(came) else math.nan,
        "switchings": round(float(part["switchings_per_s"].mean()), 1),
    }


def _headline(rows: list[dict[str, Any]]) -> str:
    good = [row for row in rows if math.isfinite(row["ripple"])]
    if not good:
        return "No step was made, so there is no result."
    best = min(good, key=lambda row: row["error_worst"] + row["ripple"])
    worst = max(good, key=lambda row: row["error_worst"] + row["ripple"])
    text = (
        f"Nearest and quietest: {best['scheme']}, at worst {best['error_worst']:.1f} % of supply"
        f" from its set-point with {best['ripple']:.1f} % of ripple"
    )
    if worst is not best:
        text += (
            f"; farthest: {worst['scheme']}, {worst['error_worst']:.1f} and {worst['ripple']:.1f} %"
        )
    return text + "."


def _claims(rows: list[dict[str, Any]]) -> Section | None:
    """Section 5.8's statements about its four schemes, held against what was measured."""
    import pandas as pd

    by = {row["name"]: row for row in rows if math.isfinite(row["ripple"])}
    if not all(name in by for name in THESIS):
        return None
    swing = {name: by[name]["ripple"] for name in THESIS}
    named = ", ".join(f"{TITLES[n].split(' (')[0]} {swing[n]:.1f} %" for n in THESIS)
    calmest = min(THESIS, key=lambda name: swing[name])
    said = [
        {
            "claim": "two-position: wild movement and considerable overshoot",
            "found": f"overshoot {by['two']['overshoot']:.1f} %, ripple {swing['two']:.1f} %",
            "same": by["two"]["overshoot"] > 5.0 and swing["two"] > 5.0,
        },
        {
            "claim": "PWM of the inlet swings more than two-position",
            "found": f"{swing['duty_in']:.1f} against {swing['two']:.1f} % of ripple",
            "same": swing["duty_in"] > swing["two"],
        },
        {
            "claim": "sliding mode is the most stable of the four",
            "found": f"least ripple: {TITLES[calmest].split(' (')[0]} ({named})",
            "same": calmest == "slide",
        },
        {
            "claim": "none of the four stops oscillating",
            "found": named,
            "same": min(swing.values()) > 1.0,
        },
    ]
    return Section(
        "Beside what the thesis says of its schemes (5.8)",
        (
            "The thesis gives no number, so that oscillation is held against 1 % of supply and"
            " considerable against 5 %. The listings of its programs have defects that may"
            " explain what differs (docs/reference/valve-schemes.md).",
        ),
        pd.DataFrame(said),
        (("claim", "said"), ("found", "measured"), ("same", "agrees")),
    )


def _figure(run: Run, table: pd.DataFrame) -> Figure:
    from analysis.figures.drawing import INK, MEASURED, SET, new_figure, style
    from analysis.figures.timeline import min_max

    record = ValveRecord(run, "switching-time")
    first = table[table["repeat"] == table["repeat"].min()]
    schemes = list(dict.fromkeys(first["scheme"]))
    windows = {int(e["order"]): e["valve_seq"] for e in record.events}
    with style():
        figure, axes = new_figure(7.2, 0.7 + 1.35 * max(len(schemes), 1), rows=max(len(schemes), 1),
                                  sharex=True)  # fmt: skip
        for ax, name in zip(np.atleast_1d(axes), schemes, strict=False):
            part = first[first["scheme"] == name].sort_values("order")
            orders = [int(order) for order in part["order"]]
            whole = record.samples([windows[orders[0]][0], windows[orders[-1]][1]])
            if len(whole.get("counts", ())):
                seconds = (whole["seq"].astype(np.float64) - windows[orders[0]][0]) * 1e-3
                ax.plot(*min_max(seconds, record.kpa(whole["counts"])), color=MEASURED,
                        linewidth=0.8)  # fmt: skip
            edges, goals = [], []
            for order, goal in zip(orders, part["set_pressure_kpa"], strict=True):
                a, b = windows[order]
                edges += [(a - windows[orders[0]][0]) * 1e-3, (b - windows[orders[0]][0]) * 1e-3]
                goals += [goal, goal]
            ax.plot(edges, goals, color=SET, linewidth=1.1, linestyle=(0, (4, 2)))
            ax.set_title(TITLES.get(name, name), loc="left", fontsize=8.5, color=INK)
            ax.set_ylabel("kPa")
            ax.set_ylim(bottom=0)
        np.atleast_1d(axes)[-1].set_xlabel("time (s)")
        figure.supylabel("pressure, gauge", fontsize=9)
    return figure


def _layout(parameters: Mapping[str, Any]) -> LiveLayout:
    """Its screen."""
    axis = {"result_axis": ("rms error of the second half of a step (kPa)", 100.0)}
    return valve_layout("Step test", {**parameters, **axis}, window_s=10.0)


STEP = Analysis("step", "Step test", reduce_step, _layout, step_findings)
ANALYSES = (STEP,)
