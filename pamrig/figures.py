"""Figures for notebooks and papers: each function draws into an axis and returns it.

``pamrig.figures.force(run, ax)`` for example. Without an axis a new figure is made. Nothing is
shown, saved or printed; ``ax.figure`` is the figure. Bars are expanded uncertainties (k = 2).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

    from pamrig import RecordedRun

__all__ = ["force", "length", "pressure", "residuals"]

LABELS = {
    "pressure_kpa": "pressure (kPa gauge)",
    "force_n": "force (N)",
    "length_mm": "length (mm)",
    "mass_kg": "load (kg)",
}


def force(run: RecordedRun | pd.DataFrame, ax: Axes | None = None) -> Axes:
    """Force against pressure, one curve per length.

    Filled markers: rising pressure; open ones: falling. The line joins the means of replicates.

    Args:
        run: a run of settled points, or its table.
        ax: where to draw.

    Raises:
        ValueError: the table has no column of forces.
    """
    return _curves(_table(run), ("pressure_kpa", "force_n"), "set_length_mm", ax)


def length(run: RecordedRun | pd.DataFrame, ax: Axes | None = None) -> Axes:
    """Length against pressure, one curve per load; as :func:`force` otherwise."""
    return _curves(_table(run), ("pressure_kpa", "length_mm"), "mass_kg", ax)


def pressure(run: RecordedRun, ax: Axes | None = None) -> Axes:
    """Measured pressure and set-point against time.

    Args:
        run: any run with the valve controller.
        ax: where to draw.
    """
    from analysis.figures.drawing import QUIET, sequence, style

    samples = run.samples
    with style():
        ax = _axis(ax)
        ax.plot(
            samples["time_s"], samples["setpoint_kpa"], color=QUIET, label="set-point",
            linewidth=0.9, drawstyle="steps-post",
        )  # fmt: skip
        ax.plot(samples["time_s"], samples["pressure_kpa"], color=sequence(2)[0], label="measured")
        ax.set(xlabel="time (s)", ylabel=LABELS["pressure_kpa"])
        ax.legend(frameon=False)
    return ax


def residuals(
    measured: pd.DataFrame, model: Callable[[Any, Any], Any], ax: Axes | None = None
) -> Axes:
    """Measured force less the force of a model, against pressure, one curve per length.

    Args:
        measured: a table of settled points: pressure_kpa, length_mm, force_n, u_force_n.
        model: force in N for pressures in kPa and lengths in mm, arrays of shape (n,). For one of
            the catalogue: ``lambda p, x: law.force(1e3 * p, 1e-3 * x)``.
        ax: where to draw.

    Raises:
        ValueError: the table has no column of forces.
    """
    _need(measured, "force_n")
    table = measured.dropna(subset=["pressure_kpa", "length_mm", "force_n"]).copy()
    values = model(table["pressure_kpa"].to_numpy(), table["length_mm"].to_numpy())
    table["force_n"] = table["force_n"] - values
    ax = _curves(table, ("pressure_kpa", "force_n"), "set_length_mm", ax)
    ax.axhline(0.0, color="0.6", linewidth=0.8, zorder=1)
    ax.set_ylabel("measured − model (N)")
    return ax


def _table(run: RecordedRun | pd.DataFrame) -> pd.DataFrame:
    import pandas as pd

    return run if isinstance(run, pd.DataFrame) else run.table


def _need(table: pd.DataFrame, *columns: str) -> None:
    for column in columns:
        if column not in table or table[column].isna().all():
            there = ", ".join(map(str, table))
            raise ValueError(f"the table has no values of {column}: it has {there}")


def _curves(table: pd.DataFrame, columns: tuple[str, str], by: str, ax: Axes | None) -> Axes:
    """Points with bars, and lines through the means, one curve per value of a column."""
    import numpy as np
    import pandas as pd

    from analysis.figures.drawing import curve, sequence, style

    _need(table, *columns)
    table = table.copy()
    for column in columns:
        if f"u_{column}" not in table:
            table[f"u_{column}"] = np.nan
    setting = table.get(f"set_{columns[0]}", pd.Series(np.nan, table.index))
    setting = setting.fillna(table[columns[0]])
    held = table.get(by, pd.Series(np.nan, table.index))
    if by.startswith("set_"):
        held = held.fillna(table.get(by.removeprefix("set_"), held).round(1))
    groups = sorted(held.dropna().unique()) or [np.nan]
    with style():
        ax = _axis(ax)
        for index, (value, colour) in enumerate(zip(groups, sequence(len(groups)), strict=True)):
            rows = table if np.isnan(value) else table[held == value]
            label = None if np.isnan(value) else f"{value:g}"
            for down, part in _directions(rows):
                curve(
                    ax, part, columns, setting, colour, index, down=down,
                    label=None if down else label,
                )  # fmt: skip
        ax.set(xlabel=LABELS[columns[0]], ylabel=LABELS[columns[1]])
        if len(groups) > 1:
            title = LABELS[by.removeprefix("set_")]
            ax.legend(title=title, frameon=False, ncols=1 + len(groups) // 8)
    return ax


def _directions(rows: pd.DataFrame) -> list[tuple[bool, pd.DataFrame]]:
    """(whether the pressure was falling, rows) of each direction."""
    if "direction" not in rows:
        return [(False, rows)]
    falling = rows["direction"] == "down"
    return [(down, rows[falling == down]) for down in (False, True) if (falling == down).any()]


def _axis(ax: Axes | None) -> Axes:
    if ax is not None:
        return ax
    from analysis.figures.drawing import new_figure

    _, made = new_figure(3.5, 2.8)
    found: Axes = made
    return found
