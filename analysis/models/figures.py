"""Figures of model fits (curves, surface, residuals) and of model comparisons."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.figures.drawing import (
    INK,
    MEASURED,
    QUIET,
    SET,
    new_figure,
    sequence,
    spread,
    style,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from plant.fitting.compare import Comparison
    from plant.fitting.data import Points
    from plant.fitting.fit import Fit

BEST = "#009E73"
"""Colour of models that are not significantly worse than the best; safe for colour blindness."""
FEW = 40
"""Up to this number of points, the markers are large."""


def fit_figure(fit: Fit, points: Points) -> Figure:
    """Curves, surface and residual map of a fit, and residuals against each input."""
    with style():
        figure, axes = new_figure(11.0, 6.6, 2, 3)
        _curves(axes[0, 0], fit, points)
        _surface(axes[0, 1], fit, points)
        _residual_map(axes[0, 2], fit, points)
        inputs: list[tuple[str, Any]] = [
            ("pressure in kPa", points.pressure_pa / 1e3),
            ("length in mm", points.length_m * 1e3),
        ]
        if np.ptp(points.temperature_c) > 2.0:
            inputs.append(("temperature in °C", points.temperature_c))
        else:
            inputs.append(("fitted force in N", points.force_n - fit.residual_n))
        for ax, (label, x) in zip(axes[1], inputs, strict=True):
            _residuals(ax, x, fit.residual_n, label)
        model = fit.model
        figure.suptitle(
            f"{model.name} fitted to {points.source}: rmse {fit.rmse_n:.2f} N, "
            f"{len(fit.free)} parameters, {len(points)} points",
            fontsize=11, color=INK,
        )  # fmt: skip
        return figure


def comparison_figure(comparison: Comparison) -> Figure:
    """Held-out rmse of each model with its interval, and the scatter between lengths."""
    with style():
        figure, axes = new_figure(9.4, 0.42 * len(comparison.scores) + 1.9, 1, 2)
        shown = [s for s in comparison.scores if np.isfinite(s.rmse_n)]
        rows = np.arange(len(shown))[::-1]
        ax: Axes = axes[0]
        for y, score in zip(rows, shown, strict=True):
            colour = MEASURED if score.real else BEST
            ax.plot([score.rmse_low_n, score.rmse_high_n], [y, y], color=colour, linewidth=2)
            ax.plot(score.rmse_n, y, "o" if not score.real else "s", color=colour, markersize=6)
            ax.plot(score.train_rmse_n, y, "|", color=QUIET, markersize=9)
        ax.set_yticks(rows, [f"{s.model} ({s.parameters})" for s in shown])
        floor = comparison.floors.between_lengths_n
        if np.isfinite(floor):
            ax.axvline(floor, color=SET, linewidth=1.4, linestyle="--")
            ax.annotate(
                f"scatter between\nlengths {floor:.2f} N", (floor, rows[0] + 0.62),
                xytext=(4, 0), textcoords="offset points", color=INK, fontsize=8, va="center",
            )  # fmt: skip
        ax.set_ylim(-0.6, len(shown) + 0.2)
        ax.set_xlim(left=0)
        ax.set_xlabel(f"rmse on held-out {comparison.holdout}s in N (95 % interval)")
        ax.set_title(
            "round, green: not significantly worse than the best; square, blue: worse;"
            " tick: fit to all",
            fontsize=8, color=QUIET, loc="left",
        )  # fmt: skip
        by_region: Axes = axes[1]
        for k, name in enumerate(next(iter(shown)).regions):
            values = [s.regions[name] for s in shown]
            by_region.plot(
                values, rows, ("D", "v")[k % 2], color=(SET, INK)[k % 2], markersize=6, label=name
            )
        by_region.set_yticks(rows, [])
        by_region.set_ylim(-0.6, len(shown) + 0.2)
        by_region.set_xlim(left=0)
        by_region.set_xlabel("rmse by pressure region in N")
        by_region.legend(loc="upper right", fontsize=8)
        return figure


def _curves(ax: Axes, fit: Fit, points: Points) -> None:
    """Force against pressure at each length: points, and the model as a line."""
    lengths = _groups(points)
    picked = lengths if len(lengths) <= 6 else [
        lengths[round(i)] for i in np.linspace(0, len(lengths) - 1, 6)
    ]  # fmt: skip
    temperature = float(np.median(points.temperature_c))
    ends: list[tuple[float, float, str, Any]] = []
    for (length, use), colour in zip(picked, sequence(len(picked)), strict=True):
        near = use & (np.abs(points.temperature_c - temperature) < 2.0)
        p = points.pressure_pa[near] / 1e3
        ax.plot(p, points.force_n[near], "o", color=colour, markersize=3.5)
        if not p.size:
            continue
        grid = np.linspace(float(p.min()), float(p.max()), 120)
        if not fit.model.law.memory:
            modelled = fit.model.force(grid * 1e3, length, temperature, outside="ignore")
            ax.plot(grid, modelled, color=colour, linewidth=1.2)
        top = int(np.argmax(p))
        ends.append(
            (float(p[top]), float(points.force_n[near][top]), f"{length * 1e3:.1f}", colour)
        )
    low, high = ax.get_ylim()
    ends.sort(key=lambda end: end[1])
    places = spread([end[1] for end in ends], 0.06 * (high - low))
    for (x, _, label, _), place in zip(ends, places, strict=True):
        ax.annotate(label, (x, place), xytext=(5, 0), textcoords="offset points", fontsize=8,
                    color=INK, va="center", annotation_clip=False)  # fmt: skip
    ax.set_xlabel("pressure in kPa")
    ax.set_ylabel("force in N")
    ax.set_title("points and model (lines), length in mm", fontsize=9, loc="left")


def _surface(ax: Axes, fit: Fit, points: Points) -> None:
    """The model over pressure and length as filled contours; points as dots."""
    p = np.linspace(points.pressure_pa.min(), points.pressure_pa.max(), 90)
    length = np.linspace(points.length_m.min(), points.length_m.max(), 90)
    ax.set_xlabel("pressure in kPa")
    ax.set_ylabel("length in mm")
    ax.set_title("model: force in N", fontsize=9, loc="left")
    if fit.model.law.memory or np.ptp(length) == 0:
        ax.text(0.5, 0.5, "no surface: model with memory, or one length", ha="center", va="center",
                transform=ax.transAxes, color=QUIET)  # fmt: skip
        return
    grid = np.meshgrid(p, length)
    temperature = float(np.median(points.temperature_c))
    force = fit.model.force(grid[0], grid[1], temperature, outside="ignore")
    filled = ax.contourf(grid[0] / 1e3, grid[1] * 1e3, force, levels=14, cmap="cividis")
    ax.plot(points.pressure_pa / 1e3, points.length_m * 1e3, ".", color="white", markersize=2)
    figure: Any = ax.figure
    figure.colorbar(filled, ax=ax).ax.tick_params(labelsize=7.5)
    ax.grid(visible=False)


def _residual_map(ax: Axes, fit: Fit, points: Points) -> None:
    """Mean residual of each cell of pressure and length: measured minus model force."""
    cells: dict[tuple[float, float], list[float]] = {}
    for p, x, r in zip(points.pressure_pa, points.length_m, fit.residual_n, strict=True):
        cells.setdefault((round(p / 1e3, 0), round(x * 1e3, 1)), []).append(float(r))
    where = np.array(list(cells))
    # Points of several temperatures or directions have the same position: draw their mean.
    mean = np.array([np.mean(values) for values in cells.values()])
    limit = float(np.percentile(np.abs(mean), 98)) or 1.0
    drawn = ax.scatter(
        where[:, 0], where[:, 1], c=mean, cmap="PuOr", vmin=-limit, vmax=limit,
        s=60 if mean.size <= FEW else 22, marker="s", edgecolors=QUIET, linewidths=0.3,
    )  # fmt: skip
    figure: Any = ax.figure
    figure.colorbar(drawn, ax=ax, extend="both").ax.tick_params(labelsize=7.5)
    ax.set_xlabel("pressure in kPa")
    ax.set_ylabel("length in mm")
    ax.set_title("measured − model in N", fontsize=9, loc="left")


def _residuals(ax: Axes, x: Any, residual: Any, label: str) -> None:
    """Residuals against one input, with the mean of each bin."""
    ax.axhline(0.0, color=QUIET, linewidth=0.8)
    ax.plot(x, residual, "o", color=MEASURED, markersize=4 if len(x) <= FEW else 2.5, alpha=0.65)
    values = np.unique(x)
    if values.size > 20:
        edges = np.linspace(x.min(), x.max(), 11)
        index = np.clip(np.digitize(x, edges) - 1, 0, 9)
        centres = [(float(np.mean(x[index == k])), float(np.mean(residual[index == k])))
                   for k in range(10) if np.any(index == k)]  # fmt: skip
    else:
        centres = [(float(v), float(np.mean(residual[x == v]))) for v in values]
    ax.plot(*zip(*centres, strict=True), color=SET, linewidth=1.6, label="mean")
    ax.set_xlabel(label)
    ax.set_ylabel("measured − model in N")
    ax.legend(fontsize=8, loc="best")


def _groups(points: Points) -> list[tuple[float, Any]]:
    labels = points.labels("length")
    found = [(float(np.mean(points.length_m[labels == n])), labels == n) for n in np.unique(labels)]
    return sorted(found, key=lambda pair: pair[0])
