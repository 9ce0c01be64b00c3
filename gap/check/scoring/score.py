"""One verdict against one opened answer: every judgement the totals are made of.

Works on plain JSON values alone, so that any diagnosis that speaks the exchange form can be
scored. Definitions:

- an *alarm* is any verdict but `no_gap_above_floor` and `below_resolution`;
- the *names given* are those of the best explanation under `named` or `named_form_inadequate`,
  and those that the verdict holds for sure whatever else acts;
- *wrong name*: a name was given and none of it is hidden in the data; *extras* are names given
  beyond the hidden ones;
- *family right*: the best explanation, where the verdict offers any, is of a hidden family;
  abstentions are misses;
- the *set at 90 %* is the shortest run of hypotheses (explanations, none, unknown), most probable
  first, that adds up to 0.9; it covers if one of them is the truth.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from plant.constants import nominal
from plant.effects.catalogue import CATALOGUE

OFFERS = ("named", "named_form_inadequate", "indistinguishable", "mimicable")
GIVES_NAME = ("named", "named_form_inadequate")
QUIET = ("no_gap_above_floor", "below_resolution")
MIMICKED = 0.9
Row = dict[str, Any]


def hypotheses(verdict: Mapping[str, Any]) -> list[tuple[str, tuple[str, ...], float]]:
    """Kind (`effects`, `none`, `unknown`), ids and probability, most probable first."""
    found = [
        ("effects", tuple(e["ids"]), float(e.get("probability") or 0.0))
        for e in verdict.get("effects") or []
    ]
    found.append(("none", (), float(verdict.get("probability_none") or 0.0)))
    found.append(("unknown", (), float(verdict.get("probability_unknown") or 0.0)))
    total = sum(p for _, _, p in found)
    if total <= 0.0:
        return []
    return sorted(((k, i, p / total) for k, i, p in found), key=lambda x: -x[2])


def credible(ranked: Sequence[tuple[str, tuple[str, ...], float]], level: float = 0.9) -> int:
    """How many hypotheses, best first, reach the level."""
    added, count = 0.0, 0
    for _, _, probability in ranked:
        count += 1
        added += probability
        if added >= level - 1e-9:
            break
    return count


def is_truth(kind: str, ids: Sequence[str], hidden: set[str], truth: str) -> bool:
    """Whether a hypothesis is what is hidden (`truth`: none, effects or unknown)."""
    if truth != "effects":
        return kind == truth
    return kind == "effects" and bool(ids) and set(ids) == hidden


def mimic_of(answer: Mapping[str, Any]) -> float:
    """How well others stand in for what is hidden, 0 to 1."""
    return float(answer["measured"].get("mimic_index", 0.0)) if answer["measured"] else 0.0


def size_of(answer: Mapping[str, Any]) -> float:
    """Recalibrated gap over the floor; for several effects that of the smallest, alone."""
    members = answer["measured"].get("members") if answer["measured"] else None
    if not members:
        return 0.0
    return float(min(m["gap_over_floor"] for m in members))


def neutral_of(name: str) -> float:
    """Value of an effect's headline parameter that is no effect; 0 for an unknown effect."""
    return CATALOGUE[name].neutral_in(nominal()) if name in CATALOGUE else 0.0


def parameter_row(answer: Mapping[str, Any], best: Mapping[str, Any]) -> Row:
    """Error and interval of the headline parameter of the first hidden effect that is named."""
    stated = best.get("parameters") or {}
    for effect in answer["effects"]:
        if effect["id"] not in best["ids"]:
            continue
        for name, true in effect["parameters"].items():
            given = stated.get(name)
            if not isinstance(true, (int, float)) or not isinstance(given, Mapping):
                continue
            value = given.get("value")
            if not isinstance(value, (int, float)):
                continue
            row: Row = {"parameter": name, "true": true, "stated": value}
            neutral = neutral_of(effect["id"])
            if true != neutral:
                # A leak's conductance is thirteen decades below one: no floor under it.
                row["error"] = (value - true) / abs(true - neutral)
                row["ratio"] = (value - neutral) / (true - neutral)
            if given.get("low") is not None and given.get("high") is not None:
                row["parameter_covered"] = bool(given["low"] <= true <= given["high"])
            return row
    return {}


def score(answer: Mapping[str, Any], verdict: Mapping[str, Any]) -> Row:
    """All judgements of one set, flat; see the module's definitions."""
    kind = answer["kind"]
    without = set(answer["without"])
    hidden = {e["id"] for e in answer["effects"]}
    known = hidden - without if kind != "outside" else set()
    truth = "none" if not hidden else ("effects" if known else "unknown")
    if kind == "unfit":
        truth = "unfit"
    status = str(verdict.get("status"))
    effects = verdict.get("effects") or []
    best = effects[0] if effects and status in OFFERS else None
    given = set(best["ids"]) if best is not None and status in GIVES_NAME else set()
    given |= set(verdict.get("sure") or ())
    families = {e["family"] for e in answer["effects"]}
    stages = {e["stage"] for e in answer["effects"]}
    ranked = hypotheses(verdict)
    count = credible(ranked)
    row: Row = {
        "stream": answer["stream"],
        "number": answer["number"],
        "kind": kind,
        "changed": answer["changed"],
        "table": answer["table"],
        "trials": answer["trials"],
        "hidden": sorted(hidden),
        "forms": [e.get("form") for e in sorted(answer["effects"], key=lambda e: str(e["id"]))],
        "family": "+".join(sorted(families)),
        "truth": truth,
        "size": size_of(answer),
        "mimic": mimic_of(answer),
        "aim": answer["aim"],
        "status": status,
        "alarm": status not in QUIET,
        "crashed": status == "crashed",
        "stage_right": bool(
            status not in QUIET
            and verdict.get("stage") is not None
            and (verdict["stage"] in stages or "any" in stages)
        ),
        "best": list(best["ids"]) if best is not None else [],
        "best_family": best.get("family") if best is not None else None,
        "family_right": bool(best is not None and known and str(best.get("family")) in families)
        or bool(best is not None and known & set(best["ids"])),
        "named": sorted(given),
        "named_right": bool(given) and given == known and truth == "effects",
        "named_family_right": bool(given & known)
        or bool(given and known and best is not None and str(best.get("family")) in families),
        "wrong_name": bool(given) and not given & known,
        "extras": len(given - known) if given & known else 0,
        "holds_truth": any(known and known & set(e["ids"]) for e in effects),
        "single_name": len(given) == 1,
        "flagged_unknown": status == "unknown",
        "flagged_unfit": status == "data_unfit",
        "set_size": count,
        "covered": any(is_truth(k, i, known, truth) for k, i, _ in ranked[:count]),
        "confidence": ranked[0][2] if ranked else None,
        "right": bool(ranked) and is_truth(ranked[0][0], ranked[0][1], known, truth),
        "seconds": verdict.get("seconds"),
    }
    if best is not None and given & known:
        row.update(parameter_row(answer, best))
    gap = verdict.get("gap") or {}
    for name in ("closed", "closed_low", "closed_high", "unit", "recalibrated", "floor"):
        row[name] = gap.get(name)
    if any(isinstance(row[k], float) and not math.isfinite(row[k]) for k in ("size", "mimic")):
        raise ValueError(f"set {answer['number']}: measured sizes are not finite")
    return row
