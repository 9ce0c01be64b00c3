"""The diagnosis beside naive selection, on blind sets it has not seen: right, wrong, and time.

    python -m benchmarks diagnosis

A look at cost, not the check of the diagnosis: that is `pamrig gap check`, with hundreds of sets.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.paired import Spread, ratios, short, table

TITLE = "Diagnosis compared with simple selection methods"
STREAM, FIRST = "practice", 900
OURS = "pamrig gap diagnose"


def one_set(number: int) -> dict[str, dict[str, Any]]:
    """Score and processor seconds of every method on one small blind set."""
    from blind.exchange import write
    from blind.recording import record
    from blind.sets import answer, blind_set
    from gap.check.examine import diagnosed
    from gap.check.scoring import baselines
    from gap.check.scoring.score import score

    one = blind_set(STREAM, number, True)
    found: dict[str, dict[str, Any]] = {}
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / "data"
        write(record(one), folder)
        truth = answer(one)
        verdict = diagnosed("gap.check.engine:verdict_of_folder", folder, one.without)
        found[OURS] = {**score(truth, verdict), "cpu_s": verdict["seconds"]}
        begin = time.process_time()
        try:
            methods = baselines.methods(baselines.problem_of(folder, one.without))
        except Exception:  # as the blind check has it: a method that cannot read has no say
            return found
        shared = time.process_time() - begin
        for name, verdict_by in methods.items():
            begin = time.process_time()
            verdict = verdict_by()
            took = shared + time.process_time() - begin
            found[name] = {**score(truth, verdict), "cpu_s": took}
    return found


def measure(tiny: bool = False) -> dict[str, Any]:
    """All methods on a few sets; the first only compiles."""
    count = 1 if tiny else 10
    if not tiny:
        one_set(FIRST - 1)
    sets = [one_set(FIRST + k) for k in range(count)]
    kept = ("cpu_s", "alarm", "wrong_name", "named_right", "named_family_right", "truth")
    return {
        "first": FIRST,
        "sets": [{n: {k: row[k] for k in kept} for n, row in one.items()} for one in sets],
    }


def lines(result: dict[str, Any]) -> list[str]:
    """The page's part."""
    sets = result["sets"]
    rows = []
    for name in sets[0] if len(sets[0]) > 1 else max(sets, key=len):
        mine = [(one[name], one[OURS]) for one in sets if name in one]
        silent = [a for a, _ in mine if a["truth"] == "none"]
        hidden = [a for a, _ in mine if a["truth"] == "effects"]
        times = ""
        if name != OURS:
            times = str(ratios([a["cpu_s"] for a, _ in mine], [b["cpu_s"] for _, b in mine]))
        rows.append([
            name,
            f"{sum(a['named_right'] for a in hidden)} of {len(hidden)}",
            f"{sum(a['named_family_right'] for a in hidden)} of {len(hidden)}",
            f"{sum(a['wrong_name'] for a, _ in mine)} of {len(mine)}",
            f"{sum(a['alarm'] for a in silent)} of {len(silent)}",
            short(Spread.of([a["cpu_s"] for a, _ in mine]).median),
            times,
        ])  # fmt: skip
    heads = [
        "method", "named exactly", "family right", "wrong names", "false alarms",
        "processor s per set", "time / pamrig",
    ]  # fmt: skip
    out = table(heads, rows)
    last = result["first"] + len(sets) - 1
    out += [
        f"Small blind sets {result['first']} to {last} of the stream `{STREAM}`, made by the "
        "second bench of `blind/`. They are too few to evaluate the diagnosis. They show the cost, "
        "and the result of simple selection on the same features and constants. A baseline needs "
        "most of its time for these features. Sets that a baseline cannot use are not in its row.",
        "",
    ]
    return out
