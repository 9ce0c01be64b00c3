"""`python -m tests.faults`: the fault campaign; see --help."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import Any

from .campaign import FINDINGS, one, protocol_of, run_campaign
from .judge import Verdict


def main() -> int:
    """Run what is asked for; 1 where something was found."""
    parser = argparse.ArgumentParser(prog="python -m tests.faults", description=__doc__)
    parser.add_argument("--runs", type=int, default=5000, help="how many (default 5000)")
    parser.add_argument("--first", type=int, default=0, help="number of the first")
    parser.add_argument("--processes", type=int, default=1, help="at a time (default 1)")
    parser.add_argument("--work", type=Path, default=Path("out/faults"), help="journal and runs")
    parser.add_argument("--only", type=int, help="one run by its number; everything is kept")
    parser.add_argument("--again", action="store_true", help="make runs with findings once more")
    parser.add_argument("--page", type=Path, help="write the results there, as a page")
    args = parser.parse_args()
    if args.only is not None:
        result = one(args.only, args.work, keep=True)
        for key, value in result.items():
            print(f"{key}: {value}")
        print(f"kept in {args.work / 'runs'}")
        return int(bool(trouble(result)))
    start, done = time.monotonic(), 0

    def tell(result: dict[str, Any]) -> None:
        nonlocal done
        done += 1
        for line in trouble(result):
            print(f"run {result['number']} ({result['protocol']}): {line}", flush=True)
            faults = (f"{f['layer']} {f['kind']} {f['device']}" for f in result["faults"])
            print("   " + "; ".join(faults), flush=True)
        if done % 100 == 0:
            print(f"{done} runs, {time.monotonic() - start:.0f} s", flush=True)

    numbers = range(args.first, args.first + args.runs)
    results = run_campaign(numbers, args.work, args.processes, tell, args.again)
    bad = [r for r in results if trouble(r)]
    print(f"{len(results)} runs, {len(bad)} with findings, "
          f"{sum(r['cpu_s'] for r in results):.0f} s of CPU")  # fmt: skip
    for result in bad[:20]:
        print(f"  again: python -m tests.faults --only {result['number']}"
              f"   ({protocol_of(result['number'])})")  # fmt: skip
    if args.page is not None:
        from .page import write_page

        write_page(results, args.page)
    return int(bool(bad))


def trouble(result: dict[str, Any]) -> list[str]:
    """Everything found of a run, in lines."""
    out = [f"{name}: {text}" for name in FINDINGS for text in result[name]]
    assert set(FINDINGS) < set(Verdict.__dataclass_fields__)
    return out + ([f"crashed: {result['crashed']}"] if result["crashed"] else [])


if __name__ == "__main__":
    sys.exit(main())
