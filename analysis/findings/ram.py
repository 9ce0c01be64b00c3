"""Findings of a ram test: time to the switch, and whether the ram was held there (5.9)."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.figures.timeline import on_spans
from analysis.figures.valve_moves import ValveMoves
from analysis.findings.findings import (
    EXPANDED,
    Analysis,
    Findings,
    ResultColumns,
    Section,
    claims_section,
    records,
)
from analysis.layouts.valve import valve_layout
from analysis.reduction.points import Reduction
from analysis.reduction.valve import ValveRecord

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
    """One row per move, from proximity flags, valve times and pressure of the telemetry.

    ``reach_s`` is the time from the set-point to the switch (resolution 1 ms). From then to the
    end: ``held_share`` is the fraction of time in which the switch was on, ``drift_kpa`` the
    change of pressure, ``switchings`` the number of times that a valve was energised.
    """
    record = ValveRecord(run, "switching-time")
    for event in record.events:
        part, received = record.on_time_grid(record.window_from_set_point(event))
        row: dict[str, Any] = {k: event.get(k) for k in LABELS}
        row["repeat"], row["set_pressure_kpa"] = event["replicate"], event["set_pressure_kpa"]
        row.update(dict.fromkeys(NUMBERS[1:], math.nan))
        on = (part["flags"] & FLAGS[event["switch"]]) > 0 if "flags" in part else np.zeros(0, bool)
        # If the switch was on at the start, it must go off before it can trigger.
        start = int(np.argmin(on)) if len(on) and on[0] and not on.all() else 0
        stuck = len(on) > 0 and bool(on[0]) and start == 0
        triggered = np.flatnonzero(on[start:] & (not stuck)) + start
        if len(triggered):
            at = int(triggered[0])
            kpa = record.kpa(part["counts"])[at:]
            driven = np.column_stack([part["inlet_u5"] > 0, part["vent_u5"] > 0])[at:]
            edge = max(len(kpa) // 5, 1)
            row["reach_s"] = at * 1e-3
            row["hold_s"] = len(kpa) * 1e-3
            row["held_share"] = float(on[at:][received[at:]].mean())
            row["pressure_kpa"] = float(kpa[-edge:].mean())
            row["drift_kpa"] = float(kpa[-edge:].mean() - kpa[:edge].mean())
            # Zero and gain cancel; differences between samples contain noise only.
            noise = float(np.diff(kpa).std()) / math.sqrt(2.0) if len(kpa) > 1 else 0.0
            noise = max(noise, abs(record.pressure.scale) / math.sqrt(12.0))
            row["u_drift_kpa"] = noise * math.sqrt(2.0 / edge)
            row["switchings"] = float((np.diff(driven.astype(np.int8), axis=0) > 0).sum())
            before = np.flatnonzero(received[:at])
            missing = at - 1 - int(before[-1]) if len(before) else at  # samples before the edge
            row["u_reach_s"] = (1 + missing) * 1e-3 / math.sqrt(3.0)
            if not received[at:].all():
                row["switchings"] = math.nan
            if not received.all():
                record.notes.append(
                    f"point {event['order']}: {int((~received).sum())} samples are missing"
                )
            row["u_pressure_kpa"] = float(record.pressure.u(row["pressure_kpa"]))
        else:
            row["settled"] = False
            record.notes.append(f"point {event['order']} ({event['slot']}): never triggered")
        record.rows.append(row)
    return record.finish_steps([*NUMBERS, *LABELS, *UNCERTAIN], "moves")


def ram_findings(run: Run, reduction: Reduction) -> Findings:
    """The moves, and the comparison with the thesis."""
    table = reduction.table
    reached = int(table["settled"].sum())
    held = int((table["settled"] & (table["held_share"] > 0.999)).sum())
    switchings = int(np.nansum(table["switchings"]))
    sections = (
        Section(
            "Moves",
            figure=lambda: _figure(run, table),
            caption="Measured pressure, set-point dashed; bars below: switch A, switch B, and the"
            " valve commands.",
        ),
        Section(
            "Each move",
            (
                "Reached: time from the set-point to the switch. Held: fraction of the time since"
                " then in which the switch was on.",
            ),
            table,
            (
                ("order", "order"), ("slot", "move"), ("reach_s", "reached after, s"),
                ("hold_s", "observed for, s"), ("held_share", "held, fraction"),
                ("pressure_kpa", "pressure at the end, kPa"), ("drift_kpa", "drift, kPa"),
                ("switchings", "switchings while held"), ("settled", "reached"),
            ),
            caption=f"{EXPANDED}.",
        ),
        claims_section(
            "Comparison with the thesis",
            "The thesis gives no number; these statements can be checked.",
            (
                (
                    "the ram moves until a proximity switch triggers",
                    f"{reached} of {len(table)} moves",
                    reached == len(table) and reached > 0,
                ),
                (
                    "it then holds its position there",
                    f"the switch stayed on in {held} of {reached}, with {switchings} switchings of"
                    " a valve in all",
                    held == reached and reached > 0,
                ),
            ),
        ),
    )  # fmt: skip
    data = {"reached": reached, "held": held, "moves": records(table)}
    return Findings(_headline(table, reached, held), sections, data)


def _headline(table: pd.DataFrame, reached: int, held: int) -> str:
    if not len(table):
        return "No move was made, so there is no result."
    text = (
        f"{reached} of {len(table)} moves reached their switch; {held} of them were held there to"
        " the end"
    )
    if reached:
        text += f"; the slowest took {float(table['reach_s'].max()):.2f} s"
    return text + "."


def _figure(run: Run, table: pd.DataFrame) -> Figure:
    from analysis.figures.drawing import (
        DOUBLE_COLUMN,
        INK,
        MEASURED,
        QUIET,
        SET,
        new_figure,
        style,
    )

    moves = ValveMoves(run, table)
    with style():
        figure, (top, bottom) = new_figure(DOUBLE_COLUMN, 4.4, rows=2, sharex=True)
        if len(moves.first):
            part, seconds, spans = moves.draw_pressure(top, moves.first)
            if len(seconds):
                lanes = (
                    ("switch A", (part["flags"] & FLAGS["A"]) > 0, INK),
                    ("switch B", (part["flags"] & FLAGS["B"]) > 0, INK),
                    ("inlet", part["inlet_u5"] > 0, MEASURED),
                    ("outlet", part["vent_u5"] > 0, SET),
                )
                for lane, (_, on, colour) in enumerate(lanes):
                    bottom.broken_barh(
                        on_spans(seconds, on), (lane + 0.1, 0.8), color=colour, linewidth=0
                    )
                bottom.set_ylim(0.0, 4.0)
                bottom.set_yticks([k + 0.5 for k in range(4)], [name for name, _, _ in lanes])
            for begin, _ in spans:
                top.axvline(begin, color=QUIET, linewidth=0.5)
        top.set_ylabel("pressure (kPa gauge)")
        bottom.set_xlabel("time (s)")
        bottom.grid(visible=False, axis="y")
        figure.align_ylabels([top, bottom])
    return figure


RAM = Analysis(
    "ram",
    "Ram test",
    reduce_ram,
    lambda parameters: valve_layout(
        "Ram test",
        {**parameters, "pressures_kpa": [2.0 * float(parameters.get("rise_kpa") or 100.0)]},
        window_s=20.0,
        result_axis=("time to the switch (s)", float(parameters.get("reach_s") or 10.0)),
    ),
    ram_findings,
    ResultColumns(("reach_s", "drift_kpa"), ("switch", "direction"), settled=False),
)
ANALYSES = (RAM,)
