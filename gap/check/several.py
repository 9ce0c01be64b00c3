"""Several effects at once: `python -m gap.check.several --sets 0-19`.

Sets of the stream `several` of the blind bench hide three to five effects of as many families, each
of 1 to 8 floors, on a muscle that differs from the nominal one. A set is scored as `pamrig gap
diagnose` would report it: what it refuses (`Status.NOMINAL_UNFIT`, `Status.DATA_UNFIT`) is counted
by itself, and its effects are not named. A name counts where the verdict is sure of it. Prints one
line a set and the totals; `--out` keeps them, and a stopped run goes on.

An effect aimed at one floor may be smaller, since strengths are limited to realistic ones, and one
that others take to more than 0.9 is not identifiable: the totals also count without them.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from blind.exchange import write
from blind.recording import record
from blind.sets import SEVERAL, blind_set
from gap.check.campaign import parse_numbers
from gap.check.scoring.score import MIMICKED
from gap.check.scoring.statistics import Share, bins_of, debiased_error, share
from gap.data.reader import read_dataset
from gap.decision.diagnose import verdict_by_catalogue
from gap.errors import CheckError
from gap.verdict import Status, Verdict, plain

LEAST_SIZE = 1.0
"""Floors, from which an effect counts among those that can be seen."""
SIZES = (1.5, 3.0)
"""Floors between which effects are counted by themselves."""
UNFIT = (Status.NOMINAL_UNFIT, Status.DATA_UNFIT)
"""Verdicts that refuse to diagnose: the stated plant, or the data, are not usable."""


def score(number: int, small: bool = False, strike: bool = False) -> dict[str, Any]:
    """Diagnose one set.

    With `strike` one of the hidden effects is struck from the catalogue, and what stands in its
    place is wrong.
    """
    one = blind_set(SEVERAL, number, small)
    hidden = sorted(effect.id for effect in one.hidden)
    struck = [hidden[number % len(hidden)]] if strike else []
    with tempfile.TemporaryDirectory() as scratch:
        write(record(one), Path(scratch))
        verdict, _, _ = verdict_by_catalogue(read_dataset(Path(scratch)), struck)
    return {**line_of(number, hidden, struck, verdict), "members": members_of(one.measured)}


def members_of(measured: Mapping[str, Any]) -> dict[str, dict[str, float]]:
    """Of each hidden effect its size alone, in floors, and what others take of it at most."""
    return {
        one["id"]: {
            "size": float(one["gap_over_floor"]),
            "mimic": max((float(other["share"]) for other in one["mimics"]), default=0.0),
        }
        for one in measured["members"]
    }


def line_of(
    number: int, hidden: Sequence[str], struck: Sequence[str], verdict: Verdict
) -> dict[str, Any]:
    """What is kept of one set: what it hides, and what the verdict says."""
    offered = verdict.effects[0].ids if verdict.effects and verdict.status.explained else ()
    gap = verdict.gap
    return {
        "number": number, "hidden": sorted(set(hidden) - set(struck)), "struck": list(struck),
        "status": str(verdict.status),
        "named": sorted(verdict.sure), "offered": sorted(offered),
        "closed": gap.closed if gap is not None else None,
        "presence": plain(verdict.evidence.get("presence")),
    }  # fmt: skip


def totals(scores: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Share of hidden effects named and offered, wrong names, closed fraction in the median.

    The effects of sets that are refused as unfit count as hidden and not named.
    """
    made: dict[str, Any] = {
        "sets": len(scores),
        "unfit": sum(s["status"] in UNFIT for s in scores),
        "unknown": sum(s["status"] == Status.UNKNOWN for s in scores),
    }
    hidden = sum(len(s["hidden"]) for s in scores)
    for key in ("named", "offered"):
        right = sum(len(set(s[key]) & set(s["hidden"])) for s in scores)
        wrong = sum(len(set(s[key]) - set(s["hidden"])) for s in scores)
        made[key] = {
            "right": right, "of": hidden, "wrong": wrong,
            "share": right / max(hidden, 1), "wrong_share": wrong / max(right + wrong, 1),
            "interval": Share(right, hidden).interval,
        }  # fmt: skip
    made["of_one_floor"] = _named_where(scores, lambda one: one["size"] >= LEAST_SIZE)
    made["without_confounder"] = _named_where(
        scores, lambda one: one["size"] >= LEAST_SIZE and one["mimic"] <= MIMICKED
    )
    made["by_size"] = {}
    for low, high in pairwise((0.0, *SIZES, np.inf)):
        within = partial(_is_within, low, high)
        made["by_size"][f"{low:g} to {high:g} floors"] = _named_where(scores, within)
    made["calibration"] = _calibration(scores)
    closed = [s["closed"] for s in scores if s["closed"] is not None]
    made["closed_median"] = float(np.median(closed)) if closed else None
    return made


def _is_within(low: float, high: float, one: Mapping[str, float]) -> bool:
    return low <= one["size"] < high


def _named_where(
    scores: Sequence[dict[str, Any]], counts: Callable[[Mapping[str, float]], bool]
) -> dict[str, Any]:
    """Share of the hidden effects that count that is named, where their sizes are known."""
    return share(
        [
            name in line["named"]
            for line in scores
            for name, one in line.get("members", {}).items()
            if name in line["hidden"] and counts(one)
        ]
    ).as_json()


def _calibration(scores: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Stated probabilities of presence against what is there: bins, and the error less chance."""
    stated, there = [], []
    for line in scores:
        for one in line["presence"] or []:
            stated.append(one["probability"])
            there.append(one["id"] in line["hidden"])
    p, right = np.array(stated), np.array(there)
    return {
        "effects": len(p),
        "error": debiased_error(p, right) if len(p) else None,
        "stated_there_count": bins_of(p, right, BINS) if len(p) else [],
    }


BINS = 5
"""Bins of equal width that the stated probabilities are printed in."""


def main() -> int:
    """Score sets, or go on where a run was stopped."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sets", default="0-19", help="set numbers: 0-19, or 3,5,8")
    parser.add_argument(
        "--strike", action="store_true", help="strike one hidden effect of each set"
    )
    parser.add_argument("--out", type=Path, default=Path("out/several.jsonl"))
    options = parser.parse_args()
    try:
        numbers = parse_numbers(options.sets)
    except CheckError as error:
        parser.error(str(error))
    options.out.parent.mkdir(parents=True, exist_ok=True)
    lines = options.out.read_text().splitlines() if options.out.exists() else []
    scores = {(s["number"], bool(s.get("struck"))): s for s in map(json.loads, lines)}
    for number in numbers:
        if (number, options.strike) not in scores:
            made = scores[number, options.strike] = score(number, strike=options.strike)
            with options.out.open("a") as file:
                file.write(json.dumps(made) + "\n")
            print(json.dumps(made), file=sys.stderr, flush=True)
    print(json.dumps(totals(list(scores.values())), indent=2))
    return 0


if __name__ == "__main__":
    sys.exit(main())
