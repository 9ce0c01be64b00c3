"""Figures of the tests of a joint."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.figures.drawing import (
    COVERAGE,
    DOUBLE_COLUMN,
    QUIET,
    SET,
    CurveEnds,
    curve,
    curves_figure,
    marker,
    new_figure,
    sequence,
    style,
)

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from analysis.regression.stiffness import LockedCell
    from plant.arrays import Array


def angle_figure(table: pd.DataFrame) -> Figure:
    """Equilibrium angle against differential pressure, one curve per common pressure."""
    free = table[table["state"] == "free"]
    groups = [(c, free[free["common_kpa"] == c]) for c in sorted(set(free["common_kpa"]))]

    def draw(axes: Any, colours: list[Any], ends: CurveEnds) -> None:
        for k, (common, rows) in enumerate(groups):
            end = (np.nan, np.nan)
            for direction, part in rows.groupby("direction"):
                end = curve(
                    axes, part.assign(u_difference_kpa=np.nan), ("difference_kpa", "angle_deg"),
                    part["difference_kpa"], colours[k], k, down=direction == "down",
                )  # fmt: skip
            ends.append((*end, f"{common:g}", colours[k]))

    return curves_figure(
        len(groups), "differential pressure (kPa)", "angle (degrees)", "common (kPa)", draw
    )


def torque_figure(table: pd.DataFrame) -> Figure:
    """Torque of the locked joint against its angle, one curve per pair of pressures."""
    locked = table[table["state"] == "locked"]
    groups = list(locked.groupby(["common_kpa", "difference_kpa"]))

    def draw(axes: Any, colours: list[Any], ends: CurveEnds) -> None:
        for k, ((common, difference), rows) in enumerate(groups):
            end = curve(
                axes, rows, ("angle_deg", "torque_n_m"), rows["set_angle_deg"], colours[k], k
            )
            ends.append((*end, f"{common:g}, {difference:+g}", colours[k]))

    heading = "common,\ndifference (kPa)"
    return curves_figure(len(groups), "angle (degrees)", "torque (N m)", heading, draw)


def stiffness_figure(cells: Sequence[LockedCell]) -> Figure:
    """Stiffness against common pressure, one marker per differential pressure."""
    differences = sorted({cell.difference_kpa for cell in cells})
    colours = sequence(len(differences))
    with style():
        figure, axes = new_figure(DOUBLE_COLUMN, 3.6)
        # Beside each other: the stiffness hardly depends on the difference.
        middle = 0.5 * (len(differences) - 1)
        apart = 0.01 * (max(c.common_kpa for c in cells) - min(c.common_kpa for c in cells))
        for k, difference in enumerate(differences):
            own = [cell for cell in cells if cell.difference_kpa == difference]
            axes.errorbar(
                [cell.common_kpa + (k - middle) * apart for cell in own],
                [cell.stiffness_n_m_rad for cell in own],
                yerr=[COVERAGE * cell.u_stiffness_n_m_rad for cell in own],
                fmt=marker(k), color=colours[k], markersize=4,
                label=f"{difference:+g} kPa".replace("-", "−"),
            )  # fmt: skip
        axes.set_xlabel("common pressure (kPa)")
        axes.set_ylabel("stiffness (N m/rad)")
        axes.set_ylim(0.0, 1.2 * max(cell.stiffness_n_m_rad for cell in cells))
        axes.legend(title="difference", fontsize=8, title_fontsize=8)
    return figure


def answers_figure(answers: Sequence[tuple[str, Array, Array]]) -> Figure:
    """Angle against time since the step.

    Args:
        answers: label, times in s, angles in degrees, of each step.
    """
    colours = sequence(len(answers))
    with style():
        figure, axes = new_figure(DOUBLE_COLUMN, 4.2)
        for k, (label, time_s, angle_deg) in enumerate(answers):
            axes.plot(time_s, angle_deg, color=colours[k], linewidth=1.0, label=label)
        axes.axvline(0.0, color=QUIET, linewidth=0.8)
        axes.axhline(0.0, color=QUIET, linewidth=0.8)
        axes.set_xlabel("time since the step (s)")
        axes.set_ylabel("angle (degrees)")
        if answers:
            axes.legend(fontsize=8, loc="upper right", bbox_to_anchor=(1.0, 1.0))
    return figure


def pressures_figure(curves: Sequence[tuple[str, Array, Array]]) -> Figure:
    """Both pressures against time since the first step."""
    with style():
        figure, axes = new_figure(DOUBLE_COLUMN, 2.6)
        for colour, (label, time_s, kpa) in zip(("#0072B2", SET), curves, strict=False):
            axes.plot(time_s, kpa, color=colour, linewidth=0.8, label=label)
        axes.set_xlabel("time (s)")
        axes.set_ylabel("pressure (kPa)")
        axes.legend(fontsize=8)
    return figure
