"""From scored sets to the table: each figure with its target, its count and its interval."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from gap.check.scoring.score import MIMICKED, Row
from gap.check.scoring.statistics import (
    bins_of,
    calibration_error,
    debiased_error,
    limit_of_diagnosis,
    share,
)

CLEAR = 2.0
BANDS = ((0.0, 0.75), (0.75, 1.5), (1.5, 3.0), (3.0, 6.0), (6.0, math.inf))
Test = Callable[[Row], bool]


def band_name(band: tuple[float, float]) -> str:
    """A band of sizes in floors, for people."""
    return f"{band[0]:g}-{band[1]:g}" if band[1] < math.inf else f">{band[0]:g}"


def rate(rows: Iterable[Row], flag: str | Test, of: Test) -> dict[str, Any]:
    """Share of the rows that pass `of` for which `flag` holds."""
    kept = [r for r in rows if of(r)]
    test = (lambda r: bool(r[flag])) if isinstance(flag, str) else flag
    return share([test(r) for r in kept]).as_json()


def catalogue_single(r: Row) -> bool:
    """One catalogue effect is hidden and the catalogue was whole."""
    return r["kind"] in ("single", "degenerate") and r["truth"] == "effects"


def clear(r: Row) -> bool:
    """At least twice the floor, and nobody confounders it."""
    return bool(r["size"] >= CLEAR and r["mimic"] <= MIMICKED)


def headline(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """The figures with a target, in order: name, target, and the share with its interval."""
    fit = [r for r in rows if r["kind"] != "unfit"]
    pairs = [r for r in rows if clear_pair(r)]
    extras = [len(set(r["named"]) - set(r["hidden"])) for r in pairs]
    stated = [r for r in fit if r["confidence"] is not None]
    confidence = np.array([r["confidence"] for r in stated], dtype=float)
    right = np.array([r["right"] for r in stated], dtype=float)
    closed = [
        r["closed"]
        for r in rows
        if clear_single(r) and r["named_right"] and r["closed"] is not None
    ]
    known_closed = [r for r in rows if r.get("closed_true") is not None]
    table: list[tuple[str, str | None, dict[str, Any]]] = [
        ("false alarm at nominal", "<= 0.02",
         rate(rows, "alarm", lambda r: r["kind"] == "nominal")),
        ("right stage, gap >= 2 floors", ">= 0.98", rate(rows, "stage_right", clear_single)),
        ("right family, gap >= 2 floors", ">= 0.95", rate(rows, "family_right", clear_single)),
        ("right name given, gap >= 2 floors", None, rate(rows, "named_right", clear_single)),
        ("wrong name given, any size", "<= 0.02",
         rate(fit, "wrong_name", lambda r: r["mimic"] <= MIMICKED)),
        ("with confounder: credible set contains the truth", ">= 0.95",
         rate(rows, "holds_truth", mimicked)),
        ("with confounder: single name given", "<= 0.05", rate(rows, "single_name", mimicked)),
        ("both effects of a pair named, each >= 2 floors", ">= 0.80",
         rate(rows, "named_right", clear_pair)),
        ("wrong additional names per pair", "<= 0.1",
         number(float(np.mean(extras)) if extras else None, len(extras))),
        ("unknown effect detected, no confounder", ">= 0.90",
         rate(rows, "flagged_unknown", clear_unknown)),
        ("falsely unknown", "<= 0.05",
         rate(rows, "flagged_unknown", lambda r: r["truth"] in ("effects", "none"))),
        ("90 % credible set contains the truth", ">= 0.88",
         rate(fit, "covered", lambda r: r["truth"] == "none" or r["size"] >= 1.0)),
        ("mean size of the credible set", "<= 1.5",
         number(float(np.mean([r["set_size"] for r in fit])) if fit else None, len(fit))),
        ("calibration error, bias-corrected", "<= 0.05",
         number(debiased_error(confidence, right), len(stated))),
        ("closed fraction, median", ">= 0.9",
         number(float(np.median(closed)) if closed else None, len(closed))),
        ("closed fraction: 95 % interval covers", "0.93-0.98",
         rate(known_closed, closed_covers, lambda r: True)),
        ("parameter: 95 % interval covers", "0.93-0.97",
         rate(rows, "parameter_covered", lambda r: "parameter_covered" in r)),
        ("defective data refused", None,
         rate(rows, "flagged_unfit", lambda r: r["kind"] == "unfit")),
        ("sound data refused", None, rate(fit, "flagged_unfit", lambda r: True)),
        ("crashed", "0", rate(rows, "crashed", lambda r: True)),
    ]  # fmt: skip
    return [figure(*line) for line in table]


def clear_single(r: Row) -> bool:
    """A catalogue single that is clear."""
    return catalogue_single(r) and clear(r)


def clear_pair(r: Row) -> bool:
    """Two effects, each of them clear."""
    return bool(r["kind"] == "pair" and clear(r))


def clear_unknown(r: Row) -> bool:
    """Nothing in the catalogue is it, or stands in for it, and it is at least twice the floor."""
    return bool(r["truth"] == "unknown" and r["size"] >= CLEAR and r["mimic"] < 0.8)


def mimicked(r: Row) -> bool:
    """A catalogue single at least twice the floor that others stand in for."""
    return bool(catalogue_single(r) and r["size"] >= CLEAR and r["mimic"] > MIMICKED)


def closed_covers(r: Row) -> bool:
    """Whether the interval of the closed fraction holds the generator's own figure."""
    if r.get("closed_low") is None or r.get("closed_high") is None:
        return False
    return bool(r["closed_low"] <= r["closed_true"] <= r["closed_high"])


def number(value: float | None, of: int) -> dict[str, Any]:
    """A figure that is not a share."""
    plain = None if value is None or math.isnan(value) else round(value, 4)
    return {"value": plain, "low": None, "high": None, "hits": None, "of": of}


def figure(name: str, target: str | None, found: dict[str, Any]) -> dict[str, Any]:
    """A line of the table; `met` is null where there is no target or nothing to count."""
    met = None
    value = found["value"]
    if target is not None and value is not None:
        if target.startswith("<="):
            met = value <= float(target[2:])
        elif target.startswith(">="):
            met = value >= float(target[2:])
        elif "-" in target:
            low, high = target.split("-")
            met = float(low) <= value <= float(high)
        else:
            met = value == float(target)
    return {"figure": name, "target": target, "met": met, **found}


def by_effect(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Per effect: right names and families by band of size, wrong names, limit of diagnosis."""
    singles = [r for r in rows if catalogue_single(r)]
    out = []
    for name in sorted({r["hidden"][0] for r in singles}):
        own = [r for r in singles if r["hidden"][0] == name]
        plain = [r for r in own if r["mimic"] <= MIMICKED]
        bands = {}
        for band in BANDS:
            here = [r for r in own if band[0] <= r["size"] < band[1]]
            bands[band_name(band)] = {
                "sets": len(here),
                "named": sum(r["named_right"] for r in here),
                "family": sum(r["family_right"] for r in here),
            }
        sizes = np.array([r["size"] for r in plain])
        hits = np.array([float(r["family_right"]) for r in plain])
        out.append(
            {
                "effect": name,
                "sets": len(own),
                "mimicked": len(own) - len(plain),
                "wrong": sum(r["wrong_name"] for r in own),
                "limit_floors": limit_of_diagnosis(sizes, hits) if len(plain) > 1 else None,
                "bands": bands,
            }
        )
    return out


def confusion(rows: Sequence[Row]) -> dict[str, dict[str, dict[str, int]]]:
    """By band of size: hidden family to verdict (family, `none`, `unknown`, `unfit`) to count."""
    out: dict[str, dict[str, dict[str, int]]] = {}
    for band in BANDS:
        table: dict[str, dict[str, int]] = {}
        for r in rows:
            single = catalogue_single(r) and band[0] <= r["size"] < band[1]
            if not single and not (r["kind"] == "nominal" and band[0] == 0.0):
                continue
            word = verdict_word(r)
            line = table.setdefault(r["family"] or "none", {})
            line[word] = line.get(word, 0) + 1
        out[band_name(band)] = table
    return out


def verdict_word(r: Row) -> str:
    """What a verdict came to, in one word: the best explanation's family or an abstention."""
    if r["status"] in ("no_gap_above_floor", "below_resolution"):
        return "none"
    if r["status"] in ("unknown", "data_unfit", "crashed"):
        return "unfit" if r["status"] == "data_unfit" else str(r["status"])
    return str(r.get("best_family") or "+".join(r["best"]) or "unknown")


def totals(rows: Sequence[Row]) -> dict[str, Any]:
    """Everything the page shows, as plain JSON values."""
    fit = [r for r in rows if r["kind"] != "unfit" and r["confidence"] is not None]
    confidence = np.array([r["confidence"] for r in fit], dtype=float)
    right = np.array([float(r["right"]) for r in fit])
    seconds = [r["seconds"] for r in rows if r["seconds"] is not None]
    return {
        "sets": len(rows),
        "kinds": {k: sum(r["kind"] == k for r in rows) for k in sorted({r["kind"] for r in rows})},
        "changed": sum(bool(r["changed"]) for r in rows),
        "headline": headline(rows),
        "headline_changed": headline([r for r in rows if r["changed"]]),
        "headline_familiar": headline([r for r in rows if not r["changed"]]),
        "by_size": [
            {"band": band_name(b), **{
                name: rate(rows, name, lambda r, b=b: catalogue_single(r) and  # type: ignore[misc]
                           b[0] <= r["size"] < b[1] and r["mimic"] <= MIMICKED)
                for name in ("stage_right", "family_right", "named_right", "wrong_name", "alarm")
            }} for b in BANDS
        ],
        "effects": by_effect(rows),
        "confusion": confusion(rows),
        "reliability": bins_of(confidence, right, 10) if len(fit) else [],
        "calibration_error": number(calibration_error(confidence, right), len(fit))["value"],
        "seconds_median": round(float(np.median(seconds)), 2) if seconds else None,
        "seconds_most": round(float(np.max(seconds)), 2) if seconds else None,
    }  # fmt: skip


def summary(entries: list[dict[str, Any]]) -> dict[str, Any]:
    """Totals of the diagnosis and of every baseline, as plain JSON values."""
    found = totals([e["score"] for e in entries])
    names = sorted({name for e in entries for name in e["baselines"]})
    found["baselines"] = {
        name: totals([e["baselines"][name] for e in entries if name in e["baselines"]])["headline"]
        for name in names
    }
    found["baseline_sets"] = sum(1 for e in entries if e["baselines"])
    return found
