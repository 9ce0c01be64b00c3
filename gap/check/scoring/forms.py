"""Seen and held-out forms side by side: the same benches and noise, other equations.

Each line is a figure of the campaign for the sets of the stream `beside` (forms that practice and
learning have met) and of `held_out` (forms that they never meet). Sets that hide no effect of the
catalogue have no form: they are made and diagnosed once and count on both sides.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from gap.check.scoring.score import MIMICKED, Row
from gap.check.scoring.statistics import debiased_error
from gap.check.scoring.totals import (
    CLEAR,
    Test,
    catalogue_single,
    clear_single,
    clear_unknown,
    closed_covers,
    number,
    rate,
)

ABOVE_FLOOR = 1.5
"""Floors from which the right family is counted in the first line."""
FORMLESS = ("nominal", "outside", "unfit")
"""Kinds of sets that hide no effect of the catalogue."""


def above(least: float) -> Test:
    """Catalogue singles of at least so many floors that nobody confounds."""
    return lambda r: bool(catalogue_single(r) and r["size"] >= least and r["mimic"] <= MIMICKED)


def calibration(rows: Sequence[Row]) -> dict[str, Any]:
    """Calibration error, debiased: no share of sets, so no interval."""
    stated = [r for r in rows if r["kind"] != "unfit" and r["confidence"] is not None]
    confidence = np.array([r["confidence"] for r in stated], dtype=float)
    right = np.array([float(r["right"]) for r in stated])
    return number(debiased_error(confidence, right), len(stated))


def figures(rows: Sequence[Row]) -> dict[str, dict[str, Any]]:
    """The figures of one side by name, each a share with its Wilson interval at 95 %."""
    fit = [r for r in rows if r["kind"] != "unfit"]
    hidden = [r for r in fit if r["truth"] == "effects"]
    return {
        "false alarm at nominal": rate(rows, "alarm", lambda r: r["kind"] == "nominal"),
        f"right family, gap >= {ABOVE_FLOOR:g} floors": rate(
            rows, "family_right", above(ABOVE_FLOOR)
        ),
        f"right family, gap >= {CLEAR:g} floors": rate(rows, "family_right", clear_single),
        f"right name given, gap >= {CLEAR:g} floors": rate(rows, "named_right", clear_single),
        "wrong name given, any size": rate(fit, "wrong_name", lambda r: r["mimic"] <= MIMICKED),
        "unknown effect detected, no confounder": rate(rows, "flagged_unknown", clear_unknown),
        "falsely unknown": rate(hidden, "flagged_unknown", lambda r: True),
        "90 % credible set contains the truth": rate(
            fit, "covered", lambda r: r["truth"] == "none" or r["size"] >= 1.0
        ),
        "parameter: 95 % interval covers": rate(
            rows, "parameter_covered", lambda r: "parameter_covered" in r
        ),
        "closed fraction: 95 % interval covers": rate(
            rows, closed_covers, lambda r: r.get("closed_true") is not None
        ),
        "calibration error, bias-corrected": calibration(rows),
        "crashed": rate(rows, "crashed", lambda r: True),
    }


def by_form(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Singles of each effect and form: sets, right families and names from 1.5 floors on."""
    found: dict[tuple[str, int], list[Row]] = {}
    for r in rows:
        if above(ABOVE_FLOOR)(r):
            found.setdefault((r["hidden"][0], r["forms"][0]), []).append(r)
    return [
        {
            "effect": effect,
            "form": form,
            "sets": len(own),
            "family": sum(r["family_right"] for r in own),
            "named": sum(r["named_right"] for r in own),
            "wrong": sum(r["wrong_name"] for r in own),
        }
        for (effect, form), own in sorted(found.items())
    ]


def side_by_side(seen: Sequence[Row], held_out: Sequence[Row]) -> dict[str, Any]:
    """Figures of both sides, and counts by form, as plain JSON values."""
    formless = [r for r in seen if r["kind"] in FORMLESS]
    left, right = figures(seen), figures([*held_out, *formless])
    return {
        "seen_sets": len(seen),
        "held_out_sets": len(held_out),
        "formless_sets": len(formless),
        "figures": [{"figure": name, "seen": left[name], "held_out": right[name]} for name in left],
        "by_form": by_form([*seen, *held_out]),
    }
