"""`python -m tests.fuzz`: fuzz everything that reads bytes of others; see --help.

Stopped and started again it goes on where it was: the journal lies in ``--out``.
"""

from __future__ import annotations

import argparse
import signal
import sys
from pathlib import Path

from .guard import Job, run, total
from .page import write_page
from .shares import MARKED, SHARES


def main() -> int:
    """Run every target; 1 where something was found, the inputs kept."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--inputs", type=int, default=10_000_000, help="in total")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="part of a target's name")
    parser.add_argument("--seconds", type=float, default=1e9, help="at most, of each target")
    parser.add_argument("--out", type=Path, default=Path("out/fuzz"), help="journal and findings")
    parser.add_argument("--page", type=Path, help="write the results there")
    args = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # takes the worker along
    wanted = [name for name in SHARES if args.only in name]
    jobs = [Job(name, round(args.inputs * SHARES[name]), args.out.resolve(), args.seed,
                args.seconds, marked=MARKED) for name in wanted]  # fmt: skip
    for job in jobs:
        done = run(job)
        each = 1e6 * done["seconds"] / max(done["inputs"], 1)
        print(f"{done['name']:16} {done['inputs']:9} inputs, {done['refused']:9} refused, "
              f"{done['kept']:4} kept, {done['branches']:5} branches, {each:6.0f} us, slowest "
              f"{done['slowest_s']:.2f} s, {done['more_mb']:6.1f} MB more", flush=True)  # fmt: skip
        for number, what in enumerate(done["found"]):
            print(f"   {what}: {job.own / 'found' / str(number)}", flush=True)
    totals = [total(job) for job in jobs]
    found = sum(len(t["found"]) for t in totals)
    print(f"{sum(t['inputs'] for t in totals)} inputs, {found} findings")
    if args.page is not None:
        write_page([t for t in totals if t["inputs"]], args.seed, args.page)
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main())
