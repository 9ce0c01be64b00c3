"""Figures of the blind check: reliability, rates over size, confusion, limits of diagnosis."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

# Okabe and Ito's colours, distinct for colour-blind readers.
BLUE, ORANGE, GREEN, RED, GREY = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#777777"


def wilson_bars(shares: list[dict[str, Any]]) -> np.ndarray:
    """Distances down and up to the interval's ends, shape (2, shares)."""
    down = [s["value"] - s["low"] for s in shares]
    up = [s["high"] - s["value"] for s in shares]
    return np.asarray(np.maximum(np.array([down, up]), 0.0))


def reliability(found: dict[str, Any], path: Path) -> None:
    """Share right against stated probability, with counts."""
    figure, axis = plt.subplots(figsize=(5.2, 4.6), layout="constrained")
    axis.plot([0, 1], [0, 1], color=GREY, lw=1, ls="--", label="perfectly calibrated")
    bins = found["reliability"]
    if bins:
        c, r, n = (np.array([b[i] for b in bins], dtype=float) for i in range(3))
        centre = (r + 1.92 / n) / (1 + 3.84 / n)
        half = 1.96 / (1 + 3.84 / n) * np.sqrt(r * (1 - r) / n + 0.96 / n**2)
        bars = np.maximum([r - (centre - half), centre + half - r], 0.0)
        axis.errorbar(c, r, bars, fmt="o", color=BLUE, capsize=3, label="sets, 95 % interval")
        for x, y, count in zip(c, r, n, strict=True):
            axis.annotate(f"{count:.0f}", (x, y), textcoords="offset points", xytext=(6, -10),
                          fontsize=8)  # fmt: skip
    axis.set(xlabel="stated probability of the first hypothesis", ylabel="share right",
             xlim=(0, 1.02), ylim=(-0.02, 1.04))  # fmt: skip
    axis.legend(frameon=False, loc="upper left")
    figure.savefig(path, dpi=130)
    plt.close(figure)


def sizes(found: dict[str, Any], path: Path) -> None:
    """Rates over the size of the gap."""
    figure, axis = plt.subplots(figsize=(6.4, 4.2), layout="constrained")
    bands = found["by_size"]
    lines = (
        ("family_right", "right family", BLUE, "o"),
        ("stage_right", "right stage", GREEN, "s"),
        ("named_right", "right name given", ORANGE, "^"),
        ("wrong_name", "wrong name given", RED, "x"),
    )
    for offset, (key, label, colour, marker) in enumerate(lines):
        here = [(i, b[key]) for i, b in enumerate(bands) if b[key]["of"]]
        if here:
            x = np.array([i for i, _ in here]) + 0.06 * (offset - 1.5)
            shares = [s for _, s in here]
            axis.errorbar(x, [s["value"] for s in shares], wilson_bars(shares), fmt=marker + "-",
                          color=colour, label=label, capsize=2, lw=1)  # fmt: skip
    labels = [f"{b['band']}\n({b['family_right']['of']} sets)" for b in bands]
    axis.set_xticks(range(len(bands)), labels)
    axis.set(xlabel="recalibrated gap over the replicate floor", ylabel="share of sets",
             ylim=(-0.03, 1.05))  # fmt: skip
    axis.legend(frameon=False, ncols=2, loc="center right")
    figure.savefig(path, dpi=130)
    plt.close(figure)


def confusion(found: dict[str, Any], path: Path) -> None:
    """Hidden family against verdict, for small and for clear gaps; counts in the cells."""
    tables = found["confusion"]
    groups = (
        ("below 1.5 floors", ("0-0.75", "0.75-1.5")),
        ("from 1.5 floors", ("1.5-3", "3-6", ">6")),
    )
    merged = []
    for title, names in groups:
        total: dict[str, dict[str, int]] = {}
        for name in names:
            for hidden, line in tables.get(name, {}).items():
                for word, count in line.items():
                    row = total.setdefault(hidden, {})
                    row[word] = row.get(word, 0) + count
        merged.append((title, total))
    rows = sorted({h for _, t in merged for h in t}, key=lambda x: (x == "none", x))
    last = ("none", "unknown", "unfit", "crashed")
    said_all = {s for _, t in merged for line in t.values() for s in line}
    columns = sorted(said_all - set(last)) + [s for s in last if s in said_all]
    figure, axes = plt.subplots(1, 2, figsize=(13.0, 6.4), layout="constrained", sharey=True)
    for axis, (title, table) in zip(axes, merged, strict=True):
        values = np.array(
            [[table.get(h, {}).get(s, 0) for s in columns] for h in rows], dtype=float
        )
        values = values.reshape(len(rows), len(columns))
        share = values / np.maximum(values.sum(axis=1, keepdims=True), 1.0)
        axis.imshow(share, cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
        for i in range(len(rows)):
            for j in range(len(columns)):
                if values[i, j]:
                    axis.text(j, i, f"{values[i, j]:.0f}", ha="center", va="center", fontsize=8,
                              color="white" if share[i, j] > 0.6 else "black")  # fmt: skip
        axis.set_xticks(range(len(columns)), columns, rotation=60, ha="right")
        axis.set_yticks(range(len(rows)), rows)
        axis.set(title=f"gap {title}", xlabel="verdict (family, or none, unknown, unfit)")
    axes[0].set_ylabel("hidden family (none: nominal sets)")
    figure.savefig(path, dpi=120)
    plt.close(figure)


def limits(found: dict[str, Any], path: Path) -> None:
    """Smallest gap from which on 90 % of the sets got the right family, effect by effect."""
    effects = found["effects"]
    figure, axis = plt.subplots(
        figsize=(7.0, 0.26 * max(len(effects), 4) + 1.2), layout="constrained"
    )
    for i, effect in enumerate(effects):
        limit = effect["limit_floors"]
        if limit is None:
            axis.text(0.12, i, f"not reached ({effect['sets']} sets)", va="center", fontsize=8,
                      color=RED)  # fmt: skip
        else:
            axis.barh(i, limit, color=BLUE, height=0.6)
            axis.text(limit * 1.05, i, f"{effect['sets']} sets", va="center", fontsize=8)
    axis.axvline(2.0, color=GREY, ls="--", lw=1)
    axis.set_yticks(range(len(effects)), [e["effect"] for e in effects])
    axis.set_xscale("log")
    axis.set(xlabel="limit of diagnosis: recalibrated gap over the replicate floor", xlim=(0.1, 30))
    axis.invert_yaxis()
    figure.savefig(path, dpi=130)
    plt.close(figure)
