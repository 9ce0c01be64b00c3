"""Tables of how far the gap shrinks: stage by stage, free-running, against a learner, elsewhere.

A fix that helps where it was fitted may be a fit and no more. So each error is taken on units that
were left out, the model is also run free, a learner without named effects shows what the same
inputs could give, and constants and amounts are compared over the folds.
"""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np
from scipy.stats import t as student

from gap.estimation.cross_validation import HeldOut, floor_squares, gap_of, held_out, left_out
from gap.estimation.fit_problem import FitProblem, FitResult
from gap.model.features import BLOCKS, UNITS
from gap.validation.free_run import free_running
from gap.validation.learner import generic


def shrinkage(problem: FitProblem, fit: FitResult, named: bool) -> dict[str, Any]:
    """All of `pamrig gap shrink`'s tables as plain values; see docs/use/gap.md.

    `named`: the verdict names the effects of the fit; if not, "after" is left out.
    """
    by_slot = held_out(problem, fit)
    return {
        "held_out": {
            scheme: {
                block: asdict(gap_of(block, held, named, "replicates", scheme))
                for block, held in (
                    by_slot if scheme == "slot" else held_out(problem, fit, units)
                ).items()
            }
            for scheme, units in problem.schemes().items()
        },
        "free_running": [
            {"end": end, **asdict(gap_of(end, held, named, "replicates", "slot"))}
            for end, held in free_running(problem, fit).items()
        ],
        "generic": _generic(problem, fit, by_slot) if named else [],
        "transfer": _transfer(problem, fit) if named else [],
        "stability": _stability(problem, fit) if named else [],
    }


def _generic(problem: FitProblem, fit: FitResult, held: dict[str, HeldOut]) -> list[dict[str, Any]]:
    """Errors of the generic learner beside those of the named effects, block by block."""
    learned = generic(problem, len(fit.amounts))
    made = []
    for block, part in held.items():
        weight = max(float(part.weight.sum()), 1e-12)
        named = part.rms("after")
        alike = float(np.sqrt(learned.alike[block].sum() / weight))
        large = float(np.sqrt(learned.large[block].sum() / weight))
        excess = part.rms("recalibrated") ** 2 - part.rms("floor") ** 2
        made.append(
            {
                "block": block, "unit": UNITS[block], "recalibrated": part.rms("recalibrated"),
                "named": named, "alike": alike, "large": large, "floor": part.rms("floor"),
                "freedom": len(fit.amounts), "splines": learned.inputs[block],
                "closed_named": _closed(part, named, excess),
                "closed_alike": _closed(part, alike, excess),
                "closed_large": _closed(part, large, excess),
            }
        )  # fmt: skip
    return made


def _closed(part: HeldOut, after: float, excess: float) -> float | None:
    """Closed fraction; None where hardly anything stands above the floor."""
    if excess <= 0.1 * part.rms("floor") ** 2:
        return None
    return (part.rms("recalibrated") ** 2 - after**2) / excess


def _transfer(problem: FitProblem, fit: FitResult) -> list[dict[str, Any]]:
    """Errors on each protocol (and mounting) when it was not used to fit, where there are two.

    `carries` is false where the fix makes the model worse there by more than the floor's half.
    """
    made = []
    for scheme in ("protocol", "mounting"):
        labels = [str(getattr(trial, scheme)) for trial in problem.data.trials]
        known = list(dict.fromkeys(labels))
        if len(known) < 2:
            continue
        units = np.array([known.index(label) for label in labels], dtype=np.int64)
        base = left_out(problem, problem.base, units).squares
        after = left_out(problem, fit, units).squares
        floor = floor_squares(problem, problem.units)
        slot_unit = {int(s): int(u) for s, u in zip(problem.units, units, strict=True)}
        for number, block in enumerate(BLOCKS):
            here = problem.rows.block == number
            if not here.any():
                continue
            weight = np.bincount(
                units[problem.rows.trial[here]],
                weights=problem.rows.compared_s[here],
                minlength=len(known),
            )
            floors = np.zeros(len(known))
            for slot, value in enumerate(floor[block]):
                floors[slot_unit[slot]] += value
            for u, name in enumerate(known):
                if weight[u] <= 0.0:
                    continue
                one, two, three = (
                    float(np.sqrt(max(x[u] / weight[u], 0.0)))
                    for x in (base[block], after[block], floors)
                )
                made.append(
                    {
                        "held_out": scheme, "name": name, "block": block, "unit": UNITS[block],
                        "recalibrated": one, "after": two,
                        "floor": three if scheme == "protocol" else None,
                        "carries": bool(two**2 <= one**2 + 0.25 * three**2),
                    }
                )  # fmt: skip
    return made


def _stability(problem: FitProblem, fit: FitResult) -> list[dict[str, Any]]:
    """Constants that moved and amounts, with their jackknife error over slots.

    An amount with a coefficient of variation near one is carried by a single slot.
    """
    change = left_out(problem, fit, problem.units).change
    used = np.bincount(problem.units) > 0
    change = change[used]
    count = len(change)
    if count < 3:
        return []
    error = np.sqrt((count - 1) / count * np.sum((change - change.mean(axis=0)) ** 2, axis=0))
    reach = float(student.ppf(0.975, count - 1))
    n = len(problem.names)
    made = [
        {
            "name": name, "kind": "constant", "unit": "sd of tolerance", "value": float(value),
            "low": float(value - reach * e), "high": float(value + reach * e), "variation": None,
        }
        for name, value, e in zip(problem.names, fit.shift, error[:n], strict=True)
        if abs(value) > 0.5
    ]  # fmt: skip
    for candidate, value, e in zip(fit.candidates, fit.amounts, error[n:], strict=True):
        made.append(
            {
                "name": candidate.key, "kind": "amount", "unit": "headline", "value": float(value),
                "low": float(value - reach * e), "high": float(value + reach * e),
                "variation": float(e / max(abs(value), 1e-30)),
            }
        )  # fmt: skip
    return made


def as_lines(found: dict[str, Any]) -> list[str]:
    """The tables for people."""
    lines = [
        "rms error of what was held out (after: with the effects; floor: noise)",
        "  left out      channel   recalibrated    after    floor",
    ]
    for scheme, blocks in found["held_out"].items():
        lines += [_row(f"by {scheme}", block, gap) for block, gap in blocks.items()]
    lines.append("the same, whole chain simulated from the command")
    lines += [_row("by slot", gap["end"], gap) for gap in found["free_running"]]
    if found["generic"]:
        lines.append(
            "share of the gap that is closed by the named effects, by splines with as many "
            "parameters, by many splines (upper bound)"
        )
    for one in found["generic"]:
        values = [one[key] for key in ("closed_named", "closed_alike", "closed_large")]
        if values[0] is not None:
            shares = ", ".join(f"{100 * value:.0f} %" for value in values)
            lines.append(f"  {one['block']:12s} {shares}  ({one['splines']} splines)")
    worse = [one for one in found["transfer"] if not one["carries"]]
    for one in worse:
        lines.append(
            f"  worse for {one['held_out']} {one['name']} when it is left out: {one['block']} "
            f"{one['recalibrated']:.3g} -> {one['after']:.3g} {one['unit']}"
        )
    if found["transfer"] and not worse:
        lines.append("the improvement holds for every protocol and mounting that was left out")
    amounts = [one for one in found["stability"] if one["kind"] == "amount"]
    if amounts:
        lines.append("amounts of the effects, with 95 % intervals by the jackknife over slots")
    for one in amounts:
        lines.append(
            f"  {one['name']:22s} {one['value']:.3g} ({one['low']:.3g} to {one['high']:.3g})"
        )
    return lines


def _row(scheme: str, block: str, gap: dict[str, Any]) -> str:
    after = f"{gap['after']:8.3g}" if gap["after"] is not None else "       -"
    return (
        f"  {scheme:12s}  {block:9s} {gap['recalibrated']:12.3g} {after} {gap['floor']:8.3g} "
        f"{gap['unit']}"
    )
