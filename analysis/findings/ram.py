"""What a ram test says: how soon a switch was reached, and whether the ram was held there (5.9)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.findings.findings import Analysis, Findings, Section
from analysis.layouts.valve import valve_layout
from analysis.reduction.points import Reduction, without_excluded
from analysis.reduction.valve import ValveRecord
from daq.live.layout import LiveLayout

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from daq.store.run import Run

FLAGS = {"A": 0x40, "B": 0x80}
NUMBERS = (
    "set_pressure_kpa", "reach_s", "hold_s", "held_share", "pressure_kpa", "drift_kpa",
    "switchings",
)  # fmt: skip
UNCERTAIN = ("u_reach_s", "u_pressure_kpa", "u_drift_kpa")
LABELS = ("direction", "switch", "repeat", "trial", "slot", "mounting", "order", "settled")


def reduce_ram(run: Run) -> Reduction:
    """One row a move: from the telemetry's proximity flags, valve times and pressure.

    ``reach_s`` is the time from the set-point to the switch (to a millisecond), ``held_share`` the
    share of the time since then in which the switch was on, ``drift_kpa`` the change of pressure
    over it, ``switchings`` how often a valve was energised in it.
    """
    record = ValveRecord(run, "switching-time")
    rows = []
    for event in record.events:
        part, sent = record.on_time(record.asked(event))
        row: dict[str, Any] = {k: event.get(k) for k in LABELS}
        row["repeat"], row["set_pressure_kpa"] = event["replicate"], event["set_pressure_kpa"]
        row.update(dict.fromkeys(NUMBERS[1:], math.nan))
        on = (part["flags"] & FLAGS[event["switch"]]) > 0 if "flags" in part else np.zeros(0, bool)
        # A switch that was on from the start must have gone off once.
        start = int(np.argmin(on)) if len(on) and on[0] and not on.all() else 0
        stuck = len(on) > 0 and bool(on[0]) and start == 0
        came = np.flatnonzero(on[start:] & (not stuck)) + start
        if len(came):
            at = int(came[0])
            kpa = record.kpa(part["counts"])[at:]
            driven = np.column_stack([part["inlet_u5"] > 0, part["vent_u5"] > 0])[at:]
            edge = max(len(kpa) // 5, 1)
            row["reach_s"] = at * 1e-3
            row["hold_s"] = len(kpa) * 1e-3
            row["held_share"] = float(on[at:][sent[at:]].mean())
            row["pressure_kpa"] = float(kpa[-edge:].mean())
            row["drift_kpa"] = float(kpa[-edge:].mean() - kpa[:edge].mean())
            # Zero and gain cancel; what moves slowly is the drift itself, what is left is noise.
            noise = float(np.diff(kpa).std()) / math.sqrt(2.0) if len(kpa) > 1 else 0.0
            noise = max(noise, abs(record.pressure.scale) / math.sqrt(12.0))
            row["u_drift_kpa"] = noise * math.sqrt(2.0 / edge)
            row["switchings"] = float((np.diff(driven.astype(np.int8), axis=0) > 0).sum())
            seen = np.flatnonzero(sent[:at])
            unseen = at - 1 - int(seen[-1]) if len(seen) else at  # it came while none was sent
            row["u_reach_s"] = (1 + unseen) * 1e-3 / math.sqrt(3.0)
            if not sent[at:].all():
                row["switchings"] = math.nan
            if not sent.all():
                record.notes.append(
                    f"point {event['order']}: {int((~sent).sum())} samples are missing"
                )
            row["u_pressure_kpa"] = float(record.pressure.u(row["pressure_kpa"]))
        else:
            row["settled"] = False
            record.notes.append(f"point {event['order']} ({event['slot']}): never triggered")
        rows.append(row)
    if run.outcome != "clean":
        record.notes.append(f"the run is {run.outcome}: the table holds the {len(rows)} moves made")
    table = _frame(rows)
    return without_excluded(
        run, Reduction(table, tuple(record.notes), {"pressure_kpa": record.pressure})
    )


def _frame(rows: list[dict[str, Any]]) -> pd.DataFrame:
    import pandas as pd

    frame = pd.DataFrame(rows, columns=[*NUMBERS, *LABELS, *UNCERTAIN])
    for column in frame:
        if column in ("direction", "switch", "slot", "mounting"):
            frame[column] = frame[column].astype(str)
        elif column in ("repeat", "trial", "order"):
            frame[column] = frame[column].astype("int64")
        elif column == "settled":
            frame[column] = frame[column].astype(bool)
        else:
            frame[column] = frame[column].astype("float64")
    return frame.sort_values("order", kind="stable", ignore_index=True)


def ram_findings(run: Run, reduction: Reduction) -> Findings:
    """The moves, and the thesis's statement."""
    import pandas as pd

    table = reduction.table
    reached = int(table["settled"].sum())
    held = table[table["settled"] & (table["held_share"] > 0.999)]
    headline = "No move was made, so there is no result."
    if len(table):
        headline = (
            f"{reached} of {len(table)} moves came to their switch, {len(held)} of them were held"
            " there to the end"
        )
        if reached:
            slowest = float(table["reach_s"].max())
            headline += f"; the slowest took {slowest:.2f} s"
        headline += "."
    said = pd.DataFrame(
        [
            {
                "claim": "the ram moves until a proximity switch triggers",
                "found": f"{reached} of {len(table)} moves",
                "same": reached == len(table) and reached > 0,
            },
            {
                "claim": "it then holds its position there",
                "found": f"the switch stayed on in {len(held)} of {reached}, with"
                f" {int(np.nansum(table['switchings']))} switchings of a valve in all",
                "same": len(held) == reached and reached > 0,
            },
        ]
    )
    sections = (
        Section(
            "Moves",
            figure=lambda: _figure(run, table),
            caption="Measured pressure, set-point dashed; bars below: switch A, switch B, and the"
            " valves as commanded.",
        ),
        Section(
            "Each move",
            (
                "Reached: from the set-point to the switch. Held: share of the time since then in"
                " which the switch was on.",
            ),
            table,
            (
                ("order", "order"), ("slot", "move"), ("reach_s", "reached after, s"),
                ("hold_s", "watched for, s"), ("held_share", "held, share"),
                ("pressure_kpa", "pressure at the end, kPa"), ("drift_kpa", "drift, kPa"),
                ("switchings", "switchings while held"), ("settled", "reached"),
            ),
            caption="± expanded uncertainty, k = 2.",
        ),
        Section(
            "Beside what the thesis says (5.9)",
            ("The thesis gives no number; these statements can be held against the record.",),
            said,
            (("claim", "said"), ("found", "measured"), ("same", "agrees")),
        ),
    )  # fmt: skip
    rows = [{str(k): v for k, v in row.items()} for row in table.to_dict("records")]
    return Findings(headline, sections, {"reached": reached, "held": len(held), "moves": rows})


def _figure(run: Run, table: pd.DataFrame) -> Figure:
    from analysis.figures.drawing import INK, MEASURED, QUIET, SET, new_figure, style
    from analysis.figures.timeline import min_max

    record = ValveRecord(run, "switching-time")
    windows = {int(e["order"]): e["valve_seq"] for e in record.events}
    first = table[table["repeat"] == table["repeat"].min()] if len(table) else table
    orders = [int(order) for order in first["order"]]
    with style():
        figure, (top, bottom) = new_figure(7.2, 4.4, rows=2, sharex=True)
        if orders:
            start = windows[orders[0]][0]
            part = record.samples([start, windows[orders[-1]][1]])
            if len(part.get("counts", ())):
                seconds = (part["seq"].astype(np.float64) - start) * 1e-3
                top.plot(*min_max(seconds, record.kpa(part["counts"])), color=MEASURED,
                         linewidth=0.9)  # fmt: skip
                lanes = (
                    ("switch A", (part["flags"] & FLAGS["A"]) > 0, INK),
                    ("switch B", (part["flags"] & FLAGS["B"]) > 0, INK),
                    ("inlet", part["inlet_u5"] > 0, MEASURED),
                    ("outlet", part["vent_u5"] > 0, SET),
                )
                for lane, (_, on, colour) in enumerate(lanes):
                    bottom.fill_between(
                        seconds, lane + 0.1, lane + 0.1 + 0.8 * on, color=colour, linewidth=0,
                        step="post",
                    )  # fmt: skip
                bottom.set_yticks([k + 0.5 for k in range(4)], [name for name, _, _ in lanes])
            for order, goal in zip(orders, first["set_pressure_kpa"], strict=True):
                a, b = ((seq - start) * 1e-3 for seq in windows[order])
                top.plot([a, b], [goal, goal], color=SET, linewidth=1.1, linestyle=(0, (4, 2)))
                top.axvline(a, color=QUIET, linewidth=0.5)
        top.set_ylabel("pressure (kPa gauge)")
        bottom.set_xlabel("time (s)")
        bottom.grid(visible=False, axis="y")
        figure.align_ylabels([top, bottom])
    return figure


def _layout(parameters: Mapping[str, Any]) -> LiveLayout:
    """Its screen."""
    shown = {
        "result_axis": ("time to the switch (s)", float(parameters.get("reach_s") or 10.0)),
        "pressures_kpa": [2.0 * float(parameters.get("rise_kpa") or 100.0)],
    }
    return valve_layout("Ram test", {**parameters, **shown}, window_s=20.0)


RAM = Analysis("ram", "Ram test", reduce_ram, _layout, ram_findings)
ANALYSES = (RAM,)
