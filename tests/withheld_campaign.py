"""`python -m tests.withheld_campaign`: does `gap investigate` find what a withheld bench hides?

Each seed draws a secret effect (entry, form, sign, size, and the bench's true constants) with the
blind package and puts it into a virtual bench. The answer is sealed in the journal by its salted
SHA-256 before the first test; `cli.investigate.investigate` then runs its tests on that bench over
its ports, byte by byte on a virtual clock, and knows the rig file and the stated constants only.
The answer is opened when the investigation has ended. The journal takes one line a seed: stopped
at any moment, the command goes on with the next seed.

    python -m tests.withheld_campaign --seeds 0-39 --page docs/evidence/investigate-check.md
"""

from __future__ import annotations

import argparse
import hashlib
import json
import shutil
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from cli.investigate.investigate import Investigation, investigate
from cli.investigate.runnable import draw_runnable
from daq.clock import VirtualClock
from daq.errors import PamrigError
from gap.check.scoring.statistics import Share, share
from rigs.rigfile.config import RigConfig, load_rig
from rigs.virtual.withheld.bench import WithheldBench

RIG = "virtual-instruments"
MIMICKED = 0.9
Row = dict[str, Any]
HOW = f"""
Each seed draws one effect of the catalogue with the package `blind` (another integrator, other
functional forms, other true constants within their tolerances); forms from 3 on are held out
(`--held-out` draws them alone). Its size is such that the
recalibrated gap is 3 to 6 floors on a mixed design of the generator. The effect is built into the
virtual bench of the rig `{RIG}`. It is drawn again if the rig's own protections end one of the
first two tests: a sensor that reads 24 kPa when vented is refused, as on a real bench. The salted
SHA-256 of the answer is fixed before the first test. `pamrig gap investigate` knows the rig file
and the stated constants. It runs its tests over the bench's ports on a virtual clock, and stops
when it can name the gap or has no test left. A name comes from the diagnosis (its status is then
given), or it is the only family left after a later test agreed with its prediction (*predicted*;
see [investigate](../use/investigate.md)). Where a gauge block or a reference gauge would decide
what no test does, the virtual bench's person sets or reads it, and the hidden instruments show it.
*Right*: exactly one
family is named, and it is the hidden one. *Not separable, confirmed*: the verdict offers a set that
contains the hidden family (or finds no gap, but a stated value moved to the end of its tolerance)
and names references that would decide, and by the generator's own measure one or two other entries
take more than {100 * MIMICKED:.0f} % of what the effect leaves. Everything else is a miss.
Intervals are Wilson intervals at 95 %.
""".strip()


def entropy_of(seed: int) -> int:
    """96 bits for a seed; nobody has met them elsewhere."""
    return int.from_bytes(hashlib.sha256(f"withheld bench {seed}".encode()).digest()[:12], "big")


def one(seed: int, config: RigConfig, out: Path, budget_min: float, held_out: bool = False) -> Row:
    """Hide, seal, investigate, open, judge."""
    running = time.process_time()
    secret = draw_runnable(config, entropy=entropy_of(seed), held_out=held_out)
    bench = WithheldBench(config, secret, VirtualClock())
    drawn = time.process_time()
    row: Row = {"seed": seed, "sha256": bench.digest}
    try:
        found = investigate(config, out / "runs", budget_min=budget_min, bench=bench, derive=False)
        row |= told(found)
    except PamrigError as error:
        row |= {"conclusion": "failed", "error": str(error), "set": [], "rounds": []}
    ended = time.process_time()
    envelope = bench.reveal()
    row |= {"cpu_draw_s": round(drawn - running, 1), "cpu_s": round(ended - drawn, 1)}
    row["answer"] = envelope["answer"]
    return row | judged(row)


def told(found: Investigation) -> Row:
    """What the investigation says, as plain values."""
    verdict = found.verdict
    return {
        "conclusion": found.conclusion,
        "status": verdict.status,
        "why": found.why,
        "named": found.family,
        "reason": str(verdict.reason),
        "set": [
            {"ids": list(e.ids), "family": e.family, "probability": round(e.probability, 4)}
            for e in verdict.effects
        ],
        "references": dict(found.references),
        "ended": found.ended,
        "rounds": [
            {
                "protocol": r.protocol, "why": r.why, "minutes": round(r.minutes, 1),
                "status": r.status, "effects": list(r.effects), "foretold": r.predicted,
            }
            for r in found.rounds
        ],
        "minutes": round(sum(r.minutes for r in found.rounds), 1),
        "traits": dict(verdict.evidence.get("traits", {})),
        "belief": dict(verdict.evidence.get("belief", {})),
    }  # fmt: skip


def judged(row: Row) -> Row:
    """Right family named; or rightly not told apart: the set holds it, and the generator agrees."""
    (hidden,) = row["answer"]["effects"]
    families = [e["family"] for e in row["set"]]
    measured = row["answer"]["measured"]
    right = row["conclusion"] == "named" and row["named"] == hidden["family"]
    mimicked = float(measured.get("mimic_index", 0.0)) >= MIMICKED
    asked = hidden["family"] in families or hidden["id"] in row.get("references", {})
    offered = row["conclusion"] == "needs reference" and asked
    return {
        "hidden": hidden["id"],
        "family": hidden["family"],
        "right": right,
        "offered": offered and not right,
        "confirmed": offered and mimicked and not right,
        "wrong": row["conclusion"] == "named" and not right,
    }


def totals(rows: list[Row]) -> dict[str, Share]:
    """The figures that the page begins with."""
    return {
        "right family named": share([r["right"] for r in rows]),
        "of these, by a test that agreed with its prediction": share(
            [by_proof(r) for r in rows if r["right"]]
        ),
        "not separable, confirmed by the generator": share([r["confirmed"] for r in rows]),
        "not separable, set holds the family, not confirmed": share(
            [r["offered"] and not r["confirmed"] for r in rows]
        ),
        "wrong name": share([r["wrong"] for r in rows]),
        "right family ranked first, any conclusion": share(
            [[e["family"] for e in r["set"]][:1] == [r["family"]] for r in rows]
        ),
    }


def by_proof(row: Row) -> bool:
    """Whether it is a later test that made the conclusion a name, not the diagnosis."""
    return row["conclusion"] == "named" and not str(row.get("status")).startswith("named")


def seeds_of(text: str) -> list[int]:
    """0-39, or 3,5,8."""
    found: list[int] = []
    for part in text.split(","):
        first, _, last = part.partition("-")
        try:
            found += range(int(first), int(last or first) + 1)
        except ValueError:
            says = f"expected numbers such as 0-39 or 3,5,8, got {text!r}"
            raise argparse.ArgumentTypeError(says) from None
    return found


def line(row: Row) -> str:
    """A seed in one line."""
    hidden = row["answer"]["effects"][0]
    best = ", ".join(f"{'+'.join(e['ids'])} {e['probability']:.2f}" for e in row["set"][:3])
    rounds = " ".join(r["protocol"] for r in row["rounds"])
    size = row["answer"]["measured"].get("gap_over_floor", 0.0)
    return (
        f"{row['seed']} {word_for(row)}: {hidden['id']} {hidden['parameters']} {size:.1f} floors, "
        f"{row['conclusion']} ({row.get('status', '')}) [{best}] {rounds} "
        f"{row.get('minutes', 0)} min, {row['cpu_s']} s of CPU "
        f"{row.get('error') or row.get('ended') or ''}"
    )


def page(rows: list[Row], command: str) -> str:
    """The page of docs: figures first, then every seed."""
    cpu = sum(r["cpu_s"] for r in rows)
    lines = [
        "# Investigations of withheld benches",
        "",
        "This command made the results and this page. You can stop it; it then continues later:",
        "",
        "```",
        command,
        "```",
        "",
        HOW,
        "",
        "| figure | required | reached |",
        "|---|---|---|",
    ]  # fmt: skip
    asked = {
        "right family named": ">= 95 %",
        "wrong name": "<= 2 %",
        "not separable, confirmed by the generator": "<= 15 %",
    }
    for name, value in totals(rows).items():
        low, high = value.interval
        lines.append(
            f"| {name} | {asked.get(name, '')} | {100 * value.value:.0f} % "
            f"[{100 * low:.0f}, {100 * high:.0f}] ({value.hits}/{value.of}) |"
        )
    lines += [
        "",
        f"{len(rows)} seeds, {cpu / 60:.0f} min of CPU; bench time per seed: "
        f"{_middle([r.get('minutes', 0.0) for r in rows]):.0f} min (median).",
        "",
        "| seed | hidden | form | amount | floors | confounder | tests | conclusion | set | score "
        "| reference |",
        "|--:|---|--:|---|--:|--:|---|---|---|---|---|",
    ]
    return "\n".join([*lines, *(_table_row(r) for r in rows), ""])


def _middle(values: list[float]) -> float:
    return sorted(values)[len(values) // 2] if values else 0.0


def _table_row(row: Row) -> str:
    hidden = row["answer"]["effects"][0]
    measured = row["answer"]["measured"]
    amount = ", ".join(
        f"{name} {value}" if isinstance(value, str) else f"{name} {value:.3g}"
        for name, value in hidden["parameters"].items()
    )
    best = "; ".join(
        f"{' + '.join(e['ids'])} {100 * e['probability']:.0f} %" for e in row["set"][:3]
    )
    tests = ", ".join(r["protocol"] for r in row["rounds"])
    asked = row["conclusion"] == "needs reference"
    reference = row["references"].get(hidden["id"], "") if asked else ""
    cells = (
        row["seed"], hidden["id"], hidden["form"], amount,
        f"{measured.get('gap_over_floor', 0.0):.1f}", f"{measured.get('mimic_index', 0.0):.2f}",
        tests, f"{row['conclusion']} ({_how(row)})", best, word_for(row),
        reference,
    )  # fmt: skip
    return "| " + " | ".join(str(cell).replace("|", "/") for cell in cells) + " |"


def _how(row: Row) -> str:
    return "predicted" if by_proof(row) else str(row.get("status", row.get("error", "")))


def word_for(row: Row) -> str:
    """How a seed was judged, in a word or two."""
    if row["right"]:
        return "right"
    if row["confirmed"]:
        return "not separable, confirmed"
    if row["offered"]:
        return "offered, not confirmed"
    return "**wrong name**" if row["wrong"] else "missed"


def main() -> int:
    """Run the seeds that the journal does not hold yet, then write the page."""
    parser = argparse.ArgumentParser(prog="python -m tests.withheld_campaign", description=__doc__)
    parser.add_argument("--seeds", default="0-39", help="numbers such as 0-39 or 3,5,8")
    parser.add_argument("--rig", default=RIG)
    parser.add_argument("--held-out", action="store_true", help="hide forms that are held out")
    parser.add_argument("--budget", type=float, default=60.0, help="bench minutes a seed")
    parser.add_argument("--journal", type=Path, help="one for each kind of forms")
    parser.add_argument("--keep", type=Path, help="keep runs and data here")
    parser.add_argument("--page", type=Path)
    args = parser.parse_args()
    try:
        seeds = seeds_of(args.seeds)
    except argparse.ArgumentTypeError as error:
        parser.error(f"--seeds: {error}")
    # The same seed hides another form: the two kinds must not share a journal.
    usual = "out/withheld-held-out.jsonl" if args.held_out else "out/withheld.jsonl"
    journal = args.journal or Path(usual)
    journal.parent.mkdir(parents=True, exist_ok=True)
    rows = read_journal(journal)
    for seed in seeds:
        if seed in rows:
            continue
        folder = args.keep / str(seed) if args.keep else Path(tempfile.mkdtemp())
        try:
            row = one(seed, load_rig(args.rig, seed), folder, args.budget, args.held_out)
        finally:
            if not args.keep:
                shutil.rmtree(folder, ignore_errors=True)
        rows[seed] = row
        with journal.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row, allow_nan=False) + "\n")
        print(line(row), flush=True)
    wanted = [rows[seed] for seed in seeds if seed in rows]
    for name, value in totals(wanted).items():
        low, high = value.interval
        print(f"{name}: {value.hits}/{value.of} ({100 * low:.0f} to {100 * high:.0f} %)")
    if args.page:
        forms = "--held-out " if args.held_out else ""
        command = (
            f"python -m tests.withheld_campaign {forms}--seeds {args.seeds} --page {args.page}"
        )
        args.page.write_text(page(wanted, command), encoding="utf-8")
    return 0


def read_journal(path: Path) -> dict[int, Row]:
    """Rows by seed; a line that was cut short by a stop is left out."""
    found: dict[int, Row] = {}
    if path.exists():
        for text in path.read_text(encoding="utf-8").splitlines():
            try:
                row = json.loads(text)
            except ValueError:
                continue
            found[int(row["seed"])] = row
    return found


if __name__ == "__main__":
    sys.exit(main())
