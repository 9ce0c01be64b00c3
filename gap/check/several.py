"""Several effects at once: `python -m gap.check.several --sets 0-19`.

Sets of the stream `several` of the blind bench hide three to five effects of as many families, each
of 1 to 8 floors, on a muscle that differs from the nominal one. A name counts where the verdict
is sure of it. Prints one line a set and the totals; `--out` keeps them, and a stopped run goes on.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from blind.__main__ import numbers_of
from blind.exchange import write
from blind.recording import record
from blind.sets import SEVERAL, blind_set
from gap.data.reader import read_dataset
from gap.decision.classify import classify
from gap.estimation.fit_problem import FitProblem
from gap.selection.config import SELECTION
from gap.selection.search import search_effects
from gap.verdict import plain


def score(number: int, most: int, small: bool = False) -> dict[str, Any]:
    """Diagnose one set with explanations of up to `most` effects."""
    one = blind_set(SEVERAL, number, small)
    hidden = sorted(effect.id for effect in one.hidden)
    with tempfile.TemporaryDirectory() as scratch:
        write(record(one), Path(scratch))
        problem = FitProblem.of(read_dataset(Path(scratch)))
    config = replace(SELECTION, most_effects=most)
    verdict, _ = classify(problem, search_effects(problem, config))
    offered = verdict.effects[0].ids if verdict.effects and verdict.status.explained else ()
    gap = verdict.gap
    return {
        "number": number, "hidden": hidden, "status": str(verdict.status),
        "named": sorted(verdict.sure), "offered": sorted(offered),
        "closed": gap.closed if gap is not None else None,
        "presence": plain(verdict.evidence.get("presence")),
    }  # fmt: skip


def totals(scores: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Share of hidden effects named and offered, wrong names, closed fraction in the median."""
    made: dict[str, Any] = {"sets": len(scores)}
    hidden = sum(len(s["hidden"]) for s in scores)
    for key in ("named", "offered"):
        right = sum(len(set(s[key]) & set(s["hidden"])) for s in scores)
        wrong = sum(len(set(s[key]) - set(s["hidden"])) for s in scores)
        made[key] = {
            "right": right, "of": hidden, "wrong": wrong,
            "share": right / max(hidden, 1), "wrong_share": wrong / max(right + wrong, 1),
        }  # fmt: skip
    closed = [s["closed"] for s in scores if s["closed"] is not None]
    made["closed_median"] = float(np.median(closed)) if closed else None
    return made


def main() -> int:
    """Score sets, or go on where a run was stopped."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sets", default="0-19", help="set numbers: 0-19, or 3,5,8")
    parser.add_argument("--most", type=int, default=SELECTION.most_effects)
    parser.add_argument("--out", type=Path, default=Path("out/several.jsonl"))
    options = parser.parse_args()
    options.out.parent.mkdir(parents=True, exist_ok=True)
    lines = options.out.read_text().splitlines() if options.out.exists() else []
    scores = {s["number"]: s for s in map(json.loads, lines)}
    for number in numbers_of(options.sets):
        if number not in scores:
            scores[number] = score(number, options.most)
            with options.out.open("a") as file:
                file.write(json.dumps(scores[number]) + "\n")
            print(json.dumps(scores[number]), file=sys.stderr, flush=True)
    print(json.dumps(totals(list(scores.values())), indent=2))
    return 0


if __name__ == "__main__":
    sys.exit(main())
