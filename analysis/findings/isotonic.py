"""What a table of lengths under hung loads says (Table C-3, Figure 4-13)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.findings.findings import Analysis, Findings, Section
from analysis.reduction.points import reduce_points
from daq.live.layout import LiveLayout

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from analysis.reduction.points import Reduction
    from daq.calibration import Calibration
    from daq.store.run import Run

EXTRA = {"mass_kg": "float64"}


def isotonic_findings(run: Run, reduction: Reduction) -> Findings:
    """Length against pressure, one curve a load, and how far each load is lifted."""
    import pandas as pd

    table = reduction.table
    every = curves_of(table)
    curves = [(name, rows) for name, rows in every if rows["length_mm"].notna().any()]
    blind = [name for name, rows in every if rows["length_mm"].isna().all()]
    camera = reduction.calibrations.get("length_mm")
    rows = [_curve_row(load, rows, camera) for load, rows in curves]
    sections = [
        Section(
            "Length against pressure",
            figure=lambda: _figure(curves),
            caption="One curve a load (the form of the thesis's Figure 4-13). Bars: expanded"
            " uncertainty, k = 2, where larger than the marker.",
        ),
        Section(
            "What each load does",
            (
                "Longest and shortest settled length and the contraction between them, a share of"
                " the longest. Zero and gain of the camera, which all lengths share, are in every"
                " ±.",
                *([f"No length was seen under {', '.join(blind)}."] if blind else []),
            ),
            pd.DataFrame(rows),
            (
                ("load", "load"), ("n", "points"), ("longest", "longest, mm"),
                ("at_longest", "at, kPa"), ("shortest", "shortest, mm"),
                ("at_shortest", "at, kPa"), ("contraction", "contraction"),
            ),
            caption="± expanded uncertainty, k = 2.",
        ),
        _wide(curves),
    ]  # fmt: skip
    if (run.manifest.get("source") or {}).get("table") == "C-3":
        sections.append(_thesis(curves, rows))
    data = {"loads": rows}
    return Findings(_headline(rows, bool(blind)), tuple(sections), data)


def load_names(table: pd.DataFrame) -> pd.Series:
    """A name for the load of each row: hung mass where known, else force."""
    if "mass_kg" in table and table["mass_kg"].notna().any():
        return table["mass_kg"].astype(float).round(4)
    return table["force_n"].astype(float).round(1)


def curves_of(table: pd.DataFrame) -> list[tuple[str, pd.DataFrame]]:
    """Rows of one load together, lightest first, each with a name."""
    by_mass = "mass_kg" in table and table["mass_kg"].notna().any()
    out = []
    for load, rows in table.groupby(load_names(table), sort=True):
        value = float(str(load))
        newton = float(rows["force_n"].mean())
        round_n = abs(newton - round(newton)) < 0.005
        name = f"{value:g} kg" if by_mass and not round_n else f"{newton:.4g} N"
        out.append((name, rows.sort_values("pressure_kpa", kind="stable")))
    return out


def _curve_row(load: str, rows: pd.DataFrame, camera: Calibration | None) -> dict[str, Any]:
    good = rows.dropna(subset=["length_mm"])
    by_length = good.sort_values("length_mm", kind="stable").to_dict("records")
    short, long = by_length[0], by_length[-1]
    ratio = 1.0 - float(short["length_mm"]) / float(long["length_mm"])
    noise = [float(r["u_length_mm_noise"]) / float(r["length_mm"]) for r in (long, short)]
    u = (1.0 - ratio) * math.hypot(*noise)
    if camera is not None:
        ends = np.array([short["length_mm"], long["length_mm"]], dtype=np.float64)
        for moved in (ends + camera.u_offset, ends + camera.u_gain * (ends - camera.offset)):
            u = math.hypot(u, 1.0 - moved[0] / moved[1] - ratio)
    return {
        "load": load,
        "n": len(good),
        "longest": float(long["length_mm"]),
        "u_longest": float(long["u_length_mm"]),
        "at_longest": _nominal(long),
        "shortest": float(short["length_mm"]),
        "u_shortest": float(short["u_length_mm"]),
        "at_shortest": _nominal(short),
        "contraction": ratio,
        "u_contraction": u,
    }


def _nominal(row: Any) -> float:
    set_kpa = float(row["set_pressure_kpa"])
    return set_kpa if math.isfinite(set_kpa) else round(float(row["pressure_kpa"]))


def _wide(curves: list[tuple[str, pd.DataFrame]]) -> Section:
    """The form of Table C-3: a row a pressure, a column a load."""
    import pandas as pd

    cells: dict[float, dict[str, Any]] = {}
    for k, (_, rows) in enumerate(curves):
        nominal = rows["set_pressure_kpa"].fillna(rows["pressure_kpa"].round(0))
        for pressure, part in rows.groupby(nominal):
            row = cells.setdefault(float(str(pressure)), {"pressure_kpa": float(str(pressure))})
            n = max(int(part["length_mm"].notna().sum()), 1)
            noise = float(np.sqrt((part["u_length_mm_noise"].astype(float) ** 2).sum())) / n
            cal = float(part["u_length_mm_cal"].astype(float).mean())
            row[f"l{k}"] = float(part["length_mm"].mean())
            row[f"u_l{k}"] = math.hypot(noise, 0.0 if math.isnan(cal) else cal)
    heads = [(f"l{k}", f"{name}, mm") for k, (name, _) in enumerate(curves)]
    return Section(
        "The form of Table C-3",
        (),
        pd.DataFrame([cells[p] for p in sorted(cells)]),
        (("pressure_kpa", "pressure, kPa"), *heads),
        caption="Length under each load, mean where a point was repeated; ± expanded uncertainty.",
    )


def _headline(rows: list[dict[str, Any]], blind: bool) -> str:
    if not rows and blind:
        return "No length was seen, so there is no result."
    if not rows:
        return "No settled point was reached, so there is no result."
    shares = [100 * row["contraction"] for row in rows]
    loads = f"{rows[0]['load']} to {rows[-1]['load']}" if len(rows) > 1 else rows[0]["load"]
    spread = f"{min(shares):.0f} to {max(shares):.0f}" if len(rows) > 1 else f"{shares[0]:.1f}"
    return f"Under {loads} the muscle contracts by {spread} % of its longest length."


def _thesis(curves: list[tuple[str, pd.DataFrame]], rows: list[dict[str, Any]]) -> Section:
    """What the text says of Table C-3, held against it."""
    import pandas as pd

    by_load = {
        name: part.set_index(part["set_pressure_kpa"].astype(float))["length_mm"].astype(float)
        for name, part in curves
    }
    ten, thirteen = by_load.get("10 N"), by_load.get("13 N")
    crossed = []
    if ten is not None and thirteen is not None:
        both = ten.index.intersection(thirteen.index)
        crossed = [float(p) for p in both if thirteen[p] < ten[p]]
    rising = [
        name
        for name, lengths in list(by_load.items())[:2]
        if bool((lengths[lengths.index <= 125].diff().dropna() >= 0).all())
    ]
    low, high = min(r["contraction"] for r in rows), max(r["contraction"] for r in rows)
    said = [
        {
            "claim": "contraction lies within 0 to 0.2 (quoted with Equation 4-19)",
            "found": f"{low:.2f} to {high:.2f} from 0 to 600 kPa",
            "same": high <= 0.2,
        },
        {
            "claim": "length rises with pressure up to 125 kPa for the two lightest loads (4.8.3)",
            "found": f"throughout for: {', '.join(rising) or 'neither'}; it wavers",
            "same": len(rising) == 2,
        },
        {
            "claim": "a heavier load hangs lower",
            "found": "13 N shorter than 10 N at "
            + (", ".join(f"{p:g}" for p in crossed) + " kPa" if crossed else "no pressure"),
            "same": not crossed,
        },
    ]
    return Section(
        "Beside what the thesis says",
        (
            "The thesis prints no number derived from Table C-3; these statements can be held"
            " against it.",
        ),
        pd.DataFrame(said),
        (("claim", "said"), ("found", "in the table"), ("same", "agrees")),
    )


def _figure(curves: list[tuple[str, pd.DataFrame]]) -> Figure:
    from analysis.figures.drawing import (
        COVERAGE,
        MARKERS,
        directions_legend,
        labels_at_right,
        new_figure,
        sequence,
        style,
    )

    colours = sequence(len(curves))
    with style():
        figure, axes = new_figure(7.2, 4.9)
        ends: list[tuple[float, float, str, Any]] = []
        for k, (name, rows) in enumerate(curves):
            for direction, part in rows.groupby("direction", sort=True):
                down = direction == "down"
                axes.errorbar(
                    part["pressure_kpa"], part["length_mm"],
                    xerr=COVERAGE * np.nan_to_num(part["u_pressure_kpa"].astype(float)),
                    yerr=COVERAGE * np.nan_to_num(part["u_length_mm"].astype(float)),
                    fmt=MARKERS[k % len(MARKERS)], markersize=5 if down else 3.4,
                    markerfacecolor="white" if down else colours[k], color=colours[k],
                    elinewidth=0.7,
                )  # fmt: skip
                nominal = part["set_pressure_kpa"].fillna(part["pressure_kpa"].round(0))
                mean = part[["pressure_kpa", "length_mm"]].astype(float).groupby(nominal).mean()
                axes.plot(
                    mean["pressure_kpa"], mean["length_mm"], color=colours[k], linewidth=1.0,
                    linestyle="--" if down else "-",
                )  # fmt: skip
            last = rows.dropna(subset=["length_mm"]).iloc[-1]
            ends.append((float(last["pressure_kpa"]), float(last["length_mm"]), name, colours[k]))
        axes.set_xlabel("pressure (kPa gauge)")
        axes.set_ylabel("length (mm)")
        labels_at_right(axes, ends, "load")
        if any((rows["direction"] == "down").any() for _, rows in curves):
            directions_legend(axes, "pressure", "upper right")
    return figure


def _reduce(run: Run) -> Reduction:
    """Settled points with the mass that hung at each."""
    return reduce_points(run, extra=EXTRA)


def _layout(parameters: Mapping[str, Any]) -> LiveLayout:
    """Its screen."""
    from analysis.layouts.static import isotonic_layout

    return isotonic_layout(pressure_max_kpa=max(parameters.get("pressures_kpa") or [600.0]))


ISOTONIC = Analysis("isotonic", "Isotonic test", _reduce, _layout, isotonic_findings)
ANALYSES = (ISOTONIC,)
