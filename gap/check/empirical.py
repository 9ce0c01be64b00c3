"""How well empirical terms do on practice sets of the blind bench whose gap got no adequate name.

    python -m gap.check.empirical --sets 9030-9089 --out out/empirical.jsonl

Of sets with an effect of two floors or more that the diagnosis calls unknown, or whose form it
calls inadequate while the named effects leave two floors or more: the share in which a term closes
half of the gap or more on slots held out, and the share in which its inputs are those of the hidden
effects (`gap.check.scoring.inputs`). A set without a term counts against both. One line a set goes
to the file; finished sets are not repeated.
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from blind.exchange import write
from blind.recording import record
from blind.sets import answer, blind_set
from gap.check.campaign import parse_numbers, read_results
from gap.check.engine import verdict_of_folder
from gap.check.scoring.inputs import inputs_right
from gap.check.scoring.score import size_of
from gap.errors import CheckError

STATUSES = ("unknown", "named_form_inadequate")
_LEAST_SIZE = 2.0
_HALF = 0.5


def scored(number: int) -> dict[str, Any]:
    """Diagnose one practice set; what its term closes, and whether its inputs are right."""
    one = blind_set("practice", number)
    truth = answer(one)
    with tempfile.TemporaryDirectory(prefix="blind-") as temporary:
        folder = Path(temporary) / "data"
        write(record(one), folder)
        verdict = verdict_of_folder(folder, one.without).as_dict()
    return line_of(number, truth, verdict)


def line_of(number: int, truth: Mapping[str, Any], verdict: Mapping[str, Any]) -> dict[str, Any]:
    """The judgement of one set from its answer and its verdict, as plain values."""
    ids = tuple(effect["id"] for effect in truth["effects"])
    forms = tuple(effect.get("form") for effect in truth["effects"])
    term = verdict.get("empirical")
    left = left_of(verdict)
    shares = {one["input"]: one["share"] for one in term["inputs"]} if term else {}
    return {
        "stream": "practice",
        "number": number,
        "kind": truth["kind"],
        "effects": ids,
        "size": size_of(truth),
        "status": verdict["status"],
        "left": left,
        "counts": verdict["status"] in STATUSES
        and min(size_of(truth), size_of(truth) if left is None else left) >= _LEAST_SIZE,
        "channel": term["channel"] if term else None,
        "closed": term["closed"] if term else None,
        "shares": shares,
        "inputs_right": term is not None and inputs_right(ids, shares, term["channel"], forms),
    }


def left_of(verdict: Mapping[str, Any]) -> float | None:
    """What named effects leave of the gap, in floors; None where nothing is named."""
    gap = verdict.get("gap") or {}
    after, floor = gap.get("after"), gap.get("floor")
    if verdict["status"] != "named_form_inadequate" or after is None or not floor:
        return None
    return math.sqrt(max(float(after) ** 2 - float(floor) ** 2, 0.0)) / float(floor)


def totals(lines: Sequence[Mapping[str, Any]]) -> dict[str, int]:
    """Sets that count, and how many of them close half and have the right inputs."""
    counted = [line for line in lines if line["counts"]]
    return {
        "sets": len(counted),
        "terms": sum(line["closed"] is not None for line in counted),
        "half_closed": sum((line["closed"] or 0.0) >= _HALF for line in counted),
        "inputs_right": sum(line["inputs_right"] for line in counted),
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Run what is missing in the file, and print the totals."""
    parser = argparse.ArgumentParser(description="empirical terms on practice sets")
    parser.add_argument("--sets", required=True, help="numbers, such as 9030-9089")
    parser.add_argument("--out", type=Path, required=True, help="file with one line a set")
    given = parser.parse_args(arguments)
    try:
        numbers = parse_numbers(given.sets)
    except CheckError as error:
        parser.error(str(error))
    done = {line["number"] for line in read_results(given.out)}
    given.out.parent.mkdir(parents=True, exist_ok=True)
    for number in numbers:
        if number in done:
            continue
        with given.out.open("a", encoding="utf-8") as file:
            file.write(json.dumps(scored(number)) + "\n")
    print(json.dumps(totals([x for x in read_results(given.out) if x["number"] in numbers])))


if __name__ == "__main__":
    main()
