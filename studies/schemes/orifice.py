"""Map of orifice size and valve speed that would prevent the oscillation.

The muscle is held at 60 mm. The conductance is proportional to the square of the orifice diameter
(1.25e-9 m3/(s Pa) at 1.0 mm). All four delays are those of the thesis times one factor. The steady
error is the rms distance of the true pressure from the set-point over the last second of 3 s.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from plant.arrays import Array
from plant.constants import (
    GAS_CONSTANT_J_KG_K,
    KEYS,
    REFERENCE_DENSITY_KG_M3,
    PlantConstants,
    nominal,
)
from plant.physics.muscle import chamber_volume
from studies.schemes.command import Progress
from studies.schemes.result import CONFIRMED, CONTRADICTED, Grid, Statement, Study
from studies.schemes.schemes import measure
from studies.schemes.trial import INTENDED, TITLES, Bench

if TYPE_CHECKING:
    from matplotlib.figure import Figure


DIAMETERS_MM = (0.15, 0.2, 0.3, 0.4, 0.5, 0.7, 1.0, 1.4)
SPEEDS = (0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 1.0, 1.4)
"""Delays relative to those of the thesis (on 10.9 ms, off 8.5 ms at 550 kPa)."""
STEPS = (0.25, 0.55, 0.85, 0.5, 0.25)
CURED_RMS = 2.0
"""Cured means a steady error below this, in % of supply."""


def valve(diameter_mm: float, speed: float) -> PlantConstants:
    """The bench of the thesis with another orifice and scaled delays."""
    c = nominal()
    changes = {f"{s}_conductance_m3_s_pa": 1.25e-9 * diameter_mm**2 for s in ("inlet", "outlet")}
    for side in ("inlet", "outlet"):
        for edge in ("on", "off"):
            for key in (f"{side}_{edge}_ms", f"{side}_{edge}_ms_per_kpa"):
                assert key in KEYS
                changes[key] = c.value(key) * speed
    return c.with_overrides(changes)


def burst_share(c: PlantConstants) -> float:
    """Pressure rise from choked flow through the inlet during one off-delay, in % of supply."""
    off = c.inlet_off_s + c.inlet_off_s_per_pa * c.supply_pa
    absolute = c.supply_pa + c.atmosphere_pa
    slew = (
        c.inlet_conductance_m3_s_pa * REFERENCE_DENSITY_KG_M3 * GAS_CONSTANT_J_KG_K
        * c.gas_temperature_k * absolute / float(chamber_volume(0.060, c))
    )  # fmt: skip
    return 100.0 * slew * off / c.supply_pa


def run(full: bool, progress: Progress) -> Study:
    """Run the study; `full` on the whole grid with three noise realizations."""
    diameters = DIAMETERS_MM if full else (0.2, 0.5, 1.0)
    speeds = SPEEDS if full else (0.1, 0.5, 1.0)
    seeds = 3 if full else 1
    steps = STEPS if full else STEPS[:3]
    maps = {s: np.full((len(speeds), len(diameters)), np.nan) for s in INTENDED}
    slow = {s: np.full((len(speeds), len(diameters)), np.nan) for s in INTENDED}
    cells = [(i, j) for i in range(len(speeds)) for j in range(len(diameters))]
    for i, j in progress.over(cells, "orifice map"):
        bench = Bench(valve(diameters[j], speeds[i]))
        for scheme in INTENDED:
            figures = measure(bench, scheme, steps, seeds)
            maps[scheme][i, j] = figures["rms"][0]
            slow[scheme][i, j] = figures["rise_s"][0]
    worth = np.array([[burst_share(valve(d, v)) for d in diameters] for v in speeds])
    grids = tuple(
        Grid(
            f"Steady error of {TITLES[s]} (rms, % of supply)",
            ("delays, share of the thesis", *(f"{d:g} mm" for d in diameters)),
            tuple((f"{v:g}", *(f"{x:.1f}" for x in row)) for v, row in
                  zip(speeds, maps[s], strict=True)),
        )
        for s in INTENDED
    )  # fmt: skip
    return Study(
        "orifice",
        "How small an orifice or how fast a valve would have prevented the oscillation?",
        _statements(maps, slow, worth, diameters, speeds),
        (_limits(maps, slow, worth, diameters, speeds), *grids),
        {"orifice": lambda: _figure(maps, worth, diameters, speeds)},
        (
            f"Cured means a steady error below {CURED_RMS:g} % of supply. The burst is the "
            "pressure rise from choked flow during one off-delay, relative to supply. Both "
            "remedies of section 5.10 reduce it.",
        ),
    )


def _limits(
    maps: dict[str, Array],
    slow: dict[str, Array],
    worth: Array,
    diameters: tuple[float, ...],
    speeds: tuple[float, ...],
) -> Grid:
    """Limits of each remedy alone, and the largest burst that is cured."""
    rows = []
    as_1996 = speeds.index(1.0), diameters.index(1.0)
    for s in INTENDED:
        cured = maps[s] < CURED_RMS
        row = cured[as_1996[0], :]
        column = cured[:, as_1996[1]]
        small = [d for d, ok in zip(diameters, row, strict=True) if ok]
        fast = [v for v, ok in zip(speeds, column, strict=True) if ok]
        rise = slow[s][as_1996[0], diameters.index(max(small))] if small else float("nan")
        ill = worth[~cured]
        rows.append(
            (
                TITLES[s],
                f"{max(small):g} mm" if small else "none",
                float(rise),
                f"{max(fast):g} of the thesis" if fast else "none",
                float(worth[cured].max()) if cured.any() else float("nan"),
                float(ill.min()) if ill.size else float("nan"),
            )
        )
    heads = ("scheme", "largest orifice, delays of the thesis", "its rise, s",
             "slowest valve, orifice of the thesis", "largest burst cured, %",
             "smallest burst not cured, %")  # fmt: skip
    return Grid("Limits of one remedy alone", heads, tuple(rows))


def _statements(
    maps: dict[str, Array],
    slow: dict[str, Array],
    worth: Array,
    diameters: tuple[float, ...],
    speeds: tuple[float, ...],
) -> tuple[Statement, ...]:
    i, j = speeds.index(1.0), diameters.index(1.0)
    two = maps["two"]
    smaller = [d for d, x in zip(diameters, two[i], strict=True) if x < CURED_RMS]
    faster = [v for v, x in zip(speeds, two[:, j], strict=True) if x < CURED_RMS]
    found = []
    if smaller:
        d = max(smaller)
        k = diameters.index(d)
        because = (
            f"two-position: {two[i, j]:.1f} % at 1.0 mm, {two[i, k]:.1f} % at {d:g} mm, where a "
            f"burst is {worth[i, k]:.1f} % of supply; the rise then takes "
            f"{slow['two'][i, k]:.2f} s instead of {slow['two'][i, j]:.2f} s"
        )
    else:
        because = f"two-position stays at {two[i].min():.1f} % or above on this grid"
    found.append(
        Statement("a smaller orifice would cure it", "5.10, 5.15",
                  CONFIRMED if smaller else CONTRADICTED, because)
    )  # fmt: skip
    if faster:
        v = max(faster)
        k = speeds.index(v)
        because = (
            f"two-position: {two[i, j]:.1f} % with the delays of the thesis, "
            f"{two[k, j]:.1f} % with {v:g} of them (off after {8.5 * v:.1f} ms), where a burst is "
            f"{worth[k, j]:.1f} % of supply"
        )
    else:
        because = (
            f"not at 1.0 mm on this grid: {two[0, j]:.1f} % even with {speeds[0]:g} of the delays, "
            "because the period of the loop is 1 ms, in which the open inlet adds "
            f"{worth[i, j] / 8.5:.1f} % of supply"
        )
    found.append(
        Statement("a faster valve would cure it", "5.10, 5.15",
                  CONFIRMED if faster else CONTRADICTED, because)
    )  # fmt: skip
    return tuple(found)


def _figure(
    maps: dict[str, Array], worth: Array, diameters: tuple[float, ...], speeds: tuple[float, ...]
) -> Figure:
    """One map per scheme, with contours of the burst."""
    from matplotlib.colors import LogNorm

    from analysis.figures.drawing import new_figure, style

    with style():
        figure, axes = new_figure(8.6, 7.0, rows=2, columns=2)
        for ax, scheme in zip(axes.ravel(), INTENDED, strict=True):
            ax.grid(False)
            mesh = ax.pcolormesh(
                np.arange(len(diameters)), np.arange(len(speeds)), maps[scheme],
                norm=LogNorm(0.1, 30.0), cmap="cividis", shading="nearest",
            )  # fmt: skip
            for a in range(len(speeds)):
                for b in range(len(diameters)):
                    value = maps[scheme][a, b]
                    ink = "white" if value < 3.0 else "black"
                    ax.text(b, a, f"{value:.1f}", ha="center", va="center", fontsize=6.5, color=ink)
            ax.contour(worth, levels=[1.0, 3.0, 10.0], colors="white", linewidths=0.9)
            ax.set_xticks(range(len(diameters)), [f"{d:g}" for d in diameters], fontsize=7.5)
            ax.set_yticks(range(len(speeds)), [f"{v:g}" for v in speeds], fontsize=7.5)
            ax.set_title(TITLES[scheme], loc="left", fontsize=9)
        for ax in axes[-1]:
            ax.set_xlabel("orifice (mm)")
        for ax in axes[:, 0]:
            ax.set_ylabel("delays (share of the thesis)")
        figure.colorbar(
            mesh, ax=axes, label="steady error (rms, % of supply); lines: bursts of 1, 3, 10 %",
            shrink=0.7,
        )  # fmt: skip
    return figure
