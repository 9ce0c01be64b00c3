"""`make bench`: every comparison of docs/evidence/benchmarks.md, and that page.

    python -m benchmarks                             # all parts, printed
    python -m benchmarks --page docs/evidence/benchmarks.md   # and the page written
    python -m benchmarks --page docs/evidence/benchmarks.md --only recording growth_length
    python -m benchmarks finger                      # any one; some exist beside the page's parts

Each part's figures are kept in ``--results`` as soon as it is done. ``--only`` measures those parts
anew and takes the others from there; ``--resume`` measures what is not there yet.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import sys
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from benchmarks.page import PARTS, machine, page, revision

RESULTS = Path("out/bench")


def measured(name: str, tiny: bool) -> dict[str, Any]:
    """A part's figures with what they cost and on what machine they were taken."""
    at = revision()
    begin, start = time.perf_counter(), os.times()
    figures = importlib.import_module(f"benchmarks.{PARTS[name]}").measure(tiny)
    end = os.times()
    cpu = sum(end[:4]) - sum(start[:4])
    return {
        "figures": figures,
        "tiny": tiny,
        "machine": machine(),
        "revision": at,
        "date": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "load": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
        "wall_s": round(time.perf_counter() - begin, 1),
        "cpu_s": round(cpu, 1),
    }


def kept(folder: Path, name: str) -> dict[str, Any] | None:
    """A part's figures of an earlier run; None if there are none."""
    path = folder / f"{name}.json"
    if not path.exists():
        return None
    return json.loads(path.read_text(encoding="utf-8"))  # type: ignore[no-any-return]


def keep(folder: Path, name: str, part: dict[str, Any]) -> None:
    """Put them there; never half."""
    folder.mkdir(parents=True, exist_ok=True)
    partial = folder / f"{name}.json.partial"
    partial.write_text(json.dumps(part, indent=1), encoding="utf-8")
    partial.replace(folder / f"{name}.json")


def main(words: list[str] | None = None) -> None:
    """Command line."""
    words = sys.argv[1:] if words is None else words
    if words and not words[0].startswith("-") and words[0] not in PARTS:
        sys.argv = words  # one that is no part of the page, with options of its own
        importlib.import_module(f"benchmarks.{words[0]}").main()
        return
    parser = argparse.ArgumentParser(prog="python -m benchmarks")
    parser.add_argument("parts", nargs="*", choices=[*PARTS, []], help="print these parts alone")
    parser.add_argument("--page", type=Path, help="write the page")
    parser.add_argument("--only", nargs="+", choices=PARTS, help="measure these parts anew")
    parser.add_argument("--resume", action="store_true", help="measure only what is not kept yet")
    parser.add_argument("--tiny", action="store_true", help="sizes that show only that it runs")
    parser.add_argument("--results", type=Path, default=RESULTS, help="where figures are kept")
    options = parser.parse_args(words)
    wanted = options.only or options.parts or PARTS
    for name in wanted:
        there = kept(options.results, name)
        if options.resume and there is not None and there["tiny"] == options.tiny:
            continue
        print(f"measuring: {name}", file=sys.stderr, flush=True)
        part = measured(name, options.tiny)
        keep(options.results, name, part)
        module = importlib.import_module(f"benchmarks.{PARTS[name]}")
        print("\n".join([f"## {module.TITLE}", "", *module.lines(part["figures"])]), flush=True)
    if options.page is not None:
        text = page({name: kept(options.results, name) for name in PARTS})
        options.page.write_text(text, encoding="utf-8")
        print(f"written: {options.page}", file=sys.stderr)


if __name__ == "__main__":
    main()
