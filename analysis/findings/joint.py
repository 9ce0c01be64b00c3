"""Findings of the tests of a joint between two muscles."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.figures.wording import fixed
from analysis.findings.findings import (
    BARS,
    EXPANDED,
    NO_SETTLED_POINT,
    Analysis,
    Findings,
    ResultColumns,
    Section,
    records,
)
from analysis.layouts.joint import joint_layout
from analysis.reduction.joint import (
    SIDES,
    JointRecord,
    angle_answer,
    reduce_joint_static,
    reduce_joint_step,
)
from analysis.reduction.points import point_events
from analysis.regression.stiffness import (
    FreeCell,
    LockedCell,
    SensorErrors,
    as_rows,
    free_cells,
    locked_cells,
)

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from analysis.reduction.points import Reduction
    from daq.store.run import Run

MOST_ANSWERS = 8
"""So many steps are drawn, of the first replicate."""
_RAD = math.pi / 180.0
ANGLE_DECIMALS = 2
"""Of a difference of angles without an uncertainty of its own, in degrees."""


def joint_static_findings(run: Run, reduction: Reduction) -> Findings:
    """Equilibrium angle, torque and stiffness at each pair of pressures."""
    table = reduction.table
    if not len(table) or not table["settled"].any():
        return Findings(NO_SETTLED_POINT)
    record = JointRecord(run)
    angles = record.angles
    errors = SensorErrors(
        record.torque_zero_n_m, record.torque_gain, angles.u_offset, angles.u_gain
    )
    locked = locked_cells(table, errors)
    free = free_cells(table, angles.u_offset, angles.u_gain, locked)
    sections = [*_free_sections(table, free), *_locked_sections(table, locked)]
    columns = (
        ("order", "point"), ("state", "joint"), ("direction", "direction"),
        ("common_kpa", "common, kPa"), ("difference_kpa", "difference, kPa"),
        ("pressure_a_kpa", "pressure a, kPa"), ("pressure_b_kpa", "pressure b, kPa"),
        ("angle_deg", "angle, °"), ("torque_n_m", "torque, N m"), ("settled", "settled"),
    )  # fmt: skip
    sections.append(Section("Points", (), table, columns, caption=f"{EXPANDED}."))
    data = {"locked": as_rows(locked), "free": as_rows(free), "points": records(table)}
    return Findings(_headline(locked, free), tuple(sections), data)


def _headline(locked: list[LockedCell], free: list[FreeCell]) -> str:
    parts = []
    if free:
        low, high = min(c.angle_deg for c in free), max(c.angle_deg for c in free)
        parts.append(f"The free joint stood at {fixed(low, 1)} to {fixed(high, 1)}°")
    if locked:
        soft = min(locked, key=lambda c: c.stiffness_n_m_rad)
        stiff = max(locked, key=lambda c: c.stiffness_n_m_rad)
        text = f"stiffness {soft.stiffness_n_m_rad:.3f}"
        if stiff.common_kpa != soft.common_kpa:
            text += (
                f" (at {soft.common_kpa:g} kPa) to {stiff.stiffness_n_m_rad:.3f} N m/rad"
                f" (at {stiff.common_kpa:g} kPa)"
            )
        else:
            most = f" to {stiff.stiffness_n_m_rad:.3f}" if stiff is not soft else ""
            text += f"{most} N m/rad at {soft.common_kpa:g} kPa"
        parts.append(text)
    text = "; ".join(parts)
    return f"{text[0].upper()}{text[1:]}." if parts else NO_SETTLED_POINT


def _free_sections(table: pd.DataFrame, cells: list[FreeCell]) -> list[Section]:
    import pandas as pd

    from analysis.figures.joint import angle_figure

    if not cells:
        return []
    frame = pd.DataFrame(as_rows(cells))
    frame["hysteresis_deg"] = frame["hysteresis_deg"].round(ANGLE_DECIMALS)
    words = (
        "Mean of all settled points, for the set-points of both pressures. The uncertainty holds"
        " the readings, the angle's zero and gain, both pressure calibrations, and friction: half"
        " the largest difference between rising and falling pressure, here or in the torque.",
        *_one_way(table, "free"),
    )
    columns = (
        ("common_kpa", "common, kPa"), ("difference_kpa", "difference, kPa"),
        ("angle_deg", "angle, °"), ("hysteresis_deg", "rising − falling, °"), ("points", "points"),
    )  # fmt: skip
    return [
        Section(
            "Equilibrium angle",
            figure=lambda: angle_figure(table),
            caption="Joint free. Filled: difference rising; open: falling. " + BARS,
        ),
        Section(
            "Equilibrium angle at each pair of pressures", words,
            frame, columns, caption=f"{EXPANDED}.",
        ),
    ]  # fmt: skip


def _locked_sections(table: pd.DataFrame, cells: list[LockedCell]) -> list[Section]:
    import pandas as pd

    from analysis.figures.joint import stiffness_figure, torque_figure

    if not cells:
        return []
    frame = pd.DataFrame(as_rows(cells))
    for name in ("stiffness", "u_stiffness"):
        frame[f"{name}_deg"] = frame[f"{name}_n_m_rad"] * _RAD * 1e3
    words = (
        "Locked at each angle, the torque at one pair of pressures is fitted by a polynomial of"
        " degree 2 in the angle (1 with two angles). Torque and stiffness are stated at the middle"
        " of the locked angles and for the set-points of both pressures; the stiffness is the"
        " torque's slope with the sign changed. Equilibrium: where the torque is 0.",
        *_one_way(table, "locked"),
        *_undecided(cells),
    )
    columns = (
        ("common_kpa", "common, kPa"), ("difference_kpa", "difference, kPa"),
        ("angle_deg", "at, °"), ("torque_n_m", "torque, N m"),
        ("stiffness_n_m_rad", "stiffness, N m/rad"), ("stiffness_deg", "stiffness, mN m/°"),
        ("equilibrium_deg", "equilibrium, °"), ("points", "points"),
    )  # fmt: skip
    frame = frame.round({"angle_deg": 2})
    return [
        Section(
            "Torque of the locked joint",
            figure=lambda: torque_figure(table),
            caption="One curve per pair of pressures. " + BARS,
        ),
        Section(
            "Stiffness",
            figure=lambda: stiffness_figure(cells),
            caption="At the middle of the locked angles. " + BARS,
        ),
        Section(
            "Torque and stiffness at each pair of pressures", words, frame, columns,
            caption=f"{EXPANDED}.",
        ),
    ]  # fmt: skip


def _one_way(table: pd.DataFrame, state: str) -> tuple[str, ...]:
    own = table[table["state"] == state]
    if {"up", "down"} <= set(own["direction"]):
        return ()
    return (
        "The pressures did not rise and fall to each pair, so that friction is not known and not"
        ' part of the uncertainty: use order = "up-down".',
    )


def _undecided(cells: list[LockedCell]) -> tuple[str, ...]:
    if all(math.isfinite(cell.u_torque_n_m) for cell in cells):
        return ()
    return (
        "How the torque follows either pressure is not known of so few pairs, and without it no"
        " uncertainty: measure at two differential pressures or more.",
    )


def joint_step_findings(run: Run, reduction: Reduction) -> Findings:
    """The answer of the angle to each step."""
    table = reduction.table
    if not len(table):
        return Findings("No step was made, so there is no result.")
    columns = (
        ("order", "step"), ("common_kpa", "common, kPa"), ("from_kpa", "from, kPa"),
        ("difference_kpa", "to, kPa"), ("start_deg", "start, °"), ("final_deg", "end, °"),
        ("rise_s", "10 to 90 %, s"), ("peak_s", "peak after, s"),
        ("overshoot_deg", "overshoot, °"), ("settle_s", "settled after, s"),
        ("skew_ms", "b after a, ms"), ("settled", "settled"),
    )  # fmt: skip
    words = (
        "Time counts from the sample in which the first of both set-points changed. The reading of"
        " an angle has the time at which its line arrived; a delay that all lines have in common is"
        " in the times as well.",
    )
    shown = table.assign(skew_ms=(1e3 * table["skew_s"]).round(2))
    sections = (
        Section(
            "Angle",
            figure=lambda: _answers(run, table),
            caption="Angle after each step of the differential pressure, first repeat.",
        ),
        Section(
            "Pressures",
            figure=lambda: _pressures(run, table),
            caption="Both pressures through the steps of the first trial.",
        ),
        Section("Each step", words, shown, columns, caption=f"{EXPANDED}."),
    )
    settled = table[table["settled"]]
    text = f"{len(settled)} of {len(table)} steps settled"
    if len(settled):
        text += (
            f"; 10 to 90 % took {settled['rise_s'].median():.2f} s (median), the largest overshoot"
            f" was {settled['overshoot_deg'].max():.1f}°"
        )
    return Findings(text + ".", sections, {"steps": records(table)})


def _signed(kpa: float) -> str:
    """A difference of pressures with its sign; none has no sign."""
    return f"{kpa:+g}".replace("-", "−") if kpa else "0"


def _answers(run: Run, table: pd.DataFrame) -> Figure:
    from analysis.figures.joint import answers_figure

    record = JointRecord(run)
    first = set(table[table["repeat"] == table["repeat"].min()]["order"])
    found: list[tuple[str, Any, Any]] = []
    for event in point_events(run):
        answer = angle_answer(record, event) if event["order"] in first else None
        if answer is not None and len(found) < MOST_ANSWERS:
            label = (
                f"{event['common_kpa']:g} kPa: {_signed(event['from_kpa'])} to"
                f" {_signed(event['difference_kpa'])}"
            )
            found.append((label, answer[0], answer[1]))
    return answers_figure(found)


def _pressures(run: Run, table: pd.DataFrame) -> Figure:
    from analysis.figures.joint import pressures_figure
    from analysis.figures.timeline import min_max

    record = JointRecord(run)
    trial = table["trial"].min()
    events = [event for event in point_events(run) if event["trial"] == trial]
    curves: list[tuple[str, Any, Any]] = []
    for name, label in zip(SIDES, ("muscle a", "muscle b"), strict=True):
        stream = record.stream(name)
        if not events or not len(stream.get("seq", ())):
            continue
        first, end = events[0][f"{name}_seq"][0], events[-1][f"{name}_seq"][1]
        use = (stream["seq"] >= first) & (stream["seq"] < end)
        kpa = record.pressures[name].apply(stream["counts"][use])
        seconds = (stream["seq"][use] - first).astype(np.float64) * 1e-3
        curves.append((label, *min_max(seconds, kpa)))
    return pressures_figure(curves)


JOINT_STATIC = Analysis(
    "joint-static",
    "Static test of a joint",
    reduce_joint_static,
    lambda parameters: joint_layout(
        "Static test of a joint", parameters, "Angle (degrees)", torques=True
    ),
    joint_static_findings,
    ResultColumns(
        ("angle_deg", "torque_n_m"),
        ("state", "set_angle_deg", "common_kpa", "difference_kpa", "direction"),
        {"angle_deg": ("state", "free"), "torque_n_m": ("state", "locked")},
    ),
)
JOINT_STEP = Analysis(
    "joint-step",
    "Step test of a joint",
    reduce_joint_step,
    lambda parameters: joint_layout("Step test of a joint", parameters, "Angle (degrees)"),
    joint_step_findings,
    ResultColumns(
        ("rise_s", "overshoot_deg", "settle_s"),
        ("common_kpa", "from_kpa", "difference_kpa"),
        settled=False,
    ),
)
ANALYSES = (JOINT_STATIC, JOINT_STEP)
