"""`python -m tests.fuzz`: fuzz everything that reads bytes of others; see --help."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from .loop import fuzz
from .targets import targets


def main() -> int:
    """Run every target; 1 where something was found, the inputs kept."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--inputs", type=int, default=10_000_000, help="in total")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="part of a target's name")
    parser.add_argument("--seconds", type=float, default=1e9, help="at most, of each target")
    parser.add_argument(
        "--out", type=Path, default=Path("out/fuzz"), help="where findings are kept"
    )
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    found = total = 0
    with open(args.out / "tallies.jsonl", "a", encoding="utf-8") as journal:
        for target, share in targets():
            if args.only not in target.name:
                continue
            count = round(args.inputs * (1.0 if args.only else share))
            tally = fuzz(target, count, args.seed, args.seconds)
            total += tally.inputs
            found += len(tally.found)
            print(f"{tally.name:16} {tally.inputs:9} inputs, {tally.refused:9} refused, "
                  f"{tally.kept:4} kept, {tally.lines:4} lines, {tally.grown_mb:6.1f} MB more, "
                  f"{tally.seconds:7.1f} s", flush=True)  # fmt: skip
            fields = {k: v for k, v in vars(tally).items() if k != "found"}
            journal.write(json.dumps({**fields, "found": [w for w, _ in tally.found]}) + "\n")
            journal.flush()
            for number, (what, data) in enumerate(tally.found):
                path = args.out / f"{tally.name.replace(' ', '-')}-{args.seed}-{number}"
                path.write_bytes(data)
                print(f"   {what}: {path}", flush=True)
    print(f"{total} inputs, {found} findings")
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main())
