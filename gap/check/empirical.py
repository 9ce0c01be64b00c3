"""How well empirical terms do on practice sets of the blind bench whose gap got no adequate name.

    python -m gap.check.empirical --sets 9030-9089 --out out/empirical.jsonl

Of sets with an effect of two floors or more that the diagnosis calls unknown, or whose form it
calls inadequate while the named effects leave two floors or more: the share in which a term closes
half of the gap or more on slots held out, and the share in which its inputs are those of the hidden
effects (`gap.check.scoring.inputs`). A set without a term counts against both. Each term is also
judged on other trials of the same bench, which no part of the diagnosis has seen. One line a set
goes to the file; finished sets are not repeated.
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
from blind.sets import BlindSet, answer, blind_set, kind_and_count, other_data
from gap.check.campaign import parse_numbers, read_results
from gap.check.scoring.inputs import inputs_right
from gap.check.scoring.score import size_of
from gap.data.reader import read_dataset
from gap.decision.diagnose import diagnose_with_search, fit_below_term
from gap.errors import CheckError
from gap.estimation.cross_validation import floor_squares
from gap.estimation.fit_problem import FitProblem
from gap.model.features import BLOCKS
from gap.validation.improved_plant import improved_plant
from gap.validation.terms.refit import within_walls

STATUSES = ("unknown", "named_form_inadequate")
_LEAST_SIZE = 2.0
_HALF = 0.5
_ANEW = 2
"""Times that other trials are made of each bench."""


def scored(number: int) -> dict[str, Any]:
    """Diagnose one practice set; what its term closes, and whether its inputs are right."""
    one = blind_set("practice", number)
    with tempfile.TemporaryDirectory(prefix="blind-") as temporary:
        folder = Path(temporary) / "data"
        write(record(one), folder)
        verdict, problem, search = diagnose_with_search(read_dataset(folder), one.without)
        line = line_of(number, answer(one), verdict.as_dict())
        term = verdict.empirical
        if line["counts"] and term is not None and problem is not None and search is not None:
            plant = improved_plant(problem, fit_below_term(verdict, problem, search), term)
            block = term.correction.block
            line["closed_anew"] = [
                closed_anew(one, seed, plant, block, folder.with_name(f"anew{seed}"))
                for seed in range(_ANEW)
            ]
    return line


def closed_anew(one: BlindSet, seed: int, plant: str, block: str, folder: Path) -> float | None:
    """Share of the gap of one block that an improved plant closes on other trials of its bench.

    Both plants are recalibrated on those trials. None where they show less than two floors of it.

    Args:
        plant: the improved plant, as the text of a `bench.toml`.
        folder: for the data; made here.
    """
    write(record(other_data(one, seed)), folder)
    gap, floor = _gap_and_floor(folder, block)
    if gap <= 0.0 or gap < _LEAST_SIZE**2 * floor:
        return None
    (folder / "bench.toml").write_text(plant, encoding="utf-8")
    left, _ = _gap_and_floor(folder, block)
    return round(1.0 - max(left, 0.0) / gap, 4)


def _gap_and_floor(folder: Path, block: str) -> tuple[float, float]:
    """Squared errors of a block beyond the floor, and of the floor; zero without the block."""
    problem = FitProblem.of(read_dataset(folder))
    here = problem.rows.block == BLOCKS.index(block)
    if not here.any():
        return 0.0, 0.0
    left = within_walls(problem, problem.base).residual[here]
    floor = float(floor_squares(problem, problem.units)[block].sum())
    return float(problem.rows.compared_s[here] @ left**2) - floor, floor


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
    anew = [x for line in counted for x in line.get("closed_anew", ()) if x is not None]
    return {
        "sets": len(counted),
        "terms": sum(line["closed"] is not None for line in counted),
        "half_closed": sum((line["closed"] or 0.0) >= _HALF for line in counted),
        "inputs_right": sum(line["inputs_right"] for line in counted),
        "judged_anew": len(anew),
        "half_closed_anew": sum(x >= _HALF for x in anew),
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Run what is missing in the file, and print the totals."""
    parser = argparse.ArgumentParser(description="empirical terms on practice sets")
    parser.add_argument("--sets", required=True, help="numbers, such as 9030-9089")
    parser.add_argument(
        "--lacking", action="store_true", help="only sets with an effect that the catalogue lacks"
    )
    parser.add_argument("--out", type=Path, required=True, help="file with one line a set")
    given = parser.parse_args(arguments)
    try:
        numbers = parse_numbers(given.sets)
    except CheckError as error:
        parser.error(str(error))
    if given.lacking:
        numbers = tuple(n for n in numbers if kind_and_count(n)[0] in ("left_out", "outside"))
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
