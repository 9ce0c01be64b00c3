"""Analysis of a simulated run: its table of windows, its live layout, its findings."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.findings.findings import Analysis, Findings, Section
from analysis.reduction.columns import number_or_nan, points_frame
from analysis.reduction.points import Reduction, put_mean
from analysis.reduction.uncertainty import window_mean
from daq.live.layout import GREEN, ORANGE, SKY, Channel, Feed, LiveLayout, Panel

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from daq.store.run import Run

EXTRA = {"mass_kg": "float64"}


def reduce(run: Run) -> Reduction:
    """One row per window: mean pressure and force of the first muscle, and its length.

    ``length_mm`` is the mean of the true state, because a camera does not see the muscles of a
    finger.
    """
    points = [event for event in run.events if event.get("kind") == "point"]
    if not points:
        why = "the scenario measures no window"
        if run.outcome != "clean":
            why = f"the run is {run.outcome}: it ended before its first window"
        return Reduction(points_frame([], EXTRA), (why,), {})
    calibrations = run.calibrations
    valve, balance, truth = (run.samples(name) for name in ("valve", "balance", "truth"))
    length = next(name for name in truth if name.endswith("_length_mm"))
    rows = [_row(run, point, valve, balance, truth, length) for point in points]
    return Reduction(points_frame(rows, EXTRA), (), calibrations)


def _row(
    run: Run, point: dict[str, Any], valve: Any, balance: Any, truth: Any, length: str
) -> dict[str, Any]:
    stated = run.manifest["conditions"]
    row: dict[str, Any] = {
        "direction": point["direction"],
        "repeat": point["replicate"],
        "settled": bool(point["settled"]),
        **{key: point[key] for key in ("trial", "slot", "mounting", "order")},
        "set_pressure_kpa": math.nan,
        "set_length_mm": number_or_nan(point.get("set_length_mm")),
        "mass_kg": number_or_nan(point.get("mass_kg")),
        "temperature_c": float(stated["temperature_c"]),
    }
    for key in ("u_temperature_c", "u_temperature_c_noise", "u_temperature_c_cal"):
        row[key] = float(stated["u_temperature_c"])
    seq = valve["seq"]
    inside = (seq >= point["valve_seq"][0]) & (seq < point["valve_seq"][1])
    row["n_samples"] = int(inside.sum())
    if inside.any():
        goal = run.calibration("pressure_kpa").apply(valve["setpoint_x16"][inside][-1] / 16.0)
        row["set_pressure_kpa"] = round(float(goal), 1)  # set-points are sent in 1/16 counts
    begin, end = point["balance_rows"]
    held = (balance["row"] >= begin) & (balance["row"] < end)
    for quantity, raw in (
        ("pressure_kpa", valve["counts"][inside]),
        ("force_n", balance["grams"][held]),
    ):
        calibration = run.calibration(quantity)
        mean = window_mean(calibration.apply(raw), abs(calibration.scale))
        u_cal = float(calibration.u(mean.mean)) if mean.n else math.nan
        put_mean(row, quantity, mean, u_cal)
    host = valve["host_ns"][inside]
    span = (truth["host_ns"] >= host.min()) & (truth["host_ns"] <= host.max()) if len(host) else []
    values = truth[length][span] if len(host) else np.array([])
    row["length_mm"] = float(np.mean(values)) if len(values) else math.nan
    row["u_length_mm"] = row["u_length_mm_noise"] = row["u_length_mm_cal"] = 0.0
    return row


def findings(run: Run, reduction: Reduction) -> Findings:
    """The figure of the whole run, and the table of windows."""
    manifest = run.manifest["parameters"]
    final = run.final or {}
    took = final.get("times_real_time")
    words = (
        f"Simulated: load {manifest['load']}, muscles {', '.join(manifest['muscles'])} "
        f"({', '.join(manifest['models'])}), {manifest['duration_s']:g} s"
        + (f", {took:g} times real time with the firmware in the loop" if took else "")
        + "."
    )
    columns = (
        ("slot", "window"),
        ("set_pressure_kpa", "set, kPa"),
        ("pressure_kpa", "pressure, kPa"),
        ("length_mm", "length, mm"),
        ("force_n", "force, N"),
    )
    sections = [
        Section(
            "Motion",
            (words,),
            figure=lambda: scene_figure(run),
            caption="True state, every millisecond; dashed: set-points.",
        )
    ]
    if len(reduction.table):
        sections.append(Section("Windows", (), table=reduction.table, columns=columns))
    return Findings(words, tuple(sections), {"scenario": manifest, "times_real_time": took})


def scene_figure(run: Run) -> Figure:
    """Pressure and force of each muscle, and every position, against time."""
    from analysis.figures.drawing import (
        DOUBLE_COLUMN,
        QUIET,
        SET,
        new_figure,
        sequence,
        style,
    )

    truth = run.samples("truth")
    t = (truth["host_ns"] - truth["host_ns"][0]) * 1e-9
    pressures = [n for n in truth if n.endswith("_pressure_kpa")]
    forces = [n for n in truth if n.endswith("_force_n")]
    positions = [
        n for n in truth if n.endswith(("_deg", "_mm")) and not n.endswith("_length_mm")
    ] or [n for n in truth if n.endswith("_length_mm")]
    positions += [n for n in truth if n == "length_mm"]
    with style():
        figure, axes = new_figure(DOUBLE_COLUMN, 5.6, rows=3, sharex=True)
        groups = ((pressures, "pressure (kPa)"), (forces, "force (N)"), (positions, ""))
        for ax, (names, label) in zip(axes, groups, strict=True):
            for name, colour in zip(names, sequence(len(names)), strict=True):
                ax.plot(t, truth[name], color=colour, linewidth=0.9, label=_plain(name))
            ax.set_ylabel(label or _axis(positions))
            if len(names) > 1:
                ax.legend(fontsize=7, ncols=2)
        valve = run.samples("valve")
        calibration = run.calibration("pressure_kpa")
        at = (valve["host_ns"] - truth["host_ns"][0]) * 1e-9
        axes[0].plot(
            at, calibration.apply(valve["setpoint_x16"] / 16.0), color=SET, linestyle="--",
            linewidth=0.9,
        )  # fmt: skip
        for event in run.events:
            if event["kind"] == "switch" and event["value"]:
                axes[2].axvline(event["time_s"], color=QUIET, linewidth=0.7, linestyle=":")
        axes[2].set_xlabel("time (s)")
        figure.align_ylabels(list(axes))
    return figure


def _plain(name: str) -> str:
    for suffix in ("_pressure_kpa", "_force_n", "_deg", "_length_mm", "_mm"):
        name = name.removesuffix(suffix)
    return name


def _axis(positions: list[str]) -> str:
    return "angle (deg)" if positions and positions[0].endswith("_deg") else "position (mm)"


def layout(parameters: Mapping[str, Any]) -> LiveLayout:
    """Live layout: curves of pressure, force and position."""
    unit = "deg" if parameters.get("load") == "joint" else "mm"
    names = list(parameters.get("coordinates") or []) or ["length"]
    positions = tuple(Channel(f"place/{name}_{unit}", name, unit, digits=2) for name in names)
    columns = [f"{name}_{unit}" for name in names]
    return LiveLayout(
        title=str(parameters.get("name", "simulation")),
        columns=(
            (
                Panel("Pressure (kPa)", "series", "pressure", (
                    Channel("pressure/set_kpa", "set-point", "kPa", ORANGE, step=True),
                    Channel("pressure/measured_kpa", "measured", "kPa", SKY),
                )),
                Panel("Force (N)", "series", "force",
                      (Channel("force/measured_n", "measured", "N", GREEN, digits=2),)),
                Panel(f"Position ({unit})", "series", "place", positions),
            ),
        ),
        feeds=(
            Feed("pressure/set_kpa", "valve", "setpoint_kpa"),
            Feed("pressure/measured_kpa", "valve", "pressure_kpa"),
            Feed("force/measured_n", "balance", "force_n"),
            *(
                Feed(channel.path, "place", column)
                for channel, column in zip(positions, columns, strict=True)
            ),
        ),
    )  # fmt: skip


SIMULATION = Analysis("simulate", "Simulation", reduce, layout, findings)
ANALYSES = (SIMULATION,)
